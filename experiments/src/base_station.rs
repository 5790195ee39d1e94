//! The base station under load, killed, and after a year: what it keeps, how soon, and what it takes.

use super::base_process::{Caller, Process, hello, peak_mb};
use super::report::CsvReport;
use super::{Experiment, Options};
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_base::store::{Entry, Event, Retain, Store, Wanted, check, newest_us, read};
use seabearing_base::{Base, Beginning};
use seabearing_core::wire::{Bearing, Encoder, Health, Message, Time, Track};
use seabearing_host::beside::Folder;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// `seabearing reproduce base-load`.
pub const LOAD: Experiment = Experiment {
    name: "base-load",
    about: "64 recorders with links call one base station, 10 records a second each and then five times that; --runs: minutes of records",
    run: load,
};

/// `seabearing reproduce base-kill`.
pub const KILL: Experiment = Experiment {
    name: "base-kill",
    about: "a base station is killed at random moments, 10 times or as --runs says: nothing acknowledged is missing or twice",
    run: kill,
};

/// `seabearing reproduce base-year`.
pub const YEAR: Experiment = Experiment {
    name: "base-year",
    about: "a store of one recorder's 20 days, or as many as --runs says: open, newest hour, one track",
    run: year,
};

const RECORDERS: u16 = 64;
/// Records a second of each; so for the first seconds, and then by so much faster.
const RATE: u32 = 10;
const FIRST_S: f64 = 8.0;
const FASTER: u32 = 5;
/// Records that a recorder holds at most.
const BEHIND: u32 = 200;

pub fn bearing(index: u64) -> Message {
    Message::Bearing(Bearing {
        index,
        azimuth: 1.5,
        elevation: 0.25,
        var_azimuth: 1e-4,
        var_elevation: 2e-4,
        cov: -3e-5,
        snr_db: 12.5,
        quality: 0.875,
        closure_s: 1e-6,
        statistic: 3.5,
        band: 0,
        flags: 0,
    })
}

pub fn track(id: u16, index: u64, last: bool) -> Message {
    Message::Track(Track {
        id,
        stage: u8::from(last),
        index,
        cpa_time_s: index as f64 / 1000.0,
        cpa_range_m: 500.0,
        cpa_azimuth: 5.25,
        heading: 0.5,
        speed_m_s: 7.0,
        starboard: true,
        sd_cpa_time_s: 0.5,
        sd_cpa_range_m: 9.0,
        sd_heading: 0.01,
        sd_speed_m_s: 0.25,
        x_m: -250.0,
        y_m: 430.5,
        var_x_m2: 100.0,
        var_y_m2: 64.0,
        cov_xy_m2: -12.0,
        range_observable: true,
        n: 200,
    })
}

fn load(options: &Options) -> Result<()> {
    let minutes = options.runs.unwrap_or(1) as u32;
    let folder = Folder::new()?;
    let base = Process::start(folder.path())?;
    let mut callers: Vec<Caller> = (1..=RECORDERS).map(Caller::new).collect();
    callers.iter_mut().try_for_each(|c| c.call(&base))?;
    let each = minutes * 60 * RATE;
    let begun = Instant::now();
    let mut worst_first_s = None;
    let worst = |callers: &[Caller]| callers.iter().map(|c| c.worst_s).fold(0.0, f64::max);
    loop {
        let at_s = begun.elapsed().as_secs_f64();
        let due = f64::from(RATE) * (at_s.min(FIRST_S) + (at_s - FIRST_S).max(0.0) * f64::from(FASTER));
        let due = due as u32;
        if at_s > FIRST_S {
            worst_first_s = worst_first_s.or(Some(worst(&callers)));
        }
        for caller in &mut callers {
            // Where this machine does not get round, it says less at once rather than what its store cannot hold.
            while caller.said < due.min(each) && caller.waiting() < BEHIND {
                let n = caller.said;
                caller.say(&bearing(u64::from(n) * 100));
            }
            caller.work(begun.elapsed().as_micros() as u64);
        }
        let done = callers.iter().all(|c| c.said == each && c.waiting() == 0);
        if done || begun.elapsed() > Duration::from_secs(60 * u64::from(minutes + 1)) {
            break;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let took_s = begun.elapsed().as_secs_f64();
    let peak = base.peak_mb();
    base.kill();
    let (missing, twice) = compare(folder.path(), &callers.iter().map(|c| c.said).collect::<Vec<_>>())?;
    let all = f64::from(each) * f64::from(RECORDERS);
    let worst = worst(&callers);
    let rate = f64::from(RATE) * f64::from(RECORDERS);
    let figures = &options.figures;
    let name = format!("longest from saying a record to its acknowledgement at {rate} a second, s");
    figures.at_most(name, worst_first_s, 1.0);
    figures.state("longest at all, s", worst);
    figures.at_least("records a second at last", (all - rate * FIRST_S) / (took_s - FIRST_S), rate);
    figures.at_most(format!("records missing in the store, of {all}"), missing as f64, 0.0);
    figures.at_most("records twice", twice as f64, 0.0);
    figures.at_most("most memory of the base station, MB", peak, 200.0);
    let mut table = CsvReport::new("base-load", "recorders,records,seconds,worst_s,peak_mb");
    table.row(&[f64::from(RECORDERS), all, took_s, worst, peak.unwrap_or(f64::NAN)]);
    table.finish(options)
}

/// Records of stations 1, 2, ... that a store lacks of so many each, and those that it has more than once.
fn compare(folder: &Path, said: &[u32]) -> Result<(u64, u64)> {
    let mut found: BTreeMap<(u64, u64), u64> = BTreeMap::new();
    read(folder, &Wanted::default(), |r| {
        if let (Some(station), Some(sequence)) = (r["station"].as_u64(), r["sequence"].as_u64()) {
            *found.entry((station, sequence)).or_default() += 1;
        }
    })?;
    let all = (1u64..).zip(said).flat_map(|(station, n)| (0..u64::from(*n)).map(move |k| (station, k)));
    let missing = all.filter(|key| !found.contains_key(key)).count() as u64;
    Ok((missing, found.values().map(|n| n - 1).sum()))
}

fn kill(options: &Options) -> Result<()> {
    let kills = options.runs.unwrap_or(10);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let folder = Folder::new()?;
    let mut caller = Caller::new(1);
    let begun = Instant::now();
    let (mut slowest_s, mut while_waiting) = (0f64, 0u32);
    for round in 0..=kills {
        let opening = Instant::now();
        let base = Process::start(folder.path()).context("it does not open its store again")?;
        slowest_s = slowest_s.max(opening.elapsed().as_secs_f64());
        caller.call(&base)?;
        let (at, last) = (Instant::now(), round == kills);
        let lives = Duration::from_micros(rng.random_range(5_000..120_000));
        while (!last && at.elapsed() < lives)
            || (last && caller.waiting() > 0 && at.elapsed() < Duration::from_secs(60))
        {
            if !last && caller.waiting() < 100 {
                let n = u64::from(caller.said);
                caller.say(&if n % 40 == 39 { track((n / 400) as u16, n, false) } else { bearing(n * 100) });
            }
            caller.work(begun.elapsed().as_micros() as u64);
            std::thread::sleep(Duration::from_micros(300));
        }
        while_waiting += u32::from(caller.waiting() > 0);
        base.kill();
    }
    let (missing, twice) = compare(folder.path(), &[caller.said])?;
    let faults = check(folder.path())?.faults.len();
    let figures = &options.figures;
    figures.at_most(format!("kills: {kills}; records missing, of {}", caller.said), missing as f64, 0.0);
    figures.at_most("records twice", twice as f64, 0.0);
    figures.at_most("records not acknowledged at the end", f64::from(caller.waiting()), 0.0);
    figures.at_most("faults that a check of the store finds", faults as f64, 0.0);
    figures.state("kills while records were on their way", f64::from(while_waiting));
    figures.state("longest start after a kill, s", slowest_s);
    let mut table = CsvReport::new("base-kill", "kills,records,missing,twice");
    table.row(&[kills as f64, f64::from(caller.said), missing as f64, twice as f64]);
    table.finish(options)
}

/// Passages a day, and bearings and reports of the track in each.
const PASSES: u64 = 12;
const BEARINGS: u64 = 600;
const REPORTS: u64 = 150;
const RATE_HZ: u64 = 1000;
const DAY_S: u64 = 86_400;
/// 2025-11-01.
const BEGIN_US: i64 = 1_761_955_200_000_000;

/// A day of an array: `Health` every minute, `Time` every hour, passages of 20 minutes.
fn day(n: u64, encoder: &mut Encoder) -> Vec<u8> {
    let mut messages: Vec<(u64, Message)> = Vec::new();
    for minute in 0..1440 {
        let index = (n * DAY_S + minute * 60) * RATE_HZ;
        if minute % 60 == 0 {
            let utc_us = BEGIN_US + (index / RATE_HZ) as i64 * 1_000_000;
            let time = Time { index, utc_us, sd_s: 1e-3, drift: 0.0, sd_drift: 1e-7, correlation: 0.0 };
            messages.push((index, Message::Time(time)));
        }
        messages.push((index, Message::Health(Health { index, processed: index, ..Health::default() })));
    }
    for pass in 0..PASSES {
        let from = (n * DAY_S + pass * DAY_S / PASSES) * RATE_HZ;
        let id = ((n * PASSES + pass) % 65_000) as u16 + 1;
        messages.extend((0..BEARINGS).map(|k| (from + k * 2000, bearing(from + k * 2000))));
        messages.extend((0..REPORTS).map(|k| {
            let index = from + k * 8000 + 1;
            (index, track(id, index, k + 1 == REPORTS))
        }));
    }
    messages.sort_by_key(|(index, _)| *index);
    messages.iter().flat_map(|(_, message)| encoder.frame(message).to_vec()).collect()
}

fn year(options: &Options) -> Result<()> {
    let days = options.runs.unwrap_or(20) as u64;
    let folder = Folder::new()?;
    let begun = Instant::now();
    let moved_s = fill(folder.path(), days)?;
    let filled_s = begun.elapsed().as_secs_f64();
    let figures = &options.figures;
    let bytes = size(folder.path())? + size(&folder.path().join("months"))?;
    figures.state(format!("{days} days: records written a second"), records(days) as f64 / filled_s);
    figures.state(format!("{days} days: store, MB"), bytes as f64 / 1e6);
    let measured = |name: &str, what: &dyn Fn() -> Result<usize>| -> Result<usize> {
        // From here on the most memory counts.
        let counts = std::fs::write("/proc/self/clear_refs", "5").is_ok();
        let begun = Instant::now();
        let found = what()?;
        figures.at_most(format!("{name}, s"), begun.elapsed().as_secs_f64(), 1.0);
        figures.at_most(format!("{name}, most memory, MB"), peak_mb("self").filter(|_| counts), 100.0);
        Ok(found)
    };
    let opened = measured("open", &|| {
        let mut base = Base::new(None);
        Ok(Store::open(folder.path(), &mut base)?.resumed() as usize)
    })?;
    let hour = measured("newest hour", &|| {
        let newest = newest_us(folder.path())?.context("no record has a time")?;
        let from = OffsetDateTime::from_unix_timestamp_nanos(i128::from(newest - 3_600_000_000) * 1000)?;
        let mut found = 0;
        read(folder.path(), &Wanted { from: Some(from), ..Wanted::default() }, |_| found += 1)?;
        Ok(found)
    })?;
    let one = measured("one track", &|| {
        let id = (days / 2 * PASSES % 65_000) as u16 + 1;
        let mut found = 0;
        read(folder.path(), &Wanted { station: Some(1), track: Some((1, id)), ..Wanted::default() }, |_| {
            found += 1
        })?;
        Ok(found)
    })?;
    figures.at_most("records that were not found", records(days) as f64 - opened as f64, 0.0);
    figures.at_most("reports of the track that were not found", REPORTS as f64 - one as f64, 0.0);
    figures.state("records of the newest hour", hour as f64);
    let (took_s, longest_s) = let_go(folder.path(), days / 2)?;
    figures.state("letting go of the older half, s for a day of it", took_s / (days / 2).max(1) as f64);
    figures.at_most("longest that storing waits for it, s", longest_s, 1.0);
    figures.at_most("longest that storing waits while a month is moved, s", moved_s, 1.0);
    let mut table = CsvReport::new("base-year", "days,records,bytes,filled_s");
    table.row(&[days as f64, opened as f64, bytes as f64, filled_s]);
    table.finish(options)
}

/// Bytes in the files of a folder; none where it is not.
fn size(folder: &Path) -> Result<u64> {
    if !folder.exists() {
        return Ok(0);
    }
    let mut sum = 0;
    for entry in std::fs::read_dir(folder)? {
        let about = entry?.metadata()?;
        sum += if about.is_file() { about.len() } else { 0 };
    }
    Ok(sum)
}

/// Lets go of the oldest days as a base station at work does: how long it takes in all, and at most at once.
fn let_go(folder: &Path, days: u64) -> Result<(f64, f64)> {
    let mut store = Store::open(folder, &mut Base::new(None))?;
    let (begun, mut longest_s) = (Instant::now(), 0f64);
    loop {
        let at = Instant::now();
        let more = store.forget(BEGIN_US + (days * DAY_S) as i64 * 1_000_000)?;
        longest_s = longest_s.max(at.elapsed().as_secs_f64());
        if !more {
            return Ok((begun.elapsed().as_secs_f64(), longest_s));
        }
    }
}

fn records(days: u64) -> u64 {
    1 + days * (1440 + 24 + PASSES * (BEARINGS + REPORTS))
}

/// Writes so many days through the base station's own ways; gives the longest that storing waited while rows were moved into
/// the files of their months, s.
fn fill(folder: &Path, days: u64) -> Result<f64> {
    let mut base = Base::new(None);
    let mut store = Store::open(folder, &mut base)?;
    let mut encoder = Encoder::default();
    let mut longest_s = 0f64;
    let mut put = |received_us, event| -> Result<()> {
        let entry = [Entry { stream: 1, received_us: Some(received_us), event }];
        store.keep(&entry)?;
        let mut rows = Vec::new();
        entry[0].tell(&mut base, 0, None, &mut rows);
        store.derive(&mut base, &rows)?;
        loop {
            let at = Instant::now();
            let more = store.tidy(Retain::default())?;
            longest_s = longest_s.max(at.elapsed().as_secs_f64());
            if !more {
                return Ok(());
            }
        }
    };
    put(BEGIN_US, Event::Began(Beginning { line: "file:year".into(), ..Beginning::default() }))?;
    put(BEGIN_US, Event::Bytes(encoder.frame(&hello(1, RATE_HZ as f32)).to_vec()))?;
    for n in 0..days {
        put(BEGIN_US + (n * DAY_S) as i64 * 1_000_000, Event::Bytes(day(n, &mut encoder)))?;
    }
    put(BEGIN_US + (days * DAY_S) as i64 * 1_000_000, Event::Ended(None))?;
    Ok(longest_s)
}
