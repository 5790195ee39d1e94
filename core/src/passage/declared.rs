//! Whether a vessel contradicts the speed that the station file declares.
//!
//! In: a passage at its end, the declared speed with its spread, and what else is known of this vessel's speed. Out: the speed
//! that contradicts it, and a solution that counts how far apart the two are. Bearings alone know no scale [M 5, 6]; elevations of a vessel at a known height do, and so does its shaft rate.

use super::{Config, MeasuredSpeed, Passage};
use crate::math::f64 as m;
use crate::motion::Solution;
use crate::motion::model::{LN_SPEED, Limits};
use crate::motion::solution::{from_covariance, solution};

/// Standard deviations that a contradiction takes: once in 15 000 passages by chance, where what is stated holds.
const DOUBT_SD: f64 = 4.0;
/// Elevations that tell the speed no better than this, relatively, contradict none.
const USEFUL_SD: f64 = 0.3;

impl<const N: usize> Passage<N> {
    /// The speed, m/s, that a measurement of this vessel's or the elevations tell, where it is more than four standard
    /// deviations from the one declared, both uncertainties counted. `config`: as declared, without the measurement. Costs a
    /// quarter of [`Passage::polish`].
    #[inline(never)]
    pub fn contradicting_speed(&self, config: &Config, measured: Option<MeasuredSpeed>) -> Option<f64> {
        let prior = config.speed_sd_m_s / config.speed_m_s;
        let declared = m::ln(config.speed_m_s);
        let contradicts = |speed_m_s: f64, relative_variance: f64| {
            let off = m::ln(speed_m_s) - declared;
            off * off > DOUBT_SD * DOUBT_SD * (relative_variance + prior * prior)
        };
        let by_shaft = measured.map(|speed| (f64::from(speed.mean_m_s()), f64::from(speed.sd_m_s())));
        if let Some((speed_m_s, sd_m_s)) = by_shaft
            && contradicts(speed_m_s, (sd_m_s / speed_m_s) * (sd_m_s / speed_m_s))
        {
            return Some(speed_m_s);
        }
        let height_m = config.medium.height_m;
        if height_m <= 0.0 || !prior.is_finite() {
            return None;
        }
        let open = Config { speed_sd_m_s: f64::INFINITY, ..*config };
        let limits = Limits { ln_speed: LN_SPEED, ..open.limits(self.times_s()) };
        let links = self.links(&open);
        let problem = super::Problem { limits, ..self.problem(&open, &links) };
        let (line, normal) = problem.freed(&self.best()?.line)?;
        let told = solution(&line, &normal, &open.free(), &limits, self.seen(), self.measurements())?;
        // What does not fit states too little; an error of the height is one of the scale.
        let height = config.height_sd_m / height_m;
        let variance = told.covariance[3][3] * told.consistency.max(1.0) + height * height;
        let useful = variance < USEFUL_SD * USEFUL_SD && line.at_limit(&limits) == 0;
        (useful && contradicts(line.speed_m_s(), variance)).then(|| line.speed_m_s())
    }

    /// A solution of this passage whose speed is contradicted by another, m/s: speed and ranges are uncertain by as much as the
    /// two are apart.
    pub fn doubted(&self, config: &Config, solution: &Solution, speed_m_s: f64) -> Option<Solution> {
        let apart = m::ln(speed_m_s / solution.speed_m_s);
        let mut covariance = solution.covariance;
        covariance[3][3] += apart * apart;
        let limits = config.limits(self.times_s());
        from_covariance(&solution.line, &covariance, &limits, solution.n, solution.consistency)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Medium;
    use crate::passage::tests::noise;
    use crate::passage::{Measurement, RECORDED};

    /// A pass at 300 m of a vessel 160 m above the array, at this speed, through noise of 0.5°.
    fn passage(config: &Config, speed_m_s: f64) -> Passage<RECORDED> {
        let (mut seed, mut passage) = (11, Passage::<RECORDED>::new());
        let sd = 0.5f64.to_radians();
        for k in -200i32..=200 {
            let t_s = 0.5 * f64::from(k);
            let along = speed_m_s * t_s;
            let range = along.hypot(300.0);
            let azimuth = along.atan2(300.0) + sd * noise(&mut seed);
            let elevation = (160.0 / range).atan() + sd * noise(&mut seed);
            let measured = Measurement::azimuth(200.0 + t_s, azimuth, sd * sd);
            passage.push(config, &Measurement { elevation: Some((elevation, sd * sd)), ..measured });
        }
        passage
    }

    #[test]
    fn only_a_speed_that_is_far_off_is_contradicted() {
        let declared = |speed_m_s, speed_sd_m_s| Config {
            speed_m_s,
            speed_sd_m_s,
            medium: Medium { height_m: 160.0, ..Config::default().medium },
            height_sd_m: 3.0,
            elevation_bias_sd_rad: 0.017,
            ..Config::default()
        };
        for (declared, truth, contradicted) in [
            (declared(7.0, 2.0), 7.0, false),
            (declared(7.0, 2.0), 10.0, false),
            (declared(7.0, 0.0), 7.0, false),
            (declared(7.0, 0.0), 7.3, false),
            (declared(5.0, 0.0), 8.0, true),
            (declared(5.0, 0.3), 9.0, true),
        ] {
            let mut passage = passage(&declared, truth);
            let fitted = passage.finish(&declared).unwrap();
            let said = passage.contradicting_speed(&declared, None);
            assert_eq!(said.is_some(), contradicted, "{truth} {declared:?} {said:?} {fitted:?}");
            assert!(said.is_none_or(|speed| (speed / truth - 1.0).abs() < 0.15), "{said:?}");
        }
        // Without elevations only a measurement tells.
        let flat = Config { speed_m_s: 5.0, speed_sd_m_s: 0.3, ..Config::default() };
        let passage = passage(&flat, 9.0);
        assert_eq!(passage.contradicting_speed(&flat, None), None);
        assert_eq!(passage.contradicting_speed(&flat, MeasuredSpeed::new(9.0, 0.3)), Some(9.0));
        assert_eq!(passage.contradicting_speed(&flat, MeasuredSpeed::new(5.5, 0.3)), None);
    }
}
