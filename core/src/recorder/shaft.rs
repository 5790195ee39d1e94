//! Shaft rate inside the array recorder: the rate of the vessel's propeller, its speed by the station's curve, and whose it is.
//!
//! Enters: samples of the first hydrophone's channel (its envelope is as good as any; a dead channel silences bearings as
//! well). Leaves: [`Message::ShaftRate`] while there is a rate, and a measured speed for the track it belongs to. A rate is
//! told at the recorder's next look at the time, so that its place among the other messages does not depend on how
//! samples are cut into blocks.

use super::slot::Slot;
use crate::block::Block;
use crate::config::{Kind, StationConfig};
use crate::demon::{self, Rate, Reading, Scratch, SpeedCurve};
use crate::traffic;
use crate::wire::{Message, ShaftRate};

/// Time between analyses, seconds: a third of their window.
const UPDATE_S: f64 = 10.0;
/// Corner of the high-pass, Hz, and at most this part of the sampling rate.
const HIGH_PASS_HZ: f64 = 3000.0;
const HIGH_PASS_SHARE: f64 = 0.2;

/// What follows from the configuration.
#[derive(Debug)]
pub(super) struct Plan {
    demon: Option<demon::Config>,
    curve: Option<SpeedCurve>,
}

impl Plan {
    pub(super) fn new(config: &StationConfig) -> Self {
        let channel = match &config.kind {
            Kind::Array(array) => array.channels[0],
            _ => 0,
        };
        let settings = demon::Settings {
            rate_hz: config.rate_hz,
            channels: 1u8 << (channel & 3),
            high_pass_hz: HIGH_PASS_HZ.min(HIGH_PASS_SHARE * config.rate_hz),
            update_s: UPDATE_S,
            ..demon::Settings::default()
        };
        Self { demon: demon::Config::new(&settings).ok(), curve: config.tracking.shaft_speed }
    }
}

/// The envelope, and a rate not yet told.
#[derive(Debug)]
pub(super) struct State {
    demon: demon::State,
    found: Slot<(u64, Rate)>,
}

impl State {
    pub(super) const fn new() -> Self {
        Self { demon: demon::State::new(), found: Slot::Empty }
    }
}

/// Takes samples.
pub(super) fn push(plan: &Plan, state: &mut State, scratch: &mut Scratch, block: &Block<'_>) {
    let (Some(config), State { demon, found }) = (&plan.demon, state) else { return };
    demon::process(config, demon, scratch, block, &mut |report| {
        if let Ok(rate) = report.rate {
            *found = Slot::Full((report.index, rate));
        }
    });
}

/// Tells a rate found since the last call and gives its speed to the only vessel there is.
pub(super) fn tell(
    plan: &Plan,
    state: &mut State,
    vessels: &mut traffic::State,
    sink: &mut dyn FnMut(&Message),
) {
    let Slot::Full((index, rate)) = core::mem::replace(&mut state.found, Slot::Empty) else { return };
    let speed = match plan.curve.map(|curve| curve.speeds(&rate)) {
        Some([Some(one), None] | [None, Some(one)]) => Some(one),
        _ => None,
    };
    let (speed_m_s, sd_speed_m_s) =
        speed.map_or((f32::INFINITY, f32::INFINITY), |s| (s.mean_m_s as f32, s.sd_m_s as f32));
    let vessel = vessels.only_vessel().filter(|_| speed.is_some());
    let track = vessel.filter(|id| traffic::set_speed(vessels, *id, speed_m_s, sd_speed_m_s));
    sink(&Message::ShaftRate(ShaftRate {
        index,
        rate_hz: rate.rate_hz,
        sd_hz: rate.sd_hz,
        confidence: rate.confidence,
        ln_false_alarm: rate.ln_false_alarm,
        harmonics: rate.harmonics,
        blades: match rate.reading {
            Reading::ShaftWithBlades(blades) => blades,
            Reading::ShaftOrBlade => 0,
        },
        speed_m_s,
        sd_speed_m_s,
        track: track.unwrap_or(0),
    }));
}
