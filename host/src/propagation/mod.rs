//! Propagation between a vessel at the surface and a station on the sea floor: arrivals against range.
//!
//! A *path* is named by how many times it crosses the water column: 1 (direct), 3, 5, … An *arrival* is what one path
//! brings from one horizontal range: travel time and complex pressure amplitude, in the convention `exp(−iωt)` (its
//! conjugate multiplies an ordinary FFT). A *branch* is the interference of two neighbouring paths: 13, 35, 57, 79;
//! its strength is the height of the pulse it draws in the cepstrum [O 17], a skew-normal function of range [O D1].
//! [`Propagation`] holds all of it; [`mod@file`] reads and writes it, [`trace`] computes it from a sound-speed profile,
//! [`convert`] takes a ready table.

pub mod bottom;
pub mod convert;
pub mod file;
pub mod profile;
pub mod strength;
pub mod trace;

pub use nalgebra::Complex;
use strength::SkewNormal;

/// Centre frequency of a vessel's wideband noise at RR03, Hz [O 17, corrected].
pub const F0_HZ: f64 = 16.5;

/// Width of the pulse an interference draws in the cepstrum at RR03, s [O 17, corrected].
pub const WIDTH_S: f64 = 0.05;

/// What one path brings from one range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayArrival {
    /// Travel time, s.
    pub toa_s: f64,
    /// Pressure amplitude relative to 1 m, convention `exp(−iωt)`.
    pub amplitude: Complex<f64>,
}

/// One path against range.
#[derive(Clone, Debug, PartialEq)]
pub struct RayPath {
    /// How many times it crosses the water column (odd).
    pub crossings: u32,
    /// Arrival at range `j · step`; `None` where the path does not exist.
    pub arrivals: Vec<Option<RayArrival>>,
}

impl RayPath {
    /// First and last row with an arrival.
    pub fn span(&self) -> Option<(usize, usize)> {
        let first = self.arrivals.iter().position(Option::is_some)?;
        let last = self.arrivals.iter().rposition(Option::is_some)?;
        Some((first, last))
    }
}

/// Everything a station must know about propagation.
#[derive(Clone, Debug, PartialEq)]
pub struct Propagation {
    /// What it is for.
    pub name: String,
    /// Water depth, m.
    pub depth_m: f64,
    /// Distance between rows, m; row 0 is range 0.
    pub step_m: f64,
    /// Centre frequency of vessels' wideband noise, Hz.
    pub f0_hz: f64,
    /// Width of the cepstral pulse, s.
    pub width_s: f64,
    /// Paths in order of crossings: 1, 3, 5, …; all of one length.
    pub paths: Vec<RayPath>,
    /// Strength of branches 13, 35, 57, 79 against range; at most one less than paths.
    pub strengths: Vec<SkewNormal>,
}

impl Propagation {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.paths.first().map_or(0, |p| p.arrivals.len())
    }

    /// The farthest range, m.
    pub fn max_range_m(&self) -> f64 {
        self.step_m * self.rows().saturating_sub(1) as f64
    }

    /// Arrival of path number `path` (0 = direct) at a range: travel time by cubic, amplitude by linear
    /// interpolation; `None` outside the path's span.
    pub fn arrival(&self, path: usize, range_m: f64) -> Option<RayArrival> {
        let rows = &self.paths.get(path)?.arrivals;
        let (j, part) = self.place(range_m)?;
        let (a, b) = (rows[j]?, rows[j + 1]?);
        let amplitude = a.amplitude * (1.0 - part) + b.amplitude * part;
        let outer = j.checked_sub(1).and_then(|i| rows[i]).zip(rows.get(j + 2).copied().flatten());
        let toa_s = match outer {
            Some((before, after)) => cubic([before.toa_s, a.toa_s, b.toa_s, after.toa_s], part),
            None => a.toa_s + (b.toa_s - a.toa_s) * part,
        };
        Some(RayArrival { toa_s, amplitude })
    }

    /// Horizontal slowness of a path at a range, s/m: how its travel time grows with range (the ray parameter).
    pub fn slowness_s_m(&self, path: usize, range_m: f64) -> Option<f64> {
        let rows = &self.paths.get(path)?.arrivals;
        let (j, _) = self.place(range_m)?;
        Some((rows[j + 1]?.toa_s - rows[j]?.toa_s) / self.step_m)
    }

    /// Travel time of the sound at a range, weighted by the power of the paths: what separates a place that was
    /// measured from the moment the vessel was there. `None` where no path exists.
    pub fn travel_time_s(&self, row: usize) -> Option<f64> {
        let (mut power, mut sum) = (0.0, 0.0);
        for a in self.paths.iter().filter_map(|p| p.arrivals.get(row).copied().flatten()) {
            power += a.amplitude.norm_sqr();
            sum += a.amplitude.norm_sqr() * a.toa_s;
        }
        (power > 0.0).then(|| sum / power)
    }

    /// Delay (s) and phase (rad, not wrapped) of branch `branch` (0 = 13) in a row; `None` where it does not exist.
    pub fn branch(&self, branch: usize, row: usize) -> Option<(f64, f64)> {
        let early = (*self.paths.get(branch)?.arrivals.get(row)?)?;
        let late = (*self.paths.get(branch + 1)?.arrivals.get(row)?)?;
        Some((late.toa_s - early.toa_s, (late.amplitude * early.amplitude.conj()).arg()))
    }

    fn place(&self, range_m: f64) -> Option<(usize, f64)> {
        let x = range_m / self.step_m;
        let last = self.rows().checked_sub(2)?;
        if !(x >= 0.0 && x <= (last + 1) as f64) {
            return None;
        }
        let j = (x as usize).min(last);
        Some((j, x - j as f64))
    }
}

/// Lagrange interpolation through four equidistant values at `part` of the way from the second to the third.
fn cubic(y: [f64; 4], part: f64) -> f64 {
    let t = part;
    -t * (t - 1.0) * (t - 2.0) / 6.0 * y[0] + (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0 * y[1]
        - (t + 1.0) * t * (t - 2.0) / 2.0 * y[2]
        + (t + 1.0) * t * (t - 1.0) / 6.0 * y[3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_is_exact_for_cubics() {
        let f = |x: f64| 1.0 - 2.0 * x + 0.5 * x * x + 0.25 * x.powi(3);
        assert!((cubic([f(-1.0), f(0.0), f(1.0), f(2.0)], 0.3) - f(0.3)).abs() < 1e-12);
    }

    #[test]
    fn a_path_ends_where_its_rows_end() {
        let a = |t| Some(RayArrival { toa_s: t, amplitude: Complex::new(1.0, 0.0) });
        let p = Propagation {
            name: "t".into(),
            depth_m: 1.0,
            step_m: 10.0,
            f0_hz: F0_HZ,
            width_s: WIDTH_S,
            paths: vec![RayPath { crossings: 1, arrivals: vec![a(1.0), a(2.0), None] }],
            strengths: vec![],
        };
        assert_eq!(p.arrival(0, 5.0).unwrap().toa_s, 1.5);
        assert_eq!(p.arrival(0, 15.0), None);
        assert_eq!(p.arrival(0, -1.0), None);
        assert_eq!(p.arrival(1, 5.0), None);
        assert_eq!(p.travel_time_s(1), Some(2.0));
        assert_eq!(p.paths[0].span(), Some((0, 1)));
    }
}
