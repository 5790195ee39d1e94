//! Whether the arrays contradict each other, and which of them is to blame.
//!
//! *Explanations* are weighed against each other by what they leave of the excess: that nothing is wrong; that the
//! orientation of one array is, or its clock, or both, free of what was assumed of them, at a price for each. (Of two arrays the
//! clocks tell only their difference: either may be the one.) If the best is that nothing is wrong, and it agrees, all is
//! well. One array is blamed if its explanations agree and no other array's is nearly as good. Else an array is set aside, if
//! without it the others agree, and without it alone. Else nobody is blamed, and the arrays are said to contradict each
//! other: each error that would explain it is then taken to be as likely as large as it would have to be, so that what is
//! stated holds whichever of them is the cause.

use super::Wrong;
use super::problem::Problem;
use super::scatter::Courses;
use crate::math::f64 as m;
use crate::network::MAX_ARRAYS;
use crate::network::locate::misfit_limit;

/// Orientation and clock of which nothing is assumed: standard deviations, radians and seconds.
const OPEN: (f64, f64) = (1.0, 100.0);
/// By how much one explanation must be better than another: odds of 20 to 1.
const CLEAR: f64 = 6.0;
/// Price of an error beyond what was assumed: chi-squared of one degree at 99.7 %, so that of some three that there may be
/// one consistent set in a hundred is taken for contradictory.
const PRICE: f64 = 8.8;
/// Most explanations: orientation, clock and both of each array.
const MOST: usize = 3 * MAX_ARRAYS;

/// What came of it.
pub(super) struct Verdict<'a> {
    /// What is assumed now.
    pub problem: Problem<'a>,
    /// The likeliest state under it.
    pub state: [f64; 4],
    pub wrong: Wrong,
    pub rejected: Option<usize>,
    pub consistent: bool,
    /// What a contradiction that nothing explains makes of the covariance; one where there is none.
    pub growth: f64,
}

/// An explanation with what it leaves.
#[derive(Clone, Copy)]
struct Explanation<'a> {
    wrong: Wrong,
    problem: Problem<'a>,
    state: [f64; 4],
    excess: f64,
    freedom: u32,
}

type Explanations<'a> = heapless::Vec<Explanation<'a>, MOST>;

impl<'a> Explanation<'a> {
    /// That this is wrong with the arrays of a problem; `near`: a state.
    fn new(problem: &Problem<'a>, wrong: Wrong, courses: &Courses, near: &[f64; 4]) -> Option<Self> {
        let mut problem = *problem;
        if let Some(of) = wrong.orientation.and_then(|k| problem.shared.get_mut(k)) {
            of.azimuth = OPEN.0;
        }
        if let Some(of) = wrong.clock.and_then(|k| problem.shared.get_mut(k)) {
            of.clock_s = OPEN.1;
        }
        let state = problem.minimum_from(*near)?;
        let (excess, freedom) = courses.excess(&problem, problem.misfit(&state));
        Some(Self { wrong, problem, state, excess, freedom: freedom.saturating_sub(wrong.count()) })
    }

    fn agrees(&self) -> bool {
        self.freedom == 0 || self.excess <= misfit_limit(self.freedom)
    }

    fn cost(&self) -> f64 {
        self.excess + PRICE * f64::from(self.wrong.count())
    }

    fn verdict(&self, rejected: Option<usize>) -> Verdict<'a> {
        let Self { wrong, problem, state, .. } = *self;
        Verdict { problem, state, wrong, rejected, consistent: true, growth: 1.0 }
    }
}

/// Judges arrays whose deviations are measured; `near`: a state.
pub(super) fn judge<'a>(
    problem: Problem<'a>,
    courses: &Courses,
    near: &[f64; 4],
    robust: bool,
) -> Option<Verdict<'a>> {
    let none = Explanation::new(&problem, Wrong::default(), courses, near)?;
    if none.freedom == 0 {
        return Some(none.verdict(None));
    }
    let mut others = explanations(&none, courses);
    others.sort_unstable_by(|a, b| a.cost().total_cmp(&b.cost()));
    let least = others.first().map_or(f64::INFINITY, Explanation::cost);
    if none.agrees() && none.excess <= least {
        return Some(none.verdict(None));
    }
    others.retain(|e| e.agrees() && e.cost() < least + CLEAR);
    if let Some(found) = blamed(&problem, &others) {
        return Some(found);
    }
    if robust && let Some(found) = culprit(&none, courses) {
        return Some(found);
    }
    let mut said = opened(&problem, none.state, &others)?;
    if others.is_empty() {
        said.growth = none.excess / f64::from(none.freedom);
    }
    Some(Verdict { consistent: false, ..said })
}

/// Every explanation but that nothing is wrong.
fn explanations<'a>(none: &Explanation<'a>, courses: &Courses) -> Explanations<'a> {
    let two = none.problem.arrays().count() == 2;
    let last = none.problem.arrays().last();
    let mut out = Explanations::new();
    for k in none.problem.arrays() {
        // The difference of two clocks is put on the second.
        let clock = if two { last } else { Some(k) };
        let only_clock = Wrong { orientation: None, clock: clock.filter(|c| *c == k) };
        let orientation = Wrong { orientation: Some(k), clock: None };
        for wrong in [orientation, only_clock, Wrong { clock, ..orientation }] {
            if wrong.count() > 0
                && let Some(found) = Explanation::new(&none.problem, wrong, courses, &none.state)
                && out.push(found).is_err()
            {
                break;
            }
        }
    }
    out
}

/// The verdict on one array, where no other is as likely the cause: `plausible` explanations, the best first.
fn blamed<'a>(problem: &Problem<'a>, plausible: &[Explanation<'a>]) -> Option<Verdict<'a>> {
    let best = plausible.first()?;
    let two = problem.arrays().count() == 2;
    // The clock of two arrays is neither's.
    let array = |e: &Explanation<'_>| e.wrong.orientation.or(e.wrong.clock.filter(|_| !two));
    let alone = plausible.iter().all(|e| array(e) == array(best));
    // What any errors would explain shows nothing.
    if !alone || best.freedom == 0 {
        return None;
    }
    let verdict = opened(problem, best.state, plausible)?;
    Some(Verdict { wrong: best.wrong, ..verdict })
}

/// The verdict on what agrees without one array, and without it alone; at least two others are needed.
fn culprit<'a>(none: &Explanation<'a>, courses: &Courses) -> Option<Verdict<'a>> {
    let without = |k: usize| {
        let rest = Problem { used: none.problem.used & !(1 << k), ..none.problem };
        let found = Explanation::new(&rest, Wrong::default(), courses, &rest.minimum()?)?;
        (found.freedom > 0 && found.agrees()).then(|| found.verdict(Some(k)))
    };
    if none.problem.arrays().count() < 3 {
        return None;
    }
    let mut agreeing = none.problem.arrays().filter_map(without);
    agreeing.next().filter(|_| agreeing.next().is_none())
}

/// With every error of the explanations as large as it would have to be.
fn opened<'a>(
    problem: &Problem<'a>,
    near: [f64; 4],
    explanations: &[Explanation<'a>],
) -> Option<Verdict<'a>> {
    let mut problem = *problem;
    let before = problem.shared;
    let two = problem.arrays().count() == 2;
    for e in explanations {
        let found = |k: usize| e.problem.likeliest(k, &e.state);
        if let Some(k) = e.wrong.orientation {
            let sd = &mut problem.shared[k].azimuth;
            *sd = sd.max(m::hypot(before[k].azimuth, found(k)[0]));
        }
        if let Some(k) = e.wrong.clock {
            let late_s = found(k)[1];
            for j in problem.arrays().filter(|j| two || *j == k) {
                let sd_s = &mut problem.shared[j].clock_s;
                *sd_s = sd_s.max(m::hypot(before[j].clock_s, late_s));
            }
        }
    }
    let state = problem.minimum_from(near)?;
    let wrong = Wrong::default();
    Some(Verdict { problem, state, wrong, rejected: None, consistent: true, growth: 1.0 })
}
