//! Position and orientation of an ocean-bottom station from its records or recordings, and vessels of known track.

use super::orient::orientation;
use super::place::{Displacement, NotObserved, Travel, alone, heard, place};
use super::records::{self, Detected};
use super::stages::{self, SpectralFrame};
use crate::course::{EastNorth, VesselCourse, polar};
use crate::propagation::{Propagation, file};
use crate::recording;
use crate::station::Station;
use anyhow::{Context, Result, anyhow};
use seabearing_core::angle::wrap_pi;
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::offset::{Residual, offset};
use std::path::PathBuf;

/// Bins of the tone band, 11 to 24 Hz.
const TONES: std::ops::Range<usize> = 226..492;

/// What a survey finds. The position comes first into the orientation; where it is not observable, the nominal one does.
pub struct Survey {
    /// The station's place relative to its nominal one.
    pub position: Result<Displacement, NotObserved>,
    /// What to add to the orientation in the station file.
    pub turn: Result<Turn>,
    /// The propagation table the ranges are of.
    pub table: Propagation,
}

/// What to add to a station's orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// The correction, rad.
    pub correction: f64,
    /// Its standard deviation, rad.
    pub sd: f64,
    /// From records: error of a single azimuth, rad; share of azimuths that support the value.
    pub quality: Option<(f64, f64)>,
    /// Azimuths or frames used.
    pub n: usize,
    /// Passages used.
    pub passages: usize,
}

/// Surveys a station by its records of azimuth and range, or by its recordings. Tracks are cut where their points are
/// farther apart than `max_gap_s`; the station is looked for within `search_m` of its nominal place.
///
/// # Errors
/// Bad input; what is not observable is said in the [`Survey`].
pub fn survey(
    station: &Station,
    input: &[PathBuf],
    tracks: &[Vec<TrackPoint>],
    max_gap_s: f64,
    search_m: f64,
) -> Result<Survey> {
    let courses: Vec<VesselCourse> = tracks.iter().flat_map(|t| courses(t, max_gap_s)).collect();
    let table_path = station.propagation.as_ref().context(
        "the station file names no propagation table, which the position needs (key `propagation`)",
    )?;
    let table = file::read(table_path)?;
    let travel = |range_m: f64| table.travel_time_s((range_m / table.step_m).round() as usize);
    let at = |position: &Result<Displacement, NotObserved>| {
        position.as_ref().map_or((0.0, 0.0), |p| (p.east_m, p.north_m))
    };
    let (position, turn) = if input.iter().all(|p| records::is_records(p)) {
        let heard = records::read(input)?;
        let position = place(&heard.ranges, &courses, &travel, search_m);
        let turn = turn_of_records(&heard, &courses, &travel, at(&position));
        (position, turn)
    } else {
        let frames = stages::frames(recording::open(input, station, None)?.as_mut(), &station.config)?;
        let position = place(&stages::range_evidence(&frames, &table), &courses, &travel, search_m);
        let turn = turn_of_frames(&frames, &courses, &travel, at(&position));
        (position, turn)
    };
    Ok(Survey { position, turn, table })
}

/// A track as courses: cut where its points are farther apart than may be interpolated.
fn courses(track: &[TrackPoint], max_gap_s: f64) -> Vec<VesselCourse> {
    track
        .chunk_by(|a, b| b.t_s - a.t_s <= max_gap_s)
        .filter(|run| run.len() > 1)
        .map(|run| {
            VesselCourse::Fixes(run.iter().map(|p| (p.t_s, (p.position_m[0], p.position_m[1]))).collect())
        })
        .collect()
}

/// From azimuth records: the robust location of their differences from the vessels' azimuths.
fn turn_of_records(
    said: &Detected,
    courses: &[VesselCourse],
    travel: &Travel<'_>,
    at: EastNorth,
) -> Result<Turn> {
    let mut residuals: Vec<Residual> = Vec::new();
    for (t_s, azimuth) in &said.azimuths {
        let Some((n, course)) = alone(courses, *t_s) else { continue };
        let Some(place) = heard(travel, course, *t_s, at) else { continue };
        residuals.push(Residual { angle: wrap_pi(polar(place).1 - azimuth), pass: n as u32 });
    }
    residuals.sort_by_key(|r| r.pass);
    let n = residuals.len();
    let found = offset(&residuals).map_err(|e| {
        anyhow!("the orientation is not observed: {e} ({n} azimuths with one vessel of known track near)")
    })?;
    Ok(Turn {
        correction: found.offset,
        sd: found.sd,
        quality: Some((found.scale, found.support)),
        n: found.n,
        passages: found.passes,
    })
}

/// From the recording: the mode of the azigram's differences from the vessels' azimuths.
fn turn_of_frames(
    frames: &[SpectralFrame],
    courses: &[VesselCourse],
    travel: &Travel<'_>,
    at: EastNorth,
) -> Result<Turn> {
    let turn = orientation(frames, courses, travel, at, TONES)
        .context("the orientation is not observed: no passage of 30 frames with one vessel of known track at 3 to 40 km")?;
    let near = frames.iter().filter(|f| alone(courses, f.t_s).is_some()).count();
    Ok(Turn { correction: turn.correction, sd: turn.sd, quality: None, n: near, passages: turn.passages })
}
