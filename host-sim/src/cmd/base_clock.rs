//! `seabearing base send ... utc now`: a recorder is told the time when the line is known to be quick.
//!
//! A link says again what has not come, and a time that comes late is wrong by as much. So the recorder is asked who it is
//! first; only after a quick answer it is told the time, and told again where that answer was late.

use super::base_tokens::{order, who};
use anyhow::{Result, bail};
use seabearing_core::wire::guard::COMMAND_BYTES;
use seabearing_core::wire::{Command, bytes_of};
use serde_json::Value;
use std::time::{Duration, Instant};

/// Answers that may be late.
const MOST_LATE: u32 = 5;

/// A recorder's clock that is to be set.
pub struct Clock {
    sd_us: u32,
    /// The line was quick just now.
    quick: bool,
    given: Option<Instant>,
    late: u32,
    done: bool,
}

impl Clock {
    /// With this standard deviation, microseconds: an answer within twice as much is quick.
    pub fn new(sd_us: u32) -> Self {
        Self { sd_us, quick: false, given: None, late: 0, done: false }
    }

    /// The next command, if one is due now.
    pub fn due(&self) -> Option<Vec<u8>> {
        if self.given.is_some() || self.done {
            return None;
        }
        let utc_us = (time::OffsetDateTime::now_utc().unix_timestamp_nanos() / 1000) as i64;
        let command = match self.quick {
            false => Command::Identify { token: who() },
            true => Command::Utc { token: order(), utc_us, sd_us: self.sd_us },
        };
        Some(bytes_of(&command, &mut [0; COMMAND_BYTES]).to_vec())
    }

    /// What was due was given.
    pub fn given(&mut self) {
        self.given = Some(Instant::now());
    }

    /// The recorder says something; whether that brings it on.
    ///
    /// # Errors
    /// It refuses, or its answers are late again and again.
    pub fn heard(&mut self, record: &Value) -> Result<bool> {
        let token = if self.quick { order() } else { who() };
        if record["type"] != "reply" || record["token"] != u64::from(token) {
            return Ok(false);
        }
        super::base_send::done(record)?;
        let Some(took) = self.given.take().map(|at| at.elapsed()) else { return Ok(false) };
        let quick = took <= Duration::from_micros(2 * u64::from(self.sd_us));
        (self.quick, self.done) = (quick, quick && self.quick);
        self.late += u32::from(!quick);
        if self.late > MOST_LATE {
            bail!(
                "answers of the recorder take {:.1} s, so that it cannot be told the time to {} ms: say a larger --sd-ms",
                took.as_secs_f64(),
                self.sd_us / 1000
            );
        }
        Ok(true)
    }

    /// Whether it was told in time.
    pub fn done(&self) -> bool {
        self.done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn reply(token: u8) -> Value {
        json!({ "type": "reply", "token": token, "status": 0 })
    }

    #[test]
    fn it_is_told_after_a_quick_answer_and_again_after_a_late_one() {
        let mut clock = Clock::new(50_000);
        let mut answer = |late: bool, token: u8| {
            assert!(clock.due().is_some());
            clock.given();
            assert!(clock.due().is_none());
            if late {
                std::thread::sleep(Duration::from_millis(120));
            }
            clock.heard(&reply(token)).unwrap();
            clock.done()
        };
        assert!(!answer(true, who()) && !answer(false, who()));
        // Told, and the answer is late: is the line quick now?
        assert!(!answer(true, order()) && !answer(false, who()) && answer(false, order()));
    }

    #[test]
    fn a_line_that_stays_slow_is_named() {
        let mut clock = Clock::new(1000);
        let said = loop {
            clock.given();
            std::thread::sleep(Duration::from_millis(5));
            if let Err(e) = clock.heard(&reply(who())) {
                break e.to_string();
            }
        };
        assert!(said.contains("--sd-ms") && !clock.done(), "{said}");
    }
}
