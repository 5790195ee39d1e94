//! `base send … station`: another configuration for a recorder, in pieces, and what becomes of it.

use crate::blob;
use crate::cmd::base_tokens;
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::config_blob::CRC;
use seabearing_core::keeper::{DONE, REFUSED};
use seabearing_core::slots::TRIAL_S;
use seabearing_core::wire::configure::{Configure, PIECE_BYTES};
use seabearing_core::wire::guard::COMMAND_BYTES;
use seabearing_core::wire::{Command, bytes_of, configure};
use serde_json::Value;
use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

/// Seconds that a recorder may take to start again: until the base station has everything, and until it is in flash.
const RESTART_S: u64 = 70;
/// Time from one question how it is to the next.
const ASK_EVERY: Duration = Duration::from_secs(1);

/// How far it is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// Pieces are sent.
    Sending,
    /// All was sent, and it is to be taken.
    Taking,
    /// It was taken: the recorder starts again.
    Starting,
    /// The recorder runs with it, and is asked how it is.
    Asking,
    /// The recorder has samples and is heard: it keeps it.
    Kept,
}

/// A new configuration on its way.
pub struct Change {
    waiting: VecDeque<Configure>,
    /// As `Hello` tells it.
    hash: String,
    bytes: usize,
    /// Sample instants that say that it has come up.
    enough: f64,
    stage: Stage,
    /// Token of the order that is not answered yet, and of the next.
    open: Option<u8>,
    token: u8,
    asked: Option<Instant>,
}

impl Change {
    /// That of a station file; `station` is the recorder's number, where that is known.
    ///
    /// # Errors
    /// The file is no station's, or another station's.
    pub fn of(file: &Path, station: Option<u16>) -> Result<Self> {
        let new = Station::read(file)?;
        let id = new.config.id;
        if let Some(station) = station.filter(|s| *s != id) {
            bail!("{}: this is station {id}, not {station}; a recorder keeps its number", file.display());
        }
        let blob = blob::of(&new)?;
        let length = u32::try_from(blob.len()).context("the configuration is too long")?;
        let mut waiting = VecDeque::from([Configure::Begin { token: 0, length, crc: CRC.checksum(&blob) }]);
        let piece = |(number, bytes)| Configure::Piece { token: 0, number, bytes };
        waiting.extend((0..).zip(configure::pieces(&blob)).map(piece));
        waiting.push_back(Configure::Take { token: 0 });
        Ok(Self {
            waiting,
            hash: format!("{:016x}", new.config.hash()),
            bytes: blob.len(),
            enough: 0.5 * new.config.rate_hz,
            stage: Stage::Sending,
            open: None,
            token: base_tokens::who().wrapping_add(1),
            asked: None,
        })
    }

    /// The next order's bytes, if one is due now.
    pub fn due(&self) -> Option<Vec<u8>> {
        let mut buffer = [0; COMMAND_BYTES];
        if self.open.is_some() {
            return None;
        }
        match self.stage {
            Stage::Sending => Some(self.waiting.front()?.with_token(self.token).encode(&mut buffer).to_vec()),
            Stage::Asking if self.asked.is_none_or(|at| at.elapsed() >= ASK_EVERY) => {
                Some(bytes_of(&Command::Identify { token: self.token }, &mut buffer).to_vec())
            }
            _ => None,
        }
    }

    /// What was due was given.
    pub fn given(&mut self) {
        (self.open, self.asked) = (Some(self.token), Some(Instant::now()));
        self.token = self.token.wrapping_add(1);
        if self.stage == Stage::Sending {
            self.waiting.pop_front();
            if self.waiting.is_empty() {
                self.stage = Stage::Taking;
            }
        }
    }

    /// The recorder says something; whether that brings it on.
    ///
    /// # Errors
    /// It refuses, or went back.
    pub fn heard(&mut self, record: &Value) -> Result<bool> {
        let before = (self.stage, self.open);
        let taken = self.stage != Stage::Sending;
        match record["type"].as_str() {
            Some("reply") if self.open.is_some_and(|token| record["token"] == u64::from(token)) => {
                self.open = None;
                self.answered(record["status"].as_u64())?;
            }
            // After a restart it may come before the answer.
            Some("hello") if taken && record["config_hash"] == self.hash.as_str() => {
                (self.stage, self.open) = (Stage::Asking, None);
            }
            Some("fault") if taken && record["code"] == "RolledBack" => {
                bail!("the recorder has gone back to the configuration before: {}", why(&record["value"]));
            }
            // Samples come, and its schedule has it leave them out.
            Some("fault") if self.stage == Stage::Asking && record["code"] == "Paused" => {
                self.stage = Stage::Kept;
            }
            Some("health")
                if self.stage == Stage::Asking && record["processed"].as_f64() >= Some(self.enough) =>
            {
                self.stage = Stage::Kept;
            }
            _ => {}
        }
        Ok(before != (self.stage, self.open))
    }

    fn answered(&mut self, status: Option<u64>) -> Result<()> {
        let what = match (status.and_then(|s| u8::try_from(s).ok()), self.stage) {
            (Some(DONE), Stage::Taking) => {
                self.stage = Stage::Starting;
                return Ok(());
            }
            (Some(DONE), _) => return Ok(()),
            (Some(REFUSED), Stage::Taking) => {
                "the recorder does not take this configuration: it is of another station, of another kind or at a rate that the recorder does not have; it keeps its own".to_owned()
            }
            (Some(REFUSED), _) => format!(
                "the recorder takes no configuration of {} bytes now: it is too long, or another is being tried or sent",
                self.bytes
            ),
            _ => "the recorder has no place for another configuration: it keeps the one that it was built with".to_owned(),
        };
        bail!(what)
    }

    /// Whether it is done.
    pub fn done(&self) -> bool {
        self.stage == Stage::Kept
    }

    /// How long the recorder may be silent, beside what any answer takes.
    pub fn patience(&self) -> Duration {
        match self.stage {
            Stage::Sending => Duration::ZERO,
            _ => Duration::from_secs(RESTART_S + u64::from(TRIAL_S)),
        }
    }

    /// What is to be said when it was silent for longer; nothing where it has never answered.
    pub fn silence(&self) -> Option<String> {
        let left = self.waiting.len() * PIECE_BYTES;
        match self.stage {
            Stage::Sending if left > self.bytes => None,
            Stage::Sending => Some(format!(
                "the recorder fell silent {left} bytes before the end; it keeps its configuration"
            )),
            _ => Some(format!(
                "it is not known whether the recorder keeps the new configuration: within {TRIAL_S} s of its start it goes \
                 back by itself where it has no samples or no base station hears it; ask with `identify`"
            )),
        }
    }
}

/// Why a recorder went back.
fn why(value: &Value) -> &'static str {
    match value.as_i64().unwrap_or(0) & 0xff {
        1 => "it started again before the new one was kept (a panic, the watchdog or a loss of power)",
        2 => "it had no samples with the new one",
        3 => "it cannot be set up with the new one",
        4 => "the new one could not be read any more",
        5 => "no base station was heard with the new one",
        _ => "it does not say why",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_recorder_that_pauses_by_its_schedule_has_come_up() {
        let asking = || Change {
            waiting: VecDeque::new(),
            hash: String::new(),
            bytes: 0,
            enough: 25.0,
            stage: Stage::Asking,
            open: None,
            token: 1,
            asked: None,
        };
        let heard = |record: Value| {
            let mut change = asking();
            change.heard(&record).unwrap();
            change.done()
        };
        assert!(heard(json!({ "type": "fault", "code": "Paused", "value": 500 })));
        assert!(heard(json!({ "type": "health", "processed": 25 })));
        assert!(!heard(json!({ "type": "health", "processed": 24 })));
        assert!(!heard(json!({ "type": "fault", "code": "Gap", "value": 500 })));
    }
}
