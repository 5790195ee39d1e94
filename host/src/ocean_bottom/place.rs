//! Place of an ocean-bottom station from vessels of known track.
//!
//! Enters: evidence of range against time (from the interference delays of a recording's frames, or from range records)
//! and the vessels' courses about the nominal place. Leaves: the offset from the nominal place under which the vessels'
//! ranges, as their sound left them, are most likely together, with its covariance; or why it is not observable. Half the
//! evidence may be wrong: each moment counts as ln(½ + ½ e^g), g its log-likelihood ratio. Assumes one vessel at a time
//! near the station.
//!
//! Neighbouring moments share errors (of the table, of the filter), so the curvature of the likelihood claims too much:
//! the covariance is that of the mean of up to six parts of the evidence, interleaved in pieces of 20 minutes.

use super::lateness::{Lateness, lateness};
use super::stages::{MomentEvidence, RANGE_STEP_M};
use crate::course::{EastNorth, VesselCourse, polar};
use rayon::prelude::*;

/// Ranges at which passages are used, m: nearer the azimuth turns fast, farther the vessel drowns.
pub const USED_M: std::ops::Range<f64> = 3_000.0..40_000.0;

/// Farthest offset searched unless asked for more, m.
pub const SEARCH_M: f64 = 1_500.0;

/// Fewest moments that count.
const LEAST: usize = 30;

/// Most parts of the evidence whose scatter gives the uncertainty, fewest, and the length of a part's pieces, s.
const PARTS: usize = 6;
const LEAST_PARTS: usize = 3;
const PART_S: f64 = 1200.0;

/// The last step of the search, which adds to the scatter.
const LEAST_SD_M: f64 = 4.0;

/// Another place that explains this share of what the best one explains is as good.
const AS_GOOD: f64 = 0.9;
/// And lies farther away than this, m.
const APART_M: f64 = 300.0;

/// Travel time (s) against horizontal range (m); `None` where no sound arrives.
pub type Travel<'a> = dyn Fn(f64) -> Option<f64> + Sync + 'a;

/// The station's place relative to its nominal one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// East, m.
    pub east_m: f64,
    /// North, m.
    pub north_m: f64,
    /// Variances of East and North and their covariance, m².
    pub cov_m2: [f64; 3],
    /// Moments used.
    pub n: usize,
    /// Passages used.
    pub passages: usize,
    /// How late the recording's clock is beside that of the tracks, where vessels' courses tell.
    pub lateness: Option<Lateness>,
}

impl Displacement {
    /// Standard deviations of East and North, m.
    pub fn sd_m(&self) -> (f64, f64) {
        (self.cov_m2[0].sqrt(), self.cov_m2[1].sqrt())
    }
}

/// Why the place is not observable.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotObserved {
    /// Fewer than 30 moments with evidence of range while one vessel of known track is alone at 3 to 40 km.
    #[error(
        "the position is not observed: {0} moments with a range while one vessel of known track is alone at 3 to \
         40 km, {LEAST} are needed"
    )]
    TooFew(usize),
    /// They span fewer than three pieces of 20 minutes.
    #[error("the position is not observed: the passages span {0} times 20 minutes, {LEAST_PARTS} are needed")]
    TooShort(usize),
    /// The best place lies at the edge of the search, this far out (m).
    #[error(
        "the position is not observed: the best one lies at the edge of the search, {0:.0} m out (--search-m)"
    )]
    Edge(f64),
    /// Two places this far apart (m) explain the ranges equally well.
    #[error(
        "the position is not observed: two places {0:.0} m apart explain the ranges equally well; a passage on \
         another course or side would tell"
    )]
    Ambiguous(f64),
    /// No one place explains the ranges, and the clock is this late beside that of the tracks (s).
    #[error("the position is not observed: {}", .0.text())]
    Clock(Lateness),
    /// The parts of the data disagree by this standard deviation (m): no more is known than the search began with.
    #[error("the position is not observed: parts of the data disagree by {0:.0} m (standard deviation)")]
    Uncertain(f64),
}

/// Where a vessel was when what arrives at a time left it, from a station at an offset.
pub fn heard(travel: &Travel<'_>, course: &VesselCourse, t_s: f64, offset: EastNorth) -> Option<EastNorth> {
    let mut place = course.at(t_s)?;
    for _ in 0..3 {
        let range = (place.0 - offset.0).hypot(place.1 - offset.1);
        place = course.at(t_s - travel(range)?)?;
    }
    Some((place.0 - offset.0, place.1 - offset.1))
}

/// The vessel that is alone near the station at a time.
pub fn alone(courses: &[VesselCourse], t_s: f64) -> Option<(usize, &VesselCourse)> {
    let near = |c: &VesselCourse| c.at(t_s).is_some_and(|p| p.0.hypot(p.1) < 1.5 * USED_M.end);
    let mut inside = courses.iter().enumerate().filter(|(_, c)| near(c));
    let one = inside.next()?;
    inside.next().is_none().then_some(one)
}

/// A moment that is used: its time, the vessel, its evidence of range.
pub(super) type Used<'a> = (f64, &'a VesselCourse, &'a [f32]);

/// The station's place, within `search_m` of the nominal one.
///
/// # Errors
/// Why it is not observable.
pub fn place(
    evidence: &[MomentEvidence],
    courses: &[VesselCourse],
    travel: &Travel<'_>,
    search_m: f64,
) -> Result<Displacement, NotObserved> {
    let mut passages = vec![false; courses.len()];
    let used: Vec<Used<'_>> = evidence
        .iter()
        .filter_map(|e| {
            let (n, course) = alone(courses, e.t_s)?;
            let range = polar(heard(travel, course, e.t_s, (0.0, 0.0))?).0;
            let used = USED_M.contains(&range);
            passages[n] |= used;
            used.then_some((e.t_s, course, e.log_ratio.as_slice()))
        })
        .collect();
    if used.len() < LEAST {
        return Err(NotObserved::TooFew(used.len()));
    }
    let parts = parts(&used);
    if parts.len() < LEAST_PARTS {
        return Err(NotObserved::TooShort(parts.len()));
    }
    let coarse = search_m / 20.0;
    let scored = grid(&used, travel, 0.0, (0.0, 0.0), search_m, coarse);
    let start = top(&scored);
    let from_nominal = |p: EastNorth| p.0.abs().max(p.1.abs());
    if from_nominal(start) > search_m - 1.5 * coarse {
        return Err(NotObserved::Edge(start.0.hypot(start.1)));
    }
    let best = climb(&used, travel, 0.0, start, &[(1.5 * coarse, 20.0), (30.0, 4.0)]);
    let lateness = lateness(&used, &parts, travel, best);
    let or_clock = |reason| lateness.filter(Lateness::is_wrong).map_or(reason, NotObserved::Clock);

    let each: Vec<EastNorth> =
        parts.iter().map(|part| climb(part, travel, 0.0, best, &[(240.0, 40.0), (40.0, 8.0)])).collect();
    let n = each.len() as f64;
    let mean = |f: &dyn Fn(&EastNorth) -> f64| each.iter().map(f).sum::<f64>() / n;
    let (east, north) = (mean(&|p| p.0), mean(&|p| p.1));
    let product = |f: &dyn Fn(&EastNorth) -> f64| each.iter().map(f).sum::<f64>() / (n - 1.0) / n;
    let cov_m2 = [
        product(&|p| (p.0 - east).powi(2)) + LEAST_SD_M.powi(2),
        product(&|p| (p.1 - north).powi(2)) + LEAST_SD_M.powi(2),
        product(&|p| (p.0 - east) * (p.1 - north)),
    ];
    let sd = cov_m2[0].max(cov_m2[1]).sqrt();
    // Parts that scatter over all they may reach have found nothing.
    if sd * n.sqrt() > 160.0 {
        return Err(or_clock(NotObserved::Uncertain(sd)));
    }
    // What is explained is counted from the score of a place where nothing is.
    let explained = |score: f64| score + used.len() as f64 * std::f64::consts::LN_2;
    let apart = APART_M.max(4.0 * sd);
    let distance = |p: EastNorth| (p.0 - best.0).hypot(p.1 - best.1);
    let whole = explained(score(&used, travel, 0.0, best));
    let rival = scored.iter().filter(|s| distance(s.1) > apart).max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some(rival) = rival {
        let there = climb(&used, travel, 0.0, rival.1, &[(coarse, 20.0)]);
        if distance(there) > apart && explained(score(&used, travel, 0.0, there)) > AS_GOOD * whole {
            return Err(or_clock(NotObserved::Ambiguous(distance(there))));
        }
    }
    let passages = passages.iter().filter(|p| **p).count();
    Ok(Displacement { east_m: best.0, north_m: best.1, cov_m2, n: used.len(), passages, lateness })
}

/// The used moments in interleaved parts: pieces of 20 minutes that hold any, dealt out in turn.
fn parts<'a>(used: &[Used<'a>]) -> Vec<Vec<Used<'a>>> {
    let mut pieces: Vec<i64> = used.iter().map(|u| (u.0 / PART_S) as i64).collect();
    pieces.sort_unstable();
    pieces.dedup();
    let count = PARTS.min(pieces.len());
    let mut parts = vec![Vec::new(); count];
    for u in used {
        let rank = pieces.partition_point(|p| *p < (u.0 / PART_S) as i64);
        parts[rank % count].push(*u);
    }
    parts
}

/// How likely an offset makes the evidence of a clock so late, as a logarithm.
pub(super) fn score(used: &[Used<'_>], travel: &Travel<'_>, late_s: f64, offset: EastNorth) -> f64 {
    used.iter()
        .map(|(t, course, e)| {
            let g = heard(travel, course, *t - late_s, offset).and_then(|place| {
                let x = polar(place).0 / RANGE_STEP_M;
                let (j, w) = (x as usize, x.fract());
                Some(f64::from(*e.get(j)?) * (1.0 - w) + f64::from(*e.get(j + 1)?) * w)
            });
            // A moment in which the vessel is not heard says nothing: half of them may be such.
            (0.5 + 0.5 * g.unwrap_or(f64::NEG_INFINITY).min(50.0).exp()).ln()
        })
        .sum()
}

/// Scores on a grid of a reach and step (m) about a start.
fn grid(
    used: &[Used<'_>],
    travel: &Travel<'_>,
    late_s: f64,
    start: EastNorth,
    reach: f64,
    step: f64,
) -> Vec<(f64, EastNorth)> {
    let n = (reach / step).round() as i32;
    let cells: Vec<EastNorth> = (-n..=n)
        .flat_map(|i| (-n..=n).map(move |j| (i, j)))
        .map(|(i, j)| (start.0 + step * f64::from(i), start.1 + step * f64::from(j)))
        .collect();
    cells.into_par_iter().map(|c| (score(used, travel, late_s, c), c)).collect()
}

fn top(scored: &[(f64, EastNorth)]) -> EastNorth {
    scored.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or((0.0, 0.0), |s| s.1)
}

/// The most likely offset on grids (reach and step, m) of falling size about a start.
pub(super) fn climb(
    used: &[Used<'_>],
    travel: &Travel<'_>,
    late_s: f64,
    start: EastNorth,
    grids: &[(f64, f64)],
) -> EastNorth {
    grids.iter().fold(start, |at, &(reach, step)| top(&grid(used, travel, late_s, at, reach, step)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ranges with 100 m of scatter, every fourth wrong, of a vessel about a station at an offset, once a minute.
    fn evidence(courses: &[VesselCourse], offset: EastNorth) -> Vec<MomentEvidence> {
        let travel = |r: f64| Some(r / 1500.0);
        (0..720)
            .filter_map(|m| {
                let t_s = 60.0 * f64::from(m);
                let (_, course) = alone(courses, t_s)?;
                let range = polar(heard(&travel, course, t_s, offset)?).0;
                let wrong = if m % 4 == 1 { 5000.0 + 37.0 * f64::from(m) } else { 0.0 };
                let said = range + wrong + 100.0 * (2.3 * f64::from(m)).sin();
                let log_ratio = (0..716)
                    .map(|j| 4.0 - (0.5 * ((RANGE_STEP_M * f64::from(j) - said) / 120.0).powi(2)) as f32);
                Some(MomentEvidence { t_s, log_ratio: log_ratio.collect() })
            })
            .collect()
    }

    fn passage(cpa_time_s: f64, cpa_range_m: f64, heading: f64) -> VesselCourse {
        let straight = VesselCourse::by_cpa(cpa_time_s, cpa_range_m, heading, 7.0, true);
        let fixes = (-30..=30).map(|k| cpa_time_s + 200.0 * f64::from(k));
        VesselCourse::Fixes(fixes.filter_map(|t| Some((t, straight.at(t)?))).collect())
    }

    #[test]
    fn passages_give_the_place_with_its_uncertainty() {
        let courses = [passage(8000.0, 6000.0, 0.4), passage(30_000.0, 9000.0, 1.7)];
        let travel = |r: f64| Some(r / 1500.0);
        let found = place(&evidence(&courses, (350.0, -210.0)), &courses, &travel, SEARCH_M).unwrap();
        let (sd_east, sd_north) = found.sd_m();
        let error = (found.east_m - 350.0, found.north_m + 210.0);
        assert!(
            error.0.abs() < (4.0 * sd_east).min(60.0) && error.1.abs() < (4.0 * sd_north).min(60.0),
            "{found:?}"
        );
        assert_eq!(found.passages, 2);
        assert!(found.cov_m2[2].powi(2) <= found.cov_m2[0] * found.cov_m2[1], "{found:?}");
    }

    #[test]
    fn vessels_on_several_courses_tell_whose_clock_is_late_and_on_one_they_do_not() {
        let courses = [passage(8000.0, 6000.0, 0.4), passage(30_000.0, 9000.0, 1.7)];
        let travel = |r: f64| Some(r / 1500.0);
        for late_s in [0.0, 60.0, -45.0] {
            let mut evidence = evidence(&courses, (350.0, -210.0));
            evidence.iter_mut().for_each(|e| e.t_s += late_s);
            let found = place(&evidence, &courses, &travel, SEARCH_M).unwrap().lateness.unwrap();
            assert!(
                (found.late_s - late_s).abs() < 3.0 * found.sd_s && found.sd_s < 10.0,
                "{late_s}: {found:?}"
            );
            assert_eq!(found.is_wrong(), late_s != 0.0, "{found:?}");
        }
        let one = [passage(8000.0, 6000.0, 0.4)];
        let mut evidence = evidence(&one, (350.0, -210.0));
        evidence.iter_mut().for_each(|e| e.t_s += 60.0);
        let found = place(&evidence, &one, &travel, SEARCH_M);
        assert!(found.is_ok_and(|found| found.lateness.is_none()));
    }

    #[test]
    fn what_is_not_observed_is_refused() {
        let travel = |r: f64| Some(r / 1500.0);
        // One straight course: the place's mirror image on its other side is as good, if it is looked for there.
        let one = [passage(8000.0, 2500.0, 0.4)];
        let found = place(&evidence(&one, (200.0, 100.0)), &one, &travel, 6000.0);
        assert!(
            matches!(found, Err(NotObserved::Ambiguous(m)) if (4500.0..5500.0).contains(&m)),
            "{found:?}"
        );
        // Almost straight over the station: how far beside it, hardly changes a range.
        let over = [passage(8000.0, 0.0, 0.4)];
        let found = place(&evidence(&over, (50.0, -20.0)), &over, &travel, SEARCH_M);
        assert!(found.is_err(), "{found:?}");
        // Farther away than it is looked for.
        let one = [passage(8000.0, 6000.0, 0.4), passage(30_000.0, 9000.0, 1.7)];
        let found = place(&evidence(&one, (4000.0, 0.0)), &one, &travel, SEARCH_M);
        assert!(found.is_err(), "{found:?}");
        assert!(place(&evidence(&one, (4000.0, 0.0)), &one, &travel, 6000.0).is_ok());
        // Hardly heard.
        let few = evidence(&one, (0.0, 0.0));
        assert!(matches!(place(&few[..20], &one, &travel, SEARCH_M), Err(NotObserved::TooFew(_))));
        let short: Vec<_> = few.iter().filter(|e| (7200.0..9600.0).contains(&e.t_s)).cloned().collect();
        assert!(matches!(place(&short, &one, &travel, SEARCH_M), Err(NotObserved::TooShort(2))));
        // Ranges that fit no course.
        let mut nonsense = few;
        for (k, e) in nonsense.iter_mut().enumerate() {
            e.log_ratio.rotate_right(k * k * 31 % 700);
        }
        let found = place(&nonsense, &one, &travel, SEARCH_M);
        assert!(found.is_err(), "{found:?}");
    }
}
