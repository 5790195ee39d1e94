//! Alarms: raised once, acknowledged by a person, cleared once.
//!
//! In: records as they are stored, and the time. Out: records `{"type":"alarm","state":"raised|acknowledged|cleared",..}`. A
//! vessel counts by the probability that it is where the rule says, given its covariance; a track whose range is not
//! observable is nowhere. One that several stations hear is one vessel ([`crate::vessels`]), and its alarm goes on when fusion finds that, or
//! takes it back. What is true again before it has been untrue for `clear_after_s` was true all the time.

pub mod area;
mod clock;
pub mod deliver;
mod held;
mod resume;
pub mod rules;
mod truth;
mod vessel;
mod way;

use crate::report::{TrackReport, VesselId, is_of_recorder, rfc3339};
use crate::vessels::{Vessels, Word};
use clock::Clock;
use held::Held;
use rules::{Condition, Rule, single};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use truth::{Truth, card, channels, margin, storage, supply};

/// A track that says nothing for so long has ended, s.
const TRACK_ENDS_S: f64 = 120.0;
/// Why an alarm is over when its vessel is heard no more.
const ENDED: &str = "its track has ended";
/// A disk has room again with so many times the room at which that was told.
const ROOM_AGAIN: f64 = 1.1;

/// What an alarm is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum About {
    /// This base station itself.
    Base,
    /// Its store, that takes nothing: the disk may be low as well.
    Store,
    Vessel(VesselId),
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
    /// Where its vessel was told to be since then.
    reports: Vec<TrackReport>,
    record: Value,
}

/// Watches records.
pub struct Watcher {
    rules: Vec<Rule>,
    /// Corners of a rule's area in a station's frame.
    corners: BTreeMap<(usize, u16), Vec<(f64, f64)>>,
    vessels: Vessels,
    /// The stations of the list, where there is one: no other is missed.
    listed: BTreeSet<u16>,
    /// When each station that would be missed was heard last; none: not since this began.
    heard_s: BTreeMap<u16, Option<f64>>,
    clocks: BTreeMap<u16, Clock>,
    begun_s: f64,
    raised: BTreeMap<(usize, About), Raised>,
    held: BTreeMap<(usize, VesselId), Held>,
    newest_id: u64,
    /// What comes is of now.
    of_now: bool,
}

impl Watcher {
    /// Watches from `now_s` on, seconds since 1970. `places`: latitude and longitude of stations, degrees. `listed`: those that are
    /// missed when they are not heard; where there is no list, those that a rule names or that have been heard. `of_now`: what comes
    /// is not read from files, so that recorders' clocks can be compared with this computer's.
    pub fn new(
        rules: Vec<Rule>,
        places: &BTreeMap<u16, (f64, f64)>,
        listed: BTreeSet<u16>,
        now_s: f64,
        of_now: bool,
    ) -> Self {
        let rules = single(rules);
        let vessels = Vessels::new(places);
        let named = rules.iter().filter(|rule| matches!(rule.condition, Condition::Silent(_)));
        let named = named.flat_map(|rule| rule.stations.iter().copied()).filter(|_| listed.is_empty());
        let heard_s = listed.iter().copied().chain(named).map(|of| (of, None)).collect();
        let mut corners = BTreeMap::new();
        for (n, rule) in rules.iter().enumerate() {
            let Condition::Inside(area) = &rule.condition else { continue };
            let of = |of: &u16| Some(((n, *of), area.corners_m(vessels.frame(*of)?)));
            corners.extend(places.keys().filter_map(of));
        }
        Self {
            rules,
            corners,
            vessels,
            listed,
            heard_s,
            clocks: BTreeMap::new(),
            begun_s: now_s,
            raised: BTreeMap::new(),
            held: BTreeMap::new(),
            newest_id: 0,
            of_now,
        }
    }

    /// Takes a record at a time; gives the alarms that change.
    pub fn take(&mut self, record: &Value, now_s: f64) -> Vec<Value> {
        let kind = record["type"].as_str().unwrap_or("");
        if kind == "note" {
            return self.store(
                record["code"].as_str().unwrap_or(""),
                record["text"].as_str().unwrap_or(""),
                now_s,
            );
        }
        let mut out = Vec::new();
        for word in self.vessels.take(record, now_s) {
            out.extend(match word {
                Word::Joins(track, network) => {
                    self.goes_on(VesselId::Track(track), &[VesselId::Network(network)])
                }
                Word::Parts(network, into) => self.goes_on(VesselId::Network(network), &into),
                Word::Says(seen) => self.says(&seen, now_s),
            });
        }
        let station = record["station"].as_u64().and_then(|n| u16::try_from(n).ok());
        let Some(station) = station.filter(|_| kind != "network_track") else { return out };
        let mut tells = false;
        if is_of_recorder(kind) {
            if self.misses(station) {
                self.heard_s.insert(station, Some(now_s));
            }
            tells = self.clocks.entry(station).or_default().take(kind, record, now_s, self.of_now);
        }
        for n in 0..self.rules.len() {
            let rule = &self.rules[n];
            if rule.stations.is_empty() || rule.stations.contains(&station) {
                for (about, truth) in self.judge(n, station, kind, record, now_s, tells) {
                    out.extend(self.note(n, about, truth, None, now_s));
                }
            }
        }
        out
    }

    /// Whether a station is missed when it is not heard.
    fn misses(&self, station: u16) -> bool {
        self.listed.is_empty() || self.listed.contains(&station)
    }

    /// Takes what is said of a vessel.
    fn says(&mut self, seen: &[TrackReport], now_s: f64) -> Vec<Value> {
        let mut out = Vec::new();
        for n in
            (0..self.rules.len()).filter(|n| self.rules[*n].condition.is_of_vessels()).collect::<Vec<_>>()
        {
            let Some((truth, report)) = self.vessel(n, seen, now_s) else { continue };
            if let Some(truth) = self.hold(n, truth, &report, now_s) {
                out.extend(self.note(n, About::Vessel(report.vessel), truth, Some(report), now_s));
            }
        }
        out
    }

    /// A vessel is told as another from now on, the first of these that has no alarm of a rule: its alarm of that rule goes on. Where
    /// all have one it is cleared.
    fn goes_on(&mut self, was: VesselId, into: &[VesselId]) -> Vec<Value> {
        let mut out = Vec::new();
        for n in 0..self.rules.len() {
            self.waits_on(n, was, into);
            let Some(mut raised) = self.raised.remove(&(n, About::Vessel(was))) else { continue };
            match into.iter().find(|vessel| !self.raised.contains_key(&(n, About::Vessel(**vessel)))) {
                Some(vessel) => {
                    name(&mut raised.record, Some(*vessel));
                    raised.reports.iter_mut().for_each(|report| report.vessel = *vessel);
                    self.raised.insert((n, About::Vessel(*vessel)), raised);
                    self.held.remove(&(n, *vessel));
                }
                None => out.push(state(&raised, "cleared")),
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
        let rules =
            (0..self.rules.len()).filter(|n| matches!(self.rules[*n].condition, Condition::Disk { .. }));
        rules
            .collect::<Vec<_>>()
            .into_iter()
            .filter_map(|n| self.note(n, About::Store, truth()?, None, now_s))
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
            } else if below(ROOM_AGAIN) {
                Truth::unknown()
            } else {
                Truth::over("there is room again")
            };
            out.extend(self.note(n, About::Base, truth, None, now_s));
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
                let silent = now_s - heard_s.unwrap_or(self.begun_s) > after_s;
                if (of.is_empty() || of.contains(&station)) && silent {
                    let since = rfc3339(heard_s.unwrap_or(self.begun_s).floor());
                    let began = if heard_s.is_none() { "this base station began, " } else { "" };
                    let since = since.as_str().unwrap_or("?");
                    let text = format!("station {station} has not been heard since {began}{since}");
                    let truth = Truth::yes("RecorderSilent", text);
                    out.extend(self.note(n, About::Station(station), truth, None, now_s));
                }
            }
        }
        out.extend(self.raise_held(now_s, held::FUSED_S));
        let stale: Vec<(usize, About)> = self
            .raised
            .iter()
            .filter(|((_, about), raised)| {
                matches!(about, About::Vessel(_)) && now_s - raised.heard_s > TRACK_ENDS_S
            })
            .map(|(key, _)| *key)
            .collect();
        for (n, about) in stale {
            out.extend(self.note(n, about, Truth::over(ENDED), None, now_s));
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

    /// Nothing more comes: gives the alarms that wait for fusion.
    pub fn finish(&mut self, now_s: f64) -> Vec<Value> {
        let mut out = self.raise_held(now_s, 0.0);
        // What a recorder has taken back is over with the input: nothing that comes later would say so again.
        let over = |((_, about), raised): &(&(usize, About), &Raised)| {
            !matches!(about, About::Vessel(_)) && raised.untrue_s.is_some()
        };
        let over: Vec<(usize, About)> = self.raised.iter().filter(over).map(|(key, _)| *key).collect();
        for key in over {
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

    /// What a record of a recorder says of a rule. `tells`: of its clock.
    fn judge(
        &self,
        n: usize,
        station: u16,
        kind: &str,
        record: &Value,
        now_s: f64,
        tells: bool,
    ) -> Vec<(About, Truth)> {
        let fault = if kind == "fault" { record["code"].as_str().unwrap_or("") } else { "" };
        let truth = match &self.rules[n].condition {
            Condition::Silent(_) => is_of_recorder(kind).then(|| Truth::over("it is heard again")),
            Condition::Channel => return channels(station, kind, fault, record),
            Condition::Clock(rule) => {
                self.clocks.get(&station).filter(|_| tells).map(|clock| clock.judge(station, rule, now_s))
            }
            Condition::Supply => supply(station, kind, fault, record),
            Condition::Storage => storage(station, kind, record),
            Condition::Margin(limits) => (kind == "margins").then(|| margin(station, limits, record)),
            Condition::Card { full } => card(station, *full, kind, record),
            Condition::Inside(_) | Condition::Range(_) | Condition::Approach { .. } => None,
            Condition::Disk { .. } => None,
        };
        truth.map(|truth| (About::Station(station), truth)).into_iter().collect()
    }

    /// Notes what is so; gives the record of a new alarm.
    fn note(
        &mut self,
        n: usize,
        about: About,
        truth: Truth,
        report: Option<TrackReport>,
        now_s: f64,
    ) -> Option<Value> {
        if let Some(raised) = self.raised.get_mut(&(n, about)) {
            held::keep(&mut raised.reports, report);
            if truth.text != ENDED {
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
        let (station, vessel, channel) = match about {
            About::Base | About::Store => (None, None, None),
            About::Vessel(vessel) => (report.and_then(|r| r.station), Some(vessel), None),
            About::Station(station) => (Some(station), None, None),
            About::Channel(station, channel) => (Some(station), None, Some(channel)),
        };
        let mut record = json!({
            "type": "alarm", "id": self.newest_id, "code": truth.code, "name": self.rules[n].name, "state": "raised",
            "station": station, "track": null, "of_session": null, "network": null, "channel": channel,
            "probability": truth.probability, "text": truth.text,
        });
        name(&mut record, vessel);
        let raised = Raised {
            id: self.newest_id,
            acknowledged: false,
            untrue_s: None,
            heard_s: now_s,
            reports: report.into_iter().collect(),
            record: record.clone(),
        };
        self.raised.insert((n, about), raised);
        Some(record)
    }
}

/// Writes into an alarm's record which vessel it is about. Its station stays what it was: the alarm is found again by it.
fn name(record: &mut Value, vessel: Option<VesselId>) {
    let (track, network) = match vessel {
        Some(VesselId::Track(track)) => (Some(track), None),
        Some(VesselId::Network(id)) => (None, Some(id)),
        None => (None, None),
    };
    record["track"] = json!(track.map(|t| t.id));
    record["of_session"] = json!(track.and_then(|t| t.session));
    record["network"] = json!(network);
}

/// An alarm's record in another state.
fn state(raised: &Raised, state: &str) -> Value {
    let mut record = raised.record.clone();
    record["state"] = state.into();
    record
}

#[cfg(test)]
mod tests;
