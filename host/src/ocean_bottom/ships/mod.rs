//! What is known of each ship that an ocean-bottom station tracked.
//!
//! Enters: all that the recorder's chain said of a recording, and its lines minute by minute (`far/tones.rs`). Leaves: a [`Ship`] for each
//! track that was not withdrawn: when it was heard, its closest point, heading and speed with their standard deviations, its tones, the spacing
//! of those that are a comb, the segments of its time, and what may be doubted ([`Doubt`]). [`told`] writes them.

mod course;
mod doubted;
pub mod told;
mod tones;

pub(crate) use course::Way;
pub use doubted::{Doubted, doubted};
pub use tones::{Comb, ShipTone};

use super::far::tones::Minute;
use crate::plot::heard::{Belonging, Passage};
use crate::plot::passage;
use seabearing_core::config::StationConfig;
use seabearing_core::wire::{Message, Range, Segment, Track};
use std::collections::{BTreeMap, BTreeSet};

/// A range belongs to a track whose course is so near, m, or within three of its standard deviations.
const RANGE_GATE_M: f64 = 3_000.0;
/// Two ships within this azimuth of each other are heard as one direction, degrees.
const BESIDE_DEG: f64 = 20.0;
/// Share of its time from which on a ship beside another is said to be so.
const BESIDE: f64 = 0.25;
/// A closest range with a standard deviation above this share of it, and above so many metres, is loose.
const LOOSE: (f64, f64) = (0.1, 300.0);
/// Share of a segment, or of the ship's time, that both have in common at least for the segment to be named with the ship.
const SHARED: f64 = 0.5;

/// Detected ranges of its own from which on a range is no course's alone.
const FEW_RANGES: usize = 3;

/// What may be doubted about a ship.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Doubt {
    /// Its passage had not ended: the last running solution stands for the final one.
    Running,
    /// Its range is not observable: azimuths alone.
    NoRange,
    /// The closest range's standard deviation is more than a tenth of it.
    LooseRange,
    /// Fewer than three detected ranges are its own: its range is that of a course through minutes none of which tells one by itself.
    FewRanges,
    /// For more than a quarter of its time another track was within 20° of it, and one direction was heard of the two.
    Beside(u16),
    /// The station doubted its own set-up in that time: what a warning among the records says.
    SetUp,
}

/// A ship as it is known.
#[derive(Clone, Debug)]
pub struct Ship {
    /// The recorder's track: the final solution, or the last report of a passage that had not ended.
    pub track: Track,
    /// Times of its first and last azimuth, s from the first sample.
    pub heard_s: (f64, f64),
    /// Azimuths that belong to it.
    pub azimuths: usize,
    /// Share of the minutes between the first and the last that have one: 1 is unbroken.
    pub heard_share: f64,
    /// Detected ranges within 3 km, or three standard deviations, of its course.
    pub ranges: usize,
    /// Numbers of the segments of its time.
    pub segments: Vec<u16>,
    /// Its tones, as they are radiated, the most steadily heard first.
    pub tones: Vec<ShipTone>,
    /// The comb that most of its tones, three at least, are neighbouring teeth of: a blade or shaft rate.
    pub comb: Option<Comb>,
    /// What may be doubted.
    pub doubts: Vec<Doubt>,
}

/// Ships of a recording, in the order of their tracks' numbers. `depth_m`: that of the floor; `lines`: those of the recording, or none.
pub fn ships(messages: &[Message], config: &StationConfig, depth_m: f64, lines: &[Minute]) -> Vec<Ship> {
    known(&passage::ocean_bottom(messages, config), messages, config, depth_m, lines)
}

/// The same of passages that were found already; a ship for each.
pub(crate) fn known(
    found: &Belonging,
    messages: &[Message],
    config: &StationConfig,
    depth_m: f64,
    lines: &[Minute],
) -> Vec<Ship> {
    let ways: Vec<Way<'_>> = found.passages.iter().map(|p| Way::of(p, config, depth_m)).collect();
    let own_minutes = minutes_of(found, messages, config.rate_hz);
    let segments = segments(messages);
    let one = |(k, passage): (usize, &Passage)| {
        let minutes = (passage.heard_s.1 - passage.heard_s.0) / 60.0;
        let tones = tones::of(&ways, k, lines);
        let ranges = detected(messages).filter(|r| belongs(r, &ways[k], passage, config.rate_hz)).count();
        let mut doubts = doubts(&ways, k, messages, config.rate_hz);
        if passage.last.range_observable && ranges < FEW_RANGES {
            doubts.push(Doubt::FewRanges);
        }
        Ship {
            track: passage.last,
            heard_s: passage.heard_s,
            azimuths: passage.own,
            heard_share: (own_minutes[k] as f64 / (minutes.round() + 1.0)).min(1.0),
            ranges,
            segments: segments.iter().filter(|s| shares(s, passage, config.rate_hz)).map(|s| s.id).collect(),
            comb: tones::comb(&tones),
            tones,
            doubts,
        }
    };
    found.passages.iter().enumerate().map(one).collect()
}

/// Minutes that have an azimuth of each passage.
fn minutes_of(found: &Belonging, messages: &[Message], rate_hz: f64) -> Vec<usize> {
    let mut minutes = vec![BTreeSet::new(); found.passages.len()];
    let heard = passage::tonal(messages, rate_hz);
    for (one, whose) in heard.iter().zip(&found.whose) {
        if let Some(own) = whose.and_then(|k| minutes.get_mut(k)) {
            own.insert((one.t_s / 60.0).round() as u64);
        }
    }
    minutes.iter().map(BTreeSet::len).collect()
}

/// The detected ranges.
fn detected(messages: &[Message]) -> impl Iterator<Item = &Range> {
    messages
        .iter()
        .filter_map(|m| if let Message::Range(r) = m { Some(r) } else { None })
        .filter(|r| r.detected)
}

/// Whether a range is this passage's.
pub(crate) fn belongs(r: &Range, way: &Way<'_>, passage: &Passage, rate_hz: f64) -> bool {
    let t_s = r.index as f64 / rate_hz;
    let near = |range_m: f64| {
        (range_m - f64::from(r.range_m)).abs() <= RANGE_GATE_M.max(3.0 * f64::from(r.sd_range_m))
    };
    passage.is_placed() && way.is_heard(t_s) && near(way.range_m(t_s))
}

/// The last word on each whole segment.
fn segments(messages: &[Message]) -> Vec<Segment> {
    let mut last = BTreeMap::new();
    for m in messages {
        if let Message::Segment(s) = m
            && s.kind == 0
        {
            last.insert(s.id, *s);
        }
    }
    last.into_values().collect()
}

/// Whether a segment and a passage have most of one of them in common.
fn shares(s: &Segment, passage: &Passage, rate_hz: f64) -> bool {
    let (a, b) = (s.start as f64 / rate_hz, s.end as f64 / rate_hz);
    let common = b.min(passage.heard_s.1) - a.max(passage.heard_s.0);
    let least = (b - a).min(passage.heard_s.1 - passage.heard_s.0);
    common > 0.0 && common >= SHARED * least
}

fn doubts(ways: &[Way<'_>], k: usize, messages: &[Message], rate_hz: f64) -> Vec<Doubt> {
    let own = &ways[k];
    let t = own.track();
    let mut out = Vec::new();
    if t.stage != Track::FINAL {
        out.push(Doubt::Running);
    }
    if !t.range_observable {
        out.push(Doubt::NoRange);
    } else if t.sd_cpa_range_m > (LOOSE.0 * f64::from(t.cpa_range_m)).max(LOOSE.1) as f32 {
        out.push(Doubt::LooseRange);
    }
    let minutes = own.minutes();
    for (_, other) in ways.iter().enumerate().filter(|(j, _)| *j != k) {
        let beside =
            minutes.iter().filter(|t_s| other.is_heard(**t_s) && own.apart_deg(other, **t_s) < BESIDE_DEG);
        if beside.count() as f64 > BESIDE * minutes.len() as f64 {
            out.push(Doubt::Beside(other.track().id));
        }
    }
    if doubted(messages, rate_hz).iter().any(|d| d.within(own.heard_s())) {
        out.push(Doubt::SetUp);
    }
    out
}
