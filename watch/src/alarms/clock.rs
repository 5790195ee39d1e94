//! Whether a recorder's UTC can be relied on: it is known, known well, and near this computer's.

use super::rules::ClockRule;
use super::truth::Truth;
use crate::report::{rfc3339, utc};
use serde_json::Value;

/// A clock is sure again below so much of a limit.
const SURE: f64 = 0.8;
/// A record that is dated so much later than it came, s, has a wrong date: none comes before it was made.
const AHEAD_S: f64 = 60.0;
/// 2020-01-01, s since 1970: a computer whose clock says less has not been told the time yet.
const SET_S: f64 = 1_577_836_800.0;

/// What is known of a recorder's clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clock {
    /// When a record came with UTC last, or the first one without, s.
    known_s: Option<f64>,
    /// The newest record that should have UTC had none.
    without: bool,
    /// Standard deviation told last, s.
    sd_s: Option<f64>,
    /// How much later than its date the newest record came whose date is right where the clock is, s; and that date.
    late: Option<(f64, f64)>,
    /// It has stepped by so much, microseconds, and has not told its deviation since.
    stepped_us: Option<i64>,
}

impl Clock {
    /// Takes a record of the recorder at a time; false where it tells nothing of its clock. `compares`: what comes is of now.
    pub(super) fn take(&mut self, kind: &str, record: &Value, now_s: f64, compares: bool) -> bool {
        if kind == "fault" && record["code"] == "ClockStepped" {
            self.stepped_us = record["value"].as_i64();
            return true;
        }
        let (dated, sd_s) = (utc(&record["utc"]), record["sd_utc_s"].as_f64());
        let is_known = dated.is_some() || (kind == "time" && sd_s.is_some());
        if !is_known && record["t_s"].is_null() {
            // It is of no moment.
            return false;
        }
        self.without = !is_known;
        if self.known_s.is_none() || is_known {
            self.known_s = Some(now_s);
        }
        match kind {
            "time" => (self.sd_s, self.stepped_us) = (sd_s.or(self.sd_s), None),
            "health" => {}
            _ => return self.without,
        }
        let came_s = utc(&record["received_utc"]).unwrap_or(now_s);
        if let Some(dated_s) = dated.filter(|_| compares && came_s >= SET_S) {
            self.late = Some((came_s - dated_s, dated_s));
        }
        true
    }

    /// What is so of a rule.
    pub(super) fn judge(&self, station: u16, rule: &ClockRule, now_s: f64) -> Truth {
        let utc = |t_s: f64| rfc3339(t_s.floor()).as_str().unwrap_or("?").to_owned();
        let sd_s = self.sd_s.filter(|_| !self.without).unwrap_or(0.0);
        let (late_s, dated_s) = self.late.filter(|_| !self.without).unwrap_or((0.0, 0.0));
        let known_s = self.known_s.unwrap_or(now_s);
        let beyond = |share: f64| late_s > share * rule.off_s || -late_s > share * AHEAD_S.min(rule.off_s);
        if let Some(us) = self.stepped_us {
            let text = format!("station {station}: its clock has stepped by {us} µs");
            Truth::yes("ClockUnsure", text)
        } else if self.without && now_s - known_s > rule.without_s {
            let text = format!("station {station}: its records have had no UTC since {}", utc(known_s));
            Truth::yes("ClockMissing", text)
        } else if beyond(1.0) {
            let (by, side) = (span(late_s.abs()), if late_s > 0.0 { "behind" } else { "ahead of" });
            let text = format!(
                "station {station}: its UTC ({}) is {by} {side} this computer's clock: one of both is wrong",
                utc(dated_s)
            );
            Truth::yes("ClockWrong", text)
        } else if sd_s > rule.sd_s {
            let text =
                format!("station {station}: UTC is known to {sd_s:.3} s, the limit is {} s", rule.sd_s);
            Truth::yes("ClockUnsure", text)
        } else if self.without || beyond(SURE) || sd_s >= SURE * rule.sd_s {
            Truth::unknown()
        } else {
            Truth::over("UTC is sure again")
        }
    }
}

/// A length of time as a person says it.
fn span(seconds: f64) -> String {
    let units = [(31_557_600.0, "years"), (86_400.0, "days"), (3600.0, "hours"), (60.0, "minutes")];
    let of = units.into_iter().find(|(unit, _)| seconds >= 2.0 * unit).unwrap_or((1.0, "s"));
    format!("{:.0} {}", seconds / of.0, of.1)
}
