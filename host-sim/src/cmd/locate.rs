//! `seabearing locate`: positions from a network of arrays.

use crate::csv::{Table, good_rows};
use crate::orientation::local_frame::LocalFrame;
use crate::orientation::sets::{Row, Set, gather};
use crate::station::Station;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use seabearing_core::config::StationConfig;
use seabearing_core::network::{Fix, MAX_ARRAYS, Region, Settings, locate};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `seabearing locate`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  \
    seabearing locate --stations network.toml --depth-m 5 bearings.csv\n\n\
    BEARINGS.csv has the header t_s,station,azimuth_deg,elevation_deg; station is an id or a name of the stations \
    file, azimuths are true (clockwise from North), an empty elevation means none was measured. Rows within 1 s of \
    each other are one measurement set. A set that does not determine a position gives a `no_fix` record with the \
    reason.")]
pub struct Args {
    /// Bearings: t_s,station,azimuth_deg,elevation_deg.
    bearings: PathBuf,
    /// Network file: a list of `[[stations]]`.
    #[arg(long)]
    stations: PathBuf,
    /// Standard deviation of azimuths, degrees.
    #[arg(long, default_value_t = 1.5)]
    sigma_azimuth_deg: f64,
    /// Standard deviation of elevations, degrees.
    #[arg(long, default_value_t = 1.6)]
    sigma_elevation_deg: f64,
    /// Depth of the source, where known, metres.
    #[arg(long)]
    depth_m: Option<f64>,
    /// Half-width of the search region about the network, metres.
    #[arg(long, default_value_t = 2000.0)]
    max_range_m: f64,
    /// Azimuths are relative to each array's own North: add its orientation_deg.
    #[arg(long)]
    relative: bool,
    /// Use every array even where one contradicts the others.
    #[arg(long)]
    keep_outliers: bool,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    for (key, x) in [
        ("sigma-azimuth-deg", args.sigma_azimuth_deg),
        ("sigma-elevation-deg", args.sigma_elevation_deg),
        ("max-range-m", args.max_range_m),
    ] {
        if !(x > 0.0 && x.is_finite()) {
            bail!("--{key} is {x}; a positive number is needed");
        }
    }
    if let Some(d) = args.depth_m
        && !d.is_finite()
    {
        bail!("--depth-m is {d}; a finite number is needed");
    }
    let network = Network::read(&args.stations)?;
    let mut rows = read_rows(&args.bearings, &network, args.relative)?;
    let sd = (args.sigma_azimuth_deg * RAD_PER_DEG, args.sigma_elevation_deg * RAD_PER_DEG);
    let sets = gather(&mut rows, &network.arrays_m, sd);
    let settings = Settings { region: network.region(&args)?, robust: !args.keep_outliers };

    let bar = crate::progress::bar(sets.len() as u64, "fixes");
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    if !args.json {
        writeln!(
            out,
            "{:>12} {:>9} {:>9} {:>8} {:>7} {:>7} {:>7}  stations",
            "t_s", "x_m", "y_m", "z_m", "sd_x", "sd_y", "sd_z"
        )?;
    }
    for set in &sets {
        let result = locate(&set.sightings, &settings);
        bar.inc(1);
        match (&result, args.json) {
            (Ok(fix), true) => writeln!(out, "{}", network.record(set, fix))?,
            (Ok(fix), false) => writeln!(out, "{}", network.line(set, fix))?,
            (Err(e), true) => {
                let record = json!({
                    "type": "no_fix", "t_s": set.t_s, "reason": e.to_string(), "stations": network.ids(set, None),
                });
                writeln!(out, "{record}")?;
            }
            (Err(e), false) => writeln!(out, "{:12.3} no fix: {e}", set.t_s)?,
        }
    }
    bar.finish_and_clear();
    out.flush()?;
    Ok(())
}

/// The stations in one local frame.
struct Network {
    stations: Vec<StationConfig>,
    arrays_m: Vec<[f64; 3]>,
    frame: Option<LocalFrame>,
}

impl Network {
    fn read(path: &Path) -> Result<Self> {
        let stations = Station::read_network(path)?;
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
            return Ok(Self { stations, arrays_m, frame: None });
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
        Ok(Self { stations, arrays_m, frame: Some(frame) })
    }

    /// Station named in a cell, by id or by name.
    fn find(&self, cell: &str) -> Result<usize> {
        let by = |f: &dyn Fn(&StationConfig) -> bool| self.stations.iter().position(f);
        by(&|s| s.name.as_str() == cell)
            .or_else(|| cell.parse::<u16>().ok().and_then(|id| by(&|s| s.id == id)))
            .ok_or_else(|| {
                let known: Vec<_> =
                    self.stations.iter().map(|s| format!("{} (`{}`)", s.id, s.name)).collect();
                anyhow!("station `{cell}` is not in the network; there are {}", known.join(", "))
            })
    }

    fn region(&self, args: &Args) -> Result<Region> {
        let n = self.arrays_m.len() as f64;
        let centre = [0, 1].map(|k| self.arrays_m.iter().map(|a| a[k]).sum::<f64>() / n);
        if let Some(depth) = args.depth_m {
            return Ok(Region::at_depth(centre, args.max_range_m, -depth));
        }
        let deepest = self.arrays_m.iter().map(|a| a[2]).fold(f64::INFINITY, f64::min);
        if deepest >= 0.0 {
            bail!("the stations have no depth, so the water column is unknown: give --depth-m of the source");
        }
        Ok(Region::between(centre, args.max_range_m, (deepest, 0.0)))
    }

    fn ids(&self, set: &Set, without: Option<usize>) -> Vec<u16> {
        set.stations
            .iter()
            .enumerate()
            .filter(|(i, _)| Some(*i) != without)
            .map(|(_, s)| self.stations[*s].id)
            .collect()
    }

    fn record(&self, set: &Set, fix: &Fix) -> Value {
        let [x, y, z] = fix.position_m;
        let c = &fix.covariance_m2;
        let mut record = json!({
            "type": "fix", "t_s": set.t_s, "x_m": x, "y_m": y, "z_m": z,
            "sd_x_m": c[0][0].sqrt(), "sd_y_m": c[1][1].sqrt(), "sd_z_m": c[2][2].sqrt(), "cov_xy_m2": c[0][1],
            "stations": self.ids(set, fix.rejected), "misfit": fix.misfit, "freedom": fix.freedom,
            "consistent": fix.consistent, "height_at_limit": fix.height_at_limit,
        });
        if let (Some(frame), Some(map)) = (&self.frame, record.as_object_mut()) {
            let (lat, lon) = frame.lat_lon_deg(x, y);
            map.insert("lat_deg".into(), lat.into());
            map.insert("lon_deg".into(), lon.into());
        }
        if let (Some(i), Some(map)) = (fix.rejected, record.as_object_mut()) {
            map.insert("rejected".into(), self.stations[set.stations[i]].id.into());
        }
        record
    }

    fn line(&self, set: &Set, fix: &Fix) -> String {
        let [x, y, z] = fix.position_m;
        let sd = [0, 1, 2].map(|k| fix.covariance_m2[k][k].sqrt());
        let ids: Vec<_> = self.ids(set, fix.rejected).iter().map(u16::to_string).collect();
        let remark = match (fix.rejected, fix.consistent) {
            (Some(i), _) => format!(" (set aside: {})", self.stations[set.stations[i]].id),
            (None, false) => " (arrays disagree; errors enlarged)".to_owned(),
            (None, true) => String::new(),
        };
        format!(
            "{:12.3} {x:9.1} {y:9.1} {z:8.1} {:7.1} {:7.1} {:7.1}  {}{remark}",
            set.t_s,
            sd[0],
            sd[1],
            sd[2],
            ids.join(" ")
        )
    }
}

fn read_rows(path: &Path, network: &Network, relative: bool) -> Result<Vec<Row>> {
    let table = Table::read(path)?;
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
                Ok(Row {
                    t_s,
                    station,
                    azimuth: wrap_tau((azimuth_deg + turn) * RAD_PER_DEG),
                    elevation: elevation.map(|e| e * RAD_PER_DEG),
                })
            });
            (line, row)
        })
        .collect();
    good_rows(&name, rows)
}
