//! Manoeuvre: bearings that leave the line on which the vessel was seen before.
//!
//! In: each bearing of a track. Out: since when the vessel is off its line, if it is. The bearings are compared with a
//! *reference*: the fit as it stood 20 to 40 s ago, which a turn since then cannot have bent. Their residuals are
//! averaged exponentially over [`MEMORY_S`]; the average's standard deviation follows from the bearings' white and
//! coloured errors and the reference's own uncertainty. More than [`SUSPECT_SD`] of them for [`SUSTAINED_S`] is a
//! suspicion. It is a manoeuvre only if two lines, before and after, explain all bearings better than any single line by
//! [`LEAST_GAIN`]: the reference may have been the wrong one of two arcs. Assumes the bearings' errors are as large as
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
        }
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
