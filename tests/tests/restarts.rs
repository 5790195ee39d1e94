//! What the recorder says when the sample index starts again, jumps or repeats: a table over kinds, moments and chains.
//!
//! Each row is one run of a recorder with a vessel in sight. Whatever the moment: what was open is finished and sent, the
//! estimates go on, and every instant is in one bucket. The table is kept as a text snapshot; the rules it must obey are
//! asserted beside it, and that the cut into blocks changes nothing.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing::station::Station;
use seabearing_core::block::{Block, Frame};
use seabearing_core::recorder::Memory;
use seabearing_core::run::Application;
use seabearing_core::wire::{FaultCode, Health, Message};
use seabearing_tests::{array_station, ocean_bottom};

const SHAFT: &str =
    "[tracking]\nspeed_from_shaft = { at_zero_m_s = 0.5, metres_a_turn = 1.4, sd_m_s = 0.3 }\n";
const RATE: u64 = 8000;

/// White noise on every hydrophone and one source due east, its power swinging at 5 Hz.
fn vessel(seconds: u64) -> Vec<Frame> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let n = (seconds * RATE) as usize;
    let swing = |i: usize| 1.0 + 0.5 * (std::f64::consts::TAU * 5.0 * i as f64 / RATE as f64).sin();
    let source: Vec<f64> = (0..n + 64).map(|i| swing(i).sqrt() * normal()).collect();
    let east = [0.0, 0.92, -0.92, 0.0];
    let delay = east.map(|x: f64| (32.0 - x / 1484.0 * RATE as f64).round() as usize);
    (0..n).map(|i| delay.map(|d| ((source[i + 64 - d] * 2.0 + normal()) * 20_000.0) as i32)).collect()
}

/// What happens to the index.
#[derive(Clone, Copy, Debug)]
enum Kind {
    BackToZero,
    Ahead,
    Repeated,
    Stuck,
}

const KINDS: [Kind; 4] = [Kind::BackToZero, Kind::Ahead, Kind::Repeated, Kind::Stuck];

/// Runs of samples with their first indices, where `kind` happens after `at` instants of `frames` that begin at `from`;
/// with them the instants there should be in all buckets.
fn runs(kind: Kind, frames: &[Frame], from: u64, at: usize) -> (Vec<(u64, &[Frame])>, u64) {
    let (before, after) = frames.split_at(at);
    let next = from + at as u64;
    let n = frames.len() as u64;
    match kind {
        Kind::BackToZero => (vec![(from, before), (0, after)], n),
        Kind::Ahead => (vec![(from, before), (next + 1_000_000, after)], n + 1_000_000),
        // Back to zero four times within five seconds' worth of samples, then on.
        Kind::Repeated => {
            let step = (after.len() / 40).max(1);
            let mut runs = vec![(from, before)];
            runs.extend(after[..4 * step].chunks(step).map(|part| (0, part)));
            runs.push((0, &after[4 * step..]));
            (runs, n)
        }
        // The same second's indices over and over for a while, then on from there.
        Kind::Stuck => {
            let step = (after.len() / 60).max(1);
            let mut runs = vec![(from, before)];
            runs.extend(after[..20 * step].chunks(step).map(|part| (next, part)));
            runs.push((next + step as u64, &after[20 * step..]));
            (runs, n)
        }
    }
}

/// Messages, each with the instants fed before it came.
fn listen(
    station: &Station,
    table: Option<&[u8]>,
    runs: &[(u64, &[Frame])],
    mut block: impl FnMut() -> usize,
) -> Vec<(u64, Message)> {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = memory.configure(&station.config, table).unwrap();
    let (mut heard, mut fed) = (Vec::new(), 0);
    recorder.start(0, &mut |m| heard.push((0, *m)));
    for (first, frames) in runs {
        let mut at = 0;
        while at < frames.len() {
            let n = block().clamp(1, frames.len() - at);
            fed += n as u64;
            let block = Block { first_index: first + at as u64, frames: &frames[at..at + n] };
            recorder.push(block, &mut |m| heard.push((fed, *m)));
            at += n;
        }
    }
    recorder.finish(&mut |m| heard.push((fed, *m)));
    heard
}

/// Seconds after `from` (instants fed) of the first message that fits.
fn first(heard: &[(u64, Message)], from: u64, rate: u64, fits: impl Fn(&Message) -> bool) -> Option<f64> {
    let found = heard.iter().find(|(fed, m)| *fed > from && fits(m));
    found.map(|(fed, _)| (fed - from) as f64 / rate as f64)
}

fn count(heard: &[(u64, Message)], fits: impl Fn(&Message) -> bool) -> usize {
    heard.iter().filter(|(_, m)| fits(m)).count()
}

fn last_health(heard: &[(u64, Message)]) -> Health {
    heard.iter().rev().find_map(|(_, m)| if let Message::Health(h) = m { Some(*h) } else { None }).unwrap()
}

fn seconds(s: Option<f64>) -> String {
    s.map_or_else(|| "never".into(), |s| format!("{s:.0}"))
}

fn faults(heard: &[(u64, Message)]) -> String {
    let mut codes: Vec<(FaultCode, usize)> = Vec::new();
    for (_, m) in heard {
        if let Message::Fault(f) = m {
            match codes.iter_mut().find(|c| c.0 == f.code) {
                Some(c) => c.1 += 1,
                None => codes.push((f.code, 1)),
            }
        }
    }
    codes.iter().map(|(code, n)| format!("{code:?} {n}")).collect::<Vec<_>>().join(", ")
}

#[test]
fn an_array_goes_on_whatever_happens_to_the_index() {
    let station = array_station(8000, SHAFT);
    let frames = vessel(130);
    let from = 1_000_000_000;
    // Moments within a step, a segment, a cell of the envelope and a minute of samples; one before there is a track.
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let moments: Vec<u64> = (0..4).map(|k| (5 + 18 * k) * RATE + rng.random_range(0..18 * RATE)).collect();
    let rows: Vec<(Kind, u64)> = KINDS.iter().flat_map(|k| moments.iter().map(|at| (*k, *at))).collect();
    let lines: Vec<String> = rows
        .par_iter()
        .map(|(kind, at)| {
            let (runs, expected) = runs(*kind, &frames, from, *at as usize);
            let heard = listen(&station, None, &runs, || 512);
            let mut rng = ChaCha8Rng::seed_from_u64(*at);
            let other: Vec<Message> = listen(&station, None, &runs, || rng.random_range(1..3000)).iter().map(|m| m.1).collect();
            assert!(heard.iter().map(|m| m.1).eq(other), "{kind:?} {at}: blocks matter");
            let (tracked, open) = heard.iter().filter(|m| m.0 <= *at).fold((0, Vec::new()), |(n, mut open), (_, m)| match m {
                Message::Track(t) if t.stage == 0 && !open.contains(&t.id) => {
                    open.push(t.id);
                    (n + 1, open)
                }
                Message::Track(t) if t.stage == 1 => (n, open.into_iter().filter(|id| *id != t.id).collect()),
                _ => (n, open),
            });
            let health = last_health(&heard);
            let total = health.processed + health.lost.iter().sum::<u64>();
            let ended = count(&heard, |m| matches!(m, Message::Track(t) if t.stage == 1 && open.contains(&t.id)));
            let track = first(&heard, *at, RATE, |m| matches!(m, Message::Track(t) if t.stage == 0));
            let shaft = first(&heard, *at, RATE, |m| matches!(m, Message::ShaftRate(_)));
            let again = first(&heard, *at, RATE, |m| matches!(m, Message::Health(_)));
            let row = format!(
                "{kind:?} at {:.3} s: tracks before {tracked}, ended {ended}; s to bearing {}, track {}, shaft rate {}, health {}; faults {}; accounted {}",
                *at as f64 / RATE as f64,
                seconds(first(&heard, *at, RATE, |m| matches!(m, Message::Bearing(_)))),
                seconds(track), seconds(shaft), seconds(again), faults(&heard),
                if total == expected { "all" } else { "NOT ALL" },
            );
            assert_eq!(total, expected, "{row}");
            assert_eq!(ended, open.len(), "{row}");
            for s in [track, shaft, again] {
                // Counted from the last time the index starts again, to the recorder's next look at the time. An index that
                // stands still is believed after half a minute.
                let patience = match kind {
                    Kind::Stuck => 30.0,
                    Kind::Repeated => (4 * ((frames.len() - *at as usize) / 40)) as f64 / RATE as f64,
                    Kind::BackToZero | Kind::Ahead => 0.0,
                } + 1024.0 / RATE as f64;
                assert!(s.is_some_and(|s| s <= 60.0 + patience), "{row}");
            }
            assert!(health.level_half_db.iter().all(|l| (-100..-20).contains(l)), "{row}: {health:?}");
            row
        })
        .collect();
    insta::assert_snapshot!(lines.join("\n"));
}

#[test]
fn an_ocean_bottom_station_goes_on_whatever_happens_to_the_index() {
    let folder = tempfile::tempdir().unwrap();
    let record = ocean_bottom(folder.path(), 10_800.0).unwrap();
    let frames: Vec<Frame> = record.blocks.iter().flat_map(|b| b.1.clone()).collect();
    let table = seabearing::ocean_bottom::table::of_station(&record.station).unwrap();
    let rate = 50;
    let from = 1_000_000_000;
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let moments: Vec<u64> =
        (0..4).map(|k| (600 + 2000 * k) * rate + rng.random_range(0..2000 * rate)).collect();
    let rows: Vec<(Kind, u64)> = KINDS.iter().flat_map(|k| moments.iter().map(|at| (*k, *at))).collect();
    let lines: Vec<String> = rows
        .par_iter()
        .map(|(kind, at)| {
            let (runs, expected) = runs(*kind, &frames, from, *at as usize);
            let heard = listen(&record.station, table.as_deref(), &runs, || 512);
            let mut rng = ChaCha8Rng::seed_from_u64(*at);
            let other: Vec<Message> =
                listen(&record.station, table.as_deref(), &runs, || rng.random_range(1..3000)).iter().map(|m| m.1).collect();
            assert!(heard.iter().map(|m| m.1).eq(other), "{kind:?} {at}: blocks matter");
            let health = last_health(&heard);
            let total = health.processed + health.lost.iter().sum::<u64>();
            let is_track = |stage| move |m: &Message| matches!(m, Message::Track(t) if t.stage == stage);
            let before = &heard[..heard.iter().take_while(|m| m.0 <= *at).count()];
            let live = before.iter().rev().find_map(|(_, m)| if let Message::Track(t) = m { Some(t.stage == 0) } else { None });
            // What was open is sent with the first block of the new time.
            let at_once: Vec<_> = heard.iter().filter(|m| m.0 > *at && m.0 <= *at + 1024).copied().collect();
            let azimuth = first(&heard, *at, rate, |m| matches!(m, Message::Azimuth(_)));
            let range = first(&heard, *at, rate, |m| matches!(m, Message::Range(r) if r.detected));
            let again = first(&heard, *at, rate, |m| matches!(m, Message::Health(_)));
            let row = format!(
                "{kind:?} at {:.0} s: track live {}, ended at once {}, segments sent at once {}; s to azimuth {}, range {}, track {}, health {}; segments in all {}; faults {}; accounted {}",
                *at as f64 / rate as f64,
                live == Some(true),
                count(&at_once, is_track(1)),
                count(&at_once, |m| matches!(m, Message::Segment(_))),
                seconds(azimuth),
                seconds(range),
                seconds(first(&heard, *at, rate, is_track(0))),
                seconds(again),
                count(&heard, |m| matches!(m, Message::Segment(_))),
                faults(&heard),
                if total == expected { "all" } else { "NOT ALL" },
            );
            assert_eq!(total, expected, "{row}");
            for s in [azimuth, again] {
                assert!(s.is_some_and(|s| s <= 80.0), "{row}");
            }
            // A range that may be a vessel's beyond the model's end is told once its track is established: a first start there would
            // wait for as long, but for a window and the time that it takes to believe the index.
            let fresh = listen(&record.station, table.as_deref(), &[(0, &frames[*at as usize..])], || 512);
            let fresh_range = first(&fresh, 0, rate, |m| matches!(m, Message::Range(r) if r.detected));
            let patience = fresh_range.map_or(80.0, |s| f64::max(80.0, s + 60.0));
            assert!(range.is_some_and(|s| s <= patience), "{row}: {fresh_range:?}");
            assert!(health.level_half_db.iter().all(|l| (-127..0).contains(l)), "{row}: {health:?}");
            if !matches!(kind, Kind::Stuck) {
                assert!(count(&at_once, |m| matches!(m, Message::Segment(_))) > 0, "{row}");
                assert!(live != Some(true) || count(&at_once, is_track(1)) == 1, "{row}");
            }
            // Evidence of minutes is gathered before there is a track: as long as from a first start, and a frame.
            if let Kind::BackToZero = kind {
                let fresh = first(&fresh, 0, rate, is_track(0));
                let track = first(&heard, *at, rate, is_track(0));
                assert!(track.zip(fresh).is_some_and(|(track, fresh)| track <= fresh + 1024.0 / rate as f64), "{row}: {fresh:?}");
            }
            row
        })
        .collect();
    insta::assert_snapshot!(lines.join("\n"));
}
