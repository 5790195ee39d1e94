//! The base station's store when the power fails: of what was written and not yet synchronised, any sectors may have
//! reached the disk, in any order, one of them torn.
//!
//! The store's two files are looked at whenever it has synchronised and after every step. What lies between is mixed,
//! sector by sector, as SQLite's order of writing and synchronising allows: while the database's own file is as it was, any
//! part of the log; once a checkpoint has begun to change it, the log is whole, and any part of the database's file.

use super::base_process::hello;
use super::base_station::{bearing, track};
use super::report::CsvReport;
use super::{Experiment, Options};
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_base::store::{Entry, Event, Store, Wanted, check, read};
use seabearing_base::{Base, Beginning};
use seabearing_core::wire::Encoder;
use seabearing_host::beside::Folder;
use std::path::Path;
use std::time::Instant;

/// `seabearing reproduce base-power`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "base-power",
    about: "the power fails while a store is written, 40 times or as --runs says: torn and unordered writes",
    run,
};

/// Bytes that a disk writes whole or not at all, but for the one under its head.
const SECTOR: usize = 512;
/// Steps of work of one store, and between two failures; those during checkpoints come to them.
const ROUND: usize = 120;
const STEPS: usize = 12;
/// Frames that come together at most.
const TOGETHER: usize = 60;

/// The database's file and its log.
type Files = [Vec<u8>; 2];
const NAMES: [&str; 2] = ["store.sqlite", "store.sqlite-wal"];

fn files(folder: &Path) -> Files {
    // A log that is not there yet is an empty one.
    NAMES.map(|name| std::fs::read(folder.join(name)).unwrap_or_default())
}

/// What came of it.
#[derive(Default)]
struct Outcome {
    failures: u64,
    during_checkpoints: u64,
    torn: u64,
    unopened: u64,
    unsound: u64,
    missing: u64,
    twice: u64,
    slowest_s: f64,
}

fn run(options: &Options) -> Result<()> {
    let wanted = options.runs.unwrap_or(40) as u64;
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut outcome = Outcome::default();
    while outcome.failures < wanted {
        round(wanted, &mut rng, &mut outcome)?;
    }
    let figures = &options.figures;
    let Outcome { failures, during_checkpoints, torn, .. } = outcome;
    figures.at_most(
        format!("failures of power: {failures}; stores that do not open"),
        outcome.unopened as f64,
        0.0,
    );
    figures.at_most("stores in which a check finds faults", outcome.unsound as f64, 0.0);
    figures.at_most("acknowledged records missing", outcome.missing as f64, 0.0);
    figures.at_most("records twice, or that nobody wrote", outcome.twice as f64, 0.0);
    figures.at_least("failures of which a sector was torn", torn as f64, failures as f64 / 4.0);
    figures.at_least("failures during a checkpoint", during_checkpoints as f64, failures as f64 / 50.0);
    figures.state("longest start after one, s", outcome.slowest_s);
    let mut table = CsvReport::new("base-power", "failures,checkpoints,torn,unopened,unsound,missing,twice");
    let Outcome { unopened, unsound, missing, twice, .. } = outcome;
    table.row(&[failures, during_checkpoints, torn, unopened, unsound, missing, twice].map(|n| n as f64));
    table.finish(options)
}

/// The work of a store from its beginning on, and what the disk would hold if the power failed now and then.
fn round(wanted: u64, rng: &mut ChaCha8Rng, outcome: &mut Outcome) -> Result<()> {
    let folder = Folder::new()?;
    let mut base = Base::new(None);
    let mut store = Store::open(folder.path(), &mut base)?;
    let mut encoder = Encoder::default();
    let (mut said, mut acknowledged) = (0u64, 0u64);
    let mut durable = files(folder.path());
    let mut events = vec![Event::Began(Beginning { line: "file:power".into(), ..Beginning::default() })];
    for step in 0..ROUND {
        let mut bytes = Vec::new();
        for _ in 0..rng.random_range(1..=TOGETHER) {
            let message = match said {
                0 => hello(1, 1000.0),
                n if n % 40 == 39 => track((n / 400) as u16, n * 100, false),
                n => bearing(n * 100),
            };
            bytes.extend_from_slice(encoder.frame(&message));
            said += 1;
        }
        events.push(Event::Bytes(bytes));
        let received_us = Some(1_790_000_000_000_000 + step as i64);
        let entry = |event| Entry { stream: 1, received_us, event };
        let batch: Vec<Entry> = events.drain(..).map(entry).collect();
        // Between the bytes and the records, or after both but before that is known.
        let early = rng.random_range(0..2) == 0;
        let due = step % STEPS == 0;
        store.keep(&batch)?;
        let kept = files(folder.path());
        let checkpoint = kept[0] != durable[0];
        if (checkpoint || early && due) && outcome.failures < wanted {
            fail(&durable, &kept, [acknowledged, said], rng, outcome)?;
        }
        if checkpoint {
            // A checkpoint: it ends with everything on the disk.
            durable = kept;
        }
        let mut rows = Vec::new();
        batch.iter().for_each(|entry| entry.tell(&mut base, 0, None, &mut rows));
        store.derive(&mut base, &rows)?;
        let derived = files(folder.path());
        if (derived[0] != durable[0] || !early && due) && outcome.failures < wanted {
            fail(&durable, &derived, [acknowledged, said], rng, outcome)?;
        }
        (durable, acknowledged) = (derived, said);
    }
    Ok(())
}

/// The power fails somewhere between two states; `[acknowledged, said]` records.
fn fail(
    durable: &Files,
    now: &Files,
    [acknowledged, said]: [u64; 2],
    rng: &mut ChaCha8Rng,
    outcome: &mut Outcome,
) -> Result<()> {
    let checkpoint = durable[0] != now[0];
    let mut image = if checkpoint { [durable[0].clone(), now[1].clone()] } else { durable.clone() };
    let at = usize::from(!checkpoint);
    let (mixed, torn) = mix(&durable[at], &now[at], rng);
    image[at] = mixed;
    outcome.failures += 1;
    outcome.during_checkpoints += u64::from(checkpoint);
    outcome.torn += u64::from(torn);
    let folder = Folder::new()?;
    for (name, bytes) in NAMES.iter().zip(&image) {
        std::fs::write(folder.path().join(name), bytes).context("the disk's image")?;
    }
    let begun = Instant::now();
    let mut base = Base::new(None);
    let opened = Store::open(folder.path(), &mut base).map(drop);
    outcome.slowest_s = outcome.slowest_s.max(begun.elapsed().as_secs_f64());
    if opened.is_err() {
        outcome.unopened += 1;
        return Ok(());
    }
    outcome.unsound += u64::from(check(folder.path()).map_or(true, |found| !found.faults.is_empty()));
    let mut found = vec![0u64; said as usize];
    let mut strange = 0;
    read(folder.path(), &Wanted::default(), |record| {
        match record["sequence"].as_u64().and_then(|n| place(n, &record)).and_then(|n| found.get_mut(n)) {
            Some(count) => *count += 1,
            None => strange += 1,
        }
    })?;
    outcome.missing += found.iter().take(acknowledged as usize).filter(|n| **n == 0).count() as u64;
    outcome.twice += strange + found.iter().map(|n| n.saturating_sub(1)).sum::<u64>();
    Ok(())
}

/// Which of all records this is: the number of its frame wraps, its time does not.
fn place(sequence: u64, record: &serde_json::Value) -> Option<usize> {
    let n = record["t_s"].as_f64().map_or(0, |t_s| (t_s * 10.0).round() as u64);
    (n & 0xffff == sequence).then_some(n as usize)
}

/// What may be on the disk of a file that was `old` and is being made `new`; whether a sector is torn.
fn mix(old: &[u8], new: &[u8], rng: &mut ChaCha8Rng) -> (Vec<u8>, bool) {
    let share: f64 = [0.02, 0.3, 0.7, 0.98][rng.random_range(0..4)];
    let mut out = old.to_vec();
    out.resize(old.len().max(new.len()), 0);
    let changed: Vec<usize> = (0..new.len().div_ceil(SECTOR))
        .filter(|n| {
            let range = n * SECTOR..((n + 1) * SECTOR).min(new.len());
            old.get(range.clone()) != Some(&new[range])
        })
        .collect();
    for n in &changed {
        if rng.random_bool(share) {
            let range = n * SECTOR..((n + 1) * SECTOR).min(new.len());
            out[range.clone()].copy_from_slice(&new[range]);
        }
    }
    let torn = changed.get(rng.random_range(0..changed.len().max(1)));
    if let Some(n) = torn {
        let cut = n * SECTOR + rng.random_range(1..SECTOR);
        let (from, to) = (n * SECTOR, ((n + 1) * SECTOR).min(new.len()));
        let cut = cut.min(to);
        out[from..cut].copy_from_slice(&new[from..cut]);
        let before = old.iter().skip(cut).copied().chain(std::iter::repeat(0));
        out[cut..to].iter_mut().zip(before).for_each(|(to, from)| *to = from);
    }
    // How long the file is stands elsewhere on the disk.
    if new.len() > old.len() && rng.random_bool(0.5) {
        out.truncate(rng.random_range(old.len()..=new.len()));
    }
    (out, torn.is_some())
}
