//! Cramér-Rao bounds of position [N 11-18]: what no unbiased estimator beats, with and without a known depth.
//!
//! `F = Σ_n (∇α_n ∇α_nᵀ/σ_α² + ∇β_n ∇β_nᵀ/σ_β²)`; the bound with a known depth inverts the (x, y) block of F, the
//! bound without it inverts all of F. The paper draws only the latter, below which an estimator that knows the depth
//! naturally falls.

use super::model::{self, Sighting};
use super::{NetworkError, Region};
use crate::kit::spd::{self, Square};
use crate::math::f64 as m;

/// Bounds in rectangular coordinates, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectangularBound {
    /// Standard deviations of x, y and z without a known depth [N 17d-f]; `None` where not observable.
    pub free_m: Option<[f64; 3]>,
    /// Standard deviations of x and y with the depth known; `None` where not observable.
    pub known_depth_m: Option<[f64; 2]>,
}

impl RectangularBound {
    /// Horizontal bound `√(σ_x² + σ_y²)` [N 18] without a known depth, metres.
    pub fn horizontal_free_m(&self) -> Option<f64> {
        self.free_m.map(|[x, y, _]| m::sqrt(x * x + y * y))
    }

    /// Horizontal bound [N 18] with the depth known, metres.
    pub fn horizontal_known_depth_m(&self) -> Option<f64> {
        self.known_depth_m.map(|[x, y]| m::sqrt(x * x + y * y))
    }
}

/// Bounds in polar coordinates about the frame's origin [N 17a-c].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolarBound {
    /// Standard deviation of azimuth, radians.
    pub azimuth: f64,
    /// Standard deviation of elevation, radians.
    pub elevation: f64,
    /// Standard deviation of range, metres.
    pub range_m: f64,
}

/// Fisher information by (x, y, z) at a position [N 13].
pub fn information(sightings: &[Sighting], source_m: &[f64; 3]) -> Square<3> {
    information_in(
        sightings,
        source_m,
        &Region::Box { least_m: [0.0; 3], greatest_m: [0.0; 3] }.derivatives(source_m),
    )
}

/// Fisher information by other coordinates, given the derivatives of (x, y, z) by them [N 13, 15].
fn information_in(sightings: &[Sighting], source_m: &[f64; 3], derivatives: &[[f64; 3]; 3]) -> Square<3> {
    let mut f = [[0.0; 3]; 3];
    for s in sightings {
        let (ga, gb) = model::gradients(&s.array_m, source_m);
        spd::add_outer(&mut f, &model::chain(&ga, derivatives), 1.0 / (s.sd_azimuth * s.sd_azimuth));
        if s.elevation.is_some() {
            let weight = 1.0 / (s.sd_elevation * s.sd_elevation);
            spd::add_outer(&mut f, &model::chain(&gb, derivatives), weight);
        }
    }
    f
}

/// The (x, y) block.
pub(super) fn horizontal(f: &Square<3>) -> Square<2> {
    let [[xx, xy, _], [_, yy, _], _] = *f;
    [[xx, xy], [xy, yy]]
}

/// Bounds of (x, y, z) at a true position; the sightings' angles themselves are not used, only which are measured.
///
/// # Errors
/// As [`model::check`].
pub fn rectangular_bound(
    sightings: &[Sighting],
    source_m: &[f64; 3],
) -> Result<RectangularBound, NetworkError> {
    model::check(sightings)?;
    let f = information(sightings, source_m);
    let free = spd::inverse(&f).map(|[[xx, ..], [_, yy, _], [.., zz]]| [xx, yy, zz].map(m::sqrt));
    let known = spd::inverse(&horizontal(&f)).map(|[[xx, _], [_, yy]]| [xx, yy].map(m::sqrt));
    Ok(RectangularBound { free_m: free, known_depth_m: known })
}

/// Bounds of (azimuth, elevation, range) about the origin at a true position.
///
/// # Errors
/// As [`model::check`]; [`NetworkError::NotObservable`] where the information is singular (also straight above the
/// origin, where azimuth is undefined).
pub fn polar_bound(sightings: &[Sighting], source_m: &[f64; 3]) -> Result<PolarBound, NetworkError> {
    model::check(sightings)?;
    let f = information_in(sightings, source_m, &model::polar_derivatives(&model::polar(source_m)));
    let [[aa, ..], [_, bb, _], [.., rr]] = spd::inverse(&f).ok_or(NetworkError::NotObservable)?;
    Ok(PolarBound { azimuth: m::sqrt(aa), elevation: m::sqrt(bb), range_m: m::sqrt(rr) })
}

/// Covariance of (x, y) at a true position of known depth, square metres [N 13, 17d, e]; `None` where it is not observable.
///
/// # Errors
/// As [`model::check`].
pub fn known_depth_bound(
    sightings: &[Sighting],
    source_m: &[f64; 3],
) -> Result<Option<Square<2>>, NetworkError> {
    model::check(sightings)?;
    Ok(spd::inverse(&horizontal(&information(sightings, source_m))))
}

/// Standard deviations of azimuth (radians) and horizontal range (metres) of a position about a point, of its covariance:
/// the polar form [N 17a, c] of what is known with the depth.
pub fn about([x0, y0]: [f64; 2], [x, y, _]: &[f64; 3], covariance_m2: &Square<2>) -> (f64, f64) {
    let (east, north) = (x - x0, y - y0);
    let range = m::sqrt(east * east + north * north);
    let variance = |u: [f64; 2]| spd::quadratic(&u, covariance_m2, &u).max(0.0);
    let along = m::sqrt(variance([east / range, north / range]));
    let across = m::sqrt(variance([north / range, -east / range]));
    (across / range, along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;

    pub(crate) const TWO: [[f64; 3]; 2] = [[4.5, -21.2, -168.0], [-4.5, 21.2, -168.0]];
    pub(crate) const THREE: [[f64; 3]; 3] =
        [[0.0, 100.0, -168.0], [86.6, -50.0, -168.0], [-86.6, -50.0, -168.0]];

    fn sightings<const N: usize>(arrays: [[f64; 3]; N]) -> [Sighting; N] {
        arrays.map(|array_m| Sighting {
            array_m,
            azimuth: 0.0,
            elevation: Some(0.0),
            sd_azimuth: 1.5 * RAD_PER_DEG,
            sd_elevation: 1.6 * RAD_PER_DEG,
        })
    }

    fn source(range_m: f64) -> [f64; 3] {
        let a = -5.0 * RAD_PER_DEG;
        [range_m * a.sin(), range_m * a.cos(), -5.0]
    }

    /// Reference values of docs/references.md (N), to the printed digits.
    #[test]
    fn reference_bounds() {
        for (range, two, three) in [
            (200.0, 8.7, 5.7),
            (400.0, 23.6, 16.5),
            (600.0, 47.9, 34.8),
            (800.0, 81.8, 60.2),
            (1000.0, 125.4, 92.9),
        ] {
            let b = rectangular_bound(&sightings(TWO), &source(range)).unwrap();
            assert!((b.horizontal_known_depth_m().unwrap() - two).abs() <= 0.05, "{range} {b:?}");
            let b = rectangular_bound(&sightings(THREE), &source(range)).unwrap();
            assert!((b.horizontal_known_depth_m().unwrap() - three).abs() <= 0.05, "{range} {b:?}");
        }
        let b = rectangular_bound(&sightings(TWO), &source(1000.0)).unwrap();
        assert!((b.horizontal_free_m().unwrap() - 4463.0).abs() <= 0.5, "{b:?}");
        let b = rectangular_bound(&sightings(THREE), &source(1000.0)).unwrap();
        assert!((b.horizontal_free_m().unwrap() - 232.7).abs() <= 0.05, "{b:?}");
    }

    /// The same information in two coordinate systems: the range bound follows from the rectangular covariance.
    #[test]
    fn polar_and_rectangular_bounds_agree() {
        let s = sightings(THREE);
        let p = source(600.0);
        let c = spd::inverse(&information(&s, &p)).unwrap();
        let r = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
        let var: f64 =
            (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| p[i] * p[j] * c[i][j]).sum();
        let polar = polar_bound(&s, &p).unwrap();
        assert!((polar.range_m - var.sqrt() / r).abs() < 1e-6 * polar.range_m);
    }

    /// The known-depth covariance is that of the rectangular bound, and a polar form of it keeps its area.
    #[test]
    fn the_polar_form_of_a_known_depth() {
        let (s, p) = (sightings(THREE), source(600.0));
        let c = known_depth_bound(&s, &p).unwrap().unwrap();
        let known = rectangular_bound(&s, &p).unwrap().known_depth_m.unwrap();
        assert!((c[0][0].sqrt() - known[0]).abs() < 1e-9 && (c[1][1].sqrt() - known[1]).abs() < 1e-9);
        let (azimuth, range) = about([0.0, 0.0], &p, &c);
        // Azimuths alone of an array at the origin give its own standard deviation across.
        let here = [Sighting { array_m: [0.0, 0.0, -168.0], ..s[0] }];
        let own = known_depth_bound(&here, &p).unwrap().unwrap();
        let (of_one, _) = about([0.0, 0.0], &p, &own);
        assert!((of_one / here[0].sd_azimuth - 1.0).abs() < 1e-9, "{of_one}");
        assert!(
            azimuth < of_one && (range * range + (600.0 * azimuth).powi(2) - c[0][0] - c[1][1]).abs() < 1e-6
        );
        // Without elevations range comes from the parallax alone.
        let flat = s.map(|s| Sighting { elevation: None, ..s });
        let (_, by_azimuths) = about([0.0, 0.0], &p, &known_depth_bound(&flat, &p).unwrap().unwrap());
        assert!(by_azimuths > range);
    }

    #[test]
    fn a_single_array_needs_a_depth() {
        let s = sightings([[0.0, 0.0, -168.0]]);
        let b = rectangular_bound(&s, &source(500.0)).unwrap();
        assert!(b.free_m.is_none() && b.known_depth_m.is_some());
        assert_eq!(polar_bound(&s, &source(500.0)), Err(NetworkError::NotObservable));
    }
}
