//! Hostile input in great numbers: streams, files and texts that were right once, mutated at random from a seed.
//!
//! A panic is caught and counted; so is an input that takes longer than [`HANG`]. What fails is kept as a file. What a
//! decoder takes for right although nobody wrote it is a false frame: its checksum of 32 bits lets one in 2³² pass.

use super::fuzz_targets::{TARGETS, Target};
use super::report::CsvReport;
use super::{Experiment, Options};
use anyhow::{Context, Result};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

/// `seabearing reproduce fuzz`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "fuzz",
    about: "mutated streams, sample lines, station files and stores: panics, false frames, hangs; --runs: inputs a target",
    run,
};

/// Inputs of the fastest target where no number is given.
const INPUTS: usize = 20_000;
/// Inputs of one source of random numbers.
const BATCH: usize = 500;
/// An input that takes so long hangs.
const HANG: Duration = Duration::from_secs(5);
/// Failing inputs of a target that are kept.
const KEPT: usize = 10;

/// What came of a target's inputs.
#[derive(Default)]
struct Outcome {
    inputs: u64,
    bytes: u64,
    panics: u64,
    hangs: u64,
    false_frames: u64,
    /// Inputs of which something came through.
    taken: u64,
    failing: Vec<Vec<u8>>,
}

fn run(options: &Options) -> Result<()> {
    let inputs = options.runs.unwrap_or(INPUTS);
    let figures = &options.figures;
    let mut table = CsvReport::new("fuzz", "target,inputs,bytes,seconds,panics,false_frames,hangs,taken");
    // A panic is counted; what it says would fill the screen.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let outcomes: Result<Vec<_>> = TARGETS.iter().map(|target| all(target, inputs, options.seed)).collect();
    std::panic::set_hook(hook);
    for (n, (target, (outcome, took))) in (0u32..).zip(TARGETS.iter().zip(outcomes?)) {
        let name = target.name;
        figures.at_most(format!("{name}: panics, of {} inputs", outcome.inputs), outcome.panics as f64, 0.0);
        figures.at_most(format!("{name}: inputs that take over 5 s"), outcome.hangs as f64, 0.0);
        figures.at_most(format!("{name}: false frames"), outcome.false_frames as f64, 0.0);
        // Else the mutations leave nothing to be taken, and the rest would prove little.
        let share = outcome.taken as f64 / outcome.inputs.max(1) as f64;
        figures.at_least(format!("{name}: share of inputs of which something is taken"), share, 0.05);
        keep(&options.out.join("fuzz"), name, &outcome.failing)?;
        let counts = [outcome.panics, outcome.false_frames, outcome.hangs, outcome.taken].map(|c| c as f64);
        let [panics, false_frames, hangs, taken] = counts;
        let (inputs, bytes) = (outcome.inputs as f64, outcome.bytes as f64);
        table.row(&[f64::from(n), inputs, bytes, took.as_secs_f64(), panics, false_frames, hangs, taken]);
    }
    table.finish(options)
}

/// All inputs of a target, a share of them where one costs much.
fn all(target: &Target, inputs: usize, seed: u64) -> Result<(Outcome, Duration)> {
    let begun = Instant::now();
    let seeds = (target.seeds)()?;
    let inputs = (inputs / target.cost).max(1);
    let batch = BATCH.min(inputs.div_ceil(4));
    let outcome = (0..inputs.div_ceil(batch))
        .into_par_iter()
        .map(|n| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (n as u64) << 20);
            let mut outcome = Outcome::default();
            for _ in 0..batch.min(inputs - n * batch) {
                one(target, &seeds, &mut rng, &mut outcome);
            }
            outcome
        })
        .reduce(Outcome::default, |mut a, mut b| {
            a.inputs += b.inputs;
            a.bytes += b.bytes;
            a.panics += b.panics;
            a.hangs += b.hangs;
            a.false_frames += b.false_frames;
            a.taken += b.taken;
            a.failing.append(&mut b.failing);
            a.failing.truncate(KEPT);
            a
        });
    Ok((outcome, begun.elapsed()))
}

fn one(target: &Target, seeds: &[Vec<u8>], rng: &mut ChaCha8Rng, outcome: &mut Outcome) {
    let mut input = seeds[rng.random_range(0..seeds.len())].clone();
    let other = &seeds[rng.random_range(0..seeds.len())];
    for _ in 0..rng.random_range(0..6) {
        mutate(&mut input, other, rng);
    }
    let begun = Instant::now();
    let ran = catch_unwind(AssertUnwindSafe(|| (target.run)(&input, seeds)));
    let late = begun.elapsed() > HANG;
    outcome.inputs += 1;
    outcome.bytes += input.len() as u64;
    outcome.hangs += u64::from(late);
    let wrong = match ran {
        Ok(came) => {
            outcome.false_frames += came.false_frames;
            outcome.taken += u64::from(came.taken);
            came.false_frames > 0
        }
        Err(_) => {
            outcome.panics += 1;
            true
        }
    };
    if (wrong || late) && outcome.failing.len() < KEPT {
        outcome.failing.push(input);
    }
}

/// One change: bits, bytes, stretches lost, doubled, moved, taken from elsewhere, cut off.
fn mutate(input: &mut Vec<u8>, other: &[u8], rng: &mut ChaCha8Rng) {
    if input.is_empty() {
        input.push(rng.random());
    }
    let length = input.len();
    let at = rng.random_range(0..length);
    let end = (at + 1 + rng.random_range(0..=(length - at - 1).min(40))).min(length);
    match rng.random_range(0..10) {
        0 | 1 => input[at] ^= 1 << rng.random_range(0..8),
        2 => input[at] = rng.random(),
        3 => input[at] = [0, 1, 0x7f, 0x80, 0xff, b'-', b'9', b'"', b'\n', b'='][rng.random_range(0..10)],
        4 => drop(input.drain(at..end)),
        5 => {
            let stretch = input[at..end].to_vec();
            let to = rng.random_range(0..=length);
            input.splice(to..to, stretch);
        }
        6 => {
            let stretch: Vec<u8> = input.drain(at..end).collect();
            let to = rng.random_range(0..=input.len());
            input.splice(to..to, stretch);
        }
        7 if !other.is_empty() => {
            let from = rng.random_range(0..other.len());
            let to = (from + rng.random_range(1..80)).min(other.len());
            input.splice(at..at, other[from..to].iter().copied());
        }
        8 => {
            let mut noise = vec![0; rng.random_range(1..20)];
            rng.fill_bytes(&mut noise);
            input.splice(at..at, noise);
        }
        _ => input.truncate(at + 1),
    }
}

fn keep(folder: &Path, name: &str, failing: &[Vec<u8>]) -> Result<()> {
    for (n, input) in failing.iter().enumerate() {
        let path = folder.join(format!("{name}-{n}.bin"));
        super::atomic::write(&path, input).context("a failing input")?;
        println!("{name}: a failing input is kept as {}", path.display());
    }
    Ok(())
}
