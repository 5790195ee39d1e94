//! The twenty-two numbers, and what delays they give.

use super::{Doubts, TimedDelays};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::kit::{Normal, Square, spd};
use crate::math::f64 as m;
use crate::network::known_track::{TrackPoint, position_at};
use nalgebra::{Rotation3, Vector3};

/// Coordinates of the hydrophones.
pub(super) const COORDINATES: usize = 3 * CHANNELS;
/// Where the turn begins among the unknowns; speed of sound, the track's shift and the clock follow.
pub(super) const TURN: usize = COORDINATES;
pub(super) const SPEED: usize = TURN + 3;
pub(super) const SHIFT: usize = SPEED + 1;
pub(super) const LATE: usize = SHIFT + 3;
/// What the image in the surface pulls less than the vessel, far away, and more of it near by.
pub(super) const IMAGE: usize = LATE + 1;
pub(super) const UNKNOWNS: usize = IMAGE + 2;

/// Distance at which both count alike, metres.
const NEAR_M: f64 = 100.0;

/// Half of the time over which the vessel's velocity is taken, seconds.
const VELOCITY_S: f64 = 0.5;

/// Values of the unknowns, and what they were said to be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model<'a> {
    /// Positions as configured, about their centroid, and as they are now, metres.
    pub configured_m: [[f64; 3]; CHANNELS],
    pub position_m: [[f64; 3]; CHANNELS],
    /// Rows of the rotation from the array's frame to the true one.
    pub matrix: Square<3>,
    pub sound_speed_m_s: f64,
    said_m_s: f64,
    pub shift_m: [f64; 3],
    pub late_s: f64,
    image_m2: [f64; 2],
    track: &'a [TrackPoint],
    gap_s: f64,
    pub doubts: Doubts,
}

impl<'a> Model<'a> {
    pub(super) fn new(
        configured_m: &[[f64; 3]; CHANNELS],
        sound_speed_m_s: f64,
        track: &'a [TrackPoint],
        gap_s: f64,
        doubts: Doubts,
    ) -> Self {
        let centre = centroid(configured_m);
        let configured_m = configured_m.map(|h| minus(&h, &centre));
        Self {
            configured_m,
            position_m: configured_m,
            matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            sound_speed_m_s,
            said_m_s: sound_speed_m_s,
            shift_m: [0.0; 3],
            late_s: 0.0,
            image_m2: [0.0; 2],
            track,
            gap_s,
            doubts,
        }
    }

    pub(super) fn turned_by(mut self, matrix: &Square<3>) -> Self {
        self.matrix = *matrix;
        self
    }

    /// What one unit of each unknown is: its standard deviation; of a turn a radian, of which nothing is known.
    pub(super) fn scales(&self) -> [f64; UNKNOWNS] {
        let d = &self.doubts;
        let mut out = [d.position_m; UNKNOWNS];
        let (track, image) = (d.track_m, d.image_m2);
        let others = [1.0, 1.0, 1.0, d.sound_speed_m_s, track, track, d.height_m, d.clock_s, image, image];
        out.iter_mut().skip(TURN).zip(others).for_each(|(x, sd)| *x = sd);
        out
    }

    /// What was known before.
    pub(super) fn prior(&self) -> Normal<UNKNOWNS> {
        let mut off = [0.0; UNKNOWNS];
        let moved = self.position_m.iter().flatten().zip(self.configured_m.iter().flatten());
        off.iter_mut().zip(moved).for_each(|(x, (now, said))| *x = now - said);
        off[SPEED] = self.sound_speed_m_s - self.said_m_s;
        off.iter_mut().skip(SHIFT).zip(self.shift_m).for_each(|(x, shift)| *x = shift);
        off[LATE] = self.late_s;
        off.iter_mut().skip(IMAGE).zip(self.image_m2).for_each(|(x, image)| *x = image);
        let mut normal = Normal::default();
        for (k, (off, sd)) in off.iter().zip(self.scales()).enumerate() {
            let mut row = [0.0; UNKNOWNS];
            row[k] = 1.0;
            normal.observe(&row, if sd > 0.0 { -off / sd } else { 0.0 }, 1.0);
        }
        normal
    }

    /// Takes a step, in units of [`Model::scales`].
    pub(super) fn step(&mut self, step: &[f64; UNKNOWNS]) {
        let mut by = *step;
        by.iter_mut().zip(self.scales()).for_each(|(x, sd)| *x *= sd);
        self.position_m.iter_mut().flatten().zip(&by).for_each(|(x, by)| *x += by);
        let turn = Rotation3::new(Vector3::new(by[TURN], by[TURN + 1], by[TURN + 2])).into_inner();
        let columns = turned(&self.matrix);
        // The columns of the product are the turned columns.
        let columns = columns.map(|column| (turn * Vector3::from(column)).into());
        self.matrix = turned(&columns);
        self.sound_speed_m_s += by[SPEED];
        self.shift_m.iter_mut().zip(by.iter().skip(SHIFT)).for_each(|(x, by)| *x += by);
        self.late_s += by[LATE];
        self.image_m2.iter_mut().zip(by.iter().skip(IMAGE)).for_each(|(x, by)| *x += by);
    }

    /// Where the track has the vessel, its shift left out; where it begins or ends meanwhile, straight on.
    fn on_track(&self, t_s: f64) -> Option<[f64; 3]> {
        let at = |t: f64| position_at(self.track, t, self.gap_s);
        at(t_s).or_else(|| {
            let (first, last) = (self.track.first()?.t_s, self.track.last()?.t_s);
            let end_s = t_s.clamp(first, last);
            let inner_s = (end_s + if t_s < first { VELOCITY_S } else { -VELOCITY_S }).clamp(first, last);
            // In a gap the end is the time itself, of which the track tells nothing.
            let (end, inner) = (at(end_s)?, at(inner_s)?);
            let beyond = (t_s - end_s) / (inner_s - end_s);
            Some(plus(&end, &minus(&inner, &end).map(|x| beyond * x)))
        })
    }

    /// Where the vessel was heard from when its sound left it, its velocity, and how far it is heard lower for each m² of
    /// [`Doubts::image_m2`]; `None` where the track does not tell. Which times it tells does not change with the clock: a set that
    /// comes and goes with it would have no slope.
    pub(super) fn source(&self, t_s: f64) -> Option<([f64; 3], [f64; 3], [f64; 2])> {
        position_at(self.track, t_s, self.gap_s)?;
        let at = |t: f64| self.on_track(t);
        let placed = |p: [f64; 3]| plus(&p, &self.shift_m);
        let now_s = t_s - self.late_s;
        let left_s = now_s - norm(&placed(at(now_s)?)) / self.sound_speed_m_s;
        let here = placed(at(left_s)?);
        let velocity = match (at(left_s - VELOCITY_S), at(left_s + VELOCITY_S)) {
            (Some(a), Some(b)) => minus(&b, &a).map(|x| x / (2.0 * VELOCITY_S)),
            (None, Some(b)) => minus(&placed(b), &here).map(|x| x / VELOCITY_S),
            (Some(a), None) => minus(&here, &placed(a)).map(|x| x / VELOCITY_S),
            (None, None) => [0.0; 3],
        };
        let [east, north, up] = here;
        let square = spd::dot(&here, &here).max(1.0);
        let lower = [up / square, up / square * (NEAR_M * NEAR_M / square)];
        let [far, near] = self.image_m2;
        Some(([east, north, up - far * lower[0] - near * lower[1]], velocity, lower))
    }

    /// By what angle the image pulls the vessel down, radians; `None` where the track does not tell.
    pub(super) fn pulled(&self, t_s: f64) -> Option<f64> {
        let ([east, north, up], _, lower) = self.source(t_s)?;
        let [far, near] = self.image_m2;
        let level = east * east + north * north;
        Some((far * lower[0] + near * lower[1]) * m::sqrt(level) / (level + up * up))
    }

    /// Derivatives (by units of the unknowns) and residual of every measured pair of a set, with the pair's number.
    pub(super) fn rows(&self, set: &TimedDelays, mut take: impl FnMut(usize, &[f64; UNKNOWNS], f64)) {
        let Some((source, velocity, lower)) = self.source(set.t_s) else { return };
        let scales = self.scales();
        let c = self.sound_speed_m_s;
        // Of each hydrophone: place in the true frame, distance and direction of the source.
        let places = self.position_m.map(|h| spd::times(&self.matrix, &h));
        let ways = places.map(|a| {
            let way = minus(&source, &a);
            let distance = norm(&way).max(1e-9);
            (distance, way.map(|x| x / distance))
        });
        for (p, ((i, j), tau)) in PAIRS.into_iter().zip(&set.tdoa_s).enumerate() {
            if !tau.is_finite() {
                continue;
            }
            let mut row = [0.0; UNKNOWNS];
            for (k, sign) in [(i, -1.0 / c), (j, 1.0 / c)] {
                let (Some((_, u)), Some(a)) = (ways.get(k), places.get(k)) else { continue };
                let own = spd::times(&turned(&self.matrix), u);
                row.iter_mut().skip(3 * k).zip(own).for_each(|(x, u)| *x -= sign * u);
                let arm = cross(a, u);
                row.iter_mut().skip(TURN).zip(arm).for_each(|(x, arm)| *x -= sign * arm);
                row.iter_mut().skip(SHIFT).zip(u).for_each(|(x, u)| *x += sign * u);
                row[LATE] -= sign * spd::dot(u, &velocity);
                row.iter_mut().skip(IMAGE).zip(lower).for_each(|(x, lower)| *x -= sign * u[2] * lower);
            }
            let expected = (ways[j].0 - ways[i].0) / c;
            row[SPEED] = -expected / c;
            row.iter_mut().zip(&scales).for_each(|(x, sd)| *x *= sd);
            take(p, &row, tau - expected);
        }
    }

    /// Residuals of a set; NaN where there are none.
    pub(super) fn residuals(&self, set: &TimedDelays) -> [f64; 6] {
        let mut out = [f64::NAN; 6];
        self.rows(set, |p, _, residual| out[p] = residual);
        out
    }
}

/// The transposed matrix.
pub(super) fn turned(a: &Square<3>) -> Square<3> {
    [0, 1, 2].map(|i: usize| [a[0][i], a[1][i], a[2][i]])
}

pub(super) fn centroid(h: &[[f64; 3]; CHANNELS]) -> [f64; 3] {
    let sum = h.iter().fold([0.0; 3], |sum, h| plus(&sum, h));
    sum.map(|x| x / CHANNELS as f64)
}

pub(super) fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn plus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn norm(v: &[f64; 3]) -> f64 {
    m::sqrt(spd::dot(v, v))
}
