//! Bearings of one array from a CSV file: `t_s,azimuth_deg` and optionally `sigma_deg`, `elevation_deg`.

use crate::csv::{CsvTable, good_rows};
use anyhow::{Result, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use seabearing_locate::motion::ml::Sample;
use std::path::Path;

/// Reads the bearings in order of time. `sd_rad`: standard deviation of an azimuth where no column `sigma_deg` says
/// another; `sd_elevation_rad`: that of elevations, which are read only where it is given. Rows that cannot be used are
/// named on standard error and left out.
///
/// # Errors
/// The file cannot be read, or no row of it is usable.
pub fn read(path: &Path, sd_rad: f64, sd_elevation_rad: Option<f64>) -> Result<Vec<Sample>> {
    let table = CsvTable::read(path)?;
    let name = path.display().to_string();
    let column = |key: &str, wanted: bool| -> Result<_> {
        (wanted && table.has(key)).then(|| table.numbers([key])).transpose()
    };
    let sigmas = column("sigma_deg", true)?;
    let elevations = column("elevation_deg", sd_elevation_rad.is_some())?;
    let mut rows = Vec::new();
    for (i, (line, row)) in table.numbers(["t_s", "azimuth_deg"])?.into_iter().enumerate() {
        let one = row.and_then(|[t_s, azimuth_deg]| {
            let sd_rad = match sigmas.as_ref().and_then(|s| s.get(i)) {
                Some((_, Ok([s]))) if *s > 0.0 => s * RAD_PER_DEG,
                Some((_, Ok([s]))) => bail!("{name}, line {line}: `sigma_deg` is {s}, it must be above 0"),
                Some((_, Err(e))) => bail!("{e:#}"),
                None => sd_rad,
            };
            let mut sample = Sample::azimuth(t_s, wrap_tau(azimuth_deg * RAD_PER_DEG), sd_rad);
            // A row may do without an elevation.
            if let (Some((_, Ok([e]))), Some(sd)) =
                (elevations.as_ref().and_then(|e| e.get(i)), sd_elevation_rad)
            {
                sample.elevation_rad = ((e * RAD_PER_DEG) as f32, sd as f32);
            }
            Ok(sample)
        });
        rows.push((line, one));
    }
    let mut samples = good_rows(&name, rows)?;
    if !samples.is_sorted_by(|a, b| a.t_s <= b.t_s) {
        eprintln!("seabearing: {name}: rows are not in order of time; sorted");
        samples.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    }
    Ok(samples)
}
