//! Track birth: bearings that no track explains, until enough of them agree on an azimuth and a constant rate.
//!
//! In: free bearings. Out: the bearings of a new vessel once [`BIRTH`] of them lie on a straight line in time with
//! residuals as large as their variances allow. A candidate dies when nothing has joined it for [`PATIENCE_S`], so
//! bearings from noise (uniform in azimuth, a few in a hundred instants) do not become vessels.

use super::Heard;
use crate::angle::wrap_pi;
use crate::kit::StraightLine;
use crate::math::f64 as m;

/// Bearings that make a vessel.
pub(super) const BIRTH: usize = 8;
/// Longest silence within a candidate, seconds.
const PATIENCE_S: f64 = 9.0;
/// Fastest bearing rate of any vessel, rad/s: 40 m/s at 200 m.
const FASTEST_RAD_S: f64 = 0.2;
/// Half-width of the gate, standard deviations.
const GATE_SD: f64 = 3.5;
/// Largest bend considered, in units of the rate squared: `α″/α′² = −2 tan φ` for `α = α_c + φ`, `tan φ = q (t − t_c)`,
/// up to φ = 63° from the closest point. A parabola `½α″t²` leaves a root mean square of `α″T²/27` about its line over T.
const BEND: f64 = 4.0;
/// Largest `α″T²` allowed for: more would let scattered bearings pass for a turning vessel.
const MOST_BEND_RAD: f64 = 0.1;
/// Largest weighted mean square of the residuals about the line (8 bearings, 6 degrees of freedom: 0.3 % exceed it).
const ROUGHEST: f64 = 3.3;

/// Bearings that may be one vessel, times relative to the first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    start_s: f64,
    bearings: [(f32, f32, f32); BIRTH],
    len: usize,
}

/// Straight line through a candidate's bearings: azimuth there and its variance.
struct Trend {
    azimuth: f64,
    variance: f64,
    mean_square: f64,
}

impl Candidate {
    pub(super) const fn new() -> Self {
        Self { start_s: 0.0, bearings: [(0.0, 0.0, 0.0); BIRTH], len: 0 }
    }

    /// Starts over with one bearing.
    pub(super) fn begin(&mut self, t_s: f64, heard: &Heard) {
        *self = Self::new();
        self.start_s = t_s;
        self.append(t_s, heard);
    }

    /// Whether this place is free at `t_s`: never used, or its bearings are too old.
    pub(super) fn is_idle(&self, t_s: f64) -> bool {
        self.len == 0 || t_s - self.last_s() > PATIENCE_S
    }

    /// Time of its newest bearing.
    pub(super) fn last_s(&self) -> f64 {
        self.start_s
            + self.len.checked_sub(1).and_then(|i| self.bearings.get(i)).map_or(0.0, |b| f64::from(b.0))
    }

    /// Squared distance of a bearing from what the candidate expects, in variances; `None` outside the gate.
    pub(super) fn distance(&self, t_s: f64, heard: &Heard) -> Option<f64> {
        if self.is_idle(t_s) {
            return None;
        }
        let trend = self.trend(t_s)?;
        let innovation = wrap_pi(heard.azimuth - trend.azimuth);
        let square = innovation * innovation / (trend.variance + heard.variance);
        (square < GATE_SD * GATE_SD).then_some(square)
    }

    /// Adds a bearing (one an instant; a second of the same instant is the same vessel in another band). True once the
    /// candidate is a vessel.
    pub(super) fn join(&mut self, t_s: f64, heard: &Heard) -> bool {
        if t_s <= self.last_s() {
            return false;
        }
        if self.len == BIRTH {
            // Full, but not yet convincing: the oldest makes room.
            let shift = self.bearings.get(1).map_or(0.0, |b| b.0);
            crate::passage::to_front(&mut self.bearings, 1);
            self.len -= 1;
            self.start_s += f64::from(shift);
            for b in &mut self.bearings {
                b.0 -= shift;
            }
        }
        self.append(t_s, heard);
        self.len == BIRTH && self.trend(t_s).is_some_and(|t| t.mean_square < ROUGHEST)
    }

    /// Its bearings: time, azimuth, variance.
    pub(super) fn bearings(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        let all = self.bearings.iter().take(self.len);
        all.map(|b| (self.start_s + f64::from(b.0), f64::from(b.1), f64::from(b.2)))
    }

    fn append(&mut self, t_s: f64, heard: &Heard) {
        if let Some(slot) = self.bearings.get_mut(self.len) {
            *slot = ((t_s - self.start_s) as f32, heard.azimuth as f32, heard.variance as f32);
            self.len += 1;
        }
    }

    /// Least-squares line, extrapolated to `t_s`. With fewer than three bearings the rate is only known to lie below
    /// [`FASTEST_RAD_S`] (a third of it as standard deviation).
    fn trend(&self, t_s: f64) -> Option<Trend> {
        let origin = self.bearings().next()?.1;
        let (mut line, mut variance) = (StraightLine::default(), 0.0);
        for (t, azimuth, v) in self.bearings() {
            line.add(t - t_s, wrap_pi(azimuth - origin), 1.0);
            variance += v;
        }
        let n = self.len as f64;
        variance /= n;
        // The rate's prior as one more observation: zero, with standard deviation FASTEST/3.
        line.add_level(variance / (FASTEST_RAD_S * FASTEST_RAD_S / 9.0));
        let line = line.fit()?;
        let (azimuth, rate) = (line.value, line.slope);
        let mut square = 0.0;
        for (t, a, _) in self.bearings() {
            let r = wrap_pi(a - origin) - line.at(t - t_s);
            square += r * r;
        }
        // The bearing of a straight track bends, which a line cannot: what that may leave counts as error.
        let span = (t_s - self.start_s).max(0.0);
        let bend = (BEND * rate * rate * span * span).min(MOST_BEND_RAD);
        let (within, beyond) = (bend / 27.0, bend / 4.0);
        let mean_square = square / ((variance + within * within) * (n - 2.0).max(1.0));
        let extrapolated = variance * line.var_value + beyond * beyond;
        let at = Trend { azimuth: origin + azimuth, variance: extrapolated, mean_square };
        m::abs(at.azimuth).is_finite().then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_turn_across_north_is_born_and_noise_is_not() {
        let heard = |azimuth: f64| Heard::azimuth(crate::angle::wrap_tau(azimuth), 1e-4);
        let mut candidate = Candidate::new();
        candidate.begin(0.0, &heard(-0.05));
        let mut born = false;
        for k in 1..BIRTH {
            let t = 0.5 * k as f64;
            assert!(candidate.distance(t, &heard(-0.05 + 0.03 * t)).is_some());
            assert!(candidate.distance(t, &heard(1.0)).is_none());
            born = candidate.join(t, &heard(-0.05 + 0.03 * t));
        }
        assert!(born && candidate.bearings().count() == BIRTH);
        assert!(!candidate.join(3.5, &heard(0.0)), "a second bearing of one instant adds nothing");
        assert!(candidate.is_idle(13.0));
    }
}
