//! Records: what the recorder's messages look like to people and other programs (JSON Lines, degrees).

mod kinds;
mod margins;
#[cfg(feature = "schema")]
mod schema;
mod sound;
mod transient;
mod warning;

pub use kinds::{Closest, Kind, Level, Member, NetworkTrack};
pub use margins::Margins;
#[cfg(feature = "schema")]
pub use schema::schema;
pub use sound::{Azigram, Samples, Snippet, Spectrum, calibrate};
pub use transient::Transient;
pub use warning::Warning;

use crate::replay::Said;
use seabearing_core::utc::Times;
use seabearing_core::wire::Message;
use serde_json::{Map, Value, json};

/// Turns messages into JSON records; knows the sample rate and, where there is one, the recording's clock.
#[derive(Debug, Clone)]
pub struct RecordFormat {
    /// Samples a second.
    pub rate_hz: f64,
    /// UTC of sample 0, where known.
    pub start: Option<time::OffsetDateTime>,
    /// What the recorder itself says of UTC; it goes before `start`.
    pub times: Times,
}

impl RecordFormat {
    /// Seconds since sample 0.
    pub fn t_s(&self, index: u64) -> f64 {
        index as f64 / self.rate_hz
    }

    /// UTC of a time since sample 0 as RFC 3339, where the recording has a clock.
    pub fn utc(&self, t_s: f64) -> Option<String> {
        let at = match self.told(t_s) {
            Some((us, _)) => time::OffsetDateTime::from_unix_timestamp_nanos(i128::from(us) * 1000).ok()?,
            // Without a rate there is no time, and an index may be any number.
            None => self.start?.checked_add(time::Duration::checked_seconds_f64(t_s)?)?,
        };
        Some(utc(at)).filter(|text| !text.is_empty())
    }

    /// UTC of a time since sample 0 as the recorder tells it, microseconds since 1970, and its standard deviation, s.
    fn told(&self, t_s: f64) -> Option<(i64, f64)> {
        self.times.utc((t_s * self.rate_hz).round() as u64, self.rate_hz)
    }

    /// The record of one message.
    pub fn json(&self, message: &Message) -> Value {
        let (index, kind) = Kind::of(message, |index| self.t_s(index));
        self.record(index, kind)
    }

    /// The record of what a replay says.
    pub fn said(&self, said: Said<'_>) -> Value {
        match said {
            Said::Message(message) => self.json(message),
            Said::Level(index, level) => self.record(Some(index), Kind::Level(level.clone())),
        }
    }

    /// The record of a kind about a sample.
    pub fn record(&self, index: Option<u64>, kind: Kind) -> Value {
        // Kinds hold numbers and texts alone, which JSON takes.
        let Ok(Value::Object(body)) = serde_json::to_value(kind) else { return Value::Null };
        let mut out = Map::new();
        out.insert("type".into(), body.get("type").cloned().unwrap_or_default());
        if let Some(index) = index {
            let t = self.t_s(index);
            out.insert("t_s".into(), json!(t));
            if let Some(utc) = self.utc(t) {
                out.insert("utc".into(), utc.into());
                if let Some((_, sd_s)) = self.told(t) {
                    out.insert("sd_utc_s".into(), json!(sd_s));
                }
            }
        }
        out.extend(body);
        Value::Object(out)
    }
}

/// A time as records tell it, RFC 3339; empty where that has no such year.
pub fn utc(at: time::OffsetDateTime) -> String {
    at.format(&time::format_description::well_known::Rfc3339).unwrap_or_default()
}

/// JSON has no infinity: what is not observable is `null`.
pub fn finite(x: f64) -> Value {
    if x.is_finite() { json!(x) } else { Value::Null }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::wire::{Azimuth, Range, Time};

    #[test]
    fn what_the_recorder_says_of_utc_dates_its_records_with_an_uncertainty() {
        let mut records = RecordFormat { rate_hz: 50.0, start: None, times: Times::default() };
        let end = Message::End(seabearing_core::wire::End { index: 100, frames: 0 });
        assert!(records.json(&end)["utc"].is_null());
        let time = Time {
            index: 50,
            utc_us: 1_790_000_000_250_000,
            sd_s: 0.25,
            drift: 0.5e-3,
            sd_drift: 0.0,
            correlation: 0.0,
        };
        records.times.note(time, false, 50.0);
        let record = records.json(&end);
        assert_eq!(record["utc"], "2026-09-21T14:13:21.2505Z");
        assert_eq!(record["sd_utc_s"], 0.25);
    }

    #[test]
    fn what_was_not_detected_has_no_value() {
        let records = RecordFormat { rate_hz: 50.0, start: None, times: Times::default() };
        let none = f32::INFINITY;
        let azimuth = Azimuth {
            index: 3000,
            azimuth: 0.0,
            sd: none,
            log_presence: -3.0,
            weight: 0.0,
            detected: false,
            kind: 0,
        };
        let range = Range {
            index: 3000,
            range_m: 0.0,
            sd_range_m: none,
            speed_m_s: 0.0,
            sd_speed_m_s: none,
            log_presence: -3.0,
            weight: 0.0,
            detected: false,
        };
        let a = records.json(&Message::Azimuth(azimuth));
        assert!(a["azimuth_deg"].is_null() && a["detected"] == false, "{a}");
        let r = records.json(&Message::Range(range));
        assert!(r["range_m"].is_null() && r["speed_m_s"].is_null(), "{r}");
        let a = records.json(&Message::Azimuth(Azimuth { sd: 0.02, detected: true, ..azimuth }));
        assert_eq!(a["azimuth_deg"], 0.0);
    }
}
