//! Whether a hydrophone is late throughout a file of measured delays.
//!
//! In: sets of six delays, the array, how far its places and the speed of sound may be off. Out: by how much each hydrophone is
//! late in all sets, with its standard deviation, and which one is.
//!
//! Four arrival times give three differences, which close around every triangle whatever they are, and a vector
//! `v = −c Σ d_k t_k` (`d_k`: dual vectors of the places, `Σ d_k h_kᵀ = 1`): the direction, of length one. Lateness `o` adds
//! `b = −c Σ d_k o_k` to every set's, so that directions that differ lie on a sphere whose centre is b. Places that are wrong and
//! another speed of sound make an ellipsoid of it about the same centre, and the wavefront's curvature bends it: these are
//! estimated beside b, each with what was told of it. What a direction has of its own (multipath, steps of the measurement)
//! is shared by all sets of a cell of directions and does not average out there.
//!
//! Not observable: with directions too few or alike anything, and nothing is said; of directions in one plane what stands across it, so that
//! two hydrophones may be left of which one is late. Fails where places are off by much more than was told.

use super::scatter::{Cells, Scatter};
use nalgebra::{Matrix3, Vector3};
use seabearing_core::block::CHANNELS;
use seabearing_core::geometry::{Geometry, PAIRS};
use seabearing_core::kit::spd::{self, Square};
use seabearing_core::kit::{Huber, Normal, Tukey, reweighted};

/// Unknowns: the centre, the hydrophones' coordinates, the speed of sound, the curvature.
pub(super) const UNKNOWNS: usize = 3 + 3 * CHANNELS + 3;
const PLACES: std::ops::Range<usize> = 3..3 + 3 * CHANNELS;
const SPEED: usize = UNKNOWNS - 3;
/// Of the wavefront: everywhere, and in proportion to the sine of the elevation, as vessels at the surface have it.
const CURVATURE: usize = UNKNOWNS - 2;
const RISING: usize = UNKNOWNS - 1;

/// Standard deviation of a coordinate where none is told, metres, and what one that is told is multiplied by.
const UNTOLD_PLACE_M: f64 = 0.05;
const MARGIN: f64 = 1.5;
/// Standard deviation of the speed of sound at least, as a share of it.
const LEAST_SPEED: f64 = 0.01;
/// That of either part of the wavefront's curvature beside the expected one, 1/m: a vessel 50 m away.
const CURVATURE_PER_M: f64 = 0.02;
/// That of the centre before anything is heard, in units of the sphere's radius.
const CENTRE: f64 = 2.0;
/// Fewest sets.
const LEAST_SETS: usize = 15;
/// Degrees of freedom that must be left to tell the scatter by.
const LEAST_FREEDOM: f64 = 3.0;
/// Standard deviations (of a normal number as rare) beyond which a hydrophone is late.
const SURE: f64 = 6.0;
/// Lateness below this share of the time across the array is not told: 0.3° of direction, positions to a centimetre.
const LEAST_SHARE: f64 = 0.005;
/// What is left of lateness that no number of sets brings down, a standard deviation in units of the time across the array: distances of vessels
/// that the curvature's two parts do not follow.
const LEAST_SD: f64 = 5e-4;
/// A hydrophone alone explains the centre where as much left unexplained has at least this probability, or is at most this share of all squares.
const EXPLAINED: f64 = 1e-3;
const LEFT: f64 = 0.03;
/// Share of the sets that must lie on the surface found.
const LEAST_KEPT: f64 = 0.5;
/// Squared deviations, of all twelve coordinates, beyond which it is the places that are wrong.
const PLACES_WRONG: f64 = 40.0;
/// Distance from a sphere at which the search for a first centre stops to count, and what a centre must gain to be one.
const FAR: f64 = 0.06;
const GAIN: f64 = 0.5;
/// Lateness tried for a first centre, in units of the time across the array: steps, and most.
const TRIED_STEP: f64 = 0.04;
const TRIED: i32 = 50;
/// Rounds in all, and those of Huber's weights.
const ROUNDS: usize = 24;
const ROUGH: usize = 8;

/// One hydrophone that would explain what the sets have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Late {
    /// Which, from 0.
    pub hydrophone: usize,
    /// How late, seconds; negative: early.
    pub late_s: f64,
    /// Its standard deviation, seconds.
    pub sd_s: f64,
}

/// What all sets have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Lateness {
    /// How late each hydrophone is against the mean of the four, seconds.
    pub each_s: [f64; CHANNELS],
    /// Standard deviations of the same, seconds; large where the directions do not tell.
    pub each_sd_s: [f64; CHANNELS],
    /// Each hydrophone as the only one that is late.
    pub alone: [Late; CHANNELS],
    /// Squared deviations that that one leaves unexplained, in units of those of the centre, and the probability of as much.
    pub left: [(f64, f64); CHANNELS],
    /// How sure it is, in standard deviations of a normal number as rare.
    pub deviations: f64,
    /// Whether the places would have to be farther off than is possible.
    pub places_wrong: bool,
    /// Time that sound takes across the array, seconds.
    pub across_s: f64,
    /// Sets used, and cells of directions in which they lie.
    pub sets: usize,
    /// See `sets`.
    pub cells: usize,
}

impl Lateness {
    /// Whether arrivals are off in all sets, of whichever hydrophones.
    fn is_sure(&self) -> bool {
        self.deviations >= SURE
            && !self.places_wrong
            && self.likeliest().late_s.abs() >= LEAST_SHARE * self.across_s
    }

    /// The hydrophone that leaves least unexplained.
    fn likeliest(&self) -> Late {
        let best = |a: &usize, b: &usize| self.left[*a].0.total_cmp(&self.left[*b].0);
        self.alone[(0..CHANNELS).min_by(best).unwrap_or(0)]
    }

    /// Hydrophones one of which is late, the likeliest first: none where no lateness is sure, or none alone explains it.
    pub fn late(&self) -> Vec<Late> {
        if !self.is_sure() {
            return Vec::new();
        }
        let explains = |k: &usize| self.left[*k].1 >= EXPLAINED || self.left[*k].0 <= LEFT;
        let mut order: Vec<usize> = (0..CHANNELS).filter(explains).collect();
        order.sort_by(|a, b| self.left[*a].0.total_cmp(&self.left[*b].0));
        order.into_iter().map(|k| self.alone[k]).collect()
    }

    /// Standard deviation of what each hydrophone's arrivals are off by, seconds, to count in bearings: 0 where nothing is sure.
    pub fn unsure_s(&self) -> [f64; CHANNELS] {
        let mut out = [0.0; CHANNELS];
        let late = self.late();
        for one in &late {
            out[one.hydrophone] = one.late_s.hypot(one.sd_s);
        }
        if late.is_empty() && self.is_sure() {
            // Four errors that add up are twice what they are by their squares.
            let each = self.each_s.iter().zip(&self.each_sd_s).map(|(x, sd)| 2.0 * x.hypot(*sd));
            out.iter_mut().zip(each).for_each(|(out, x)| *out = x.min(self.across_s));
        }
        out
    }

    /// What to say of it, and what to do; `None` where nothing is sure.
    pub fn said(&self) -> Option<String> {
        if !self.is_sure() {
            return None;
        }
        let microseconds = |late: &Late| {
            let way = if late.late_s > 0.0 { "late" } else { "early" };
            format!("{:.1} ± {:.1} µs {way}", 1e6 * late.late_s.abs(), 1e6 * late.sd_s)
        };
        let late = self.late();
        let held = "the stated errors of bearings count it";
        Some(match &late[..] {
            [one] => format!(
                "hydrophone {} is {} in all sets ({held}): put its channel right, or its delays: {}",
                one.hydrophone,
                microseconds(one),
                mended(one)
            ),
            [] => {
                let each = self.each_s.iter().zip(&self.each_sd_s).enumerate();
                let each: Vec<String> = each
                    .map(|(k, (x, sd))| format!("hydrophone {k} by {:+.1} ± {:.1}", 1e6 * x, 1e6 * sd))
                    .collect();
                format!(
                    "arrivals of several hydrophones are off in all sets, against their mean (µs): {} ({held}): look at how their \
                     channels are sampled",
                    each.join(", ")
                )
            }
            several => {
                let each: Vec<String> = several
                    .iter()
                    .map(|l| format!("hydrophone {} is {}", l.hydrophone, microseconds(l)))
                    .collect();
                format!(
                    "{} in all sets ({held}): look at these channels; sets from other directions would tell which",
                    each.join(", or ")
                )
            }
        })
    }
}

/// What puts a hydrophone's delays right: by column.
fn mended(late: &Late) -> String {
    let of = |which: fn((usize, usize)) -> usize, less: bool| {
        let pairs = PAIRS.into_iter().filter(|p| which(*p) == late.hydrophone);
        let names: Vec<String> = pairs.map(|(i, j)| format!("tdoa{i}{j}_s")).collect();
        let by = 1e6 * late.late_s.abs();
        let way = if less == (late.late_s > 0.0) { "less" } else { "more" };
        (!names.is_empty()).then(|| format!("{} {by:.1} µs {way}", names.join(", ")))
    };
    [of(|p| p.1, true), of(|p| p.0, false)].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// What is known of the array.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// Range for which delays are expected, metres.
    pub range_m: f64,
    /// Standard deviation of each coordinate of each hydrophone, metres.
    pub position_sd_m: f64,
    /// Standard deviation of the speed of sound, m/s.
    pub sound_speed_sd_m_s: f64,
    /// Greatest root-mean-square closure of a set that is used, seconds.
    pub tolerance_s: f64,
}

/// The array, as vectors.
pub(super) struct Model {
    position_m: [[f64; 3]; CHANNELS],
    pub(super) duals: [[f64; 3]; CHANNELS],
    pub(super) sound_speed_m_s: f64,
    pub(super) curvature: f64,
    across_s: f64,
    /// Information told of each unknown.
    prior: [f64; UNKNOWNS],
}

/// How late each hydrophone is in all sets; `None` where the sets do not tell.
pub fn lateness(geometry: &Geometry, told: &Told, sets: &[[f64; 6]]) -> Option<Lateness> {
    let model = Model::new(geometry, told);
    let vectors: Vec<[f64; 3]> = sets.iter().filter_map(|s| model.vector(s, told.tolerance_s)).collect();
    if vectors.len() < LEAST_SETS {
        return None;
    }
    let mut first = [0.0; UNKNOWNS];
    first[..3].copy_from_slice(&model.first_centre(&vectors));
    let start = (first, Scatter::default());
    let equations = |round, (place, scatter): &([f64; UNKNOWNS], Scatter)| {
        let cells = model.cells(&vectors, place, scatter.scale, round < ROUGH);
        let mut normal = cells.normal(scatter);
        model.told(place, &mut normal);
        Some(normal)
    };
    let advance = |round, (place, scatter): &mut ([f64; UNKNOWNS], Scatter), step: &[f64; UNKNOWNS]| {
        place.iter_mut().zip(step).for_each(|(x, by)| *x += by);
        let back = model.back(place);
        let residuals: Vec<f64> = vectors.iter().map(|v| model.row(v, place, &back).1.abs()).collect();
        let fitted = model.fitted(&vectors, place, scatter, round < ROUGH);
        scatter.scale = Scatter::scale_of(residuals, fitted);
        scatter.take(&model.cells(&vectors, place, scatter.scale, round < ROUGH), fitted);
        round < ROUGH || step.iter().any(|x| x.abs() > 1e-8)
    };
    let ((place, scatter), _) = reweighted(start, ROUNDS, equations, advance)?;
    // What successive cells share is judged by the fit that takes them for independent: one that leans on what was told leaves more of it.
    let fitted = model.fitted(&vectors, &place, &scatter, false);
    let cells = model.cells(&vectors, &place, scatter.scale, false);
    let scatter = scatter.in_order(&cells, fitted);
    let freedom = scatter.freedom(cells.len(), fitted);
    if cells.sets() < LEAST_KEPT * vectors.len() as f64 || freedom < LEAST_FREEDOM {
        return None;
    }
    let advance = |_, (place, _): &mut ([f64; UNKNOWNS], Scatter), step: &[f64; UNKNOWNS]| {
        place.iter_mut().zip(step).for_each(|(x, by)| *x += by);
        step.iter().any(|x| x.abs() > 1e-8)
    };
    let equations = |_, state: &([f64; UNKNOWNS], Scatter)| equations(ROUNDS, state);
    let ((place, _), covariance) = reweighted((place, scatter), ROUGH, equations, advance)?;
    model.told_of(&place, &covariance, freedom, (cells.sets().round() as usize, cells.len()))
}

impl Model {
    pub(super) fn new(geometry: &Geometry, told: &Told) -> Self {
        let position_m = geometry.position_m.map(|h| h.map(f64::from));
        let c = f64::from(geometry.sound_speed_m_s);
        let across_m = PAIRS.map(|(i, j)| norm(&minus(&position_m[i], &position_m[j])));
        let mut prior = [1.0 / (CENTRE * CENTRE); UNKNOWNS];
        let place_sd_m = if told.position_sd_m > 0.0 { MARGIN * told.position_sd_m } else { UNTOLD_PLACE_M };
        prior[PLACES].fill(place_sd_m.powi(-2));
        prior[SPEED] = (told.sound_speed_sd_m_s / c).max(LEAST_SPEED).powi(-2);
        prior[CURVATURE] = CURVATURE_PER_M.powi(-2);
        prior[RISING] = CURVATURE_PER_M.powi(-2);
        Self {
            position_m,
            duals: duals(&position_m),
            sound_speed_m_s: c,
            curvature: 1.0 / told.range_m,
            across_s: across_m.into_iter().fold(0.0, f64::max) / c,
            prior,
        }
    }

    /// The vector of a set whose delays close around every triangle.
    pub(super) fn vector(&self, delays_s: &[f64; 6], tolerance_s: f64) -> Option<[f64; 3]> {
        let mut times = [0.0; CHANNELS];
        for ((i, j), tau) in PAIRS.into_iter().zip(delays_s) {
            times[i] -= tau / CHANNELS as f64;
            times[j] += tau / CHANNELS as f64;
        }
        let left = PAIRS.iter().zip(delays_s).map(|((i, j), tau)| (tau - times[*j] + times[*i]).powi(2));
        let mut v = [0.0; 3];
        for (dual, t) in self.duals.iter().zip(&times) {
            v.iter_mut().zip(dual).for_each(|(x, d)| *x -= self.sound_speed_m_s * t * d);
        }
        (left.sum::<f64>() <= 6.0 * tolerance_s * tolerance_s && norm(&v) < 10.0).then_some(v)
    }

    /// What a curvature of 1/m adds to the vector of a direction, along it.
    pub(super) fn bend(&self, u: &[f64; 3]) -> f64 {
        let of = |(h, d): (&[f64; 3], &[f64; 3])| {
            -0.5 * (spd::dot(h, h) - spd::dot(h, u).powi(2)) * spd::dot(d, u)
        };
        self.position_m.iter().zip(&self.duals).map(of).sum()
    }

    /// What undoes that displacements δ_k make (1 + Σ d_k δ_kᵀ) u of a direction.
    fn back(&self, place: &[f64; UNKNOWNS]) -> Matrix3<f64> {
        let mut stretch = Matrix3::identity();
        for (dual, moved) in self.duals.iter().zip(place[PLACES].as_chunks::<3>().0) {
            stretch += Vector3::from(*dual) * Vector3::from(*moved).transpose();
        }
        stretch.try_inverse().unwrap_or_else(Matrix3::identity)
    }

    /// Derivatives of the length of a vector about the centre, undone of what the places do to it, and by how much it is longer than expected;
    /// its direction.
    fn row(
        &self,
        v: &[f64; 3],
        place: &[f64; UNKNOWNS],
        back: &Matrix3<f64>,
    ) -> ([f64; UNKNOWNS], f64, [f64; 3]) {
        let own: [f64; 3] = (back * Vector3::from(minus(v, &[place[0], place[1], place[2]]))).into();
        let length = norm(&own).max(1e-6);
        let u = own.map(|x| x / length);
        let along: [f64; 3] = (back.transpose() * Vector3::from(u)).into();
        let mut row = [0.0; UNKNOWNS];
        row[..3].copy_from_slice(&along);
        for (k, dual) in self.duals.iter().enumerate() {
            let along = spd::dot(dual, &along);
            for (j, x) in own.iter().enumerate() {
                row[PLACES.start + 3 * k + j] = along * x;
            }
        }
        row[SPEED] = 1.0;
        row[CURVATURE] = self.bend(&u);
        row[RISING] = row[CURVATURE] * u[2];
        let expected: f64 = row.iter().zip(place).skip(SPEED).map(|(a, x)| a * x).sum();
        (row, length - 1.0 - self.curvature * row[CURVATURE] - expected, u)
    }

    fn cells(&self, vectors: &[[f64; 3]], place: &[f64; UNKNOWNS], scale: f64, rough: bool) -> Cells {
        let (mut cells, back) = (Cells::default(), self.back(place));
        for v in vectors {
            let (row, residual, u) = self.row(v, place, &back);
            let r = residual / scale;
            let weight = if rough { Huber::EFFICIENT.weight(r) } else { Tukey::EFFICIENT.weight(r) };
            cells.take(&u, &row, residual, weight);
        }
        cells
    }

    fn told(&self, place: &[f64; UNKNOWNS], normal: &mut Normal<UNKNOWNS>) {
        for (k, (x, weight)) in place.iter().zip(&self.prior).enumerate() {
            let mut row = [0.0; UNKNOWNS];
            row[k] = 1.0;
            normal.observe(&row, -x, *weight);
        }
    }

    /// How many unknowns the sets determine.
    fn fitted(&self, vectors: &[[f64; 3]], place: &[f64; UNKNOWNS], scatter: &Scatter, rough: bool) -> f64 {
        let mut normal = self.cells(vectors, place, scatter.scale, rough).normal(scatter);
        self.told(place, &mut normal);
        let covariance = spd::inverse(&normal.information(&[true; UNKNOWNS]));
        covariance
            .map_or(UNKNOWNS as f64, |c| self.prior.iter().enumerate().map(|(k, p)| 1.0 - p * c[k][k]).sum())
    }

    /// The centre from which the fit begins: none, or that of one hydrophone late by so much that no fit would find it from none.
    fn first_centre(&self, vectors: &[[f64; 3]]) -> [f64; 3] {
        let cost = |b: &[f64; 3]| -> f64 {
            vectors.iter().map(|v| ((norm(&minus(v, b)) - 1.0) / FAR).powi(2).min(1.0)).sum()
        };
        let mut best = ([0.0; 3], GAIN * cost(&[0.0; 3]));
        for dual in &self.duals {
            for step in -TRIED..=TRIED {
                let late_s = f64::from(step) * TRIED_STEP * self.across_s;
                let b = dual.map(|d| -self.sound_speed_m_s * late_s * d);
                let cost = cost(&b);
                if cost < best.1 {
                    best = (b, cost);
                }
            }
        }
        best.0
    }

    /// What a centre and its covariance say of the hydrophones.
    fn told_of(
        &self,
        place: &[f64; UNKNOWNS],
        covariance: &Square<UNKNOWNS>,
        freedom: f64,
        (sets, cells): (usize, usize),
    ) -> Option<Lateness> {
        let b = [place[0], place[1], place[2]];
        let mut c = [[0.0; 3]; 3];
        for (row, from) in c.iter_mut().zip(covariance) {
            row.copy_from_slice(&from[..3]);
        }
        let information = spd::inverse(&c)?;
        let all = spd::quadratic(&b, &information, &b);
        let least = (LEAST_SD * self.across_s).powi(2);
        let mut alone = [Late { hydrophone: 0, late_s: 0.0, sd_s: 0.0 }; CHANNELS];
        let mut unexplained = [(0.0, 0.0); CHANNELS];
        for (k, dual) in self.duals.iter().enumerate() {
            let a = dual.map(|d| -self.sound_speed_m_s * d);
            let variance = 1.0 / spd::quadratic(&a, &information, &a);
            let late_s = variance * spd::quadratic(&a, &information, &b);
            alone[k] = Late { hydrophone: k, late_s, sd_s: (variance + least).sqrt() };
            let left = (all - late_s * late_s / variance).max(0.0);
            unexplained[k] = (left / all, (1.0 + left / freedom).powf(-0.5 * freedom));
        }
        let best = (0..CHANNELS).min_by(|a, b| unexplained[*a].0.total_cmp(&unexplained[*b].0))?;
        let student = alone[best].late_s.abs() / alone[best].sd_s;
        let own = |h: &[f64; 3]| h.map(|x| -x / self.sound_speed_m_s);
        let each_s = self.position_m.each_ref().map(|h| spd::dot(&own(h), &b));
        let each_sd_s = self
            .position_m
            .each_ref()
            .map(|h| (spd::quadratic(&own(h), &c, &own(h)).max(0.0) + least).sqrt());
        let off: f64 = place[PLACES].iter().zip(&self.prior[PLACES]).map(|(x, p)| x * x * p).sum();
        let finite = each_s.iter().chain(&each_sd_s).chain([&student]).all(|x| x.is_finite());
        finite.then_some(Lateness {
            each_s,
            each_sd_s,
            alone,
            left: unexplained,
            deviations: as_normal(student, freedom),
            places_wrong: off > PLACES_WRONG,
            across_s: self.across_s,
            sets,
            cells,
        })
    }
}

/// The normal number that is as rare as one of Student's distribution (Wallace).
fn as_normal(t: f64, freedom: f64) -> f64 {
    (freedom * (t * t / freedom).ln_1p()).sqrt() * (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
}

/// Vectors whose products with the places are 1 for the own one and 0 for the others', up to a constant: 1/m.
fn duals([o, a, b, c]: &[[f64; 3]; CHANNELS]) -> [[f64; 3]; CHANNELS] {
    let (a, b, c) = (minus(a, o), minus(b, o), minus(c, o));
    let cross = |x: &[f64; 3], y: &[f64; 3]| {
        [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    };
    let (bc, ca, ab) = (cross(&b, &c), cross(&c, &a), cross(&a, &b));
    // No station's hydrophones are in a plane.
    let volume = spd::dot(&a, &bc);
    let [a, b, c] = [bc, ca, ab].map(|x| x.map(|x| x / volume));
    [[0, 1, 2].map(|k: usize| -(a[k] + b[k] + c[k])), a, b, c]
}

fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn norm(v: &[f64; 3]) -> f64 {
    spd::dot(v, v).sqrt()
}

#[cfg(test)]
#[path = "late_tests.rs"]
mod tests;
