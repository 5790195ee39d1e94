//! Rows of a bearings file gathered into measurement sets, each brought to one instant.

use seabearing_locate::network::common_time::{Timed, bring, bring_azimuth};
use seabearing_locate::network::model::Sighting;

/// Rows closer in time than this are one measurement set, seconds (paper N: the arrays' instants differ by less).
const SAME_SET_S: f64 = 1.0;

/// One row of the bearings file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BearingRow {
    /// Time, seconds.
    pub t_s: f64,
    /// Index of the station.
    pub station: usize,
    /// Azimuth, radians.
    pub azimuth: f64,
    /// Elevation, radians, where given.
    pub elevation: Option<f64>,
    /// Standard deviations of azimuth and elevation, radians.
    pub sd: (f64, f64),
}

/// Sightings of one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct SightingSet {
    /// The instant: mean time of the set's rows, seconds.
    pub t_s: f64,
    /// One sighting a station.
    pub sightings: Vec<Sighting>,
    /// Index of the station of each sighting.
    pub stations: Vec<usize>,
}

impl SightingSet {
    /// The same instant without a station.
    pub fn without(&self, station: usize) -> Self {
        let others = || self.stations.iter().zip(&self.sightings).filter(|(k, _)| **k != station);
        Self {
            t_s: self.t_s,
            sightings: others().map(|(_, seen)| *seen).collect(),
            stations: others().map(|(k, _)| *k).collect(),
        }
    }
}

/// Gathers rows into sets: a set begins with the earliest row not yet used and takes every row within
/// `SAME_SET_S` of it; of two rows of one station the earlier begins the next set. `rows` are sorted by time.
pub fn gather(rows: &mut [BearingRow], arrays_m: &[[f64; 3]]) -> Vec<SightingSet> {
    rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let mut of_station: Vec<(Vec<Timed>, Vec<Timed>)> = vec![(Vec::new(), Vec::new()); arrays_m.len()];
    for r in rows.iter() {
        let (azimuths, elevations) = &mut of_station[r.station];
        azimuths.push(Timed { t_s: r.t_s, angle: r.azimuth });
        if let Some(angle) = r.elevation {
            elevations.push(Timed { t_s: r.t_s, angle });
        }
    }
    let mut out = Vec::new();
    let mut next = 0;
    while next < rows.len() {
        let begin = rows[next].t_s;
        let mut members: Vec<BearingRow> = Vec::new();
        while let Some(row) = rows.get(next) {
            if row.t_s - begin > SAME_SET_S || members.iter().any(|m| m.station == row.station) {
                break;
            }
            members.push(*row);
            next += 1;
        }
        out.push(bring_together(&members, &of_station, arrays_m));
    }
    out
}

fn bring_together(
    members: &[BearingRow],
    of_station: &[(Vec<Timed>, Vec<Timed>)],
    arrays_m: &[[f64; 3]],
) -> SightingSet {
    let first = members[0].t_s;
    let t_s = first + members.iter().map(|m| m.t_s - first).sum::<f64>() / members.len() as f64;
    let sightings = members
        .iter()
        .map(|r| {
            let (azimuths, elevations) = &of_station[r.station];
            let (azimuth, sd_azimuth) =
                bring_azimuth(&Timed { t_s: r.t_s, angle: r.azimuth }, window(azimuths, r.t_s), t_s, r.sd.0);
            let elevation = r
                .elevation
                .map(|e| bring(&Timed { t_s: r.t_s, angle: e }, window(elevations, r.t_s), t_s, r.sd.1));
            Sighting {
                array_m: arrays_m[r.station],
                azimuth,
                elevation: elevation.map(|e| e.0),
                sd_azimuth,
                sd_elevation: elevation.map_or(r.sd.1, |e| e.1),
            }
        })
        .collect();
    SightingSet { t_s, sightings, stations: members.iter().map(|m| m.station).collect() }
}

/// The neighbours of an instant, so that long files stay linear in time.
fn window(all: &[Timed], t_s: f64) -> &[Timed] {
    use seabearing_locate::network::common_time::WINDOW_S;
    let from = all.partition_point(|p| p.t_s < t_s - WINDOW_S);
    let to = all.partition_point(|p| p.t_s <= t_s + WINDOW_S);
    &all[from..to]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(t_s: f64, station: usize) -> BearingRow {
        BearingRow { t_s, station, azimuth: 1.0, elevation: None, sd: (0.02, 0.02) }
    }

    #[test]
    fn rows_within_a_second_are_one_set() {
        let mut rows = vec![row(0.9, 1), row(0.0, 0), row(2.0, 0), row(3.1, 1), row(4.0, 0), row(4.5, 0)];
        let sets = gather(&mut rows, &[[0.0; 3], [100.0, 0.0, 0.0]]);
        let stations: Vec<_> = sets.iter().map(|s| s.stations.clone()).collect();
        assert_eq!(stations, [vec![0, 1], vec![0], vec![1, 0], vec![0]]);
        assert!((sets[0].t_s - 0.45).abs() < 1e-12);
    }
}
