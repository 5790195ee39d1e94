//! Continuity in time of the bearings of one vessel: what the last accepted ones say about the next.
//!
//! Enters: times and directions of consistent solutions. Leaves: a predicted direction with a gate, and a verdict on each
//! new solution. The prediction is a straight line in time through the recent accepted directions; solutions that stay
//! outside its gate build a rival hypothesis, which takes over when it is consistent for longer than chance allows and
//! the main one has fallen silent. Fixed memory.

use super::wavefront::{self, Direction};
use crate::kit::StraightLine;
use crate::math::f32 as m;

/// Accepted bearings remembered.
const REMEMBERED: usize = 16;
/// Seconds after which a remembered bearing says nothing.
const MEMORY_S: f64 = 30.0;
/// Bearings a hypothesis needs before it predicts.
const ESTABLISHED: usize = 3;
/// Gate about the prediction at no delay, radians: 6°, well beyond a good set's error and inside what a wrong pair does.
const GATE_RAD: f32 = 0.105;
/// Widening of the gate with the time since the last bearing, radians a second (a pass at 100 m turns by 4°/s at most).
const GATE_RATE_RAD_S: f32 = 0.01;
/// Widest gate, radians.
const GATE_MOST_RAD: f32 = 0.35;
/// Sets over which the variance of a delay is averaged.
const LEARNT_FROM: f32 = 64.0;
/// Sets over which errors of single hydrophones are averaged: a lasting one shows differently from other directions.
const SHARED_FROM: f32 = 1024.0;
/// Bearings in a row a rival needs before it replaces the main hypothesis.
const RIVAL_NEEDS: usize = 6;

/// Where the next bearing is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedDirection {
    /// Expected direction.
    pub direction: Direction,
    /// Angle about it within which a solution continues the track, radians.
    pub gate: f32,
    /// Its variance, in units of that of one bearing: what those that it is made of have of their own.
    pub variance: f32,
}

/// One hypothesis: a ring of recent directions.
#[derive(Clone, Copy, Debug)]
struct Hypothesis {
    times: [f64; REMEMBERED],
    directions: [Direction; REMEMBERED],
    count: usize,
}

/// Memory of the recent bearings (about 700 bytes).
#[derive(Clone, Debug)]
pub struct Continuity {
    main: Hypothesis,
    rival: Hypothesis,
    residual_s2: f32,
    about_s2: f32,
    learnt: f32,
    /// What the residuals have that is of single hydrophones, s², and over how many sets.
    shared_s2: f32,
    shared: f32,
}

impl Continuity {
    /// Knows nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            main: Hypothesis::new(),
            rival: Hypothesis::new(),
            residual_s2: 0.0,
            about_s2: 0.0,
            learnt: 0.0,
            shared_s2: 0.0,
            shared: 0.0,
        }
    }

    /// Where the next bearing is expected at `t_s`; `None` before three bearings or after a long silence.
    pub fn predict(&self, t_s: f64) -> Option<ExpectedDirection> {
        self.main.predict(t_s)
    }

    /// Takes a consistent solution; answers whether it is accepted.
    pub fn judge(&mut self, t_s: f64, direction: &Direction) -> bool {
        match self.main.predict(t_s) {
            Some(p) if within(&p, direction) => {
                self.main.add(t_s, direction);
                self.rival.count = 0;
                true
            }
            Some(_) => {
                let continues = self.rival.last_near(t_s, direction);
                if !continues {
                    self.rival.count = 0;
                }
                self.rival.add(t_s, direction);
                if self.rival.count >= RIVAL_NEEDS {
                    self.main = self.rival;
                    self.rival.count = 0;
                    return true;
                }
                false
            }
            // Not established: a bearing near the last one builds, another one starts afresh.
            None => {
                if !self.main.last_near(t_s, direction) {
                    self.main.count = 0;
                }
                self.main.add(t_s, direction);
                self.main.count >= ESTABLISHED
            }
        }
    }

    /// Takes an accepted set into the mean variance of a delay: its residual over `pairs` pairs, and, where there was a
    /// prediction, the squared distance from it in units of a delay's variance, less what the prediction itself errs by. Errors that
    /// all pairs share leave no residual; they show as scatter about the prediction.
    pub fn learn_scatter(&mut self, residual_s: f32, pairs: u32, about_prediction_s2: Option<f32>) {
        let n = pairs as f32;
        let variance = residual_s * residual_s * n / (n - 2.0).max(1.0);
        self.learnt = (self.learnt + 1.0).min(LEARNT_FROM);
        self.residual_s2 += (variance - self.residual_s2) / self.learnt;
        if let Some(square) = about_prediction_s2.filter(|s| s.is_finite()) {
            self.about_s2 += (square - self.about_s2) / self.learnt;
        }
    }

    /// Takes what an accepted set of all pairs has of errors of single hydrophones (their places, their clocks): the part of its
    /// residual that closes around every triangle, s², one degree of freedom. Errors of pairs close around none, so that the
    /// mean over all residuals makes too little of those of hydrophones, all of which are in the direction. Such errors last: the mean
    /// is over many sets.
    pub fn learn_shared(&mut self, square_s2: f32) {
        self.shared = (self.shared + 1.0).min(SHARED_FROM);
        self.shared_s2 += (square_s2 - self.shared_s2) / self.shared;
    }

    /// Mean variance of a pair's delay over recent accepted sets, s²: the largest of what residuals, what their part of single
    /// hydrophones (less `told_s2`, which is reckoned with elsewhere), and what scatter about the predictions say.
    pub fn scatter_s2(&self, told_s2: f32) -> f32 {
        self.residual_s2.max(self.about_s2).max(self.shared_s2 - told_s2)
    }
}

fn within(p: &ExpectedDirection, direction: &Direction) -> bool {
    wavefront::dot(&p.direction, direction) >= m::cos(p.gate)
}

impl Hypothesis {
    const fn new() -> Self {
        Self { times: [0.0; REMEMBERED], directions: [[0.0; 3]; REMEMBERED], count: 0 }
    }

    /// Appends, the oldest falling out.
    fn add(&mut self, t_s: f64, direction: &Direction) {
        if self.count >= REMEMBERED {
            self.times.copy_within(1.., 0);
            self.directions.copy_within(1.., 0);
            self.count = REMEMBERED - 1;
        }
        if let (Some(t), Some(d)) = (self.times.get_mut(self.count), self.directions.get_mut(self.count)) {
            *t = t_s;
            *d = *direction;
            self.count += 1;
        }
    }

    fn last(&self) -> Option<(f64, Direction)> {
        let n = self.count.checked_sub(1)?;
        Some((*self.times.get(n)?, *self.directions.get(n)?))
    }

    /// Whether a direction is within the gate of the last one.
    fn last_near(&self, t_s: f64, direction: &Direction) -> bool {
        self.last().is_some_and(|(at, last)| {
            let age = t_s - at;
            (0.0..=MEMORY_S).contains(&age) && wavefront::dot(&last, direction) >= m::cos(gate(age as f32))
        })
    }

    fn predict(&self, t_s: f64) -> Option<ExpectedDirection> {
        let (at, last) = self.last()?;
        let age = t_s - at;
        if self.count < ESTABLISHED || !(0.0..=MEMORY_S).contains(&age) {
            return None;
        }
        // Straight lines in time through the three components, about the newest time.
        let mut lines = [StraightLine::default(); 3];
        let mut n = 0u32;
        for (t, d) in self.times.iter().zip(&self.directions).take(self.count) {
            if t - at < -MEMORY_S {
                continue;
            }
            n += 1;
            for (line, x) in lines.iter_mut().zip(d) {
                line.add(t - at, f64::from(*x), 1.0);
            }
        }
        let mut v = last;
        let mut variance = 1.0 / f64::from(n.max(1));
        for (x, line) in v.iter_mut().zip(&lines) {
            // A slope needs a stretch of time; below five bearings the mean of what there is predicts better.
            match line.fit().filter(|_| n >= 5) {
                Some(sloped) => {
                    *x = sloped.at(age) as f32;
                    // Of the same times, the same for all three.
                    variance = sloped.var_value + age * (2.0 * sloped.cov + age * sloped.var_slope);
                }
                None => *x = line.mean().unwrap_or(0.0) as f32,
            }
        }
        let length = m::sqrt(wavefront::dot(&v, &v));
        (length > 0.5).then(|| ExpectedDirection {
            direction: v.map(|x| x / length),
            gate: gate(age as f32),
            variance: variance as f32,
        })
    }
}

/// The gate so many seconds after the last bearing.
fn gate(age_s: f32) -> f32 {
    (GATE_RAD + GATE_RATE_RAD_S * age_s).min(GATE_MOST_RAD)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prediction_says_how_far_it_scatters() {
        let expected = |bearings: usize, ahead_s: f64| {
            let mut h = Hypothesis::new();
            for n in 0..bearings {
                h.add(n as f64, &[1.0, 0.0, 0.0]);
            }
            h.predict(bearings as f64 - 1.0 + ahead_s).unwrap().variance
        };
        // The mean of four; lines through n even steps, one step and ten beyond: (4n + 2) / (n (n − 1)) one step beyond.
        assert!((expected(4, 1.0) - 0.25).abs() < 1e-6);
        assert!((expected(5, 1.0) - 22.0 / 20.0).abs() < 1e-5);
        assert!((expected(16, 1.0) - 66.0 / 240.0).abs() < 1e-5);
        assert!((expected(16, 10.0) - (1.0 / 16.0 + 17.5f32.powi(2) / 340.0)).abs() < 1e-5);
    }
}
