//! Vessels that passed a station, from AIS files: positions, split into passages, projected about the station.
//!
//! Kept are merchant vessels under way by engine (status 0; ship types 70 to 89 where the file tells them), as \[O\] did.
//! A passage is a run of a vessel's positions without a gap of 24 h, within 100 km, whose closest point is within 25 km.

use super::course::{Course, Place};
use super::scenario::{Radiation, Scenario};
use super::simulate::{Extra, Vessel};
use crate::ais::Report;
use crate::geodesy::LocalFrame;
use anyhow::{Result, bail};
use std::collections::BTreeMap;
use std::path::Path;

/// Greatest gap within a passage, s.
const GAP_S: f64 = 86_400.0;
/// Radius of the surveyed area, m.
pub const RADIUS_M: f64 = 100_000.0;
/// Greatest range of the closest point, m.
pub const CLOSEST_M: f64 = 25_000.0;
/// Faster than any merchant vessel, m/s: a position that needs more is wrong.
const FASTEST_M_S: f64 = 20.0;

/// One vessel's passage.
#[derive(Clone, Debug, PartialEq)]
pub struct Passage {
    /// The vessel.
    pub mmsi: u64,
    /// UTC (seconds since 1970) and place of each position.
    pub fixes: Vec<(f64, Place)>,
    /// UTC of the closest point, seconds since 1970.
    pub cpa_unix_s: f64,
    /// Its range, m.
    pub cpa_range_m: f64,
}

/// Reads the merchant vessels' positions of a file.
///
/// # Errors
/// The file cannot be read, is of no known layout, or holds no usable row.
pub fn read(path: &Path) -> Result<Vec<Report>> {
    let name = path.display();
    let (mut reports, bad) = crate::ais::read(path)?;
    if !bad.is_empty() {
        eprintln!("seabearing: {name}: skipped {} unreadable rows", bad.len());
    }
    reports.retain(merchant_under_way);
    if reports.is_empty() {
        bail!("{name}: no position of a merchant vessel under way");
    }
    Ok(reports)
}

/// Under way by engine, and of a merchant's type; where the type is not told, heard on land, as \[O\] took them.
fn merchant_under_way(r: &Report) -> bool {
    r.status == Some(0) && r.ship_type.map_or(r.terrestrial == Some(true), |kind| (70..90).contains(&kind))
}

/// Passages of all vessels about a station (latitude, longitude in degrees), in order of their closest point.
pub fn passages(reports: &[Report], origin_deg: (f64, f64)) -> Vec<Passage> {
    let frame = LocalFrame::new(origin_deg.0, origin_deg.1);
    let mut by_vessel: BTreeMap<u64, Vec<(f64, Place)>> = BTreeMap::new();
    for r in reports {
        let place = frame.east_north_m(r.lat_lon_deg.0, r.lat_lon_deg.1);
        by_vessel.entry(r.mmsi).or_default().push((r.t_s, place));
    }
    let mut out = Vec::new();
    for (mmsi, mut fixes) in by_vessel {
        fixes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut run: Vec<(f64, Place)> = Vec::new();
        for fix in fixes {
            let inside = fix.1.0.hypot(fix.1.1) <= RADIUS_M;
            if let Some((t, p)) = run.last() {
                let (dt, way) = (fix.0 - t, (fix.1.0 - p.0).hypot(fix.1.1 - p.1));
                if dt < GAP_S && (dt <= 0.0 || way > FASTEST_M_S * dt.max(30.0)) {
                    continue;
                }
                if dt >= GAP_S || !inside {
                    out.extend(passage(mmsi, std::mem::take(&mut run)));
                }
            }
            if inside {
                run.push(fix);
            }
        }
        out.extend(passage(mmsi, run));
    }
    out.sort_by(|a, b| a.cpa_unix_s.total_cmp(&b.cpa_unix_s));
    out
}

fn passage(mmsi: u64, fixes: Vec<(f64, Place)>) -> Option<Passage> {
    if fixes.len() < 2 {
        return None;
    }
    let mut best = (f64::INFINITY, 0.0);
    for w in fixes.windows(2) {
        let ((t0, a), (t1, b)) = (w[0], w[1]);
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let length2 = dx * dx + dy * dy;
        let u = if length2 > 0.0 { (-(a.0 * dx + a.1 * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
        let range = (a.0 + u * dx).hypot(a.1 + u * dy);
        if range < best.0 {
            best = (range, t0 + u * (t1 - t0));
        }
    }
    (best.0 <= CLOSEST_M).then_some(Passage { mmsi, fixes, cpa_unix_s: best.1, cpa_range_m: best.0 })
}

impl Passage {
    /// As a course in seconds from a start, its first and last legs carried on to the edge of the surveyed area: a
    /// terrestrial receiver's coverage ends, the vessel does not.
    pub fn course(&self, start_unix_s: f64) -> Course {
        let mut fixes: Vec<(f64, Place)> = self.fixes.iter().map(|f| (f.0 - start_unix_s, f.1)).collect();
        let carry = |from: (f64, Place), towards: (f64, Place)| {
            let dt = towards.0 - from.0;
            let v = ((towards.1.0 - from.1.0) / dt, (towards.1.1 - from.1.1) / dt);
            let speed2 = v.0 * v.0 + v.1 * v.1;
            let along = towards.1.0 * v.0 + towards.1.1 * v.1;
            let inside = RADIUS_M.powi(2) - towards.1.0.powi(2) - towards.1.1.powi(2);
            let more =
                dt.signum() * (-along * dt.signum() + (along * along + speed2 * inside).sqrt()) / speed2;
            (more.abs() < GAP_S)
                .then_some((towards.0 + more, (towards.1.0 + v.0 * more, towards.1.1 + v.1 * more)))
        };
        // Neighbouring fixes can be seconds apart: take a leg of at least half an hour for the direction.
        let n = fixes.len();
        let inner_first = fixes.iter().position(|f| f.0 > fixes[0].0 + 1800.0).unwrap_or(n - 1);
        let inner_last = fixes.iter().rposition(|f| f.0 < fixes[n - 1].0 - 1800.0).unwrap_or(0);
        let before = carry(fixes[inner_first], fixes[0]);
        let after = carry(fixes[inner_last], fixes[n - 1]);
        fixes.extend(after.filter(|f| f.0 > fixes[n - 1].0));
        let first = fixes[0].0;
        if let Some(f) = before.filter(|f| f.0 < first) {
            fixes.insert(0, f);
        }
        Course::Fixes(fixes)
    }

    /// As a vessel of the simulator, with lines of its own.
    pub fn extra(&self, start_unix_s: f64, radiation: &Radiation) -> Extra {
        // A factor between 0.93 and 1.07 from the vessel's number sets its lines apart from the others'.
        let own =
            0.93 + 0.14 * (self.mmsi.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / f64::from(1 << 24);
        let mut radiation = radiation.clone();
        radiation.blade_hz *= own;
        radiation.tones_hz.iter_mut().for_each(|f| *f *= own);
        let vessel = Vessel {
            name: self.mmsi.to_string(),
            course: self.course(start_unix_s),
            active_s: (f64::NEG_INFINITY, f64::INFINITY),
        };
        Extra { vessel, radiation }
    }
}

/// The AIS vessels a scenario asks for.
///
/// # Errors
/// A file cannot be read, or no vessel passes while the scenario runs.
pub fn extras(scenario: &Scenario) -> Result<Vec<Extra>> {
    let mut out = Vec::new();
    for entry in &scenario.ais {
        let Some([lat, lon]) = scenario.lat_lon_deg else {
            bail!("lat_lon_deg is needed to place AIS vessels")
        };
        let start = scenario.start_utc()?.unix_timestamp() as f64;
        let span = start..start + scenario.duration_s;
        let all = passages(&read(&entry.file)?, (lat, lon));
        let chosen: Vec<_> = all
            .iter()
            .filter(|p| span.contains(&p.cpa_unix_s) && entry.mmsi.is_none_or(|m| m == p.mmsi))
            .map(|p| p.extra(start, &entry.radiation))
            .collect();
        if chosen.is_empty() {
            bail!(
                "{}: no vessel passes within 25 km while the scenario runs ({} passages in the file)",
                entry.file.display(),
                all.len()
            );
        }
        out.extend(chosen);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_and_selected() {
        let at = |mmsi, hours: f64, km: f64, off_km: f64| Report {
            mmsi,
            t_s: 3600.0 * hours,
            lat_lon_deg: (off_km / 110.574, km / 111.3195),
            speed_m_s: None,
            status: Some(0),
            ship_type: Some(70),
            terrestrial: None,
        };
        let mut reports: Vec<Report> =
            (-5..6).map(|h| at(1, f64::from(h), 25.0 * f64::from(h), 10.0)).collect();
        reports.extend((-5..6).map(|h| at(2, f64::from(h), 25.0 * f64::from(h), 40.0)));
        reports.extend((-5..6).map(|h| at(1, 100.0 + f64::from(h), 25.0 * f64::from(h), 12.0)));
        let p = passages(&reports, (0.0, 0.0));
        assert_eq!(p.len(), 2);
        assert!((p[0].cpa_range_m - 10_000.0).abs() < 10.0 && p[0].cpa_unix_s.abs() < 60.0);
        let Course::Fixes(f) = p[0].course(0.0) else { panic!() };
        let edge = f[0].1.0.hypot(f[0].1.1);
        assert!((edge - RADIUS_M).abs() < 1.0, "{edge}");
        assert!(f.windows(2).all(|w| w[0].0 < w[1].0));
    }
}
