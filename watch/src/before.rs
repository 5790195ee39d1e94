//! What tracks have said before fusion found that they are one vessel's: of the network track that is true, too.
//!
//! In: the reports of a track when it is joined. Out: those of a network track with what its members said before it, as seen from one
//! station. A track that fusion lets go of has its reports again once it speaks for itself.

use crate::report::{TrackId, TrackReport, VesselId};
use crate::vessels::Vessels;
use seabearing_core::angle::wrap_pi;
use seabearing_host::geodesy::LocalFrame;
use std::collections::BTreeMap;

/// Tracks that are known; of more those that were joined first are forgotten.
const TRACKS: usize = 2000;
/// Step by which North is found, m.
const NORTH_STEP_M: f64 = 10.0;

/// What joined tracks have said while they were alone.
#[derive(Clone, Debug, Default)]
pub struct Before {
    /// With the time at which each was joined, s.
    reports: BTreeMap<TrackId, (Vec<TrackReport>, f64)>,
}

impl Before {
    /// A track is joined at a time, s, and has said this.
    pub fn joins(&mut self, track: TrackId, said: Vec<TrackReport>, now_s: f64) {
        // One that goes from one network track to another has said nothing alone in between.
        if said.is_empty() {
            return;
        }
        self.reports.insert(track, (said, now_s));
        if self.reports.len() > TRACKS {
            let first = self.reports.iter().min_by(|a, b| a.1.1.total_cmp(&b.1.1)).map(|(track, _)| *track);
            first.into_iter().for_each(|track| drop(self.reports.remove(&track)));
        }
    }

    /// A vessel speaks for itself: what it has said before, if it is a track that was joined.
    pub fn parts(&mut self, vessel: VesselId) -> Vec<TrackReport> {
        let VesselId::Track(track) = vessel else { return Vec::new() };
        self.reports.remove(&track).map(|(said, _)| said).unwrap_or_default()
    }

    /// Lets go of what is told as a vessel of which this does not hold, by the time at which it was joined, s.
    pub fn retain(&mut self, vessels: &Vessels, holds: impl Fn(VesselId, f64) -> bool) {
        self.reports.retain(|track, (_, joined_s)| holds(vessels.told_as(*track), *joined_s));
    }

    /// The reports of a vessel, behind those that its members had made before the first of them, all as seen from the station of
    /// the first of its own.
    pub fn with(&self, vessel: VesselId, own: &[TrackReport], vessels: &Vessels) -> Vec<TrackReport> {
        let VesselId::Network(_) = vessel else { return own.to_vec() };
        let time = |r: &TrackReport| r.utc_s.filter(|_| r.place.is_some()).map(|(t_s, _)| t_s);
        let mut out: Vec<TrackReport> = Vec::new();
        let mut first_s = own.iter().filter_map(time).fold(f64::INFINITY, f64::min);
        let Some(from) = own.first().and_then(|r| r.station) else { return own.to_vec() };
        for (_, (said, _)) in self.reports.iter().filter(|(track, _)| vessels.told_as(**track) == vessel) {
            // Those of two stations at one time share most of what they know.
            let earlier = said.iter().filter(|r| time(r).is_some_and(|t_s| t_s < first_s));
            let earlier: Vec<TrackReport> =
                earlier.filter_map(|r| seen_from(&TrackReport { vessel, ..*r }, from, vessels)).collect();
            first_s = earlier.iter().filter_map(time).fold(first_s, f64::min);
            out.extend(earlier);
        }
        out.extend(own);
        out
    }
}

/// What is to be taken of a report, as seen from some stations: as seen from that of the first report taken.
pub fn as_before(
    first: Option<&TrackReport>,
    seen: &[TrackReport],
    vessels: &Vessels,
) -> Option<TrackReport> {
    let any = seen.first()?;
    let from = first.map_or(any.station, |first| first.station);
    let same = seen.iter().find(|r| r.station == from).copied();
    // That station may hear it no more.
    same.or_else(|| seen_from(any, from?, vessels))
}

/// A report in the plane of another station; without a closest point, which is its own station's. None where it is not
/// known where one of both stands.
fn seen_from(report: &TrackReport, station: u16, vessels: &Vessels) -> Option<TrackReport> {
    if report.station == Some(station) {
        return Some(*report);
    }
    let (its, other) = (vessels.frame(report.station?)?, vessels.frame(station)?);
    let moved = report.place.map(|((x, y), covariance)| {
        let (x, y, north) = moved(its, other, (x, y));
        (((x, y), covariance.turned(-north)), north)
    });
    let north = moved.map_or(0.0, |(_, north)| north);
    Some(TrackReport {
        station: Some(station),
        place: moved.map(|(place, _)| place),
        heading_rad: report.heading_rad.map(|(heading, sd)| (wrap_pi(heading + north), sd)),
        cpa_utc_s: None,
        cpa_range_m: None,
        ..*report
    })
}

/// A place of one frame in another, m, and the direction there of the first one's North, radians clockwise.
fn moved(from: &LocalFrame, to: &LocalFrame, (x, y): (f64, f64)) -> (f64, f64, f64) {
    let at = |x: f64, y: f64| {
        let (lat, lon) = from.lat_lon_deg(x, y);
        to.east_north_m(lat, lon)
    };
    let ((x, y), (east, north)) = (at(x, y), at(x, y + NORTH_STEP_M));
    (x, y, (east - x).atan2(north - y))
}

#[cfg(test)]
mod tests;
