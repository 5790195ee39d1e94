//! The account: what the recorders said, and what the base station has of it.

use super::STATIONS;
use super::recorder::{Ended, records_memory};
use crate::emulator::SamplePath;
use crate::record::RecordFormat;
use crate::twin;
use anyhow::{Context, Result, bail};
use seabearing_base::store::{Wanted, check, read};
use seabearing_core::utc::Times;
use seabearing_core::wire::link::{ByteStore, Class, Store};
use seabearing_core::wire::{Decoder, Message};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Errors of a time beyond so many of its standard deviations are wrong.
const BEYOND: f64 = 4.0;

/// Prints the account of both recorders.
///
/// # Errors
/// It does not balance.
pub fn balance(store: &Path, recorders: &[Ended], begun: OffsetDateTime) -> Result<()> {
    let mut wrong = Vec::new();
    for (station, recorder) in STATIONS.into_iter().zip(recorders) {
        let account = Account::of(store, station, recorder, begun)?;
        account.print(station);
        wrong.extend(account.wrong(station));
    }
    wrong.extend(check(store)?.faults);
    if !wrong.is_empty() {
        bail!("the account does not balance: {}", wrong.join("; "));
    }
    println!("the store is sound; every record is there exactly once, with its UTC");
    Ok(())
}

/// What one recorder said and the base station has.
#[derive(Default)]
struct Account {
    boots: u32,
    sessions: u64,
    /// Records written, as the recorder's own store says; those that wait there still; those that it dropped.
    written: u64,
    waiting: u64,
    dropped: u64,
    /// At the base station.
    missing: u64,
    twice: u64,
    unknown: u64,
    /// Records of a moment, those of them with UTC, its largest error and standard deviation, and errors beyond it.
    dated: u64,
    of_a_moment: u64,
    worst_error_s: f64,
    worst_sd_s: f64,
    beyond: u64,
    /// Records that the host's twin says over the same samples, and those of them that are not the same.
    compared: u64,
    unlike: u64,
    ups: usize,
    downs: usize,
    /// Samples that the converter lost because the emulated board was late, s.
    lost_s: f64,
}

impl Account {
    fn of(store: &Path, station: u16, recorder: &Ended, begun: OffsetDateTime) -> Result<Self> {
        let mut memory = records_memory(&recorder.retained)?;
        let (kept, starts) = ByteStore::open(&mut memory);
        let ledger = kept.ledger();
        let mut account = Self {
            boots: starts.saturating_sub(1),
            written: ledger.ordinal.into(),
            waiting: Class::ALL.iter().map(|c| u64::from(ledger.kept(*c))).sum(),
            lost_s: recorder.lost as f64 / recorder.rate_hz,
            dropped: ledger.lost.iter().map(|n| u64::from(*n)).sum(),
            ..Self::default()
        };
        let mut found: BTreeMap<u64, u64> = BTreeMap::new();
        let mut sessions: BTreeMap<u64, BTreeMap<u64, Value>> = BTreeMap::new();
        read(store, &Wanted { station: Some(station), ..Wanted::default() }, |record| {
            account.ups += usize::from(record["state"] == "up");
            account.downs += usize::from(record["state"] == "down");
            let (Some(sequence), Some(session)) = (record["sequence"].as_u64(), record["session"].as_u64())
            else {
                return;
            };
            *found.entry(sequence).or_default() += 1;
            sessions.entry(session).or_default().insert(sequence, record);
        })?;
        account.sessions = sessions.len() as u64;
        account.missing = (0..account.written).filter(|n| !found.contains_key(n)).count() as u64;
        account.unknown = found.keys().filter(|n| **n >= account.written).count() as u64;
        account.twice = found.values().map(|n| n - 1).sum();
        for (records, (samples, first)) in sessions.values().zip(&recorder.sessions) {
            account.date(records, *first as f64 / recorder.rate_hz, begun)?;
            account.compare(records, samples, recorder)?;
        }
        Ok(account)
    }

    /// How far the times are from when the samples were.
    fn date(&mut self, records: &BTreeMap<u64, Value>, first_s: f64, begun: OffsetDateTime) -> Result<()> {
        for record in records.values() {
            let Some(t_s) = record["t_s"].as_f64() else { continue };
            self.of_a_moment += 1;
            let (Some(utc), Some(sd_s)) = (record["utc"].as_str(), record["sd_utc_s"].as_f64()) else {
                continue;
            };
            self.dated += 1;
            let utc = OffsetDateTime::parse(utc, &Rfc3339).context("a time of the base station")?;
            let error_s = (utc - begun).as_seconds_f64() - (first_s + t_s);
            self.worst_error_s = self.worst_error_s.max(error_s.abs());
            self.worst_sd_s = self.worst_sd_s.max(sd_s);
            self.beyond += u64::from(error_s.abs() > BEYOND * sd_s);
        }
        Ok(())
    }

    /// Whether the records are those of the host's twin: in a session that a loss of power ended its first ones, else all.
    fn compare(&mut self, records: &BTreeMap<u64, Value>, samples: &Path, of: &Ended) -> Result<()> {
        let mut said = Vec::new();
        let mut decoder = Decoder::default();
        let feed = |out: &mut dyn std::io::Write| -> Result<()> {
            std::io::copy(&mut std::fs::File::open(samples)?, out)?;
            Ok(())
        };
        twin::host(&of.blob, SamplePath::File, feed, |frame| {
            said.extend(frame.iter().filter_map(|b| decoder.push::<Message>(*b).map(|r| r.message)));
            Ok(())
        })?;
        let format = RecordFormat { rate_hz: of.rate_hz, start: None, times: Times::default() };
        let twin = said.iter().map(|m| bare(&format.json(m))).filter(follows);
        let twin: Vec<Value> = twin.collect();
        let came: Vec<Value> = records.values().map(bare).filter(follows).collect();
        let whole = records.values().any(|r| r["type"] == "end");
        let same = came.iter().zip(&twin).filter(|(a, b)| a == b).count();
        let expected = if whole { twin.len() } else { came.len() };
        self.compared += expected as u64;
        self.unlike += (expected.max(came.len()) - same) as u64;
        Ok(())
    }

    fn print(&self, station: u16) {
        let Self { boots, sessions, written, waiting, dropped, missing, twice, .. } = self;
        println!("recorder {station}: {boots} starts, {written} records written as its own store says");
        println!("  waiting there {waiting}, dropped there {dropped}");
        println!("  at the base station in {sessions} sessions: missing {missing}, twice {twice}");
        println!(
            "  with UTC {} of {} that are of a moment; largest error {:.3} s, largest standard deviation {:.3} s",
            self.dated, self.of_a_moment, self.worst_error_s, self.worst_sd_s
        );
        println!(
            "  as the host's twin says over the same samples: {} of {}",
            self.compared - self.unlike.min(self.compared),
            self.compared
        );
        if self.lost_s > 0.0 {
            println!(
                "  {:.1} s of samples lost, and told as gaps: this machine is slower than the recorder",
                self.lost_s
            );
        }
        println!("  its line came up {} times and went down {} times", self.ups, self.downs);
    }

    fn wrong(&self, station: u16) -> Option<String> {
        let counts = [
            ("missing", self.missing),
            ("twice", self.twice),
            ("never written", self.unknown),
            ("left in the recorder", self.waiting),
            ("dropped by the recorder", self.dropped),
            ("without UTC", self.of_a_moment - self.dated),
            ("with a wrong UTC", self.beyond),
            ("unlike the twin's", self.unlike),
            ("sessions too few", 2u64.saturating_sub(self.sessions)),
            ("records too few", 20u64.saturating_sub(self.written)),
        ];
        let wrong: Vec<String> =
            counts.iter().filter(|c| c.1 > 0).map(|(name, n)| format!("{n} {name}")).collect();
        (!wrong.is_empty()).then(|| format!("recorder {station}: {}", wrong.join(", ")))
    }
}

/// A record without what only the base station knows.
fn bare(record: &Value) -> Value {
    let mut record = record.clone();
    if let Value::Object(map) = &mut record {
        ["utc", "sd_utc_s", "received_utc", "station", "session", "sequence"].iter().for_each(|key| {
            map.remove(*key);
        });
    }
    record
}

/// Whether a record follows from the samples alone: not the answers to commands, nor what counts them.
fn follows(record: &Value) -> bool {
    !matches!(record["type"].as_str(), Some("time" | "reply" | "health" | "end"))
}
