//! Starting hypotheses for the track fit, both passing sides.
//!
//! In: bearings in order of time. Out: up to [`STARTS`] lines, best first. The bearings are averaged into a sketch of
//! at most `SKETCH` points and unwrapped; the total turn `Δ` leaves a one-dimensional family of lines, indexed by the
//! direction in mid-window relative to CPA, which is scanned on a grid for the least squared residual.
//! Assumes a bearing every time the vessel turns by less than half a circle. Cost: under 120 candidates of 24 `atan`.

use super::model::{Limits, Line, Medium, PARAMETERS};
use crate::angle::wrap_pi;
use crate::math::f64 as m;

/// Points of the sketch: enough to tell the curvature of the arc, few enough for some hundred candidates.
const SKETCH: usize = 24;
/// Directions tried in mid-window.
const GRID: usize = 17;
/// Hypotheses handed on.
pub const STARTS: usize = 4;

/// A scored line.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The line.
    pub line: Line,
    /// Its squared residual over the sketch, rad².
    pub score: f64,
}

/// Unwrapped averages of consecutive bearings.
struct Sketch {
    t_s: [f64; SKETCH],
    azimuth: [f64; SKETCH],
    n: usize,
}

impl Sketch {
    fn of(bearings: impl Iterator<Item = (f64, f64)>, count: usize) -> Self {
        let per = count.div_ceil(SKETCH).max(1);
        let mut s = Self { t_s: [0.0; SKETCH], azimuth: [0.0; SKETCH], n: 0 };
        let (mut sum_t, mut sum_a, mut held, mut last) = (0.0, 0.0, 0usize, None::<f64>);
        for (i, (t, a)) in bearings.enumerate() {
            // Unwrapped against the running mean of its group, or against the last group.
            let near = if held > 0 { Some(sum_a / held as f64) } else { last };
            sum_a += near.map_or(a, |r| r + wrap_pi(a - r));
            sum_t += t;
            held += 1;
            if held == per || i + 1 == count {
                if let (Some(t_slot), Some(a_slot)) = (s.t_s.get_mut(s.n), s.azimuth.get_mut(s.n)) {
                    *t_slot = sum_t / held as f64;
                    *a_slot = sum_a / held as f64;
                    last = Some(*a_slot);
                    s.n += 1;
                }
                (sum_t, sum_a, held) = (0.0, 0.0, 0);
            }
        }
        s
    }

    fn points(&self) -> impl Iterator<Item = (f64, f64)> + Clone {
        self.t_s.iter().copied().zip(self.azimuth.iter().copied()).take(self.n)
    }

    /// Bearing of CPA that fits best and squared residual of `sense·atan(q (t − t_c))`.
    fn score(&self, sense: f64, q: f64, t_c: f64) -> (f64, f64) {
        let n = self.n as f64;
        let mut residuals = [0.0; SKETCH];
        let mut mean = 0.0;
        for (r, (t, a)) in residuals.iter_mut().zip(self.points()) {
            *r = a - sense * m::atan(q * (t - t_c));
            mean += *r / n;
        }
        (mean, residuals.iter().take(self.n).map(|r| (r - mean) * (r - mean)).sum())
    }
}

/// Lines to start a fit from; `speed_m_s` is the speed they assume. None if there are fewer than three bearings.
pub fn starts(
    bearings: impl Iterator<Item = (f64, f64)>,
    count: usize,
    speed_m_s: f64,
    limits: &Limits,
) -> [Option<Start>; STARTS] {
    let mut found = [None; STARTS];
    let sketch = Sketch::of(bearings, count);
    let mut ends = sketch.points();
    let (Some((t_a, a_a)), Some((t_b, a_b))) = (ends.next(), ends.last()) else { return found };
    let span = t_b - t_a;
    if sketch.n < 3 || span.is_nan() || span <= 0.0 {
        return found;
    }
    let turn = a_b - a_a;
    let least = 0.002_f64.max(0.2 * turn.abs());
    // The turn as seen, its neighbours (noise at the ends), the other way round (a jump over the array, or no turn).
    let opposite = -turn.signum() * (m::TAU - turn.abs());
    let turns = [turn, 0.8 * turn, turn + turn.signum() * least, opposite, -turn.signum() * least];
    for turn in turns {
        let size = turn.abs();
        if !(1e-4..=3.4).contains(&size) {
            continue;
        }
        let size = size.min(3.10);
        let reach = m::FRAC_PI_2 - 0.5 * size - 0.004;
        let mut scores = [(f64::INFINITY, 0.0, 0.0, 0.0); GRID];
        for (k, slot) in scores.iter_mut().enumerate() {
            let middle = reach * (2.0 * k as f64 / (GRID - 1) as f64 - 1.0);
            let (from, to) = (m::tan(middle - 0.5 * size), m::tan(middle + 0.5 * size));
            let q = (to - from) / span;
            let t_c = t_a - from / q;
            let (alpha, score) = sketch.score(turn.signum(), q, t_c);
            *slot = (score, alpha, t_c, q);
        }
        for (k, (score, alpha, t_c, q)) in scores.iter().enumerate() {
            let before = k.checked_sub(1).and_then(|i| scores.get(i)).map_or(f64::INFINITY, |s| s.0);
            let after = scores.get(k + 1).map_or(f64::INFINITY, |s| s.0);
            if *score <= before && *score <= after && q.is_finite() && *q > 0.0 {
                let line = Line { p: [*alpha, *t_c, m::ln(*q), m::ln(speed_m_s), 0.0], sense: turn.signum() };
                insert(&mut found, Start { line: line.moved(&[0.0; PARAMETERS], limits), score: *score });
            }
        }
    }
    found
}

/// Keeps the best few, in order.
fn insert(found: &mut [Option<Start>; STARTS], mut new: Start) {
    for slot in found {
        match slot {
            Some(held) if held.score <= new.score => {}
            Some(held) => core::mem::swap(held, &mut new),
            None => {
                *slot = Some(new);
                return;
            }
        }
    }
}

/// Moves a line's time of CPA from time of reception to time of emission, as the sketch knows nothing of travel time.
pub fn emitted(line: &Line, medium: &Medium) -> Line {
    let mut out = *line;
    out.p[1] -= medium.slowness_s_m * line.cpa_range_m();
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn first_hypothesis_is_near_the_truth_on_both_sides_and_across_north() {
        let limits = Limits {
            range_m: (20.0, 5000.0),
            ln_speed: super::super::model::LN_SPEED,
            times_s: (0.0, 200.0),
        };
        for sense in [1.0, -1.0] {
            for (alpha, t_c, r) in
                [(0.1, 100.0, 500.0), (6.2, -40.0, 300.0), (3.0, 230.0, 900.0), (1.0, 60.0, 40.0)]
            {
                let truth = Line { p: [alpha, t_c, m::ln(7.0 / r), m::ln(7.0), 0.0], sense };
                let medium = Medium::of_sound_speed(f64::INFINITY);
                let b: Vec<_> =
                    (0..400).map(|k| (0.5 * k as f64, truth.azimuth(&medium, 0.5 * k as f64))).collect();
                let best = starts(b.iter().copied(), b.len(), 7.0, &limits)[0].unwrap().line;
                assert_eq!(best.sense, sense);
                let heading = wrap_pi(best.heading_rad() - truth.heading_rad());
                assert!(
                    heading.abs() < 0.2 && (best.cpa_range_m() / r - 1.0).abs() < 0.5,
                    "{best:?} {truth:?}"
                );
            }
        }
    }
}
