//! What one station hears: its bearings, given to its own tracks.
//!
//! A recorder says which vessels it tracks, not which bearing made which track. A bearing belongs to the track whose course
//! passes it within 4°; one that two tracks pass belongs to neither. Bearings wait for the courses that may want
//! them. For fits a track's bearings are averaged about its course, which takes the bend out of them.

use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::kit::median;
use seabearing_core::kit::normal::least_squares;
use std::collections::{BTreeMap, VecDeque};

/// A bearing so near to a course is that vessel's, radians, beside 4.5 of its own standard deviations.
const GATE_RAD: f64 = 4.0 * RAD_PER_DEG;
const GATE_SD: f64 = 4.5;
/// Time after which every live track has told its course again, s: recorders do so every five.
const TOLD_S: f64 = 6.0;
/// How long a bearing waits for a track, s: vessels are reported late, and of those of a resent hour all at once.
const WAITS_S: f64 = 180.0;
/// A track whose course is older than this takes no bearings, s.
const STALE_S: f64 = 60.0;
/// Bearings kept of a station without a track, and of a track.
const PENDING: usize = 4000;
const KEPT: usize = 20_000;
/// Averages of a track, and the least time that one spans, s.
const AVERAGES: usize = 16;
const LEAST_S: f64 = 10.0;
/// Time over which the errors of successive bearings are alike, s, and the least of them, radians.
const TAU_S: f64 = 5.0;
const LEAST_SD: f64 = 0.05 * RAD_PER_DEG;
/// A bearing is wrong beyond so many robust standard deviations of its neighbours.
const WRONG_SD: f64 = 4.0;
/// Jump of a clock that is none: its own deviations 4 times, and so much, s.
const JUMP_S: f64 = 1.0;

/// A track of a station: its session and number there.
pub type TrackNumber = (u32, u16);

/// A bearing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// UTC, seconds since 1970.
    pub t_s: f64,
    /// Its standard deviation, s; infinite where unknown.
    pub sd_clock_s: f64,
    /// Azimuth, radians clockwise from true North.
    pub azimuth: f64,
    /// Variance of the azimuth, rad².
    pub variance: f64,
}

/// Where a station's own track puts a vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// UTC, seconds since 1970.
    pub t_s: f64,
    /// East and North of the station then, m.
    pub at_m: [f64; 2],
    /// Velocity East and North, m/s.
    pub velocity_m_s: [f64; 2],
}

impl Course {
    /// Azimuth at a time, radians. Range and speed scale together and do not touch it.
    fn azimuth(&self, t_s: f64) -> f64 {
        let ([x, y], [vx, vy], dt) = (self.at_m, self.velocity_m_s, t_s - self.t_s);
        (x + vx * dt).atan2(y + vy * dt)
    }

    fn passes(&self, heard: &Heard) -> bool {
        let off = wrap_pi(heard.azimuth - self.azimuth(heard.t_s)).abs();
        off < GATE_RAD + GATE_SD * heard.variance.sqrt()
    }
}

/// Several bearings as one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Average {
    /// Mean time, UTC, seconds since 1970.
    pub t_s: f64,
    /// Azimuth then, radians clockwise from true North.
    pub azimuth: f64,
    /// Variance, rad².
    pub variance: f64,
}

/// A track of a station with its bearings.
#[derive(Clone, Debug)]
pub struct StationTrack {
    course: Course,
    bearings: Vec<Heard>,
    /// No more will come.
    pub over: bool,
    /// Goes up with every report and bearing.
    pub version: u32,
}

impl StationTrack {
    /// Bearings it has.
    pub fn count(&self) -> usize {
        self.bearings.len()
    }

    /// Time of its first and last bearing.
    pub fn span(&self) -> Option<(f64, f64)> {
        Some((self.bearings.first()?.t_s, self.bearings.last()?.t_s))
    }

    /// Standard deviation of the clock, s; infinite where unknown.
    pub fn sd_clock_s(&self) -> f64 {
        self.bearings.iter().map(|b| b.sd_clock_s).fold(0.0, f64::max)
    }

    /// Averages over equal times, and the least misfit that any smooth course leaves of them: what of their misfit is the
    /// station's own.
    pub fn averages(&self) -> (Vec<Average>, f64) {
        let Some((from, to)) = self.span() else { return Default::default() };
        let width = ((to - from) / AVERAGES as f64).max(LEAST_S);
        let mut out = Vec::new();
        let slot = |b: &Heard| ((b.t_s - from) / width) as u64;
        for of in self.bearings.chunk_by(|a, b| slot(a) == slot(b)) {
            out.extend(self.average(of, width));
        }
        // Three parameters of a lone course, as a parabola about it.
        let middle = 0.5 * (from + to);
        let scaled = |a: &Average| 2.0 * (a.t_s - middle) / (to - from).max(1.0);
        let rows: Vec<([f64; 3], f64)> = out
            .iter()
            .map(|a| {
                let (t, sd) = (scaled(a), a.variance.sqrt());
                ([1.0, t, t * t].map(|x| x / sd), wrap_pi(a.azimuth - self.course.azimuth(a.t_s)) / sd)
            })
            .collect();
        let [p, q, r] = least_squares(rows.iter().copied()).unwrap_or_default();
        let own = rows.iter().map(|([a, b, c], y)| (y - a * p - b * q - c * r).powi(2)).sum();
        (out, own)
    }

    fn average(&self, of: &[Heard], width: f64) -> Option<Average> {
        let off = |b: &Heard| wrap_pi(b.azimuth - self.course.azimuth(b.t_s));
        let mut all: Vec<f64> = of.iter().map(off).collect();
        let middle = median(&mut all)?;
        let mut away: Vec<f64> = all.iter().map(|r| (r - middle).abs()).collect();
        let scatter = 1.4826 * median(&mut away)?;
        let good = |b: &&Heard| (off(b) - middle).abs() <= WRONG_SD * scatter.max(b.variance.sqrt());
        let (mut n, mut t, mut r, mut variance) = (0.0, 0.0, 0.0, 0.0);
        for b in of.iter().filter(good) {
            n += 1.0;
            t += b.t_s - self.course.t_s;
            r += off(b);
            variance += b.variance.max(LEAST_SD * LEAST_SD);
        }
        if n == 0.0 {
            return None;
        }
        let t_s = self.course.t_s + t / n;
        let alike = n.min((width / (2.0 * TAU_S)).max(1.0));
        Some(Average { t_s, azimuth: self.course.azimuth(t_s) + r / n, variance: variance / n / alike })
    }
}

/// A station.
#[derive(Clone, Debug, Default)]
pub struct Station {
    pending: VecDeque<Heard>,
    /// Its tracks.
    pub tracks: BTreeMap<TrackNumber, StationTrack>,
    /// Session, UTC of its sample 0 and standard deviation, as the newest bearing says.
    clock: Option<(u32, f64, f64)>,
}

impl Station {
    /// Takes a bearing of `t_s` seconds after sample 0 of its session. Gives by how much the station's clock has
    /// jumped, s, if it has: then all that was heard before is forgotten, since nobody knows when it was.
    pub fn bearing(&mut self, session: u32, t_s: f64, heard: Heard) -> Option<f64> {
        let (zero, sd) = (heard.t_s - t_s, heard.sd_clock_s);
        let known = |s: f64| if s.is_finite() { s } else { 0.0 };
        let jumped = self.clock.filter(|(of, before, with)| {
            *of == session && (zero - before).abs() > JUMP_S + 4.0 * known(sd).hypot(known(*with))
        });
        self.clock = Some((session, zero, sd));
        if jumped.is_some() {
            self.pending.clear();
            self.tracks.retain(|(of, _), _| *of != session);
        }
        let at = self.pending.partition_point(|b| b.t_s <= heard.t_s);
        self.pending.insert(at, heard);
        if self.pending.len() > PENDING {
            self.pending.pop_front();
        }
        jumped.map(|(_, before, _)| zero - before)
    }

    /// Takes the report of a track, and gives out the bearings that can be given by now.
    pub fn report(&mut self, number: TrackNumber, course: Course, over: bool) {
        let track = self.tracks.entry(number).or_insert_with(|| StationTrack {
            course,
            bearings: Vec::new(),
            over,
            version: 0,
        });
        // A link may send the last word first: it stands.
        if over || !track.over {
            (track.course, track.over) = (course, over);
            track.version += 1;
        }
        let until = if over { course.t_s } else { course.t_s - TOLD_S };
        self.give_out(until);
    }

    /// A track was no vessel's.
    pub fn withdraw(&mut self, number: TrackNumber) {
        self.tracks.remove(&number);
    }

    /// Whether a bearing of a time comes after the last word of a track that may want it, as what a link sends again does.
    pub fn is_late(&self, t_s: f64) -> bool {
        self.tracks.values().any(|t| t.over && t_s <= t.course.t_s)
    }

    /// Gives out what can be given by now.
    pub fn settle(&mut self) {
        let told = |t: &StationTrack| if t.over { t.course.t_s } else { t.course.t_s - TOLD_S };
        if let Some(until) = self.tracks.values().map(told).max_by(f64::total_cmp) {
            self.give_out(until);
        }
    }

    fn give_out(&mut self, until_s: f64) {
        let mut left = VecDeque::new();
        for heard in self.pending.drain(..) {
            if heard.t_s > until_s {
                left.push_back(heard);
                continue;
            }
            let mut wants = self.tracks.values_mut().filter(|track| {
                let after = heard.t_s - track.course.t_s;
                let before = track.bearings.first().map_or(WAITS_S, |b| b.t_s - heard.t_s);
                let there = if track.over { after <= 1.0 } else { after < STALE_S };
                there && before <= WAITS_S && track.course.passes(&heard)
            });
            match (wants.next(), wants.next()) {
                (Some(track), None) => track.take(heard),
                // Nobody can say whose it is.
                (Some(_), Some(_)) => {}
                (None, _) if until_s - heard.t_s < WAITS_S => left.push_back(heard),
                (None, _) => {}
            }
        }
        self.pending = left;
    }
}

impl StationTrack {
    /// One bearing an instant, the one that claims the least error.
    fn take(&mut self, heard: Heard) {
        let at = self.bearings.partition_point(|b| b.t_s < heard.t_s);
        let room = self.bearings.len() < KEPT;
        self.version += 1;
        match self.bearings.get_mut(at) {
            Some(same) if same.t_s == heard.t_s => {
                *same = if heard.variance < same.variance { heard } else { *same };
            }
            _ if room => self.bearings.insert(at, heard),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vessel at 1 km going East at 5 m/s, closest at 100 s.
    fn course(t_s: f64) -> Course {
        Course { t_s, at_m: [5.0 * (t_s - 100.0), 1000.0], velocity_m_s: [5.0, 0.0] }
    }

    fn heard(t_s: f64, azimuth: f64) -> Heard {
        Heard { t_s, sd_clock_s: 0.01, azimuth, variance: 1e-4 }
    }

    fn listen(station: &mut Station, azimuth: impl Fn(f64) -> f64, seconds: std::ops::Range<u32>) {
        for t_s in seconds.map(f64::from) {
            assert_eq!(station.bearing(1, t_s, heard(t_s, azimuth(t_s))), None);
        }
    }

    #[test]
    fn a_track_takes_the_bearings_before_its_first_report_and_averages_bend_with_its_course() {
        let mut station = Station::default();
        listen(&mut station, |t| course(t).azimuth(t), 0..200);
        station.report((1, 1), course(200.0), true);
        let track = &station.tracks[&(1, 1)];
        assert!(track.count() > 170, "{}", track.count());
        let (averages, own) = track.averages();
        assert!(averages.len() > 15 && own < 1e-12, "{averages:?} {own}");
        assert!(averages.iter().all(|a| wrap_pi(a.azimuth - course(0.0).azimuth(a.t_s)).abs() < 1e-9));
        assert!(averages.iter().all(|a| a.variance <= 1e-4 * 1.001));
    }

    #[test]
    fn a_bearing_that_two_tracks_pass_is_neithers() {
        let mut station = Station::default();
        let other = |t_s: f64| Course {
            at_m: [-5.0 * (t_s - 100.0), 1000.0],
            velocity_m_s: [-5.0, 0.0],
            ..course(t_s)
        };
        for t_s in 0..200 {
            let t_s = f64::from(t_s);
            station.bearing(1, t_s, heard(t_s, course(t_s).azimuth(t_s)));
            station.bearing(1, t_s, heard(t_s, other(t_s).azimuth(t_s)));
            if t_s % 5.0 == 0.0 && t_s > 10.0 {
                station.report((1, 1), course(t_s), false);
                station.report((1, 2), other(t_s), false);
            }
        }
        let [a, b] = [1, 2].map(|id| &station.tracks[&(1, id)].bearings);
        assert!(a.iter().all(|x| b.iter().all(|y| x != y)));
        // Within 4.5 deviations and 4 degrees of the crossing at 100 s there is none, away from it there are all.
        for of in [a, b] {
            assert!(of.iter().all(|x| (x.t_s - 100.0).abs() > 8.0) && of.len() > 120, "{}", of.len());
        }
    }

    #[test]
    fn a_wrong_bearing_does_not_move_the_average() {
        let mut station = Station::default();
        listen(&mut station, |t| course(t).azimuth(t) + if t as u32 % 10 == 3 { 0.05 } else { 0.0 }, 0..200);
        station.report((1, 1), course(200.0), true);
        let (averages, _) = station.tracks[&(1, 1)].averages();
        assert!(averages.iter().all(|a| wrap_pi(a.azimuth - course(0.0).azimuth(a.t_s)).abs() < 1e-3));
    }

    #[test]
    fn a_clock_that_jumps_takes_with_it_what_it_said_before() {
        let mut station = Station::default();
        listen(&mut station, |t| course(t).azimuth(t), 0..100);
        station.report((1, 1), course(100.0), false);
        assert!(station.tracks[&(1, 1)].count() > 50);
        assert_eq!(station.bearing(1, 100.0, heard(100.9, 0.0)), None);
        let jumped = station.bearing(1, 101.0, heard(131.0, 0.0)).unwrap();
        assert!((jumped - 29.1).abs() < 1e-9 && station.tracks.is_empty());
        // Another session has another line of UTC.
        assert_eq!(station.bearing(2, 5.0, heard(400.0, 0.0)), None);
    }
}
