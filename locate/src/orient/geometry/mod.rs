//! Positions of a compact array's hydrophones and its orientation together, from one pass of a vessel of known track, with
//! what was known before.
//!
//! In: arrival-time differences, the track, and how far each thing may be from where it is said to be ([`Doubts`]). Out:
//! positions in the array's own frame, the rotation of that frame, what is left uncertain of both.
//!
//! With hydrophones `h_k`, rotation `R`, speed `c`, a track that lies `e` off and a clock that is `l` late,
//! `τ_ij = (‖s − R h_j‖ − ‖s − R h_i‖)/c`, `s = p(t − l − r/c) + e`: Gauss-Newton over twenty-two numbers, each in units of its own
//! standard deviation, so that what the pass does not tell keeps the one it had. A rotation of all hydrophones is the
//! orientation and a common displacement the track's, so that positions are told without both: those nearest to the
//! configured ones.
//!
//! **What one pass cannot tell.** Of far-away sources a pair's delay is its baseline's component along the direction. On a straight
//! level course all directions lie in one plane through the array: components across it are in no delay (distances stay the
//! same if an array is mirrored in that plane, and near by, where they would not be linear, what remains looks like a stretch along the
//! plane). That leaves three of the six numbers of a shape as they were. A course that turns tells all six, but for the size of the array,
//! which the speed of sound has in common with all delays.

mod gauge;
mod model;
mod noise;

use super::OrientError;
use super::rotation::{DirectionPair, rotation};
use crate::angle::wrap_pi;
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::kit::normal::least_squares;
use crate::kit::{Square, reweighted, spd};
use crate::math::f64 as m;
use crate::network::known_track::TrackPoint;
pub use gauge::aligned;
use model::{COORDINATES, LATE, Model, SHIFT, SPEED, UNKNOWNS};
use noise::Noise;

/// Fewest sets of six differences.
const LEAST_SETS: usize = 20;
/// Smallest noise of a difference assumed, seconds, so that exact data do not divide by zero.
const LEAST_SCALE_S: f64 = 1e-10;
/// Rounds at most, those in which Huber's weights find the neighbourhood before Tukey's leave wrong pairs out, and those after which the
/// noise stays as it was found: what follows is one fixed function's minimum.
const ROUNDS: usize = 120;
const ROUGH: usize = 6;
const LEARNT: usize = 24;
/// Largest step that is none any more, in standard deviations of what was known before.
const SETTLED: f64 = 1e-6;
/// Least share of a step that is gone where steps turn back.
const LEAST_SHARE: f64 = 1.0 / 16.0;
/// Largest standard deviation of an orientation that is one, radians (6°).
const LARGEST_TURN: f64 = 0.1;
/// Of the angle by which the image in the surface pulls a vessel, what two numbers do not stand for: where it is nearly told apart, a delay is
/// no longer that of one direction between both, each pair by its own. By `reproduce orient-geometry`, seed 3.
const IMAGE_LEFT: f64 = 0.15;
/// Largest share of the pairs that may be wrong.
const MOST_WRONG: f64 = 0.5;

/// Differences of one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedDelays {
    /// When, seconds.
    pub t_s: f64,
    /// `τ_ij = t_j − t_i` in the order of [`PAIRS`], seconds; NaN where a pair is missing.
    pub tdoa_s: [f64; 6],
}

/// Standard deviations of what is assumed; 0: exact. All are errors that last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Doubts {
    /// Each coordinate of each hydrophone, metres.
    pub position_m: f64,
    /// Speed of sound, m/s.
    pub sound_speed_m_s: f64,
    /// East and North of the whole track, metres.
    pub track_m: f64,
    /// Height of the source, metres.
    pub height_m: f64,
    /// The recorder's clock against the track's, seconds.
    pub clock_s: f64,
    /// A vessel `d` deep and its image are heard together from the surface between them, but for what the image's longer way makes it
    /// fainter, `(1 − g²)/(1 + g²) = 2 d z/r²`: lower by `2 d² z/r²` for an array `z` deep. How far twice the square of the depth may be
    /// from 0, square metres. Where the two are nearly told apart it is more: near by, `100 m` away as much again may come to it, as `1/r⁴`.
    pub image_m2: f64,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mended {
    /// East, North, Up of each hydrophone in the array's own frame, metres, about the configured centroid, turned so that they are
    /// nearest to the configured ones.
    pub position_m: [[f64; 3]; CHANNELS],
    /// Covariance of the same, m²: hydrophone by hydrophone, East, North, Up. Of rank six.
    pub covariance_m2: Square<COORDINATES>,
    /// Rows of the matrix that turns the array's frame into the true one.
    pub matrix: Square<3>,
    /// Turn of the array's frame about the vertical, clockwise from above, radians in (−π, π].
    pub heading: f64,
    /// Standard deviations of the turn about East, North and Up, radians.
    pub sd_turn: [f64; 3],
    /// Positions turned into the true frame but for the heading: what a station file holds, which has no tilt. Metres.
    pub level_m: [[f64; 3]; CHANNELS],
    /// Standard deviations of the same, metres, those of the tilt among them.
    pub sd_level_m: [[f64; 3]; CHANNELS],
    /// Speed of sound and its standard deviation, m/s.
    pub sound_speed_m_s: (f64, f64),
    /// How far the track lies off: East, North, Up, metres, and its standard deviations.
    pub track_m: ([f64; 3], [f64; 3]),
    /// How late the recorder's clock is, and its standard deviation, seconds.
    pub late_s: (f64, f64),
    /// Of the six numbers of the shape, how many the pass does not tell: variances left, in units of those before.
    pub untold: f64,
    /// Root of the mean variance of the twelve coordinates left, and the largest standard deviation in any combination, metres.
    pub sd_m: (f64, f64),
    /// Robust standard deviation of one difference about the fit, seconds: the median over the pass.
    pub scale_s: f64,
    /// How many successive sets share one error.
    pub correlated: f64,
    /// Differences used, and those left out as wrong.
    pub n: usize,
    /// See `n`.
    pub wrong: usize,
}

/// Mends positions that may be wrong by [`Doubts::position_m`]. Sets of whose time the track tells nothing are passed over. `gap_s`:
/// longest gap of the track that is interpolated.
///
/// # Errors
/// [`OrientError`].
pub fn geometry(
    sets: &[TimedDelays],
    track: &[TrackPoint],
    gap_s: f64,
    configured_m: &[[f64; 3]; CHANNELS],
    sound_speed_m_s: f64,
    doubts: &Doubts,
) -> Result<Mended, OrientError> {
    let finite = configured_m.iter().flatten().all(|x| x.is_finite());
    let sd = [doubts.position_m, doubts.sound_speed_m_s, doubts.track_m, doubts.height_m, doubts.clock_s];
    if !finite || !(sound_speed_m_s > 100.0) || !sd.iter().all(|x| *x >= 0.0 && x.is_finite()) {
        return Err(OrientError::NotFinite);
    }
    let first = Model::new(configured_m, sound_speed_m_s, track, gap_s, *doubts);
    let heard = || sets.iter().filter(|s| first.source(s.t_s).is_some());
    if heard().count() < LEAST_SETS {
        return Err(OrientError::TooFew);
    }
    let start = first.turned_by(&start(&first, heard())?);
    let equations = |_, (model, noise): &(Model<'_>, Noise)| {
        let mut normal = model.prior();
        for (k, set) in sets.iter().enumerate() {
            model.rows(set, |_, row, residual| normal.observe(row, residual, noise.weights(k, residual).0));
        }
        Some(normal)
    };
    let (mut share, mut last, mut settled) = (1.0f64, [0.0; UNKNOWNS], false);
    let advance = |round, (model, noise): &mut (Model<'_>, Noise), step: &[f64; UNKNOWNS]| {
        // Weights change with the place, and two places may send to each other: a step that turns back is gone in part.
        let next: f64 = if spd::dot(step, &last) < 0.0 { 0.5 * share } else { 1.5 * share };
        share = next.clamp(LEAST_SHARE, 1.0);
        last = *step;
        model.step(&step.map(|x| share * x));
        if round < LEARNT {
            *noise = Noise::of(model, sets, round >= ROUGH);
        }
        settled = round > ROUGH && step.iter().all(|x| m::abs(*x) < SETTLED);
        !settled
    };
    let begin = (start, Noise::of(&start, sets, false));
    let ((model, noise), c) =
        reweighted(begin, ROUNDS, equations, advance).ok_or(OrientError::NotObservable)?;
    if !settled {
        return Err(OrientError::Unsettled);
    }
    found(&model, &noise, sets, &c)
}

/// The rotation under which the configured positions hear the directions that the delays give.
fn start<'a>(
    model: &Model<'_>,
    heard: impl Iterator<Item = &'a TimedDelays> + Clone,
) -> Result<[[f64; 3]; 3], OrientError> {
    // As many of them as fit, evenly over the pass.
    let mut pairs = [DirectionPair { measured: [0.0; 3], known: [0.0; 3], sd: 1.0 }; 240];
    let every = (heard.clone().count() / pairs.len() + 1).max(1);
    let mut n = 0;
    for (set, pair) in heard.step_by(every).filter_map(|set| direction(model, set)).zip(&mut pairs) {
        (*pair, n) = (DirectionPair { measured: set.0, known: set.1, sd: 1.0 }, n + 1);
    }
    rotation(pairs.get(..n).unwrap_or(&[]), 1.0).map(|r| r.matrix)
}

/// Where a set's delays point in the array's frame, and where the vessel is.
fn direction(model: &Model<'_>, set: &TimedDelays) -> Option<([f64; 3], [f64; 3])> {
    let h = &model.configured_m;
    let rows = PAIRS.iter().zip(&set.tdoa_s).filter(|(_, tau)| tau.is_finite());
    let slowness = least_squares(rows.filter_map(|((i, j), tau)| {
        let (a, b) = (h.get(*i)?, h.get(*j)?);
        Some(([a[0] - b[0], a[1] - b[1], a[2] - b[2]], tau * model.sound_speed_m_s))
    }))?;
    let known = model.source(set.t_s)?.0;
    let unit = |v: [f64; 3]| {
        let norm = m::sqrt(spd::dot(&v, &v));
        (norm > 1e-3).then(|| v.map(|x| x / norm))
    };
    Some((unit(slowness)?, unit(known)?))
}

/// The answer, with its uncertainty, from the last place and the inverse of its information.
fn found(
    model: &Model<'_>,
    noise: &Noise,
    sets: &[TimedDelays],
    c: &Square<UNKNOWNS>,
) -> Result<Mended, OrientError> {
    let scales = model.scales();
    let mut covariance = noise.covariance(model, sets, c).ok_or(OrientError::Unsettled)?;
    for (i, row) in covariance.iter_mut().enumerate() {
        for (x, s) in row.iter_mut().zip(&scales) {
            *x *= s * scales[i];
        }
    }
    let (mut shape, mut turn) = gauge::told(model, &covariance);
    // What is left out of the linear model: a shape that is uncertain by s has to be turned by some s/size, the square of which moves it
    // where it is told better.
    let largest = spd::largest_eigenvalue(&shape).max(0.0);
    let square: f64 = model.configured_m.iter().map(|h| spd::dot(h, h)).sum::<f64>() / CHANNELS as f64;
    let bent = largest / square;
    // No time averages it out, and residuals do not show it: it moves with the vessel.
    let left = IMAGE_LEFT * IMAGE_LEFT * square * noise.pulled_square(model, sets);
    gauge::blur(model, &mut shape, largest * bent + left);
    for (k, row) in turn.iter_mut().enumerate() {
        row[k] += bent * bent;
    }
    let sd_turn = [0, 1, 2].map(|k: usize| m::sqrt(turn[k][k].max(0.0)));
    if !sd_turn.iter().all(|s| *s <= LARGEST_TURN) {
        return Err(OrientError::Uncertain);
    }
    let (mut n, mut wrong) = (0, 0);
    for (k, set) in sets.iter().enumerate() {
        model.rows(set, |_, _, residual| {
            let good = noise.weights(k, residual).0 > 0.0;
            (n, wrong) = (n + usize::from(good), wrong + usize::from(!good));
        });
    }
    if !(wrong as f64 <= MOST_WRONG * (n + wrong) as f64) {
        return Err(OrientError::Inconsistent);
    }
    let trace: f64 = (0..COORDINATES).map(|i| shape[i][i]).sum();
    let before = model.doubts.position_m;
    let [[_, north_east, _], [_, north_north, _], _] = model.matrix;
    let heading = m::atan2(north_east, north_north);
    let (s, co) = m::sin_cos(heading);
    let level_m = model.position_m.map(|h| {
        let [x, y, z] = spd::times(&model.matrix, &h);
        [x * co - y * s, x * s + y * co, z]
    });
    let sd_at = |k: usize| m::sqrt(covariance[k][k].max(0.0));
    Ok(Mended {
        position_m: model.position_m,
        covariance_m2: shape,
        matrix: model.matrix,
        heading: wrap_pi(heading),
        sd_turn,
        level_m,
        sd_level_m: gauge::level(model, &covariance, heading, largest * bent + left),
        sound_speed_m_s: (model.sound_speed_m_s, sd_at(SPEED)),
        track_m: (model.shift_m, [SHIFT, SHIFT + 1, SHIFT + 2].map(sd_at)),
        late_s: (model.late_s, sd_at(LATE)),
        untold: if before > 0.0 { trace / (before * before) } else { 0.0 },
        sd_m: (m::sqrt(trace / COORDINATES as f64), m::sqrt(spd::largest_eigenvalue(&shape).max(0.0))),
        scale_s: noise.median_s(sets.len()),
        correlated: noise.correlated,
        n,
        wrong,
    })
}

#[cfg(test)]
mod tests;
