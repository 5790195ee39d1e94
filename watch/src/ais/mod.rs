//! Vessels as AIS tells them: where each was at a time, and how surely.
//!
//! In: position reports, from files ([`read`]) or live. Out: [`Fleet`]. Between two reports a vessel is taken straight on;
//! what it may have done otherwise is an integrated random walk of its velocity, whose deviation from the straight line
//! has the variance q τ²(G−τ)²/(3G) at τ of a gap G. To this come the receiver's error, the way from the antenna to what
//! sounds, and the error of the reports' times.

pub mod aivdm;

use anyhow::Result;
use seabearing_host::ais::{AisReport, IMPOSSIBLE_M_S};
use seabearing_host::geodesy::LocalFrame;
use std::collections::BTreeMap;
use std::path::Path;

use crate::report::Covariance;

/// Standard deviation of a reported position, m.
const POSITION_SD_M: f64 = 15.0;
/// Power of the acceleration by which a vessel leaves the straight line between two reports, m²/s³, before its own
/// reports tell: 5 m in the middle of a minute, 150 m in that of ten. Then at least, and at most.
const WANDER_M2_S3: f64 = 0.005;
const WANDERS_M2_S3: (f64, f64) = (0.002, 0.5);
/// What is known beforehand counts as so many reports.
const BEFOREHAND: f64 = 10.0;
/// Length of a vessel that does not tell it, m.
const USUAL_LENGTH_M: f64 = 100.0;
/// What sounds lies from the antenna by so much of the length, standard deviation.
const ANTENNA: f64 = 0.3;
/// Standard deviation of a report's time, s; and where all of a file are whole minutes.
const TIME_SD_S: f64 = 0.5;
const MINUTES_SD_S: f64 = 17.3;
/// A position may be wrong by so much without being another vessel's, m.
const SLACK_M: f64 = 300.0;
/// Velocities are taken over at least so long, where reports are: between nearer ones their errors are all there is, s.
const BASE_S: f64 = 30.0;
/// Reports that make a vessel: fewer that fit no other are wrong positions.
const LEAST_REPORTS: usize = 3;

/// A vessel's reports.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Vessel {
    /// Its number.
    pub mmsi: u64,
    /// Which of several vessels with that number, from 0.
    pub twin: u8,
    /// Its name, where known.
    pub name: Option<String>,
    /// Its length, m, where known.
    pub length_m: Option<f64>,
    /// How much it wanders, m²/s³: see the module.
    wander_m2_s3: f64,
    /// Times (seconds since 1970 UTC) and latitude and longitude (degrees), in order of time.
    fixes: Vec<(f64, (f64, f64))>,
}

/// Where a vessel is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// East and North, m.
    pub place_m: (f64, f64),
    /// East and North speed, m/s.
    pub velocity_m_s: (f64, f64),
    /// Of the place.
    pub covariance: Covariance,
    /// The part of it that is between reports: standard deviation, m.
    pub wander_m: f64,
    /// Standard deviations of the velocity along the course and across it, m/s.
    pub sd_velocity_m_s: (f64, f64),
}

impl Vessel {
    /// First and last report, seconds since 1970.
    pub fn span_s(&self) -> (f64, f64) {
        let at = |fix: Option<&(f64, _)>| fix.map_or(f64::NAN, |f| f.0);
        (at(self.fixes.first()), at(self.fixes.last()))
    }

    /// The reports on either side of a time, `least_s` apart or more where there are such; at an end of all reports those
    /// next to it.
    fn around(&self, t_s: f64, least_s: f64) -> Option<[(f64, (f64, f64)); 2]> {
        let mut b = self.fixes.partition_point(|f| f.0 <= t_s).max(1).min(self.fixes.len().max(2) - 1);
        let mut a = b - 1;
        let at = |n: usize| self.fixes.get(n).map_or(f64::NAN, |f| f.0);
        while at(b) - at(a) < least_s && (a > 0 || b + 1 < self.fixes.len()) {
            // Outwards on the side that is nearer.
            let before = if a > 0 { t_s - at(a - 1) } else { f64::INFINITY };
            let behind = if b + 1 < self.fixes.len() { at(b + 1) - t_s } else { f64::INFINITY };
            if before <= behind {
                a -= 1;
            } else {
                b += 1;
            }
        }
        Some([*self.fixes.get(a)?, *self.fixes.get(b)?])
    }

    /// Where it was, East and North of a frame's origin; `None` where reports are further apart than `gap_s`, or the time
    /// is more than half of that beyond the first or the last.
    pub fn at(&self, t_s: f64, frame: &LocalFrame, gap_s: f64, time_sd_s: f64) -> Option<Placed> {
        let [(ta, a), (tb, b)] = self.around(t_s, 0.0)?;
        let gap = tb - ta;
        let beyond = (ta - t_s).max(t_s - tb).max(0.0);
        if !(gap > 0.0 && gap <= gap_s && beyond <= 0.5 * gap_s) {
            return None;
        }
        let place = |at: (f64, f64)| frame.east_north_m(at.0, at.1);
        let (a, b, after) = (place(a), place(b), t_s - ta);
        let place_m = (a.0 + (b.0 - a.0) * after / gap, a.1 + (b.1 - a.1) * after / gap);
        let [(tc, c), (td, d)] = self.around(t_s, BASE_S.max(10.0 * time_sd_s))?;
        let (c, d, base) = (place(c), place(d), td - tc);
        let velocity_m_s = ((d.0 - c.0) / base, (d.1 - c.1) / base);
        let velocity_variance = 2.0 * (POSITION_SD_M / base).powi(2) + self.wander_m2_s3 * base / 3.0;
        let wander = if beyond > 0.0 {
            self.wander_m2_s3 * beyond.powi(3) / 3.0 + velocity_variance * beyond * beyond
        } else {
            self.wander_m2_s3 * (after * (gap - after)).powi(2) / (3.0 * gap)
        };
        let across = POSITION_SD_M.powi(2) + wander;
        let speed = velocity_m_s.0.hypot(velocity_m_s.1);
        let length = ANTENNA * self.length_m.unwrap_or(USUAL_LENGTH_M);
        let along = across + length * length + (speed * time_sd_s).powi(2);
        let direction =
            if speed > 0.0 { (velocity_m_s.0 / speed, velocity_m_s.1 / speed) } else { (0.0, 1.0) };
        let covariance = Covariance::along_across(direction, along, across);
        let late = 2.0 * (speed * time_sd_s / base).powi(2);
        let sd_velocity_m_s = ((velocity_variance + late).sqrt(), velocity_variance.sqrt());
        Some(Placed { place_m, velocity_m_s, covariance, wander_m: wander.sqrt(), sd_velocity_m_s })
    }

    /// Whether it may have been within `reach_m` of the frame's origin at a time at which no report within `gap_s` on both
    /// sides tells where it was, going no faster than `speed_m_s`. After the last report and before the first it is thought
    /// of for as long as `gap_s`, in between for `longest_s`.
    pub fn may_hide(
        &self,
        t_s: f64,
        frame: &LocalFrame,
        reach_m: f64,
        gap_s: f64,
        longest_s: f64,
        speed_m_s: f64,
    ) -> bool {
        let Some([(ta, a), (tb, b)]) = self.around(t_s, 0.0) else { return false };
        let inside = (ta..=tb).contains(&t_s);
        let can = |t: f64, at: (f64, f64)| {
            let (x, y) = frame.east_north_m(at.0, at.1);
            x.hypot(y) <= reach_m + speed_m_s * (t - t_s).abs()
        };
        match inside {
            true => tb - ta > gap_s && tb - ta <= longest_s && can(ta, a) && can(tb, b),
            false => {
                (ta - t_s).max(t_s - tb) <= gap_s
                    && can(if t_s < ta { ta } else { tb }, if t_s < ta { a } else { b })
            }
        }
    }

    /// How much it wanders: each report against the straight line between its neighbours.
    fn measure(&mut self, time_sd_s: f64) {
        let (mut squares, mut weights_in_all) = (0.0, 0.0);
        for three in self.fixes.windows(3) {
            let [(ta, a), (tm, m), (tb, b)] = *three else { continue };
            let (gap, after) = (tb - ta, tm - ta);
            let frame = LocalFrame::new(m.0, m.1);
            let (a, b) = (frame.east_north_m(a.0, a.1), frame.east_north_m(b.0, b.1));
            let share = after / gap;
            let (x, y) = (a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1));
            let speed = (b.0 - a.0).hypot(b.1 - a.1) / gap;
            let weights = 1.0 + share * share + (1.0 - share).powi(2);
            let noise = weights * (2.0 * POSITION_SD_M.powi(2) + (speed * time_sd_s).powi(2));
            let span = (after * (gap - after)).powi(2) / (3.0 * gap);
            // The sharper a gap tells, the more it counts.
            let weight = (span * WANDER_M2_S3 / (span * WANDER_M2_S3 + noise)).powi(2);
            squares += weight * (x * x + y * y - noise) / (2.0 * span);
            weights_in_all += weight;
        }
        let measured = (squares + BEFOREHAND * WANDER_M2_S3) / (weights_in_all + BEFOREHAND);
        self.wander_m2_s3 = measured.max(WANDERS_M2_S3.0).min(WANDERS_M2_S3.1);
    }

    fn push(&mut self, report: &AisReport) {
        self.fixes.push((report.t_s, report.lat_lon_deg));
        self.length_m = report.length_m.or(self.length_m);
    }
}

/// All vessels of some reports.
#[derive(Clone, Debug, Default)]
pub struct Fleet {
    /// In order of number.
    pub vessels: Vec<Vessel>,
    /// What a person should know of the reports.
    pub remarks: Vec<String>,
    /// Standard deviation of the reports' times, s.
    pub time_sd_s: f64,
    /// Times of all reports, seconds since 1970, in order.
    times_s: Vec<f64>,
}

impl Fleet {
    /// Brings reports together. Where positions under one number jump as no vessel does, there are two vessels, which are
    /// kept apart, or single wrong positions, which are left out.
    pub fn of(reports: &[AisReport], names: &BTreeMap<u64, String>) -> Self {
        let mut by_number: BTreeMap<u64, Vec<&AisReport>> = BTreeMap::new();
        for report in reports {
            by_number.entry(report.mmsi).or_default().push(report);
        }
        let whole = reports.iter().all(|r| r.t_s % 60.0 == 0.0);
        let mut times_s: Vec<f64> = reports.iter().map(|r| r.t_s).collect();
        times_s.sort_by(f64::total_cmp);
        let time_sd_s = if whole { MINUTES_SD_S } else { TIME_SD_S };
        let mut fleet = Self { vessels: Vec::new(), remarks: Vec::new(), time_sd_s, times_s };
        for (mmsi, mut reports) in by_number {
            reports.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
            let mut twins = apart(&reports, time_sd_s);
            let wrong: usize =
                twins.extract_if(.., |v| v.fixes.len() < LEAST_REPORTS).map(|v| v.fixes.len()).sum();
            if wrong > 0 && !twins.is_empty() {
                fleet
                    .remarks
                    .push(format!("{mmsi}: {wrong} position(s) left out that it cannot have been at"));
            }
            if twins.len() > 1 {
                fleet.remarks.push(format!(
                    "{mmsi}: {} vessels have this number, as their positions jump; they are kept apart",
                    twins.len()
                ));
            }
            for (n, mut vessel) in twins.into_iter().enumerate() {
                vessel.mmsi = mmsi;
                vessel.twin = n as u8;
                vessel.name = names.get(&mmsi).cloned();
                vessel.measure(time_sd_s);
                fleet.vessels.push(vessel);
            }
        }
        fleet
    }

    /// Whether any vessel reported within `gap_s` of a time.
    pub fn covers(&self, t_s: f64, gap_s: f64) -> bool {
        let from = self.times_s.partition_point(|t| *t < t_s - gap_s);
        self.times_s.get(from).is_some_and(|t| *t <= t_s + gap_s)
    }
}

/// The vessels that share a number: each report goes to the one that can have come there, the nearest first.
fn apart(reports: &[&AisReport], time_sd_s: f64) -> Vec<Vessel> {
    let mut vessels: Vec<Vessel> = Vec::new();
    for report in reports {
        let (lat, lon) = report.lat_lon_deg;
        let frame = LocalFrame::new(lat, lon);
        let mut best: Option<(f64, usize)> = None;
        let mut known = false;
        for (n, vessel) in vessels.iter().enumerate() {
            let Some((t_s, at)) = vessel.fixes.last() else { continue };
            let (x, y) = frame.east_north_m(at.0, at.1);
            let (d, dt) = (x.hypot(y), report.t_s - t_s);
            let can = d <= SLACK_M + IMPOSSIBLE_M_S * (dt + 2.0 * time_sd_s);
            // The same once more, as two receivers heard it.
            known |= can && dt <= 0.0;
            if can && best.is_none_or(|(nearest, _)| d < nearest) {
                best = Some((d, n));
            }
        }
        if known {
            continue;
        }
        let n = best.map_or(vessels.len(), |(_, n)| n);
        if n == vessels.len() && n < usize::from(u8::MAX) {
            vessels.push(Vessel::default());
        }
        if let Some(vessel) = vessels.get_mut(n) {
            vessel.push(report);
        }
    }
    vessels
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AisFile {
    /// Position reports.
    pub reports: Vec<AisReport>,
    /// Names of vessels by their numbers.
    pub names: BTreeMap<u64, String>,
    /// What could not be read, with its line.
    pub bad: Vec<String>,
}

/// Reads a file of AIVDM sentences or of one of the layouts of [`seabearing_host::ais`].
///
/// # Errors
/// The file cannot be read, or no report in it can.
pub fn read(path: &Path) -> Result<AisFile> {
    let name = path.display().to_string();
    let text = seabearing_host::ais::text(path)?;
    if text.trim_start().starts_with(['!', '\\', '$']) {
        return aivdm::file(&text, &name);
    }
    let (reports, bad) = seabearing_host::ais::parse(&text, &name)?;
    Ok(AisFile { reports, names: BTreeMap::new(), bad })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(mmsi: u64, t_s: f64, lat_lon_deg: (f64, f64)) -> AisReport {
        AisReport {
            mmsi,
            t_s,
            lat_lon_deg,
            speed_m_s: None,
            status: None,
            ship_type: None,
            terrestrial: None,
            length_m: None,
        }
    }

    /// North at 5 m/s from a place, a report every 30 s.
    fn steady(mmsi: u64, east_m: f64, minutes: u32) -> Vec<AisReport> {
        let frame = LocalFrame::new(50.0, -1.0);
        (0..=2 * minutes)
            .map(|k| 30.0 * f64::from(k) + 0.1)
            .map(|t_s| report(mmsi, t_s, frame.lat_lon_deg(east_m, 5.0 * t_s)))
            .collect()
    }

    #[test]
    fn a_vessel_is_between_its_reports_and_nowhere_in_a_gap() {
        let mut reports = steady(7, 1000.0, 10);
        reports.retain(|r| !(100.0..500.0).contains(&r.t_s));
        let fleet = Fleet::of(&reports, &BTreeMap::new());
        let frame = LocalFrame::new(50.0, -1.0);
        let vessel = &fleet.vessels[0];
        let at = |t_s: f64, gap_s: f64| vessel.at(t_s, &frame, gap_s, fleet.time_sd_s);
        let here = at(45.0, 300.0).unwrap();
        assert!((here.place_m.0 - 1000.0).abs() < 1.0 && (here.place_m.1 - 225.0).abs() < 1.0, "{here:?}");
        assert!((here.velocity_m_s.1 - 5.0).abs() < 0.1);
        assert_eq!(at(300.0, 300.0), None);
        let bridged = at(300.0, 900.0).unwrap();
        assert!(bridged.covariance.xx > 4.0 * here.covariance.xx);
        // 5 m/s, 0.5 s: along the course; the antenna: 0.3 · 100 m.
        assert!((here.covariance.yy - here.covariance.xx - 906.25).abs() < 1e-6);
        let hides = |reach_m, speed_m_s| vessel.may_hide(300.0, &frame, reach_m, 300.0, 3600.0, speed_m_s);
        assert!(hides(3000.0, 15.0) && !hides(100.0, 1.0));
        assert!(at(700.0, 300.0).is_some() && at(800.0, 300.0).is_none(), "beyond the last report");
    }

    #[test]
    fn two_vessels_of_one_number_are_kept_apart_and_a_wrong_position_is_left_out() {
        let mut reports = steady(7, 0.0, 10);
        reports.extend(steady(7, 40_000.0, 10).into_iter().map(|r| AisReport { t_s: r.t_s + 10.0, ..r }));
        reports.push(report(7, 200.0, (10.0, 100.0)));
        reports.extend(steady(8, 5000.0, 10));
        let fleet = Fleet::of(&reports, &BTreeMap::new());
        let numbers: Vec<_> = fleet.vessels.iter().map(|v| (v.mmsi, v.twin, v.fixes.len())).collect();
        assert_eq!(numbers, [(7, 0, 21), (7, 1, 21), (8, 0, 21)]);
        assert_eq!(fleet.remarks.len(), 2, "{:?}", fleet.remarks);
        assert!(fleet.remarks[0].contains("1 position(s) left out"));
        assert!(fleet.remarks[1].starts_with("7: 2 vessels have this number"));
    }

    #[test]
    fn times_to_the_minute_are_known_to_be_coarse() {
        let coarse = |r: AisReport| AisReport { t_s: (r.t_s / 60.0).floor() * 60.0, ..r };
        let reports: Vec<_> = steady(7, 0.0, 4).into_iter().map(coarse).collect();
        let fleet = Fleet::of(&reports, &BTreeMap::new());
        assert_eq!(fleet.time_sd_s, MINUTES_SD_S);
        assert!(fleet.covers(100.0, 60.0) && !fleet.covers(1000.0, 60.0));
    }
}
