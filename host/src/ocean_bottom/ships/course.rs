//! The straight course of a track while it was heard: where its ship was, how well that is known, and how fast it came nearer.
//!
//! It is the course through the closest point that the track states, with the heading and speed stated there: at the ends of a passage a ship
//! whose way bends is beside it.

use crate::angle::{azimuth_deg, turn_deg, wrap_deg};
use crate::plot::directions::{Direction, Z95};
use crate::plot::heard::Passage;
use seabearing_core::config::StationConfig;
use seabearing_core::wire::Track;

/// Points of a curve.
const POINTS: u32 = 240;

/// A course.
pub(crate) struct Way<'a> {
    passage: &'a Passage,
    sound_m_s: f64,
    depth_m: f64,
}

impl<'a> Way<'a> {
    /// Of a passage by a station on a floor so deep, m.
    pub(crate) fn of(passage: &'a Passage, config: &StationConfig, depth_m: f64) -> Self {
        Self::new(passage, config.sound_speed_m_s, depth_m)
    }

    fn new(passage: &'a Passage, sound_m_s: f64, depth_m: f64) -> Self {
        Self { passage, sound_m_s, depth_m }
    }

    pub(super) fn track(&self) -> &'a Track {
        &self.passage.last
    }

    pub(super) fn heard_s(&self) -> (f64, f64) {
        self.passage.heard_s
    }

    /// Whether it was heard about that time.
    pub(super) fn is_heard(&self, t_s: f64) -> bool {
        (self.passage.heard_s.0..=self.passage.heard_s.1).contains(&t_s)
    }

    /// The whole minutes of its time, s.
    pub(super) fn minutes(&self) -> Vec<f64> {
        let (from, to) = self.passage.heard_s;
        ((from / 60.0).ceil() as u64..=(to / 60.0).floor() as u64).map(|m| 60.0 * m as f64).collect()
    }

    /// Azimuth at a time, degrees.
    pub(super) fn azimuth_deg(&self, t_s: f64) -> f64 {
        let (x, y) = self.passage.place(t_s);
        azimuth_deg(x, y)
    }

    /// Horizontal range at a time, m.
    pub(super) fn range_m(&self, t_s: f64) -> f64 {
        let (x, y) = self.passage.place(t_s);
        x.hypot(y)
    }

    /// Angle between two, degrees.
    pub(super) fn apart_deg(&self, other: &Self, t_s: f64) -> f64 {
        turn_deg(self.azimuth_deg(t_s), other.azimuth_deg(t_s)).abs()
    }

    /// What a tone that is heard at a time has to be multiplied by to be as it was radiated: the straight path's Doppler shift.
    pub(super) fn radiated(&self, t_s: f64) -> f64 {
        let slant = |t_s: f64| self.range_m(t_s).hypot(self.depth_m);
        // What is heard now left the ship one travel time ago.
        let left_s = t_s - slant(t_s) / self.sound_m_s;
        1.0 + (slant(left_s + 0.5) - slant(left_s - 0.5)) / self.sound_m_s
    }

    /// Standard deviations of azimuth, rad, and range, m, at a time: those of closest time, closest range, heading and speed, as stated, taken as
    /// independent.
    fn sd(&self, t_s: f64) -> (f64, f64) {
        let t = self.track();
        let (d, v) = (f64::from(t.cpa_range_m), f64::from(t.speed_m_s));
        let since = t_s - t.cpa_time_s;
        let along = v * since;
        let range = d.hypot(along).max(1.0);
        let [sd_t, sd_d, sd_h, sd_v] =
            [t.sd_cpa_time_s, t.sd_cpa_range_m, t.sd_heading, t.sd_speed_m_s].map(f64::from);
        // Azimuth is heading and the angle whose tangent is along over across; range the hypotenuse.
        let turn = 1.0 / (range * range);
        let azimuth = [sd_h, turn * along * sd_d, turn * d * v * sd_t, turn * d * since * sd_v];
        let away = [d / range * sd_d, along / range * v * sd_t, along / range * since * sd_v];
        let root = |parts: &[f64]| parts.iter().map(|p| p * p).sum::<f64>().sqrt();
        (root(&azimuth), root(&away))
    }

    /// Times along it, s; none where its place is not known.
    fn times(&self) -> impl Iterator<Item = f64> {
        let (from, to) = self.passage.heard_s;
        let placed = self.passage.is_placed();
        (0..=POINTS)
            .filter(move |_| placed)
            .map(move |k| from + (to - from) * f64::from(k) / f64::from(POINTS))
    }

    /// Azimuths with half of their 95 %, degrees; `at`: where a time lies on the axis.
    pub(crate) fn azimuths(&self, at: impl Fn(f64) -> f64) -> Vec<Direction> {
        self.times()
            .map(|t_s| {
                let half = Z95 * self.sd(t_s).0.to_degrees();
                Direction { at: at(t_s), t_s, value: wrap_deg(self.azimuth_deg(t_s)), half }
            })
            .collect()
    }

    /// Ranges with half of their 95 %, km.
    pub(crate) fn ranges_km(&self, at: impl Fn(f64) -> f64) -> Vec<Direction> {
        self.times()
            .map(|t_s| {
                let half = Z95 * self.sd(t_s).1 / 1e3;
                Direction { at: at(t_s), t_s, value: self.range_m(t_s) / 1e3, half }
            })
            .collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::plot::heard::Belonging;
    use crate::plot::heard::tests::{RATE_HZ, track};

    pub(in super::super) fn way(found: &Belonging) -> Way<'_> {
        Way::new(&found.passages[0], 1500.0, 4000.0)
    }

    /// A passage of a ship whose closest point, `north_m` North of the station, is at an hour; heard for two.
    pub(in super::super) fn passage(id: u16, north_m: f64) -> Belonging {
        let cpa_azimuth = if north_m < 0.0 { std::f32::consts::PI } else { 0.0 };
        let report = |stage, t_s| Track { cpa_azimuth, ..track(id, stage, t_s, (3600.0, north_m)) };
        let reports = [report(0, 0.0), report(1, 7200.0)];
        Belonging::of_array(&reports, &[], RATE_HZ)
    }

    #[test]
    fn deviations_are_those_of_the_closest_point_there_and_of_heading_and_speed_far_away() {
        let mut found = passage(1, 5000.0);
        let t = &mut found.passages[0].last;
        (t.sd_cpa_time_s, t.sd_cpa_range_m, t.sd_heading, t.sd_speed_m_s) = (10.0, 50.0, 0.01, 0.02);
        let way = way(&found);
        let (azimuth, range) = way.sd(3600.0);
        // There the time turns the azimuth, by speed over range.
        assert!((azimuth - (0.01f64.powi(2) + (7.0 / 5000.0 * 10.0f64).powi(2)).sqrt()).abs() < 1e-6);
        assert!((range - 50.0).abs() < 1e-6);
        let (azimuth, range) = way.sd(3600.0 + 100_000.0);
        assert!(
            (azimuth - 0.01).abs() < 1e-3
                && (range - (70.0f64.powi(2) + 2000.0f64.powi(2)).sqrt()).abs() < 5.0
        );
        let band = way.azimuths(|t_s| t_s);
        assert_eq!((band.len(), band[120].t_s), (241, 3600.0));
        assert!((band[0].value - 281.2).abs() < 0.2 && (band[240].value - 78.8).abs() < 0.2, "{band:?}");
    }

    #[test]
    fn a_tone_is_as_it_was_radiated_whether_the_ship_comes_or_goes() {
        let found = passage(1, 5000.0);
        let way = way(&found);
        // Coming at nearly 7 m/s it is heard too high.
        let (comes, there, goes) = (way.radiated(0.0), way.radiated(3604.3), way.radiated(7200.0));
        assert!((comes - 0.9955).abs() < 3e-4 && (there - 1.0).abs() < 1e-5 && (goes - 1.0045).abs() < 3e-4);
    }
}
