//! Vessels too far away to be ranged: tracks of an ocean-bottom station from azimuths and tones alone.
//!
//! Enter: what the recorder says each minute ([`heard`]: tonal azimuths, ranges, its own tracks), and, where the recording is at hand, the
//! lines of its spectra ([`tones`]). Leave: one track a vessel ([`Track`]).
//!
//! 1. Azimuths are joined along smooth curves ([`curves`]); pieces that one straight course explains are one vessel's.
//! 2. To each curve the straight course is fitted ([`course`], the fit of `seabearing track`). Azimuths of one station tell the time and
//!    azimuth of the closest point, the heading and the speed over the range there, and no length [M 5, 6].
//! 3. Lines that come from the curve's direction fall in frequency as the vessel passes; by how much is its speed ([`doppler`]), and with it
//!    range is known.
//! 4. Ranges that a track of the recorder explains, whose vessel stands where the curve does, are this vessel's: the fit takes them, and knows all.
//!
//! What is not observable is `None`. Assumed: straight courses, one direction a vessel. *Fails* where a vessel turns (the misfit makes the
//! deviations grow), where two vessels' curves cross at like rates, and where a vessel comes straight on: its bearing stands still.

pub mod course;
pub mod curves;
pub mod doppler;
pub mod heard;
pub mod picture;
pub mod tones;

use crate::propagation::Propagation;
use course::Course;
use curves::Curve;
use heard::{Direction, Heard};
use tones::Minute;

/// Deviations by which the speed that ranges give may differ from that of the tones.
const CONTRADICTS: f64 = 3.0;

/// What is known of the station.
#[derive(Clone, Copy, Debug)]
pub struct Place<'t> {
    /// Speed of sound for travel times, m/s.
    pub sound_speed_m_s: f64,
    /// Depth of the floor, m: ranges count only where it is known.
    pub depth_m: Option<f64>,
    /// Standard deviation of its orientation, rad; the azimuths' own deviations hold it.
    pub orientation_sd: f64,
    /// How sound travels, where that is known.
    pub table: Option<&'t Propagation>,
}

/// A number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

/// What told how far away a vessel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// The fall of its tones gives its speed.
    Tones,
    /// Its ranges.
    Ranges,
}

impl Scale {
    /// As records name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tones => "tones",
            Self::Ranges => "ranges",
        }
    }
}

/// The closest point as azimuths tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Its time, s.
    pub time_s: Known,
    /// Its azimuth, rad.
    pub azimuth: Known,
    /// Heading, rad.
    pub heading: Known,
    /// The station lies to starboard.
    pub starboard: bool,
    /// Speed over range there, 1/s.
    pub speed_over_range: Option<Known>,
}

/// Where a vessel is on its way past the station.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Before its closest point.
    Approaching,
    /// About it.
    Passing,
    /// After it.
    Leaving,
}

impl Phase {
    /// As records name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Approaching => "approaching",
            Self::Passing => "passing",
            Self::Leaving => "leaving",
        }
    }
}

/// A line of the spectrum that comes from where the vessel is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Its frequency in the middle of its time, Hz.
    pub hz: f64,
    /// Minutes in which it stands out.
    pub n: usize,
}

/// What is known of one vessel.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Its azimuths, in order of time.
    pub directions: Vec<Direction>,
    /// The fitted course.
    pub course: Course,
    /// Azimuth at the last of them, rad.
    pub azimuth: Known,
    /// Rate of the azimuth there, rad/s, positive clockwise.
    pub turning: Known,
    /// The closest point; `None` where the bearing has not turned enough to tell it.
    pub closest: Option<Closest>,
    /// Where it is on its way at the last azimuth.
    pub phase: Option<Phase>,
    /// Speed, m/s.
    pub speed_m_s: Option<Known>,
    /// Range of the closest point, m.
    pub range_m: Option<Known>,
    /// What told speed and range.
    pub scale: Option<Scale>,
    /// Ranges that are its.
    pub ranges: usize,
    /// Ranges that its tones contradict: those of another pair of paths.
    pub ranges_refused: usize,
    /// Lines from its direction.
    pub tones: Vec<Tone>,
    /// Numbers of the recorder's own tracks of it.
    pub recorder_tracks: Vec<u16>,
}

impl Track {
    /// East and North of the station at a time, m, where the distance is known.
    pub fn place_m(&self, t_s: f64) -> Option<(f64, f64)> {
        let (range_m, speed_m_s) = (self.range_m?.value, self.speed_m_s?.value);
        let closest = self.closest?;
        let along = speed_m_s * (t_s - closest.time_s.value);
        let ((sa, ca), (sh, ch)) = (closest.azimuth.value.sin_cos(), closest.heading.value.sin_cos());
        Some((range_m * sa + along * sh, range_m * ca + along * ch))
    }
}

/// Finds the vessels in what was heard. `minutes` are the lines of the recording, where it is at hand.
pub fn tracks(heard: &Heard, minutes: &[Minute], place: &Place<'_>) -> Vec<Track> {
    let curves = course::joined(curves::curves(&heard.directions), place);
    curves.into_iter().filter_map(|curve| track(curve, heard, minutes, place)).collect()
}

fn track(curve: Curve, heard: &Heard, minutes: &[Minute], place: &Place<'_>) -> Option<Track> {
    let alone = course::fit(&curve.directions, &[], place)?;
    let chains = tones::chains(&curve, &alone, minutes);
    let by_tones = doppler::speed(&alone, &chains, place);
    let (ranges, recorder_tracks) = heard.of_curve(&curve, place);
    let ranged = course::fit(&curve.directions, &ranges, place).filter(|c| c.scale.is_some());
    // Ranges read as another pair of paths make a course as good, at another speed: the tones know better.
    let contradicts = |c: &Course| {
        let s = &c.solution;
        by_tones
            .is_some_and(|(v, _)| (v.value - s.speed_m_s).abs() > CONTRADICTS * v.sd.hypot(s.sd_speed_m_s))
    };
    let taken = ranged.filter(|c| !contradicts(c));
    let refused = ranged.is_some() && taken.is_none();
    let mut out = taken.unwrap_or(alone).track(curve.directions, place);
    out.tones = chains.iter().map(|c| Tone { hz: c.middle_hz(), n: c.points.len() }).collect();
    out.ranges_refused = if refused { ranges.len() } else { 0 };
    if taken.is_some() {
        (out.ranges, out.recorder_tracks) = (ranges.len(), recorder_tracks);
    }
    if out.scale.is_none()
        && let Some((speed, range)) = by_tones
    {
        (out.speed_m_s, out.range_m, out.scale) = (Some(speed), Some(range), Some(Scale::Tones));
    }
    Some(out)
}
