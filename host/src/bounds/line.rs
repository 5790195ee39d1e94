//! What a uniform line of sensors can tell at best: a bearing as `process` makes it, against direction and signal-to-noise ratio; and
//! its own orientation from a pass of a vessel of known track.

use crate::line::Analysis;
use crate::line::weights::independent_steps;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::{Normal, median};
use seabearing_locate::line::{LineError, LinePlan};

/// Step of the derivatives of a sine, radians, seconds and 1.
const STEP: f64 = 1e-5;
/// Orientations of the line to the vessel's way whose median is stated, over half a turn.
const WAYS: usize = 12;

/// Orientation (radians), clock shift (seconds) and η, the cosine of the sound's common elevation.
pub type Truth = [f64; 3];

/// Cramér-Rao bound of the orientation with shift and η unknown, from bearings at some times (by the line's clock, s) with sines of
/// deviation `sd`, of which successive ones have the share `common` of their error in common; `vessel`: its East and North from
/// the line (m) at a time (s). Radians; `None` where the bearings do not tell.
pub fn orientation(
    times_s: &[f64],
    sd: f64,
    common: f64,
    truth: Truth,
    vessel: impl Fn(f64) -> [f64; 2],
) -> Option<f64> {
    let sine = |t_s: f64, [orientation, shift_s, eta]: Truth| {
        let [x, y] = vessel(t_s - shift_s);
        eta * (x.atan2(y) - orientation).cos()
    };
    let mut normal = Normal::<3>::default();
    let mut before: Option<[f64; 3]> = None;
    for t_s in times_s {
        let slope: [f64; 3] = std::array::from_fn(|i| {
            let (mut up, mut down) = (truth, truth);
            up[i] += STEP;
            down[i] -= STEP;
            (sine(*t_s, up) - sine(*t_s, down)) / (2.0 * STEP)
        });
        let fresh = (1.0 - common * common).sqrt();
        let row = before.map_or(slope, |b| std::array::from_fn(|i| (slope[i] - common * b[i]) / fresh));
        before = Some(slope);
        normal.observe(&row, 0.0, 1.0 / (sd * sd));
    }
    Some(normal.covariance(&[true; 3], &[0.0; 3])?[0][0].sqrt())
}

/// A line as its recordings are analysed.
pub struct Expectations {
    plans: Vec<LinePlan>,
    analysis: Analysis,
}

impl Expectations {
    /// `None` where the station is no line, or names no frequencies to look at.
    ///
    /// # Errors
    /// The frequency at which the line cannot be used, and why.
    pub fn of(station: &StationConfig, analysis: &Analysis) -> Result<Option<Self>, (f64, LineError)> {
        let Kind::Line(line) = &station.kind else { return Ok(None) };
        let plan = |f: &f64| {
            LinePlan::new(
                usize::from(line.sensors),
                line.spacing_m,
                *f,
                station.sound_speed_m_s,
                analysis.subarrays,
                analysis.forgetting,
                analysis.sources,
            )
            .map_err(|e| (*f, e))
        };
        let plans = analysis.frequencies_hz.iter().map(plan).collect::<Result<Vec<_>, _>>()?;
        Ok((!plans.is_empty()).then(|| Self { plans, analysis: analysis.clone() }))
    }

    /// Independent snapshots that a bearing rests on: transforms of a step times independent steps.
    pub fn snapshots(&self) -> f64 {
        (self.analysis.step_s / self.analysis.frame_s).max(1.0) * independent_steps(self.analysis.forgetting)
    }

    /// Standard deviation of the sine of a single source's bearing, all frequencies hearing it with such a signal-to-noise ratio
    /// (power) of one sensor and transform. It is the same in every direction.
    pub fn sine_sd(&self, snr: f64) -> f64 {
        let information = |plan: &LinePlan| plan.sine_sd(snr, self.snapshots()).powi(-2);
        self.plans.iter().map(information).sum::<f64>().sqrt().recip()
    }

    /// The same of the azimuth at the horizon, radians, `from_broadside` radians off; `None` so near the axis that there is none, as
    /// the records have it.
    pub fn azimuth_sd(&self, snr: f64, from_broadside: f64) -> Option<f64> {
        let (sd, across) = (self.sine_sd(snr), from_broadside.cos());
        (across > 2.0 * sd).then(|| sd / across)
    }

    /// Standard deviation of the line's orientation from one straight pass of a vessel of known track, the clock's shift and η
    /// unknown: the median over directions of the way, radians; `None` where half of them tell nothing.
    pub fn orientation_sd(&self, snr: f64, range_m: f64, speed_m_s: f64, heard_s: f64) -> Option<f64> {
        let step_s = self.analysis.step_s;
        let count = (heard_s / step_s).floor() as i32;
        let times: Vec<f64> = (0..=count).map(|k| (f64::from(k) - 0.5 * f64::from(count)) * step_s).collect();
        let sd = self.sine_sd(snr);
        let of_way = |k: usize| {
            let axis = std::f64::consts::PI * (k as f64 + 0.5) / WAYS as f64;
            let vessel = |t_s: f64| [speed_m_s * t_s, range_m];
            orientation(&times, sd, self.analysis.forgetting, [axis, 0.0, 1.0], vessel)
        };
        let mut all: Vec<f64> = (0..WAYS).map(|k| of_way(k).unwrap_or(f64::INFINITY)).collect();
        median(&mut all).filter(|sd| *sd < std::f64::consts::FRAC_PI_2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::config::LineConfig;

    fn line(frequencies_hz: &[f64]) -> Expectations {
        let station = StationConfig::new(Kind::Line(LineConfig { sensors: 23, spacing_m: 0.75 }), 2048.0);
        let analysis = Analysis { frequencies_hz: frequencies_hz.to_vec(), ..Analysis::default() };
        Expectations::of(&station, &analysis).unwrap().unwrap()
    }

    #[test]
    fn a_bearing_is_as_good_as_its_noise_its_snapshots_and_its_frequencies() {
        let one = line(&[702.0]);
        // 16 transforms a second, 0.4 remembered.
        assert!((one.snapshots() - 16.0 * 25.0 / 9.0 * 15.0 / 17.0).abs() < 1e-9);
        // The bound of 23 sensors without subarrays, 6/(N S M (M² − 1)) of the phase's variance, is a little less.
        let phase = std::f64::consts::TAU * 0.75 * 702.0 / 1484.0;
        let bound = (6.0 / (one.snapshots() * 10.0 * 23.0 * (23.0f64.powi(2) - 1.0))).sqrt() / phase;
        assert!((1.0..1.35).contains(&(one.sine_sd(10.0) / bound)), "{} {bound}", one.sine_sd(10.0));
        assert!((one.sine_sd(10.0) / one.sine_sd(1000.0) - 10.0).abs() < 0.1);
        let two = line(&[702.0, 702.0]);
        assert!((two.sine_sd(1.0) * 2f64.sqrt() / one.sine_sd(1.0) - 1.0).abs() < 1e-9);
        let (broadside, slanting) = (one.azimuth_sd(1.0, 0.0), one.azimuth_sd(1.0, 60f64.to_radians()));
        assert!((slanting.unwrap() / broadside.unwrap() - 2.0).abs() < 1e-9);
        assert_eq!(one.azimuth_sd(1.0, std::f64::consts::FRAC_PI_2), None);
    }

    #[test]
    fn a_pass_that_turns_tells_the_orientation_and_a_far_one_hardly() {
        let line = line(&[444.0, 666.0, 702.0]);
        let at = |range_m| line.orientation_sd(1.0, range_m, 7.0, 300.0);
        assert!(at(500.0).unwrap() < 1f64.to_radians(), "{:?}", at(500.0));
        assert!(at(4000.0).is_none_or(|sd| sd > 5.0 * at(500.0).unwrap()), "{:?}", at(4000.0));
        assert!(
            Expectations::of(&StationConfig::array(64_000.0, [[0.0; 3]; 4]), &Analysis::default())
                .unwrap()
                .is_none()
        );
    }
}
