//! The recorder's passage fit on bearings of which single ones may be wrong, and nobody else's.
//!
//! In: measurements in order of time. Out: the track, and how many were refused. A measurement beyond the gate is refused.
//! A young passage may have begun with a wrong one, or run into a wrong arc: it is searched afresh, and after three refusals
//! in a row that nothing explains together with the rest it begins again with those.

use super::solution::Solution;
use crate::angle::wrap_pi;
use seabearing_core::passage::{Config, Measurement, Passage, RECORDED};

/// Refusals in a row with which a young passage begins again.
const BEGIN_AGAIN: usize = 3;

/// The only vessel there is.
pub struct Lone {
    config: Config,
    gate_sd: f64,
    passage: Passage<RECORDED>,
    held: heapless::Vec<Measurement, BEGIN_AGAIN>,
    taken: usize,
    seen: usize,
}

impl Lone {
    /// Nothing seen; `gate_sd` infinite refuses nothing.
    pub fn new(config: Config, gate_sd: f64) -> Self {
        Self { config, gate_sd, passage: Passage::new(), held: heapless::Vec::new(), taken: 0, seen: 0 }
    }

    /// Takes a measurement.
    pub fn take(&mut self, heard: &Measurement) {
        self.seen += 1;
        if self.gated(heard) {
            self.keep(heard);
            return;
        }
        if !self.passage.is_young() {
            return;
        }
        if self.passage.reconsider(&self.config, heard) == Some(true) {
            self.taken += 1;
            self.held.clear();
            return;
        }
        if self.held.push(*heard).is_ok() && self.held.is_full() {
            (self.passage, self.taken) = (Passage::new(), 0);
            for heard in core::mem::take(&mut self.held) {
                self.keep(&heard);
            }
        }
    }

    /// The track, and how many measurements it does without.
    pub fn finish(mut self) -> (Option<Solution>, usize) {
        (self.passage.finish(&self.config), self.seen - self.taken)
    }

    fn gated(&self, heard: &Measurement) -> bool {
        let Some((azimuth, variance)) = self.passage.expected(&self.config, heard.t_s) else { return true };
        let white =
            if self.config.extra_tau_s > 0.0 { 0.0 } else { self.config.extra_sd_rad * heard.extra_scale };
        let variance = variance + heard.variance_rad2 + white * white;
        let off = wrap_pi(heard.azimuth_rad - azimuth);
        off * off <= self.gate_sd * self.gate_sd * variance
    }

    fn keep(&mut self, heard: &Measurement) {
        if self.passage.push(&self.config, heard) {
            self.taken += 1;
            self.held.clear();
            while self.passage.work(&self.config) {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::motion::Line;

    #[test]
    fn no_passage_is_shut_out_by_its_first_bearings() {
        let config = Config { speed_m_s: 7.0, speed_sd_m_s: 0.0, extra_sd_rad: 0.0, ..Config::default() };
        let truth = Line { p: [5.5, 100.0, (7.0f64 / 500.0).ln(), 7f64.ln(), 0.0], sense: 1.0 };
        let mut state = 21u64;
        let mut noise = || {
            let draws = (0..12).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            });
            draws.sum::<f64>() - 6.0
        };
        for run in 0..60 {
            let mut lone = Lone::new(config, 5.0);
            for k in 0..120 {
                let t_s = 0.5 * f64::from(k);
                // In every third passage one of the first bearings is a wrong peak.
                let wrong = if run % 3 == 0 && k == run / 10 { 1.0 } else { 0.0 };
                let azimuth = truth.azimuth(&config.medium, t_s) + 0.0017 * noise() + wrong;
                lone.take(&Measurement::azimuth(t_s, azimuth, 3e-6));
            }
            let (track, refused) = lone.finish();
            assert!(track.is_some() && refused < 30, "{run}: {refused}");
        }
    }
}
