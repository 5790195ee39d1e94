//! What an array would report of passing vessels, and what the recorder's tracker makes of it.
//!
//! Every 0.5 s each vessel gives a bearing with probability 0.85: white error of 0.9° and Gauss-Markov error of 0.5° and
//! 5 s, travel time included; vessels within 3° of each other give one bearing between them, weighted by level.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi, wrap_tau};
use seabearing_core::config::Tracking;
use seabearing_core::intake::GRID;
use seabearing_core::passage;
use seabearing_core::traffic::{self, Config, State};
use seabearing_core::wire::{Bearing, Message, Track};
use std::f64::consts::TAU;

/// Samples a second.
pub const RATE_HZ: f64 = 64_000.0;
const STEP_S: f64 = 0.5;
const DETECTION: f64 = 0.85;
const MERGE_DEG: f64 = 3.0;
const WHITE_DEG: f64 = 0.9;
const COLOURED_DEG: f64 = 0.5;
const TAU_S: f64 = 5.0;
const SOUND_M_S: f64 = 1484.0;

/// Something that moves and is heard.
pub trait HeardVessel {
    /// East and North of the array at a time, metres.
    fn position(&self, t_s: f64) -> (f64, f64);

    /// Distance, metres.
    fn range(&self, t_s: f64) -> f64 {
        let (x, y) = self.position(t_s);
        x.hypot(y)
    }

    /// Azimuth received at `t_s`, radians.
    fn azimuth(&self, t_s: f64) -> f64 {
        let mut emitted_s = t_s;
        for _ in 0..4 {
            emitted_s = t_s - self.range(emitted_s) / SOUND_M_S;
        }
        let (x, y) = self.position(emitted_s);
        wrap_tau(x.atan2(y))
    }
}

/// Times and bearings of one run, in order.
pub type Bearings = Vec<(f64, f64)>;

/// What the array would report of these vessels.
pub fn listen(
    vessels: &[impl HeardVessel],
    duration_s: f64,
    rng: &mut ChaCha8Rng,
    false_bearing: f64,
) -> Bearings {
    let mut normal = {
        let mut rng = ChaCha8Rng::seed_from_u64(rng.random());
        move || -> f64 { StandardNormal.sample(&mut rng) }
    };
    let keep = (-STEP_S / TAU_S).exp();
    let mut coloured: Vec<f64> = vessels.iter().map(|_| COLOURED_DEG * normal()).collect();
    let mut out = Vec::new();
    for k in 0..(duration_s / STEP_S) as u32 {
        let t_s = STEP_S * f64::from(k);
        // Sorted by azimuth, vessels close together form groups that give one bearing.
        let mut heard: Vec<(f64, f64)> = Vec::new();
        for (vessel, coloured) in vessels.iter().zip(&mut coloured) {
            *coloured = keep * *coloured + (1.0 - keep * keep).sqrt() * COLOURED_DEG * normal();
            let azimuth = vessel.azimuth(t_s) + *coloured * RAD_PER_DEG;
            let level = vessel.range(t_s).powi(-2);
            let near = heard.iter_mut().find(|(a, _)| wrap_pi(azimuth - *a).abs() < MERGE_DEG * RAD_PER_DEG);
            if let Some((a, l)) = near {
                *a += level / (level + *l) * wrap_pi(azimuth - *a);
                *l += level;
            } else {
                heard.push((azimuth, level));
            }
        }
        for (azimuth, _) in heard {
            if rng.random::<f64>() < DETECTION {
                out.push((t_s, wrap_tau(azimuth + WHITE_DEG * RAD_PER_DEG * normal())));
            }
        }
        if rng.random::<f64>() < false_bearing {
            out.push((t_s, rng.random_range(0.0..TAU)));
        }
    }
    out
}

/// The tracker's configuration: the errors as they are drawn, ways as straight as is said, everything else as usual.
fn config(course_sd_deg: f64) -> Config {
    let tracking =
        Tracking { bearing_sd_deg: COLOURED_DEG, bearing_tau_s: TAU_S, course_sd_deg, ..Tracking::default() };
    Config::with(passage::Config::new(&tracking, SOUND_M_S), RATE_HZ)
}

fn message(t_s: f64, azimuth: f64) -> Bearing {
    let variance = (WHITE_DEG * RAD_PER_DEG).powi(2) as f32;
    Bearing {
        index: (t_s * RATE_HZ) as u64,
        azimuth: azimuth as f32,
        elevation: 0.0,
        var_azimuth: variance,
        var_elevation: variance,
        cov: 0.0,
        snr_db: 10.0,
        quality: 1.0,
        closure_s: 0.0,
        statistic: 2.0,
        band: 0,
        flags: 0,
    }
}

/// Runs the tracker, which takes ways to be straight but for `course_sd_deg`; returns its track records, and for each bearing the number of the track it lies on.
pub fn track(bearings: &Bearings, course_sd_deg: f64) -> (Vec<Track>, Vec<Option<u16>>) {
    let config = config(course_sd_deg);
    let mut state = State::new();
    let (mut records, mut on) = (Vec::new(), Vec::new());
    let mut sink = |m| {
        if let Message::Track(t) = m {
            records.push(t);
        }
    };
    let mut reached = 0;
    for &(t_s, azimuth) in bearings {
        let bearing = message(t_s, azimuth);
        // As the recorder does: the tracker hears of every grid step.
        while reached + GRID <= bearing.index {
            reached += GRID;
            traffic::advance(&config, &mut state, reached, &mut sink);
        }
        traffic::bearing(&config, &mut state, &bearing, &mut sink);
        on.push(state.nearest(&config, &bearing));
    }
    traffic::finish(&config, &mut state, &mut sink);
    (records, on)
}
