//! Which stations are fused with each other: *regions* of stations that stand near each other, at most [`MAX_ARRAYS`] in
//! each, and a fusion for each region.
//!
//! In: the stations file. Nearest stations come together first, as long as a region stays small and near enough (the
//! clusters of single linkage, with a bound); a region that is left with fewer than three takes its nearest stations from a larger
//! one. A vessel that goes from one region to another is a network track of each.

use super::sites::{Place, Sites};
use super::{Found, Fusion};
use crate::stations::Listed;
use seabearing_locate::network::MAX_ARRAYS;
use serde_json::Value;
use std::collections::HashMap;

/// Farthest that a station may be from the first of its region, metres: beyond, the plane is no picture of the sea.
const FARTHEST_M: f64 = 100_000.0;
/// Stations that are fused, of all regions together: every two of them are compared once, when the base station starts.
pub const MOST: usize = 1024;
/// A region with fewer takes stations from a larger one: with two stations no third tells which of them is wrong.
const LEAST: usize = 3;

/// The stations that are fused, region by region.
#[derive(Clone, Debug, Default)]
pub struct Regions {
    /// The regions, each with two stations or more, in the order of their first stations in the stations file.
    pub regions: Vec<Sites>,
    /// Stations that would be fused if there were not more than [`MOST`].
    pub left_out: usize,
}

impl Regions {
    /// Of a stations file, and a line for each thing that an operator should know of it.
    pub fn of(listed: &[Listed]) -> (Self, Vec<String>) {
        let mut notes = Vec::new();
        let in_plane = !listed.is_empty() && listed.iter().all(|s| s.config.lat_lon_deg.is_none());
        let mut placed: Vec<(&Listed, Place)> = Vec::new();
        let mut left_out: Vec<u16> = Vec::new();
        for s in listed {
            match Place::of(s, in_plane) {
                Ok(_) if placed.len() == MOST => left_out.push(s.config.id),
                Ok(place) => placed.push((s, place)),
                Err(why) => notes.push(format!("station {} {why}; its bearings are not fused", s.config.id)),
            }
        }
        let places: Vec<Place> = placed.iter().map(|p| p.1).collect();
        let mut regions = Vec::new();
        for members in divided(&places) {
            let stations: Vec<(&Listed, Place)> = members.iter().map(|n| placed[*n]).collect();
            if let [(alone, _)] = &stations[..] {
                notes.push(format!(
                    "station {} has no other within {:.0} km; its bearings are not fused",
                    alone.config.id,
                    FARTHEST_M / 1000.0
                ));
                continue;
            }
            regions.push(Sites::of(&stations));
        }
        if regions.len() > 1 {
            let said: Vec<String> = regions.iter().map(Sites::numbers).collect();
            notes.push(format!(
                "bearings are fused in {} regions of at most {MAX_ARRAYS} stations: {}; a vessel between two of them is a network \
                 track of each",
                regions.len(),
                said.join("; ")
            ));
        }
        if let [first, .., last] | [first @ last] = &left_out[..] {
            notes.push(format!(
                "{MOST} stations are fused, the first of the stations file; {} are not (from {first} to {last}): give the stations of \
                 some regions to a base station of their own",
                left_out.len()
            ));
        }
        (Self { regions, left_out: left_out.len() }, notes)
    }

    /// Stations that are fused.
    pub fn stations(&self) -> usize {
        self.regions.iter().map(|r| r.sites.len()).sum()
    }
}

/// Numbers of the places of each region, in order.
fn divided(places: &[Place]) -> Vec<Vec<usize>> {
    let n = places.len();
    let mut near: Vec<(f64, usize, usize)> = Vec::new();
    for (a, from) in places.iter().enumerate() {
        for (b, to) in places.iter().enumerate().skip(a + 1) {
            let distance = from.distance_m(to);
            if distance <= FARTHEST_M {
                near.push((distance, a, b));
            }
        }
    }
    near.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut region_of: Vec<usize> = (0..n).collect();
    let mut regions: Vec<Vec<usize>> = (0..n).map(|k| vec![k]).collect();
    // The plane of a region is that of its first station.
    let fits = |all: &[usize]| {
        let first = all.iter().min();
        let near = |k: &usize| first.is_none_or(|first| places[*first].distance_m(&places[*k]) <= FARTHEST_M);
        all.len() <= MAX_ARRAYS && all.iter().all(near)
    };
    for (_, a, b) in &near {
        let (a, b) = (region_of[*a], region_of[*b]);
        let together = [&regions[a][..], &regions[b][..]].concat();
        if a != b && fits(&together) {
            together.iter().for_each(|k| region_of[*k] = a);
            regions[b].clear();
            regions[a] = together;
        }
    }
    // A station that all others left alone is of no use: its nearest ones go with it.
    let both = || near.iter().flat_map(|(_, a, b)| [(*a, *b), (*b, *a)]);
    let given = |(poor, other): (usize, usize), regions: &[Vec<usize>], region_of: &[usize]| {
        let (to, from) = (region_of[poor], region_of[other]);
        if to == from || regions[to].len() >= LEAST || regions[from].len() <= LEAST {
            return None;
        }
        let with = [&regions[to][..], &[other]].concat();
        let mut without = regions[from].clone();
        without.retain(|k| *k != other);
        (fits(&with) && fits(&without)).then_some((other, (to, with), (from, without)))
    };
    while let Some((moved, (to, with), (from, without))) =
        both().find_map(|pair| given(pair, &regions, &region_of))
    {
        (regions[to], regions[from]) = (with, without);
        region_of[moved] = to;
    }
    let mut out: Vec<Vec<usize>> = regions.into_iter().filter(|r| !r.is_empty()).collect();
    out.iter_mut().for_each(|r| r.sort_unstable());
    out.sort_by_key(|r| r.first().copied());
    out
}

/// A fusion for each region; network tracks have numbers of one sequence.
pub struct Fusions {
    fusions: Vec<Fusion>,
    region_of: HashMap<u16, usize>,
    newest_id: u32,
}

impl Fusions {
    /// Nothing heard yet.
    pub fn new(regions: Regions) -> Self {
        let of = |(n, r): (usize, &Sites)| r.sites.iter().map(move |s| (s.station, n)).collect::<Vec<_>>();
        let region_of = regions.regions.iter().enumerate().flat_map(of).collect();
        Self { fusions: regions.regions.into_iter().map(Fusion::new).collect(), region_of, newest_id: 0 }
    }

    /// Takes a record, as [`Fusion::take`] does, where its station is of a region.
    pub fn take(&mut self, record: &Value) -> Vec<Found> {
        let said = if record["type"] == "network_track" {
            // Its number is taken, whatever became of its stations.
            let id = record["id"].as_u64().and_then(|n| u32::try_from(n).ok());
            self.newest_id = self.newest_id.max(id.unwrap_or(0));
            &record["members"][0]["station"]
        } else {
            &record["station"]
        };
        let station = said.as_u64().and_then(|n| u16::try_from(n).ok());
        let region = station.and_then(|s| self.region_of.get(&s));
        let Some(fusion) = region.and_then(|n| self.fusions.get_mut(*n)) else { return Vec::new() };
        fusion.newest_id = self.newest_id;
        let out = fusion.take(record);
        self.newest_id = fusion.newest_id;
        out
    }
}

#[cfg(test)]
mod tests;
