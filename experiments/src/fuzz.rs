//! Hostile input in great numbers: streams, files and texts that were right once, mutated at random from a seed.
//!
//! A panic is caught and counted; so is an input that takes longer than [`HANG`]; one that does not come to an end
//! ([`STUCK`]) ends the run. What fails is kept as a file. What a decoder takes for right although nobody wrote it is a
//! false frame: its checksum of 32 bits lets one in 2³² pass.

use super::fuzz_targets::{Seeds, TARGETS, Target};
use super::report::CsvReport;
use super::{Experiment, Options, atomic, progress};
use anyhow::{Context, Result, bail};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_host::interrupt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
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
/// One that takes so long is not waited for.
const STUCK: Duration = Duration::from_secs(60);
/// How often it is looked at what is busy.
const LOOK: Duration = Duration::from_secs(1);
/// Names the one target that is tried, by its file (`cargo xtask fuzz --target` sets it).
pub const ONLY: &str = "SEABEARING_FUZZ_TARGET";
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
    let folder = options.out.join("fuzz");
    let only = std::env::var(ONLY).ok();
    let chosen = |target: &Target| only.as_ref().is_none_or(|file| target.file == file);
    if !TARGETS.iter().any(chosen) {
        bail!("no target `{}`; there are: {}", only.unwrap_or_default(), TARGETS.map(|t| t.file).join(", "));
    }
    let mut table = CsvReport::new("fuzz", "target,inputs,bytes,seconds,panics,false_frames,hangs,taken");
    for (n, target) in (0u32..).zip(&TARGETS).filter(|(_, target)| chosen(target)) {
        // A panic is counted; what it says would fill the screen.
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(|_| {}));
        let ran = all(target, inputs, options.seed, &folder);
        std::panic::set_hook(hook);
        let (outcome, took) = ran?;
        let name = target.name;
        figures.at_most(format!("{name}: panics, of {} inputs", outcome.inputs), outcome.panics as f64, 0.0);
        figures.at_most(format!("{name}: inputs that take over 5 s"), outcome.hangs as f64, 0.0);
        figures.at_most(format!("{name}: false frames"), outcome.false_frames as f64, 0.0);
        // Else the mutations leave nothing to be taken, and the rest would prove little.
        let share = outcome.taken as f64 / outcome.inputs.max(1) as f64;
        figures.at_least(format!("{name}: share of inputs of which something is taken"), share, 0.05);
        for (n, input) in outcome.failing.iter().enumerate() {
            keep(&folder, target, n, input)?;
        }
        let counts = [outcome.panics, outcome.false_frames, outcome.hangs, outcome.taken].map(|c| c as f64);
        let [panics, false_frames, hangs, taken] = counts;
        let (inputs, bytes) = (outcome.inputs as f64, outcome.bytes as f64);
        table.row(&[f64::from(n), inputs, bytes, took.as_secs_f64(), panics, false_frames, hangs, taken]);
    }
    table.finish(options)
}

/// All inputs of a target, a share of them where one costs much.
fn all(target: &Target, inputs: usize, seed: u64, folder: &Path) -> Result<(Outcome, Duration)> {
    let begun = Instant::now();
    let seeds = Seeds::of(target)?;
    let inputs = (inputs / target.cost).max(1);
    let batch = BATCH.min(inputs.div_ceil(4));
    let bar = progress::bar(inputs as u64, target.name);
    let busy = Busy::of(rayon::current_num_threads());
    let (over, ended) = channel();
    let outcome = std::thread::scope(|scope| {
        let watched = &busy;
        scope.spawn(move || watched.watch(target, folder, &ended));
        let _until_all_is_done = over;
        (0..inputs.div_ceil(batch))
            .into_par_iter()
            .map(|n| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (n as u64) << 20);
                let (mut outcome, count) = (Outcome::default(), batch.min(inputs - n * batch));
                (0..count).for_each(|_| one(target, &seeds, &mut rng, &busy, &mut outcome));
                bar.inc(count as u64);
                outcome
            })
            .reduce(Outcome::default, Outcome::and)
    });
    bar.finish_and_clear();
    Ok((outcome, begun.elapsed()))
}

impl Outcome {
    fn and(mut self, mut other: Self) -> Self {
        self.inputs += other.inputs;
        self.bytes += other.bytes;
        self.panics += other.panics;
        self.hangs += other.hangs;
        self.false_frames += other.false_frames;
        self.taken += other.taken;
        self.failing.append(&mut other.failing);
        self.failing.truncate(KEPT);
        self
    }
}

/// What each thread is busy with since when; empty where it is not.
struct Busy(Vec<Mutex<(Option<Instant>, Vec<u8>)>>);

impl Busy {
    fn of(threads: usize) -> Self {
        Self((0..threads).map(|_| Mutex::default()).collect())
    }

    /// This thread begins with an input.
    fn begin(&self, input: &[u8]) {
        if let Some(slot) = self.mine() {
            let (since, kept) = &mut *locked(slot);
            kept.clear();
            kept.extend_from_slice(input);
            *since = Some(Instant::now());
        }
    }

    /// This thread has done with it, after so long.
    fn end(&self) -> Duration {
        let since = self.mine().and_then(|slot| locked(slot).0.take());
        since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    fn mine(&self) -> Option<&Mutex<(Option<Instant>, Vec<u8>)>> {
        self.0.get(rayon::current_thread_index().unwrap_or(0))
    }

    /// Ends the program where an input does not come to an end.
    fn watch(&self, target: &Target, folder: &Path, ended: &Receiver<()>) {
        while ended.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
            for slot in &self.0 {
                let (since, input) = &*locked(slot);
                if since.is_some_and(|since| since.elapsed() > STUCK) {
                    eprintln!("seabearing: {}: an input takes more than {} s", target.name, STUCK.as_secs());
                    if let Err(e) = keep(folder, target, KEPT, input) {
                        eprintln!("seabearing: {e:#}");
                    }
                    interrupt::leave(1);
                }
            }
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn one(target: &Target, seeds: &Seeds, rng: &mut ChaCha8Rng, busy: &Busy, outcome: &mut Outcome) {
    let mut input = seeds.inputs[rng.random_range(0..seeds.inputs.len())].clone();
    let other = &seeds.inputs[rng.random_range(0..seeds.inputs.len())];
    for _ in 0..rng.random_range(0..6) {
        mutate(&mut input, other, rng);
    }
    busy.begin(&input);
    let ran = catch_unwind(AssertUnwindSafe(|| (target.run)(&input, seeds)));
    let late = busy.end() > HANG;
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

/// Keeps a failing input as a file.
fn keep(folder: &Path, target: &Target, n: usize, input: &[u8]) -> Result<()> {
    let path = folder.join(format!("{}-{n}.bin", target.file));
    atomic::write(&path, input).context("a failing input")?;
    println!("{}: a failing input is kept as {}", target.name, path.display());
    Ok(())
}
