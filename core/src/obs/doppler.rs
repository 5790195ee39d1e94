//! Whether a vessel's lines fall as its course says: another pair of paths puts it at twice or half of its speed, and so of their fall.
//!
//! Enters: a course, and the minutes with the moves of their lines ([`lines`](super::lines)). Leaves: the ratio of the speed that the lines tell to
//! that of the course, with its deviation. A line of frequency f₀ is heard at `f₀ (1 − p ṙ)`, p the horizontal slowness of its sound and
//! ṙ the radial speed; of a course that is right but for its scale all moves are the ratio times those expected. Engines do not turn
//! evenly and sound goes over from path to path: what moves the lines beside their vessel is told by how they scatter about the
//! ratio, so lines that wander tell little and say so.
//! Assumes: moves of single minutes that err independently (their errors are correlated by −0.2 from one to the next in simulated
//! records, where sound that goes over from path to path makes most of them). Cost: 0.3 M instructions for eight hours.

use super::course::Course;
use super::evidence::Minute;
use super::fit;
use super::travel::TravelTime;
use crate::math;

/// Horizontal slowness of the sound times its speed: that of the direct path, `r/√(r² + h²)`, as far as this and no more. The paths of RR03, weighed
/// by power, have 0.55, 0.73 and 0.80 at 3, 5 and 7 km and 0.75 to 0.83 from there to 50 km.
const MOST_LEVEL: f64 = 0.8;

/// By how much that may be off, relative, and with it the ratio.
pub(super) const LEVEL_SD: f64 = 0.1;

/// Depth of the water at RR03, m, and speed of sound, m/s.
const WATER_M: f64 = 4340.0;
const SOUND_M_S: f64 = 1500.0;

/// Most that lines may say against a course, natural logarithm: an engine may as well have changed its speed as the vessel passed.
const LEAST_LOG: f64 = -8.0;

/// When after a minute's middle its lines are measured, minutes: their frames are the newest of its window.
const LATER_MIN: f64 = 0.92;

/// Least that an engine walks within the square root of a minute, relative: a tenth of a percent in a hundred minutes. A passage is one walk,
/// which may be a quiet one in every minute and still lead far.
const WALK: f64 = 1e-4;

/// Minutes that are taken together, and fewest of these that tell a ratio.
const TOGETHER: u8 = 3;
const LEAST: u16 = 6;

/// What the fall of lines says of a course.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fall {
    /// Sums of squares of what is expected, of its products with what was heard, of squares of that; so many.
    xx: f64,
    xy: f64,
    yy: f64,
    n: u16,
}

/// Relative shift of the lines of a course's vessel at a time.
fn shift(course: &Course, travel: &TravelTime, t_s: f64) -> f64 {
    let s = course.seen(travel, t_s);
    let water_m = WATER_M * travel.depth_ratio();
    let level = (s.range_m / math::f64::hypot(s.range_m, water_m)).min(MOST_LEVEL);
    -level / SOUND_M_S * s.speed_m_s
}

impl Fall {
    /// What those of the minutes' directions that are this course's say. Wanted in several places, and large.
    #[inline(never)]
    pub(super) fn of(
        course: &Course,
        travel: &TravelTime,
        step_s: f64,
        minutes: impl Iterator<Item = Minute>,
    ) -> Self {
        let mut out = Self::default();
        let (mut expected, mut heard, mut held) = (0.0, 0.0, 0);
        for m in minutes {
            let Some(moved) = fit::own_move(&m, &course.seen(travel, step_s * f64::from(m.number))) else {
                continue;
            };
            let now_s = step_s * (f64::from(m.number) + LATER_MIN);
            expected += shift(course, travel, now_s) - shift(course, travel, now_s - step_s);
            (heard, held) = (heard + moved, held + 1);
            if held == TOGETHER {
                out.xx += expected * expected;
                out.xy += expected * heard;
                out.yy += heard * heard;
                out.n += 1;
                (expected, heard, held) = (0.0, 0.0, 0);
            }
        }
        out
    }

    /// The ratio of the speed that they tell to the course's, and its deviation; `None` of too few.
    pub(super) fn ratio(&self) -> Option<(f64, f64)> {
        if self.n < LEAST || self.xx <= 0.0 {
            return None;
        }
        let ratio = self.xy / self.xx;
        let rest =
            ((self.yy - self.xy * ratio) / f64::from(self.n - 1)).max(f64::from(TOGETHER) * WALK * WALK);
        Some((ratio, math::f64::sqrt(rest / self.xx + LEVEL_SD * LEVEL_SD)))
    }

    /// By how many deviations that is not one.
    pub(super) fn off(&self) -> f64 {
        self.ratio().map_or(0.0, |(ratio, sd)| math::f64::abs(ratio - 1.0) / sd)
    }

    /// Natural logarithm of how likely the moves are on this course over how likely they are on the one of its shape that suits them best,
    /// however much they scatter: −½ n ln of the ratio of the sums of squares that are left, and no less than [`LEAST_LOG`].
    pub(super) fn log(&self) -> f64 {
        let off = self.off();
        let n = f64::from(self.n);
        let log = if off > 0.0 { -0.5 * n * math::f64::ln(1.0 + off * off / n) } else { 0.0 };
        log.max(LEAST_LOG)
    }
}

#[cfg(test)]
mod tests {
    use super::super::limits::{AZIMUTH_MODES, RANGE_MODES};
    use super::super::presence::RangePresence;
    use super::super::tonal::{Directions, Mode};
    use super::*;

    /// Minutes of a course whose lines move as it says, and by a wander of so much a minute beside.
    fn minutes(course: &Course, wander: f64) -> std::vec::Vec<Minute> {
        let travel = TravelTime::EMPTY;
        let mut seed = 3;
        (0..120)
            .map(|k| {
                let now_s = 60.0 * (f64::from(k) + LATER_MIN);
                let moved = shift(course, &travel, now_s) - shift(course, &travel, now_s - 60.0)
                    + wander * 1e-3 * f64::from(super::super::mend::tests::gaussian(&mut seed));
                let mode = Mode {
                    azimuth: course.seen(&travel, 60.0 * f64::from(k)).azimuth() as f32,
                    sd: 0.01,
                    log_presence: 20.0,
                    bins: 9,
                    step: 0,
                    impulsive: false,
                    moved: Some(moved as f32),
                };
                let mut modes = [None; AZIMUTH_MODES];
                modes[0] = Some(mode);
                let directions = Directions { modes, log_presence: 20.0, log_below: 0.0, frames: 17 };
                let none = RangePresence {
                    log_odds: 0.0,
                    log_evidence: 0.0,
                    approaching: 0.5,
                    modes: [None; RANGE_MODES],
                };
                Minute::new(k, &directions, &none)
            })
            .collect()
    }

    #[test]
    fn lines_tell_the_scale_of_a_course_and_wandering_ones_that_they_do_not() {
        let course = |scale: f64| Course { t0_s: 3_600.0, p: [scale * 6_000.0, 0.0, 0.0, scale * 7.0] };
        let of = |wander: f64, scale: f64| {
            let minutes = minutes(&course(1.0), wander).into_iter();
            Fall::of(&course(scale), &TravelTime::EMPTY, 60.0, minutes)
        };
        for wander in [0.0, 1e-4] {
            let (ratio, sd) = of(wander, 1.0).ratio().unwrap();
            assert!((ratio - 1.0).abs() < 2.0 * sd && sd < 0.2, "{ratio} {sd}");
            for scale in [0.5, 2.0] {
                let wrong = of(wander, scale);
                assert!(wrong.off() > 3.0 && wrong.log() < of(wander, 1.0).log() - 4.0, "{wander} {scale}");
            }
        }
        for scale in [0.5, 1.0, 2.0] {
            assert!(of(2e-3, scale).off() < 3.0);
        }
        let few = minutes(&course(1.0), 0.0).into_iter().take(10);
        assert!(Fall::of(&course(1.0), &TravelTime::EMPTY, 60.0, few).ratio().is_none());
    }
}
