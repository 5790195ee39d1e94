//! The admissible set of source positions: part of the estimator, not a convenience.
//!
//! A bounded region makes estimates "superefficient" (paper N, section V): where the bound exceeds the region, errors
//! cannot. The region is a box in the coordinates the estimator searches.

use super::NetworkError;
use super::model;

/// Where the source may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// Rectangular coordinates [N 8, 10], metres: least and greatest x, y and z. Equal z limits mean a known depth
    /// [N 10].
    Box {
        /// Least (x, y, z).
        least_m: [f64; 3],
        /// Greatest (x, y, z).
        greatest_m: [f64; 3],
    },
    /// Polar coordinates about the frame's origin [N 9]: every azimuth, limited elevation (radians) and range
    /// (metres).
    Polar {
        /// Least and greatest elevation, radians.
        elevation: (f64, f64),
        /// Least and greatest range, metres.
        range_m: (f64, f64),
    },
}

impl Region {
    /// A square box of half-width `half_m` about a centre, at a known height z (minus the depth).
    pub fn at_depth(centre_m: [f64; 2], half_m: f64, z_m: f64) -> Self {
        let [x, y] = centre_m;
        Self::Box { least_m: [x - half_m, y - half_m, z_m], greatest_m: [x + half_m, y + half_m, z_m] }
    }

    /// A square box of half-width `half_m` about a centre between two heights.
    pub fn between(centre_m: [f64; 2], half_m: f64, z_m: (f64, f64)) -> Self {
        let [x, y] = centre_m;
        Self::Box { least_m: [x - half_m, y - half_m, z_m.0], greatest_m: [x + half_m, y + half_m, z_m.1] }
    }

    /// Checks the limits.
    ///
    /// # Errors
    /// [`NetworkError::NotFinite`], [`NetworkError::EmptyRegion`].
    pub fn check(&self) -> Result<(), NetworkError> {
        let (least, greatest) = self.limits();
        let mut n = 0;
        for ((lo, hi), free) in least.iter().zip(&greatest).zip(self.free()) {
            if !(lo.is_finite() && hi.is_finite()) {
                return Err(NetworkError::NotFinite);
            }
            if lo > hi {
                return Err(NetworkError::EmptyRegion);
            }
            n += u8::from(free);
        }
        let reaches = match self {
            Self::Box { .. } => true,
            Self::Polar { elevation, range_m } => {
                elevation.0 >= -crate::math::f64::FRAC_PI_2
                    && elevation.1 <= crate::math::f64::FRAC_PI_2
                    && range_m.0 >= 0.0
            }
        };
        if n >= 2 && reaches { Ok(()) } else { Err(NetworkError::EmptyRegion) }
    }

    /// Limits in the region's own coordinates; the azimuth's (−2π to 4π) leave every iteration room to wrap.
    pub fn limits(&self) -> ([f64; 3], [f64; 3]) {
        match *self {
            Self::Box { least_m, greatest_m } => (least_m, greatest_m),
            Self::Polar { elevation, range_m } => (
                [-crate::math::f64::TAU, elevation.0, range_m.0],
                [2.0 * crate::math::f64::TAU, elevation.1, range_m.1],
            ),
        }
    }

    /// Which coordinates are searched (a coordinate with equal limits is known).
    pub fn free(&self) -> [bool; 3] {
        let ([a0, b0, c0], [a1, b1, c1]) = self.limits();
        [a1 > a0, b1 > b0, c1 > c0]
    }

    /// Whether the depth is known: two unknowns only.
    pub fn depth_known(&self) -> bool {
        self.free().iter().filter(|f| **f).count() == 2
    }

    /// (x, y, z) of the region's own coordinates.
    pub fn position(&self, own: &[f64; 3]) -> [f64; 3] {
        match self {
            Self::Box { .. } => *own,
            Self::Polar { .. } => model::rectangular(own),
        }
    }

    /// The region's own coordinates of (x, y, z), moved to the nearest admissible values.
    pub fn own(&self, position_m: &[f64; 3]) -> [f64; 3] {
        let raw = match self {
            Self::Box { .. } => *position_m,
            Self::Polar { .. } => model::polar(position_m),
        };
        self.clamp(&raw)
    }

    /// Own coordinates moved inside the limits.
    pub fn clamp(&self, own: &[f64; 3]) -> [f64; 3] {
        let (least, greatest) = self.limits();
        let mut out = *own;
        for ((x, lo), hi) in out.iter_mut().zip(&least).zip(&greatest) {
            *x = x.max(*lo).min(*hi);
        }
        out
    }

    /// Derivatives of (x, y, z) by the own coordinates, one row a coordinate.
    pub fn derivatives(&self, own: &[f64; 3]) -> [[f64; 3]; 3] {
        match self {
            Self::Box { .. } => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            Self::Polar { .. } => model::polar_derivatives(own),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_checked() {
        assert_eq!(Region::at_depth([0.0, 0.0], 2000.0, -5.0).check(), Ok(()));
        assert!(Region::at_depth([0.0, 0.0], 2000.0, -5.0).depth_known());
        assert_eq!(Region::at_depth([0.0, 0.0], -1.0, -5.0).check(), Err(NetworkError::EmptyRegion));
        assert_eq!(Region::at_depth([0.0, 0.0], 0.0, -5.0).check(), Err(NetworkError::EmptyRegion));
        assert_eq!(Region::at_depth([f64::NAN, 0.0], 9.0, -5.0).check(), Err(NetworkError::NotFinite));
        let polar = Region::Polar { elevation: (0.0, 1.5), range_m: (1.0, 2000.0) };
        assert_eq!(polar.check(), Ok(()));
        assert!(!polar.depth_known());
        let beyond = Region::Polar { elevation: (0.0, 3.0), range_m: (1.0, 2000.0) };
        assert_eq!(beyond.check(), Err(NetworkError::EmptyRegion));
    }
}
