//! UTC for recorders without a satellite receiver: told by this computer's clock when they come up, and now and then.

use super::Base;
use super::record::micros;
use seabearing_core::wire::Command;
use seabearing_core::wire::guard::Key;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// Number by which the answers are known.
const TOKEN: u8 = 0x75;
/// How wrong the time may be when it arrives, one standard deviation: this clock's error and the line's delay.
const SD_US: u32 = 500_000;

/// A recorder that does not say when its samples were is told again after so long.
const AGAIN: Duration = Duration::from_secs(10);

/// 2020-01-01, microseconds since 1970: no computer that runs this has a right clock that says less.
const CLOCK_SET_US: i64 = 1_577_836_800_000_000;

/// Tells recorders the time, by signed commands.
#[derive(Debug)]
pub struct Teller {
    every: Duration,
    keys: BTreeMap<u16, Key>,
    /// In which boot, and when, a station was told last.
    told: BTreeMap<u16, (u32, Instant)>,
}

impl Teller {
    /// Stations with these keys are told once they have opened their link, after each start, and so often.
    pub fn new(every: Duration, keys: BTreeMap<u16, Key>) -> Self {
        Self { every, keys, told: BTreeMap::new() }
    }

    /// Tells whoever is due.
    pub(crate) fn work(&mut self, base: &mut Base) {
        let utc_us = micros(OffsetDateTime::now_utc());
        if utc_us < CLOCK_SET_US {
            // This computer does not know it itself yet.
            return;
        }
        for (stream, session) in base.linked() {
            let Some(key) = self.keys.get(&session.station) else { continue };
            let told = self.told.get(&session.station);
            // A recorder refuses it while its converter stands still, as at its start.
            let every = if base.is_dated(&session) { self.every } else { self.every.min(AGAIN) };
            if told.is_some_and(|(boot, at)| *boot == session.boot && at.elapsed() < every) {
                continue;
            }
            if base.command(stream, Some(key), &Command::Utc { token: TOKEN, utc_us, sd_us: SD_US }) {
                self.told.insert(session.station, (session.boot, Instant::now()));
            }
        }
    }
}
