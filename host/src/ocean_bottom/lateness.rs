//! Whether the tracks' times are those of the recording, by the ranges that tell the station's place.
//!
//! Enters: the moments whose ranges tell the place, and that place. Leaves: how late the recording's clock is beside the tracks'. A clock that is late moves
//! every vessel along its course, which no other place undoes where vessels come on several courses; on one straight course it does, and then
//! nothing is known of the clock. Each time from two minutes early to as much late is tried with the place that fits it best. The deviation is that
//! of interleaved parts of the evidence, as the place's.

use super::place::{Travel, Used, climb, score};
use crate::course::EastNorth;

/// Latest and earliest that is looked for, and from one to the next, s.
const MOST_S: f64 = 120.0;
const STEP_S: f64 = 10.0;
/// About the place that fits the time before, reach and step, m: no vessel goes farther in between.
const GRIDS_M: [(f64, f64); 2] = [(150.0, 50.0), (40.0, 16.0)];
/// Moments that are enough, evenly taken: a clock is wanted to seconds.
const MOMENTS: usize = 300;
/// Where parts scatter by more than this, nothing is known of the clock, s.
const UNKNOWN_S: f64 = 40.0;
/// Least deviation that is believed: times of tracks are often whole minutes joined straight, s.
const LEAST_SD_S: f64 = 3.0;
/// Vessels whose velocities differ by less than this share of them, root mean square, are on one course: another place undoes a clock that is late.
const ONE_COURSE: f64 = 0.3;
/// A clock so many deviations off is wrong.
const WRONG: f64 = 3.0;

/// How late the recording's clock is beside that of the tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lateness {
    /// Seconds; below 0 it is early, or the tracks' times are late.
    pub late_s: f64,
    /// Its standard deviation, s.
    pub sd_s: f64,
}

impl Lateness {
    /// Whether the two clocks cannot be the same.
    pub fn is_wrong(&self) -> bool {
        self.late_s.abs() > WRONG * self.sd_s
    }

    /// In words.
    pub fn text(&self) -> String {
        let which = if self.late_s > 0.0 { "earlier" } else { "later" };
        format!(
            "the times of the tracks are {:.0} s (standard deviation {:.0} s) {which} than those of the recording; put one of the clocks right",
            self.late_s.abs(),
            self.sd_s
        )
    }
}

/// How late the clock is, of moments and of their parts, whose place with a clock that is right is `at`; `None` where they do not tell.
pub(super) fn lateness(
    used: &[Used<'_>],
    parts: &[Vec<Used<'_>>],
    travel: &Travel<'_>,
    at: EastNorth,
) -> Option<Lateness> {
    if on_one_course(used) {
        return None;
    }
    let late_s = best(used, travel, at)?;
    let each: Option<Vec<f64>> = parts.iter().map(|part| best(part, travel, at)).collect();
    let each = each?;
    let n = each.len() as f64;
    let mean = each.iter().sum::<f64>() / n;
    let scatter = (each.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    (scatter < UNKNOWN_S).then(|| Lateness { late_s, sd_s: (scatter / n.sqrt()).hypot(LEAST_SD_S) })
}

/// Whether all vessels go one way at one speed.
fn on_one_course(used: &[Used<'_>]) -> bool {
    let velocity = |(t_s, course, _): &Used<'_>| {
        let ((x, y), (to_x, to_y)) = (course.at(t_s - STEP_S)?, course.at(t_s + STEP_S)?);
        Some((to_x - x, to_y - y))
    };
    let each: Vec<EastNorth> = used.iter().filter_map(velocity).collect();
    let n = each.len() as f64;
    let sum = |of: &dyn Fn(&EastNorth) -> f64| each.iter().map(of).sum::<f64>() / n;
    let (east, north) = (sum(&|v| v.0), sum(&|v| v.1));
    let square = sum(&|v| v.0 * v.0 + v.1 * v.1);
    let varies = square - east * east - north * north;
    // As well where there are none.
    !(varies > ONE_COURSE * ONE_COURSE * square)
}

/// The likeliest time by which the clock is late; `None` where that is at an end of those looked for.
fn best(used: &[Used<'_>], travel: &Travel<'_>, at: EastNorth) -> Option<f64> {
    let every = used.len().div_ceil(MOMENTS).max(1);
    let used: Vec<Used<'_>> = used.iter().step_by(every).copied().collect();
    let steps = (MOST_S / STEP_S).round() as i32;
    let mut scores = vec![0.0; (2 * steps + 1) as usize];
    for towards in [-1, 1] {
        let mut place = at;
        for k in 0..=steps {
            let late_s = STEP_S * f64::from(towards * k);
            place = climb(&used, travel, late_s, place, &GRIDS_M);
            scores[(steps + towards * k) as usize] = score(&used, travel, late_s, place);
        }
    }
    let top = (0..scores.len()).max_by(|a, b| scores[*a].total_cmp(&scores[*b]))?;
    let (a, b, c) = (scores.get(top.checked_sub(1)?)?, scores.get(top)?, scores.get(top + 1)?);
    let bend = a - 2.0 * b + c;
    let shift = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
    Some(STEP_S * (top as f64 + shift - f64::from(steps)))
}
