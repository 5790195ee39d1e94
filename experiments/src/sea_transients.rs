//! `reproduce sea-transients`: explosions and whale clicks for half an hour, and no vessel; snaps of shrimp beside a vessel.
//! What is tracked, which transients are reported, from where, and what that takes on the line.
//!
//! Explosions and clicks: 16 kHz, ambient noise of a falling spectrum, four runs of their own. An explosion in about 20 s, 20 to 40 dB
//! over the noise, dying away within half a second; after each a train of clicks two a second, 20 to 36 dB at their peak,
//! a millisecond long. Snaps: 64 kHz, 5 and 20 a second as in `sea-snaps`, 10 to 40 times the root mean square of all at their peak, a vessel of 10 and 0 dB.
//! Each sound from a direction and distance of its own. Whistles (5 to 15 kHz in 0.5 to 1 s, one in 1 to 2 s, from a herd that moves) and strokes
//! of a pile driver (50 ms, one in 1 to 2 s, from one place): 64 kHz, no vessel, one to three times the root mean square of the noise.

use super::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};
use super::figure::Bar;
use super::report::CsvReport;
use super::sea::{ELLIPSE, Held, RATE_HZ, Said, hear, station};
use super::{Experiment, Options};
use crate::progress;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::block::Frame;
use seabearing_core::config::StationConfig;
use seabearing_core::geometry::Geometry;
use seabearing_core::wire::{Encoder, FaultCode, Message, Transient};
use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "sea-transients",
    about: "explosions, whale clicks, snaps, whistles and pile strokes: tracks, transients reported, their directions",
    run,
};

/// Samples of a record of explosions and clicks: 131 s; records of a run.
const RECORD: usize = 1 << 21;
const RECORDS: u64 = 4;
/// Samples of a record of snaps: 33 s.
const SNAPPED: usize = 1 << 21;
const NOISE_CODES: f64 = 2e3;
const A_SECOND: [f64; 2] = [5.0, 20.0];
const SNR_DB: [f64; 2] = [10.0, 0.0];
/// A record within so many seconds of a transient is of that.
const SAME_S: f64 = 0.005;
/// Taps of the interpolation on either side.
const TAPS: i64 = 16;

/// A transient as it was made.
#[derive(Clone, Copy)]
struct Made {
    /// When the first hydrophone hears it.
    t_s: f64,
    /// Azimuth and elevation, radians.
    from: (f64, f64),
}

/// A sea in memory, and what was put into it.
struct Sea<'a> {
    geometry: &'a Geometry,
    rate_hz: f64,
    frames: Vec<Frame>,
    made: Vec<Made>,
}

impl Sea<'_> {
    /// Adds a sound (in units of the noise) that is heard from a direction and distance of its own at a time.
    fn add(&mut self, at_s: f64, sound: &[f64], rng: &mut ChaCha8Rng) {
        let from = (rng.random_range(0.0..TAU), rng.random_range(-0.5f64..0.9).asin());
        let range_m = 50.0 * 100f64.powf(rng.random::<f64>());
        self.add_from(at_s, sound, from, range_m);
    }

    /// The same from this direction (radians) and distance.
    fn add_from(&mut self, at_s: f64, sound: &[f64], from: (f64, f64), range_m: f64) {
        let arrivals = exact_arrivals(self.geometry, from.0, from.1, range_m);
        let first = arrivals.iter().copied().fold(f64::INFINITY, f64::min);
        for (channel, arrival) in arrivals.iter().enumerate() {
            let start = (at_s + arrival - first) * self.rate_hz;
            let whole = start.floor();
            let weights: Vec<f64> = (-TAPS..TAPS)
                .map(|k| {
                    let x = k as f64 - (start - whole);
                    let window = (0.5 * PI * x / (TAPS + 1) as f64).cos().powi(2);
                    if x.abs() < 1e-9 { 1.0 } else { (PI * x).sin() / (PI * x) * window }
                })
                .collect();
            let n = sound.len() as i64;
            for (frame, at) in
                self.frames.iter_mut().skip(whole as usize - TAPS as usize).zip(-TAPS..n + TAPS)
            {
                let taps = weights.iter().zip(-TAPS..);
                let value: f64 =
                    taps.filter_map(|(w, k)| Some(w * sound.get(usize::try_from(at - k).ok()?)?)).sum();
                frame[channel] += (NOISE_CODES * value).round() as i32;
            }
        }
        self.made.push(Made { t_s: at_s, from });
    }
}

/// Noise that dies away, without what is near half the sampling rate.
fn explosion(rng: &mut ChaCha8Rng) -> Vec<f64> {
    let peak = 10f64.powf(rng.random_range(1.0..2.0));
    let white: Vec<f64> = (0..9600).map(|_| StandardNormal.sample(rng)).collect();
    let smooth = white.windows(3).map(|x| 0.4 * x[0] + 0.8 * x[1] + 0.4 * x[2]);
    smooth.enumerate().map(|(k, x)| peak * (-(k as f64) / 2000.0).exp() * x).collect()
}

/// A click of a millisecond at 5 kHz.
fn click(rng: &mut ChaCha8Rng) -> Vec<f64> {
    let peak = 10f64.powf(rng.random_range(1.0..1.8));
    let pulse = |k: i32| {
        let x = f64::from(k - 10) / RATE_HZ;
        peak * (-0.5 * (x / 2.5e-4).powi(2)).exp() * (TAU * 5000.0 * x).cos()
    };
    (0..21).map(pulse).collect()
}

/// A snap that rings at 3 kHz, in a sea with a vessel of that root mean square.
fn snap(rate_hz: f64, rms: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let peak = rms * 10f64.powf(rng.random_range(1.0..1.6));
    let pulse = |k: usize| {
        let x = k as f64 / rate_hz;
        1.6 * peak * (1.0 - (-x / 3e-5).exp()) * (-x / 4e-4).exp() * (TAU * 3000.0 * x).cos()
    };
    (0..(0.003 * rate_hz) as usize).map(pulse).collect()
}

/// A whistle that sweeps up or down.
fn whistle(rate_hz: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let (rms, seconds) = (rng.random_range(1.0..3.0), rng.random_range(0.5..1.0));
    let ends = (rng.random_range(5e3..7e3), rng.random_range(12e3..15e3));
    let (from, to) = if rng.random() { ends } else { (ends.1, ends.0) };
    let tone = |k: usize| {
        let t = k as f64 / rate_hz;
        let swell = (PI * t / seconds).sin();
        rms * 2f64.sqrt() * swell * (TAU * (from * t + 0.5 * (to - from) * t * t / seconds)).sin()
    };
    (0..(seconds * rate_hz) as usize).map(tone).collect()
}

/// A stroke of a pile driver: noise below some kilohertz that dies away.
fn stroke(rate_hz: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let peak = rng.random_range(2.0..4.0);
    let keep = (-TAU * 2000.0 / rate_hz).exp();
    let mut last = 0.0;
    let noise = (0..(0.3 * rate_hz) as usize).map(|k| {
        let x: f64 = StandardNormal.sample(rng);
        last = keep * last + (1.0 - keep * keep).sqrt() * x;
        peak * (-(k as f64) / rate_hz / 0.05).exp() * last
    });
    noise.collect()
}

/// What a run gave.
#[derive(Clone, Default)]
struct Tally {
    seconds: f64,
    made: usize,
    /// Made and told one by one; told, and none.
    matched: usize,
    none: usize,
    /// Told, by themselves or in a number.
    counted: u64,
    directions: usize,
    held: Held,
    error_deg: Vec<f64>,
    bytes: u64,
    tracks: usize,
    bearings: usize,
    frames: i64,
    /// Those that are nowhere (at most: fewer were counted than made).
    missed: usize,
}

impl Tally {
    fn join(mut self, other: Self) -> Self {
        self.seconds += other.seconds;
        self.made += other.made;
        self.matched += other.matched;
        self.none += other.none;
        self.counted += other.counted;
        self.directions += other.directions;
        self.held.join(other.held);
        self.error_deg.extend(other.error_deg);
        self.bytes += other.bytes;
        self.tracks += other.tracks;
        self.bearings += other.bearings;
        self.frames += other.frames;
        self.missed += other.missed;
        self
    }

    /// What was said of what was made.
    fn of(said: &Said, made: &[Made], rate_hz: f64, seconds: f64) -> Self {
        let mut tally = Self { seconds, made: made.len(), ..Self::default() };
        let mut open: Vec<Made> = made.to_vec();
        for told in &said.transients {
            tally.counted += u64::from(told.count);
            tally.bytes += Encoder::default().frame(&Message::Transient(*told)).len() as u64;
            let t_s = told.index as f64 / rate_hz;
            match open.iter().position(|m| (m.t_s - t_s).abs() < SAME_S) {
                Some(n) => {
                    tally.matched += 1;
                    tally.directed(told, &open.swap_remove(n));
                }
                None => tally.none += 1,
            }
        }
        tally.missed = made.len().saturating_sub(tally.counted as usize - tally.none);
        tally.tracks = said.tracks.iter().map(|t| t.id).collect::<BTreeSet<_>>().len();
        tally.bearings = said.bearings.len();
        tally.frames = said.faults.iter().filter(|f| f.code == FaultCode::Impulses).map(|f| f.value).sum();
        tally
    }

    fn directed(&mut self, told: &Transient, made: &Made) {
        if !told.has_direction() {
            return;
        }
        let (da, de) =
            (wrap_pi(f64::from(told.azimuth) - made.from.0), f64::from(told.elevation) - made.from.1);
        let (va, ve, c) = (f64::from(told.var_azimuth), f64::from(told.var_elevation), f64::from(told.cov));
        let chi2 = (ve * da * da - 2.0 * c * da * de + va * de * de) / (va * ve - c * c);
        self.directions += 1;
        self.held.take(chi2 < ELLIPSE);
        self.error_deg.push((da * made.from.1.cos()).hypot(de).to_degrees());
    }

    /// The error that so many of 100 directions do not exceed, degrees.
    fn error_deg(&self, percent: usize) -> f64 {
        let mut sorted = self.error_deg.clone();
        sorted.sort_by(f64::total_cmp);
        sorted
            .get((sorted.len() * percent / 100).min(sorted.len().saturating_sub(1)))
            .copied()
            .unwrap_or(f64::NAN)
    }

    fn row(&self, report: &mut CsvReport, scene: [f64; 2]) {
        report.row(&[
            scene[0],
            scene[1],
            self.seconds,
            self.made as f64,
            self.matched as f64,
            self.counted as f64,
            self.none as f64,
            self.directions as f64,
            self.error_deg(50),
            self.error_deg(95),
            self.held.percent(),
            self.bytes as f64,
            self.tracks as f64,
            self.bearings as f64,
            self.frames as f64,
        ]);
    }

    /// The share of directions in their stated 95 %: of so many that it can be told.
    fn coverage(&self, options: &Options, scene: &str) {
        let name = format!("{scene}: directions in their 95 %, % of {}", self.held.of);
        // No nearer than so many can tell.
        let unsure = 196.0 * (0.95 * 0.05 / self.held.of as f64).sqrt();
        let bar = Bar::Within((95.0 - unsure).min(92.0), (95.0 + unsure).clamp(97.0, 100.0));
        options.figures.report(name, self.held.percent(), bar);
    }

    fn figures(&self, options: &Options, scene: &str) {
        let figures = &options.figures;
        figures.state(format!("{scene}: transients made"), self.made as f64);
        figures.at_most(format!("{scene}: of them neither told nor counted"), self.missed as f64, 0.0);
        figures.state(format!("{scene}: told one by one, at the right time"), self.matched as f64);
        let none_an_hour = self.none as f64 / self.seconds * 3600.0;
        figures.at_most(format!("{scene}: told that are none, an hour"), none_an_hour, 6.0);
        let directed = 100.0 * self.directions as f64 / self.matched as f64;
        figures.at_least(format!("{scene}: of those told with a direction, %"), directed, 90.0);
        figures.state(format!("{scene}: direction error, median, °"), self.error_deg(50));
        figures.state(format!("{scene}: direction error, 95 %, °"), self.error_deg(95));
        let bytes = self.bytes as f64 / self.seconds * 60.0;
        figures.state(format!("{scene}: telemetry of transients, bytes a minute"), bytes);
    }
}

/// Explosions and clicks; one recorder hears several records one after the other.
fn loud(config: &StationConfig, sounder: &Sounder, seed: u64) -> Result<Tally> {
    let geometry = config.geometry()?;
    let mut made = Vec::new();
    let records = (0..RECORDS).map(|n| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(17_000_023) + n);
        let frames = sounder.record(rng.random(), NOISE_CODES, None);
        let mut sea = Sea { geometry: &geometry, rate_hz: RATE_HZ, frames, made: Vec::new() };
        let last_s = sounder.seconds() - 10.0;
        let mut t_s = 3.0;
        while t_s < last_s {
            let sound = explosion(&mut rng);
            sea.add(t_s + rng.random::<f64>(), &sound, &mut rng);
            for n in 0..rng.random_range(4u32..12) {
                let sound = click(&mut rng);
                sea.add(t_s + 3.0 + 0.5 * f64::from(n) + 0.1 * rng.random::<f64>(), &sound, &mut rng);
            }
            t_s += rng.random_range(15.0..25.0);
        }
        let begun = n as f64 * sounder.seconds();
        made.extend(sea.made.iter().map(|m| Made { t_s: begun + m.t_s, ..*m }));
        sea.frames
    });
    let said = hear(config, records.flatten())?;
    Ok(Tally::of(&said, &made, RATE_HZ, RECORDS as f64 * sounder.seconds()))
}

/// Whistles of a herd, or strokes of a pile driver, and no vessel.
fn called(config: &StationConfig, sounder: &Sounder, seed: u64, whistles: bool) -> Result<Tally> {
    let geometry = config.geometry()?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let frames = sounder.record(rng.random(), NOISE_CODES, None);
    let mut sea = Sea { geometry: &geometry, rate_hz: config.rate_hz, frames, made: Vec::new() };
    let (azimuth, elevation) = (rng.random_range(0.0..TAU), rng.random_range(0.0..0.3));
    let mut t_s = 0.5;
    while t_s < sounder.seconds() - 1.5 {
        let turned = if whistles { 0.02 * t_s } else { 0.0 };
        let sound =
            if whistles { whistle(config.rate_hz, &mut rng) } else { stroke(config.rate_hz, &mut rng) };
        sea.add_from(t_s, &sound, ((azimuth + turned) % TAU, elevation), 400.0);
        t_s += rng.random_range(1.0..2.0);
    }
    let said = hear(config, sea.frames.into_iter())?;
    Ok(Tally::of(&said, &sea.made, config.rate_hz, sounder.seconds()))
}

/// Snaps beside a vessel.
fn snapped(
    config: &StationConfig,
    sounder: &Sounder,
    seed: u64,
    snr_db: f64,
    a_second: f64,
) -> Result<Tally> {
    let geometry = config.geometry()?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let vessel = exact_arrivals(&geometry, rng.random_range(0.0..TAU), rng.random_range(0.0..0.7), 500.0);
    let frames = sounder.record(rng.random(), NOISE_CODES, Some((snr_db, vessel)));
    let mut sea = Sea { geometry: &geometry, rate_hz: config.rate_hz, frames, made: Vec::new() };
    let rms = (1.0 + 10f64.powf(snr_db / 10.0)).sqrt();
    let mut t_s = 0.5;
    while t_s < sounder.seconds() - 0.1 {
        let sound = snap(config.rate_hz, rms, &mut rng);
        sea.add(t_s, &sound, &mut rng);
        t_s += rng.random_range(0.5..1.5) / a_second;
    }
    let said = hear(config, sea.frames.into_iter())?;
    Ok(Tally::of(&said, &sea.made, config.rate_hz, sounder.seconds()))
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(4) as u64;
    let config = station(RATE_HZ, 168.0, |_| {});
    let mut report = CsvReport::new(
        "sea_transients",
        "snr_db,a_second,seconds,made,told,counted,none,directions,median_deg,p95_deg,held_percent,bytes,tracks,bearings,\
         frames_kept_out",
    );
    let bar = progress::bar(runs * (3 + (SNR_DB.len() * A_SECOND.len()) as u64), "runs");
    let join = |tallies: Vec<Tally>| tallies.into_iter().fold(Tally::default(), Tally::join);
    let each = |n: u64| options.seed.wrapping_mul(1_000_003) + n;
    let sounder = Sounder::new(&config.geometry()?, RATE_HZ, RECORD, AmbientField::Independent);
    let made = (0..runs).into_par_iter().map(|n| {
        bar.inc(1);
        loud(&config, &sounder, each(n))
    });
    let tally = join(made.collect::<Result<Vec<_>>>()?);
    tally.row(&mut report, [f64::NEG_INFINITY, 0.0]);
    options.figures.at_most("vessel tracks of explosions and clicks", tally.tracks as f64, 1.0);
    options.figures.state("minutes of explosions and clicks", tally.seconds / 60.0);
    tally.figures(options, "explosions and clicks");
    tally.coverage(options, "explosions and clicks");
    options.figures.state("explosions and clicks: bearings", tally.bearings as f64);
    options.figures.state("explosions and clicks: frames kept out of bearings", tally.frames as f64);

    let config = station(64_000.0, 168.0, |_| {});
    let sounder = Sounder::new(&config.geometry()?, config.rate_hz, SNAPPED, AmbientField::Independent);
    let mut snaps = Tally::default();
    for snr_db in SNR_DB {
        for a_second in A_SECOND {
            let made = (0..runs).into_par_iter().map(|n| {
                bar.inc(1);
                snapped(&config, &sounder, each(n).wrapping_mul(31) + a_second as u64, snr_db, a_second)
            });
            let tally = join(made.collect::<Result<Vec<_>>>()?);
            tally.row(&mut report, [snr_db, a_second]);
            tally.figures(options, &format!("{a_second} snaps a second, vessel at {snr_db} dB"));
            snaps = snaps.join(tally);
        }
    }
    snaps.coverage(options, "snaps");
    for (what, whistles) in [("whistles", true), ("strokes", false)] {
        let made = (0..runs).into_par_iter().map(|n| {
            bar.inc(1);
            called(&config, &sounder, each(n).wrapping_mul(37) + 5, whistles)
        });
        let tally = join(made.collect::<Result<Vec<_>>>()?);
        options.figures.at_most(format!("vessel tracks of {what}"), tally.tracks as f64, 0.0);
        options.figures.state(format!("{what}, of {}: bearings", tally.made), tally.bearings as f64);
    }
    bar.finish_and_clear();
    report.finish(options)
}
