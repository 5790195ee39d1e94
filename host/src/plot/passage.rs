//! A page for each passage of a vessel: what it sounded like, where it was heard from, its course and what is stated of it.
//!
//! Enters: what the recorder said of a whole recording, and the samples once more, for spectrograms. Leaves:
//! `passage-N.svg`, N the track's number. The array's page shows azimuth and elevation, the ocean bottom's azimuth and range.
//! The line in the panels is the final course; its band is not drawn, for errors along a course hang together.

use super::spectrogram::Spectrogram;
use super::times::Times;
use super::{Plot, Scale, cut_at_wraps, write_panels};
use crate::angle::{azimuth_deg, wrap_deg};
use crate::recording::BlockSource;
use crate::station::Station;
use anyhow::Result;
use seabearing_core::config::Kind;
use seabearing_core::wire::{Message, Track};
use std::collections::BTreeMap;
use std::path::Path;
use time::OffsetDateTime;

/// Half the width of a 95 % interval of a Gaussian, in standard deviations.
const Z95: f64 = 1.959_964;

/// What is shown before the first and after the last report, as a share of the time between, and at least s.
const ROOM: f64 = 0.1;
const LEAST_ROOM_S: f64 = 5.0;

/// Width of the left column, and of the right one, points.
pub(super) const LEFT: u32 = 760;
const RIGHT: u32 = 540;

/// A vessel's passage.
pub(crate) struct Passage {
    /// The final solution, or the last report.
    pub(crate) last: Track,
    /// Time of its first and last report, s.
    heard_s: (f64, f64),
    /// What is drawn, s.
    shown_s: (f64, f64),
}

impl Passage {
    /// The vessel's place by the last solution at a time, East and North, m.
    fn place(&self, t_s: f64, rate_hz: f64) -> (f64, f64) {
        let since = t_s - self.last.index as f64 / rate_hz;
        let way = f64::from(self.last.speed_m_s) * since;
        let (s, c) = f64::from(self.last.heading).sin_cos();
        (f64::from(self.last.x_m) + way * s, f64::from(self.last.y_m) + way * c)
    }

    fn is_placed(&self) -> bool {
        self.last.range_observable && self.last.x_m.is_finite() && self.last.y_m.is_finite()
    }

    /// Azimuth of the course against time, degrees.
    pub(crate) fn azimuths(&self, times: &Times, rate_hz: f64) -> Vec<(f64, f64)> {
        cut_at_wraps(&self.course(|t_s, (x, y)| (times.at(t_s), wrap_deg(azimuth_deg(x, y))), rate_hz))
    }

    /// Its range against time, km.
    pub(crate) fn ranges_km(&self, times: &Times, rate_hz: f64) -> Vec<(f64, f64)> {
        self.course(|t_s, (x, y)| (times.at(t_s), x.hypot(y) / 1e3), rate_hz)
    }

    /// Of the course's times and places; nothing where the place is not known.
    fn course(&self, of: impl Fn(f64, (f64, f64)) -> (f64, f64), rate_hz: f64) -> Vec<(f64, f64)> {
        let placed = self.is_placed();
        self.times_s().filter(|_| placed).map(|t_s| of(t_s, self.place(t_s, rate_hz))).collect()
    }

    /// A hundred times of the passage, s.
    fn times_s(&self) -> impl Iterator<Item = f64> {
        let (from, to) = self.heard_s;
        (0..=100).map(move |k| from + (to - from) * f64::from(k) / 100.0)
    }
}

/// The passages that were reported and not withdrawn.
pub(crate) fn passages(messages: &[Message], rate_hz: f64) -> Vec<Passage> {
    let mut by_id: BTreeMap<u16, Vec<Track>> = BTreeMap::new();
    for message in messages {
        if let Message::Track(t) = message {
            by_id.entry(t.id).or_default().push(*t);
        }
    }
    by_id.retain(|_, reports| reports.iter().all(|t| t.stage != Track::WITHDRAWN));
    let passage = |reports: Vec<Track>| {
        let last = *reports.iter().rev().find(|t| t.stage == Track::FINAL).or(reports.last())?;
        let index = |of: fn(u64, u64) -> u64| reports.iter().map(|t| t.index).reduce(of);
        let heard_s = (index(u64::min)? as f64 / rate_hz, index(u64::max)? as f64 / rate_hz);
        // The closest point belongs to it, if it was not long ago or ahead.
        let length = heard_s.1 - heard_s.0;
        let near = (last.cpa_time_s - heard_s.0).abs().min((last.cpa_time_s - heard_s.1).abs()) <= length;
        let cpa_s = last.cpa_time_s;
        let heard_s = if near { (heard_s.0.min(cpa_s), heard_s.1.max(cpa_s)) } else { heard_s };
        let room = (ROOM * (heard_s.1 - heard_s.0)).max(LEAST_ROOM_S);
        Some(Passage { last, heard_s, shown_s: ((heard_s.0 - room).max(0.0), heard_s.1 + room) })
    };
    by_id.into_values().filter_map(passage).collect()
}

/// Draws the pages; how many. `source` is the recording from its beginning, `start` its UTC.
///
/// # Errors
/// The recording is lost, or a file cannot be written.
pub fn write_all(
    folder: &Path,
    station: &Station,
    start: Option<OffsetDateTime>,
    messages: &[Message],
    source: &mut dyn BlockSource,
) -> Result<usize> {
    let rate_hz = station.config.rate_hz;
    let all = passages(messages, rate_hz);
    let mut sounds: Vec<Spectrogram> =
        all.iter().map(|p| Spectrogram::new(rate_hz, p.shown_s, &station.calibration[0])).collect();
    let end_s = all.iter().map(|p| p.shown_s.1).fold(0.0, f64::max);
    while let Some(block) = source.next_block()? {
        sounds.iter_mut().for_each(|sound| sound.take(&block));
        if block.first_index as f64 > end_s * rate_hz {
            break;
        }
    }
    let full_scale = f64::from(station.config.full_scale);
    for (passage, sound) in all.iter().zip(&sounds) {
        let times = Times::new(start, passage.shown_s.1);
        let mut panels = vec![sound.plot(&times, full_scale), map(passage, &times, rate_hz)];
        let (azimuth, other) = match &station.config.kind {
            Kind::Obs(_) => heard(passage, &times, messages, rate_hz),
            _ => bearings(passage, &times, messages, rate_hz),
        };
        panels.extend([azimuth, stated(passage, &times, &station.config.name), other]);
        let path = folder.join(format!("passage-{}.svg", passage.last.id));
        write_panels(&path, &panels.iter().collect::<Vec<_>>(), 2)?;
    }
    Ok(all.len())
}

/// An empty panel against the time shown.
fn against_time(title: &str, label: &str, passage: &Passage, times: &Times) -> Plot {
    let mut figure = Plot::new(title, "", label);
    figure.size(LEFT, 280).x_range(times.at(passage.shown_s.0), times.at(passage.shown_s.1));
    times.along(&mut figure);
    figure
}

/// Azimuth and elevation of an array.
fn bearings(passage: &Passage, times: &Times, messages: &[Message], rate_hz: f64) -> (Plot, Plot) {
    let mut azimuth = against_time("Azimuth", "azimuth (°)", passage, times);
    let mut elevation = against_time("Elevation", "elevation (°)", passage, times);
    azimuth.y_scale(Scale::Degrees);
    let mut bands = [Vec::new(), Vec::new()];
    let mut points = [Vec::new(), Vec::new()];
    for message in messages {
        let Message::Bearing(b) = message else { continue };
        let t_s = b.index as f64 / rate_hz;
        if t_s < passage.shown_s.0 || t_s > passage.shown_s.1 {
            continue;
        }
        let values = [(b.azimuth, b.var_azimuth), (b.elevation, b.var_elevation)];
        for ((band, points), (value, variance)) in bands.iter_mut().zip(&mut points).zip(values) {
            let value = f64::from(value).to_degrees();
            let half = Z95 * f64::from(variance.max(0.0).sqrt()).to_degrees();
            if points.last().is_some_and(|p: &(f64, f64)| (p.1 - value).abs() > 90.0) {
                band.push((times.at(t_s), f64::NAN, f64::NAN));
            }
            band.push((times.at(t_s), value - half, value + half));
            points.push((times.at(t_s), value));
        }
    }
    for (figure, (band, points)) in [&mut azimuth, &mut elevation].into_iter().zip(bands.iter().zip(&points))
    {
        figure.band("95 % band", band).points("bearings", points).same_colour();
    }
    azimuth.truth("course", &passage.azimuths(times, rate_hz));
    (azimuth, elevation)
}

/// Azimuth and range at the ocean bottom.
fn heard(passage: &Passage, times: &Times, messages: &[Message], rate_hz: f64) -> (Plot, Plot) {
    let mut azimuth = against_time("Azimuth", "azimuth (°)", passage, times);
    let mut range = against_time("Range", "range (km)", passage, times);
    azimuth.y_scale(Scale::Degrees);
    let shown = |index: u64| {
        let t_s = index as f64 / rate_hz;
        (passage.shown_s.0..=passage.shown_s.1).contains(&t_s).then(|| times.at(t_s))
    };
    let azimuths = messages.iter().filter_map(|m| match m {
        Message::Azimuth(a) if a.detected => {
            Some((shown(a.index)?, wrap_deg(f64::from(a.azimuth).to_degrees())))
        }
        _ => None,
    });
    let ranges = messages.iter().filter_map(|m| match m {
        Message::Range(r) if r.detected => Some((shown(r.index)?, f64::from(r.range_m) / 1e3)),
        _ => None,
    });
    azimuth.points("detections", &azimuths.collect::<Vec<_>>());
    azimuth.truth("course", &passage.azimuths(times, rate_hz));
    range.points("detections", &ranges.collect::<Vec<_>>());
    range.truth("course", &passage.ranges_km(times, rate_hz));
    (azimuth, range)
}

/// The course on a map, with times, the way it goes and the ellipse of its last point.
fn map(passage: &Passage, times: &Times, rate_hz: f64) -> Plot {
    let mut figure = Plot::map("Course");
    figure.size(RIGHT, 440);
    if !passage.is_placed() {
        return figure;
    }
    let t = &passage.last;
    let (from, to) = passage.heard_s;
    let at = |t_s: f64| passage.place(t_s, rate_hz);
    figure.line(&format!("track {}", t.id), &[at(from), at(to)]);
    // The way it goes: a head at the end.
    let length = 0.05 * (at(to).0 - at(from).0).hypot(at(to).1 - at(from).1);
    let barb = |turn: f64| {
        let (s, c) = (f64::from(t.heading) + turn).sin_cos();
        (at(to).0 - length * s, at(to).1 - length * c)
    };
    figure.line("", &[barb(0.4), at(to), barb(-0.4)]).same_colour();
    let centre = (f64::from(t.x_m), f64::from(t.y_m));
    let variances = (t.var_x_m2.into(), t.var_y_m2.into(), t.cov_xy_m2.into());
    figure.ellipse("95 % ellipse", centre, variances, 0.95).same_colour();
    let mut marked = vec![from, to];
    if t.cpa_time_s > from && t.cpa_time_s < to {
        marked.push(t.cpa_time_s);
    }
    figure.points("", &marked.iter().map(|t_s| at(*t_s)).collect::<Vec<_>>()).same_colour();
    figure.notes(marked.into_iter().map(|t_s| (at(t_s), times.clock(t_s))).collect());
    figure
}

/// What is stated of the passage, in words.
fn stated(passage: &Passage, times: &Times, station: &str) -> Plot {
    let t = &passage.last;
    let degrees = |x: f32| f64::from(x).to_degrees();
    let pm = |value: f64, sd: f64, digits: usize, unit: &str| {
        if !value.is_finite() {
            "not observable".to_owned()
        } else if sd.is_finite() {
            format!("{value:.digits$} ± {sd:.digits$} {unit}")
        } else {
            format!("{value:.digits$} {unit}")
        }
    };
    let solution = if t.stage == Track::FINAL { "end-of-passage solution" } else { "running estimate" };
    let range = if t.range_observable { f64::from(t.cpa_range_m) } else { f64::NAN };
    let side = if t.starboard { "starboard" } else { "port" };
    let lines = [
        format!("Station {station}, track {}: {solution}", t.id),
        format!("Heard from {} to {}", times.clock(passage.heard_s.0), times.clock(passage.heard_s.1)),
        format!(
            "Closest at {} ± {:.1} s, at {:.1}°",
            times.clock(t.cpa_time_s),
            t.sd_cpa_time_s,
            wrap_deg(degrees(t.cpa_azimuth))
        ),
        format!("Closest range {}", pm(range, t.sd_cpa_range_m.into(), 0, "m")),
        format!("Heading {}", pm(wrap_deg(degrees(t.heading)), degrees(t.sd_heading), 1, "°")),
        format!("Speed {}", pm(t.speed_m_s.into(), t.sd_speed_m_s.into(), 2, "m/s")),
        format!("Station on its {side} side; {} measurements", t.n),
        "± is one standard deviation".to_owned(),
    ];
    let mut figure = Plot::new("Stated", "", "");
    figure.size(RIGHT, 280).words(lines.to_vec());
    figure
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(id: u16, stage: u8, index: u64) -> Message {
        Message::Track(Track {
            id,
            stage,
            index,
            cpa_time_s: 50.0,
            cpa_range_m: 500.0,
            cpa_azimuth: 0.0,
            heading: 1.570_796_4,
            speed_m_s: 7.0,
            starboard: true,
            sd_cpa_time_s: 0.1,
            sd_cpa_range_m: 9.0,
            sd_heading: 0.01,
            sd_speed_m_s: 0.0,
            x_m: 350.0,
            y_m: 500.0,
            var_x_m2: 100.0,
            var_y_m2: 400.0,
            cov_xy_m2: 50.0,
            range_observable: true,
            n: 200,
        })
    }

    #[test]
    fn a_passage_is_what_was_not_withdrawn_and_its_course_goes_through_its_closest_point() {
        let rate_hz = 100.0;
        let (running, last) = (track(1, Track::RUNNING, 2_000), track(1, Track::FINAL, 10_000));
        let gone = [track(2, Track::RUNNING, 3_000), track(2, Track::WITHDRAWN, 4_000)];
        let all = passages(&[running, gone[0], gone[1], last], rate_hz);
        assert_eq!(all.len(), 1);
        let passage = &all[0];
        assert_eq!((passage.heard_s, passage.last.stage), ((20.0, 100.0), Track::FINAL));
        let (x, y) = passage.place(50.0, rate_hz);
        assert!(x.abs() < 1e-3 && (y - 500.0).abs() < 1e-3, "{x} {y}");
    }
}
