//! The likelihood of a straight motion under one set of assumptions, its maximum, and the information at a state.

use super::{DatedSighting, HUBER, JointSettings, Offset, SharedError};
use crate::angle::wrap_pi;
use crate::kit::normal::least_squares;
use crate::kit::spd::{self, Square};
use crate::kit::{Normal, minimise};
use crate::math::f64 as m;
use crate::network::MAX_ARRAYS;
use crate::network::model::{self, Sighting, bearing, gradients};

/// Most damped steps; convergence takes about ten.
const STEPS: usize = 100;
/// Fall of the cost that is not worth a step.
const LEAST_FALL: f64 = 1e-11;
/// Steps to the likeliest shared errors.
const SHARED_STEPS: usize = 5;
/// Square of a step, in variances of what is shared, after which there is no need of another.
const SHARED_SMALL: f64 = 1e-10;

/// Most that averaging over a state's own uncertainty may widen the variance of its place.
const MOST_WIDENED: f64 = 4.0;

/// Bearings and what is assumed of them.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub bearings: &'a [DatedSighting],
    pub settings: &'a JointSettings,
    /// Mean time of the bearings that count, seconds.
    pub t_ref_s: f64,
    /// Arrays whose bearings count, a bit each.
    pub used: u16,
    /// What each array's bearings share.
    pub shared: [SharedError; MAX_ARRAYS],
    /// What the stated deviations of each array's azimuths and elevations are multiplied by.
    pub scale: [[f64; 2]; MAX_ARRAYS],
}

/// One standardised angle: derivatives by state and by what its array shares, and the residual.
#[derive(Clone, Copy)]
pub(super) struct Row {
    pub by_state: [f64; 4],
    pub by_shared: [f64; 2],
    pub residual: f64,
    /// When the sound left the vessel, from the reference time on, seconds.
    pub after_s: f64,
    /// 0 an azimuth, 1 an elevation.
    pub angle: usize,
}

fn unit<const N: usize>(k: usize) -> [f64; N] {
    let mut out = [0.0; N];
    out[k] = 1.0;
    out
}

/// Normal equations of the state alone, the last two parameters taking their likeliest values: Schur's complement.
fn eliminated(both: &Normal<6>) -> Normal<4> {
    let (h, g) = (both.information(&[true; 6]), both.gradient);
    let mut out = Normal::default();
    out.observe_at_cost(&[0.0; 4], 0.0, 0.0, both.cost());
    let left = spd::inverse(&of_shared(&h)).unwrap_or_default();
    for i in 0..4 {
        let share = spd::times(&left, &[h[i][4], h[i][5]]);
        out.gradient[i] = g[i] - spd::dot(&share, &[g[4], g[5]]);
        for j in i..4 {
            out.upper[i][j] = h[i][j] - spd::dot(&share, &[h[j][4], h[j][5]]);
        }
    }
    out
}

fn of_shared(h: &Square<6>) -> Square<2> {
    [[h[4][4], h[4][5]], [h[5][4], h[5][5]]]
}

impl<'a> Problem<'a> {
    /// As the settings have it, of some of the arrays.
    pub fn new(bearings: &'a [DatedSighting], settings: &'a JointSettings, used: u16) -> Self {
        let shared = settings.shared;
        Self { bearings, settings, t_ref_s: 0.0, used, shared, scale: [[1.0; 2]; MAX_ARRAYS] }.of_arrays(used)
    }

    /// The same with the bearings of these arrays.
    pub fn of_arrays(mut self, used: u16) -> Self {
        self.used = used;
        let n = self.used().count().max(1) as f64;
        self.t_ref_s = self.used().map(|b| b.t_s).sum::<f64>() / n;
        self
    }

    /// Arrays whose bearings count.
    pub fn arrays(&self) -> impl Iterator<Item = usize> + Clone + use<> {
        let used = self.used;
        (0..MAX_ARRAYS).filter(move |k| used >> k & 1 == 1)
    }

    /// Bearings that count.
    pub fn used(&self) -> impl Iterator<Item = &'a DatedSighting> + Clone + use<'a> {
        let (bearings, used) = (self.bearings, self.used);
        bearings.iter().filter(move |b| used >> b.array & 1 == 1)
    }

    /// Angles measured.
    pub fn angles(&self) -> u32 {
        self.used().map(|b| 1 + u32::from(b.sighting.elevation.is_some())).sum()
    }

    /// The likeliest state.
    pub fn minimum(&self) -> Option<[f64; 4]> {
        let start = [self.start_of_lines(), self.start_of_elevations()]
            .into_iter()
            .flatten()
            .map(|s| (self.normal(&s).cost(), s))
            .filter(|(c, _)| c.is_finite())
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        self.minimum_from(start.1)
    }

    /// The same near a state.
    pub fn minimum_from(&self, state: [f64; 4]) -> Option<[f64; 4]> {
        let moved = |state: &[f64; 4], step: &[f64; 4]| {
            let mut to = *state;
            to.iter_mut().zip(step).for_each(|(x, s)| *x += s);
            to
        };
        let evaluate = |state: &[f64; 4]| Some(self.normal(state));
        minimise(state, &[true; 4], STEPS, LEAST_FALL, moved, evaluate).map(|end| end.at)
    }

    /// Inverse of the information at a state.
    pub fn covariance(&self, state: &[f64; 4]) -> Option<Square<4>> {
        spd::inverse(&self.normal(state).information(&[true; 4]))
    }

    fn place(&self, t_s: f64, state: &[f64; 4]) -> [f64; 3] {
        let [x, y, vx, vy] = *state;
        let dt = t_s - self.t_ref_s;
        [x + vx * dt, y + vy * dt, self.settings.z_m]
    }

    fn distance(&self, s: &Sighting, t_s: f64, state: &[f64; 4]) -> f64 {
        let [x, y, z] = model::difference(&self.place(t_s, state), &s.array_m);
        m::sqrt(x * x + y * y + z * z)
    }

    /// Mean distance of the arrays from the vessel at the times of their bearings, metres.
    pub fn mean_distance(&self, state: &[f64; 4]) -> f64 {
        let n = self.used().count().max(1) as f64;
        self.used().map(|b| self.distance(&b.sighting, b.t_s, state)).sum::<f64>() / n
    }

    /// When the sound of a bearing that came at a time left the vessel: two rounds suffice, a vessel is far slower than sound.
    fn emission(&self, s: &Sighting, t_s: f64, state: &[f64; 4]) -> f64 {
        let c = self.settings.sound_speed_m_s;
        let first = t_s - self.distance(s, t_s, state) / c;
        t_s - self.distance(s, first, state) / c
    }

    /// Misfit of all arrays, each with the shared errors that fit it best.
    pub fn misfit(&self, state: &[f64; 4]) -> f64 {
        let of = |array: usize| {
            let at = self.likeliest(array, state);
            let square = |r: f64| HUBER.clipped(r) * HUBER.clipped(r);
            let rows = self.rows(array, state, at).map(|row| square(row.residual)).sum::<f64>();
            let prior = self.shared_variances(array).into_iter().zip(at).filter(|(v, _)| *v > 0.0);
            rows + prior.map(|(v, x)| x * x / v).sum::<f64>()
        };
        self.arrays().map(of).sum()
    }

    fn shared_variances(&self, array: usize) -> [f64; 2] {
        self.shared.get(array).map_or([0.0; 2], SharedError::variances)
    }

    /// Every angle of an array, standardised, its azimuths turned and its clock late by so much.
    pub fn rows(
        &self,
        array: usize,
        state: &[f64; 4],
        [turned, late_s]: [f64; 2],
    ) -> impl Iterator<Item = Row> + Clone {
        let [scale_azimuth, scale_elevation] = self.scale.get(array).copied().unwrap_or([1.0; 2]);
        let (problem, state) = (*self, *state);
        self.used().filter(move |b| b.array == array).flat_map(move |b| {
            let s = &b.sighting;
            let t = problem.emission(s, b.t_s - late_s, &state);
            let dt = t - problem.t_ref_s;
            let place = problem.place(t, &state);
            let (azimuth, elevation) = bearing(&s.array_m, &place);
            let (ga, gb) = gradients(&s.array_m, &place);
            let row = |[x, y, _]: [f64; 3], residual: f64, sd: f64, angle: usize| Row {
                by_state: [x, y, x * dt, y * dt].map(|d| d / sd),
                // A clock that is late stamps what it hears with a later time.
                by_shared: [1.0 - angle as f64, -(x * state[2] + y * state[3])].map(|d| d / sd),
                residual: residual / sd,
                after_s: dt,
                angle,
            };
            let off = wrap_pi(s.azimuth - turned - azimuth);
            let of_azimuth = row(ga, off, scale_azimuth * s.sd_azimuth, 0);
            let of_elevation =
                s.elevation.map(|e| row(gb, e - elevation, scale_elevation * s.sd_elevation, 1));
            [Some(of_azimuth), of_elevation].into_iter().flatten()
        })
    }

    /// The shared errors of an array that are likeliest for a state.
    pub fn likeliest(&self, array: usize, state: &[f64; 4]) -> [f64; 2] {
        let variances = self.shared_variances(array);
        let free = variances.map(|v| v > 0.0);
        let mut at = [0.0; 2];
        if free == [false; 2] {
            return at;
        }
        for _ in 0..SHARED_STEPS {
            let mut normal = Normal::<2>::default();
            for row in self.rows(array, state, at) {
                normal.observe(&row.by_shared, row.residual, HUBER.weight(row.residual));
            }
            for (k, v) in variances.into_iter().enumerate().filter(|(_, v)| *v > 0.0) {
                normal.observe(&unit(k), -at[k], 1.0 / v);
            }
            let Some(step) = normal.step(&free, 0.0) else { break };
            at.iter_mut().zip(step).for_each(|(x, s)| *x += s);
            if step.iter().zip(variances).all(|(s, v)| s * s <= SHARED_SMALL * v) {
                break;
            }
        }
        at
    }

    /// Normal equations of the robust likelihood of one array, of the state and what it shares.
    fn of_array(&self, array: usize, state: &[f64; 4], at: [f64; 2]) -> Normal<6> {
        let mut normal = Normal::<6>::default();
        for row in self.rows(array, state, at) {
            let r = row.residual;
            let ([a, b, c, d], [e, f]) = (row.by_state, row.by_shared);
            normal.observe_at_cost(&[a, b, c, d, e, f], r, HUBER.weight(r), 2.0 * HUBER.loss(r));
        }
        for (k, v) in self.shared_variances(array).into_iter().enumerate() {
            if v > 0.0 {
                normal.observe(&unit(4 + k), -at[k], 1.0 / v);
            } else {
                normal.hold(4 + k);
            }
        }
        normal
    }

    /// Normal equations of the robust likelihood, shared errors eliminated.
    pub fn normal(&self, state: &[f64; 4]) -> Normal<4> {
        let mut all = Normal::default();
        for array in self.arrays() {
            let at = self.likeliest(array, state);
            all.join(&eliminated(&self.of_array(array, state, at)));
        }
        all
    }

    /// The covariance of a state, averaged over the state's own uncertainty: a turn of the whole scene that is hardly known bends
    /// what is known of it. `least` is that of the state alone, and is kept where the mean is that of other places.
    pub fn averaged(&self, state: &[f64; 4], least: &Square<4>) -> Square<4> {
        let Some(factor) = spd::Factor::new(least) else { return *least };
        let mut mean = [[0.0; 4]; 4];
        for column in 0..4 {
            // Columns of the factor times √n: the eight states have the covariance itself.
            for sign in [2.0, -2.0] {
                let mut to = *state;
                to.iter_mut().zip(&factor.lower).for_each(|(x, row)| *x += sign * row[column]);
                let Some(c) = self.covariance(&to) else { return *least };
                for (sum, add) in mean.iter_mut().flatten().zip(c.iter().flatten()) {
                    *sum += add / 8.0;
                }
            }
        }
        let of_place = |c: &Square<4>| spd::largest_eigenvalue(&[[c[0][0], c[0][1]], [c[1][0], c[1][1]]]);
        if of_place(&mean) <= MOST_WIDENED * of_place(least) { mean } else { *least }
    }

    /// What each array shares at a state of this covariance; `growth`: of the arrays' own variances; `clock_of`: whose clock the others'
    /// are told against.
    pub fn offsets(
        &self,
        state: &[f64; 4],
        covariance: &Square<4>,
        growth: f64,
        clock_of: usize,
    ) -> [Offset; MAX_ARRAYS] {
        let mut out = [Offset::default(); MAX_ARRAYS];
        // Of that one, which comes first: how late its clock is, the variance of that, and what it follows the state by.
        let mut first: Option<(f64, f64, [f64; 4])> = None;
        for array in core::iter::once(clock_of).chain(self.arrays().filter(|k| *k != clock_of)) {
            let at = self.likeliest(array, state);
            let h = self.of_array(array, state, at).information(&[true; 6]);
            let free = self.shared_variances(array).map(|v| if v > 0.0 { growth } else { 0.0 });
            let left = spd::inverse(&of_shared(&h)).unwrap_or_default();
            let pulls = left.map(|row| {
                let mut pull = [0.0; 4];
                for (p, h) in pull.iter_mut().zip(&h) {
                    *p = spd::dot(&row, &[h[4], h[5]]);
                }
                pull
            });
            let of_state = |pull: &[f64; 4]| spd::quadratic(pull, covariance, pull);
            let sd_turned = m::sqrt(free[0] * left[0][0] + of_state(&pulls[0]));
            let own = free[1] * left[1][1];
            let clock_s = match first {
                None => {
                    first = Some((at[1], own, pulls[1]));
                    (0.0, 0.0)
                }
                Some((late_s, variance, pull)) => {
                    let mut apart = pulls[1];
                    apart.iter_mut().zip(&pull).for_each(|(a, p)| *a -= p);
                    (at[1] - late_s, m::sqrt(own + variance + of_state(&apart)))
                }
            };
            out[array] = Offset { azimuth: (at[0], sd_turned), clock_s };
        }
        out
    }

    /// Linear start from the bearing lines.
    fn start_of_lines(&self) -> Option<[f64; 4]> {
        let rows = self.used().map(|b| {
            let (sa, ca) = m::sin_cos(b.sighting.azimuth);
            let [x, y, _] = b.sighting.array_m;
            let dt = b.t_s - self.t_ref_s;
            ([ca, -sa, ca * dt, -sa * dt], x * ca - y * sa)
        });
        least_squares(rows)
    }

    /// Linear start from positions by azimuth, elevation and the known height.
    fn start_of_elevations(&self) -> Option<[f64; 4]> {
        let rows = self.used().flat_map(|b| {
            let s = &b.sighting;
            let [x, y, z] = s.array_m;
            let dt = b.t_s - self.t_ref_s;
            let (sa, ca) = m::sin_cos(s.azimuth);
            let d = s.elevation.map_or(0.0, |e| (self.settings.z_m - z) / m::tan(e));
            // Ranges from shallow elevations are worthless and would dominate squares: weight by 1/d.
            let w = if d > 0.0 && d.is_finite() { 1.0 / (1.0 + d) } else { 0.0 };
            [
                ([w, 0.0, w * dt, 0.0], w * (x + if w > 0.0 { d * sa } else { 0.0 })),
                ([0.0, w, 0.0, w * dt], w * (y + if w > 0.0 { d * ca } else { 0.0 })),
            ]
        });
        least_squares(rows)
    }
}
