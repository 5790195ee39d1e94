//! A straight passage of one array, and what no unbiased estimator tells of it better [M 23-29].

use seabearing_core::angle::wrap_pi;
use seabearing_core::motion::{Line, Medium};
use seabearing_locate::motion::bound::{self, Bounds};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{Config, Sample};
use seabearing_locate::motion::whiten::{Factorisation, Workspace};

/// Time between bearings, s [M section IV-B].
pub const STEP_S: f64 = 0.5;
/// Bearings of the longest window: 400 s.
pub const POSITIONS: usize = 801;
/// Heading of the vessel, degrees.
const HEADING_DEG: f64 = 45.0;

/// One geometry: constant speed, closest point in the middle of the window at time 0, array to starboard.
#[derive(Clone, Copy, Debug)]
pub struct StraightPass {
    /// Range of the closest point, m.
    pub range_m: f64,
    /// Length of the window, s.
    pub window_s: f64,
    /// Standard deviation of errors of the azimuth, radians.
    pub sd_rad: f64,
    /// Correlation interval, s.
    pub tau_s: f64,
    /// True speed, m/s.
    pub speed_m_s: f64,
}

impl StraightPass {
    /// The true line.
    pub fn line(&self) -> Line {
        let cpa = (HEADING_DEG - 90.0).to_radians();
        Line { p: [cpa, 0.0, (self.speed_m_s / self.range_m).ln(), self.speed_m_s.ln(), 0.0], sense: 1.0 }
    }

    /// Number of bearings.
    pub fn count(&self) -> usize {
        (self.window_s / STEP_S).round() as usize + 1
    }

    /// Bearings with these errors (radians).
    pub fn samples(&self, medium: &Medium, errors: &[f64]) -> Vec<Sample> {
        let line = self.line();
        let azimuth = |(k, e): (usize, &f64)| {
            let t = -0.5 * self.window_s + STEP_S * k as f64;
            Sample::azimuth(t, wrap_pi(line.azimuth(medium, t) + e), self.sd_rad)
        };
        errors.iter().enumerate().map(azimuth).collect()
    }
}

/// What a fit assumes: the speed is known, there are no elevations, and the travel time is left out.
pub fn config(model: Model, tau_s: f64, speed_m_s: f64) -> Config {
    Config {
        model,
        tau_s,
        speed_m_s,
        speed_sd_m_s: 0.0,
        range_m: (20.0, 20_000.0),
        medium: Medium::of_sound_speed(f64::INFINITY),
        elevation_bias_sd_rad: 0.0,
    }
}

/// Cramér-Rao bounds of a pass under a fit's assumptions; `sd_elevation`: standard deviation of elevations, radians, where
/// they are measured. `None` where the geometry is singular.
pub fn limit(pass: &StraightPass, config: &Config, sd_elevation: Option<f64>) -> Option<Bounds> {
    let mut work = Box::new(Workspace::<POSITIONS>::new());
    let line = pass.line();
    let mut samples = pass.samples(&config.medium, &vec![0.0; pass.count()]);
    if let Some(sd) = sd_elevation {
        for s in &mut samples {
            s.elevation_rad = (line.expected(&config.medium, s.t_s).elevation as f32, sd as f32);
        }
    }
    let times = samples.iter().map(|s| s.t_s);
    let plan = Factorisation::new(config.model, config.tau_s, times, &mut work, &mut []).ok()?;
    bound::cramer_rao(config, &samples, &line, &plan, &mut work, &[])
}

/// Bounds of the estimator with the right (linear) model, and true spread of the one with the diagonal matrix.
pub fn limits(pass: &StraightPass) -> Option<(Bounds, Bounds)> {
    let c = config(Model::Linear, pass.tau_s, pass.speed_m_s);
    let s = pass.samples(&c.medium, &vec![0.0; pass.count()]);
    let best = limit(pass, &c, None)?;
    let diagonal = bound::sandwich(&c, &s, &pass.line(), Model::Linear, pass.tau_s)?;
    Some((best, diagonal))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The methods page's own check: σ 2°, 7 m/s known, 200 s, 401 bearings, linear model.
    #[test]
    fn reference_values_of_range_and_heading() {
        for (tau_s, range_m, sd_m, sd_deg) in [
            (0.0, 500.0, 2.1, 0.33),
            (0.0, 2000.0, 18.5, 2.89),
            (50.0, 500.0, 18.1, 2.23),
            (50.0, 1000.0, 43.6, 5.26),
            (150.0, 2000.0, 153.0, 14.2),
        ] {
            let sd_rad = 2f64.to_radians();
            let pass = StraightPass { range_m, window_s: 200.0, sd_rad, tau_s, speed_m_s: 7.0 };
            let (best, _) = limits(&pass).unwrap();
            let heading = best.heading_rad.to_degrees();
            assert!((best.cpa_range_m / sd_m - 1.0).abs() < 0.05, "{tau_s} {range_m}: {}", best.cpa_range_m);
            assert!((heading / sd_deg - 1.0).abs() < 0.05, "{tau_s} {range_m}: {heading}");
        }
    }

    #[test]
    fn elevations_give_the_speed() {
        let pass = StraightPass { range_m: 500.0, window_s: 200.0, sd_rad: 0.02, tau_s: 0.0, speed_m_s: 7.0 };
        let free = Config { speed_sd_m_s: f64::INFINITY, ..config(Model::White, 0.0, 7.0) };
        assert!(limit(&pass, &free, None).is_none());
        let medium = Medium { height_m: 150.0, ..free.medium };
        let known = limit(&pass, &Config { medium, ..free }, Some(0.02)).unwrap();
        assert!(known.speed_m_s > 0.0 && known.speed_m_s < 1.0, "{known:?}");
    }
}
