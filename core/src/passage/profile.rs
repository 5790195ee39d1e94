//! How far the heading may be from the best line's: what other headings cost.
//!
//! In: the best line of a passage. Out: a standard deviation of its heading, radians. While a vessel has hardly turned, every heading with its own
//! closest point explains the bearings nearly as well, and where noise looks like an arc the curvature of the likelihood there says that it is
//! known to a few degrees. So the heading is held [`FAR_SD`] deviations to either side, all else is fitted, and the deviation is the one at which a
//! parabola would have risen as much: `|d| / √Δ`. A vessel is taken to pass as likely in one distance as in another, so that an arc as of one near by has
//! to be told by its bearings. With what follows from the heading along that ridge it widens a solution.
//!
//! Without it 88 % of the headings of vessels that go straight were in their 95 %, and 46 % of those told in the first minute
//! (`seabearing reproduce several-vessels`). Cost: two fits of one line, a few seconds apart, while the heading is known to no better than [`SURE_RAD`].

use super::Passage;
use super::settings::Config;
use crate::math::f64 as m;
use crate::motion::normal::Matrix;

/// Deviations by which the heading is held aside, and no farther than this, radians.
const FAR_SD: f64 = 4.0;
const FARTHEST_RAD: f64 = 1.2;
/// A rise that is none: nothing tells the heading.
const LEAST_RISE: f64 = 0.01;
/// A heading with less spread has the deviation of its line, radians (3°).
const SURE_RAD: f64 = 0.05;
/// Time between profiles, seconds.
const PROFILED_S: f64 = 5.0;
/// Steps of a fit with its heading held.
const HELD_STEPS: usize = 6;

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
        let (covariance, own) = (best.covariance(), best.heading_sd_rad());
        let far = (FAR_SD * own).min(FARTHEST_RAD);
        let mut sd = own;
        for aside in [-far, far] {
            if let Some(rise) = problem.rise(&best.line, &along_heading(&covariance, aside), HELD_STEPS) {
                sd = sd.max(far / m::sqrt(rise.max(LEAST_RISE)));
            }
        }
        self.heading_sd = sd as f32;
    }

    /// A covariance whose heading has at least the deviation profiled, and whatever goes with it as much more.
    pub(super) fn with_profile(&self, covariance: &Matrix) -> Matrix {
        let known = covariance[0][0];
        let more = f64::from(self.heading_sd) * f64::from(self.heading_sd) - known;
        let mut wider = *covariance;
        if more > 0.0 && known > 0.0 {
            let ridge = along_heading(covariance, m::sqrt(more));
            for (row, a) in wider.iter_mut().zip(&ridge) {
                row.iter_mut().zip(&ridge).for_each(|(c, b)| *c += a * b);
            }
        }
        wider
    }
}

/// What the parameters are moved by where the heading is moved by this, by their covariance.
fn along_heading<const P: usize>(covariance: &[[f64; P]; P], aside: f64) -> [f64; P] {
    covariance.map(|row| row.first().map_or(0.0, |c| aside * c / covariance[0][0]))
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

    #[test]
    fn a_profile_widens_the_heading_and_what_goes_with_it() {
        let mut passage = Passage::<64>::new();
        let mut known = [[0.0; 5]; 5];
        (0..5).for_each(|k| known[k][k] = 0.01);
        (known[0][1], known[1][0]) = (0.005, 0.005);
        assert_eq!(passage.with_profile(&known), known);
        passage.heading_sd = 0.2;
        let wider = passage.with_profile(&known);
        assert!(
            (wider[0][0] - 0.04).abs() < 1e-6
                && (wider[0][1] - 0.02).abs() < 1e-6
                && (wider[1][1] - 0.0175).abs() < 1e-6
        );
        assert!((wider[2][2] - 0.01).abs() < 1e-9);
    }
}
