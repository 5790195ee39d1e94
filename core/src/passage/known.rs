//! A line with its uncertainty in 96 bytes, and what it predicts.
//!
//! The covariance of the line's first four parameters is kept as its triangular root in single precision: a predicted
//! variance is then a sum of squares, whose rounding stays below a microradian however strongly the parameters of a
//! young track are correlated. The fifth, the elevations' bias, moves no azimuth.

use super::Config;
use crate::motion::model::{Line, PARAMETERS};
use crate::motion::normal::Matrix;

/// Parameters that move an azimuth.
const MOVING: usize = 4;

/// A prediction of azimuth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prediction {
    /// Azimuth, radians.
    pub(crate) azimuth: f64,
    /// Variance of the line's prediction, rad².
    pub(crate) line_variance: f64,
    /// Variance of the bearings' own coloured error, rad².
    pub(crate) coloured_variance: f64,
}

impl Prediction {
    /// Variance of a new bearing about the prediction, its white part aside.
    pub(crate) fn variance(&self) -> f64 {
        self.line_variance + self.coloured_variance
    }
}

/// A line with what is known about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known {
    pub(crate) line: Line,
    /// Lower triangular root of the covariance, row by row.
    root: [f32; MOVING * (MOVING + 1) / 2],
}

impl Known {
    /// From a line and the covariance of its parameters.
    pub(crate) fn new(line: Line, covariance: &Matrix) -> Self {
        Self { line, root: root(covariance) }
    }

    /// Standard deviation of the heading, radians.
    pub(crate) fn heading_sd_rad(&self) -> f64 {
        f64::from(self.root[0])
    }

    /// Covariance of the parameters (none for the elevations' bias).
    pub(crate) fn covariance(&self) -> Matrix {
        let mut l = [[0.0; MOVING]; MOVING];
        let mut kept = self.root.iter();
        for (i, row) in l.iter_mut().enumerate() {
            for (place, root) in row.iter_mut().take(i + 1).zip(&mut kept) {
                *place = f64::from(*root);
            }
        }
        let mut out = [[0.0; PARAMETERS]; PARAMETERS];
        for i in 0..MOVING {
            for j in 0..MOVING {
                out[i][j] = l[i].iter().zip(&l[j]).map(|(a, b)| a * b).sum();
            }
        }
        out
    }

    /// Azimuth at a time of reception and the variance the line's uncertainty gives it.
    pub(crate) fn azimuth(&self, config: &Config, t_s: f64) -> (f64, f64) {
        let e = self.line.expected(&config.medium, t_s);
        let mut parts = [0.0; MOVING];
        let mut kept = self.root.iter();
        for (i, derivative) in e.d_azimuth.iter().take(MOVING).enumerate() {
            for (part, root) in parts.iter_mut().take(i + 1).zip(&mut kept) {
                *part += f64::from(*root) * derivative;
            }
        }
        (e.azimuth, parts.iter().map(|x| x * x).sum())
    }
}

/// Lower triangular root of the covariance's first rows; a direction without spread (a known speed) has a zero column.
fn root(covariance: &Matrix) -> [f32; MOVING * (MOVING + 1) / 2] {
    let [a, b, c, d, _] = *covariance;
    let l = crate::kit::spd::root(&[a, b, c, d].map(|[a, b, c, d, _]| [a, b, c, d]));
    let mut out = [0.0; MOVING * (MOVING + 1) / 2];
    let triangle = l.iter().enumerate().flat_map(|(i, row)| row.iter().take(i + 1));
    out.iter_mut().zip(triangle).for_each(|(place, x)| *place = *x as f32);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::spd::quadratic;
    use crate::math::f64 as m;
    use crate::motion::normal::Normal;

    #[test]
    fn kept_spread_is_that_of_the_covariance_for_free_and_for_known_speed() {
        let config = Config::default();
        let line = Line { p: [0.4, 60.0, m::ln(7.0 / 600.0), m::ln(7.0), 0.0], sense: -1.0 };
        // The first seconds of a track, whose parameters are correlated to five digits.
        let mut normal = Normal::default();
        for k in 0..20 {
            let e = line.expected(&config.medium, f64::from(k));
            let [a, b, c, d, _] = e.d_azimuth;
            normal.add(&[a, b, c, d, 0.0, 0.0], 1e6);
        }
        normal.add(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0], 10.0);
        for free in [[true, true, true, true, false], [true, true, true, false, false]] {
            let covariance = normal.covariance(&free, &[1e-3, 1e-6, 1e-2, 1e-3, 1e-3]).unwrap();
            let known = Known::new(line, &covariance);
            for t in [0.0, 12.0, 25.0, 80.0] {
                let d = line.expected(&config.medium, t).d_azimuth;
                let (expected, kept) = (quadratic(&d, &covariance, &d), known.azimuth(&config, t).1);
                assert!((kept - expected).abs() < 1e-3 * expected + 1e-10, "{t} {kept} {expected}");
            }
        }
        assert!(size_of::<Known>() <= 96);
    }
}
