//! A made sea for the chain's tests: a white source heard by a tetrahedron, and what the chain says of it.

use crate::angle::{unit_vector, wrap_pi};
use crate::array::wavefront;
use crate::array::{Plan, Scratch, State, finish, push};
use crate::block::{Block, CHANNELS, Frame};
use crate::config::{ArrayConfig, Kind, StationConfig};
use crate::wire::{Bearing, FaultCode, Message, Transient};
use std::boxed::Box;
use std::vec::Vec;

pub(super) const AZIMUTH: f64 = 2.1;
pub(super) const ELEVATION: f64 = 0.3;
pub(super) const SECONDS: usize = 14;

/// A tetrahedron of 1.84 m, 168 m deep in a sea without a surface, as the caller changes it.
pub(super) fn planned(rate_hz: f64, change: impl FnOnce(&mut ArrayConfig)) -> Plan {
    let mut config = StationConfig::array(
        rate_hz,
        [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]],
    );
    config.depth_m = 168.0;
    if let Kind::Array(array) = &mut config.kind {
        array.band_hz.1 = array.band_hz.1.min(0.4375 * rate_hz);
        array.vessel_depth_m = 0.0;
        change(array);
    }
    Plan::new(&config).unwrap()
}

pub(super) fn plan(rate_hz: f64) -> Plan {
    planned(rate_hz, |_| {})
}

/// Normal numbers: sums of twelve uniform ones.
pub(super) struct Normal(pub(super) u64);

impl Normal {
    pub(super) fn next(&mut self) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (self.0 >> 11) as f64 / (1u64 << 53) as f64;
        }
        sum
    }
}

/// What a source gives the hydrophones from a direction, at the surface or, where there is none, 500 m away: white, or falling by 6 dB an octave
/// above a knee, with this root mean square.
pub(super) fn source(
    plan: &Plan,
    (azimuth, elevation): (f64, f64),
    rms: f64,
    knee_hz: Option<f64>,
    seconds: usize,
    seed: u64,
) -> Vec<[f64; CHANNELS]> {
    const TAPS: i64 = 24;
    let rate = f64::from(plan.rate_hz());
    let n = seconds * rate as usize;
    let mut random = Normal(seed);
    let margin = 200;
    let keep = knee_hz.map_or(0.0, |knee| (-core::f64::consts::TAU * knee / rate).exp());
    let gain = rms * (1.0 - keep * keep).sqrt();
    let mut last = 0.0;
    let source: Vec<f64> = (0..n + 2 * margin)
        .map(|_| {
            last = keep * last + gain * random.next();
            last
        })
        .collect();
    let direction = unit_vector(azimuth as f32, elevation as f32);
    let (curvature, _) = plan.curvature_from(&direction);
    let delays = wavefront::arrivals(plan.geometry(), &direction, curvature);
    let filters = delays.map(|t| {
        let delay = f64::from(t) * rate;
        let whole = delay.floor();
        let taps: Vec<f64> = (-TAPS..TAPS)
            .map(|k| {
                let x = core::f64::consts::PI * (k as f64 - (delay - whole));
                let window = (0.5 * x / TAPS as f64).cos().powi(2);
                if x.abs() < 1e-9 { 1.0 } else { x.sin() / x * window }
            })
            .collect();
        (whole as i64, taps)
    });
    (0..n)
        .map(|i| {
            core::array::from_fn(|c| {
                let (whole, taps) = &filters[c];
                let from = (i + margin) as i64 - whole;
                taps.iter().zip(-TAPS..).map(|(h, k)| h * source[(from - k) as usize]).sum()
            })
        })
        .collect()
}

/// Adds white noise of unit power to each hydrophone.
pub(super) fn noisy(mut sea: Vec<[f64; CHANNELS]>, seed: u64) -> Vec<[f64; CHANNELS]> {
    let mut random = Normal(seed);
    sea.iter_mut().flatten().for_each(|x| *x += random.next());
    sea
}

/// A white source of the usual direction, so many dB above the noise of each hydrophone.
pub(super) fn sea(plan: &Plan, snr_db: f64, seed: u64) -> Vec<[f64; CHANNELS]> {
    let rms = 10f64.powf(snr_db / 20.0);
    noisy(source(plan, (AZIMUTH, ELEVATION), rms, None, SECONDS, seed), seed ^ 0x5ea)
}

pub(super) struct Heard {
    pub(super) faults: Vec<(FaultCode, i64, f64)>,
    pub(super) bearings: Vec<Bearing>,
    pub(super) transients: Vec<Transient>,
    pub(super) channels: u8,
    /// Whether an echo off the bottom was known at the end.
    pub(super) echo: bool,
}

pub(super) fn hear(plan: &Plan, sea: &[[f64; CHANNELS]]) -> Heard {
    let frames: Vec<Frame> = sea.iter().map(|x| x.map(|x| (2000.0 * x).round() as i32)).collect();
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let (mut faults, mut bearings, mut transients) = (Vec::new(), Vec::new(), Vec::new());
    let mut sink = |message| match message {
        Message::Fault(f) => faults.push((f.code, f.value, f.index as f64 / f64::from(plan.rate_hz()))),
        Message::Bearing(b) => bearings.push(b),
        Message::Transient(t) => transients.push(t),
        _ => {}
    };
    push(plan, &mut state, &mut scratch, Block { first_index: 0, frames: &frames }, &mut sink);
    let (channels, echo) = (state.channels(plan), state.hears_echo());
    finish(plan, &mut state, &mut scratch, &mut sink);
    Heard { faults, bearings, transients, channels, echo }
}

/// Error of a bearing of the usual direction across and up, radians.
pub(super) fn error(b: &Bearing) -> (f64, f64) {
    error_from(b, (AZIMUTH, ELEVATION))
}

/// Error of a bearing of a direction, radians.
pub(super) fn error_from(b: &Bearing, (azimuth, elevation): (f64, f64)) -> (f64, f64) {
    (wrap_pi(f64::from(b.azimuth) - azimuth), f64::from(b.elevation) - elevation)
}

/// Squared error of a bearing in units of its covariance: beyond 5.991 in one of twenty.
pub(super) fn standardised(b: &Bearing, direction: (f64, f64)) -> f64 {
    let (across, up) = error_from(b, direction);
    let (va, ve, c) = (f64::from(b.var_azimuth), f64::from(b.var_elevation), f64::from(b.cov));
    (ve * across * across - 2.0 * c * across * up + va * up * up) / (va * ve - c * c)
}
