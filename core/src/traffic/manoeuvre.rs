//! Manoeuvre: bearings that leave the line on which the vessel was seen before.
//!
//! In: each bearing of a track. Out: since when the vessel is off its line, if it is. The bearings are compared with a
//! *reference*: the fit as it stood 20 to 40 s ago, which a turn since then cannot have bent. Their residuals are
//! averaged exponentially over [`MEMORY_S`]; the average's standard deviation follows from the bearings' white and
//! coloured errors and the reference's own uncertainty. More than [`SUSPECT_SD`] of them for [`SUSTAINED_S`] is a
//! suspicion. It is a manoeuvre only if two lines, before and after, explain all bearings better than any single line by
//! [`LEAST_GAIN`]: the reference may have been the wrong one of two arcs. A change of speed that takes longer bends the reference with
//! it and never stands out of the bearings' mean: every [`TRIED_S`] the lines are polished and two near the best are tried before and after the middle of the
//! passage, and the next time its last quarter; a gain of [`SLOW_GAIN`] is a suspicion. Assumes the bearings' errors are as large as
//! reported; a track shorter than [`LEAST_S`] is not tested.

use super::track::Passage;
use crate::angle::wrap_pi;
use crate::math::f64 as m;
use crate::passage::{Config, Known};

/// Time between references, seconds.
const REFERENCE_S: f64 = 20.0;
/// Memory of the mean residual, seconds.
const MEMORY_S: f64 = 8.0;
/// Standard deviations of the mean residual that raise a suspicion.
const SUSPECT_SD: f64 = 3.5;
/// Fall of the weighted squared residual that proves it. Three more parameters and the time of the cut lower it by about
/// 5 by chance; 30 happens once in 10⁵.
pub(super) const LEAST_GAIN: f64 = 30.0;
/// The same where nothing but the two lines speaks for it. Elevations that lie off by something else as the vessel passes (a wrong place of the
/// array, an echo) gain up to 40.
const SLOW_GAIN: f64 = 45.0;
/// Time from one trial of two lines to the next, seconds.
const TRIED_S: f64 = 30.0;
/// What two lines gain by chance, and of how many parameters: a gain of so many times it widens what the one line states as many times.
const CHANCE_GAIN: f64 = 4.0;
/// And no further: it is parted before.
const MOST_MISFIT: f64 = 25.0;
/// Time until a refuted suspicion may be raised again, seconds.
const RESPITE_S: f64 = 5.0;
/// Seconds for which they must be exceeded.
const SUSTAINED_S: f64 = 2.0;
/// Length of track below which a reference says too little, seconds.
const LEAST_S: f64 = 40.0;

/// The test's memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Manoeuvre {
    reference: Option<Known>,
    pending: Option<Known>,
    renewed_s: f64,
    last_s: f64,
    mean: f64,
    white: f64,
    since_s: Option<f64>,
    respite_s: f64,
    /// When two lines were last tried.
    tried_s: f64,
    /// Whether about the middle of the passage.
    in_middle: bool,
    /// What two lines gained the last time about the last quarter, about the middle, and when they took the place of one that the vessel had left
    /// slowly: it may go on doing so.
    gains: [f32; 3],
}

impl Manoeuvre {
    pub(super) const fn new() -> Self {
        Self {
            reference: None,
            pending: None,
            renewed_s: 0.0,
            last_s: 0.0,
            mean: 0.0,
            white: 0.0,
            since_s: None,
            respite_s: 0.0,
            tried_s: 0.0,
            in_middle: false,
            gains: [0.0; 3],
        }
    }

    /// Whether two lines are to be tried now.
    pub(super) fn is_due(&self, passage: &Passage) -> bool {
        let (first_s, newest_s) = passage.times_s();
        newest_s - first_s >= LEAST_S && newest_s - self.tried_s >= TRIED_S
    }

    /// Tries two lines: when the vessel seems to have left its line and by how much the proof has to gain, if they explain the bearings better.
    /// By as much as they do the passage doubts what it tells.
    pub(super) fn tried(&mut self, config: &Config, passage: &mut Passage) -> Option<(f64, f64)> {
        let (first_s, newest_s) = passage.times_s();
        self.tried_s = newest_s;
        self.in_middle = !self.in_middle;
        let newer = if self.in_middle { 0.5 } else { 0.25 };
        let at_s = newest_s - newer * (newest_s - first_s);
        let gain = passage.gain_of_two(config, at_s)?;
        let [quarter, middle, _] = &mut self.gains;
        *(if self.in_middle { middle } else { quarter }) = gain as f32;
        passage.set_misfit(self.misfit());
        (gain > SLOW_GAIN).then_some((at_s, SLOW_GAIN))
    }

    /// Of what follows a proof that had to gain this, and the passage that tells it.
    pub(super) fn after(&self, gain: f64, newer: &mut Passage) -> Self {
        let slowly = if gain > LEAST_GAIN { self.most() as f32 } else { 0.0 };
        let after = Self { gains: [0.0, 0.0, slowly], ..Self::new() };
        newer.set_misfit(after.misfit());
        after
    }

    fn misfit(&self) -> f64 {
        (self.most() / CHANCE_GAIN).clamp(1.0, MOST_MISFIT)
    }

    fn most(&self) -> f64 {
        self.gains.iter().fold(0.0, |most, gain| most.max(f64::from(*gain)))
    }

    /// The fit before the vessel left its line, if it did.
    pub(super) fn reference(&self) -> Option<&Known> {
        self.reference.as_ref()
    }

    /// Takes a bearing of the track (already part of `passage`). Answers since when the vessel seems to have left its line.
    pub(super) fn test(
        &mut self,
        config: &Config,
        passage: &Passage,
        t_s: f64,
        azimuth: f64,
        variance: f64,
    ) -> Option<f64> {
        if t_s - passage.times_s().0 < LEAST_S {
            self.renewed_s = t_s;
            self.last_s = t_s;
            return None;
        }
        if t_s - self.renewed_s >= REFERENCE_S && self.since_s.is_none() {
            self.reference = self.pending;
            self.pending = passage.best().copied();
            self.renewed_s = t_s;
            (self.mean, self.white) = self.against_new_reference(config, passage, t_s);
        }
        let step_s = (t_s - self.last_s).max(0.0);
        self.last_s = t_s;
        let reference = self.reference.as_ref()?;
        let (expected, line_variance) = reference.azimuth(config, t_s);
        let gain = 1.0 - m::exp(-step_s.min(MEMORY_S) / MEMORY_S);
        self.mean += gain * (wrap_pi(azimuth - expected) - self.mean);
        let (coloured, tau_s, extra) = config.errors();
        self.white = (1.0 - gain) * (1.0 - gain) * self.white + gain * gain * (variance + extra);
        let spread = self.white + coloured * tau_s / (tau_s + MEMORY_S) + line_variance;
        if self.mean * self.mean < SUSPECT_SD * SUSPECT_SD * spread {
            self.since_s = None;
            return None;
        }
        let since_s = *self.since_s.get_or_insert(t_s);
        if t_s - since_s < SUSTAINED_S || t_s < self.respite_s {
            return None;
        }
        let onset_s = onset(config, reference, passage, t_s);
        self.respite_s = t_s + RESPITE_S;
        Some(onset_s)
    }

    /// Mean residual and its white variance as they would stand had the new reference been used all along.
    fn against_new_reference(&self, config: &Config, passage: &Passage, t_s: f64) -> (f64, f64) {
        let Some(reference) = &self.reference else { return (0.0, 0.0) };
        let (mut sum, mut weights, mut white) = (0.0, 0.0, 0.0);
        for node in passage.averages() {
            let at = passage.times_s().0 + node.t_s;
            let weight = m::exp(((at - t_s) / MEMORY_S).min(0.0));
            sum += weight * wrap_pi(node.azimuth - reference.azimuth(config, at).0);
            white += weight * weight * node.white;
            weights += weight;
        }
        if weights > 1e-6 { (sum / weights, white / (weights * weights)) } else { (0.0, 0.0) }
    }
}

/// When the vessel left its line: the newest bearing that still lies on it or on its other side.
fn onset(config: &Config, reference: &Known, passage: &Passage, t_s: f64) -> f64 {
    let mut sign = 0.0;
    for node in passage.averages().rev() {
        let at = passage.times_s().0 + node.t_s;
        let (expected, line_variance) = reference.azimuth(config, at);
        let residual = wrap_pi(node.azimuth - expected);
        let spread = node.white + line_variance;
        if sign == 0.0 {
            sign = residual.signum();
        }
        if residual * sign < m::sqrt(spread) && at < t_s - SUSTAINED_S {
            return at;
        }
    }
    t_s - REFERENCE_S
}
