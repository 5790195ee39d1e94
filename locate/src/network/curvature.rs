//! What a curved likelihood does to a fix: the second-order bias of maximum likelihood, and a covariance that is not
//! that of one point only.
//!
//! Range goes as 1/tan β, so symmetric errors of elevation throw a distant source farther out than in. For
//! measurements `θ_k` with gradients `g_k`, Hessians `H_k` and covariance of position `C`, the bias of the ML estimate
//! is `b = −½ C Σ_k g_k tr(H_k C)/σ_k²` (Box 1971); it is scaled by the
//! noise the residuals show. `tr(H C)` comes from second differences of θ along the columns
//! of a Cholesky factor of C, which is also where the bound is evaluated again: the reported covariance is its mean
//! over these 2n points, so that a fix that happened to fall short does not claim to be better than one that fell
//! long. Known depth: n = 2, otherwise 3. Cost: 2n+1 bearings and bounds an array.

use super::bound::{horizontal, information};
use super::model::{Sighting, bearing, gradients};
use crate::angle::wrap_pi;
use crate::kit::spd::{self, Square};
use crate::math::f64 as m;

/// Largest bias that is corrected, as a share of the standard deviation: beyond it the second order is no
/// approximation any more and the fix is on its way to being unresolved.
const LARGEST_SHARE: f64 = 0.5;

/// Largest ratio of residual to claimed variance the correction follows: more is an outlier, not noise.
const LARGEST_NOISE: f64 = 2.0;

/// Covariance from the information at one place; the z row and column are zero where the depth is known.
pub(super) fn covariance(information: &Square<3>, depth_known: bool) -> Option<Square<3>> {
    if depth_known {
        let [[xx, xy], [yx, yy]] = spd::inverse(&horizontal(information))?;
        Some([[xx, xy, 0.0], [yx, yy, 0.0], [0.0; 3]])
    } else {
        spd::inverse(information)
    }
}

/// Position less its second-order bias, and the covariance averaged over the position's own uncertainty; the input
/// where the second order is too large to be one. `noise` is the variance of the residuals over the claimed one
/// (misfit over freedom, one on average; zero for exact bearings, which then give the exact position).
pub(super) fn corrected(
    sightings: &[Sighting],
    position_m: &[f64; 3],
    first_order: &Square<3>,
    depth_known: bool,
    noise: f64,
) -> ([f64; 3], Square<3>) {
    let Some(spread) = columns(first_order, depth_known) else { return (*position_m, *first_order) };
    let mut pull = [0.0; 3];
    for s in sightings {
        let (azimuth, elevation) = bearing(&s.array_m, position_m);
        let (ga, gb) = gradients(&s.array_m, position_m);
        let (mut bend_a, mut bend_b) = (0.0, 0.0);
        for column in &spread {
            for sign in [1.0, -1.0] {
                let (a, b) = bearing(&s.array_m, &moved(position_m, column, sign));
                bend_a += wrap_pi(a - azimuth);
                bend_b += b - elevation;
            }
        }
        let wa = bend_a / (s.sd_azimuth * s.sd_azimuth);
        let wb = if s.elevation.is_some() { bend_b / (s.sd_elevation * s.sd_elevation) } else { 0.0 };
        for ((p, a), b) in pull.iter_mut().zip(&ga).zip(&gb) {
            *p += wa * a + wb * b;
        }
    }
    let mut bias = [0.0; 3];
    for (b, row) in bias.iter_mut().zip(first_order) {
        *b = -0.5 * noise.clamp(0.0, LARGEST_NOISE) * row.iter().zip(&pull).map(|(c, p)| c * p).sum::<f64>();
    }
    let size = m::sqrt(bias.iter().map(|b| b * b).sum());
    let sd = m::sqrt(spd::largest_eigenvalue(first_order));
    if !(size <= LARGEST_SHARE * sd) {
        return (*position_m, *first_order);
    }
    let place = moved(position_m, &bias, -1.0);
    let mut mean = [[0.0; 3]; 3];
    let mut n = 0.0;
    // Columns of C's factor times √n: the points then have exactly the covariance C.
    let scale = m::sqrt(if depth_known { 2.0 } else { 3.0 });
    for column in &spread {
        for sign in [scale, -scale] {
            if column.iter().all(|x| *x == 0.0) {
                continue;
            }
            let Some(c) = covariance(&information(sightings, &moved(&place, column, sign)), depth_known)
            else {
                return (place, *first_order);
            };
            for (row, add) in mean.iter_mut().zip(&c) {
                for (x, y) in row.iter_mut().zip(add) {
                    *x += y;
                }
            }
            n += 1.0;
        }
    }
    mean.iter_mut().flatten().for_each(|x| *x /= n);
    // One of the points may lie where the bearings determine nothing; the mean is then its, not the fix's.
    let widened = spd::largest_eigenvalue(&mean) <= 4.0 * sd * sd;
    (place, if widened { mean } else { *first_order })
}

/// Columns of the Cholesky factor of a covariance, padded with zeros.
fn columns(covariance_m2: &Square<3>, depth_known: bool) -> Option<[[f64; 3]; 3]> {
    if depth_known {
        let [[xx, xy, _], [_, yy, _], _] = *covariance_m2;
        let [[a, _], [b, c]] = spd::Factor::new(&[[xx, xy], [xy, yy]])?.lower;
        Some([[a, b, 0.0], [0.0, c, 0.0], [0.0; 3]])
    } else {
        let [[a, ..], [b, c, _], [d, e, f]] = spd::Factor::new(covariance_m2)?.lower;
        Some([[a, b, d], [0.0, c, e], [0.0, 0.0, f]])
    }
}

fn moved(position_m: &[f64; 3], by: &[f64; 3], sign: f64) -> [f64; 3] {
    let mut out = *position_m;
    for (o, b) in out.iter_mut().zip(by) {
        *o += sign * b;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;

    /// One array and a known depth: range is h/tan β, whose bias is var(r)/r to second order (plus a part in (h/r)²).
    #[test]
    fn the_bias_of_range_from_elevation() {
        let array_m = [0.0, 0.0, -168.0];
        let position = [0.0, 1000.0, -5.0];
        let s = [Sighting {
            array_m,
            azimuth: 0.0,
            elevation: Some(bearing(&array_m, &position).1),
            sd_azimuth: 0.1 * RAD_PER_DEG,
            sd_elevation: 1.0 * RAD_PER_DEG,
        }];
        let first = covariance(&information(&s, &position), true).unwrap();
        let (place, c) = corrected(&s, &position, &first, true, 1.0);
        let expected = first[1][1] / 1000.0;
        assert!(((position[1] - place[1]) / expected - 1.0).abs() < 0.1, "{place:?} {expected}");
        assert!(c[1][1] > first[1][1] && c[1][1] < 1.3 * first[1][1]);
        assert!(c.iter().flatten().all(|x| x.is_finite()));
    }
}
