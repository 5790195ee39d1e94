//! What the terminal shows, made of records: a line a station, alarms not cleared, the newest events.
//!
//! Ages are counted on the computer's steady clock, so that a clock that is set changes none of them.

use crate::report::utc;
use seabearing_base::view::with_sd;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};

/// Events kept.
const EVENTS: usize = 1000;
/// Stations kept: more than a base station takes connections.
const STATIONS: usize = 2000;
/// Alarms kept.
const ALARMS: usize = 1000;
/// Tracks of a station that are counted.
const TRACKS: usize = 40;
/// A track that says nothing for so long goes on no more, s.
const TRACK_ENDS_S: f64 = 120.0;

/// How much something matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Weight {
    /// It is as it should be.
    Usual,
    /// Somebody may want to look.
    Doubtful,
    /// Somebody must look.
    Bad,
}

/// One station.
#[derive(Clone, Debug, Default)]
pub struct Station {
    /// Its name, where the stations file says one.
    pub name: String,
    /// State of its line, `up`, `silent` or `down`; empty where it has said none.
    pub link: String,
    /// When its newest record came, seconds of the steady clock.
    pub heard_s: Option<f64>,
    /// Standard deviation of its UTC, s.
    pub sd_utc_s: Option<f64>,
    /// Its newest bearing, for a person, and when that came, seconds of the steady clock.
    pub bearing: Option<(f64, String)>,
    /// Channels that are dead now.
    pub dead_channels: usize,
    /// It has said that its recording has ended.
    pub ended: bool,
    /// What is known of its tracks, by session and number.
    tracks: BTreeMap<(u64, u64), Track>,
    newest: Option<(u64, u64)>,
}

/// What is known of a track.
#[derive(Clone, Debug, Default)]
struct Track {
    heard_s: f64,
    text: String,
    ais: String,
    over: bool,
}

/// An alarm that is not cleared.
#[derive(Clone, Debug)]
pub struct Alarm {
    /// Its number.
    pub id: u64,
    /// A person has seen it.
    pub acknowledged: bool,
    /// A person here has just said so; whoever raised it has not answered yet.
    pub asked: bool,
    /// The date when it was raised, UTC.
    pub day: String,
    /// The time of day, and what it says.
    pub text: String,
}

/// A line of the event log.
#[derive(Clone, Debug)]
pub struct Event {
    /// How much it matters.
    pub weight: Weight,
    /// Its date, UTC, as `2026-05-01`; empty where it has none.
    pub day: String,
    /// With its time of day, UTC.
    pub text: String,
}

/// Everything that is shown.
#[derive(Clone, Debug, Default)]
pub struct Board {
    /// Stations by number; those that have not said theirs are one.
    pub stations: BTreeMap<Option<u64>, Station>,
    /// Alarms not cleared: those that nobody has seen, then the others, oldest first.
    pub alarms: Vec<Alarm>,
    /// Newest last.
    pub events: VecDeque<Event>,
    /// Records taken.
    pub records: u64,
    /// Records that the view was too slow for.
    pub missed: u64,
}

impl Board {
    /// A station that is expected.
    pub fn expect(&mut self, station: u16, name: &str) {
        name.clone_into(&mut self.stations.entry(Some(station.into())).or_default().name);
    }

    /// A station that was heard before this began, seconds of the steady clock.
    pub fn was_heard(&mut self, station: Option<u16>, heard_s: f64) {
        self.stations.entry(station.map(u64::from)).or_default().heard_s = Some(heard_s);
    }

    /// Takes a record at a time, seconds of the steady clock; gives its event, if it is one.
    pub fn take(&mut self, record: &Value, now_s: f64) -> Option<Event> {
        self.records += 1;
        let kind = record["type"].as_str().unwrap_or("");
        if kind == "alarm" {
            self.alarm(record);
        }
        let of = record["station"].as_u64();
        // What the base station says of nobody is no station.
        let known = self.stations.contains_key(&of) || self.stations.len() < STATIONS;
        if known && (of.is_some() || !record["session"].is_null()) && kind != "network_track" {
            self.stations.entry(of).or_default().take(kind, record, now_s);
        }
        let event = event(kind, record)?;
        self.push(event.clone());
        Some(event)
    }

    /// A line for a person that is no record, at a time of day (UTC).
    pub fn note(&mut self, clock: &str, text: &str) {
        self.push(Event {
            weight: Weight::Doubtful,
            day: String::new(),
            text: format!("{clock} {}", printable(text)),
        });
    }

    fn push(&mut self, event: Event) {
        self.events.push_back(event);
        if self.events.len() > EVENTS {
            self.events.pop_front();
        }
    }

    /// An alarm is its newest state.
    fn alarm(&mut self, record: &Value) {
        let Some(id) = record["id"].as_u64() else { return };
        let known = self.alarms.iter().position(|a| a.id == id);
        match (record["state"].as_str(), known) {
            (Some("cleared"), Some(n)) => drop(self.alarms.remove(n)),
            (Some("acknowledged"), Some(n)) => {
                if let Some(alarm) = self.alarms.get_mut(n) {
                    alarm.acknowledged = true;
                }
            }
            (Some(state @ ("raised" | "acknowledged")), None) if self.alarms.len() < ALARMS => {
                let ((day, clock), code) = (moment(record), record["code"].as_str().unwrap_or(""));
                let text = record["text"].as_str().unwrap_or("");
                let text = format!("{clock} {} {}", printable(code), printable(text));
                self.alarms.push(Alarm {
                    id,
                    acknowledged: state == "acknowledged",
                    asked: false,
                    day,
                    text,
                });
            }
            _ => {}
        }
        self.alarms.sort_by_key(|a| (a.acknowledged, a.id));
    }

    /// Stations whose line is in a state.
    pub fn lines(&self, state: &str) -> usize {
        self.stations.values().filter(|s| s.link == state).count()
    }
}

impl Station {
    fn take(&mut self, kind: &str, record: &Value, now_s: f64) {
        match kind {
            "line" => return record["state"].as_str().unwrap_or("").clone_into(&mut self.link),
            "ais_match" => return self.matched(record),
            "alarm" | "lost" | "warning" | "acknowledge" | "note" => return,
            _ => self.heard_s = Some(now_s),
        }
        let number = |key: &str| record[key].as_f64().unwrap_or(f64::NAN);
        match kind {
            "hello" => self.ended = false,
            "end" => self.ended = true,
            "time" => self.sd_utc_s = record["sd_utc_s"].as_f64(),
            "health" => self.dead_channels = record["dead_channels"].as_array().map_or(0, Vec::len),
            "bearing" => {
                let azimuth = with_sd(number("azimuth_deg"), number("sd_azimuth_deg"));
                self.bearing = Some((now_s, format!("{azimuth}° {:.0} dB", number("snr_db"))));
            }
            "azimuth" if record["detected"] == true => {
                let azimuth = with_sd(number("azimuth_deg"), number("sd_deg"));
                self.bearing = Some((now_s, format!("{azimuth}°")));
            }
            "range" if record["detected"] == true => {
                let range = with_sd(number("range_m"), number("sd_range_m"));
                self.bearing = Some((now_s, format!("range {range} m")));
            }
            "track" => self.tracked(record, now_s),
            _ => {}
        }
    }

    fn tracked(&mut self, record: &Value, now_s: f64) {
        let (Some(session), Some(id)) = (record["session"].as_u64(), record["id"].as_u64()) else { return };
        let stage = record["stage"].as_str().unwrap_or("");
        if stage == "withdrawn" {
            self.tracks.remove(&(session, id));
            self.newest = self.tracks.keys().next_back().copied();
            return;
        }
        let number = |key: &str| record[key].as_f64().unwrap_or(f64::NAN);
        let value = |key: &str| with_sd(number(key), number(&format!("sd_{key}")));
        let range = match record["range_observable"] == true {
            true => format!("{} m", value("cpa_range_m")),
            false => "range not observable".to_owned(),
        };
        let closest_s = utc(&record["utc"]).map(|t_s| t_s + number("cpa_time_s") - number("t_s"));
        let at =
            closest_s.filter(|t| t.is_finite()).map_or(String::new(), |t| format!(" at {}", day_clock(t)));
        let (heading, speed) = (value("heading_deg"), value("speed_m_s"));
        let track = self.tracks.entry((session, id)).or_default();
        track.text = format!("{session}.{id} {stage}: {range}{at}, {heading}°, {speed} m/s");
        (track.heard_s, track.over) = (now_s, stage == "final");
        self.newest = Some((session, id));
        while self.tracks.len() > TRACKS {
            self.tracks.pop_first();
        }
    }

    /// Which vessel of AIS a track is.
    fn matched(&mut self, record: &Value) {
        let (Some(session), Some(id)) = (record["of_session"].as_u64(), record["id"].as_u64()) else {
            return;
        };
        let Some(track) = self.tracks.get_mut(&(session, id)) else { return };
        track.ais = match record["verdict"].as_str() {
            Some("vessel") => {
                let name = record["name"].as_str().map(printable).unwrap_or_default();
                format!("is {name} {}", record["mmsi"]).replace("  ", " ")
            }
            Some("dark") => "is DARK".to_owned(),
            _ => String::new(),
        };
    }

    /// Its newest track for a person, whether that goes on, and how many others go on.
    pub fn track(&self, now_s: f64) -> Option<(String, bool, usize)> {
        let goes_on = |t: &Track| !t.over && now_s - t.heard_s < TRACK_ENDS_S;
        let newest = self.newest?;
        let track = self.tracks.get(&newest)?;
        let others = self.tracks.iter().filter(|(key, t)| **key != newest && goes_on(t)).count();
        let ais = if track.ais.is_empty() { String::new() } else { format!("; {}", track.ais) };
        Some((format!("{}{ais}", track.text), goes_on(track), others))
    }
}

/// What a record says that is worth a line.
fn event(kind: &str, record: &Value) -> Option<Event> {
    let word = |key: &str| record[key].as_str().map(printable).unwrap_or_default();
    let (weight, what) = match kind {
        "alarm" => {
            let weight = if record["state"] == "raised" { Weight::Bad } else { Weight::Usual };
            (weight, format!("alarm {}: {}", word("state"), word("text")))
        }
        "line" => {
            let weight = if record["state"] == "up" { Weight::Usual } else { Weight::Bad };
            let who = record["peer"].as_str().or(record["line"].as_str()).map(printable).unwrap_or_default();
            let cause = word("cause");
            let colon = if cause.is_empty() { "" } else { ": " };
            (weight, format!("line {} ({who}){colon}{cause}", word("state")))
        }
        "fault" => (Weight::Doubtful, format!("fault {} {}", word("code"), record["value"])),
        "faults_held" => (Weight::Doubtful, format!("{} faults {}", record["count"], word("code"))),
        "lost" => (Weight::Bad, format!("{} records lost {}", record["frames"], word("cause"))),
        "warning" => (Weight::Doubtful, word("text")),
        "note" => (Weight::Doubtful, word("text")),
        "hello" => (Weight::Usual, format!("recorder started, version {}", word("version"))),
        "end" => (Weight::Usual, "recording ended".to_owned()),
        "transient" if record["kind"] == "burst" => {
            let from = record["azimuth_deg"].as_f64().map_or_else(String::new, |a| format!(" from {a:.1}°"));
            let peak = record["peak_db"].as_f64().unwrap_or(f64::NAN);
            (Weight::Usual, format!("burst{from}, {peak:.0} dB re {}", word("reference")))
        }
        "track" if record["stage"] == "final" => {
            (Weight::Usual, format!("track {}.{} is final", record["session"], record["id"]))
        }
        "ais_match" if record["verdict"] == "dark" => (
            Weight::Doubtful,
            match record["network"].as_u64() {
                Some(id) => format!("network track {id}: no vessel of AIS is it"),
                None => format!("track {}.{}: no vessel of AIS is it", record["of_session"], record["id"]),
            },
        ),
        _ => return None,
    };
    let station = record["station"].as_u64().map_or_else(|| "-".to_owned(), |n| n.to_string());
    let (day, clock) = moment(record);
    Some(Event { weight, day, text: format!("{clock} {station:>5} {what}") })
}

/// Date and time of day of a record, UTC.
fn moment(record: &Value) -> (String, String) {
    let text = record["utc"].as_str().or(record["received_utc"].as_str()).unwrap_or("");
    (text.get(..10).unwrap_or("").to_owned(), text.get(11..19).unwrap_or("--:--:--").to_owned())
}

/// Time of day, UTC, of seconds since 1970.
pub fn day_clock(utc_s: f64) -> String {
    let s = utc_s.rem_euclid(86_400.0) as u64;
    format!("{:02}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
}

/// How long ago, coarse, so that a line that is heard all the time does not change; `-` where never.
pub fn age(heard_s: Option<f64>, now_s: f64) -> String {
    let Some(heard_s) = heard_s else { return "-".to_owned() };
    match (now_s - heard_s).max(0.0) as u64 {
        0..10 => "<10 s".to_owned(),
        s @ 10..60 => format!("{} s", s / 10 * 10),
        s @ 60..7200 => format!("{} min", s / 60),
        s @ 7200..172_800 => format!("{} h", s / 3600),
        s => format!("{} d", s / 86_400),
    }
}

/// Text from outside without control characters, which a terminal would obey.
pub fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}
