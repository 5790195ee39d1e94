//! What the turning of a source that itself changes does to a mean over steps.
//!
//! A bearing is a mean over times of variance σ² about its own: where the sine goes as `ξ + b t + c t²` the mean is `ξ + b t + c (t² + σ²)`
//! (a vessel of 8 m/s 100 m away: 0.003, three deviations). c is fitted to the bearings of the same source in the steps about; what
//! the fit leaves unknown of it is in the deviation. Bearings leave as many steps late as are looked at.

use super::LineBearing;
use seabearing_core::kit::Normal;
use std::collections::VecDeque;

/// Fewest steps to either side, and as many deviations of the times: five bearings leave c some tenths of a bearing's error.
const LEAST_REACH: usize = 3;
const DEVIATIONS: f64 = 1.5;
/// What the next order leaves of c, as a share: over steps to a third of the range over the speed, of ξ a fourth derivative times t² over the second of a straight pass is
/// about one, of which a fourteenth to a quarter stays in c.
const HIGHER: f64 = 0.25;
/// Fewest bearings for three unknowns.
const LEAST: usize = 5;

/// The bearings of a step.
#[derive(Debug)]
pub(super) struct Told {
    /// Variance of the times they are a mean over, s².
    pub(super) variance_s2: f64,
    pub(super) bearings: Vec<LineBearing>,
}

/// Steps whose bearings wait for those after them.
pub(super) struct Bend {
    /// Steps to either side.
    reach: usize,
    /// Difference of sines from one step to the next within which bearings are one source's.
    near: f64,
    told: VecDeque<Told>,
    next: usize,
}

impl Bend {
    /// Of bearings that rest on times of such a deviation at most, with such steps (s) and beam.
    pub(super) fn new(deviation_s: f64, step_s: f64, beam: f64) -> Self {
        let reach = ((DEVIATIONS * deviation_s / step_s).ceil() as usize).max(LEAST_REACH);
        Self { reach, near: 0.5 * beam, told: VecDeque::new(), next: 0 }
    }

    /// Takes a step's bearings; gives those of the step that has enough after it.
    pub(super) fn push(&mut self, told: Told) -> Vec<LineBearing> {
        self.told.push_back(told);
        if self.told.len() > self.next + self.reach { self.straighten() } else { Vec::new() }
    }

    /// No step follows at once: gives the rest.
    pub(super) fn end(&mut self) -> Vec<LineBearing> {
        let mut out = Vec::new();
        while self.next < self.told.len() {
            out.extend(self.straighten());
        }
        self.told.clear();
        self.next = 0;
        out
    }

    fn straighten(&mut self) -> Vec<LineBearing> {
        let Some(own) = self.told.get(self.next) else { return Vec::new() };
        let straight = |b: &LineBearing| {
            let Some((bend, sd)) = self.bend(b) else { return *b };
            let off = bend * own.variance_s2;
            let sd = b.sd.hypot(sd * own.variance_s2).hypot(HIGHER * off);
            LineBearing { sine: (b.sine - off).clamp(-1.0, 1.0), sd, ..*b }
        };
        let out = own.bearings.iter().map(straight).collect();
        self.next += 1;
        while self.next > self.reach {
            self.told.pop_front();
            self.next -= 1;
        }
        out
    }

    /// Coefficient c of a source's sine, 1/s², and its deviation; `None` where too few steps have it.
    fn bend(&self, own: &LineBearing) -> Option<(f64, f64)> {
        let mut normal = Normal::<3>::default();
        let mut n = 1;
        let mut take = |b: &LineBearing, variance_s2: f64| {
            let t_s = b.t_s - own.t_s;
            normal.observe(&[1.0, t_s, t_s * t_s + variance_s2], b.sine - own.sine, 1.0 / (b.sd * b.sd));
        };
        take(own, self.told.get(self.next)?.variance_s2);
        let earlier = (self.next.saturating_sub(self.reach)..self.next).rev();
        let later = self.next + 1..=self.next + self.reach;
        for side in [&mut earlier.into_iter() as &mut dyn Iterator<Item = usize>, &mut later.into_iter()] {
            let mut last = own;
            for k in side {
                let Some(Told { variance_s2, bearings }) = self.told.get(k) else { break };
                let away = |b: &&LineBearing| (b.sine - last.sine).abs();
                let nearest = bearings.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
                let Some(nearest) = nearest.filter(|b| away(b) < self.near) else { break };
                take(nearest, *variance_s2);
                last = nearest;
                n += 1;
            }
        }
        if n < LEAST {
            return None;
        }
        let solution = normal.solution()?;
        let bend = solution[2];
        // What goes about the fit by more than it says leaves less of it.
        let misfit = (normal.cost() - normal.fall(&solution)) / (n - 3) as f64;
        let variance = normal.covariance(&[true; 3], &[0.0; 3])?[2][2] * misfit.max(1.0);
        (bend.is_finite() && variance.is_finite()).then(|| (bend, variance.max(0.0).sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bearings that are means over times of a variance of 0.9 s² of two sources, one of which turns ever faster.
    fn told(k: u32) -> Told {
        let t_s = f64::from(k);
        let noise = |seed: f64| 0.001 * (7.3 * t_s * t_s + seed).sin();
        let of = |source: usize, sine: f64| LineBearing {
            t_s,
            source,
            sine,
            sd: 0.0007,
            snr_db: 10.0,
            frequencies: 1,
        };
        let turning = 0.3 - 0.004 * ((t_s - 10.0).powi(2) + 0.9) + noise(0.0);
        let mut bearings = vec![of(0, turning), of(1, -0.6 + noise(1.0))];
        if k.is_multiple_of(3) {
            bearings.swap(0, 1);
        }
        Told { variance_s2: 0.9, bearings }
    }

    #[test]
    fn a_mean_of_a_curve_is_put_on_it_and_a_straight_way_stays() {
        let mut bend = Bend::new(0.95, 1.0, 0.2);
        let mut out: Vec<LineBearing> = (0..20).flat_map(|k| bend.push(told(k))).collect();
        assert_eq!(out.len(), 34);
        out.extend(bend.end());
        assert_eq!(out.len(), 40);
        let (mut turning, mut straight) = (0.0, 0.0);
        for b in &out {
            if b.sine > -0.5 {
                turning += (b.sine - 0.3 + 0.004 * (b.t_s - 10.0).powi(2)) / 20.0;
            } else {
                straight += (b.sine + 0.6) / 20.0;
            }
            assert!(b.sd < 0.0014, "{b:?}");
        }
        assert!(turning.abs() < 0.0007 && straight.abs() < 0.0005, "{turning} {straight}");
        // Few steps tell no bend.
        let alone = bend.push(told(3)).len() + bend.end().len();
        assert_eq!(alone, 2);
    }
}
