//! Where a vessel is, and when it made the sound that arrives now.
//!
//! Positions are metres East and North of the station. A sound received at `t` by a hydrophone at `h` was emitted at
//! `t_e` with `t_e + ‖r(t_e) − h‖/c = t`; the fixed-point iteration for it contracts by `v/c` (0.005 at 7 m/s) a step.

use super::scenario::{ArrayVessel, Side, Straight};
use crate::csv::{CsvTable, good_rows};
use crate::geodesy::LocalFrame;
use anyhow::{Result, bail};
use seabearing_core::kit::golden;
use std::path::Path;

/// A vessel's course.
#[derive(Clone, Debug)]
pub enum VesselMotion {
    /// Position at a time, and velocity.
    Straight {
        /// Time of the closest point, s.
        at_s: f64,
        /// Position then, m.
        position: [f64; 2],
        /// Velocity, m/s.
        velocity: [f64; 2],
    },
    /// Positions at times, joined by cubics with continuous velocity; straight on outside.
    Track(Vec<Knot>),
}

/// One point of a track.
#[derive(Clone, Copy, Debug)]
pub struct Knot {
    t_s: f64,
    position: [f64; 2],
    velocity: [f64; 2],
}

/// Closest point of approach, horizontally.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cpa {
    /// Its time, s.
    pub time_s: f64,
    /// Its range, m.
    pub range_m: f64,
}

impl VesselMotion {
    /// The course of a vessel of a scenario; `lat_lon_deg` is the station's position, for tracks in degrees.
    ///
    /// # Errors
    /// The track file cannot be used.
    pub fn of(vessel: &ArrayVessel, lat_lon_deg: Option<(f64, f64)>) -> Result<Self> {
        match (&vessel.straight, &vessel.track) {
            (Some(s), _) => Ok(Self::straight(s)),
            (None, Some(path)) => Self::track(path, lat_lon_deg),
            (None, None) => bail!("vessel `{}` has no course", vessel.name),
        }
    }

    /// A straight course. With the array to starboard the vessel is, at its closest, 90° to the left of its heading.
    fn straight(s: &Straight) -> Self {
        let (east, north) = s.heading_deg.to_radians().sin_cos();
        let side = if s.side == Side::Starboard { 1.0 } else { -1.0 };
        Self::Straight {
            at_s: s.cpa_time_s,
            position: [-side * s.cpa_range_m * north, side * s.cpa_range_m * east],
            velocity: [s.speed_m_s * east, s.speed_m_s * north],
        }
    }

    /// A course from a file; bad rows are named and left out.
    fn track(path: &Path, lat_lon_deg: Option<(f64, f64)>) -> Result<Self> {
        let name = path.display().to_string();
        let table = CsvTable::read(path)?;
        let rows = if table.has("x_m") {
            good_rows(&name, table.numbers(["t_s", "x_m", "y_m"])?)?
        } else {
            let Some((lat0, lon0)) = lat_lon_deg else {
                bail!("{name}: a track in lat, lon needs `lat_deg` and `lon_deg` in the station file");
            };
            let rows = good_rows(&name, table.numbers(["t_s", "lat", "lon"])?)?;
            let frame = LocalFrame::new(lat0, lon0);
            rows.into_iter()
                .map(|[t, lat, lon]| {
                    let (x, y) = frame.east_north_m(lat, lon);
                    [t, x, y]
                })
                .collect()
        };
        Self::through(&rows).map_err(|e| anyhow::anyhow!("{name}: {e}"))
    }

    /// A course through points (t, x, y) in order of time.
    ///
    /// # Errors
    /// Fewer than two points, or times that do not rise.
    pub fn through(rows: &[[f64; 3]]) -> Result<Self> {
        if rows.len() < 2 {
            bail!("a track needs at least two points");
        }
        if let Some(w) = rows.windows(2).find(|w| w[1][0] <= w[0][0]) {
            bail!("times must rise: {} s is followed by {} s", w[0][0], w[1][0]);
        }
        let last = rows.len() - 1;
        let knots = (0..rows.len()).map(|i| {
            let (a, b) = (rows[i.saturating_sub(1)], rows[(i + 1).min(last)]);
            let dt = b[0] - a[0];
            let [t_s, x, y] = rows[i];
            Knot { t_s, position: [x, y], velocity: [(b[1] - a[1]) / dt, (b[2] - a[2]) / dt] }
        });
        Ok(Self::Track(knots.collect()))
    }

    /// Position (East, North) at a time.
    pub fn position(&self, t_s: f64) -> [f64; 2] {
        self.state(t_s).0
    }

    /// Velocity (East, North) at a time.
    pub fn velocity(&self, t_s: f64) -> [f64; 2] {
        self.state(t_s).1
    }

    fn state(&self, t_s: f64) -> ([f64; 2], [f64; 2]) {
        let line =
            |at: f64, p: [f64; 2], v: [f64; 2]| ([p[0] + v[0] * (t_s - at), p[1] + v[1] * (t_s - at)], v);
        match self {
            Self::Straight { at_s, position, velocity } => line(*at_s, *position, *velocity),
            Self::Track(knots) => {
                let after = knots.partition_point(|k| k.t_s <= t_s);
                let (Some(a), Some(b)) = (after.checked_sub(1).and_then(|i| knots.get(i)), knots.get(after))
                else {
                    let k = knots[after.saturating_sub(1)];
                    return line(k.t_s, k.position, k.velocity);
                };
                // Cubic Hermite between the two knots.
                let h = b.t_s - a.t_s;
                let u = (t_s - a.t_s) / h;
                let (u2, u3) = (u * u, u * u * u);
                let mut out = ([0.0; 2], [0.0; 2]);
                for k in 0..2 {
                    let (p, q, v, w) = (a.position[k], b.position[k], h * a.velocity[k], h * b.velocity[k]);
                    out.0[k] = p * (2.0 * u3 - 3.0 * u2 + 1.0)
                        + v * (u3 - 2.0 * u2 + u)
                        + q * (3.0 * u2 - 2.0 * u3)
                        + w * (u3 - u2);
                    out.1[k] = (p * (6.0 * u2 - 6.0 * u)
                        + v * (3.0 * u2 - 4.0 * u + 1.0)
                        + q * (6.0 * u - 6.0 * u2)
                        + w * (3.0 * u2 - 2.0 * u))
                        / h;
                }
                out
            }
        }
    }

    /// When the sound that reaches `receiver` (East, North, Up) at `t_s` left a source at height `z_m`, and how far it
    /// travelled: (emission time, distance).
    pub fn emission(
        &self,
        t_s: f64,
        receiver: [f64; 3],
        z_m: f64,
        sound_speed_m_s: f64,
        guess_s: f64,
    ) -> (f64, f64) {
        let mut t_e = guess_s;
        let mut distance = 0.0;
        for _ in 0..50 {
            let [x, y] = self.position(t_e);
            let d = [x - receiver[0], y - receiver[1], z_m - receiver[2]];
            distance = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            let next = t_s - distance / sound_speed_m_s;
            let step = next - t_e;
            t_e = next;
            // A tenth of a picosecond: far below what 24 bits resolve at any sample rate.
            if step.abs() < 1e-13 {
                break;
            }
        }
        (t_e, distance)
    }

    /// The closest point within a span of time.
    pub fn cpa(&self, from_s: f64, to_s: f64) -> Cpa {
        let range = |t: f64| {
            let [x, y] = self.position(t);
            x.hypot(y)
        };
        if let Self::Straight { at_s, .. } = self {
            return Cpa { time_s: *at_s, range_m: range(*at_s) };
        }
        const STEPS: usize = 2000;
        let at = |i: usize| from_s + (to_s - from_s) * i as f64 / STEPS as f64;
        let best = (0..=STEPS).min_by(|a, b| range(at(*a)).total_cmp(&range(at(*b)))).unwrap_or(0);
        let time_s = golden(at(best.saturating_sub(1)), at((best + 1).min(STEPS)), 50, range);
        Cpa { time_s, range_m: range(time_s) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PASS: Straight = Straight {
        cpa_time_s: 100.0,
        cpa_range_m: 500.0,
        heading_deg: 90.0,
        speed_m_s: 7.0,
        side: Side::Starboard,
    };

    #[test]
    fn a_straight_pass_has_its_closest_point_where_it_says() {
        let m = VesselMotion::straight(&PASS);
        let [x, y] = m.position(100.0);
        // Heading East with the array on the right: the vessel is North of the array.
        assert!(x.abs() < 1e-9 && (y - 500.0).abs() < 1e-9);
        assert_eq!(m.cpa(0.0, 1.0), Cpa { time_s: 100.0, range_m: 500.0 });
        let port = VesselMotion::straight(&Straight { side: Side::Port, ..PASS });
        assert!((port.position(100.0)[1] + 500.0).abs() < 1e-9);
    }

    #[test]
    fn the_emission_solves_its_equation() {
        let m = VesselMotion::straight(&PASS);
        let h = [0.5, -0.3, 0.9];
        for t in [0.0, 77.7, 100.0, 200.0] {
            let (te, d) = m.emission(t, h, 164.0, 1484.0, t);
            let [x, y] = m.position(te);
            let want = ((x - h[0]).powi(2) + (y - h[1]).powi(2) + (164.0 - h[2]).powi(2)).sqrt();
            assert!((te + want / 1484.0 - t).abs() < 1e-12 && (d - want).abs() < 1e-8);
        }
    }

    #[test]
    fn a_track_through_points_of_a_line_is_that_line() {
        let s = VesselMotion::straight(&PASS);
        let rows: Vec<[f64; 3]> = (0..=20)
            .map(|i| f64::from(i) * 10.0)
            .map(|t| {
                let [x, y] = s.position(t);
                [t, x, y]
            })
            .collect();
        let m = VesselMotion::through(&rows).unwrap();
        for t in [-5.0, 0.0, 33.3, 100.0, 199.9, 230.0] {
            let (a, b) = (m.position(t), s.position(t));
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-6, "{t}");
            let v = m.velocity(t);
            assert!((v[0] - 7.0).abs() < 1e-9 && v[1].abs() < 1e-9);
        }
        let cpa = m.cpa(0.0, 200.0);
        assert!((cpa.time_s - 100.0).abs() < 1e-3 && (cpa.range_m - 500.0).abs() < 1e-6);
        assert!(VesselMotion::through(&[[0.0; 3], [0.0; 3]]).is_err());
    }
}
