//! Bearings of several stations fused: which of their tracks are one vessel, and that vessel's motion.
//!
//! In: records as they are stored. Out: records `{"type":"network_track",..}` ([`NetworkTrack`]). [`Fusion`] is a function of
//! the records it is given, in any order of the stations; a track that comes hours late is fused then.
//!
//! - [`regions`]: which stations are fused with each other, and a fusion for each region;
//! - [`sites`]: the stations of a region in one plane;
//! - [`heard`]: a station's bearings, given to its own tracks;
//! - [`groups`]: tracks of several stations that are one vessel's, by [`seabearing_locate::network::joint`];
//! - [`task`]: the thread that does it beside the base station.

pub mod groups;
pub mod heard;
pub mod regions;
pub mod sites;
pub mod task;

use crate::record::{rfc3339, us_of};
use groups::{Fits, Group, Key, Node};
use heard::{Course, Heard, Station};
use seabearing_core::kit::spd;
use seabearing_host::record::{Closest, Kind, Member, NetworkTrack};
use seabearing_locate::network::joint::JointTrack;
use serde_json::{Value, json};
use sites::Sites;

/// Bearings of a track before it is fused.
const LEAST: usize = 20;
/// Least time between two looks at a track that goes on, and between two live reports, s.
const EVERY_S: f64 = 10.0;
/// What is older than the newest record by so much is fused no more, s.
const FORGOTTEN_S: f64 = 7200.0;
/// Beyond so much a heading is not known, radians: a uniform circle has 1.8.
const HEADING_SD: f64 = 1.2;

/// A record that fusion leads to: its station, where it is of one, and its body.
pub type Found = (Option<u16>, Value);

/// A network track as it was told last.
#[derive(Clone, Debug)]
struct Told {
    id: u32,
    members: Vec<Key>,
    /// It has ended.
    over: bool,
    /// Newest bearing, and bearings.
    to_s: f64,
    n: usize,
}

/// Fuses what the stations of one region hear.
pub struct Fusion {
    sites: Sites,
    stations: Vec<Station>,
    told: Vec<Told>,
    fits: Fits,
    newest_s: f64,
    /// When the tracks were looked at last, by the record that led to it.
    looked_s: f64,
    newest_id: u32,
}

impl Fusion {
    /// Nothing heard yet.
    pub fn new(sites: Sites) -> Self {
        let n = sites.sites.len();
        Self {
            sites,
            stations: vec![Station::default(); n],
            told: Vec::new(),
            fits: Fits::default(),
            newest_s: f64::NEG_INFINITY,
            looked_s: f64::NEG_INFINITY,
            newest_id: 0,
        }
    }

    /// Takes a record as the base station publishes it; gives the station and the body of those that it leads to. Records
    /// without UTC, or of other stations, lead to none.
    pub fn take(&mut self, record: &Value) -> Vec<Found> {
        let kind = record["type"].as_str().unwrap_or("");
        if kind == "network_track" {
            self.remember(record);
            return Vec::new();
        }
        let of = record["station"].as_u64().and_then(|n| u16::try_from(n).ok());
        let number = |key: &str| record[key].as_f64().filter(|x| x.is_finite());
        let session = record["session"].as_u64().and_then(|n| u32::try_from(n).ok());
        let (Some(station), Some(session), Some(utc_us)) = (of, session, us_of(&record["utc"])) else {
            return Vec::new();
        };
        let Some(site) = self.sites.find(station) else { return Vec::new() };
        let utc_s = utc_us as f64 * 1e-6;
        match kind {
            "bearing" | "azimuth" => {
                let sd = number("sd_azimuth_deg").or(number("sd_deg"));
                let (Some(azimuth), Some(sd), Some(t_s)) = (number("azimuth_deg"), sd, number("t_s")) else {
                    return Vec::new();
                };
                // Of an ocean-bottom station's modes the likeliest, where a vessel was detected.
                let weight = number("weight").unwrap_or(1.0);
                if record["detected"] == false || weight < 0.5 || record["source"] == "impulsive" {
                    return Vec::new();
                }
                let heard = Heard {
                    t_s: utc_s,
                    sd_clock_s: number("sd_utc_s").unwrap_or(f64::INFINITY),
                    azimuth: azimuth.to_radians(),
                    variance: sd.to_radians().powi(2),
                };
                self.newest_s = self.newest_s.max(utc_s);
                let late = self.stations[site].is_late(utc_s);
                let jumped = self.stations[site].bearing(session, t_s, heard);
                if jumped.is_some() {
                    self.fits = Fits::default();
                }
                let mut out: Vec<_> = jumped.map(|by_s| jump(station, by_s)).into_iter().collect();
                if late && (utc_s - self.looked_s).abs() >= EVERY_S {
                    self.looked_s = utc_s;
                    out.extend(self.look());
                }
                out
            }
            "track" => {
                let Some(id) = record["id"].as_u64().and_then(|n| u16::try_from(n).ok()) else {
                    return Vec::new();
                };
                let stage = record["stage"].as_str().unwrap_or("");
                if stage == "withdrawn" {
                    self.stations[site].withdraw((session, id));
                    return self.look();
                }
                let values = ["x_m", "y_m", "heading_deg", "speed_m_s"].map(number);
                let [Some(x), Some(y), Some(heading), Some(speed)] = values else { return Vec::new() };
                let (s, c) = heading.to_radians().sin_cos();
                let course = Course { t_s: utc_s, at_m: [x, y], velocity_m_s: [speed * s, speed * c] };
                let over = stage == "final";
                self.stations[site].report((session, id), course, over);
                if !over && (utc_s - self.looked_s).abs() < EVERY_S {
                    return Vec::new();
                }
                self.looked_s = utc_s;
                self.look()
            }
            _ => Vec::new(),
        }
    }

    /// Takes up what a network track was told to be before this program began.
    fn remember(&mut self, record: &Value) {
        let Some(id) = record["id"].as_u64().and_then(|n| u32::try_from(n).ok()) else { return };
        self.newest_id = self.newest_id.max(id);
        self.told.retain(|t| t.id != id);
        let member = |m: &Value| {
            let n = |key: &str| m[key].as_u64();
            let site = self.sites.find(n("station")?.try_into().ok()?)?;
            Some((site, (n("session")?.try_into().ok()?, n("id")?.try_into().ok()?)))
        };
        let members: Vec<Key> =
            record["members"].as_array().into_iter().flatten().filter_map(member).collect();
        if record["state"] != "withdrawn" && members.len() > 1 {
            let to_s = us_of(&record["to_utc"]).unwrap_or(0) as f64 * 1e-6;
            let n = record["n"].as_u64().unwrap_or(0) as usize;
            self.told.push(Told { id, members, over: record["state"] == "final", to_s, n });
        }
    }

    /// Looks at all tracks that are there; what has changed is told.
    fn look(&mut self) -> Vec<Found> {
        let oldest_s = self.newest_s - FORGOTTEN_S;
        for station in &mut self.stations {
            station.settle();
            station.tracks.retain(|_, track| track.span().is_none_or(|s| s.1 > oldest_s));
        }
        self.told.retain(|t| t.to_s > oldest_s);
        let mut nodes = Vec::new();
        for (site, station) in self.stations.iter().enumerate() {
            for (number, track) in station.tracks.iter().filter(|(_, t)| t.count() >= LEAST) {
                let Some(span) = track.span() else { continue };
                let (averages, own) = track.averages();
                let (key, sd_clock_s) = ((site, *number), track.sd_clock_s());
                nodes.push(Node { key, version: track.version, averages, own, span, sd_clock_s });
            }
        }
        let before: Vec<Vec<Key>> = self.told.iter().map(|t| t.members.clone()).collect();
        let found = groups::groups(&self.sites, &nodes, &before, &mut self.fits);
        let keys = |g: &Group| g.nodes.iter().map(|n| nodes[*n].key).collect::<Vec<_>>();
        let found: Vec<(Vec<Key>, Group)> = found.into_iter().map(|g| (keys(&g), g)).collect();
        let mut out = Vec::new();
        let mut kept = Vec::new();
        for (members, group) in found {
            let common = |t: &Told| t.members.iter().filter(|k| members.contains(k)).count();
            let was = (0..self.told.len()).max_by_key(|i| common(&self.told[*i]));
            let was = was.filter(|i| common(&self.told[*i]) > 0).map(|i| self.told.remove(i));
            let tracks = || members.iter().filter_map(|(site, n)| self.stations[*site].tracks.get(n));
            let over = tracks().all(|t| t.over);
            let n = tracks().map(|t| t.count()).sum();
            let spans = || tracks().filter_map(|t| t.span());
            let from_s = spans().map(|s| s.0).fold(f64::INFINITY, f64::min);
            let to_s = spans().map(|s| s.1).fold(f64::NEG_INFINITY, f64::max);
            let id = was.as_ref().map_or(self.newest_id + 1, |t| t.id);
            self.newest_id = self.newest_id.max(id);
            let now = Told { id, members, over, to_s, n };
            let old = was.as_ref().is_some_and(|w| {
                let same = w.members == now.members && w.over == over;
                same && (w.n == n || (!over && (to_s - w.to_s).abs() < EVERY_S))
            });
            if old {
                kept.extend(was);
                continue;
            }
            out.push(self.record(&now, Some(&group), from_s));
            kept.push(now);
        }
        for gone in std::mem::take(&mut self.told) {
            let track = |(site, n): &Key| self.stations[*site].tracks.get(n);
            // A group that cannot be told from others for now may be told again while its tracks go on.
            let ended = gone.members.iter().all(|m| track(m).is_some_and(|t| t.over));
            let taken = gone.members.iter().any(|m| kept.iter().any(|k| k.members.contains(m)));
            if ended || taken {
                out.push(self.record(&gone, None, gone.to_s));
            } else {
                kept.push(gone);
            }
        }
        self.told = kept;
        out
    }

    /// The record of a network track; without a group it is withdrawn.
    fn record(&self, told: &Told, group: Option<&Group>, from_s: f64) -> (Option<u16>, Value) {
        let utc = |s: f64| rfc3339((s * 1e6) as i64);
        let text = |s: f64| utc(s).as_str().map(str::to_owned);
        let motion = group.and_then(|g| g.motion.as_ref());
        let member = |(site, (session, id)): &Key| Member {
            station: self.sites.sites[*site].station,
            session: *session,
            id: *id,
        };
        let mut track = NetworkTrack {
            id: told.id,
            state: match (group, told.over) {
                (None, _) => "withdrawn",
                (_, true) => "final",
                _ => "live",
            },
            members: told.members.iter().map(member).collect(),
            from_utc: group.and_then(|_| text(from_s)),
            to_utc: text(told.to_s),
            lat_deg: None,
            lon_deg: None,
            x_m: None,
            y_m: None,
            var_x_m2: None,
            var_y_m2: None,
            cov_xy_m2: None,
            heading_deg: None,
            sd_heading_deg: None,
            speed_m_s: None,
            sd_speed_m_s: None,
            covariance: None,
            closest: None,
            consistent: motion.and(group).map(|g| g.consistent),
            n: told.n,
        };
        if let Some(motion) = motion {
            self.tell_motion(&mut track, motion, told.to_s);
        }
        let mut record = serde_json::to_value(Kind::NetworkTrack(track)).unwrap_or_default();
        record["utc"] = utc(told.to_s);
        (None, record)
    }

    fn tell_motion(&self, track: &mut NetworkTrack, motion: &JointTrack, t_s: f64) {
        let [x, y] = motion.position_m(t_s);
        let dt = t_s - motion.t_ref_s;
        let covariance = spd::propagated(
            &[[1.0, 0.0, dt, 0.0], [0.0, 1.0, 0.0, dt], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
            &motion.covariance,
        );
        (track.x_m, track.y_m) = (Some(x), Some(y));
        let (place, north) = self.sites.lat_lon_deg([x, y]);
        (track.lat_deg, track.lon_deg) = place.unzip();
        let (s, c) = north.sin_cos();
        let [[xx, xy, ..], [_, yy, ..], ..] = covariance;
        let [[xx, xy], [_, yy]] = spd::propagated(&[[c, -s], [s, c]], &[[xx, xy], [xy, yy]]);
        (track.var_x_m2, track.var_y_m2, track.cov_xy_m2) = (Some(xx), Some(yy), Some(xy));
        let ((heading, sd_heading), (speed, sd_speed)) = (motion.heading(), motion.speed_m_s());
        if sd_heading < HEADING_SD {
            track.heading_deg = Some((heading - north).to_degrees().rem_euclid(360.0));
            track.sd_heading_deg = Some(sd_heading.to_degrees());
        }
        if sd_speed.is_finite() {
            (track.speed_m_s, track.sd_speed_m_s) = (Some(speed), Some(sd_speed));
        }
        track.covariance = Some(covariance.into_iter().flatten().collect());
        let mut stations: Vec<u16> = track.members.iter().map(|m| m.station).collect();
        stations.dedup();
        track.closest =
            Some(stations.into_iter().filter_map(|station| self.closest(motion, station)).collect());
    }

    /// The closest point of approach to a station.
    fn closest(&self, motion: &JointTrack, station: u16) -> Option<Closest> {
        let [x, y, _] = self.sites.sites.get(self.sites.find(station)?)?.at_m;
        let closest = motion.closest([x, y])?;
        let finite = |x: f64| Some(x).filter(|x| x.is_finite());
        Some(Closest {
            station,
            utc: rfc3339((closest.t_s.0 * 1e6) as i64).as_str().map(str::to_owned),
            sd_s: finite(closest.t_s.1),
            range_m: finite(closest.range_m.0),
            sd_range_m: finite(closest.range_m.1),
        })
    }
}

/// The record of a clock that jumped.
fn jump(station: u16, by_s: f64) -> (Option<u16>, Value) {
    let text = format!(
        "station {station}: its UTC has jumped by {by_s:.1} s; what it heard before is fused no more, see to its clock"
    );
    (Some(station), json!({ "type": "warning", "code": "ClockJumped", "text": text }))
}

#[cfg(test)]
mod tests;
