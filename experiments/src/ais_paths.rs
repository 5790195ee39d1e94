//! Smooth paths of real vessels from their AIS reports: position, velocity and acceleration every second.
//!
//! Reports of one vessel that follow each other within [`GAP_S`], have moved and need no impossible speed make a path. At
//! each second a parabola is fitted to the reports within [`REACHES_S`] either side, weighted by the tricube of their
//! distance in time; its value and derivatives are the vessel's. The reports are good to some ten metres (coarse
//! positions, times of reception); turns shorter than some twenty seconds are blurred.

use super::heard_vessels::HeardVessel;
use crate::ais::{AisReport, IMPOSSIBLE_M_S, tracks};
use crate::course::Fix;
use nalgebra::{Matrix3, Vector3};

/// Longest time between reports of one path, seconds: a vessel that goes straight reports every 10 s, some are lost.
const GAP_S: f64 = 45.0;
/// Reports so far away in time take part in the parabola, seconds: the farther ones where there are too few near.
const REACHES_S: [f64; 2] = [30.0, 60.0];
const LEAST_REPORTS: usize = 6;

/// A vessel at one second.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    /// East and North, metres.
    pub position_m: [f64; 2],
    /// Velocity, m/s.
    pub velocity_m_s: [f64; 2],
    /// Acceleration, m/s².
    pub acceleration_m_s2: [f64; 2],
}

impl Instant {
    /// Speed, m/s.
    pub fn speed_m_s(&self) -> f64 {
        self.velocity_m_s[0].hypot(self.velocity_m_s[1])
    }

    /// Course, radians clockwise from North.
    pub fn course(&self) -> f64 {
        self.velocity_m_s[0].atan2(self.velocity_m_s[1])
    }

    /// Rate of turn, rad/s, clockwise positive.
    pub fn turn_rad_s(&self) -> f64 {
        let ([vx, vy], [ax, ay]) = (self.velocity_m_s, self.acceleration_m_s2);
        (ax * vy - ay * vx) / (vx * vx + vy * vy)
    }

    /// Acceleration along the course, m/s².
    pub fn along_m_s2(&self) -> f64 {
        let ([vx, vy], [ax, ay]) = (self.velocity_m_s, self.acceleration_m_s2);
        (ax * vx + ay * vy) / self.speed_m_s()
    }
}

/// A path, one instant a second.
pub type VesselPath = Vec<Instant>;

/// The paths of at least `least_s` seconds in the reports, in order of vessel and time.
pub fn paths(reports: &[AisReport], least_s: usize) -> Vec<VesselPath> {
    let Some(first) = reports.first() else { return Vec::new() };
    let mut out = Vec::new();
    for track in tracks(reports, first.lat_lon_deg).into_values() {
        let mut piece: Vec<Fix> = Vec::new();
        for (report, _) in track {
            if let Some((t_s, (x, y))) = piece.last() {
                let dt = report.0 - t_s;
                if dt > GAP_S {
                    out.extend(smooth(&std::mem::take(&mut piece)));
                } else if dt < 1.0
                    || report.1 == (*x, *y)
                    || (report.1.0 - x).hypot(report.1.1 - y) > IMPOSSIBLE_M_S * dt + 20.0
                {
                    continue;
                }
            }
            piece.push(report);
        }
        out.extend(smooth(&piece));
    }
    out.retain(|p| p.len() >= least_s);
    out
}

/// Parabolas through one vessel's consecutive reports; cut where too few are near.
fn smooth(reports: &[Fix]) -> Vec<VesselPath> {
    let (Some(first), Some(last)) = (reports.first(), reports.last()) else { return Vec::new() };
    let mut out = vec![VesselPath::new()];
    for k in 0..=(last.0 - first.0) as u32 {
        let t_s = first.0 + f64::from(k);
        match REACHES_S.iter().find_map(|reach_s| parabola(reports, t_s, *reach_s)) {
            Some(instant) => out.last_mut().map_or((), |path| path.push(instant)),
            None => out.push(VesselPath::new()),
        }
    }
    out
}

fn parabola(reports: &[Fix], t_s: f64, reach_s: f64) -> Option<Instant> {
    let from = reports.partition_point(|r| r.0 <= t_s - reach_s);
    let near = reports[from..].iter().take_while(|r| r.0 < t_s + reach_s);
    let (mut normal, mut sides, mut count) = (Matrix3::zeros(), [Vector3::zeros(); 2], 0);
    for (at, (x, y)) in near {
        let tau = (at - t_s) / reach_s;
        let weight = (1.0 - tau.abs().powi(3)).powi(3);
        let row = Vector3::new(1.0, tau, tau * tau);
        normal += weight * row * row.transpose();
        for (side, p) in sides.iter_mut().zip([x, y]) {
            *side += weight * *p * row;
        }
        count += 1;
    }
    let factor = normal.cholesky().filter(|_| count >= LEAST_REPORTS)?;
    let [x, y] = sides.map(|s| factor.solve(&s));
    Some(Instant {
        position_m: [x[0], y[0]],
        velocity_m_s: [x[1] / reach_s, y[1] / reach_s],
        acceleration_m_s2: [2.0 * x[2] / (reach_s * reach_s), 2.0 * y[2] / (reach_s * reach_s)],
    })
}

/// A stretch of a path past an array.
#[derive(Clone, Copy, Debug)]
pub struct Passing<'a> {
    /// The stretch.
    pub path: &'a [Instant],
    /// Where the array is, in the path's frame, metres.
    pub array_m: [f64; 2],
}

impl HeardVessel for Passing<'_> {
    fn position(&self, t_s: f64) -> (f64, f64) {
        let last = self.path.len() - 2;
        let k = (t_s.max(0.0) as usize).min(last);
        let (a, b, f) = (&self.path[k], &self.path[k + 1], t_s - k as f64);
        let at = |i: usize| a.position_m[i] + f * (b.position_m[i] - a.position_m[i]) - self.array_m[i];
        (at(0), at(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesy::LocalFrame;

    #[test]
    fn a_circle_of_reports_has_its_speed_and_rate_of_turn() {
        // 8 m/s, 0.5 °/s clockwise, a report every 4 s, one wrong position among them.
        let rate = 0.5f64.to_radians();
        let radius = 8.0 / rate;
        let frame = LocalFrame::new(50.0, -1.0);
        let reports: Vec<AisReport> = (0..80)
            .map(|k| {
                let t_s = 4.0 * f64::from(k);
                let (s, c) = (rate * t_s).sin_cos();
                let jump = if k == 40 { 5000.0 } else { 0.0 };
                let lat_lon_deg = frame.lat_lon_deg(radius * (1.0 - c) + jump, radius * s);
                AisReport {
                    mmsi: 1,
                    t_s,
                    lat_lon_deg,
                    speed_m_s: None,
                    status: None,
                    ship_type: None,
                    terrestrial: None,
                    length_m: None,
                }
            })
            .collect();
        let found = paths(&reports, 100);
        assert_eq!(found.len(), 1);
        for instant in &found[0][30..280] {
            assert!((instant.speed_m_s() - 8.0).abs() < 0.1, "{instant:?}");
            assert!((instant.turn_rad_s() - rate).abs() < 0.05 * rate, "{instant:?}");
            assert!(instant.along_m_s2().abs() < 0.01, "{instant:?}");
        }
    }
}
