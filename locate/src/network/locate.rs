//! A fix, or the reason why there is none; robust to one bad array.
//!
//! Of the arrays, one may be wrong altogether (a second vessel, a reflected path, a turned frame). With three or more
//! arrays the misfit shows it: it is compared with its chi-square quantile, and where it is too large each array is
//! left out in turn. An array is set aside only if the rest then agree and no other choice explains them nearly as
//! well; otherwise all are kept, the fix is marked inconsistent and its covariance grows by the misfit.

use super::model::Sighting;
use super::search::{Maximum, maximum};
use super::{MAX_ARRAYS, NetworkError, Region};
use crate::kit::median;
use crate::kit::spd::{self, Square};
use crate::math::f64 as m;

/// Largest standard deviation of a fix, as a share of the median distance to the arrays: beyond one half, range is
/// not a number with an error but an open ridge of the likelihood.
pub const LARGEST_RELATIVE_SD: f64 = 0.5;

/// Normal quantile of the misfit test: one consistent set in a thousand is taken for inconsistent.
const TEST_QUANTILE: f64 = 3.09;

/// How a set is turned into a fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixSettings {
    /// Search region.
    pub region: Region,
    /// Whether one array may be set aside.
    pub robust: bool,
}

/// A position with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// East, North, Up, metres: the likelihood's maximum less its second-order bias.
    pub position_m: [f64; 3],
    /// Covariance of (x, y, z), square metres; the z row and column are zero where the depth is known.
    pub covariance_m2: Square<3>,
    /// Sum of squared standardised residuals of the arrays used.
    pub misfit: f64,
    /// Number of measured angles used minus unknowns.
    pub freedom: u32,
    /// Whether the misfit is within its test; where it is not, the covariance has been scaled up by misfit/freedom.
    pub consistent: bool,
    /// Index of the sighting that was set aside, if one was.
    pub rejected: Option<usize>,
    /// Whether the height ended at a limit of the region (its own standard deviation is then that of the bearings
    /// alone).
    pub height_at_limit: bool,
}

/// Locates a source.
///
/// # Errors
/// Bad input as [`maximum`]; [`NetworkError::NotObservable`] where the bearings do not determine the position;
/// [`NetworkError::OutsideRegion`] where the most likely place is at the horizontal edge of the region.
pub fn locate(sightings: &[Sighting], settings: &FixSettings) -> Result<Fix, NetworkError> {
    let region = &settings.region;
    let unknowns = if region.depth_known() { 2 } else { 3 };
    let whole = maximum(sightings, region)?;
    let freedom = angles(sightings, None).saturating_sub(unknowns);
    if !settings.robust || freedom == 0 || whole.misfit <= misfit_limit(freedom) {
        return fix(sightings, None, &whole, region, unknowns);
    }
    if sightings.len() >= 3
        && let Some((index, rest)) = outlier(sightings, region, unknowns)
    {
        return fix(sightings, Some(index), &rest, region, unknowns);
    }
    fix(sightings, None, &whole, region, unknowns)
}

/// The one array without which the others agree, if it stands out.
fn outlier(sightings: &[Sighting], region: &Region, unknowns: u32) -> Option<(usize, Maximum)> {
    let mut best: Option<(usize, Maximum)> = None;
    let mut second = f64::INFINITY;
    for index in 0..sightings.len() {
        let rest = without(sightings, Some(index))?;
        if angles(&rest, None) <= unknowns {
            continue;
        }
        let Ok(found) = maximum(&rest, region) else { continue };
        match &best {
            Some((_, b)) if found.misfit >= b.misfit => second = second.min(found.misfit),
            Some((_, b)) => {
                second = second.min(b.misfit);
                best = Some((index, found));
            }
            None => best = Some((index, found)),
        }
    }
    let (index, found) = best?;
    let freedom = angles(sightings, Some(index)).saturating_sub(unknowns);
    // Another choice within a likelihood ratio of e³ (6 in the misfit) means the bad array cannot be told.
    let alone = second - found.misfit >= 6.0;
    (found.misfit <= misfit_limit(freedom) && alone).then_some((index, found))
}

/// The sightings but one.
fn without(sightings: &[Sighting], index: Option<usize>) -> Option<heapless::Vec<Sighting, MAX_ARRAYS>> {
    let mut rest = heapless::Vec::new();
    for (_, s) in sightings.iter().enumerate().filter(|(i, _)| Some(*i) != index) {
        rest.push(*s).ok()?;
    }
    Some(rest)
}

/// Number of measured angles, without one sighting.
fn angles(sightings: &[Sighting], left_out: Option<usize>) -> u32 {
    sightings
        .iter()
        .enumerate()
        .filter(|(i, _)| Some(*i) != left_out)
        .map(|(_, s)| 1 + u32::from(s.elevation.is_some()))
        .sum()
}

/// Largest consistent misfit for a number of degrees of freedom (Wilson and Hilferty's chi-square quantile).
pub fn misfit_limit(freedom: u32) -> f64 {
    let k = f64::from(freedom.max(1));
    let c = 2.0 / (9.0 * k);
    let root = 1.0 - c + TEST_QUANTILE * m::sqrt(c);
    k * root * root * root
}

fn fix(
    sightings: &[Sighting],
    rejected: Option<usize>,
    found: &Maximum,
    region: &Region,
    unknowns: u32,
) -> Result<Fix, NetworkError> {
    let freedom = angles(sightings, rejected).saturating_sub(unknowns);
    let known = region.depth_known();
    let first_order =
        super::curvature::covariance(&found.information, known).ok_or(NetworkError::NotObservable)?;
    let inside = !found.at_edge.iter().any(|e| *e);
    let (position_m, mut covariance_m2) = if inside {
        let used = without(sightings, rejected).ok_or(NetworkError::TooManyArrays)?;
        let noise = if freedom > 0 { found.misfit / f64::from(freedom) } else { 0.0 };
        super::curvature::corrected(&used, &found.position_m, &first_order, known, noise)
    } else {
        (found.position_m, first_order)
    };
    let consistent = freedom == 0 || found.misfit <= misfit_limit(freedom);
    if !consistent {
        let scale = found.misfit / f64::from(freedom.max(1));
        covariance_m2.iter_mut().flatten().for_each(|x| *x *= scale);
    }
    let (edge_horizontal, edge_height) = match (region, found.at_edge) {
        (Region::Box { .. }, [x, y, z]) => (x || y, z),
        (Region::Polar { .. }, [_, e, r]) => (r, e),
    };
    if edge_horizontal {
        return Err(NetworkError::OutsideRegion);
    }
    let largest = m::sqrt(spd::largest_eigenvalue(&covariance_m2));
    if !(largest <= LARGEST_RELATIVE_SD * median_distance_m(sightings, rejected, &position_m)) {
        return Err(NetworkError::NotObservable);
    }
    Ok(Fix {
        position_m,
        covariance_m2,
        misfit: found.misfit,
        freedom,
        consistent,
        rejected,
        height_at_limit: edge_height,
    })
}

/// Median slant distance from the arrays used to a position, metres.
fn median_distance_m(sightings: &[Sighting], left_out: Option<usize>, position_m: &[f64; 3]) -> f64 {
    let mut distances: heapless::Vec<f64, MAX_ARRAYS> = heapless::Vec::new();
    for (_, s) in sightings.iter().enumerate().filter(|(i, _)| Some(*i) != left_out) {
        let [x, y, z] = super::model::difference(position_m, &s.array_m);
        // Never more than MAX_ARRAYS sightings pass the check.
        let _ = distances.push(m::sqrt(x * x + y * y + z * z));
    }
    median(&mut distances).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;
    use crate::network::model::bearing;

    fn seen(array_m: [f64; 3], source: [f64; 3], error: f64) -> Sighting {
        let (a, b) = bearing(&array_m, &source);
        Sighting {
            array_m,
            azimuth: a + error,
            elevation: Some(b + 0.2 * error),
            sd_azimuth: 1.5 * RAD_PER_DEG,
            sd_elevation: 1.6 * RAD_PER_DEG,
        }
    }

    const FREE: Region =
        Region::Box { least_m: [-2000.0, -2000.0, -168.0], greatest_m: [2000.0, 2000.0, 0.0] };
    const SURFACE: Region =
        Region::Box { least_m: [-2000.0, -2000.0, -5.0], greatest_m: [2000.0, 2000.0, -5.0] };

    #[test]
    fn a_source_on_the_line_through_the_arrays_is_refused() {
        // Both arrays at the source's own depth: no parallax at all.
        let arrays = [[0.0, 0.0, -5.0], [0.0, 100.0, -5.0]];
        let s = arrays.map(|a| seen(a, [0.0, 500.0, -5.0], 0.0));
        for region in [SURFACE, FREE] {
            let e = locate(&s, &FixSettings { region, robust: true });
            assert!(matches!(e, Err(NetworkError::NotObservable | NetworkError::OutsideRegion)), "{e:?}");
        }
        // Azimuths alone, seen nearly from the line, with errors either way.
        for error in [-0.01, 0.01] {
            let s = [seen(arrays[0], [3.0, 500.0, -5.0], 0.0), seen(arrays[1], [3.0, 500.0, -5.0], error)]
                .map(|s| Sighting { elevation: None, ..s });
            let e = locate(&s, &FixSettings { region: SURFACE, robust: true });
            assert!(matches!(e, Err(NetworkError::NotObservable | NetworkError::OutsideRegion)), "{e:?}");
        }
    }

    #[test]
    fn a_single_array_needs_the_depth() {
        let s = [seen([0.0, 0.0, -168.0], [200.0, 100.0, -5.0], 0.0)];
        assert!(locate(&s, &FixSettings { region: FREE, robust: true }).is_err());
        let f = locate(&s, &FixSettings { region: SURFACE, robust: true }).unwrap();
        assert!((f.position_m[0] - 200.0).abs() < 1e-3 && f.freedom == 0);
    }

    #[test]
    fn one_bad_array_of_four_is_set_aside() {
        let arrays =
            [[0.0, 100.0, -168.0], [86.6, -50.0, -168.0], [-86.6, -50.0, -168.0], [0.0, -300.0, -168.0]];
        let source = [400.0, 200.0, -5.0];
        let mut s = arrays.map(|a| seen(a, source, 0.0));
        s[2].azimuth += 40.0 * RAD_PER_DEG;
        let f = locate(&s, &FixSettings { region: SURFACE, robust: true }).unwrap();
        assert_eq!(f.rejected, Some(2));
        assert!(f.consistent && (f.position_m[0] - 400.0).abs() < 1.0, "{f:?}");
        let kept = locate(&s, &FixSettings { region: SURFACE, robust: false }).unwrap();
        assert!(!kept.consistent && kept.covariance_m2[0][0] > 4.0 * f.covariance_m2[0][0]);
    }

    #[test]
    fn misfit_limits_match_the_chi_square_table() {
        // 99.9 % points: 10.83, 16.27, 20.52 for 1, 3, 5 degrees of freedom; the approximation is within 4 %.
        for (k, q) in [(1, 10.83), (3, 16.27), (5, 20.52)] {
            assert!((misfit_limit(k) / q - 1.0).abs() < 0.04, "{k}");
        }
    }
}
