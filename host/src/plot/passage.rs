//! A page for each passage of a vessel: what it sounded like, where it was heard from, its course and what is stated of it.
//!
//! Enters: what the recorder said of a whole recording, and the samples once more, for spectrograms. Leaves:
//! `passage-N.svg`, N the track's number. The array's page shows azimuth and elevation, the ocean bottom's azimuth and range;
//! its panels have one axis of time. The page's own track stands out; what belongs to others is faded and named.
//! The line in the panels is the final course; its band is not drawn, for errors along a course hang together.

use super::directions::{self, Angle, NOBODY, faded};
use super::heard::{Belonging, Heard, Passage, reports};
use super::spectrogram::Spectrogram;
use super::times::Times;
use super::{Plot, Scale, ways, write_panels};
use crate::angle::wrap_deg;
use crate::recording::BlockSource;
use crate::station::Station;
use anyhow::Result;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::wire::{Bearing, Message, Track};
use std::path::Path;
use time::OffsetDateTime;

/// Width of the left column, and of the right one, points.
pub(super) const LEFT: u32 = 760;
const RIGHT: u32 = 540;

/// A range of the ocean bottom belongs to a track whose course is so near, km, or within three standard deviations.
const RANGE_GATE_KM: f64 = 3.0;

/// The bearings among messages, and the directions they are.
fn of_array(messages: &[Message], rate_hz: f64) -> (Vec<Bearing>, Vec<Heard>) {
    let bearing = |m: &Message| if let Message::Bearing(b) = m { Some(*b) } else { None };
    let bearings: Vec<Bearing> = messages.iter().filter_map(bearing).collect();
    let heard = bearings.iter().map(|b| Heard::of(b, rate_hz)).collect();
    (bearings, heard)
}

/// The tonal detections of an ocean-bottom station as directions.
pub(crate) fn tonal(messages: &[Message], rate_hz: f64) -> Vec<Heard> {
    let one = |m: &Message| match m {
        Message::Azimuth(a) if a.detected && a.kind == 0 => Some(Heard {
            t_s: a.index as f64 / rate_hz,
            azimuth_deg: wrap_deg(f64::from(a.azimuth).to_degrees()),
            sd_deg: f64::from(a.sd).to_degrees(),
        }),
        _ => None,
    };
    messages.iter().filter_map(one).collect()
}

/// The passages that an ocean-bottom station reported and did not withdraw, with their detections.
pub(crate) fn ocean_bottom(messages: &[Message], config: &StationConfig) -> Belonging {
    Belonging::of(&reports(messages), &tonal(messages, config.rate_hz), config)
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
    let config = &station.config;
    let rate_hz = config.rate_hz;
    let at_bottom = matches!(config.kind, Kind::Obs(_));
    let (bearings, heard) =
        if at_bottom { (Vec::new(), tonal(messages, rate_hz)) } else { of_array(messages, rate_hz) };
    let found = Belonging::of(&reports(messages), &heard, config);
    let mut sounds: Vec<Spectrogram> = found
        .passages
        .iter()
        .map(|p| Spectrogram::new(rate_hz, p.shown_s(), &station.calibration[0]))
        .collect();
    let end_s = found.passages.iter().map(|p| p.shown_s().1).fold(0.0, f64::max);
    while let Some(block) = source.next_block()? {
        sounds.iter_mut().for_each(|sound| sound.take(&block));
        if block.first_index as f64 > end_s * rate_hz {
            break;
        }
    }
    let full_scale = f64::from(config.full_scale);
    for (k, (passage, sound)) in found.passages.iter().zip(&sounds).enumerate() {
        let times = Times::new(start, passage.shown_s().1);
        let source = times.source(&config.name);
        let mut sound = sound.plot(&times, full_scale);
        sound.caption(&format!(
            "Spectral density of {} against time and frequency: mean of Hann windows in each cell. {source}",
            station.calibration[0].quantity.replace('_', " ")
        ));
        let mut map = Plot::map("Course");
        map.size(RIGHT, 440).caption(&map_words(passage));
        ways::alone(&mut map, passage, &times);
        let [mut azimuth, mut other] = if at_bottom {
            detections(k, &found, &heard, &times, messages, rate_hz)
        } else {
            [Angle::Azimuth, Angle::Elevation].map(|angle| {
                let mut figure =
                    directions::panel(angle, &bearings, &found, rate_hz, &times, passage.shown_s(), Some(k));
                figure.caption(&directions::words(angle, true));
                figure
            })
        };
        azimuth.truth("course", &passage.azimuths(&times));
        if at_bottom {
            other.truth("course", &passage.ranges_km(&times));
        }
        let (from, to) = passage.shown_s();
        for figure in [&mut sound, &mut azimuth, &mut other] {
            figure.x_range(times.at(from), times.at(to));
        }
        for figure in [&mut azimuth, &mut other] {
            figure.size(LEFT, 280);
        }
        let panels = [sound, map, azimuth, stated(passage, &times, &config.name), other];
        let path = folder.join(format!("passage-{}.svg", passage.last.id));
        write_panels(&path, &panels.iter().collect::<Vec<_>>(), 2)?;
    }
    Ok(found.passages.len())
}

fn map_words(passage: &Passage) -> String {
    if !passage.is_placed() {
        return "No course is drawn: nothing is known of the track's range.".to_owned();
    }
    "Straight course by the last solution, with UTC at its ends and its closest point; the ellipse holds the last place with 95 %. \
     Black triangle: the station."
        .to_owned()
}

/// Azimuth and range of the detections of an ocean-bottom station.
fn detections(
    alone: usize,
    found: &Belonging,
    heard: &[Heard],
    times: &Times,
    messages: &[Message],
    rate_hz: f64,
) -> [Plot; 2] {
    let mut azimuth = Plot::new("Azimuth", "", "azimuth (°)");
    let mut range = Plot::new("Range", "", "range (km)");
    let own = found.passages.get(alone);
    let (from, to) = own.map_or((0.0, 0.0), Passage::shown_s);
    let shown = |t_s: f64| (from..=to).contains(&t_s);
    let of = |whose: Option<usize>| {
        let these = heard.iter().zip(&found.whose).filter(|(h, w)| **w == whose && shown(h.t_s));
        these.map(|(h, _)| (times.at(h.t_s), h.azimuth_deg)).collect::<Vec<_>>()
    };
    azimuth.points("of no track", &of(None)).coloured(NOBODY).sized(1.6);
    for (k, passage) in found.passages.iter().enumerate().filter(|(k, _)| *k != alone) {
        let points = of(Some(k));
        if !points.is_empty() {
            azimuth
                .points(&format!("{} (another)", passage.name()), &points)
                .coloured(faded(passage.colour()))
                .sized(1.6);
        }
    }
    let mut ranges = [Vec::new(), Vec::new()];
    for message in messages {
        let Message::Range(r) = message else { continue };
        let (t_s, km) = (r.index as f64 / rate_hz, f64::from(r.range_m) / 1e3);
        if !r.detected || !shown(t_s) {
            continue;
        }
        let near = own.is_some_and(|passage| {
            let (x, y) = passage.place(t_s);
            (x.hypot(y) / 1e3 - km).abs() <= RANGE_GATE_KM.max(3e-3 * f64::from(r.sd_range_m))
        });
        ranges[usize::from(near)].push((times.at(t_s), km));
    }
    range.points("of no track, or of another", &ranges[0]).coloured(NOBODY).sized(1.6);
    if let Some(passage) = own {
        azimuth.points(&passage.name(), &of(Some(alone))).coloured(passage.look());
        range.points(&passage.name(), &ranges[1]).coloured(passage.look());
    }
    azimuth.y_scale(Scale::Degrees).y_range(0.0, 360.0);
    azimuth.caption(
        "Azimuth of each tonal detection, degrees clockwise from true North: this track's in full colour, others' faded, those \
         of no track grey. Line: the course by the last solution.",
    );
    range.caption(
        "Horizontal range of each detection: those within 3 km, or three standard deviations, of this track's course in colour, others grey. Line: \
         the course by the last solution.",
    );
    for figure in [&mut azimuth, &mut range] {
        times.along(figure);
    }
    [azimuth, range]
}

/// What is stated of the passage, in words.
fn stated(passage: &Passage, times: &Times, station: &str) -> Plot {
    let t = &passage.last;
    let degrees = |x: f32| f64::from(x).to_degrees();
    let pm = |value: f64, sd: f64, digits: usize, unit: &str| {
        if !value.is_finite() {
            "not observable".to_owned()
        } else if sd.is_finite() {
            // Two digits of the deviation.
            let digits = if sd > 0.0 { (1.0 - sd.log10().floor()).clamp(0.0, 4.0) as usize } else { digits };
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
        heard_words(passage, times),
        format!(
            "Closest at {} ± {:.1} s, at {:.1}°",
            times.clock(t.cpa_time_s),
            t.sd_cpa_time_s,
            wrap_deg(degrees(t.cpa_azimuth))
        ),
        format!("Closest range {}", pm(range, t.sd_cpa_range_m.into(), 0, "m")),
        format!("Heading {}", pm(wrap_deg(degrees(t.heading)), degrees(t.sd_heading), 1, "°")),
        // A speed that is declared without a deviation is no estimate.
        match t.sd_speed_m_s {
            0.0 => format!("Speed {} m/s, as declared", t.speed_m_s),
            sd => format!("Speed {}", pm(t.speed_m_s.into(), sd.into(), 2, "m/s")),
        },
        format!("Station on its {side} side; {} measurements", t.n),
        "± is one standard deviation".to_owned(),
    ];
    let mut figure = Plot::new("Stated", "", "");
    figure.size(RIGHT, 280).words(lines.to_vec());
    figure
}

/// When it was heard: its first and last direction, or where none is told apart, its reports.
fn heard_words(passage: &Passage, times: &Times) -> String {
    let (from, to) = (times.clock(passage.heard_s.0), times.clock(passage.heard_s.1));
    match passage.own {
        0 => format!("Reported from {from} to {to}"),
        n => format!("Heard from {from} to {to}, {n} directions"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::heard::tests::{RATE_HZ, bearing, track};
    use super::*;

    #[test]
    fn a_track_is_heard_from_its_first_bearing_on_not_from_its_first_report() {
        let way = (50.0, 500.0);
        let messages: Vec<Message> = (10..90)
            .map(|t| Message::Bearing(bearing(f64::from(t), way)))
            .chain((30..90).map(|t| Message::Track(track(1, 0, f64::from(t), way))))
            .collect();
        let (_, heard) = of_array(&messages, RATE_HZ);
        let mut found = Belonging::of_array(&reports(&messages), &heard, RATE_HZ);
        let times = Times::new(None, 100.0);
        assert_eq!(heard_words(&found.passages[0], &times), "Heard from 10.0 s to 89.0 s, 80 directions");
        found = Belonging::of_array(&reports(&messages), &[], RATE_HZ);
        assert_eq!(heard_words(&found.passages[0], &times), "Reported from 30.0 s to 89.0 s");
    }
}
