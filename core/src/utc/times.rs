//! UTC as a reader of [`Time`] records has it, at the recorder and at a base station alike: on the lines between them, and up to a
//! break on that of before.

use super::{GATE, seconds, wandered};
use crate::math::f64::sqrt;
use crate::wire::Time;

/// The two newest [`Time`] records heard, and with them UTC between, after and before; and those about the newest break of the
/// line, because records of samples before it come after it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    before: Option<Time>,
    newest: Option<Time>,
    /// The newest breaks, the oldest first.
    broken: [Option<Break>; BREAKS],
    /// Samples before this number are on lines of which nothing is known any more.
    forgotten: u64,
}

/// Breaks of the line that are known of: a minute's records come late, and of a line that was down for long some of before.
const BREAKS: usize = 3;

/// A line that ends and one that begins.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Break {
    ends: Time,
    begins: Time,
    /// The clock that tells UTC has stepped; else numbers of samples between were an estimate.
    stepped: bool,
}

/// Times are told to the microsecond, and drifts to seven digits.
const ROUNDED_S: f64 = 5e-6;
/// What is told to be less certain by so much than the line before it is behind an estimate of samples' numbers.
const LESS_CERTAIN: f64 = 1.5;

impl Times {
    /// Takes a record of samples that come at `rate_hz` nominally; after a step (`stepped`) what was before counts for what was
    /// before alone.
    pub fn note(&mut self, time: Time, stepped: bool, rate_hz: f64) {
        if let Some(ends) = self.newest.filter(|newest| newest.index < time.index)
            && rate_hz > 0.0
        {
            let (utc_us, sd_s) = along(&ends, time.index, rate_hz);
            let told_sd_s = f64::from(time.sd_s);
            let off_s = 1e-6 * utc_us.wrapping_sub(time.utc_us) as f64;
            // What the recorder itself would have refused is a step, whether that was heard or not.
            let variance = sd_s * sd_s + told_sd_s * told_sd_s + ROUNDED_S * ROUNDED_S;
            let stepped = stepped || off_s * off_s > GATE * GATE * variance;
            if stepped || told_sd_s > LESS_CERTAIN * sd_s {
                if let Some(oldest) = self.broken[0] {
                    self.forgotten = oldest.begins.index;
                }
                self.broken.rotate_left(1);
                self.broken[BREAKS - 1] = Some(Break { ends, begins: time, stepped });
            }
        }
        self.before = self.newest.filter(|newest| newest.index < time.index && !stepped);
        self.newest = Some(time);
    }

    /// UTC of a sample, microseconds since 1970, and its standard deviation in seconds; `None` while nothing is known, and
    /// of samples from before the oldest break that is remembered.
    pub fn utc(&self, index: u64, rate_hz: f64) -> Option<(i64, f64)> {
        let newest = self.newest.filter(|_| index >= self.forgotten)?;
        let broken = self.broken.iter().flatten().find(|broken| index < broken.begins.index);
        if let Some(Break { ends, begins, stepped }) = broken {
            let outside = *stepped || index <= ends.index;
            let on =
                if outside { along(ends, index, rate_hz) } else { between(ends, begins, index, rate_hz) };
            return Some(on);
        }
        match self.before {
            Some(before) if index < newest.index && index > before.index => {
                Some(between(&before, &newest, index, rate_hz))
            }
            Some(before) if index <= before.index => Some(along(&before, index, rate_hz)),
            _ => Some(along(&newest, index, rate_hz)),
        }
    }
}

/// UTC of a sample along the line of one record, µs since 1970, and its standard deviation, s.
pub fn along(time: &Time, index: u64, rate_hz: f64) -> (i64, f64) {
    let tau = seconds(time.index, index, rate_hz);
    let (sd, sd_drift) = (f64::from(time.sd_s), f64::from(time.sd_drift));
    let covariance = f64::from(time.correlation) * sd * sd_drift;
    let variance = sd * sd + tau * (2.0 * covariance + tau * sd_drift * sd_drift) + wandered(tau);
    let passed_us = 1e6 * tau * (1.0 + f64::from(time.drift));
    (time.utc_us.saturating_add(passed_us as i64), sqrt(variance.max(0.0)))
}

/// UTC on the straight line between two records. The ends' errors may be common to both; between them an integrated random
/// walk leaves the line through its ends by q L³ s² (1 − s)² / 3 in variance, at the share s of the length L.
fn between(a: &Time, b: &Time, index: u64, rate_hz: f64) -> (i64, f64) {
    let (length, from_a) = (seconds(a.index, b.index, rate_hz), seconds(a.index, index, rate_hz));
    let s = from_a / length;
    let passed_us = s * b.utc_us.wrapping_sub(a.utc_us) as f64;
    let ends = (1.0 - s) * f64::from(a.sd_s) + s * f64::from(b.sd_s);
    let bridge = s * (1.0 - s);
    let variance = ends * ends + wandered(length) * bridge * bridge;
    (a.utc_us.saturating_add(passed_us as i64), sqrt(variance))
}
