//! Where a vessel is at a time: a straight course, or fixes joined by straight legs.

use crate::csv::CsvTable;
use crate::scenario::{Side, Straight};
use anyhow::{Context, Result};
use seabearing_core::angle::wrap_tau;
use seabearing_core::kit::closest;
use seabearing_core::kit::straight_line::through;
use std::collections::BTreeMap;
use std::path::Path;

/// East and North of the station, metres.
pub type EastNorth = (f64, f64);

/// How a vessel moves.
#[derive(Clone, Debug, PartialEq)]
pub enum VesselCourse {
    /// Straight and steady.
    Straight {
        /// Time of the closest point, s.
        cpa_time_s: f64,
        /// Place at that time, m.
        closest_m: EastNorth,
        /// East and North speed, m/s.
        velocity_m_s: (f64, f64),
    },
    /// Time and place of fixes, in order of time; at rest nowhere outside them (the vessel is not there).
    Fixes(Vec<(f64, EastNorth)>),
}

impl VesselCourse {
    /// The straight course of a scenario.
    pub fn straight(s: &Straight) -> Self {
        let starboard = s.side == Side::Starboard;
        Self::by_cpa(s.cpa_time_s, s.cpa_range_m, s.heading_deg.to_radians(), s.speed_m_s, starboard)
    }

    /// A straight course by its closest point; `starboard` if the station lies on the vessel's starboard side.
    pub fn by_cpa(
        cpa_time_s: f64,
        cpa_range_m: f64,
        heading_rad: f64,
        speed_m_s: f64,
        starboard: bool,
    ) -> Self {
        let (s, c) = heading_rad.sin_cos();
        // To starboard of heading (s, c) lies (c, −s): a station there sees the vessel on the other side.
        let side = if starboard { -cpa_range_m } else { cpa_range_m };
        Self::Straight {
            cpa_time_s,
            closest_m: (side * c, -side * s),
            velocity_m_s: (speed_m_s * s, speed_m_s * c),
        }
    }

    /// The vessel's place; `None` where fixes do not tell.
    pub fn at(&self, t_s: f64) -> Option<EastNorth> {
        match self {
            Self::Straight { cpa_time_s, closest_m, velocity_m_s } => {
                let dt = t_s - cpa_time_s;
                Some((closest_m.0 + velocity_m_s.0 * dt, closest_m.1 + velocity_m_s.1 * dt))
            }
            Self::Fixes(fixes) => {
                let after = fixes.partition_point(|f| f.0 <= t_s);
                if after == 0 || after == fixes.len() {
                    return fixes.last().filter(|f| f.0 == t_s).map(|f| f.1);
                }
                let ((t0, a), (t1, b)) = (fixes[after - 1], fixes[after]);
                let w = (t_s - t0) / (t1 - t0);
                Some((a.0 + (b.0 - a.0) * w, a.1 + (b.1 - a.1) * w))
            }
        }
    }

    /// The straight course that fits best in the least-squares sense: itself, or a line through the places of every minute
    /// within `HEARD_M`, since fixes come at odd times and a real vessel bends its way farther out. Through all fixes
    /// where it is hardly ever that near.
    pub fn straightened(&self) -> Option<Self> {
        let Self::Fixes(fixes) = self else { return Some(self.clone()) };
        let (first, last) = (fixes.first()?.0, fixes.last()?.0);
        let minutes = (0..=((last - first) / 60.0) as usize).map(|m| first + 60.0 * m as f64);
        let near: Vec<(f64, EastNorth)> =
            minutes.filter_map(|t| Some((t, self.at(t)?))).filter(|f| polar(f.1).0 <= HEARD_M).collect();
        line(if near.len() >= 30 { &near } else { fixes })
    }

    /// Greatest distance between the course within `HEARD_M` and its straightened form, m.
    pub fn bend_m(&self) -> Option<f64> {
        let (Self::Fixes(fixes), straight) = (self, self.straightened()?) else { return Some(0.0) };
        let apart = |(t, p): &(f64, EastNorth)| {
            let q = straight.at(*t)?;
            (polar(*p).0 <= HEARD_M).then(|| (p.0 - q.0).hypot(p.1 - q.1))
        };
        Some(fixes.iter().filter_map(apart).fold(0.0, f64::max))
    }
}

/// Range within which a vessel is heard well, m.
const HEARD_M: f64 = 50_000.0;

/// The straight course through places in the least-squares sense.
fn line(fixes: &[(f64, EastNorth)]) -> Option<VesselCourse> {
    // About the mean time, where rounding matters least.
    let mean_s = fixes.iter().map(|f| f.0).sum::<f64>() / fixes.len() as f64;
    let x = through(fixes.iter().map(|(t, at)| (t - mean_s, at.0)))?;
    let y = through(fixes.iter().map(|(t, at)| (t - mean_s, at.1)))?;
    let after_s = closest([x.value, y.value, x.slope, y.slope])?.after_s;
    Some(VesselCourse::Straight {
        cpa_time_s: mean_s + after_s,
        closest_m: (x.at(after_s), y.at(after_s)),
        velocity_m_s: (x.slope, y.slope),
    })
}

/// Courses of a track file: one a `source`, or one in all. Rows of other kinds of source (no x, y) are passed over.
///
/// # Errors
/// The file cannot be read, or no vessel has two rows.
pub fn of_file(path: &Path) -> Result<Vec<VesselCourse>> {
    let table = CsvTable::read(path)?;
    let source = table.has("source").then(|| table.column("source")).transpose()?;
    let mut by_vessel: BTreeMap<String, Vec<(f64, EastNorth)>> = BTreeMap::new();
    for (row, (_, numbers)) in table.numbers(["t_s", "x_m", "y_m"])?.into_iter().enumerate() {
        let name = source.and_then(|c| table.text(row, c)).unwrap_or("").to_owned();
        if let Ok([t, x, y]) = numbers {
            by_vessel.entry(name).or_default().push((t, (x, y)));
        }
    }
    let courses: Vec<VesselCourse> = by_vessel
        .into_values()
        .filter(|f| f.len() >= 2)
        .map(|mut fixes| {
            fixes.sort_by(|a, b| a.0.total_cmp(&b.0));
            fixes.dedup_by_key(|f| f.0);
            VesselCourse::Fixes(fixes)
        })
        .collect();
    (!courses.is_empty())
        .then_some(courses)
        .with_context(|| format!("{}: no vessel with two or more rows of t_s, x_m, y_m", path.display()))
}

/// Range (m) and azimuth (rad, clockwise from North, 0 to 2π) of a place.
pub fn polar(place: EastNorth) -> (f64, f64) {
    (place.0.hypot(place.1), wrap_tau(place.0.atan2(place.1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closest_point_side_and_heading() {
        // Heading East with the station to starboard (south of the vessel): the vessel passes to the north.
        let c = VesselCourse::by_cpa(100.0, 5000.0, std::f64::consts::FRAC_PI_2, 7.0, true);
        let (x, y) = c.at(100.0).unwrap();
        assert!(x.abs() < 1e-9 && (y - 5000.0).abs() < 1e-9);
        let (x, y) = c.at(110.0).unwrap();
        assert!((x - 70.0).abs() < 1e-9 && (y - 5000.0).abs() < 1e-9);
    }

    #[test]
    fn fixes_join_and_straighten() {
        let truth = VesselCourse::by_cpa(500.0, 8000.0, 1.0, 6.0, false);
        let fixes = (0..20).map(|i| 100.0 * f64::from(i)).map(|t| (t, truth.at(t).unwrap())).collect();
        let c = VesselCourse::Fixes(fixes);
        let (a, b) = (c.at(650.0).unwrap(), truth.at(650.0).unwrap());
        assert!((a.0 - b.0).hypot(a.1 - b.1) < 1e-6);
        assert_eq!(c.at(-1.0), None);
        let Some(VesselCourse::Straight { cpa_time_s, closest_m, .. }) = c.straightened() else { panic!() };
        assert!((cpa_time_s - 500.0).abs() < 1e-6 && (closest_m.0.hypot(closest_m.1) - 8000.0).abs() < 1e-6);
        assert!(c.bend_m().unwrap() < 1e-6);
    }

    #[test]
    fn a_bend_far_out_does_not_turn_the_straightened_course() {
        let truth = VesselCourse::by_cpa(9000.0, 8000.0, 1.0, 6.0, false);
        let mut fixes: Vec<_> =
            (0..180).map(|i| 100.0 * f64::from(i)).map(|t| (t, truth.at(t).unwrap())).collect();
        let last = fixes[179].1;
        fixes.push((30_000.0, (last.0, last.1 + 80_000.0)));
        let Some(VesselCourse::Straight { velocity_m_s: v, .. }) =
            VesselCourse::Fixes(fixes.clone()).straightened()
        else {
            panic!()
        };
        assert!((v.0.atan2(v.1) - 1.0).abs() < 1e-3, "{v:?}");
        fixes[90].1.0 += 3000.0;
        assert!((VesselCourse::Fixes(fixes).bend_m().unwrap() - 3000.0).abs() < 200.0);
    }
}
