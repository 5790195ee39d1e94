//! `truth.csv`: where every vessel really was.

use super::array::{ambient_power, motions, signal_power};
use super::scenario::ArrayScenario;
use crate::angle::{azimuth_deg, turn_deg, wrap_deg};
use crate::csv::{CsvTable, CsvText, Fixed};
use anyhow::Result;
use seabearing_locate::between::between;
use std::path::Path;

/// Header of the file; `docs/simulate.md` describes every column.
pub const HEADER: &str = "t_s,vessel,x_m,y_m,range_m,azimuth_deg,elevation_deg,emission_t_s,emission_x_m,emission_y_m,\
arrival_azimuth_deg,arrival_elevation_deg,speed_m_s,heading_deg,cpa_time_s,cpa_range_m,snr_db";

/// The whole file.
///
/// # Errors
/// A vessel's track file cannot be used.
pub fn csv(scenario: &ArrayScenario) -> Result<String> {
    let motions = motions(scenario)?;
    let config = &scenario.station.config;
    let noise = ambient_power(scenario, &motions);
    let rate = 1.0 + scenario.recorder.clock_drift_ppm * 1e-6;
    let mut out = CsvText::new(HEADER);
    let closest: Vec<_> = motions.iter().map(|m| m.cpa(0.0, scenario.duration_s)).collect();
    let steps = (scenario.duration_s / scenario.truth_step_s + 1e-9).floor() as u64;
    for step in 0..=steps {
        let t = step as f64 * scenario.truth_step_s;
        let true_t = t / rate;
        for (v, ((motion, cpa), vessel)) in motions.iter().zip(&closest).zip(&scenario.vessels).enumerate() {
            let z = config.depth_m - vessel.depth_m;
            let (x, y) = motion.position(true_t);
            let (emitted, _) = motion.emission(true_t, [0.0; 3], z, config.sound_speed_m_s, true_t);
            let (ex, ey) = motion.position(emitted);
            let (vx, vy) = motion.velocity(true_t);
            let elevation = |x: f64, y: f64| z.atan2(x.hypot(y)).to_degrees();
            let snr = 10.0 * (signal_power(scenario, v, ex.hypot(ey)) / noise).log10();
            out.row(&[
                &Fixed(t, 3),
                &vessel.name,
                &Fixed(x, 3),
                &Fixed(y, 3),
                &Fixed(x.hypot(y), 3),
                &Fixed(azimuth_deg(x, y), 5),
                &Fixed(elevation(x, y), 5),
                &Fixed(emitted * rate, 6),
                &Fixed(ex, 3),
                &Fixed(ey, 3),
                &Fixed(azimuth_deg(ex, ey), 5),
                &Fixed(elevation(ex, ey), 5),
                &Fixed(vx.hypot(vy), 4),
                &Fixed(azimuth_deg(vx, vy), 4),
                &Fixed(cpa.time_s * rate, 4),
                &Fixed(cpa.range_m, 3),
                &Fixed(snr, 2),
            ]);
        }
    }
    Ok(out.finish())
}

/// Where a vessel really was: one row of `truth.csv`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Seconds of the recorder's clock.
    pub t_s: f64,
    /// East of the station, m.
    pub x_m: f64,
    /// North of the station, m.
    pub y_m: f64,
    /// Azimuth the sound arrives from, degrees.
    pub arrival_azimuth_deg: f64,
    /// Elevation it arrives from, degrees; NaN where the file does not tell.
    pub arrival_elevation_deg: f64,
    /// Heading, degrees.
    pub heading_deg: f64,
    /// Time of the closest point, seconds of the recorder's clock.
    pub cpa_time_s: f64,
    /// Horizontal range there, m.
    pub cpa_range_m: f64,
}

impl Truth {
    /// Reads `truth.csv`, vessel by vessel, in the order of their first rows.
    ///
    /// # Errors
    /// The file cannot be read or a column is missing.
    pub fn read(path: &Path) -> Result<Vec<(String, Vec<Self>)>> {
        Self::of(&CsvTable::read(path)?)
    }

    /// The same of a table.
    ///
    /// # Errors
    /// A column is missing.
    pub fn of(table: &CsvTable) -> Result<Vec<(String, Vec<Self>)>> {
        let vessel = table.column("vessel")?;
        let columns =
            ["t_s", "x_m", "y_m", "arrival_azimuth_deg", "heading_deg", "cpa_time_s", "cpa_range_m"];
        let rows = table.numbers(columns)?;
        // Not every file has them.
        let elevations: Vec<f64> = if table.has("arrival_elevation_deg") {
            let told = table.numbers(["arrival_elevation_deg"])?.into_iter();
            told.map(|(_, row)| row.map_or(f64::NAN, |[deg]| deg)).collect()
        } else {
            Vec::new()
        };
        let mut out: Vec<(String, Vec<Self>)> = Vec::new();
        for (i, (_, row)) in rows.into_iter().enumerate() {
            let [t_s, x_m, y_m, arrival_azimuth_deg, heading_deg, cpa_time_s, cpa_range_m] = row?;
            let name = table.text(i, vessel).unwrap_or("");
            let arrival_elevation_deg = elevations.get(i).copied().unwrap_or(f64::NAN);
            let truth = Self {
                t_s,
                x_m,
                y_m,
                arrival_azimuth_deg,
                arrival_elevation_deg,
                heading_deg,
                cpa_time_s,
                cpa_range_m,
            };
            match out.iter_mut().find(|(n, _)| n == name) {
                Some((_, rows)) => rows.push(truth),
                None => out.push((name.to_owned(), vec![truth])),
            }
        }
        Ok(out)
    }

    /// Azimuth of arrival at a time, degrees, between two rows in order of time; `None` outside them.
    pub fn azimuth_at(rows: &[Self], t_s: f64) -> Option<f64> {
        let (a, b, share) = between(rows, |row| row.t_s, t_s)?;
        let turn = turn_deg(a.arrival_azimuth_deg, b.arrival_azimuth_deg);
        Some(wrap_deg(a.arrival_azimuth_deg + share * turn))
    }
}
