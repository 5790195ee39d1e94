//! A network file (`[[stations]]`) and the bearings of its arrays.

use super::sets::BearingRow;
use crate::csv::{CsvTable, good_rows};
use crate::geodesy::LocalFrame;
use crate::station::{CLOCK_SD_S, ORIENTATION_SD_DEG, Station};
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use seabearing_core::config::StationConfig;
use seabearing_locate::network::MAX_ARRAYS;
use seabearing_locate::network::joint::SharedError;
use std::collections::HashSet;
use std::path::Path;
use time::OffsetDateTime;

/// The stations in one local frame.
pub struct Network {
    /// The stations of the file, in its order.
    pub stations: Vec<StationConfig>,
    /// East, North, Up of each, metres.
    pub arrays_m: Vec<[f64; 3]>,
    /// The local frame, where the file gives latitudes: its origin is the first station.
    pub frame: Option<LocalFrame>,
    /// Standard deviation of each one's orientation, radians.
    pub sd_orientation: Vec<f64>,
    /// Whether the file says it.
    pub says_orientation: Vec<bool>,
    /// Standard deviation of each one's clock, seconds, where the file says it.
    pub sd_clock_s: Vec<Option<f64>>,
}

impl Network {
    /// Reads a network file.
    ///
    /// # Errors
    /// One line that names the file and what is wrong.
    pub fn read(path: &Path) -> Result<Self> {
        let (_, listed) = Station::read_listed(path)?;
        let says_orientation = listed.iter().map(|s| s.orientation_sd_deg.is_some()).collect();
        let sd_orientation =
            listed.iter().map(|s| s.orientation_sd_deg.unwrap_or(ORIENTATION_SD_DEG) * RAD_PER_DEG);
        let sd_orientation = sd_orientation.collect();
        let sd_clock_s = listed.iter().map(|s| s.clock_sd_s).collect();
        let stations: Vec<_> = listed.into_iter().map(|s| s.config).collect();
        let name = path.display();
        if stations.len() > MAX_ARRAYS {
            bail!("{name}: {} stations; at most {MAX_ARRAYS} make one network", stations.len());
        }
        for (i, s) in stations.iter().enumerate() {
            if stations[..i].iter().any(|o| o.id == s.id && o.name == s.name) {
                bail!("{name}: two stations have the same id {} and name `{}`", s.id, s.name);
            }
        }
        let local: Option<Vec<_>> = stations
            .iter()
            .map(|s| s.local_east_north_m.map(|(east, north)| [east, north, -s.depth_m]))
            .collect();
        if let Some(arrays_m) = local {
            return Ok(Self {
                stations,
                arrays_m,
                frame: None,
                sd_orientation,
                says_orientation,
                sd_clock_s,
            });
        }
        let Some((lat, lon)) = stations[0].lat_lon_deg else {
            bail!("{name}: station `{}` has no position (lat_deg and lon_deg, or local_m)", stations[0].name)
        };
        let frame = LocalFrame::new(lat, lon);
        let arrays_m = stations
            .iter()
            .map(|s| {
                let (lat, lon) = s.lat_lon_deg.with_context(|| {
                    format!("{name}: station `{}` has no lat_deg and lon_deg as the others have", s.name)
                })?;
                let (east, north) = frame.east_north_m(lat, lon);
                Ok([east, north, -s.depth_m])
            })
            .collect::<Result<_>>()?;
        Ok(Self { stations, arrays_m, frame: Some(frame), sd_orientation, says_orientation, sd_clock_s })
    }

    /// What the bearings of each station share: errors of its orientation and its clock. `stated_s`: what each recorder
    /// states of its clock, which counts where the file says nothing.
    pub fn shared(&self, stated_s: &[Option<f64>]) -> [SharedError; MAX_ARRAYS] {
        let mut out = [SharedError::default(); MAX_ARRAYS];
        for (i, (of, azimuth)) in out.iter_mut().zip(&self.sd_orientation).enumerate() {
            let stated_s = stated_s.get(i).copied().flatten();
            let clock_s = self.sd_clock_s[i].or(stated_s).unwrap_or(CLOCK_SD_S);
            *of = SharedError { azimuth: *azimuth, clock_s };
        }
        out
    }

    /// Those of [`Self::shared`] that the file or the recorder states; 0 where neither does.
    pub fn said(&self, stated_s: &[Option<f64>]) -> [SharedError; MAX_ARRAYS] {
        let mut out = self.shared(stated_s);
        for (i, of) in out.iter_mut().enumerate() {
            if self.says_orientation.get(i) != Some(&true) {
                of.azimuth = 0.0;
            }
            let clocks = [&self.sd_clock_s[..], stated_s];
            if clocks.iter().all(|clocks| clocks.get(i).copied().flatten().is_none()) {
                of.clock_s = 0.0;
            }
        }
        out
    }

    /// Station named in a cell, by id or by name.
    ///
    /// # Errors
    /// There is none such; the known ones are named.
    pub fn find(&self, cell: &str) -> Result<usize> {
        let by = |f: &dyn Fn(&StationConfig) -> bool| self.stations.iter().position(f);
        by(&|s| s.name.as_str() == cell)
            .or_else(|| cell.parse::<u16>().ok().and_then(|id| by(&|s| s.id == id)))
            .ok_or_else(|| {
                let known: Vec<_> =
                    self.stations.iter().map(|s| format!("{} (`{}`)", s.id, s.name)).collect();
                anyhow!("station `{cell}` is not in the network; there are {}", known.join(", "))
            })
    }
}

/// Bearings of a network.
#[derive(Default)]
pub struct NetworkBearings {
    /// The bearings.
    pub rows: Vec<BearingRow>,
    /// UTC of time zero, where there is a clock.
    pub start: Option<OffsetDateTime>,
    /// Standard deviation of each station's clock that its recorder states, seconds.
    pub sd_clock_s: Vec<Option<f64>>,
    /// Some are of ocean-bottom stations, which hear tens of kilometres.
    pub of_the_floor: bool,
}

impl NetworkBearings {
    /// Brings the bearings in order of time and leaves each once; whether those of a station were not in order, and how many stood there again.
    pub fn once(&mut self) -> (bool, usize) {
        let mut last = [f64::NEG_INFINITY; MAX_ARRAYS];
        let mut ordered = true;
        for row in &self.rows {
            if let Some(last) = last.get_mut(row.station) {
                ordered &= row.t_s >= *last;
                *last = row.t_s;
            }
        }
        self.rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let before = self.rows.len();
        let mut seen = HashSet::new();
        self.rows.retain(|row| {
            let elevation = row.elevation.map(f64::to_bits);
            seen.insert((row.station, row.t_s.to_bits(), row.azimuth.to_bits(), elevation))
        });
        (!ordered, before - self.rows.len())
    }
}

/// Reads `t_s,station,azimuth_deg,elevation_deg`; `relative`: azimuths are from each array's own North. Rows that
/// cannot be used are named on standard error and left out. `sd`: standard deviations of azimuth and elevation, radians.
///
/// # Errors
/// The file cannot be read, or no row of it is usable.
pub fn read_rows(path: &Path, network: &Network, sd: (f64, f64), relative: bool) -> Result<Vec<BearingRow>> {
    let table = CsvTable::read(path)?;
    let name = path.display().to_string();
    let station_column = table.column("station")?;
    let elevation_column = table.column("elevation_deg")?;
    let rows = table.numbers(["t_s", "azimuth_deg"])?;
    let rows = rows
        .into_iter()
        .enumerate()
        .map(|(i, (line, numbers))| {
            let row = numbers.and_then(|[t_s, azimuth_deg]| {
                let here = || format!("{name}, line {line}");
                let cell = table.text(i, station_column).unwrap_or("");
                let station = network.find(cell).with_context(here)?;
                let elevation = match table.text(i, elevation_column).unwrap_or("") {
                    "" => None,
                    text => Some(
                        text.parse::<f64>()
                            .ok()
                            .filter(|e| e.abs() <= 90.0)
                            .ok_or_else(|| anyhow!("`elevation_deg` is `{text}`; -90 to 90 was expected"))
                            .with_context(here)?,
                    ),
                };
                let turn = if relative { network.stations[station].orientation_deg } else { 0.0 };
                Ok(BearingRow {
                    t_s,
                    station,
                    azimuth: wrap_tau((azimuth_deg + turn) * RAD_PER_DEG),
                    elevation: elevation.map(|e| e * RAD_PER_DEG),
                    sd,
                })
            });
            (line, row)
        })
        .collect();
    good_rows(&name, rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bearing_counts_once_in_order_of_time() {
        let row = |t_s: f64, station, azimuth| BearingRow {
            t_s,
            station,
            azimuth,
            elevation: None,
            sd: (0.01, 0.01),
        };
        let (a, b, c) = (row(1.0, 0, 0.5), row(1.0, 1, 0.5), row(2.0, 0, 0.6));
        let mut heard = NetworkBearings { rows: vec![c, a, b, a], ..NetworkBearings::default() };
        assert_eq!(heard.once(), (true, 1));
        assert_eq!(heard.once(), (false, 0));
        // One station after the other is in order.
        let mut apart = NetworkBearings { rows: vec![a, c, b], ..NetworkBearings::default() };
        assert_eq!(apart.once(), (false, 0));
        let told: Vec<_> = heard.rows.iter().map(|r| (r.t_s, r.station)).collect();
        assert_eq!(told, [(1.0, 0), (1.0, 1), (2.0, 0)]);
    }
}
