//! How far records are from the truth: errors of detections and of tracks.
//!
//! A detection is compared with where the vessel was when the sound of its strongest path left it. Errors are
//! summarised by the scaled median absolute deviation 1.4826 · median |e| (SMAD) [O section III F].

use crate::course::VesselCourse;
use crate::ocean_bottom::simulate::MovingVessel;
pub use crate::ocean_bottom::truth::{Then, closest, passed, then};
use crate::propagation::Propagation;
use seabearing_core::angle::wrap_pi;
use seabearing_core::kit::quantile;
use seabearing_core::wire::{Message, Track};
use std::f64::consts::PI;

/// A range farther from the truth than this is on a wrong branch, m.
const WRONG_BRANCH_M: f64 = 1500.0;

/// An azimuth farther from the truth than this is none of the vessel's, rad.
const WRONG_AZIMUTH: f64 = 45.0 * PI / 180.0;

/// The scaled median absolute deviation; NaN of nothing.
pub fn smad(errors: &[f64]) -> f64 {
    seabearing_core::kit::MAD_TO_SD * median(errors.iter().map(|e| e.abs()).collect())
}

/// The median; NaN of nothing.
pub fn median(mut x: Vec<f64>) -> f64 {
    quantile::median(&mut x).unwrap_or(f64::NAN)
}

/// Errors of one vessel's detections.
#[derive(Clone, Debug, Default)]
pub struct Detections {
    /// Azimuth errors within `WRONG_AZIMUTH`, rad.
    pub azimuth: Vec<f64>,
    /// Azimuth detections farther off.
    pub azimuth_wrong: usize,
    /// Range errors within `WRONG_BRANCH_M`, m.
    pub range_m: Vec<f64>,
    /// Radial speed errors of the same, m/s.
    pub speed_m_s: Vec<f64>,
    /// Range detections farther off.
    pub range_wrong: usize,
}

impl Detections {
    /// Joins another's.
    pub fn append(&mut self, other: &Self) {
        self.azimuth.extend(&other.azimuth);
        self.azimuth_wrong += other.azimuth_wrong;
        self.range_m.extend(&other.range_m);
        self.speed_m_s.extend(&other.speed_m_s);
        self.range_wrong += other.range_wrong;
    }

    /// Share of range detections on a wrong branch.
    pub fn wrong_branch(&self) -> f64 {
        self.range_wrong as f64 / (self.range_wrong + self.range_m.len()).max(1) as f64
    }
}

/// Scores the heaviest azimuth and range mode of every minute against the vessel nearest to it; one entry a vessel.
pub fn detections(
    messages: &[Message],
    table: &Propagation,
    paths: usize,
    rate_hz: f64,
    vessels: &[MovingVessel],
) -> Vec<Detections> {
    let mut out = vec![Detections::default(); vessels.len()];
    let mut last = None;
    for m in messages {
        match m {
            Message::Azimuth(a) if a.detected => {
                let truth: Vec<_> = truths(table, paths, vessels, a.index as f64 / rate_hz);
                let nearest = truth
                    .iter()
                    .map(|(v, t)| (*v, wrap_pi(f64::from(a.azimuth) - t.azimuth)))
                    .min_by(|x, y| x.1.abs().total_cmp(&y.1.abs()));
                match nearest {
                    Some((v, e)) if e.abs() < WRONG_AZIMUTH => out[v].azimuth.push(e),
                    Some((v, _)) => out[v].azimuth_wrong += 1,
                    None => {}
                }
            }
            Message::Range(r) if r.detected && last != Some(r.index) => {
                last = Some(r.index);
                let truth = truths(table, paths, vessels, r.index as f64 / rate_hz);
                let nearest = truth
                    .iter()
                    .map(|(v, t)| {
                        (*v, f64::from(r.range_m) - t.range_m, f64::from(r.speed_m_s) - t.radial_m_s)
                    })
                    .min_by(|x, y| x.1.abs().total_cmp(&y.1.abs()));
                match nearest {
                    Some((v, e, s)) if e.abs() < WRONG_BRANCH_M => {
                        out[v].range_m.push(e);
                        out[v].speed_m_s.push(s);
                    }
                    Some((v, ..)) => out[v].range_wrong += 1,
                    None => {}
                }
            }
            _ => {}
        }
    }
    out
}

fn truths(table: &Propagation, paths: usize, vessels: &[MovingVessel], t_s: f64) -> Vec<(usize, Then)> {
    vessels.iter().enumerate().filter_map(|(i, v)| Some((i, then(table, paths, v, t_s)?))).collect()
}

/// Errors of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackMiss {
    /// Time of the closest point, s.
    pub cpa_time_s: f64,
    /// Its range, m.
    pub cpa_range_m: f64,
    /// Heading, rad.
    pub heading: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
}

/// A track's errors against a vessel's (straightened) course.
pub fn track(t: &Track, course: &VesselCourse) -> Option<TrackMiss> {
    closest(course).map(|truth| missed(t, truth))
}

/// A track's errors against the way itself at its closest point.
pub fn track_passed(t: &Track, course: &VesselCourse) -> Option<TrackMiss> {
    passed(course).map(|truth| missed(t, truth))
}

fn missed(t: &Track, (time, range, heading, speed): (f64, f64, f64, f64)) -> TrackMiss {
    TrackMiss {
        cpa_time_s: t.cpa_time_s - time,
        cpa_range_m: f64::from(t.cpa_range_m) - range,
        heading: wrap_pi(f64::from(t.heading) - heading),
        speed_m_s: f64::from(t.speed_m_s) - speed,
    }
}

/// The vessel a track belongs to: nearest in time of the closest point, then heading; `None` where none is within an
/// hour and 30°.
pub fn owner(t: &Track, vessels: &[MovingVessel]) -> Option<usize> {
    let cost = |v: &MovingVessel| {
        let e = track(t, &v.course)?;
        let (hours, turn) = (e.cpa_time_s.abs() / 3600.0, e.heading.abs() / (PI / 6.0));
        (hours < 1.0 && turn < 1.0).then_some(hours + turn)
    };
    vessels
        .iter()
        .enumerate()
        .filter_map(|(i, v)| Some((i, cost(v)?)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|x| x.0)
}

/// Root of the mean square; not a number of nothing.
pub fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0f64);
    for x in values {
        sum += x * x;
        n += 1.0;
    }
    (sum / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
        assert!(median(vec![]).is_nan());
        assert!((smad(&[-1.0, 1.0, 5.0]) - 1.4826).abs() < 1e-12);
    }
}
