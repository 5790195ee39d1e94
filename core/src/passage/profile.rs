//! When the heading of a passage's best line is profiled ([`crate::motion::profile`]): every few seconds while it is not sure.

use super::Passage;
use super::settings::Config;
use crate::math::f64 as m;
use crate::motion::normal::Matrix;
use crate::motion::profile::{heading_sd_rad, widened};

/// A heading with less spread has the deviation of its line, radians (3°).
const SURE_RAD: f64 = 0.05;
/// Time between profiles, seconds.
const PROFILED_S: f64 = 5.0;

impl<const N: usize> Passage<N> {
    /// Whether the heading is to be profiled now. One that has become sure no longer needs to be.
    pub(super) fn is_profile_due(&mut self) -> bool {
        let Some(best) = self.best() else { return false };
        if best.heading_sd_rad() < SURE_RAD && f64::from(self.heading_sd) < SURE_RAD {
            self.heading_sd = 0.0;
            return false;
        }
        let since_s = m::abs(self.last_s - self.origin_s - f64::from(self.profiled_s));
        self.heading_sd <= 0.0 || since_s >= PROFILED_S
    }

    /// Profiles the heading of the best line.
    #[inline(never)]
    pub(super) fn profile(&mut self, config: &Config) {
        self.profiled_s = (self.last_s - self.origin_s) as f32;
        let links = self.links(config);
        let problem = self.problem(config, &links);
        let Some(best) = self.best() else { return };
        let (free, limits) = (config.free(), &problem.limits);
        let sd = heading_sd_rad(&best.line, &best.covariance(), &free, limits, |line| problem.evaluate(line));
        self.heading_sd = sd as f32;
    }

    /// A covariance of the best line with the deviation of the heading that was found.
    pub(super) fn with_profile(&self, covariance: &Matrix) -> Matrix {
        widened(covariance, f64::from(self.heading_sd))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::{RAD_PER_DEG, wrap_pi};
    use crate::passage::Measurement;

    /// Running headings of vessels that go north 1500 m to the east at 7 m/s, from 60 s before their closest point on, heard for `heard_s` with
    /// errors of 0.9°: told, and of these within 1.96 of their deviations.
    fn headings(heard_s: f64) -> (usize, usize) {
        let config = Config { speed_m_s: 7.0, speed_sd_m_s: 2.0, ..Config::default() };
        let sd = 0.9 * RAD_PER_DEG;
        let (mut told, mut right) = (0, 0);
        for run in 0..60u32 {
            let mut seed = 77 + run;
            let mut uniform = || {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f64::from(seed >> 8) / f64::from(1 << 24)
            };
            let mut passage = Passage::<64>::new();
            let mut t_s = 0.0;
            while t_s < heard_s {
                let error = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                let azimuth = m::atan2(1500.0, 7.0 * (t_s - 60.0));
                passage.push(&config, &Measurement::azimuth(t_s, azimuth + sd * error, sd * sd));
                while passage.work(&config) {}
                t_s += 0.5;
            }
            let Some(solution) = passage.solution(&config).filter(|s| s.sd_heading_rad.is_finite()) else {
                continue;
            };
            told += 1;
            right += usize::from(m::abs(wrap_pi(solution.heading_rad)) < 1.96 * solution.sd_heading_rad);
        }
        (told, right)
    }

    #[test]
    fn an_arc_that_noise_makes_tells_no_heading() {
        // Of 60 each; by the curvature of the likelihood alone 25, 59, 60, 60 are told and 24, 58, 43, 33 of them wrong.
        for heard_s in [12.0, 20.0, 30.0, 45.0] {
            let (told, right) = headings(heard_s);
            assert!(told - right <= 5, "{heard_s} s: {right} of {told}");
        }
    }

    #[test]
    fn what_a_whole_passage_tells_is_told_and_right() {
        let (told, right) = headings(240.0);
        assert!(told == 60 && (53..=60).contains(&right), "{right} of {told}");
    }
}
