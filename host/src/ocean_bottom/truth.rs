//! Where a vessel truly was: at the moment the sound of its strongest path left it, and at its closest point.

use super::passage::emission;
use super::simulate::MovingVessel;
use crate::course::{Steady, VesselCourse};
use crate::propagation::Propagation;

/// Where a vessel was when what arrives most strongly now left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Then {
    /// Range, m.
    pub range_m: f64,
    /// Azimuth, rad.
    pub azimuth: f64,
    /// Radial speed, m/s, positive when leaving.
    pub radial_m_s: f64,
}

/// The vessel's place at emission; `None` where nothing of it arrives.
pub fn then(table: &Propagation, paths: usize, vessel: &MovingVessel, t_s: f64) -> Option<Then> {
    let strongest = (0..paths)
        .filter_map(|n| {
            let (left, range, azimuth) = emission(table, &vessel.course, n, t_s)?;
            (vessel.active_s.0..=vessel.active_s.1).contains(&left).then_some(())?;
            Some((table.arrival(n, range)?.amplitude.norm(), left, range, azimuth))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let (_, left, range_m, azimuth) = strongest;
    let after = vessel.course.at(left + 1.0)?;
    Some(Then { range_m, azimuth, radial_m_s: after.0.hypot(after.1) - range_m })
}

/// Closest point of a straight course: time, range, heading, speed.
pub fn closest(course: &VesselCourse) -> Option<(f64, f64, f64, f64)> {
    let Steady { at_s, place_m, velocity_m_s: (vx, vy) } = course.straightened()?;
    Some((at_s, place_m.0.hypot(place_m.1), vx.atan2(vy), vx.hypot(vy)))
}

/// How long before and after its closest point a vessel's heading and speed there are taken over, s: longer than the jitter of
/// its fixes, shorter than its bends.
const PASSING_S: f64 = 300.0;

/// Farthest that the closest point of the way itself is looked for from that of the straight course, s.
const WITHIN_S: f64 = 3600.0;

/// Closest point of the way itself, bends and all: time, range, heading, speed.
pub fn passed(course: &VesselCourse) -> Option<(f64, f64, f64, f64)> {
    let (straight_s, ..) = closest(course)?;
    let cpa = course.cpa(straight_s - WITHIN_S, straight_s + WITHIN_S);
    let (a, b) = (course.at(cpa.time_s - PASSING_S)?, course.at(cpa.time_s + PASSING_S)?);
    let (vx, vy) = ((b.0 - a.0) / (2.0 * PASSING_S), (b.1 - a.1) / (2.0 * PASSING_S));
    Some((cpa.time_s, cpa.range_m, vx.atan2(vy), vx.hypot(vy)))
}
