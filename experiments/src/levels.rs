//! Levels of known tones and noise, the shape of decidecades, and what measuring levels costs.

use super::{Experiment, Options};
use anyhow::Result;
use cpu_time::ThreadTime;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use seabearing_core::block::{Block, Frame};
use seabearing_core::levels::bands::{class_1_db, decidecade_hz, edge_hz, of_decidecade};
use seabearing_core::levels::{self, EMPTY_ROW, Plan, ROWS, Report, Row, Scratch, State};
use seabearing_core::recorder::ArrayRecorder;
use seabearing_core::run::Application;
use seabearing_host::levels::Meter;
use seabearing_host::recording::{Asked, Recording, Span};
use seabearing_host::replay::with_levels;
use seabearing_host::station::Station;
use std::f64::consts::TAU;
use std::path::Path;
use std::time::Instant;

pub const EXPERIMENT: Experiment = Experiment {
    name: "levels",
    about: "levels of known tones and noise at six rates, class 1 of IEC 61260-1, cost beside the array's chain",
    run,
};

/// Full scale, codes.
const FULL_SCALE: f64 = 8_388_608.0;

/// Rates, Hz, and seconds measured.
const RATES: [(f64, f64); 6] =
    [(50.0, 1800.0), (100.0, 1800.0), (8000.0, 60.0), (16_000.0, 60.0), (64_000.0, 60.0), (96_000.0, 60.0)];

fn run(o: &Options) -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(o.seed);
    for (rate_hz, seconds) in RATES {
        let [tone, noise, octave] = known(rate_hz, seconds, &mut random)?;
        let at = if rate_hz < 1000.0 { format!("{rate_hz} Hz") } else { format!("{} kHz", rate_hz / 1e3) };
        o.figures.at_most(format!("tones of known level at {at}: greatest error, dB"), tone, 0.1);
        o.figures.at_most(format!("white noise of known level at {at}: error, dB"), noise, 0.1);
        o.figures.at_most(format!("twice the pressure at {at}: error of 6.02 dB, dB"), octave, 0.01);
    }
    let (margin, tried) = class_1()?;
    o.figures.state("tones held against the mask of each decidecade", tried as f64);
    o.figures.at_least("class 1 of IEC 61260: least distance from the mask, dB", margin, 0.0);
    let minute = minute(&mut random)?;
    let (chain_s, levels_s) = cost(&minute)?;
    o.figures
        .state("array's chain, one minute of four channels at 64 kHz: ms of processor time", 1e3 * chain_s);
    o.figures.state("levels of the same minute: ms of processor time", 1e3 * levels_s);
    o.figures.state("processor time with levels over that without", 1.0 + levels_s / chain_s);
    let name = "time of a clock with levels over that without, two processors";
    if std::thread::available_parallelism().is_ok_and(|n| n.get() >= 2) {
        o.figures.at_most(name, slower(&minute)?, 1.05);
    } else {
        o.figures.state(name, None);
    }
    Ok(())
}

fn db(power: f64) -> f64 {
    10.0 * power.log10()
}

/// The first interval's report.
fn report(plan: &Plan, frames: &[Frame], counts: &mut [Row]) -> Option<Report> {
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut out = None;
    let mut sink = |report: &Report, _: &[Row]| {
        out.get_or_insert_with(|| report.clone());
    };
    for (number, part) in frames.chunks(16_384).enumerate() {
        let block = Block { first_index: number as u64 * 16_384, frames: part };
        levels::push(plan, &mut state, &mut scratch, counts, block, &mut sink);
    }
    levels::finish(plan, &mut state, &mut scratch, counts, &mut sink);
    out
}

fn sum(plan: &Plan, report: &Report, cells: std::ops::Range<i32>, channel: usize) -> f64 {
    let powers = cells.filter_map(|cell| report.mean_square.get(plan.place(cell)?));
    powers.map(|p| f64::from(p[channel])).sum()
}

/// Greatest error of tones in their decidecades and in the broad band, of noise in the broad band, and of a doubling; dB.
fn known(rate_hz: f64, seconds: f64, random: &mut ChaCha8Rng) -> Result<[f64; 3]> {
    let plan = Plan::new(rate_hz, FULL_SCALE as i32, seconds)?;
    let normal = Normal::new(0.0, 1e5)?;
    let numbers = plan.decidecades();
    let (low, high) = (numbers.start + 1, numbers.end - 2);
    let tones = [low, (low + high) / 2];
    let mut square = 0.0;
    let n = (rate_hz * seconds) as u64;
    let frames: Vec<Frame> = (0..n)
        .map(|n| {
            let tone = |number: i32| 1e6 * (TAU * (decidecade_hz(number) * n as f64 / rate_hz).fract()).sin();
            let white: f64 = normal.sample(random);
            let white = white.round();
            square += white * white;
            [tone(tones[0]) as i32, tone(tones[1]) as i32, white as i32, 2 * white as i32]
        })
        .collect();
    let Some(report) = report(&plan, &frames, &mut []) else { anyhow::bail!("no report at {rate_hz} Hz") };
    let all = |channel| sum(&plan, &report, plan.cells(), channel);
    let tone_square = 0.5 * (1e6 / FULL_SCALE).powi(2);
    let error = tones.iter().enumerate().flat_map(|(channel, number)| {
        [sum(&plan, &report, of_decidecade(*number), channel), all(channel)]
            .map(|p| db(p / tone_square).abs())
    });
    let cells = plan.cells();
    let share = (edge_hz(cells.end) - edge_hz(cells.start)) / (rate_hz / 2.0);
    let noise = db(all(2) / (share * square / n as f64 / FULL_SCALE.powi(2))).abs();
    Ok([error.fold(0.0, f64::max), noise, (db(all(3) / all(2)) - 20.0 * 2f64.log10()).abs()])
}

/// Least distance of any decidecade's attenuation of any tone from the limits of class 1, dB, and how many were tried.
fn class_1() -> Result<(f64, usize)> {
    let rate_hz = 8000.0;
    // Long enough for three stages: bands of all of them and those at which stages meet.
    let plan = Plan::new(rate_hz, FULL_SCALE as i32, 21.0)?;
    // Eighty tones a decade: every band's edges and middle among them.
    let tones: Vec<f64> =
        (-40..288).map(|k| 10f64.powf(f64::from(k) / 80.0)).filter(|f| *f < 0.499 * rate_hz).collect();
    let amplitude = 4e6;
    let tone_db = db(0.5 * (amplitude / FULL_SCALE).powi(2));
    let (mut margin, mut tried) = (f64::INFINITY, 0);
    for four in tones.chunks(4) {
        let f = |c: usize| four.get(c).or(four.last()).copied().unwrap_or(1.0);
        let frames: Vec<Frame> = (0..168_000)
            .map(|n| {
                let tone = |c| amplitude * (TAU * (f(c) * f64::from(n) / rate_hz).fract() + 0.3).sin();
                std::array::from_fn(|c| tone(c).round() as i32)
            })
            .collect();
        let Some(report) = report(&plan, &frames, &mut []) else { anyhow::bail!("no report") };
        for (c, tone_hz) in four.iter().enumerate() {
            for number in plan.decidecades() {
                let attenuation = tone_db - db(sum(&plan, &report, of_decidecade(number), c));
                let ratio = tone_hz / decidecade_hz(number);
                // On an edge the limits jump: those within hold.
                let (least, greatest) = class_1_db(ratio.powf(1.0 - 1e-9));
                margin = margin.min(attenuation - least).min(greatest - attenuation);
                tried += 1;
            }
        }
    }
    Ok((margin, tried))
}

/// Samples a second of the minute whose cost is measured.
const FAST_HZ: f64 = 64_000.0;

/// A minute of four channels of noise.
fn minute(random: &mut ChaCha8Rng) -> Result<Vec<Frame>> {
    let normal = Normal::new(0.0, 1e5)?;
    let second: Vec<Frame> = (0..64_000)
        .map(|_| std::array::from_fn(|_| Distribution::<f64>::sample(&normal, random) as i32))
        .collect();
    Ok(second.iter().cycle().take(60 * 64_000).copied().collect())
}

const STATION: &str = "[station]\nid = 1\nkind = \"array\"\n[sampling]\nrate_hz = 64000\n[array]\nhydrophones_m = \
    [[0.0,1.07,-0.38],[0.93,-0.53,-0.38],[-0.93,-0.53,-0.38],[0.0,0.0,1.13]]\n";

/// Processor time, s, of the array's chain and of levels for a minute.
fn cost(minute: &[Frame]) -> Result<(f64, f64)> {
    let station = Station::parse(STATION, "station", Path::new("."))?;
    let mut recorder = Box::new(ArrayRecorder::new());
    recorder.configure(&station.config)?;
    let plan = Plan::new(FAST_HZ, station.config.full_scale, 60.0)?;
    let mut counts = vec![EMPTY_ROW; ROWS];
    let begun = ThreadTime::now();
    for (number, frames) in minute.chunks(16_384).enumerate() {
        recorder.push(Block { first_index: number as u64 * 16_384, frames }, &mut |_| {});
    }
    let chain_s = begun.elapsed().as_secs_f64();
    let begun = ThreadTime::now();
    report(&plan, minute, &mut counts);
    Ok((chain_s, begun.elapsed().as_secs_f64()))
}

/// How much longer a recording's processing takes with levels, as `process` does it: the shortest of several runs of each,
/// which take turns, so that what else the machine does weighs on both.
fn slower(minute: &[Frame]) -> Result<f64> {
    const RUNS: usize = 9;
    let station = Station::parse(STATION, "station", Path::new("."))?;
    let recording = Recording::of_frames(minute.to_vec(), FAST_HZ, &station, &Asked::default())?;
    let took = |levels: bool| -> Result<f64> {
        let mut meter = levels.then(|| Meter::new(&station, 60.0, false)).transpose()?;
        let mut source = recording.source(Span::default())?;
        let begun = Instant::now();
        with_levels(&station.config, None, &mut *source, meter.as_mut(), |_| Ok(()))?;
        Ok(begun.elapsed().as_secs_f64())
    };
    let (mut without, mut with) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..RUNS {
        without = without.min(took(false)?);
        with = with.min(took(true)?);
    }
    Ok(with / without)
}
