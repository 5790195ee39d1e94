//! Vessels that passed a station, from AIS files: positions, split into passages, projected about the station.
//!
//! Two formats are read, told apart by their header (also packed with xz): terrestrial (`MMSI,STATUS,…`, comma) and
//! satellite (`mmsi;source;locDate;…`, semicolon). Kept are merchant vessels under way by engine (status 0; satellite:
//! ship types 70 to 89), as \[O\] did. A passage is a run of a vessel's positions without a gap of 24 h, within 100 km,
//! whose closest point is within 25 km. The projection is azimuthal equidistant about the station.

use super::course::{Course, Place};
use super::scenario::{Radiation, Scenario};
use super::simulate::{Extra, Vessel};
use anyhow::{Result, bail};
use std::collections::BTreeMap;
use std::path::Path;
use time::{Date, Month, PrimitiveDateTime, Time};

/// Greatest gap within a passage, s.
const GAP_S: f64 = 86_400.0;
/// Radius of the surveyed area, m.
pub const RADIUS_M: f64 = 100_000.0;
/// Greatest range of the closest point, m.
pub const CLOSEST_M: f64 = 25_000.0;
/// Faster than any merchant vessel, m/s: a position that needs more is wrong.
const FASTEST_M_S: f64 = 20.0;

/// One position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// The vessel.
    pub mmsi: u64,
    /// UTC, seconds since 1970.
    pub unix_s: f64,
    /// Latitude, degrees.
    pub lat_deg: f64,
    /// Longitude, degrees.
    pub lon_deg: f64,
}

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
/// The file cannot be read, is of neither format, or holds no usable row.
pub fn read(path: &Path) -> Result<Vec<Report>> {
    let name = path.display();
    let text = crate::ais::text(path)?;
    let mut lines = text.lines();
    let header = lines.next().unwrap_or_default();
    let parse: fn(&[&str]) -> Option<Option<Report>> = match header {
        h if h.starts_with("MMSI,STATUS,") => terrestrial,
        h if h.starts_with("mmsi;source;locDate;locTime;") => satellite,
        _ => bail!(
            "{name}: not an AIS file this program knows (header `{}`)",
            header.chars().take(60).collect::<String>()
        ),
    };
    let separator = if header.contains(';') { ';' } else { ',' };
    let (mut reports, mut bad) = (Vec::new(), 0);
    for line in lines {
        match parse(&line.split(separator).collect::<Vec<_>>()) {
            Some(report) => reports.extend(report),
            None => bad += 1,
        }
    }
    if bad > 0 {
        eprintln!("seabearing: {name}: skipped {bad} unreadable rows");
    }
    if reports.is_empty() {
        bail!("{name}: no position of a merchant vessel under way");
    }
    Ok(reports)
}

/// `None`: unreadable; `Some(None)`: readable and not wanted.
fn terrestrial(c: &[&str]) -> Option<Option<Report>> {
    let (date, clock) = c.get(7)?.split_once(' ')?;
    let mut ymd = date.split('-');
    let unix_s = unix([ymd.next()?, ymd.next()?, ymd.next()?], clock)?;
    let wanted = c.get(8)?.trim() == "TER" && c.get(1)?.trim() == "0";
    report(c.first()?, unix_s, c.get(5)?, c.get(6)?, wanted)
}

fn satellite(c: &[&str]) -> Option<Option<Report>> {
    let mut dmy = c.get(2)?.split('/');
    let (d, m, y) = (dmy.next()?, dmy.next()?, dmy.next()?);
    let unix_s = unix([y, m, d], c.get(3)?)?;
    let kind = c.get(16)?.parse::<u32>().unwrap_or(0);
    let wanted = (70..90).contains(&kind) && c.get(10)?.trim() == "0";
    report(c.first()?, unix_s, c.get(5)?, c.get(4)?, wanted)
}

fn report(mmsi: &str, unix_s: f64, lat: &str, lon: &str, wanted: bool) -> Option<Option<Report>> {
    let (lat_deg, lon_deg) = (lat.trim().parse::<f64>().ok()?, lon.trim().parse::<f64>().ok()?);
    let r = Report { mmsi: mmsi.trim().parse().ok()?, unix_s, lat_deg, lon_deg };
    ((-90.0..=90.0).contains(&lat_deg) && (-360.0..=360.0).contains(&lon_deg)).then_some(wanted.then_some(r))
}

fn unix(ymd: [&str; 3], clock: &str) -> Option<f64> {
    let month = Month::try_from(ymd[1].parse::<u8>().ok()?).ok()?;
    let date = Date::from_calendar_date(ymd[0].parse().ok()?, month, ymd[2].parse().ok()?).ok()?;
    let mut hms = clock.trim().split(':').map(|x| x.parse::<u8>().ok());
    let time = Time::from_hms(hms.next()??, hms.next()??, hms.next().flatten().unwrap_or(0)).ok()?;
    Some(PrimitiveDateTime::new(date, time).assume_utc().unix_timestamp() as f64)
}

/// East and North of a place about an origin (degrees), azimuthal equidistant: the chord on the WGS 84 ellipsoid gives
/// the direction, and with the local radius of curvature the arc (within a metre in 100 km).
pub fn project(origin_deg: (f64, f64), lat_deg: f64, lon_deg: f64) -> Place {
    let (a, e2) = (6_378_137.0, 0.006_694_379_990_14);
    let ecef = |lat: f64, lon: f64| {
        let (s, c) = lat.to_radians().sin_cos();
        let n = a / (1.0 - e2 * s * s).sqrt();
        let (sl, cl) = lon.to_radians().sin_cos();
        [n * c * cl, n * c * sl, n * (1.0 - e2) * s]
    };
    let (o, p) = (ecef(origin_deg.0, origin_deg.1), ecef(lat_deg, lon_deg));
    let d = [p[0] - o[0], p[1] - o[1], p[2] - o[2]];
    let (s, c) = origin_deg.0.to_radians().sin_cos();
    let (sl, cl) = origin_deg.1.to_radians().sin_cos();
    let east = -sl * d[0] + cl * d[1];
    let north = -s * cl * d[0] - s * sl * d[1] + c * d[2];
    let chord = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    let flat = east.hypot(north);
    if flat == 0.0 {
        return (0.0, 0.0);
    }
    let w = (1.0 - e2 * s * s).sqrt();
    let (meridian, vertical) = (a * (1.0 - e2) / w.powi(3), a / w);
    let (cos2, sin2) = ((north / flat).powi(2), (east / flat).powi(2));
    let radius = 1.0 / (cos2 / meridian + sin2 / vertical);
    let arc = 2.0 * radius * (chord / (2.0 * radius)).min(1.0).asin();
    (east / flat * arc, north / flat * arc)
}

/// Passages of all vessels about a station (latitude, longitude in degrees), in order of their closest point.
pub fn passages(reports: &[Report], origin_deg: (f64, f64)) -> Vec<Passage> {
    let mut by_vessel: BTreeMap<u64, Vec<(f64, Place)>> = BTreeMap::new();
    for r in reports {
        by_vessel.entry(r.mmsi).or_default().push((r.unix_s, project(origin_deg, r.lat_deg, r.lon_deg)));
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
    fn projection_against_known_arcs() {
        // One degree of longitude on the equator is 111 319.49 m, one of latitude at 45° about 111 131.8 m.
        let (x, y) = project((0.0, 10.0), 0.0, 10.5);
        assert!((x - 55_659.75).abs() < 0.5 && y.abs() < 1e-6, "{x} {y}");
        let (x, y) = project((45.0, 0.0), 45.5, 0.0);
        assert!(x.abs() < 1e-6 && (y - 55_570.8).abs() < 3.0, "{x} {y}");
    }

    #[test]
    fn split_and_selected() {
        let at = |mmsi, hours: f64, km: f64, off_km: f64| Report {
            mmsi,
            unix_s: 3600.0 * hours,
            lat_deg: off_km / 110.574,
            lon_deg: km / 111.3195,
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
