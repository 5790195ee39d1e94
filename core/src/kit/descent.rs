//! Levenberg-Marquardt: damped Gauss-Newton steps that never raise the cost.
//!
//! In: a function that gives the normal equations at a place, and one that moves a place by a step and brings it back
//! inside its limits. Out: a place from which no damping lowers the cost. Cost: one evaluation a step, more where the
//! linear model does not hold.

use super::normal::Normal;

/// Largest damping tried before a descent counts as finished.
const DAMPING_MAX: f64 = 1e8;
/// Damping with which a descent that is taken up again begins.
const DAMPING_FRESH: f64 = 1e-3;

/// Fall of the cost that is not worth an evaluation for a statistician: a ten-thousandth of a standard deviation in every
/// parameter.
pub const LEAST_FALL: f64 = 1e-8;

/// A place of the descent.
#[derive(Clone, Copy, Debug)]
pub struct Point<P, const N: usize> {
    /// Where.
    pub at: P,
    /// Normal equations there.
    pub normal: Normal<N>,
    /// Damping that last worked.
    pub damping: f64,
}

/// What a call of [`Point::descend`] came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Cost went down; another step may help.
    Moved,
    /// The cost fell by less than ten times the least fall, would fall by less than the least, or no damping lowers it.
    Converged,
}

impl<P, const N: usize> Point<P, N> {
    /// One damped Gauss-Newton step of the free parameters: `moved` gives the place a step leads to, `evaluate` the
    /// normal equations there (`None` where there are none). `least_fall`: fall of the cost that is not worth a step.
    pub fn descend(
        &mut self,
        free: &[bool; N],
        least_fall: f64,
        moved: impl Fn(&P, &[f64; N]) -> P,
        mut evaluate: impl FnMut(&P) -> Option<Normal<N>>,
    ) -> Progress {
        let cost = self.normal.cost();
        while self.damping < DAMPING_MAX {
            if let Some(step) = self.normal.step(free, self.damping) {
                if self.normal.fall(&step) < least_fall {
                    break;
                }
                let at = moved(&self.at, &step);
                if let Some(normal) = evaluate(&at).filter(|n| n.is_finite() && n.cost() <= cost) {
                    let fall = cost - normal.cost();
                    *self = Self { at, normal, damping: (self.damping * 0.1).max(1e-9) };
                    return if fall < 10.0 * least_fall { Progress::Converged } else { Progress::Moved };
                }
            }
            self.damping = (self.damping * 10.0).max(1e-6);
        }
        self.damping = DAMPING_FRESH;
        Progress::Converged
    }
}

/// Up to `steps` steps of [`Point::descend`] from a start; `None` where the start has no normal equations.
pub fn minimise<P, const N: usize>(
    start: P,
    free: &[bool; N],
    steps: usize,
    least_fall: f64,
    moved: impl Fn(&P, &[f64; N]) -> P,
    mut evaluate: impl FnMut(&P) -> Option<Normal<N>>,
) -> Option<Point<P, N>> {
    let normal = evaluate(&start)?;
    let mut point = Point { at: start, normal, damping: DAMPING_FRESH };
    for _ in 0..steps {
        if point.descend(free, least_fall, &moved, &mut evaluate) == Progress::Converged {
            break;
        }
    }
    Some(point)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plus(at: &[f64; 2], step: &[f64; 2]) -> [f64; 2] {
        [at[0] + step[0], at[1] + step[1]]
    }

    /// Rosenbrock's valley as least squares: residuals `1 − x` and `10 (y − x²)`, minimum at (1, 1).
    fn valley(at: &[f64; 2]) -> Option<Normal<2>> {
        let [x, y] = *at;
        let mut normal = Normal::default();
        normal.observe(&[1.0, 0.0], 1.0 - x, 1.0);
        normal.observe(&[-20.0 * x, 10.0], 10.0 * (x * x - y), 1.0);
        Some(normal)
    }

    proptest! {
        #![proptest_config(seabearing_testkit::property(64))]

        #[test]
        fn a_bent_valley_is_followed_to_its_end(x in -3.0f64..3.0, y in -3.0f64..3.0) {
            let end = minimise([x, y], &[true; 2], 200, 1e-16, plus, valley).unwrap();
            prop_assert!((end.at[0] - 1.0).abs() < 1e-6 && (end.at[1] - 1.0).abs() < 1e-6, "{end:?}");
        }

        #[test]
        fn no_step_raises_the_cost_and_held_parameters_stay(x in -3.0f64..3.0, y in -3.0f64..3.0) {
            let mut point = Point { at: [x, y], normal: valley(&[x, y]).unwrap(), damping: 1e-3 };
            for _ in 0..20 {
                let before = point.normal.cost();
                point.descend(&[false, true], 1e-12, plus, valley);
                prop_assert!(point.normal.cost() <= before && point.at[0] == x);
            }
            prop_assert!((point.at[1] - x * x).abs() < 1e-6);
        }
    }

    #[test]
    fn a_place_without_equations_is_never_entered() {
        let wall = |at: &[f64; 2]| if at[0] > 0.0 { None } else { valley(at) };
        let end = minimise([-1.0, 1.0], &[true; 2], 50, 1e-12, plus, wall).unwrap();
        assert!(end.at[0] <= 0.0 && end.normal.cost() < 4.0);
        assert!(minimise([1.0, 1.0], &[true; 2], 5, 1e-12, plus, wall).is_none());
    }
}
