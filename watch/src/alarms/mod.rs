//! Alarms: raised once, acknowledged by a person, cleared once.
//!
//! In: records as they are stored, and the time. Out: records `{"type":"alarm","state":"raised|acknowledged|cleared",..}`. A
//! vessel counts by the probability that it is where the rule says, given its covariance; a track whose range is not
//! observable is nowhere. What is true again before it has been untrue for `clear_after_s` was true all the time.

pub mod area;
pub mod deliver;
pub mod rules;

use crate::report::{Covariance, TrackId, TrackReport, is_of_recorder};
use area::{is_inside, share};
use rules::{Condition, Rule};
use seabearing_host::geodesy::LocalFrame;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// A track that says nothing for so long has ended, s.
const TRACK_ENDS_S: f64 = 120.0;
/// A disk has room again with so many times the room at which that was told.
const ROOM_AGAIN: f64 = 1.1;
/// What a store adds to a record.
const OF_THE_STORE: [&str; 5] = ["utc", "sd_utc_s", "received_utc", "session", "sequence"];

/// What an alarm is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum About {
    /// This base station itself.
    Base,
    Track(TrackId),
    Station(u16),
    Channel(u16, u8),
}

/// An alarm that is raised.
#[derive(Clone, Debug)]
struct Raised {
    id: u64,
    acknowledged: bool,
    /// Since when it is not true any more.
    untrue_s: Option<f64>,
    /// When a track was heard of last.
    heard_s: f64,
    record: Value,
}

/// Watches records.
pub struct Watcher {
    rules: Vec<Rule>,
    /// Corners of a rule's area in a station's frame.
    corners: BTreeMap<(usize, u16), Vec<(f64, f64)>>,
    heard_s: BTreeMap<u16, f64>,
    raised: BTreeMap<(usize, About), Raised>,
    newest_id: u64,
    /// The store takes nothing.
    fails: bool,
}

impl Watcher {
    /// Watches these stations (latitude and longitude in degrees, where known) from `now_s` on, seconds since 1970.
    pub fn new(rules: Vec<Rule>, stations: &BTreeMap<u16, Option<(f64, f64)>>, now_s: f64) -> Self {
        let frames: BTreeMap<u16, LocalFrame> = stations
            .iter()
            .filter_map(|(of, at)| at.map(|(lat, lon)| (*of, LocalFrame::new(lat, lon))))
            .collect();
        let mut corners = BTreeMap::new();
        for (n, rule) in rules.iter().enumerate() {
            let Condition::Inside(area) = &rule.condition else { continue };
            corners.extend(frames.iter().map(|(of, frame)| ((n, *of), area.corners_m(frame))));
        }
        let heard_s = stations.keys().map(|of| (*of, now_s)).collect();
        Self { rules, corners, heard_s, raised: BTreeMap::new(), newest_id: 0, fails: false }
    }

    /// Takes a record at a time; gives the alarms that change.
    pub fn take(&mut self, record: &Value, now_s: f64) -> Vec<Value> {
        let mut out = Vec::new();
        let kind = record["type"].as_str().unwrap_or("");
        if kind == "note" {
            return self.store(
                record["code"].as_str().unwrap_or(""),
                record["text"].as_str().unwrap_or(""),
                now_s,
            );
        }
        let Some(station) = record["station"].as_u64().and_then(|n| u16::try_from(n).ok()) else {
            return out;
        };
        if is_of_recorder(kind) {
            self.heard_s.insert(station, now_s);
        }
        for n in 0..self.rules.len() {
            let rule = &self.rules[n];
            if rule.stations.is_empty() || rule.stations.contains(&station) {
                for (about, truth) in self.judge(n, station, kind, record, now_s) {
                    out.extend(self.note(n, about, truth, now_s));
                }
            }
        }
        out
    }

    /// The store takes nothing, or takes records again.
    fn store(&mut self, code: &str, text: &str, now_s: f64) -> Vec<Value> {
        let truth = || match code {
            "StoreFails" => Some(Truth::yes("StoreFails", text.to_owned())),
            "StoreTakes" => Some(Truth::over("the store takes records again")),
            _ => None,
        };
        self.fails = if truth().is_some() { code == "StoreFails" } else { self.fails };
        let rules =
            (0..self.rules.len()).filter(|n| matches!(self.rules[*n].condition, Condition::Disk { .. }));
        rules
            .collect::<Vec<_>>()
            .into_iter()
            .filter_map(|n| self.note(n, About::Base, truth()?, now_s))
            .collect()
    }

    /// Whether any rule asks for the room on the store's disk.
    pub fn asks_for_disk(&self) -> bool {
        self.rules.iter().any(|rule| matches!(rule.condition, Condition::Disk { .. }))
    }

    /// Takes how much of the store's disk is free, and how large it is, bytes.
    pub fn disk(&mut self, free: u64, total: u64, now_s: f64) -> Vec<Value> {
        let mut out = Vec::new();
        let (mb, percent) = (free as f64 * 1e-6, 100.0 * free as f64 / (total as f64).max(1.0));
        for n in 0..self.rules.len() {
            let Condition::Disk { free_mb, free_percent } = self.rules[n].condition else { continue };
            let below = |times: f64| {
                free_mb.is_some_and(|least| mb < times * least)
                    || free_percent.is_some_and(|least| percent < times * least)
            };
            let truth = if below(1.0) {
                let text = format!("the disk of the store has {mb:.0} MB free, {percent:.1} % of it");
                Truth::yes("DiskLow", text)
            } else if below(ROOM_AGAIN) || self.fails {
                Truth::unknown()
            } else {
                Truth::over("there is room again")
            };
            out.extend(self.note(n, About::Base, truth, now_s));
        }
        out
    }

    /// Looks at what time alone changes.
    pub fn tick(&mut self, now_s: f64) -> Vec<Value> {
        let mut out = Vec::new();
        for n in 0..self.rules.len() {
            let Condition::Silent(after_s) = self.rules[n].condition else { continue };
            for (station, heard_s) in self.heard_s.clone() {
                let of = &self.rules[n].stations;
                let silent = now_s - heard_s;
                if (of.is_empty() || of.contains(&station)) && silent > after_s {
                    let text = format!("station {station} has not been heard for {silent:.0} s");
                    out.extend(self.note(
                        n,
                        About::Station(station),
                        Truth::yes("RecorderSilent", text),
                        now_s,
                    ));
                }
            }
        }
        let stale: Vec<(usize, About)> = self
            .raised
            .iter()
            .filter(|((_, about), raised)| {
                matches!(about, About::Track(_)) && now_s - raised.heard_s > TRACK_ENDS_S
            })
            .map(|(key, _)| *key)
            .collect();
        for (n, about) in stale {
            out.extend(self.note(n, about, Truth::over("its track has ended"), now_s));
        }
        let due: Vec<(usize, About)> = self
            .raised
            .iter()
            .filter(|((n, _), raised)| {
                raised.untrue_s.is_some_and(|t| now_s - t >= self.rules[*n].clear_after_s)
            })
            .map(|(key, _)| *key)
            .collect();
        for key in due {
            out.extend(self.raised.remove(&key).map(|raised| state(&raised, "cleared")));
        }
        out
    }

    /// A person has seen an alarm.
    pub fn acknowledge(&mut self, id: u64) -> Option<Value> {
        let raised = self.raised.values_mut().find(|raised| raised.id == id && !raised.acknowledged)?;
        raised.acknowledged = true;
        Some(state(raised, "acknowledged"))
    }

    /// Alarms that are raised now, and how many of them nobody has seen.
    pub fn standing(&self) -> (usize, usize) {
        (self.raised.len(), self.raised.values().filter(|r| !r.acknowledged).count())
    }

    /// Takes up what stood when a base station ended before: its alarm records, oldest first. Gives those that are cleared, as
    /// there is no such rule any more, or it is about other stations now.
    pub fn resume(&mut self, records: &[Value], now_s: f64) -> Vec<Value> {
        let mut out = Vec::new();
        let over = |record: &Value| {
            let mut record = anew(record);
            record["state"] = "cleared".into();
            record
        };
        let newest: BTreeMap<u64, &Value> =
            records.iter().filter_map(|r| Some((r["id"].as_u64()?, r))).collect();
        for (id, record) in newest.into_iter().filter(|(_, r)| r["state"] != "cleared") {
            self.newest_id = self.newest_id.max(id);
            let Some(n) = self.rules.iter().position(|rule| record["name"] == rule.name.as_str()) else {
                out.push(over(record));
                continue;
            };
            let station = record["station"].as_u64().and_then(|s| u16::try_from(s).ok());
            let base = matches!(self.rules[n].condition, Condition::Disk { .. });
            let Some(station) = station.or(base.then_some(0)) else { continue };
            let of = &self.rules[n].stations;
            if !base && !of.is_empty() && !of.contains(&station) {
                out.push(over(record));
                continue;
            }
            let number = |key: &str| record[key].as_u64();
            let about = match (number("track"), number("channel")) {
                (Some(track), _) => About::Track(TrackId {
                    station: Some(station),
                    session: number("of_session").and_then(|s| u32::try_from(s).ok()),
                    id: track as u16,
                }),
                (_, Some(channel)) => About::Channel(station, channel as u8),
                _ if base => About::Base,
                _ => About::Station(station),
            };
            let acknowledged = record["state"] == "acknowledged";
            let raised = Raised { id, acknowledged, untrue_s: None, heard_s: now_s, record: anew(record) };
            // Of two of one name, as a version before left them, the later one goes on.
            out.extend(self.raised.insert((n, about), raised).map(|before| over(&before.record)));
        }
        out
    }

    /// What a record says of a rule.
    fn judge(&self, n: usize, station: u16, kind: &str, record: &Value, now_s: f64) -> Vec<(About, Truth)> {
        let (rule, here) = (&self.rules[n], About::Station(station));
        let fault = if kind == "fault" { record["code"].as_str().unwrap_or("") } else { "" };
        match &rule.condition {
            Condition::Inside(_) | Condition::Range(_) | Condition::Approach { .. } => {
                let Some(report) = TrackReport::of(record) else { return Vec::new() };
                vec![(About::Track(report.track), self.vessel(n, station, &report, now_s))]
            }
            Condition::Silent(_) if !is_of_recorder(kind) => Vec::new(),
            Condition::Silent(_) => vec![(here, Truth::over("it is heard again"))],
            Condition::Channel => channels(station, kind, fault, record),
            Condition::Clock(limit_s) => match (kind, fault, record["sd_utc_s"].as_f64()) {
                (_, "ClockStepped", _) => {
                    let text = format!("station {station}: its clock has stepped by {} µs", record["value"]);
                    vec![(here, Truth::yes("ClockUnsure", text))]
                }
                ("time", _, Some(sd)) if sd > *limit_s => {
                    let text =
                        format!("station {station}: UTC is known to {sd:.3} s, the limit is {limit_s} s");
                    vec![(here, Truth::yes("ClockUnsure", text))]
                }
                ("time", _, Some(sd)) if sd < 0.8 * limit_s => vec![(here, Truth::over("UTC is sure again"))],
                _ => Vec::new(),
            },
            Condition::Supply => match (kind, fault) {
                (_, "SupplyLow") => {
                    let text = format!("station {station}: the supply is below {} mV", record["value"]);
                    vec![(here, Truth::yes("SupplyLow", text))]
                }
                // It records again.
                ("hello" | "bearing" | "azimuth", _) => vec![(here, Truth::over("it records again"))],
                _ => Vec::new(),
            },
            Condition::Storage if kind == "lost" && record["cause"].is_string() => {
                let text = format!(
                    "station {station}: {} records lost: {}",
                    record["frames"],
                    record["cause"].as_str().unwrap_or("")
                );
                vec![(here, Truth::yes("StorageFull", text))]
            }
            // Nothing says that there is room: it is over when nothing is lost any more.
            Condition::Storage if kind != "alarm" => vec![(here, Truth::over("nothing is lost any more"))],
            Condition::Storage | Condition::Disk { .. } => Vec::new(),
        }
    }

    /// What a track's report says of a rule about vessels.
    fn vessel(&self, n: usize, station: u16, report: &TrackReport, now_s: f64) -> Truth {
        if report.is_withdrawn || report.is_final {
            return Truth::over("its track has ended");
        }
        let rule = &self.rules[n];
        let (probability, what, code) = match &rule.condition {
            Condition::Inside(_) => {
                let Some(((place, covariance), corners)) = report.place.zip(self.corners.get(&(n, station)))
                else {
                    return Truth::unknown();
                };
                let p = share(place, &covariance, |at| is_inside(corners, at));
                (p, format!("is inside {}", rule.name), "VesselInside")
            }
            Condition::Range(range_m) => {
                let Some((place, covariance)) = report.place else { return Truth::unknown() };
                let p = share(place, &covariance, |(x, y)| x.hypot(y) <= *range_m);
                (p, format!("is within {range_m:.0} m"), "VesselNear")
            }
            Condition::Approach { distance_m, within_s } => {
                let (Some((cpa_s, _)), Some((range_m, sd_m))) = (report.cpa_utc_s, report.cpa_range_m) else {
                    return Truth::unknown();
                };
                let ahead = cpa_s - report.utc_s.map_or(now_s, |(t_s, _)| t_s);
                if !(0.0..=*within_s).contains(&ahead) {
                    return Truth::over("its closest point has passed, or is further off");
                }
                let spread = Covariance { xx: sd_m * sd_m, yy: 0.0, xy: 0.0 };
                let p = share((range_m, 0.0), &spread, |(r, _)| r <= *distance_m);
                (p, format!("will pass at {range_m:.0} m in {ahead:.0} s"), "VesselApproaches")
            }
            _ => return Truth::unknown(),
        };
        if probability >= rule.probability {
            let text = format!("vessel {}: it {what}, with probability {probability:.2}", report.track);
            Truth { is: Some(true), code, text, probability: Some(probability) }
        } else if probability < rule.clear_probability {
            Truth::over("it is outside")
        } else {
            Truth::unknown()
        }
    }

    /// Notes what is so; gives the record of a new alarm.
    fn note(&mut self, n: usize, about: About, truth: Truth, now_s: f64) -> Option<Value> {
        if let Some(raised) = self.raised.get_mut(&(n, about)) {
            if !matches!(truth.text.as_str(), "its track has ended") {
                raised.heard_s = now_s;
            }
            match truth.is {
                Some(true) => raised.untrue_s = None,
                Some(false) => drop(raised.untrue_s.get_or_insert(now_s)),
                None => {}
            }
            return None;
        }
        if truth.is != Some(true) {
            return None;
        }
        // The time in microseconds, so that no two are alike, of one run or of two.
        self.newest_id = (self.newest_id + 1).max((now_s * 1e6) as u64);
        let (station, track, channel) = match about {
            About::Base => (None, None, None),
            About::Track(track) => (track.station, Some(track), None),
            About::Station(station) => (Some(station), None, None),
            About::Channel(station, channel) => (Some(station), None, Some(channel)),
        };
        let record = json!({
            "type": "alarm", "id": self.newest_id, "code": truth.code, "name": self.rules[n].name, "state": "raised",
            "station": station, "track": track.map(|t| t.id), "of_session": track.and_then(|t| t.session),
            "channel": channel, "probability": truth.probability, "text": truth.text,
        });
        let raised = Raised {
            id: self.newest_id,
            acknowledged: false,
            untrue_s: None,
            heard_s: now_s,
            record: record.clone(),
        };
        self.raised.insert((n, about), raised);
        Some(record)
    }
}

/// A record of a store without what belongs to its time: to be said again.
fn anew(record: &Value) -> Value {
    let mut record = record.clone();
    if let Some(map) = record.as_object_mut() {
        map.retain(|key, _| !OF_THE_STORE.contains(&key.as_str()));
    }
    record
}

/// An alarm's record in another state.
fn state(raised: &Raised, state: &str) -> Value {
    let mut record = raised.record.clone();
    record["state"] = state.into();
    record
}

/// Channels that a record says are sick, or well.
fn channels(station: u16, kind: &str, fault: &str, record: &Value) -> Vec<(About, Truth)> {
    let about = |channel: u8| About::Channel(station, channel);
    let sick = |channel: u8, how: &str| {
        (about(channel), Truth::yes("ChannelSick", format!("station {station}: channel {channel} {how}")))
    };
    let value = record["value"].as_u64().and_then(|c| u8::try_from(c).ok());
    match (kind, fault, value) {
        (_, "DeadChannel", Some(c)) => vec![sick(c, "is dead")],
        (_, "OwnNoise", Some(c)) => vec![sick(c, "does not hear what the others hear")],
        (_, "Inverted", Some(c)) => vec![sick(c, "has the sign of the others turned round")],
        (_, "Leaking", Some(c)) => vec![sick(c, "holds some of another's signal")],
        (_, "ChannelBack", Some(c)) => vec![(about(c), Truth::over("it is back"))],
        ("health", ..) => {
            let dead: BTreeSet<u8> = record["dead_channels"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(|c| u8::try_from(c.as_u64()?).ok())
                .collect();
            (0..4u8)
                .map(|c| {
                    if dead.contains(&c) {
                        sick(c, "is dead or left out")
                    } else {
                        (about(c), Truth::over("it is well"))
                    }
                })
                .collect()
        }
        _ => Vec::new(),
    }
}

/// What is so of a rule.
struct Truth {
    /// `None`: nobody knows, and all stays as it is.
    is: Option<bool>,
    code: &'static str,
    text: String,
    probability: Option<f64>,
}

impl Truth {
    fn yes(code: &'static str, text: String) -> Self {
        Self { is: Some(true), code, text, probability: None }
    }

    fn over(why: &str) -> Self {
        Self { is: Some(false), code: "", text: why.to_owned(), probability: None }
    }

    fn unknown() -> Self {
        Self { is: None, code: "", text: String::new(), probability: None }
    }
}

#[cfg(test)]
mod tests;
