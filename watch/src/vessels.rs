//! Vessels of all stations: where fusion has found that tracks of several stations are one vessel's, its network track stands for
//! them all.
//!
//! In: records `track` and `network_track`, and the time. Out: [`Word`]s, in the order in which they are true. While a network track
//! is told without a place (or its stations contradict each other), or is not told for [`STALE_S`], its stations' own tracks speak for the
//! vessel.

use crate::report::{Covariance, TrackId, TrackReport, VesselId, utc};
use seabearing_core::angle::wrap_pi;
use seabearing_host::geodesy::LocalFrame;
use serde_json::Value;
use std::collections::BTreeMap;

/// Time without a place of a network track after which a station's own track speaks for the vessel, and without a word of that one
/// after which another may, s.
pub const STALE_S: f64 = 60.0;
/// Network tracks that are known; of more those with the lowest numbers are forgotten.
const NETWORKS: usize = 5000;
/// Step by which North is found, degrees.
const NORTH_STEP_DEG: f64 = 1e-4;

/// What a record says of vessels.
#[derive(Clone, Debug, PartialEq)]
pub enum Word {
    /// A track is from now on told as that network track.
    Joins(TrackId, u32),
    /// A network track is no more; its members are told as these from now on, or again.
    Parts(u32, Vec<VesselId>),
    /// A vessel's motion, as seen from each of the stations that hear it; at least from one.
    Says(Vec<TrackReport>),
}

/// A network track.
#[derive(Clone, Debug, Default)]
struct Network {
    members: Vec<TrackId>,
    /// All of them have ended.
    is_over: bool,
    /// When it was told with a place last.
    placed_s: Option<f64>,
    /// What its members have said since, and when; and which of them speaks for it.
    own: BTreeMap<TrackId, (TrackReport, f64)>,
    speaker: Option<TrackId>,
}

/// Which tracks are one vessel's.
#[derive(Clone, Debug, Default)]
pub struct Vessels {
    frames: BTreeMap<u16, LocalFrame>,
    networks: BTreeMap<u32, Network>,
    network_of: BTreeMap<TrackId, u32>,
}

impl Vessels {
    /// Of these stations (latitude and longitude, degrees).
    pub fn new(stations: &BTreeMap<u16, (f64, f64)>) -> Self {
        let frames = stations.iter().map(|(of, (lat, lon))| (*of, LocalFrame::new(*lat, *lon))).collect();
        Self { frames, ..Self::default() }
    }

    /// East and North of a station.
    pub fn frame(&self, station: u16) -> Option<&LocalFrame> {
        self.frames.get(&station)
    }

    /// What a track is told as now.
    pub fn told_as(&self, track: TrackId) -> VesselId {
        self.network_of.get(&track).map_or(VesselId::Track(track), |id| VesselId::Network(*id))
    }

    /// The stations that hear a vessel.
    pub fn stations(&self, vessel: VesselId) -> Vec<u16> {
        let members = match vessel {
            VesselId::Track(track) => return track.station.into_iter().collect(),
            VesselId::Network(id) => self.networks.get(&id).map_or(&[][..], |n| &n.members),
        };
        members.iter().filter_map(|m| m.station).collect()
    }

    /// Takes a record at a time, seconds of any clock that goes on.
    pub fn take(&mut self, record: &Value, now_s: f64) -> Vec<Word> {
        if record["type"] == "network_track" {
            return self.network(record, now_s);
        }
        let Some(report) = TrackReport::of(record) else { return Vec::new() };
        let VesselId::Track(track) = report.vessel else { return Vec::new() };
        match self.network_of.get(&track).copied() {
            None => vec![Word::Says(vec![report])],
            Some(id) => self.speaks(id, track, report, now_s).into_iter().collect(),
        }
    }

    /// A member's report as that of its network track, where it has to speak for that; behind it what the others said last.
    fn speaks(&mut self, id: u32, track: TrackId, report: TrackReport, now_s: f64) -> Option<Word> {
        let network = self.networks.get_mut(&id)?;
        if report.is_final || report.is_withdrawn || network.is_over {
            network.own.remove(&track);
            return None;
        }
        let report = TrackReport { vessel: VesselId::Network(id), ..report };
        if report.place.is_none() || network.placed_s.is_some_and(|at| now_s - at <= STALE_S) {
            return None;
        }
        network.own.insert(track, (report, now_s));
        network.own.retain(|_, (_, at)| now_s - *at <= STALE_S);
        let speaker = network.speaker.filter(|of| network.own.contains_key(of)).unwrap_or(track);
        network.speaker = Some(speaker);
        let others = network.own.iter().filter(|(of, _)| **of != track).map(|(_, (report, _))| *report);
        (speaker == track).then(|| Word::Says([report].into_iter().chain(others).collect()))
    }

    fn network(&mut self, record: &Value, now_s: f64) -> Vec<Word> {
        let Some(id) = record["id"].as_u64().and_then(|n| u32::try_from(n).ok()) else { return Vec::new() };
        if record["state"] == "withdrawn" {
            let Some(gone) = self.networks.remove(&id) else { return Vec::new() };
            self.network_of.retain(|_, of| *of != id);
            return vec![Word::Parts(id, gone.members.iter().map(|m| self.told_as(*m)).collect())];
        }
        let members: Vec<TrackId> =
            record["members"].as_array().into_iter().flatten().filter_map(TrackId::of).collect();
        let mut out = Vec::new();
        self.network_of.retain(|track, of| *of != id || members.contains(track));
        for track in &members {
            if self.network_of.insert(*track, id) != Some(id) {
                out.push(Word::Joins(*track, id));
            }
        }
        let seen: Vec<TrackReport> = self.seen(id, &members, record);
        let network = self.networks.entry(id).or_default();
        (network.members, network.is_over) = (members, record["state"] == "final");
        if seen.iter().any(|r| r.place.is_some()) {
            network.placed_s = Some(now_s);
            network.own.clear();
        } else {
            network.placed_s = None;
        }
        if self.networks.len() > NETWORKS
            && let Some((forgotten, _)) = self.networks.pop_first()
        {
            self.network_of.retain(|_, of| *of != forgotten);
        }
        if !seen.is_empty() {
            out.push(Word::Says(seen));
        }
        out
    }

    /// A network track as seen from the stations of its members.
    fn seen(&self, id: u32, members: &[TrackId], record: &Value) -> Vec<TrackReport> {
        let mut stations: Vec<u16> = members.iter().filter_map(|m| m.station).collect();
        stations.dedup();
        let known = stations.iter().filter_map(|of| Some((*of, self.frames.get(of)?)));
        let seen: Vec<TrackReport> =
            known.map(|(of, frame)| seen_from(id, of, Some(frame), record)).collect();
        match stations.first().filter(|_| seen.is_empty()) {
            // Nobody knows where; that it is there still is known.
            Some(of) => vec![seen_from(id, *of, None, record)],
            None => seen,
        }
    }
}

/// A network track's report as seen from a station.
fn seen_from(id: u32, station: u16, frame: Option<&LocalFrame>, record: &Value) -> TrackReport {
    let number = |key: &str| record[key].as_f64().filter(|x| x.is_finite());
    // Stations that contradict each other tell no place.
    let agrees = record["consistent"] != false;
    let at = frame.zip(number("lat_deg").zip(number("lon_deg"))).filter(|_| agrees);
    let placed = at.map(|(frame, (lat, lon))| {
        let (x, y) = frame.east_north_m(lat, lon);
        let (east, north) = frame.east_north_m(lat + NORTH_STEP_DEG, lon);
        // The vessel's North is not the station's.
        ((x, y), (east - x).atan2(north - y))
    });
    let place = placed.and_then(|(place, north)| {
        let told = Covariance { xx: number("var_x_m2")?, yy: number("var_y_m2")?, xy: number("cov_xy_m2")? };
        Some((place, told.turned(-north)))
    });
    let radians = |key: &str| number(key).map(f64::to_radians);
    let north = placed.map_or(0.0, |(_, north)| north);
    let heading = radians("heading_deg").map(|h| wrap_pi(h + north));
    let closest = record["closest"].as_array().into_iter().flatten().find(|c| c["station"] == station);
    let closest = closest.unwrap_or(&Value::Null);
    let of_closest = |key: &str| closest[key].as_f64().filter(|x| x.is_finite());
    TrackReport {
        vessel: VesselId::Network(id),
        station: Some(station),
        is_final: record["state"] == "final",
        is_withdrawn: false,
        utc_s: utc(&record["utc"]).map(|t_s| (t_s, None)),
        place,
        heading_rad: heading.zip(radians("sd_heading_deg")),
        speed_m_s: number("speed_m_s").zip(number("sd_speed_m_s")),
        cpa_utc_s: utc(&closest["utc"]).zip(of_closest("sd_s")),
        cpa_range_m: of_closest("range_m").zip(of_closest("sd_range_m")),
    }
}

#[cfg(test)]
mod tests;
