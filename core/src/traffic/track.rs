//! One vessel's track: its passage, what is due for it, and what is known of its place and speed.
//!
//! In: what the passage found. Out: its solution as it is told, doubted where the vessel contradicts the speed declared, and where the vessel is, for
//! the bearing estimator.

use super::Config;
use super::duty::Duty;
use super::manoeuvre::Manoeuvre;
use crate::math::f64 as m;
use crate::motion::Solution;
use crate::passage::{self, Known, MeasuredSpeed, RECORDED};
use crate::wire::{Fault, FaultCode, Message};

pub(super) type Passage = passage::Passage<RECORDED>;

/// One vessel.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) id: u16,
    pub(super) duty: Duty,
    pub(super) passage: Passage,
    pub(super) manoeuvre: Manoeuvre,
    pub(super) updated_s: f64,
    /// Newest bearing that may have been its own.
    pub(super) heard_s: f64,
    /// Start of the crossing it is in.
    pub(super) crossing_since_s: Option<f64>,
    /// Infinite before the first report.
    pub(super) next_report_s: f64,
    pub(super) reported: bool,
    /// Relative standard deviation of its distance, where its track knows that well.
    pub(super) relative_sd: Option<f32>,
    /// Azimuth, distance and its standard deviation then, radians and metres.
    pub(super) place: Option<(f32, f32, f32)>,
    pub(super) speed: Option<MeasuredSpeed>,
    /// Whether its elevations or its shaft rate have contradicted the speed declared.
    pub(super) contradicted: bool,
}

impl Track {
    pub(super) const fn new() -> Self {
        Self {
            id: 0,
            duty: Duty::Free,
            passage: Passage::new(),
            manoeuvre: Manoeuvre::new(),
            updated_s: 0.0,
            heard_s: 0.0,
            crossing_since_s: None,
            next_report_s: 0.0,
            reported: false,
            relative_sd: None,
            place: None,
            speed: None,
            contradicted: false,
        }
    }

    /// What its fit assumes: the configured settings with what was measured of this vessel, and without the speed declared where
    /// it was contradicted.
    pub(super) fn motion(&self, config: &Config) -> passage::Config {
        let mut motion = config.motion;
        if self.contradicted {
            motion.speed_sd_m_s = f64::INFINITY;
        }
        motion.with_speed(self.speed)
    }

    /// Whether enough is known of it to be reported.
    #[inline(never)]
    pub(super) fn is_telling(&self, config: &Config) -> bool {
        let (first_s, last_s) = self.passage.times_s();
        let least = if last_s - first_s < config.report_after_s {
            config.report_after
        } else {
            config.report_after / 2
        };
        self.passage.seen() >= least
    }

    /// A solution of its passage. Where what is known of the vessel's speed contradicts the one declared, that is told, once, and
    /// its speed and ranges are uncertain by as much as the two are apart: the depth may be wrong by which elevations tell a speed.
    pub(super) fn judged(
        &mut self,
        config: &Config,
        solution: Solution,
        index: u64,
        sink: &mut dyn FnMut(Message),
    ) -> Solution {
        let mut other = config.motion.speed_m_s;
        if !self.contradicted {
            let told = self.passage.contradicting_speed(&config.motion, self.speed);
            let Some(speed_m_s) = told else { return solution };
            (self.contradicted, other) = (true, speed_m_s);
            let (code, value) = (FaultCode::SpeedContradicted, m::round(100.0 * speed_m_s) as i64);
            sink(Message::Fault(Fault { code, index, value }));
        }
        self.passage.doubted(&self.motion(config), &solution, other).unwrap_or(solution)
    }

    /// Notes where it is at `t_s`, in the azimuth (radians) in which it was heard, if its track knows its distance.
    pub(super) fn stand(&mut self, config: &Config, t_s: f64, azimuth: f64) {
        self.place = self.relative_sd.and_then(|relative| {
            let at = self.passage.best()?;
            // Half-way between the distances by the speed that it shows and by the one declared, where they contradict each other.
            let declared = config.motion.speed_m_s;
            let apart = if self.contradicted { 0.5 * m::ln(declared / at.line.speed_m_s()) } else { 0.0 };
            let range_m = m::exp(apart) * slant_m(config, at, t_s);
            let sd_m = range_m * m::hypot(f64::from(relative), apart);
            Some((azimuth as f32, range_m as f32, sd_m as f32))
        });
    }

    /// Whether it takes bearings.
    pub(super) fn is_live(&self) -> bool {
        !matches!(self.duty, Duty::Free | Duty::Over { .. })
    }
}

/// Relative standard deviation of a vessel's distance along the sound's way, where its track knows it well enough to help the
/// bearing estimator: to a third; or where the usual speed alone tells it, of which the slow and the fast are twice and half as far off.
pub(super) fn distance_known(config: &Config, solution: &Solution) -> Option<f32> {
    let (r, h) = (solution.cpa_range_m, config.height_m);
    let relative = solution.sd_cpa_range_m * r / (r * r + h * h);
    let known = if relative < 0.3 { relative } else { 0.6 };
    (solution.range_observable && relative < 0.6).then_some(known as f32)
}

/// Distance from the array to the vessel on a line, metres.
fn slant_m(config: &Config, known: &Known, t_s: f64) -> f64 {
    let ([x, y], _) = known.line.position(t_s);
    m::hypot(m::hypot(x, y), config.height_m)
}
