//! A base station that starts again goes on with the alarms that stood.

use super::rules::{Condition, Rule};
use super::{About, Raised, Watcher, name};
use crate::report::{TrackId, VesselId};
use crate::vessels::Word;
use serde_json::Value;
use std::collections::BTreeMap;

/// What a store adds to a record.
const OF_THE_STORE: [&str; 5] = ["utc", "sd_utc_s", "received_utc", "session", "sequence"];

impl Watcher {
    /// Takes up what stood when a base station ended before: its alarm records and network tracks, as they came: whose an alarm is follows from
    /// both. Gives those that are cleared, as there is no such rule any more, or it is of another kind or about other stations now.
    pub fn resume(&mut self, records: &[Value], now_s: f64) -> Vec<Value> {
        // What is to be cleared, by number, unless the store says that it was.
        let mut over: BTreeMap<u64, Value> = BTreeMap::new();
        for record in records {
            if record["type"] == "network_track" {
                for word in self.vessels.take(record, now_s) {
                    let cleared = match word {
                        Word::Joins(track, network) => {
                            self.goes_on(VesselId::Track(track), &[VesselId::Network(network)])
                        }
                        Word::Parts(network, into) => self.goes_on(VesselId::Network(network), &into),
                        Word::Says(_) => Vec::new(),
                    };
                    over.extend(
                        cleared.into_iter().filter_map(|record| Some((record["id"].as_u64()?, record))),
                    );
                }
                continue;
            }
            let Some(id) = record["id"].as_u64() else { continue };
            self.newest_id = self.newest_id.max(id);
            // What is said of it last is so.
            over.remove(&id);
            self.raised.retain(|_, raised| raised.id != id);
            if record["state"] == "cleared" {
                continue;
            }
            let cleared = match self.place_of(record) {
                None => continue,
                Some(None) => Some(record.clone()),
                Some(Some(key)) => self.stands(key, id, record, now_s),
            };
            if let Some((id, record)) = cleared.and_then(|record| Some((record["id"].as_u64()?, record))) {
                over.insert(id, cleared_anew(&record));
            }
        }
        over.into_values().collect()
    }

    /// The rule that an alarm record is of, and what it is about; none where no rule is. None at all of a record that is none.
    fn place_of(&self, record: &Value) -> Option<Option<(usize, About)>> {
        let code = record["code"].as_str().unwrap_or("");
        let goes_on =
            |rule: &Rule| record["name"] == rule.name.as_str() && rule.condition.codes().contains(&code);
        let Some(n) = self.rules.iter().position(goes_on) else { return Some(None) };
        let rule = &self.rules[n];
        let station = record["station"].as_u64().and_then(|s| u16::try_from(s).ok());
        let base = matches!(rule.condition, Condition::Disk { .. });
        let station = station.or(base.then_some(0))?;
        let of_others = !rule.stations.is_empty() && !rule.stations.contains(&station);
        let of_none = matches!(rule.condition, Condition::Silent(_)) && !self.misses(station);
        if !base && (of_others || of_none) {
            return Some(None);
        }
        let number = |key: &str| record[key].as_u64();
        let network = number("network").and_then(|id| u32::try_from(id).ok());
        let about = match (number("track"), number("channel")) {
            _ if network.is_some() => About::Vessel(VesselId::Network(network.unwrap_or(0))),
            (Some(track), _) => About::Vessel(self.vessels.told_as(TrackId {
                station: Some(station),
                session: number("of_session").and_then(|s| u32::try_from(s).ok()),
                id: track as u16,
            })),
            (_, Some(channel)) => About::Channel(station, channel as u8),
            _ if base && code == "StoreFails" => About::Store,
            _ if base => About::Base,
            _ => About::Station(station),
        };
        Some(Some((n, about)))
    }

    /// An alarm stands. Of two of one name, as a version before left them, the later one goes on: gives the other.
    fn stands(&mut self, key: (usize, About), id: u64, record: &Value, now_s: f64) -> Option<Value> {
        let acknowledged = record["state"] == "acknowledged";
        let mut record = anew(record);
        if let About::Vessel(vessel) = key.1 {
            name(&mut record, Some(vessel));
        }
        let raised = Raised { id, acknowledged, untrue_s: None, heard_s: now_s, reports: Vec::new(), record };
        self.raised.insert(key, raised).map(|before| before.record)
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

/// The same, cleared.
fn cleared_anew(record: &Value) -> Value {
    let mut record = anew(record);
    record["state"] = "cleared".into();
    record
}
