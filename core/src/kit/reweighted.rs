//! Undamped Gauss-Newton rounds, for nearly linear problems whose weights change with the estimate (iteratively reweighted
//! least squares).
//!
//! In: a function that gives the normal equations of a round at a place, and one that takes a step and says whether another
//! round is worth it. Out: the last place and the inverse of the last information, the covariance for unit weights. Where
//! the problem bends so much that a full step can raise the cost, [`super::descent`] is the one to take.

use super::normal::Normal;
use super::spd::{self, Square};

/// Up to `rounds` rounds from a start; `None` where the equations of one determine no step, or there is no round.
pub fn reweighted<P, const N: usize>(
    mut place: P,
    rounds: usize,
    mut equations: impl FnMut(usize, &P) -> Option<Normal<N>>,
    mut advance: impl FnMut(usize, &mut P, &[f64; N]) -> bool,
) -> Option<(P, Square<N>)> {
    let mut inverse = None;
    for round in 0..rounds {
        let normal = equations(round, &place)?;
        let inverse = inverse.insert(spd::inverse(&normal.information(&[true; N]))?);
        let step =
            core::array::from_fn(|i| inverse.get(i).map_or(0.0, |row| spd::dot(row, &normal.gradient)));
        if !advance(round, &mut place, &step) {
            break;
        }
    }
    Some((place, inverse?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::Tukey;

    #[test]
    fn a_wrong_measurement_loses_its_weight_and_the_rounds_end() {
        let values = [2.0, 2.1, 1.9, 2.05, 1.95, 40.0];
        let mut rounds = 1;
        let (mean, inverse) = reweighted(
            2.5,
            50,
            |_, at| {
                let mut normal = Normal::<1>::default();
                for y in values {
                    normal.observe(&[1.0], y - at, Tukey::EFFICIENT.weight((y - at) / 0.2));
                }
                Some(normal)
            },
            |round, at, step| {
                rounds = round;
                *at += step[0];
                step[0].abs() > 1e-12
            },
        )
        .unwrap();
        assert!((mean - 2.0).abs() < 1e-9 && rounds < 50, "{mean} {rounds}");
        assert!((0.2..0.25).contains(&inverse[0][0]));
        let nothing = reweighted(0.0, 5, |_, _| Some(Normal::<1>::default()), |_, _, _| true);
        assert_eq!(nothing, None);
    }
}
