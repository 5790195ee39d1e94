//! Positions of a compact array's hydrophones, from arrival-time differences of a vessel of known track.
//!
//! For a source at `r`, `τ_ij = (‖r − h_j‖ − ‖r − h_i‖)/c`; per pair that is one equation in the six coordinates of two
//! hydrophones, with gradient `∂τ_ij/∂h_j = −û_j/c`, `∂τ_ij/∂h_i = û_i/c`. Gauss-Newton from the configured positions over
//! the twelve coordinates with robust weights. Differences say nothing of a common displacement, so the centroid is
//! held where it was configured. The vessel's track must be good to the accuracy wanted: 1 m at 300 m turns the
//! whole array by 0.2°, 6 mm at 1.85 m.

use super::{OrientError, quantile};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::kit::{Huber, MAD_TO_SD, Normal, Tukey, reweighted};
use crate::math::f64 as m;

/// Unknown coordinates.
const UNKNOWNS: usize = 3 * CHANNELS;
/// Fewest sets of six differences.
const LEAST_SETS: usize = 10;
/// Smallest noise of a difference assumed, seconds, so that exact data do not divide by zero.
const LEAST_SCALE_S: f64 = 1e-12;
/// Largest standard deviation of a coordinate that is one, metres.
const LARGEST_SD_M: f64 = 0.5;

/// Differences of one instant and where the source was, East, North, Up from the array's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Differences {
    /// Source position, metres.
    pub source_m: [f64; 3],
    /// `τ_ij = t_j − t_i` in the order of [`PAIRS`], seconds; NaN where a pair is missing.
    pub tdoa_s: [f64; 6],
}

/// Hydrophone positions found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hydrophones {
    /// East, North, Up of each, metres, in the true frame.
    pub position_m: [[f64; 3]; CHANNELS],
    /// Standard deviations of the same, metres.
    pub sd_m: [[f64; 3]; CHANNELS],
    /// Robust standard deviation of one difference about the fit, seconds.
    pub scale_s: f64,
    /// Differences used.
    pub n: usize,
}

/// Finds the positions from configured ones.
///
/// # Errors
/// [`OrientError`].
pub fn hydrophones(
    sets: &[Differences],
    configured_m: &[[f64; 3]; CHANNELS],
    sound_speed_m_s: f64,
) -> Result<Hydrophones, OrientError> {
    if sets.len() < LEAST_SETS {
        return Err(OrientError::TooFew);
    }
    let finite = configured_m.iter().flatten().all(|x| x.is_finite())
        && sets.iter().all(|s| s.source_m.iter().all(|x| x.is_finite()));
    if !finite || !(sound_speed_m_s > 100.0) {
        return Err(OrientError::NotFinite);
    }
    let equations = |round, (h, scale_s): &(_, f64)| {
        // Huber's weights find the neighbourhood, Tukey's then leave wrong pairs out.
        let weight = |r| if round < 6 { Huber::EFFICIENT.weight(r) } else { Tukey::EFFICIENT.weight(r) };
        let mut normal = Normal::<UNKNOWNS>::default();
        for (row, value) in sets.iter().flat_map(|s| rows(s, h, sound_speed_m_s)) {
            normal.observe(&row, value, weight(value / scale_s));
        }
        // The centroid: three equations "the changes sum to zero" with the weight of a typical diagonal element.
        let trace: f64 =
            normal.upper.iter().enumerate().filter_map(|(i, row)| row.get(i)).sum::<f64>() / UNKNOWNS as f64;
        for axis in 0..3 {
            let mut row = [0.0; UNKNOWNS];
            row.iter_mut().skip(axis).step_by(3).for_each(|x| *x = 1.0);
            normal.observe(&row, 0.0, trace);
        }
        Some(normal)
    };
    let advance = |round, (h, scale_s): &mut ([[f64; 3]; CHANNELS], f64), step: &[f64; UNKNOWNS]| {
        h.iter_mut().flatten().zip(step).for_each(|(x, step)| *x += step);
        let residuals = sets.iter().flat_map(|s| rows(s, h, sound_speed_m_s)).map(|(_, value)| m::abs(value));
        *scale_s = (MAD_TO_SD * quantile(residuals, 0.5)).max(LEAST_SCALE_S);
        round <= 6 || step.iter().any(|x| !(m::abs(*x) < 1e-9))
    };
    // Any wrong pair is at most an array's length off; the first round takes all in.
    let ((h, scale_s), c) = reweighted((*configured_m, f64::INFINITY), 20, equations, advance)
        .ok_or(OrientError::NotObservable)?;
    let n = sets.iter().flat_map(|s| rows(s, &h, sound_speed_m_s)).count();
    let mut sd_m = [[0.0; 3]; CHANNELS];
    for (s, (i, row)) in sd_m.iter_mut().flatten().zip(c.iter().enumerate()) {
        // Six differences of four arrival times carry the information of three: twice the variance.
        *s = scale_s * m::sqrt(2.0 * row.get(i).copied().unwrap_or(f64::NAN).max(0.0));
    }
    let good = h.iter().flatten().all(|x| x.is_finite());
    if good && sd_m.iter().flatten().all(|s| *s <= LARGEST_SD_M) {
        Ok(Hydrophones { position_m: h, sd_m, scale_s, n })
    } else {
        Err(OrientError::NotObservable)
    }
}

/// Gradient and residual of every measured pair of a set.
fn rows<'a>(
    set: &'a Differences,
    h: &'a [[f64; 3]; CHANNELS],
    c: f64,
) -> impl Iterator<Item = ([f64; UNKNOWNS], f64)> + Clone + use<'a> {
    PAIRS.iter().zip(&set.tdoa_s).filter(|(_, tau)| tau.is_finite()).map(move |((i, j), tau)| {
        let (di, ui) = towards(&set.source_m, h.get(*i));
        let (dj, uj) = towards(&set.source_m, h.get(*j));
        let mut row = [0.0; UNKNOWNS];
        for (x, u) in row.iter_mut().skip(3 * i).zip(&ui) {
            *x = u / c;
        }
        for (x, u) in row.iter_mut().skip(3 * j).zip(&uj) {
            *x = -u / c;
        }
        (row, tau - (dj - di) / c)
    })
}

/// Distance and unit vector from a hydrophone to the source.
fn towards(source_m: &[f64; 3], hydrophone_m: Option<&[f64; 3]>) -> (f64, [f64; 3]) {
    let mut d = *source_m;
    for (x, h) in d.iter_mut().zip(hydrophone_m.unwrap_or(&[0.0; 3])) {
        *x -= h;
    }
    let norm = m::sqrt(d.iter().map(|x| x * x).sum::<f64>()).max(1e-9);
    (norm, d.map(|x| x / norm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const TRUE: [[f64; 3]; 4] =
        [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, -0.01, 1.14]];

    fn passes(noise_s: f64) -> Vec<Differences> {
        let mut out = Vec::new();
        for k in 0..150 {
            let t = f64::from(k);
            // Two passes at different sides, as one straight line spans the vertical badly.
            let source_m =
                if k % 2 == 0 { [150.0, -600.0 + 8.0 * t, 163.0] } else { [-600.0 + 8.0 * t, -90.0, 163.0] };
            let mut tdoa_s = [0.0; 6];
            for (p, (x, (i, j))) in tdoa_s.iter_mut().zip(PAIRS).enumerate() {
                let d = |n: usize| towards(&source_m, TRUE.get(n)).0;
                *x = (d(j) - d(i)) / 1484.0 + noise_s * (1.7 * t + 2.3 * p as f64 * t).sin();
            }
            if k % 12 == 5 {
                tdoa_s[2] += 4e-4;
            }
            if k % 10 == 1 {
                tdoa_s[4] = f64::NAN;
            }
            out.push(Differences { source_m, tdoa_s });
        }
        out
    }

    #[test]
    fn displaced_hydrophones_are_put_right() {
        let mut configured = TRUE;
        configured[1][0] += 0.05;
        configured[3][2] -= 0.08;
        configured[2][1] += 0.03;
        let found = hydrophones(&passes(2e-6), &configured, 1484.0).unwrap();
        // Positions are known but for the common displacement, which stays the configured one's.
        for axis in 0..3 {
            let shift: f64 = (0..4).map(|i| (configured[i][axis] - TRUE[i][axis]) / 4.0).sum();
            for i in 0..4 {
                let error = found.position_m[i][axis] - TRUE[i][axis] - shift;
                assert!(
                    error.abs() < 0.005 && error.abs() < 5.0 * found.sd_m[i][axis],
                    "{i} {axis} {error} {found:?}"
                );
            }
        }
    }

    #[test]
    fn one_direction_does_not_give_positions() {
        let one = [passes(0.0)[0]; 40];
        assert_eq!(hydrophones(&one, &TRUE, 1484.0), Err(OrientError::NotObservable));
    }
}
