//! A layered sound-speed profile: the speed is linear in depth between the given points.

use crate::csv::CsvTable;
use anyhow::{Context, Result, bail};
use std::path::Path;

/// Speeds of sound that sea water can have, m/s.
const SPEEDS_M_S: std::ops::RangeInclusive<f64> = 1350.0..=1650.0;

/// Sound speed against depth, from the surface to the floor.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedProfile {
    /// Depth (m, growing, first 0) and speed (m/s).
    points: Vec<(f64, f64)>,
}

/// What a ray of one ray parameter does on its way through the whole column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Horizontal distance, m.
    pub x_m: f64,
    /// Travel time, s.
    pub t_s: f64,
}

impl SpeedProfile {
    /// One speed everywhere.
    pub fn uniform(depth_m: f64, speed_m_s: f64) -> Self {
        Self { points: vec![(0.0, speed_m_s), (depth_m, speed_m_s)] }
    }

    /// Reads a CSV with columns `depth_m,speed_m_s` and cuts or extends it (with the slope of its last two points) to
    /// a floor. The uppermost speed holds up to the surface.
    ///
    /// # Errors
    /// Missing columns, depths that do not grow, speeds sea water cannot have, a profile that ends far above the floor.
    pub fn read(path: &Path, depth_m: f64) -> Result<Self> {
        let table = CsvTable::read(path)?;
        let rows = table.numbers(["depth_m", "speed_m_s"])?;
        let mut points = Vec::new();
        for (line, row) in rows {
            let [z, c] = row?;
            let here = || format!("{}, line {line}", path.display());
            if !SPEEDS_M_S.contains(&c) {
                bail!("{}: speed_m_s is {c}; sea water has 1350 to 1650 m/s (is it in km/s?)", here());
            }
            points.push((z, c));
            if let [.., (before, _), (now, _)] = points[..]
                && now <= before
            {
                bail!("{}: depth_m must grow (positive down), {now} follows {before}", here());
            }
        }
        Self::new(points, depth_m).with_context(|| path.display().to_string())
    }

    /// Of points (depth, speed), cut or extended to a floor.
    ///
    /// # Errors
    /// Fewer than two points, or a profile that ends more than a tenth of the depth above the floor.
    pub fn new(mut points: Vec<(f64, f64)>, depth_m: f64) -> Result<Self> {
        if points.len() < 2 {
            bail!("a profile needs two depths or more");
        }
        if points[0].0 > 0.0 {
            points.insert(0, (0.0, points[0].1));
        }
        let (last_z, last_c) = points[points.len() - 1];
        if last_z < 0.9 * depth_m {
            bail!(
                "the profile ends at {last_z} m, the floor is at {depth_m} m (is the profile in km, or the depth wrong?)"
            );
        }
        let (z0, c0) = points[points.len() - 2];
        let slope = (last_c - c0) / (last_z - z0);
        if last_z < depth_m {
            points.push((depth_m, last_c + slope * (depth_m - last_z)));
        }
        let cut = points.iter().position(|p| p.0 >= depth_m).unwrap_or(points.len() - 1);
        let (z1, c1) = points[cut];
        let (z0, c0) = points[cut - 1];
        points.truncate(cut);
        points.push((depth_m, c0 + (c1 - c0) * (depth_m - z0) / (z1 - z0)));
        Ok(Self { points })
    }

    /// The open ocean of the subtropics: warm water over a sound channel at about 1200 m.
    ///
    /// # Errors
    /// As [`SpeedProfile::new`]; depths from 1500 to 6000 m are fine.
    pub fn subtropical(depth_m: f64) -> Result<Self> {
        let points = [
            (0.0, 1535.5),
            (60.0, 1535.5),
            (150.0, 1528.0),
            (300.0, 1517.0),
            (600.0, 1501.5),
            (900.0, 1489.5),
            (1200.0, 1486.0),
            (1600.0, 1487.0),
            (2200.0, 1494.0),
            (3000.0, 1506.5),
            (4000.0, 1523.5),
            (5000.0, 1541.0),
            (6000.0, 1559.0),
        ];
        Self::new(points.to_vec(), depth_m)
    }

    /// Depth of the floor, m.
    pub fn depth_m(&self) -> f64 {
        self.points[self.points.len() - 1].0
    }

    /// Speed at the surface, m/s.
    pub fn surface_m_s(&self) -> f64 {
        self.points[0].1
    }

    /// Speed at the floor, m/s.
    pub fn floor_m_s(&self) -> f64 {
        self.points[self.points.len() - 1].1
    }

    /// The greatest speed; rays with a parameter of its inverse or more turn before they cross.
    pub fn greatest_m_s(&self) -> f64 {
        self.points.iter().map(|p| p.1).fold(0.0, f64::max)
    }

    /// Distance and time of one crossing of the column for a ray parameter p below 1 / greatest speed: the sum of
    /// circular arcs, in a form that has no loss of digits where the gradient or p vanishes.
    pub fn crossing(&self, p_s_m: f64) -> Crossing {
        let mut sum = Crossing { x_m: 0.0, t_s: 0.0 };
        for w in self.points.windows(2) {
            let ((z1, c1), (z2, c2)) = (w[0], w[1]);
            let dz = z2 - z1;
            let (s1, s2) = (cosine(p_s_m, c1), cosine(p_s_m, c2));
            sum.x_m += p_s_m * (c1 + c2) * dz / (s1 + s2);
            let bend = (c2 - c1) / c1;
            sum.t_s += if bend.abs() < 1e-7 {
                2.0 * dz / (0.5 * (c1 + c2) * (s1 + s2))
            } else {
                dz / (c2 - c1) * (bend.ln_1p() + ((s1 - s2) / (1.0 + s2)).ln_1p())
            };
        }
        sum
    }
}

/// Cosine of a ray's angle from the vertical.
fn cosine(p_s_m: f64, speed_m_s: f64) -> f64 {
    let s = p_s_m * speed_m_s;
    ((1.0 - s) * (1.0 + s)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_speed_gives_straight_rays() {
        let p = SpeedProfile::uniform(4000.0, 1500.0);
        let x = p.crossing(0.6 / 1500.0);
        assert!((x.x_m - 3000.0).abs() < 1e-9 && (x.t_s - 5000.0 / 1500.0).abs() < 1e-12, "{x:?}");
    }

    #[test]
    fn a_gradient_agrees_with_many_thin_layers() {
        let p = SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1485.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let q = 0.9 / 1540.0;
        let (mut x, mut t) = (0.0, 0.0);
        let n = 400_000;
        for i in 0..n {
            let z = (f64::from(i) + 0.5) * 4340.0 / f64::from(n);
            let c = if z < 1000.0 { 1540.0 - 0.055 * z } else { 1485.0 + 43.0 / 3340.0 * (z - 1000.0) };
            let s = (1.0 - (q * c) * (q * c)).sqrt();
            x += 4340.0 / f64::from(n) * q * c / s;
            t += 4340.0 / f64::from(n) / (c * s);
        }
        let sum = p.crossing(q);
        assert!((sum.x_m - x).abs() < 1e-4 && (sum.t_s - t).abs() < 1e-8, "{sum:?} {x} {t}");
    }

    #[test]
    fn cut_and_extended_to_the_floor() {
        let p = SpeedProfile::new(vec![(5.0, 1540.0), (4000.0, 1520.0)], 4200.0).unwrap();
        assert_eq!((p.surface_m_s(), p.depth_m()), (1540.0, 4200.0));
        assert!((p.floor_m_s() - 1519.0).abs() < 0.01);
        let p = SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1500.0), (5000.0, 1540.0)], 3000.0).unwrap();
        assert_eq!((p.floor_m_s(), p.depth_m()), (1520.0, 3000.0));
        assert!(SpeedProfile::new(vec![(0.0, 1500.0), (5.0, 1500.0)], 4000.0).is_err());
    }
}
