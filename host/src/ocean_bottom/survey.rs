//! Position and orientation of an ocean-bottom station from its records or recordings, and vessels of known track.

use super::mirrored::{Horizontals, Pairing, doubt};
use super::orient::orientation;
use super::place::{Displacement, NotObserved, Travel, alone, heard, place};
use super::records;
use super::stages::{self, SpectralFrame};
use crate::course::{EastNorth, VesselCourse, polar};
use crate::propagation::{Propagation, file};
use crate::recording;
use crate::station::Station;
use anyhow::{Context, Result, anyhow};
use seabearing_core::angle::wrap_pi;
use seabearing_core::config::Kind;
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
    /// What is wrong with the horizontal components, told from records.
    pub doubt: Option<Horizontals>,
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
    let (position, turn, doubt) = if input.iter().all(|p| records::is_records(p)) {
        let heard = records::read(input)?;
        let position = place(&heard.ranges, &courses, &travel, search_m);
        let pairings = pairings(&heard.azimuths, &courses, &travel, at(&position));
        (position, turn_of_records(&pairings), doubt(&pairings, orientation_of_north(station)))
    } else {
        let frames = stages::frames(recording::open(input, station, None)?.as_mut(), &station.config)?;
        let position = place(&stages::range_evidence(&frames, &table), &courses, &travel, search_m);
        let turn = turn_of_frames(&frames, &courses, &travel, at(&position));
        (position, turn, None)
    };
    Ok(Survey { position, turn, doubt, table })
}

/// True azimuth of the north component as configured, rad.
fn orientation_of_north(station: &Station) -> f64 {
    match &station.config.kind {
        Kind::Obs(o) => o.orientation_of_north_deg.to_radians(),
        _ => 0.0,
    }
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

/// Azimuths (time s, rad) beside those of the vessel of known track, where one alone was near; in order of passages.
pub fn pairings(
    azimuths: &[(f64, f64)],
    courses: &[VesselCourse],
    travel: &Travel<'_>,
    at: EastNorth,
) -> Vec<Pairing> {
    let mut pairings: Vec<Pairing> = azimuths
        .iter()
        .filter_map(|(t_s, measured)| {
            let (n, course) = alone(courses, *t_s)?;
            let place = heard(travel, course, *t_s, at)?;
            Some(Pairing { truth: polar(place).1, measured: *measured, pass: n as u32 })
        })
        .collect();
    pairings.sort_by_key(|p| p.pass);
    pairings
}

/// From azimuth records: the robust location of their differences from the vessels' azimuths.
fn turn_of_records(pairings: &[Pairing]) -> Result<Turn> {
    let residuals: Vec<Residual> =
        pairings.iter().map(|p| Residual { angle: wrap_pi(p.truth - p.measured), pass: p.pass }).collect();
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
