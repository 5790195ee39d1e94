//! Vessels that passed a station, from AIS files: positions, split into passages, projected about the station.
//!
//! Kept are merchant vessels under way by engine (status 0; ship types 70 to 89 where the file tells them), as \[O\] did.
//! A passage is a run of a vessel's positions without a gap of 24 h, within 100 km, whose closest point is within 25 km.
//! A leg that crosses the circle of 100 km counts as far as it lies inside, also where both its ends lie outside.

use super::scenario::{ObsScenario, Radiation};
use super::simulate::{Extra, MovingVessel};
use super::smooth::way;
use crate::ais::{AisReport, IMPOSSIBLE_M_S, tracks};
use crate::course::{Fix, VesselCourse, nearest};
use anyhow::{Result, bail};
use std::path::Path;

/// Greatest gap within a passage, s.
const GAP_S: f64 = 86_400.0;
/// Radius of the surveyed area, m.
pub const RADIUS_M: f64 = 100_000.0;
/// Greatest range of the closest point, m.
const CLOSEST_M: f64 = 25_000.0;
/// Longest leg taken as straight, m: across the area and half its width more, a few hours at sea.
const LONGEST_LEG_M: f64 = 3.0 * RADIUS_M;
/// A position follows one of so many before it: longer runs of wrong ones are not looked over.
const LOOKED_BACK: usize = 100;
/// Positions one after the other from which on those that are not the vessel's are another one's with its number, and no wrong ones.
const TWIN: usize = 6;
/// Standard deviation of a time told in whole minutes, s.
const MINUTE_S: f64 = 17.3;

/// One vessel's passage.
#[derive(Clone, Debug, PartialEq)]
pub struct AisPassage {
    /// The vessel.
    pub mmsi: u64,
    /// UTC (seconds since 1970) and place of each position.
    pub fixes: Vec<Fix>,
    /// UTC of the closest point, seconds since 1970.
    pub cpa_unix_s: f64,
    /// Its range, m.
    pub cpa_range_m: f64,
}

/// Reads the merchant vessels' positions of a file.
///
/// # Errors
/// The file cannot be read, is of no known layout, or holds no usable row.
pub fn read(path: &Path) -> Result<Vec<AisReport>> {
    let name = path.display();
    let (mut reports, bad) = crate::ais::read(path)?;
    if !bad.is_empty() {
        log::warn!("{name}: skipped {} unreadable rows", bad.len());
    }
    reports.retain(merchant_under_way);
    if reports.is_empty() {
        bail!("{name}: no position of a merchant vessel under way");
    }
    Ok(reports)
}

/// Under way by engine, and of a merchant's type; where the type is not told, heard on land, as \[O\] took them.
fn merchant_under_way(r: &AisReport) -> bool {
    r.status == Some(0) && r.ship_type.map_or(r.terrestrial == Some(true), |kind| (70..90).contains(&kind))
}

/// Passages of all vessels about a station (latitude, longitude in degrees), in order of their closest point.
pub fn passages(reports: &[AisReport], origin_deg: (f64, f64)) -> Vec<AisPassage> {
    let mut out = Vec::new();
    for (mmsi, fixes) in tracks(reports, origin_deg) {
        for vessel in vessels_of(fixes.iter().map(|f| f.0).collect()) {
            of_vessel(mmsi, vessel, &mut out);
        }
    }
    out.sort_by(|a, b| a.cpa_unix_s.total_cmp(&b.cpa_unix_s));
    out
}

/// The passages of one vessel's positions.
fn of_vessel(mmsi: u64, fixes: Vec<Fix>, out: &mut Vec<AisPassage>) {
    let mut run: Vec<Fix> = Vec::new();
    let mut last: Option<Fix> = None;
    for fix in fixes {
        let Some(from) = last.replace(fix) else { continue };
        let (dt, way) = (fix.0 - from.0, (fix.1.0 - from.1.0).hypot(fix.1.1 - from.1.1));
        // What of the leg lies inside the area; a leg without any, or too long to be straight, ends the run.
        let within = (dt < GAP_S && way < LONGEST_LEG_M).then(|| inside(from, fix)).flatten();
        match within {
            Some((begin, end)) => {
                if run.is_empty() {
                    run.push(begin);
                }
                run.push(end);
                if end != fix {
                    out.extend(passage(mmsi, std::mem::take(&mut run)));
                }
            }
            None => out.extend(passage(mmsi, std::mem::take(&mut run))),
        }
    }
    out.extend(passage(mmsi, run));
}

/// The positions of each vessel that has a number: of the one with the most, and of others that have it too.
fn vessels_of(mut fixes: Vec<Fix>) -> Vec<Vec<Fix>> {
    let mut vessels: Vec<Vec<Fix>> = Vec::new();
    loop {
        let vessel = of_one_vessel(&fixes);
        if vessel.is_empty() || !vessels.is_empty() && vessel.len() < TWIN {
            return vessels;
        }
        // What it could have been at as well says nothing of another.
        fixes.retain(|fix| {
            let apart_s = |own: &&Fix| (own.0 - fix.0).abs();
            let nearest = vessel.iter().min_by(|a, b| apart_s(a).total_cmp(&apart_s(b)));
            !nearest.is_some_and(|own| is_within_reach(own, fix))
        });
        vessels.push(vessel);
    }
}

/// Whether a vessel can have been at both.
fn is_within_reach(a: &Fix, b: &Fix) -> bool {
    (b.1.0 - a.1.0).hypot(b.1.1 - a.1.1) <= IMPOSSIBLE_M_S * (b.0 - a.0).abs().max(30.0)
}

/// The positions that one vessel can have been at one after the other: the most of them, so that those few are dropped that are wrong. Of as many
/// the ones inside the area.
fn of_one_vessel(fixes: &[Fix]) -> Vec<Fix> {
    let follows =
        |from: &Fix, to: &Fix| to.0 - from.0 >= GAP_S || (to.0 > from.0 && is_within_reach(from, to));
    // Positions of the longest way that ends with each, those of them inside, and which stands before it.
    let mut ways: Vec<(usize, usize, Option<usize>)> = Vec::with_capacity(fixes.len());
    for (k, fix) in fixes.iter().enumerate() {
        let earlier = (k.saturating_sub(LOOKED_BACK)..k).filter(|j| follows(&fixes[*j], fix));
        // Of ways as long the one that was gone last.
        let before = earlier.max_by_key(|j| (ways[*j].0, ways[*j].1, *j));
        let (count, within) = before.map_or((0, 0), |j| (ways[j].0, ways[j].1));
        let is_inside = fix.1.0.hypot(fix.1.1) <= RADIUS_M;
        ways.push((count + 1, within + usize::from(is_inside), before));
    }
    let mut at = (0..ways.len()).rev().max_by_key(|k| (ways[*k].0, ways[*k].1));
    let mut out = Vec::new();
    while let Some(k) = at {
        out.push(fixes[k]);
        at = ways[k].2;
    }
    out.reverse();
    out
}

/// Legs left out because they are too long to be straight, of those that would lie partly inside the surveyed area.
pub fn legs_too_long(reports: &[AisReport], origin_deg: (f64, f64)) -> usize {
    let long = |pair: &&[(Fix, Option<f64>)]| {
        let (from, to) = (pair[0].0, pair[1].0);
        let (dt, way) = (to.0 - from.0, (to.1.0 - from.1.0).hypot(to.1.1 - from.1.1));
        dt < GAP_S && way >= LONGEST_LEG_M && way <= IMPOSSIBLE_M_S * dt && inside(from, to).is_some()
    };
    tracks(reports, origin_deg).values().map(|fixes| fixes.windows(2).filter(long).count()).sum()
}

/// The part of a straight leg inside the surveyed area, a point of time and place at either end.
fn inside(a: Fix, b: Fix) -> Option<(Fix, Fix)> {
    let (dx, dy) = (b.1.0 - a.1.0, b.1.1 - a.1.1);
    let (length2, along) = (dx * dx + dy * dy, a.1.0 * dx + a.1.1 * dy);
    let beyond = a.1.0.powi(2) + a.1.1.powi(2) - RADIUS_M.powi(2);
    if length2 == 0.0 {
        return (beyond <= 0.0).then_some((a, b));
    }
    // |a + u d| = R.
    let root = (along * along - length2 * beyond).sqrt();
    let at = |u: f64| (a.0 + u * (b.0 - a.0), (a.1.0 + u * dx, a.1.1 + u * dy));
    let (enter, leave) = ((-along - root) / length2, (-along + root) / length2);
    (enter < 1.0 && leave > 0.0)
        .then(|| (if enter > 0.0 { at(enter) } else { a }, if leave < 1.0 { at(leave) } else { b }))
}

fn passage(mmsi: u64, fixes: Vec<Fix>) -> Option<AisPassage> {
    let closest = |w: &[Fix]| {
        let (share, range_m) = nearest(w[0].1, w[1].1);
        (range_m, w[0].0 + share * (w[1].0 - w[0].0))
    };
    let (cpa_range_m, cpa_unix_s) = fixes.windows(2).map(closest).min_by(|a, b| a.0.total_cmp(&b.0))?;
    (cpa_range_m <= CLOSEST_M).then_some(AisPassage { mmsi, fixes, cpa_unix_s, cpa_range_m })
}

impl AisPassage {
    /// Standard deviation of the times of its fixes, s: of those told in whole minutes, where most are.
    fn sd_s(&self) -> f64 {
        let whole = self.fixes.iter().filter(|f| f.0 % 60.0 == 0.0).count();
        if 2 * whole > self.fixes.len() { MINUTE_S } else { 0.0 }
    }

    /// As a smooth course in seconds from a start, to the edge of the surveyed area.
    pub fn course(&self, start_unix_s: f64) -> VesselCourse {
        way(&self.carried_on(start_unix_s), self.sd_s())
    }

    /// Its fixes in seconds from a start, the first and last legs carried on to the edge of the surveyed area: a terrestrial
    /// receiver's coverage ends, the vessel does not.
    fn carried_on(&self, start_unix_s: f64) -> Vec<Fix> {
        let mut fixes: Vec<Fix> = self.fixes.iter().map(|f| (f.0 - start_unix_s, f.1)).collect();
        let carry = |from: Fix, towards: Fix| {
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
        fixes.extend(after.filter(|f| f.0 > fixes[n - 1].0 + 1.0));
        let first = fixes[0].0;
        if let Some(f) = before.filter(|f| f.0 < first - 1.0) {
            fixes.insert(0, f);
        }
        fixes
    }

    /// As a vessel of the simulator, with lines of its own.
    pub fn extra(&self, start_unix_s: f64, radiation: &Radiation) -> Extra {
        // A factor between 0.93 and 1.07 from the vessel's number sets its lines apart from the others'.
        let own =
            0.93 + 0.14 * (self.mmsi.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / f64::from(1 << 24);
        let mut radiation = radiation.clone();
        radiation.blade_hz *= own;
        radiation.engine_hz *= own;
        radiation.tones_hz.iter_mut().for_each(|f| *f *= own);
        let fixes = self.carried_on(start_unix_s);
        let active_s = fixes.first().zip(fixes.last()).map_or((0.0, 0.0), |(first, last)| (first.0, last.0));
        let vessel = MovingVessel { name: self.mmsi.to_string(), course: way(&fixes, self.sd_s()), active_s };
        Extra { vessel, radiation }
    }
}

/// The AIS vessels a scenario asks for.
///
/// # Errors
/// A file cannot be read, or no vessel passes while the scenario runs.
pub fn extras(scenario: &ObsScenario) -> Result<Vec<Extra>> {
    let mut out = Vec::new();
    for entry in &scenario.ais {
        let Some([lat, lon]) = scenario.lat_lon_deg else {
            bail!("lat_lon_deg is needed to place AIS vessels")
        };
        let start = scenario.start.unix_timestamp() as f64;
        let span = start..start + scenario.duration_s;
        let reports = read(&entry.file)?;
        let all = passages(&reports, (lat, lon));
        let chosen: Vec<_> = all
            .iter()
            .filter(|p| span.contains(&p.cpa_unix_s) && entry.mmsi.is_none_or(|m| m == p.mmsi))
            .map(|p| p.extra(start, &entry.radiation))
            .collect();
        if chosen.is_empty() {
            let left_out = match legs_too_long(&reports, (lat, lon)) {
                0 => String::new(),
                n => format!(
                    "; {n} legs from one position to the next are {:.0} km and longer, too long to be taken as straight, and were \
                     left out: positions that stand closer are needed",
                    1e-3 * LONGEST_LEG_M
                ),
            };
            bail!(
                "{}: no vessel passes within 25 km while the scenario runs ({} passages in the file{left_out})",
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

    fn at(mmsi: u64, hours: f64, km: f64, off_km: f64) -> AisReport {
        AisReport {
            mmsi,
            t_s: 3600.0 * hours,
            lat_lon_deg: (off_km / 110.574, km / 111.3195),
            speed_m_s: None,
            status: Some(0),
            ship_type: Some(70),
            terrestrial: None,
            length_m: None,
        }
    }

    #[test]
    fn vessels_whose_fixes_jump_the_circle_are_kept() {
        // None inside; one inside; a wrong first place far away; and one that turns back outside.
        let mut reports = vec![at(1, 0.0, -110.0, 10.0), at(1, 8.0, 110.0, 10.0)];
        reports.extend([at(2, 0.0, -120.0, 5.0), at(2, 4.0, 0.0, 5.0), at(2, 8.0, 120.0, 5.0)]);
        reports.extend([at(3, -0.1, 3000.0, 0.0), at(3, 0.0, -110.0, 15.0), at(3, 8.0, 110.0, 15.0)]);
        reports.extend([at(4, 0.0, 110.0, 10.0), at(4, 8.0, 150.0, 10.0)]);
        let found = passages(&reports, (0.0, 0.0));
        let kept: Vec<(u64, f64)> = found.iter().map(|p| (p.mmsi, (p.cpa_range_m / 1e3).round())).collect();
        assert_eq!(kept.len(), 3, "{kept:?}");
        for (mmsi, km) in [(1, 10.0), (2, 5.0), (3, 15.0)] {
            assert!(kept.contains(&(mmsi, km)), "{kept:?}");
        }
        for p in &found {
            assert!((p.cpa_unix_s - 4.0 * 3600.0).abs() < 60.0);
            let f = p.carried_on(0.0);
            assert!(f.windows(2).all(|w| w[1].0 > w[0].0 + 1.0));
            let reach = [f[0], f[f.len() - 1]].map(|f| f.1.0.hypot(f.1.1));
            assert!(reach.iter().all(|r| (r - RADIUS_M).abs() < 1.0), "{reach:?}");
        }
    }

    #[test]
    fn of_places_that_contradict_each_other_the_fewer_are_dropped() {
        let right = |mmsi: u64| {
            (0..=100).map(move |k| at(mmsi, 0.06 * f64::from(k), -80.0 + 1.6 * f64::from(k), 10.0))
        };
        // A first place inside that is wrong, and a run of wrong ones in between.
        let mut reports: Vec<AisReport> = std::iter::once(at(1, -0.02, 0.0, 10.0)).chain(right(1)).collect();
        reports.extend(right(2).take(40));
        reports.extend((0..4).map(|k| at(2, 2.4 + 0.06 * f64::from(k), -60.0, -8.0)));
        reports.extend(right(2).skip(44));
        let found = passages(&reports, (0.0, 0.0));
        assert_eq!(found.len(), 2);
        for p in &found {
            assert!(
                (p.cpa_unix_s - 3.0 * 3600.0).abs() < 60.0 && (p.cpa_range_m - 10_000.0).abs() < 20.0,
                "{p:?}"
            );
            assert!(p.fixes.len() >= 95 && p.fixes.iter().all(|f| (f.1.1 - 10_000.0).abs() < 20.0), "{p:?}");
        }
    }

    #[test]
    fn of_two_vessels_with_one_number_both_are_kept_and_repeated_positions_are_of_one() {
        // One passes; the other stands 85 km off, and reports as often and once more.
        let passing = (0..24).map(|n| at(7, n as f64 / 3.0, 8.0 * (n as f64 - 12.0), 10.0));
        let standing = (0..25).map(|n| at(7, n as f64 / 3.0 + 0.1, -60.0, -60.0));
        let reports: Vec<AisReport> = passing.clone().chain(standing).collect();
        let found = passages(&reports, (0.0, 0.0));
        assert!(matches!(&found[..], [one] if (one.cpa_range_m - 10_000.0).abs() < 100.0), "{found:?}");
        // Heard by two receivers.
        let twice: Vec<AisReport> = passing.clone().zip(passing).flat_map(|(a, b)| [a, b]).collect();
        assert_eq!(passages(&twice, (0.0, 0.0)).len(), 1);
    }

    #[test]
    fn legs_too_long_to_be_straight_are_counted() {
        let reports = [at(1, 0.0, -160.0, 10.0), at(1, 9.0, 160.0, 10.0), at(1, 10.0, 180.0, 10.0)];
        assert!(passages(&reports, (0.0, 0.0)).is_empty());
        assert_eq!(legs_too_long(&reports, (0.0, 0.0)), 1);
        // One that would not come near, and one of a length that is taken.
        assert_eq!(legs_too_long(&[at(2, 0.0, -160.0, 120.0), at(2, 9.0, 160.0, 120.0)], (0.0, 0.0)), 0);
        assert_eq!(legs_too_long(&[at(3, 0.0, -110.0, 10.0), at(3, 8.0, 110.0, 10.0)], (0.0, 0.0)), 0);
    }

    #[test]
    fn split_and_selected() {
        let mut reports: Vec<AisReport> =
            (-5..6).map(|h| at(1, f64::from(h), 25.0 * f64::from(h), 10.0)).collect();
        reports.extend((-5..6).map(|h| at(2, f64::from(h), 25.0 * f64::from(h), 40.0)));
        reports.extend((-5..6).map(|h| at(1, 100.0 + f64::from(h), 25.0 * f64::from(h), 12.0)));
        let p = passages(&reports, (0.0, 0.0));
        assert_eq!(p.len(), 2);
        assert!((p[0].cpa_range_m - 10_000.0).abs() < 10.0 && p[0].cpa_unix_s.abs() < 60.0);
        let f = p[0].carried_on(0.0);
        let edge = f[0].1.0.hypot(f[0].1.1);
        assert!((edge - RADIUS_M).abs() < 1.0, "{edge}");
        assert!(f.windows(2).all(|w| w[0].0 < w[1].0));
    }
}
