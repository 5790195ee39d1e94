//! Records: what the recorder's messages look like to people and other programs (JSON Lines, degrees).

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
        let deg = |x: f32| finite(f64::from(x).to_degrees());
        let num = |x: f32| finite(f64::from(x));
        let (kind, index, body) = match message {
            Message::Hello(h) => (
                "hello",
                None,
                json!({
                    "wire_version": h.wire_version, "schema_hash": format!("{:016x}", h.schema_hash),
                    "config_hash": format!("{:016x}", h.config_hash),
                    "version": format!("{}.{}.{}", h.version.0, h.version.1, h.version.2),
                    "station": h.station, "kind": match h.kind { 0 => "array", 1 => "obs", _ => "waiting" },
                    "rate_hz": num(h.rate_hz), "reset_cause": h.reset_cause,
                }),
            ),
            Message::Bearing(b) => (
                "bearing",
                Some(b.index),
                json!({
                    "azimuth_deg": deg(b.azimuth), "elevation_deg": deg(b.elevation),
                    "sd_azimuth_deg": deg(b.var_azimuth.sqrt()), "sd_elevation_deg": deg(b.var_elevation.sqrt()),
                    "cov_deg2": finite(f64::from(b.cov) * 1f64.to_degrees().powi(2)),
                    "snr_db": num(b.snr_db), "quality": num(b.quality), "closure_s": num(b.closure_s),
                    "statistic": num(b.statistic), "band": b.band, "flags": b.flags,
                }),
            ),
            Message::Track(t) => (
                "track",
                Some(t.index),
                json!({
                    "id": t.id, "stage": if t.stage == 0 { "running" } else { "final" },
                    "cpa_time_s": finite(t.cpa_time_s), "cpa_range_m": num(t.cpa_range_m),
                    "cpa_azimuth_deg": deg(t.cpa_azimuth), "heading_deg": deg(t.heading),
                    "speed_m_s": num(t.speed_m_s), "side": if t.starboard { "starboard" } else { "port" },
                    "sd_cpa_time_s": num(t.sd_cpa_time_s), "sd_cpa_range_m": num(t.sd_cpa_range_m),
                    "sd_heading_deg": deg(t.sd_heading), "sd_speed_m_s": num(t.sd_speed_m_s),
                    "x_m": num(t.x_m), "y_m": num(t.y_m), "var_x_m2": num(t.var_x_m2),
                    "var_y_m2": num(t.var_y_m2), "cov_xy_m2": num(t.cov_xy_m2),
                    "range_observable": t.range_observable, "n": t.n,
                }),
            ),
            Message::Health(h) => (
                "health",
                Some(h.index),
                json!({
                    "processed": h.processed, "lost_gap": h.lost[0], "lost_overlap": h.lost[1],
                    "lost_invalid": h.lost[2], "lost_clipped": h.lost[3], "lost_dead_channel": h.lost[4],
                    "lost_remainder": h.lost[5],
                    "dead_channels": (0..4).filter(|c| h.channels >> c & 1 == 1).collect::<Vec<_>>(),
                    "clipping_channels": (0..4).filter(|c| h.channels >> (4 + c) & 1 == 1).collect::<Vec<_>>(),
                    "level_db_full_scale": h.level_half_db.map(|l| f64::from(l) / 2.0),
                    "records": h.records, "frames_dropped": h.frames_dropped,
                }),
            ),
            Message::Azimuth(a) => (
                "azimuth",
                Some(a.index),
                // Without a spread there is no azimuth: a minute in which nothing was detected.
                json!({
                    "azimuth_deg": a.sd.is_finite().then(|| deg(a.azimuth)), "sd_deg": deg(a.sd), "log_presence": num(a.log_presence),
                    "weight": num(a.weight), "detected": a.detected,
                    "source": if a.kind == 0 { "tonal" } else { "impulsive" },
                }),
            ),
            Message::Range(r) => (
                "range",
                Some(r.index),
                json!({
                    "range_m": r.sd_range_m.is_finite().then(|| num(r.range_m)), "sd_range_m": num(r.sd_range_m),
                    "speed_m_s": r.sd_speed_m_s.is_finite().then(|| num(r.speed_m_s)),
                    "sd_speed_m_s": num(r.sd_speed_m_s), "log_presence": num(r.log_presence),
                    "weight": num(r.weight), "detected": r.detected,
                }),
            ),
            Message::Segment(s) => (
                "segment",
                Some(s.end),
                json!({
                    "id": s.id, "start_s": self.t_s(s.start), "end_s": self.t_s(s.end),
                    "turn_s": s.turn.map(|t| self.t_s(t)),
                    "kind": match s.kind { 1 => "approaching", 2 => "leaving", _ => "general" },
                    "log_evidence": num(s.log_evidence),
                }),
            ),
            Message::Fault(f) => {
                ("fault", Some(f.index), json!({ "code": format!("{:?}", f.code), "value": f.value }))
            }
            Message::FaultsHeld(f) => (
                "faults_held",
                Some(f.index),
                json!({ "code": format!("{:?}", f.code), "count": f.count, "value": f.value }),
            ),
            Message::Reply(r) => ("reply", None, json!({ "token": r.token, "status": r.status })),
            Message::ShaftRate(s) => (
                "shaft_rate",
                Some(s.index),
                json!({
                    "rate_hz": num(s.rate_hz), "sd_hz": num(s.sd_hz), "confidence": num(s.confidence),
                    "ln_false_alarm": num(s.ln_false_alarm), "harmonics": s.harmonics,
                    "blades": (s.blades > 0).then_some(s.blades), "speed_m_s": num(s.speed_m_s),
                    "sd_speed_m_s": num(s.sd_speed_m_s), "track": (s.track > 0).then_some(s.track),
                }),
            ),
            Message::Time(t) => (
                "time",
                Some(t.index),
                json!({
                    "sd_utc_s": num(t.sd_s), "drift_ppm": finite(f64::from(t.drift) * 1e6),
                    "sd_drift_ppm": finite(f64::from(t.sd_drift) * 1e6),
                }),
            ),
            Message::End(e) => ("end", Some(e.index), json!({ "frames": e.frames })),
        };
        let mut out = Map::new();
        out.insert("type".into(), kind.into());
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
        if let Value::Object(body) = body {
            out.extend(body);
        }
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
        records.times.note(time, false);
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
