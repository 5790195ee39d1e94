//! From the times at which four hydrophones hear a sound of unknown distance to its direction: least squares with the wavefront's
//! curvature and the speed of sound as two more unknowns.

use super::plan::Plan;
use super::wavefront::{self, Direction};
use crate::block::CHANNELS;
use crate::math::f32 as m;

/// Root mean square of the wavefront's curvature, 1/m: that of sounds of which as many come from each octave of distance between 50 m
/// and 5 km.
const CURVATURE_SD: f64 = 1.0 / 150.0;
const FARTHEST: f64 = 1.0 / 5000.0;
const NEAREST: f64 = 1.0 / 50.0;
/// Squared deviations by which the four times may miss one wavefront.
const MISSES: f64 = 16.0;
/// Unknowns: two of direction, curvature, relative slowness.
const UNKNOWNS: usize = 4;

/// A direction, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arrival {
    /// Radians.
    pub(super) azimuth: f32,
    pub(super) elevation: f32,
    /// Variances and covariance, rad².
    pub(super) var_azimuth: f32,
    pub(super) var_elevation: f32,
    pub(super) cov: f32,
}

/// The direction of the wavefront that comes at four times, of a variance each; `None` where it is none.
pub(super) fn wavefront_of(plan: &Plan, times: &[f32; CHANNELS], variance_s2: f32) -> Option<Arrival> {
    let geometry = &plan.geometry;
    let mean = times.iter().sum::<f32>() / CHANNELS as f32;
    let times = times.map(|t| t - mean);
    // Slowness of a plane wave.
    let (mut spread, mut sum) = ([[0.0; UNKNOWNS]; UNKNOWNS], [0.0; UNKNOWNS]);
    for (h, t) in geometry.position_m.iter().zip(&times) {
        let [x, y, z] = h.map(f64::from);
        add(&mut spread, &mut sum, &[x, y, z, 0.0], 1.0, -f64::from(*t));
    }
    spread[3][3] = 1.0;
    let [east, north, up, _] = times_of(&inverse(spread)?, &sum);
    let slowness = [east, north, up];
    let length = crate::math::f64::sqrt(slowness.iter().map(|x| x * x).sum());
    if length.is_nan() || length <= 0.0 {
        return None;
    }
    let mut u: Direction = slowness.map(|x| (x / length) as f32);
    let (mut curvature, mut curvature_sd, mut slower) = (0.0f64, CURVATURE_SD, 0.0f64);
    let slower_sd = f64::from(plan.sound_speed_sd);
    let weight = 1.0 / f64::from(variance_s2);
    let mut covariance = [[0.0; UNKNOWNS]; UNKNOWNS];
    for round in 0..ROUNDS {
        let e = wavefront::tangents(&u);
        let model = wavefront::arrivals(geometry, &u, curvature as f32);
        let [across, up] =
            [&e.0, &e.1].map(|tangent| wavefront::gradient(geometry, &u, tangent, curvature as f32));
        let columns = [
            across,
            up,
            geometry.position_m.map(|h| {
                let along = wavefront::dot(&h, &u);
                0.5 * plan.inv_c * (wavefront::dot(&h, &h) - along * along)
            }),
            model,
        ]
        .map(centred);
        let (model, measured) = (centred(model), centred(times));
        let mut normal = [[0.0; UNKNOWNS]; UNKNOWNS];
        let mut right = [0.0; UNKNOWNS];
        let mut misses = 0.0;
        for (h, (t, expected)) in measured.iter().zip(&model).enumerate() {
            let row = columns.map(|c| c.get(h).copied().unwrap_or(0.0));
            let left = t - expected * (1.0 + slower);
            add(&mut normal, &mut right, &row, weight, left);
            misses += weight * left * left;
        }
        let priors =
            [([0.0, 0.0, 1.0, 0.0], curvature, curvature_sd), ([0.0, 0.0, 0.0, 1.0], slower, slower_sd)];
        for (row, value, sd) in priors {
            let known = 1.0 / (sd * sd);
            add(&mut normal, &mut right, &row, known, -value);
            misses += known * value * value;
        }
        if round == PLAIN_ROUNDS && !(misses <= MISSES) {
            return None;
        }
        covariance = inverse(normal)?;
        let [across, up, bend, slow] = times_of(&covariance, &right);
        u = wavefront::stepped(&u, &e, across as f32, up as f32);
        curvature += bend;
        slower += slow;
        if round >= PLAIN_ROUNDS {
            let [.., [.., variance, _], _] = covariance;
            let square = curvature * curvature + variance;
            curvature_sd = crate::math::f64::sqrt(square).clamp(FARTHEST, NEAREST);
        }
    }
    let [[first, cross, ..], [_, second, ..], ..] = covariance;
    let (azimuth, elevation) = wavefront::angles(&u);
    // A step along the horizontal tangent turns the azimuth by 1/cos β; at the zenith azimuth means nothing.
    let widen = 1.0 / wavefront::tangents(&u).1[2].max(1e-3);
    let most = m::PI * m::PI / 3.0;
    Some(Arrival {
        azimuth,
        elevation,
        var_azimuth: (first as f32 * widen * widen).min(most),
        var_elevation: (second as f32).min(most),
        cov: (cross as f32 * widen).clamp(-most, most),
    })
}

/// Rounds of the least squares. From [`PLAIN_ROUNDS`] on, which hardly move anything any more, the curvature is what was found of it
/// uncertain by: the prior law of a scale that may be any.
const ROUNDS: usize = 4;
const PLAIN_ROUNDS: usize = 2;

/// A symmetric matrix.
type Square = [[f64; UNKNOWNS]; UNKNOWNS];

/// Adds a measurement with these derivatives to normal equations.
#[inline(never)]
fn add(normal: &mut Square, right: &mut [f64; UNKNOWNS], row: &[f64; UNKNOWNS], weight: f64, value: f64) {
    for ((line, right), x) in normal.iter_mut().zip(right).zip(row) {
        *right += weight * x * value;
        line.iter_mut().zip(row).for_each(|(sum, y)| *sum += weight * x * y);
    }
}

#[inline(never)]
fn times_of(a: &Square, x: &[f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
    a.map(|row| row.iter().zip(x).map(|(a, x)| a * x).sum())
}

/// Inverse of a positive definite matrix, pivot by pivot: a quarter of the code of a factor. `None` where it is singular.
#[inline(never)]
fn inverse(mut a: Square) -> Option<Square> {
    for k in 0..UNKNOWNS {
        let row = a[k];
        let pivot = row[k];
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        for (i, line) in a.iter_mut().enumerate() {
            // The pivot's own row keeps nothing of what it was.
            let unit = if i == k { 1.0 } else { 0.0 };
            let of = if i == k { 1.0 - 1.0 / pivot } else { line[k] / pivot };
            for (j, (x, own)) in line.iter_mut().zip(&row).enumerate() {
                *x = if j == k { unit - of } else { *x - of * own };
            }
        }
    }
    a.iter().flatten().all(|x| x.is_finite()).then_some(a)
}

/// About their mean.
#[inline(never)]
fn centred(times: [f32; CHANNELS]) -> [f64; CHANNELS] {
    let times = times.map(f64::from);
    let mean = times.iter().sum::<f64>() / CHANNELS as f64;
    times.map(|t| t - mean)
}
