//! Whether a straight course is bent: what all arrays show alike beyond it.
//!
//! In: each array's bearings and its own straight course. Out: the bend `b₂ u² + b₃ u³` of the vessel's way, `u` from −1 to 1 over the
//! record, the same for all arrays; how sure it is, and how far what is stated of a straight course is off by it. A bend is judged by
//! what bearings are left about a course that is bent: how large these errors are, and how much successive ones have in common
//! ([`super::scatter`]), whatever was stated of them. Errors told to last count as long as they were told.
//!
//! Not seen: turns there and back within the record, which go in runs (`runs`).

use super::HUBER;
use super::problem::{Problem, Row};
use super::scatter::{FITTED, LEAST_SCATTER, spread};
use crate::kit::spd::{self, Square};
use crate::kit::{MAD_TO_SD, Normal, order_statistic};
use crate::math::f64 as m;
use crate::network::locate::misfit_limit;

/// Fewest bearings of an array.
const LEAST: usize = 40;
/// Rounds in which single wrong bearings lose their weight.
const ROUNDS: usize = 3;
/// Where a parameter is not observable, it stays.
const HELD: f64 = 1e-9;
/// Excess over chi-squared of four degrees at 99.9 %: what successive errors have in common is itself known from few of them.
const SURE: f64 = 1.5;
/// Its least share of all squares: less may be errors that last for the whole record, which nothing tells from a bend (of the medium, of an
/// array's geometry). Four tenths of the scatter, root mean square, are left to them.
const SHARE: f64 = 0.15;
/// 95 % of chi-squared of two degrees: how far off what is stated may be by a bend.
const STATED_95: f64 = 5.991;

/// What arrays show, summed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bends {
    normal: Normal<4>,
    /// Sum of squares about the straight courses, in the same variances.
    squares: f64,
    half_s: f64,
    alike: [f64; crate::network::MAX_ARRAYS],
}

/// A bend, metres at the end of the record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bend {
    at: [f64; 4],
    half_s: f64,
}

fn wide(row: &Row, half_s: f64) -> [f64; 8] {
    let [x, y, vx, vy] = row.by_state;
    let u = row.after_s / half_s;
    let (two, three) = (u * u, u * u * u);
    [x, y, vx / half_s, vy / half_s, x * two, y * two, x * three, y * three]
}

impl Bends {
    /// None yet, of the arrays of a problem.
    pub fn new(problem: &Problem<'_>) -> Self {
        let half_s = problem.used().map(|b| m::abs(b.t_s - problem.t_ref_s)).fold(1.0, f64::max);
        Self { normal: Normal::default(), squares: 0.0, half_s, alike: problem.settings.alike }
    }

    /// Takes the bearings of an array, whose own straight course this is.
    pub fn take(&mut self, alone: &Problem<'_>, array: usize, course: &[f64; 4]) {
        let half_s = self.half_s;
        let rows = || alone.rows(array, course, [0.0; 2]).map(move |row| (row, wide(&row, half_s)));
        if alone.used().count() < LEAST {
            return;
        }
        let elevations = rows().any(|(row, _)| row.angle == 1);
        // Two more parameters of each angle; all four of azimuths alone.
        let more = if elevations { 2.0 } else { 4.0 };
        let mut at = [0.0; 8];
        // As stated; then as the bearings show about that.
        let mut sd = [1.0; 2];
        for round in 0..ROUNDS {
            if round == 1 {
                for (angle, sd) in sd.iter_mut().enumerate() {
                    let off = rows().filter(|(row, _)| row.angle == angle);
                    let off = off.map(|(row, by)| m::abs(row.residual - spd::dot(&by, &at)));
                    *sd = (MAD_TO_SD * order_statistic(off, 0.5).unwrap_or(1.0)).max(LEAST_SCATTER);
                }
            }
            let mut normal = Normal::<8>::default();
            for (row, by) in rows() {
                let weight = HUBER.weight((row.residual - spd::dot(&by, &at)) / sd[row.angle]);
                normal.observe(&by, row.residual, weight / (sd[row.angle] * sd[row.angle]));
            }
            let Some(found) = normal.step(&[true; 8], HELD) else { return };
            at = found;
        }
        let mut variance = [f64::INFINITY; 2];
        for (angle, variance) in variance.iter_mut().enumerate() {
            let off = rows().filter(move |(row, _)| row.angle == angle);
            let off = off.map(move |(row, by)| row.residual - spd::dot(&by, &at));
            if let Some((own, common)) = spread(off, FITTED[angle] + more) {
                *variance = own * common.max(2.0 * self.alike[array] - 1.0);
            }
        }
        let mut normal = Normal::<8>::default();
        for (row, by) in rows() {
            let weight = HUBER.weight((row.residual - spd::dot(&by, &at)) / sd[row.angle]);
            normal.observe(&by, row.residual, weight / variance[row.angle]);
        }
        if let Some(of_bend) = without_course(&normal) {
            self.normal.join(&of_bend);
            self.squares += normal.cost();
        }
    }

    /// The bend, where there is one beyond all chance.
    pub fn found(&self) -> Option<Bend> {
        let at = self.normal.solution()?;
        let fall = self.normal.fall(&at);
        (fall > SURE * misfit_limit(4) && fall > SHARE * self.squares)
            .then_some(Bend { at, half_s: self.half_s })
    }
}

/// Normal equations of the bend alone, the course at its likeliest.
fn without_course(both: &Normal<8>) -> Option<Normal<4>> {
    let (h, g) = (both.information(&[true; 8]), both.gradient);
    let mut of_course: Square<4> = core::array::from_fn(|i| core::array::from_fn(|j| h[i][j]));
    of_course.iter_mut().enumerate().for_each(|(i, row)| row[i] *= 1.0 + HELD);
    let left = spd::inverse(&of_course)?;
    let mut out = Normal::default();
    for i in 0..4 {
        let share = spd::times(&left, &core::array::from_fn(|j| h[i + 4][j]));
        out.gradient[i] = g[i + 4] - (0..4).map(|j| share[j] * g[j]).sum::<f64>();
        for k in i..4 {
            out.upper[i][k] = h[i + 4][k + 4] - (0..4).map(|j| share[j] * h[j][k + 4]).sum::<f64>();
        }
    }
    Some(out)
}

impl Bend {
    /// By how much the covariance of a straight course must grow to hold its places and velocities at both ends and in the middle;
    /// `None` where it holds them.
    pub fn beyond(&self, covariance: &Square<4>) -> Option<f64> {
        let [ax, ay, bx, by] = self.at;
        // The straight line through u² is 1/3, that through u³ is 3/5 u.
        let place = |u: f64| {
            let (two, three) = (u * u - 1.0 / 3.0, u * u * u - 0.6 * u);
            [ax * two + bx * three, ay * two + by * three]
        };
        let velocity = |u: f64| {
            let (two, three) = (2.0 * u, 3.0 * u * u - 0.6);
            [ax * two + bx * three, ay * two + by * three].map(|x| x / self.half_s)
        };
        let off = |u: f64| {
            let dt = u * self.half_s;
            let at = [[1.0, 0.0, dt, 0.0], [0.0, 1.0, 0.0, dt]];
            let on = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
            let squares =
                |d: [f64; 2], c: Square<2>| spd::solve(&c, &d).map_or(f64::INFINITY, |x| spd::dot(&d, &x));
            f64::max(
                squares(place(u), spd::propagated(&at, covariance)),
                squares(velocity(u), spd::propagated(&on, covariance)),
            )
        };
        let most = [-1.0, 0.0, 1.0].into_iter().map(off).fold(0.0, f64::max);
        (most > STATED_95).then_some(0.5 * most)
    }
}
