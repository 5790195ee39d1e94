//! `reproduce sea-sick`: one channel goes sick while a vessel is heard: is it named within 10 s, and are the bearings
//! meanwhile and afterwards right or withheld?
//!
//! A vessel passes 500 m away at 10 and 0 dB in ambient noise of its own spectrum, 64 kHz, array without any symmetry, so that
//! exchanged channels contradict each other. The channel is sick from the second second on, alone or with another, or all four slip by a
//! slot or two of their converter's line. Near: inverted, exchanged, slipped, one or two samples late while a vessel passes 200 m from an array 60 m deep, where it is heard apart from its image in the
//! surface, in the demo's noise; and the same with nothing wrong, of which nothing is to be said. A bearing is wrong where it is off by more
//! than four of its standard deviations and 0.1°; one that states more than 5° counts as withheld.

use super::report::CsvReport;
use super::sea::{Said, arrival, ferry, hear, miss, scenario, side, station};
use super::sea_moving::MovingSea;
use super::{Experiment, Options};
use crate::progress;
use crate::scenario::Straight;
use crate::world::ArrayScenario;
use crate::world::scenario::{AmbientSpectrum, Water};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::block::{CHANNELS, Frame};
use seabearing_core::config::StationConfig;
use seabearing_core::wire::FaultCode;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-sick",
    about: "one channel or two deaf, noisy, inverted, late, exchanged or leaking, or all slipped: named, and bearings right or withheld",
    run,
};

const DURATION_S: f64 = 16.0;
const RATE_HZ: f64 = 64_000.0;
const RANGE_M: f64 = 500.0;
const SNR_DB: [f64; 2] = [10.0, 0.0];
/// When the channel becomes sick, and how soon it is to be named, seconds.
const FROM_S: f64 = 2.0;
const WITHIN_S: f64 = 10.0;
/// What makes a bearing wrong: so many of its standard deviations, and degrees.
const WRONG_SD: f64 = 4.0;
const WRONG_DEG: f64 = 0.1;
/// A bearing that states more than this points nowhere, degrees.
const WITHHELD_DEG: f64 = 5.0;

/// What ails a channel.
#[derive(Clone, Copy, Debug)]
enum Sickness {
    Silent,
    Copied,
    OwnNoise,
    Noisy,
    Inverted,
    Late,
    Exchanged,
    /// Each channel holds the hydrophone so many slots on.
    Slipped(usize),
    Leaking(f64),
    /// Two that hear each other.
    Crosstalk(f64),
    Common,
    /// So many samples late.
    LateBy(usize),
    Well,
}

const ALL: [(Sickness, &str); 14] = [
    (Sickness::Silent, "silent"),
    (Sickness::Copied, "copy of another"),
    (Sickness::OwnNoise, "its own noise alone"),
    (Sickness::Noisy, "20 dB of its own noise"),
    (Sickness::Inverted, "inverted"),
    (Sickness::Late, "a sample late"),
    (Sickness::Exchanged, "exchanged with another"),
    (Sickness::Leaking(0.3), "leaking at -10 dB"),
    (Sickness::Leaking(0.1), "leaking at -20 dB"),
    (Sickness::Crosstalk(0.3), "leaking both ways at -10 dB"),
    (Sickness::Crosstalk(0.1), "leaking both ways at -20 dB"),
    (Sickness::Common, "noise common to all"),
    (Sickness::Slipped(1), "all slipped by a slot"),
    (Sickness::Slipped(2), "all slipped by two slots"),
];

/// Two channels sick at once, the second of them the one after the next. What none can see is not among them: a channel
/// late when only three are heard.
const TWO: [(Sickness, Sickness, &str); 5] = [
    (Sickness::Silent, Sickness::OwnNoise, "silent and its own noise alone"),
    (Sickness::OwnNoise, Sickness::OwnNoise, "two with noise of their own"),
    (Sickness::Inverted, Sickness::Inverted, "two inverted"),
    (Sickness::Inverted, Sickness::Noisy, "inverted and 20 dB of its own noise"),
    (Sickness::OwnNoise, Sickness::Inverted, "its own noise alone and inverted"),
];

/// What is wrong near a vessel.
const NEAR: [(Sickness, &str); 6] = [
    (Sickness::Inverted, "near, inverted"),
    (Sickness::Exchanged, "near, exchanged with another"),
    (Sickness::Slipped(1), "near, all slipped by a slot"),
    (Sickness::Late, "near, a sample late"),
    (Sickness::LateBy(2), "near, two samples late"),
    (Sickness::Well, "near, nothing"),
];
/// How far the vessel is at its closest, how deep the array, metres.
const NEAR_M: (f64, f64) = (200.0, 60.0);

impl Sickness {
    fn spoil(self, frames: &mut [Frame], channel: usize, noise_codes: f64, rng: &mut ChaCha8Rng) {
        let other = (channel + 1) % CHANNELS;
        let mut noise = |rms: f64| -> i32 {
            let x: f64 = StandardNormal.sample(rng);
            (rms * noise_codes * x) as i32
        };
        let mut before = 0;
        if let Self::LateBy(samples) = self {
            let from = (FROM_S * RATE_HZ) as usize;
            for n in (from..frames.len()).rev() {
                frames[n][channel] = frames[n - samples][channel];
            }
        }
        for frame in frames.iter_mut().skip((FROM_S * RATE_HZ) as usize) {
            let heard = frame[channel];
            match self {
                Self::Silent => frame[channel] = 0,
                Self::Copied => frame[channel] = frame[other],
                Self::OwnNoise => frame[channel] = noise(1.0),
                Self::Noisy => frame[channel] += noise(10.0),
                Self::Inverted => frame[channel] = -heard,
                Self::Late => frame[channel] = before,
                Self::LateBy(_) | Self::Well => {}
                Self::Exchanged => frame.swap(channel, other),
                Self::Slipped(slots) => frame.rotate_left(slots),
                Self::Leaking(gain) => frame[channel] += (gain * f64::from(frame[other])) as i32,
                Self::Crosstalk(gain) => {
                    let of = |x: i32| (gain * f64::from(x)) as i32;
                    let (to, back) = (of(frame[other]), of(heard));
                    frame[channel] += to;
                    frame[other] += back;
                }
                Self::Common => {
                    let x = noise(1.0);
                    frame.iter_mut().for_each(|c| *c += x);
                }
            }
            before = heard;
        }
    }

    /// Whether a fault names the channel (or the pair, or that something is wrong with all).
    fn named(self, code: FaultCode, value: i64, channel: usize) -> bool {
        use FaultCode as F;
        let own = value == channel as i64;
        match self {
            Self::Silent => own && matches!(code, F::DeadChannel),
            Self::Copied => matches!(code, F::DeadChannel),
            Self::OwnNoise | Self::Noisy => own && matches!(code, F::OwnNoise),
            Self::Inverted => own && matches!(code, F::Inverted),
            Self::Well => false,
            Self::Late | Self::LateBy(_) | Self::Exchanged | Self::Slipped(_) | Self::Common => {
                matches!(code, F::Inconsistent)
            }
            Self::Leaking(_) => own && matches!(code, F::Leaking),
            Self::Crosstalk(_) => {
                (own || value == ((channel + 1) % CHANNELS) as i64) && matches!(code, F::Leaking)
            }
        }
    }
}

/// What became of one sickness.
#[derive(Clone, Copy, Debug, Default)]
struct Verdict {
    runs: f64,
    named: f64,
    /// Longest time until then, s.
    latest_s: f64,
    bearings: f64,
    wrong: f64,
    outside: f64,
}

impl Verdict {
    fn join(self, o: Self) -> Self {
        Self {
            runs: self.runs + o.runs,
            named: self.named + o.named,
            latest_s: self.latest_s.max(o.latest_s),
            bearings: self.bearings + o.bearings,
            wrong: self.wrong + o.wrong,
            outside: self.outside + o.outside,
        }
    }

    /// `named` says of a fault's code and channel whether it names what is sick.
    fn of(said: &Said, named: impl Fn(FaultCode, i64) -> bool, scene: &ArrayScenario) -> Result<Self> {
        let mut verdict = Self { runs: 1.0, ..Self::default() };
        let seconds = |index: u64| index as f64 / RATE_HZ - FROM_S;
        let named = said.faults.iter().find(|f| named(f.code, f.value));
        if let Some(f) = named.filter(|f| seconds(f.index) <= WITHIN_S) {
            verdict.named = 1.0;
            verdict.latest_s = seconds(f.index);
        }
        for b in said.bearings.iter().filter(|b| b.band == 0 && seconds(b.index) > 0.5) {
            let at = arrival(scene, &scene.vessels[0], b.index as f64 / RATE_HZ)?;
            let (chi2, off) = miss(b, at);
            if f64::from(b.var_azimuth.max(b.var_elevation)).sqrt().to_degrees() > WITHHELD_DEG {
                continue;
            }
            verdict.bearings += 1.0;
            verdict.wrong += f64::from(u8::from(chi2 > WRONG_SD * WRONG_SD && off.to_degrees() > WRONG_DEG));
            verdict.outside += f64::from(u8::from(chi2 > super::sea::ELLIPSE));
        }
        Ok(verdict)
    }
}

fn trial(config: &StationConfig, seed: u64, snr_db: f64) -> Result<Vec<Verdict>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let course = Straight {
        cpa_time_s: 0.5 * DURATION_S,
        cpa_range_m: RANGE_M,
        heading_deg: rng.random_range(0.0..360.0),
        speed_m_s: 7.0,
        side: side(rng.random()),
    };
    let channel = rng.random_range(0..CHANNELS);
    let water = Water { surface_reflection: 0.0, ..Water::default() };
    let mut scene = scenario(config.clone(), water, vec![ferry(course)], DURATION_S, seed);
    // Noise of the vessel's spectrum.
    scene.scene.ambient = AmbientSpectrum {
        snr_at_cpa_db: Some(snr_db),
        slope_db_per_decade: scene.vessels[0].slope_db_per_decade,
        knee_hz: scene.vessels[0].knee_hz,
        ..AmbientSpectrum::default()
    };
    let healthy: Vec<Frame> = MovingSea::new(&scene)?.collect();
    let noise_codes = healthy.iter().map(|f| f64::from(f[channel]).powi(2)).sum::<f64>();
    let noise_codes = (noise_codes / healthy.len() as f64 / (1.0 + 10f64.powf(snr_db / 10.0))).sqrt();
    let second = (channel + 2) % CHANNELS;
    let one = ALL.par_iter().map(|(sickness, _)| (*sickness, None));
    let two = TWO.par_iter().map(|(first, second, _)| (*first, Some(*second)));
    one.chain(two)
        .map(|(sickness, other)| {
            let mut frames = healthy.clone();
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x51c4);
            sickness.spoil(&mut frames, channel, noise_codes, &mut rng);
            if let Some(other) = other {
                other.spoil(&mut frames, second, noise_codes, &mut rng);
            }
            let said = hear(config, frames.into_iter())?;
            let first = |code, value| sickness.named(code, value, channel);
            // Of two, either, or that they contradict each other.
            let any = |code, value| {
                code == FaultCode::Inconsistent
                    || first(code, value)
                    || other.is_some_and(|other| other.named(code, value, second))
            };
            match other {
                None => Verdict::of(&said, first, &scene),
                Some(_) => Verdict::of(&said, any, &scene),
            }
        })
        .collect()
}

/// A vessel near by and its image: what became of each of [`NEAR`], and how many faults were raised.
fn near(config: &StationConfig, seed: u64) -> Result<Vec<(Verdict, f64)>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let course = Straight {
        cpa_time_s: rng.random_range(0.0..2.0) * DURATION_S,
        cpa_range_m: NEAR_M.0,
        heading_deg: rng.random_range(0.0..360.0),
        speed_m_s: rng.random_range(4.0..10.0),
        side: side(rng.random()),
    };
    let channel = rng.random_range(0..CHANNELS);
    let mut vessel = ferry(course);
    vessel.depth_m = rng.random_range(2.0..8.0);
    let scene = scenario(config.clone(), Water::default(), vec![vessel], DURATION_S, seed);
    let healthy: Vec<Frame> = MovingSea::new(&scene)?.collect();
    let each = NEAR.par_iter().map(|(sickness, _)| {
        let mut frames = healthy.clone();
        sickness.spoil(&mut frames, channel, 0.0, &mut ChaCha8Rng::seed_from_u64(seed ^ 0x51c4));
        let said = hear(config, frames.into_iter())?;
        let faults = said.faults.iter().filter(|f| f.code != FaultCode::Impulses).count();
        let named = |code, value| sickness.named(code, value, channel);
        Ok((Verdict::of(&said, named, &scene)?, faults as f64))
    });
    each.collect()
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(1);
    // Each hydrophone displaced by decimetres from the corners of the tetrahedron.
    let config = station(RATE_HZ, 168.0, |array| {
        array.vessel_depth_m = 0.0;
        array.hydrophones_m =
            [[0.0, 1.06, -0.28], [0.92, -0.43, -0.45], [-0.80, -0.61, -0.38], [0.12, 0.0, 1.02]];
    });
    let mut report =
        CsvReport::new("sea_sick", "sickness,snr_db,runs,named_in_10_s,latest_s,bearings,wrong,outside_%");
    let bar = progress::bar(((SNR_DB.len() + 2) * runs) as u64, "records");
    let names: Vec<&str> =
        ALL.iter().map(|(_, name)| *name).chain(TWO.iter().map(|(.., name)| *name)).collect();
    let mut sums = vec![Verdict::default(); names.len()];
    for snr_db in SNR_DB {
        let mut of_level = vec![Verdict::default(); names.len()];
        for n in 0..runs as u64 {
            let seed = options.seed.wrapping_mul(13_000_027) + 2 * n + u64::from(snr_db > 5.0);
            for (sum, verdict) in of_level.iter_mut().zip(trial(&config, seed, snr_db)?) {
                *sum = sum.join(verdict);
            }
            bar.inc(1);
        }
        for (k, v) in of_level.iter().enumerate() {
            let outside = 100.0 * v.outside / v.bearings;
            report.row(&[k as f64, snr_db, v.runs, v.named, v.latest_s, v.bearings, v.wrong, outside]);
            sums[k] = sums[k].join(*v);
        }
    }
    let config = station(RATE_HZ, NEAR_M.1, |_| {});
    let mut of_near = [(Verdict::default(), 0.0); NEAR.len()];
    for n in 0..2 * runs as u64 {
        let seed = options.seed.wrapping_mul(13_000_027) + 1_000_000 + n;
        for ((sum, faults), (verdict, more)) in of_near.iter_mut().zip(near(&config, seed)?) {
            (*sum, *faults) = (sum.join(verdict), *faults + more);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if !options.json {
        for (k, name) in names.iter().enumerate() {
            println!("sickness {k}: {name}");
        }
    }
    report.finish(options)?;
    for (name, v) in names.iter().zip(sums) {
        options.figures.at_least(format!("{name}: named within 10 s, %"), 100.0 * v.named / v.runs, 100.0);
        options.figures.at_most(format!("{name}: wrong bearings, of {}", v.bearings), v.wrong, 0.0);
    }
    for ((sickness, name), (v, faults)) in NEAR.iter().zip(of_near) {
        if matches!(sickness, Sickness::Well) {
            options.figures.at_most(format!("{name}: faults"), faults, 0.0);
        } else {
            options.figures.at_least(
                format!("{name}: named within 10 s, %"),
                100.0 * v.named / v.runs,
                100.0,
            );
        }
        options.figures.at_most(format!("{name}: wrong bearings, of {}", v.bearings), v.wrong, 0.0);
    }
    Ok(())
}
