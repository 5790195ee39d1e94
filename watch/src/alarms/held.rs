//! Alarms that wait for fusion: of a track where a vessel of other stations has an alarm already, which may be that vessel.

use super::truth::Truth;
use super::{About, Watcher};
use crate::report::{Covariance, TrackReport, VesselId};
use serde_json::Value;

/// Time in which fusion may find that a station's track is a vessel which has an alarm already, s.
pub(super) const FUSED_S: f64 = 12.0;
/// 99 % point of chi-squared of two: places that differ by more are two vessels'.
const FAR: f64 = 9.210;
/// Speed with which places of different times may differ, m/s, and for how long: what is further apart in time tells nothing of one
/// place, s.
const FAST_M_S: f64 = 10.0;
const MOMENT_S: f64 = 60.0;

/// Reports of a vessel with an alarm that are kept, at most: of more every other one, and the newest.
const REPORTS: usize = 60;

/// Keeps where a vessel with an alarm was: a track of other stations may be told of the same moment later.
pub(super) fn keep(reports: &mut Vec<TrackReport>, report: Option<TrackReport>) {
    let Some(report) = report.filter(|r| r.place.is_some()) else { return };
    if reports.len() >= REPORTS {
        let mut n = 0;
        reports.retain(|_| {
            n += 1;
            n % 2 == 1
        });
    }
    reports.push(report);
}

/// An alarm that may be another's: it waits for fusion.
#[derive(Clone, Debug)]
pub(super) struct Held {
    since_s: f64,
    truth: Truth,
    report: TrackReport,
    /// It is not so any more; it was, and whoever is to be told has not been.
    over: Option<Truth>,
}

impl Watcher {
    /// Lets an alarm wait that may be another's. Gives back what is to be noted now.
    pub(super) fn hold(&mut self, n: usize, truth: Truth, report: &TrackReport, now_s: f64) -> Option<Truth> {
        let key = (n, report.vessel);
        match truth.is {
            Some(true) => {
                let held = self.held.remove(&key);
                let is_new = !self.raised.contains_key(&(n, About::Vessel(report.vessel)));
                if is_new && self.may_be_known(n, report) {
                    let since_s = held.map_or(now_s, |held| held.since_s);
                    self.held.insert(key, Held { since_s, truth, report: *report, over: None });
                    return None;
                }
            }
            Some(false) if report.is_withdrawn => drop(self.held.remove(&key)),
            Some(false) => {
                if let Some(held) = self.held.get_mut(&key) {
                    held.over = Some(truth);
                    return None;
                }
            }
            None => {}
        }
        Some(truth)
    }

    /// A vessel is told as one of these from now on: what waits goes on waiting as the first that has no alarm, or is that one's.
    pub(super) fn waits_on(&mut self, n: usize, was: VesselId, into: &[VesselId]) {
        let Some(held) = self.held.remove(&(n, was)) else { return };
        let is_free = |vessel: &&VesselId| !self.raised.contains_key(&(n, About::Vessel(**vessel)));
        if let Some(vessel) = into.iter().find(is_free).copied() {
            let report = TrackReport { vessel, ..held.report };
            self.held.entry((n, vessel)).or_insert(Held { report, ..held });
        }
    }

    /// Raises what has waited for so long, s; what is not so any more is cleared after that.
    pub(super) fn raise_held(&mut self, now_s: f64, waited_s: f64) -> Vec<Value> {
        let due = self.held.iter().filter(|(_, held)| now_s - held.since_s >= waited_s);
        let due: Vec<(usize, VesselId)> = due.map(|(key, _)| *key).collect();
        let mut out = Vec::new();
        for (n, vessel) in due {
            let Some(held) = self.held.remove(&(n, vessel)) else { continue };
            for truth in [Some(held.truth), held.over].into_iter().flatten() {
                out.extend(self.note(n, About::Vessel(vessel), truth, Some(held.report), now_s));
            }
        }
        out
    }

    /// Whether a station's track may be a vessel that other stations hear, and that has an alarm of a rule: fusion finds out.
    fn may_be_known(&self, n: usize, report: &TrackReport) -> bool {
        let VesselId::Track(track) = report.vessel else { return false };
        let of_rule = self.raised.range((n, About::Base)..).take_while(|((rule, _), _)| *rule == n);
        of_rule.flat_map(|(_, raised)| &raised.reports).any(|other| {
            // A station tells its own vessels apart.
            let heard_here = self.vessels.stations(other.vessel).iter().any(|s| Some(*s) == track.station);
            !heard_here && self.are_near(report, other)
        })
    }

    /// Whether the places of two reports are one within their errors; not where one has none, or they are of different moments.
    fn are_near(&self, report: &TrackReport, other: &TrackReport) -> bool {
        let frame = |r: &TrackReport| r.station.and_then(|station| self.vessels.frame(station)).copied();
        let apart_s = report.utc_s.zip(other.utc_s).map_or(0.0, |(a, b)| a.0 - b.0);
        let difference = || {
            let (here, there) = (frame(report)?, frame(other)?);
            let (((x, y), own), ((u, v), its)) = (report.place?, other.place?);
            let (lat, lon) = there.lat_lon_deg(u, v);
            let (u, v) = here.east_north_m(lat, lon);
            let moved = (FAST_M_S * apart_s).powi(2);
            let sum = own.plus(its).plus(Covariance { xx: moved, yy: moved, xy: 0.0 });
            sum.distance2((u - x, v - y))
        };
        apart_s.abs() <= MOMENT_S && difference().is_some_and(|d2| d2 <= FAR)
    }
}
