//! From sound pressure to codes: hydrophone sensitivity, gain, converter, and what may go wrong with a channel.

use super::scenario::{Affected, ArrayFault, ArrayScenario};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use seabearing_core::config::Kind;

/// Codes of 24 bits: ±2²³.
const FULL_SCALE: f64 = 8_388_608.0;

/// The recorder's electronics.
pub struct SimulatedConverter {
    /// Codes per µPa of each hydrophone.
    scale: [f64; CHANNELS],
    /// Recorder channel of each hydrophone.
    channels: [u8; CHANNELS],
    /// Codes of 24 bits in one of the converter's.
    step: f64,
    faults: Vec<ArrayFault>,
    rate_hz: f64,
    held: Frame,
}

impl SimulatedConverter {
    /// The electronics of a scenario.
    pub fn new(scenario: &ArrayScenario) -> Self {
        let r = &scenario.recorder;
        let (sensitivity, channels) = match &scenario.station.config.kind {
            Kind::Array(a) => (a.sensitivity_db_re_1v_upa, a.channels),
            _ => ([-165.0; CHANNELS], [0, 1, 2, 3]),
        };
        Self {
            scale: sensitivity.map(|s| 10f64.powf((s + r.gain_db) / 20.0) / r.full_scale_v * FULL_SCALE),
            channels,
            step: 2f64.powi(24 - r.bits as i32),
            faults: scenario.faults.clone(),
            rate_hz: scenario.station.config.rate_hz,
            held: [0; CHANNELS],
        }
    }

    /// The codes of one instant, by recorder channel, from the pressures (µPa) at the hydrophones.
    pub fn convert(&mut self, index: u64, pressure: [f32; CHANNELS]) -> Frame {
        let t = index as f64 / self.rate_hz;
        let mut volts = [0.0; CHANNELS];
        for ((p, scale), channel) in pressure.iter().zip(self.scale).zip(self.channels) {
            if let Some(v) = volts.get_mut(usize::from(channel)) {
                *v = f64::from(*p) * scale;
            }
        }
        for fault in &self.faults {
            if let ArrayFault::Loud(l) = fault
                && (l.from_s..l.to_s).contains(&t)
                && let Some(v) = volts.get_mut(l.channel)
            {
                *v *= 10f64.powf(l.gain_db / 20.0);
            }
        }
        let mut frame = volts.map(|v| self.code(v));
        let within = |a: &Affected| (a.from_s..a.to_s).contains(&t);
        for fault in &self.faults {
            match fault {
                ArrayFault::Dead(a) if within(a) => frame[a.channel] = 0,
                ArrayFault::Stuck(a) if within(a) => frame[a.channel] = self.held[a.channel],
                ArrayFault::Nan(a) if within(a) => frame[a.channel] = MISSING,
                ArrayFault::Swap(s) if (s.from_s..s.to_s).contains(&t) => {
                    frame.swap(s.channels[0], s.channels[1])
                }
                _ => {}
            }
        }
        self.held = frame;
        frame
    }

    fn code(&self, v: f64) -> i32 {
        let code = (v / self.step).round() * self.step;
        // The greatest code of a coarser converter is written as 2^23 - 1, as `recording` reads it.
        if code >= FULL_SCALE - self.step { 0x7f_ffff } else { code.max(-FULL_SCALE) as i32 }
    }
}
