//! What the recorder says of a sea: azimuths, ranges and its own tracks, from its messages or its records.

use super::Place;
use super::curves::Curve;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::wire::{self, Message};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Share of a minute's posterior from which on a range is the minute's own.
const CHIEF: f64 = 0.5;
/// A range is a track's of the recorder if it is no farther off: that, and a share of the range.
const OWN_RANGE_M: (f64, f64) = (1_500.0, 0.05);
/// A track of the recorder is a curve's if it stands no farther from it, rad.
const OWN_AZIMUTH: f64 = 0.2;
/// Longest time from a range to the curve's nearest azimuth, s.
const NEAR_S: f64 = 150.0;

/// A tonal azimuth of a minute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// When it was heard, s.
    pub t_s: f64,
    /// Azimuth, rad.
    pub azimuth: f64,
    /// Its standard deviation, rad.
    pub sd: f64,
}

/// A range of a minute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// When it was heard, s.
    pub t_s: f64,
    /// Range, m.
    pub range_m: f64,
    /// Its standard deviation, m.
    pub sd_m: f64,
}

/// A straight course as the recorder told it last.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Told {
    cpa_time_s: f64,
    cpa_range_m: f64,
    heading: f64,
    speed_m_s: f64,
    starboard: bool,
}

impl Told {
    /// Range and azimuth at a time.
    fn at(&self, t_s: f64, sound_speed_m_s: f64) -> (f64, f64) {
        let (s, c) = self.heading.sin_cos();
        let side = if self.starboard { -self.cpa_range_m } else { self.cpa_range_m };
        let place = |t: f64| {
            let along = self.speed_m_s * (t - self.cpa_time_s);
            (side * c + along * s, -side * s + along * c)
        };
        let (x, y) = place(t_s);
        let (x, y) = place(t_s - x.hypot(y) / sound_speed_m_s);
        (x.hypot(y), x.atan2(y))
    }
}

/// Everything that was heard, in order of time.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// Detected tonal azimuths.
    pub directions: Vec<Direction>,
    /// Detected ranges that hold most of their minute's posterior.
    pub distances: Vec<Distance>,
    /// UTC of time 0, where it is known.
    pub start: Option<OffsetDateTime>,
    tracks: BTreeMap<u16, Told>,
}

impl Heard {
    /// Takes a message of the recorder.
    pub fn take(&mut self, message: &Message, rate_hz: f64) {
        let at = |index: u64| index as f64 / rate_hz;
        match message {
            Message::Azimuth(a) if a.detected && a.kind == 0 && a.sd.is_finite() => {
                self.directions.push(Direction {
                    t_s: at(a.index),
                    azimuth: f64::from(a.azimuth),
                    sd: f64::from(a.sd),
                });
            }
            Message::Range(r) if r.detected && f64::from(r.weight) >= CHIEF => {
                self.distances.push(Distance {
                    t_s: at(r.index),
                    range_m: f64::from(r.range_m),
                    sd_m: f64::from(r.sd_range_m),
                });
            }
            Message::Track(t) => {
                let told = Told {
                    cpa_time_s: t.cpa_time_s,
                    cpa_range_m: f64::from(t.cpa_range_m),
                    heading: f64::from(t.heading),
                    speed_m_s: f64::from(t.speed_m_s),
                    starboard: t.starboard,
                };
                self.told(t.id, told, t.stage != wire::Track::WITHDRAWN);
            }
            _ => {}
        }
    }

    fn told(&mut self, id: u16, told: Told, stands: bool) {
        if stands {
            self.tracks.insert(id, told);
        } else {
            self.tracks.remove(&id);
        }
    }

    /// Reads records of `process`, or of a base station: of the station of this number, where it is given; those that name none
    /// are any station's.
    ///
    /// # Errors
    /// The file cannot be read, holds no detected tonal azimuth, or holds several stations' and none is given.
    pub fn read(path: &Path, station: Option<u16>) -> Result<Self> {
        let name = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {name}"))?;
        let mut out = Self::default();
        let mut bad = 0usize;
        let mut stations = BTreeSet::new();
        for line in text.lines().filter(|l| !l.trim().is_empty()) {
            match serde_json::from_str::<Value>(line) {
                Ok(record) => match (record.get("station").and_then(Value::as_u64), station) {
                    (Some(id), Some(wanted)) if id != u64::from(wanted) => {}
                    (id, _) => {
                        // Of what says nothing here it does not matter whose it is.
                        if out.record(&record) {
                            stations.extend(id);
                        }
                    }
                },
                Err(_) => bad += 1,
            }
        }
        if bad > 0 {
            log::warn!("{name}: {bad} lines are no records");
        }
        if stations.len() > 1 {
            bail!(
                "{name}: records of stations {stations:?}: say whose vessels are wanted by --station STATION.toml"
            );
        }
        if out.directions.is_empty() {
            bail!("{name}: no detected tonal `azimuth` record of an ocean-bottom station");
        }
        out.directions.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        out.distances.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        Ok(out)
    }

    /// Takes a record; whether it says something here, as azimuths, ranges and tracks do.
    fn record(&mut self, record: &Value) -> bool {
        self.of_record(record).is_some()
    }

    fn of_record(&mut self, record: &Value) -> Option<()> {
        let number = |key: &str| record.get(key).and_then(Value::as_f64);
        let detected = record.get("detected").and_then(Value::as_bool) == Some(true);
        let t_s = number("t_s")?;
        if self.start.is_none()
            && let Some(utc) = record.get("utc").and_then(Value::as_str)
        {
            let before = time::Duration::checked_seconds_f64(t_s);
            self.start =
                OffsetDateTime::parse(utc, &Rfc3339).ok().zip(before).and_then(|(a, b)| a.checked_sub(b));
        }
        match record.get("type").and_then(Value::as_str) {
            Some("azimuth") if detected && record.get("source").is_none_or(|s| s == "tonal") => {
                let (azimuth, sd) = (number("azimuth_deg")?, number("sd_deg")?);
                let (azimuth, sd) = (azimuth * RAD_PER_DEG, sd * RAD_PER_DEG);
                self.directions.extend((sd > 0.0).then_some(Direction { t_s, azimuth, sd }));
            }
            Some("range") if detected && number("weight").is_none_or(|w| w >= CHIEF) => {
                let (range_m, sd_m) = (number("range_m")?, number("sd_range_m")?);
                self.distances.extend((sd_m > 0.0).then_some(Distance { t_s, range_m, sd_m }));
            }
            Some("track") => {
                let id = record.get("id").and_then(Value::as_u64).and_then(|id| u16::try_from(id).ok());
                let stands = record.get("stage").is_none_or(|s| s != "withdrawn");
                let told = || {
                    Some(Told {
                        cpa_time_s: number("cpa_time_s")?,
                        cpa_range_m: number("cpa_range_m")?,
                        heading: number("heading_deg")? * RAD_PER_DEG,
                        speed_m_s: number("speed_m_s")?,
                        starboard: record.get("side")? == "starboard",
                    })
                };
                if let Some((id, told)) = id.zip(told()) {
                    self.told(id, told, stands);
                }
            }
            _ => return None,
        }
        Some(())
    }

    /// Ranges of a curve's vessel, and the recorder's tracks of it: a range is the curve's where a track explains it that stands where the curve does.
    pub(super) fn of_curve(&self, curve: &Curve, place: &Place<'_>) -> (Vec<Distance>, Vec<u16>) {
        let (mut distances, mut ids) = (Vec::new(), Vec::new());
        for d in &self.distances {
            let Some(own) = curve.near(d.t_s, NEAR_S) else { continue };
            let explains = |told: &Told| {
                let (range_m, azimuth) = told.at(d.t_s, place.sound_speed_m_s);
                let most_m = OWN_RANGE_M.0 + OWN_RANGE_M.1 * d.range_m;
                (range_m - d.range_m).abs() < most_m && wrap_pi(azimuth - own.azimuth).abs() < OWN_AZIMUTH
            };
            let Some((id, _)) = self.tracks.iter().find(|(_, told)| explains(told)) else { continue };
            distances.push(*d);
            if !ids.contains(id) {
                ids.push(*id);
            }
        }
        (distances, ids)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_and_messages_say_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.jsonl");
        let text = r#"{"type":"hello","wire_version":1}
{"type":"azimuth","t_s":120.0,"utc":"2024-05-01T09:02:00Z","azimuth_deg":90.0,"sd_deg":0.5,"weight":1.0,"detected":true,"source":"tonal"}
{"type":"azimuth","t_s":60.0,"azimuth_deg":80.0,"sd_deg":1.0,"weight":1.0,"detected":true,"source":"tonal"}
{"type":"azimuth","t_s":60.0,"azimuth_deg":80.0,"sd_deg":1.0,"weight":1.0,"detected":true,"source":"impulsive"}
{"type":"range","t_s":60.0,"range_m":7000.0,"sd_range_m":40.0,"weight":0.7,"detected":true}
{"type":"range","t_s":60.0,"range_m":14000.0,"sd_range_m":40.0,"weight":0.3,"detected":true}
not a record
"#;
        std::fs::write(&path, text).unwrap();
        let read = Heard::read(&path, None).unwrap();
        assert_eq!(read.directions.iter().map(|d| d.t_s).collect::<Vec<_>>(), [60.0, 120.0]);
        assert_eq!(read.distances, [Distance { t_s: 60.0, range_m: 7000.0, sd_m: 40.0 }]);
        assert_eq!(read.start, Some(time::macros::datetime!(2024-05-01 09:00 UTC)));
        let mut told = Heard::default();
        let azimuth = wire::Azimuth {
            index: 3000,
            azimuth: 80f32.to_radians(),
            sd: 1f32.to_radians(),
            log_presence: 20.0,
            weight: 1.0,
            detected: true,
            kind: 0,
        };
        told.take(&Message::Azimuth(azimuth), 50.0);
        told.take(&Message::Azimuth(wire::Azimuth { kind: 1, ..azimuth }), 50.0);
        let [one] = told.directions[..] else { panic!("{told:?}") };
        assert!((one.azimuth - read.directions[0].azimuth).abs() < 1e-6 && one.t_s == 60.0);
        std::fs::write(&path, "{\"type\":\"hello\"}\n").unwrap();
        assert!(Heard::read(&path, None).is_err());
    }

    #[test]
    fn records_of_two_stations_are_not_one_stations() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.jsonl");
        let azimuth = |station: u32, t: u32| {
            format!(
                "{{\"type\":\"azimuth\",\"station\":{station},\"t_s\":{t},\"azimuth_deg\":80.0,\"sd_deg\":1.0,\"detected\":true}}\n"
            )
        };
        std::fs::write(&path, azimuth(3, 60) + &azimuth(4, 60) + &azimuth(4, 120)).unwrap();
        let said = Heard::read(&path, None).unwrap_err().to_string();
        assert!(said.contains("stations {3, 4}") && said.contains("--station"), "{said}");
        assert_eq!(Heard::read(&path, Some(4)).unwrap().directions.len(), 2);
        assert!(Heard::read(&path, Some(5)).is_err());
    }

    #[test]
    fn a_course_passes_its_closest_point() {
        let told =
            Told { cpa_time_s: 1000.0, cpa_range_m: 9000.0, heading: 0.5, speed_m_s: 7.0, starboard: true };
        let (range_m, azimuth) = told.at(1006.0, 1500.0);
        assert!((range_m - 9000.0).abs() < 1.0);
        // The station lies to starboard: the vessel is seen a quarter turn to port of where it goes.
        assert!(wrap_pi(azimuth - (0.5 - std::f64::consts::FRAC_PI_2)).abs() < 1e-3);
    }
}
