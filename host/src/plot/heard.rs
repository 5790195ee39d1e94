//! Passages as they were reported, and which direction belongs to which.
//!
//! Records of bearings do not name a track. A bearing belongs to the track whose azimuth at its time, by the final solution or by
//! the report nearest in time, is nearest to it and within a gate, from the first report to the last; and before the first
//! report, which needs many bearings, and after the last, as far as bearings on the track's azimuth follow each other without a
//! silence.

use super::times::Times;
use super::{Look, cut_at_wraps};
use crate::angle::{azimuth_deg, turn_deg, wrap_deg};
use plotters::style::RGBColor;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::wire::{Bearing, Message, Track};
use std::collections::BTreeMap;

/// What is shown before the first and after the last bearing, as a share of the time between, and at least s.
const ROOM: f64 = 0.1;
const LEAST_ROOM_S: f64 = 5.0;

/// A direction that was heard.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heard {
    pub(crate) t_s: f64,
    /// Degrees from North.
    pub(crate) azimuth_deg: f64,
    /// Its standard deviation, degrees.
    pub(crate) sd_deg: f64,
}

impl Heard {
    pub(crate) fn of(b: &Bearing, rate_hz: f64) -> Self {
        Self {
            t_s: b.index as f64 / rate_hz,
            azimuth_deg: f64::from(b.azimuth).to_degrees(),
            sd_deg: f64::from(b.var_azimuth.max(0.0).sqrt()).to_degrees(),
        }
    }
}

/// How near a direction has to be to a track's.
#[derive(Clone, Copy, Debug)]
struct Gate {
    /// Degrees where the direction's standard deviation is small, and at most.
    least_deg: f64,
    most_deg: f64,
    /// After so long without one a track was not heard, s.
    silence_s: f64,
}

impl Gate {
    const ARRAY: Self = Self { least_deg: 3.0, most_deg: 10.0, silence_s: 45.0 };
    const OCEAN_BOTTOM: Self = Self { least_deg: 15.0, most_deg: 30.0, silence_s: 1800.0 };
}

/// A vessel's passage.
pub(crate) struct Passage {
    /// The final solution, or the last report.
    pub(crate) last: Track,
    /// All reports, in the order of time.
    pub(crate) reports: Vec<Track>,
    /// Times of the first and last direction that belongs to it, s; of its reports where none does.
    pub(crate) heard_s: (f64, f64),
    /// How many directions belong to it.
    pub(crate) own: usize,
    /// Its place among all.
    number: usize,
}

/// A track's place by one report at a time, East and North, m.
fn place(report: &Track, t_s: f64, rate_hz: f64) -> (f64, f64) {
    let way = f64::from(report.speed_m_s) * (t_s - report.index as f64 / rate_hz);
    let (s, c) = f64::from(report.heading).sin_cos();
    (f64::from(report.x_m) + way * s, f64::from(report.y_m) + way * c)
}

impl Passage {
    /// The vessel's place at a time on the straight course through the closest point of its last solution, East and North, m. Of one that does not move,
    /// which has none, its place.
    pub(crate) fn place(&self, t_s: f64) -> (f64, f64) {
        let t = &self.last;
        let (closest, way) = (f64::from(t.cpa_range_m), f64::from(t.speed_m_s) * (t_s - t.cpa_time_s));
        if !(closest + way).is_finite() {
            return (t.x_m.into(), t.y_m.into());
        }
        let ((s, c), (east, north)) = (f64::from(t.cpa_azimuth).sin_cos(), f64::from(t.heading).sin_cos());
        (closest * s + way * east, closest * c + way * north)
    }

    /// Whether its places are more than a guess.
    pub(crate) fn is_placed(&self) -> bool {
        self.last.range_observable && self.last.x_m.is_finite() && self.last.y_m.is_finite()
    }

    /// Its look on every picture of a recording.
    pub(crate) fn look(&self) -> Look {
        Look::of(self.number)
    }

    /// Its colour there.
    pub(crate) fn colour(&self) -> RGBColor {
        self.look().colour
    }

    pub(crate) fn name(&self) -> String {
        format!("track {}", self.last.id)
    }

    /// What is shown of it, s.
    pub(crate) fn shown_s(&self) -> (f64, f64) {
        let (from, to) = self.heard_s;
        let room = (ROOM * (to - from)).max(LEAST_ROOM_S);
        ((from - room).max(0.0), to + room)
    }

    /// Azimuth of the course against time, degrees.
    pub(crate) fn azimuths(&self, times: &Times) -> Vec<(f64, f64)> {
        cut_at_wraps(&self.course(|t_s, (x, y)| (times.at(t_s), wrap_deg(azimuth_deg(x, y)))))
    }

    /// Its range against time, km.
    pub(crate) fn ranges_km(&self, times: &Times) -> Vec<(f64, f64)> {
        self.course(|t_s, (x, y)| (times.at(t_s), x.hypot(y) / 1e3))
    }

    /// Of the course's times and places; nothing where the place is not known.
    fn course(&self, of: impl Fn(f64, (f64, f64)) -> (f64, f64)) -> Vec<(f64, f64)> {
        let placed = self.is_placed();
        let (from, to) = self.heard_s;
        let times = (0..=200).map(|k| from + (to - from) * f64::from(k) / 200.0);
        times.filter(|_| placed).map(|t_s| of(t_s, self.place(t_s))).collect()
    }

    /// How far an azimuth is from the track's, degrees.
    fn misses_deg(&self, one: &Heard, rate_hz: f64) -> f64 {
        let index = (one.t_s * rate_hz) as u64;
        let after = self.reports.partition_point(|r| r.index < index);
        let beside =
            [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|k| self.reports.get(k));
        let nearest = beside.min_by_key(|r| r.index.abs_diff(index)).unwrap_or(&self.last);
        [place(nearest, one.t_s, rate_hz), self.place(one.t_s)]
            .map(|(x, y)| turn_deg(azimuth_deg(x, y), one.azimuth_deg).abs())
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }

    fn reported_s(&self, rate_hz: f64) -> (f64, f64) {
        let at = |report: Option<&Track>| report.map_or(0.0, |r| r.index as f64 / rate_hz);
        (at(self.reports.first()), at(self.reports.last()))
    }
}

/// All that pictures say of tracks: passages, directions in the order of time, and of each whose it is.
pub(crate) struct Belonging {
    /// Those that were not withdrawn, in the order of their numbers.
    pub(crate) passages: Vec<Passage>,
    /// The place among the passages, for each direction.
    pub(crate) whose: Vec<Option<usize>>,
}

impl Belonging {
    /// Of what a recorder reported, and of what it heard, in the order of time.
    pub(crate) fn of(reports: &[Track], heard: &[Heard], config: &StationConfig) -> Self {
        let gate = if matches!(config.kind, Kind::Obs(_)) { Gate::OCEAN_BOTTOM } else { Gate::ARRAY };
        Self::within(reports, heard, config.rate_hz, gate)
    }

    /// Of an array's, where no more is known of it.
    pub(crate) fn of_array(reports: &[Track], heard: &[Heard], rate_hz: f64) -> Self {
        Self::within(reports, heard, rate_hz, Gate::ARRAY)
    }

    fn within(reports: &[Track], heard: &[Heard], rate_hz: f64, gate: Gate) -> Self {
        let mut passages = passages(reports, rate_hz);
        let fits = |passage: &Passage, one: &Heard| {
            let miss = passage.misses_deg(one, rate_hz);
            (miss <= (3.0 * one.sd_deg).clamp(gate.least_deg, gate.most_deg)).then_some(miss)
        };
        let spans: Vec<(f64, f64)> = passages.iter().map(|p| p.reported_s(rate_hz)).collect();
        let whose_of = |one: &Heard| {
            let there = passages.iter().zip(&spans).enumerate();
            let fitting = there
                .filter(|(_, (_, span))| (span.0..=span.1).contains(&one.t_s))
                .filter_map(|(k, (passage, _))| Some((k, fits(passage, one)?)));
            fitting.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
        };
        let mut whose: Vec<Option<usize>> = heard.iter().map(whose_of).collect();
        for (k, (passage, span)) in passages.iter().zip(&spans).enumerate() {
            let (before, after) = (
                heard.partition_point(|one| one.t_s < span.0),
                heard.partition_point(|one| one.t_s <= span.1),
            );
            let mut follow = |places: &mut dyn Iterator<Item = usize>, mut last_s: f64| {
                for place in places {
                    let (Some(one), Some(whose)) = (heard.get(place), whose.get_mut(place)) else { break };
                    if (last_s - one.t_s).abs() > gate.silence_s {
                        break;
                    }
                    if whose.is_none() && fits(passage, one).is_some() {
                        *whose = Some(k);
                        last_s = one.t_s;
                    }
                }
            };
            follow(&mut (0..before).rev(), span.0);
            follow(&mut (after..heard.len()), span.1);
        }
        for (one, whose) in heard.iter().zip(&whose) {
            if let Some(passage) = whose.and_then(|k| passages.get_mut(k)) {
                passage.heard_s =
                    if passage.own == 0 { (one.t_s, one.t_s) } else { (passage.heard_s.0, one.t_s) };
                passage.own += 1;
            }
        }
        Self { passages, whose }
    }
}

/// The passages that were reported and not withdrawn.
fn passages(reports: &[Track], rate_hz: f64) -> Vec<Passage> {
    let mut by_id: BTreeMap<u16, Vec<Track>> = BTreeMap::new();
    for report in reports {
        by_id.entry(report.id).or_default().push(*report);
    }
    by_id.retain(|_, reports| reports.iter().all(|t| t.stage != Track::WITHDRAWN));
    let passage = |(number, mut reports): (usize, Vec<Track>)| {
        let last = *reports.iter().rev().find(|t| t.stage == Track::FINAL).or(reports.last())?;
        reports.sort_by_key(|report| report.index);
        let mut passage = Passage { last, reports, heard_s: (0.0, 0.0), own: 0, number };
        passage.heard_s = passage.reported_s(rate_hz);
        Some(passage)
    };
    by_id.into_values().enumerate().filter_map(passage).collect()
}

/// The tracks among messages.
pub(crate) fn reports(messages: &[Message]) -> Vec<Track> {
    let track = |m: &Message| if let Message::Track(t) = m { Some(*t) } else { None };
    messages.iter().filter_map(track).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const RATE_HZ: f64 = 100.0;

    /// A vessel on a course past the station: its closest point is North of it, and it goes East.
    pub(crate) fn track(id: u16, stage: u8, t_s: f64, (cpa_time_s, north_m): (f64, f64)) -> Track {
        Track {
            id,
            stage,
            index: (t_s * RATE_HZ) as u64,
            cpa_time_s,
            cpa_range_m: north_m.abs() as f32,
            cpa_azimuth: 0.0,
            heading: 1.570_796_4,
            speed_m_s: 7.0,
            starboard: true,
            sd_cpa_time_s: 0.1,
            sd_cpa_range_m: 9.0,
            sd_heading: 0.01,
            sd_speed_m_s: 0.0,
            x_m: (7.0 * (t_s - cpa_time_s)) as f32,
            y_m: north_m as f32,
            var_x_m2: 100.0,
            var_y_m2: 400.0,
            cov_xy_m2: 50.0,
            range_observable: true,
            n: 200,
        }
    }

    /// A bearing of a vessel on such a course.
    pub(in super::super) fn bearing(t_s: f64, (cpa_time_s, north_m): (f64, f64)) -> Bearing {
        Bearing {
            index: (t_s * RATE_HZ) as u64,
            azimuth: wrap_deg(azimuth_deg(7.0 * (t_s - cpa_time_s), north_m)).to_radians() as f32,
            elevation: 0.1,
            var_azimuth: 1e-4,
            var_elevation: 1e-4,
            cov: 0.0,
            snr_db: 10.0,
            quality: 1.0,
            closure_s: 0.0,
            statistic: 2.0,
            band: 0,
            flags: 0,
        }
    }

    fn heard(b: &Bearing) -> Heard {
        Heard::of(b, RATE_HZ)
    }

    #[test]
    fn a_bearing_belongs_to_the_track_it_is_on_and_a_track_begins_with_its_first_bearing() {
        let (north, south) = ((50.0, 500.0), (60.0, -400.0));
        // Heard from 5 s on, reported from 20 s on; the second from 30 s and 40 s on.
        let mut all: Vec<(usize, Bearing)> = Vec::new();
        for t_s in 0..100 {
            let t_s = f64::from(t_s);
            if t_s >= 5.0 {
                all.push((0, bearing(t_s, north)));
            }
            if t_s >= 30.0 {
                all.push((1, bearing(t_s, south)));
            }
            // Noise of nobody.
            all.push((2, Bearing { azimuth: 1.2, ..bearing(t_s, north) }));
        }
        let reports =
            |id, from: u32, way| (from..=99).step_by(5).map(move |t| track(id, 0, f64::from(t), way));
        let mut told: Vec<Track> = reports(3, 20, north).chain(reports(8, 40, south)).collect();
        told.push(track(3, Track::FINAL, 99.0, north));
        told.push(track(9, Track::RUNNING, 50.0, north));
        told.push(track(9, Track::WITHDRAWN, 60.0, north));
        let found =
            Belonging::of_array(&told, &all.iter().map(|(_, b)| heard(b)).collect::<Vec<_>>(), RATE_HZ);
        assert_eq!(found.passages.iter().map(|p| p.last.id).collect::<Vec<_>>(), [3, 8]);
        for ((true_one, b), whose) in all.iter().zip(&found.whose) {
            assert_eq!(whose.unwrap_or(2), *true_one, "{b:?}");
        }
        assert_eq!(found.passages[0].heard_s, (5.0, 99.0));
        assert!((found.passages[1].heard_s.0 - 30.0).abs() < 1e-9, "{:?}", found.passages[1].heard_s);
        let (x, y) = found.passages[0].place(50.0);
        assert!(x.abs() < 1e-3 && (y - 500.0).abs() < 1e-3, "{x} {y}");
    }

    #[test]
    fn what_a_silence_parts_is_not_taken_back_to() {
        let way = (50.0, 500.0);
        // Something on the same azimuth more than 45 s before.
        let all = [1.0, 60.0, 61.0, 62.0].map(|t| heard(&bearing(t, way)));
        let found = Belonging::of_array(&[track(1, 0, 63.0, way)], &all, RATE_HZ);
        assert_eq!(found.whose, [None, Some(0), Some(0), Some(0)]);
        assert_eq!(found.passages[0].heard_s, (60.0, 62.0));
    }
}
