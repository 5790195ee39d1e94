//! Maximum likelihood with heavy tails: single wrong bearings hardly pull.
//!
//! In: what [`super::ml::fit`] takes, and memory for one copy of the samples. Out: the same fit, and how many bearings it
//! holds for wrong. Errors are Student-t with [`FREEDOM`] degrees of freedom and the stated standard deviation as their
//! scale: real bearings have such tails (`seabearing reproduce difar`). The likelihood is climbed by reweighting,
//! `σ_k² ← σ_k² (ν + r_k²/σ_k²)/(ν + 1)`, from a scale eight times as wide, so that the first fit is not lost to the
//! wrong bearings. Assumes that fewer than half of the bearings are wrong, and independent errors: under a correlated model a
//! weight scales the correlated error itself, which invents information. Cost: about ten fits.

use super::ml::{Config, Fit, FitError, Sample, fit, refit};
use super::model::{Expected, Line, Medium};
use super::whiten::Workspace;
use crate::angle::wrap_pi;
use crate::kit::Student;
use crate::math::f64 as m;

/// Degrees of freedom: the fewest for which the variance of the variance exists is four; tails as of real buoys.
pub const FREEDOM: f64 = 4.0;
/// Errors of the bearings.
pub const STUDENT: Student = Student { freedom: FREEDOM };
/// Widening of the scale in successive fits.
const SCALES: [f64; 3] = [8.0, 4.0, 2.0];
/// Most fits at the final scale.
const STEPS: usize = 12;
/// A bearing with a residual beyond this many standard deviations counts as wrong.
const WRONG_SD: f64 = 4.0;

/// A fit with heavy tails.
#[derive(Clone, Copy, Debug)]
pub struct RobustFit {
    /// The fit; its covariance is that of the reweighted bearings.
    pub fit: Fit,
    /// Bearings farther from the track than `WRONG_SD` standard deviations.
    pub wrong: usize,
}

/// Fits the track. `weighted` is as long as `samples` and is overwritten by them with their reweighted errors.
///
/// # Errors
/// As [`super::ml::fit`]; [`FitError::TooFew`] also where `weighted` is too short.
pub fn fit_robust<const N: usize>(
    config: &Config,
    samples: &[Sample],
    weighted: &mut [Sample],
    work: &mut Workspace<N>,
    dense: &mut [f64],
) -> Result<RobustFit, FitError> {
    let Some(weighted) = weighted.get_mut(..samples.len()) else { return Err(FitError::TooFew) };
    weighted.copy_from_slice(samples);
    let mut best = fit(config, weighted, work, dense)?;
    for widening in SCALES {
        reweight(&best, config, samples, weighted, widening);
        best = fit(config, weighted, work, dense)?;
    }
    for _ in 0..STEPS {
        reweight(&best, config, samples, weighted, 1.0);
        let Some(next) = refit(config, weighted, &best.solution.line, &best.factorisation, work, dense)
        else {
            break;
        };
        let moved = next.solution.line.p.iter().zip(&best.solution.line.p).map(|(a, b)| m::abs(a - b));
        let still = moved.fold(0.0, f64::max) < 1e-6;
        best = next;
        if still {
            break;
        }
    }
    let wrong = wrong(&best.solution.line, &config.medium, samples);
    Ok(RobustFit { fit: best, wrong })
}

/// Bearings farther from a line than `WRONG_SD` standard deviations.
pub fn wrong(line: &Line, medium: &Medium, samples: &[Sample]) -> usize {
    let view = line.view(medium);
    let is_wrong = |s: &&Sample| {
        let [azimuth, elevation] = residuals(s, &view.expected(s.t_s), 1.0);
        m::abs(azimuth) > WRONG_SD || m::abs(elevation) > WRONG_SD
    };
    samples.iter().filter(is_wrong).count()
}

/// Standard deviations of a Gaussian likelihood that pulls as the Student-t one does at the present residuals.
fn reweight(fit: &Fit, config: &Config, samples: &[Sample], weighted: &mut [Sample], widening: f64) {
    let view = fit.solution.line.view(&config.medium);
    let growth = |r: f64| (1.0 / m::sqrt(STUDENT.weight(r))) as f32;
    for (w, s) in weighted.iter_mut().zip(samples) {
        let [azimuth, elevation] = residuals(s, &view.expected(s.t_s), widening);
        w.sd_rad = s.sd_rad * growth(azimuth);
        w.elevation_rad.1 = s.elevation_rad.1 * growth(elevation);
    }
}

/// Residuals of azimuth and elevation over their widened standard deviations; zero where there is no elevation.
fn residuals(s: &Sample, expected: &Expected, widening: f64) -> [f64; 2] {
    let azimuth = wrap_pi(s.azimuth_rad - expected.azimuth) / (widening * f64::from(s.sd_rad));
    let (elevation, sd) = s.elevation_rad;
    [azimuth, (f64::from(elevation) - expected.elevation) / (widening * f64::from(sd))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;
    use crate::motion::test_pass::{config, normal};
    use std::boxed::Box;
    use std::vec::Vec;

    /// A vessel that passes 400 m away at 7 m/s, heading 60°; Gaussian errors of 1°, some bearings wrong altogether.
    fn samples(wrong_every: usize) -> Vec<Sample> {
        let mut normal = normal(7);
        let (s, c) = (60.0 * RAD_PER_DEG).sin_cos();
        (0..200)
            .map(|k| {
                let t = f64::from(k);
                let (along, aside) = (7.0 * (t - 100.0), 400.0);
                let azimuth = (along * s - aside * c).atan2(along * c + aside * s);
                let mut error = normal() * RAD_PER_DEG;
                if wrong_every > 0 && k as usize % wrong_every == 3 {
                    error += 1.2 + 0.3 * normal();
                }
                Sample::azimuth(t, azimuth + error, RAD_PER_DEG)
            })
            .collect()
    }

    #[test]
    fn wrong_bearings_hardly_pull_and_good_ones_lose_little() {
        let mut work = Box::new(Workspace::<256>::new());
        let mut fits = |wrong_every| {
            let data = samples(wrong_every);
            let mut copy = data.clone();
            let plain = fit(&config(), &data, &mut work, &mut []).unwrap().solution;
            let robust = fit_robust(&config(), &data, &mut copy, &mut work, &mut []).unwrap();
            (plain, robust)
        };
        let (plain, robust) = fits(0);
        assert_eq!(robust.wrong, 0);
        let s = robust.fit.solution;
        assert!((s.cpa_range_m - plain.cpa_range_m).abs() < plain.sd_cpa_range_m);
        assert!((0.9..1.2).contains(&(s.sd_cpa_range_m / plain.sd_cpa_range_m)), "{s:?}");
        for every in [10, 4] {
            let (plain, robust) = fits(every);
            let s = robust.fit.solution;
            assert_eq!(robust.wrong, 200_usize.div_ceil(every) - usize::from(200 % every == 1), "{every}");
            let off = wrap_pi(s.heading_rad - 60.0 * RAD_PER_DEG).abs();
            assert!(
                off < 3.0 * s.sd_heading_rad && (s.cpa_range_m - 400.0).abs() < 3.0 * s.sd_cpa_range_m,
                "{s:?}"
            );
            assert!((plain.cpa_range_m - 400.0).abs() > 5.0 * (s.cpa_range_m - 400.0).abs(), "{plain:?}");
        }
    }
}
