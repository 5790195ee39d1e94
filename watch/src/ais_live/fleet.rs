//! What has become of the tracks beside AIS that have ended, all together: the record `ais_fleet`.

use crate::errors::{Measured, over_fleet};
use crate::matching::Verdict;
use crate::report::VesselId;
use serde_json::Value;
use std::collections::BTreeMap;

/// Tracks that are counted: of more the first by station and number are left out.
const MOST: usize = 5000;
/// Time after which the record is made again where tracks have ended, s.
const EVERY_S: f64 = 3600.0;

/// The verdicts on tracks that have ended, and their errors.
#[derive(Debug, Default)]
pub(super) struct Ended {
    tracks: BTreeMap<VesselId, (Verdict, Option<Measured>)>,
    /// Tracks have ended since the record was made last, and when that was.
    new: bool,
    told_s: f64,
}

impl Ended {
    /// Takes a track that has ended; one that had ended before counts as it is now.
    pub(super) fn take(&mut self, vessel: VesselId, verdict: &Verdict, errors: Option<Measured>) {
        self.tracks.insert(vessel, (verdict.clone(), errors));
        self.new = true;
        if self.tracks.len() > MOST {
            self.tracks.pop_first();
        }
    }

    /// A track that had ended was none.
    pub(super) fn withdraw(&mut self, vessel: VesselId) {
        self.new |= self.tracks.remove(&vessel).is_some();
    }

    /// The record, if it is time for it.
    pub(super) fn due(&mut self, now_s: f64) -> Option<Value> {
        if now_s - self.told_s >= EVERY_S { self.record(now_s) } else { None }
    }

    /// The record, if there is something new.
    pub(super) fn record(&mut self, now_s: f64) -> Option<Value> {
        self.told_s = now_s;
        if !std::mem::take(&mut self.new) {
            return None;
        }
        let verdicts: Vec<Verdict> = self.tracks.values().map(|(verdict, _)| verdict.clone()).collect();
        let errors: Vec<Measured> = self.tracks.values().filter_map(|(_, errors)| errors.clone()).collect();
        Some(over_fleet(&verdicts, &errors))
    }
}
