//! `seabearing orient` for an ocean-bottom station from its records or recordings: orientation and position.

use super::orient::degrees;
use crate::geodesy::LocalFrame;
use crate::ocean_bottom::course::{Course, Place, polar};
use crate::ocean_bottom::orient::orientation;
use crate::ocean_bottom::place::{Offset, Travel, alone, heard, place};
use crate::ocean_bottom::records::{self, Records};
use crate::ocean_bottom::stages::{self, Frame};
use crate::propagation::{Propagation, file};
use crate::record::finite;
use crate::recording;
use crate::station::Station;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::config::Kind;
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::offset::{Residual, offset};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Bins of the tone band, 11 to 24 Hz.
const TONES: std::ops::Range<usize> = 226..492;

/// The records of orientation and position. The position comes first into the orientation; where it is not observable,
/// the nominal one does, and a line on standard error says why.
///
/// # Errors
/// Bad input, or neither is observable.
pub fn records(
    station: &Station,
    input: &[PathBuf],
    tracks: &[Vec<TrackPoint>],
    max_gap_s: f64,
    search_m: f64,
) -> Result<Vec<Value>> {
    let courses: Vec<Course> = tracks.iter().flat_map(|t| courses(t, max_gap_s)).collect();
    let table_path = station.propagation.as_ref().context(
        "the station file names no propagation table, which the position needs (key `propagation`)",
    )?;
    let table = file::read(table_path)?;
    let travel = |range_m: f64| table.travel_time_s((range_m / table.step_m).round() as usize);
    let (position, turn) = if input.iter().all(|p| records::is_records(p)) {
        let heard = records::read(input)?;
        let position = place(&heard.ranges, &courses, &travel, search_m);
        let at = position.map_or((0.0, 0.0), |p| (p.east_m, p.north_m));
        (position, turn_of_records(&heard, &courses, &travel, at))
    } else {
        let frames = frames(station, input)?;
        let position = place(&stages::range_evidence(&frames, &table), &courses, &travel, search_m);
        let at = position.map_or((0.0, 0.0), |p| (p.east_m, p.north_m));
        (position, turn_of_frames(&frames, &courses, &travel, at))
    };
    let mut out = Vec::new();
    match &turn {
        Ok(turn) => out.push(turn.record(station)),
        Err(reason) => eprintln!("seabearing: {reason}"),
    }
    match (&position, turn) {
        (Ok(offset), _) => out.push(position_record(station, offset, &table)),
        (Err(reason), Ok(_)) => eprintln!("seabearing: {reason}"),
        (Err(reason), Err(turn)) => bail!("{turn}; {reason}"),
    }
    Ok(out)
}

/// A track as courses: cut where its points are farther apart than may be interpolated.
fn courses(track: &[TrackPoint], max_gap_s: f64) -> Vec<Course> {
    track
        .chunk_by(|a, b| b.t_s - a.t_s <= max_gap_s)
        .filter(|run| run.len() > 1)
        .map(|run| Course::Fixes(run.iter().map(|p| (p.t_s, (p.position_m[0], p.position_m[1]))).collect()))
        .collect()
}

fn frames(station: &Station, input: &[PathBuf]) -> Result<Vec<Frame>> {
    let mut source = recording::open(input, station, None)?;
    stages::frames(source.as_mut(), &station.config)
}

/// What orientation comes to.
struct Turn {
    correction: f64,
    sd: f64,
    /// Error of a single azimuth, rad; share of azimuths that support the value.
    quality: Option<(f64, f64)>,
    n: usize,
    passages: usize,
}

impl Turn {
    fn record(&self, station: &Station) -> Value {
        let configured_deg = match &station.config.kind {
            Kind::Obs(o) => o.orientation_of_north_deg,
            _ => 0.0,
        };
        let mut record = json!({
            "type": "orientation", "orientation_deg": degrees(self.correction + configured_deg * RAD_PER_DEG),
            "sd_deg": finite(self.sd / RAD_PER_DEG), "n": self.n, "passes": self.passages,
        });
        if let (Some((scale, support)), Some(o)) = (self.quality, record.as_object_mut()) {
            o.insert("mean_error_deg".into(), json!(scale / RAD_PER_DEG));
            o.insert("support".into(), json!(support));
        }
        record
    }
}

/// From azimuth records: the robust location of their differences from the vessels' azimuths.
fn turn_of_records(heard_: &Records, courses: &[Course], travel: &Travel<'_>, at: Place) -> Result<Turn> {
    let mut residuals: Vec<Residual> = Vec::new();
    for (t_s, azimuth) in &heard_.azimuths {
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
fn turn_of_frames(frames: &[Frame], courses: &[Course], travel: &Travel<'_>, at: Place) -> Result<Turn> {
    let turn = orientation(frames, courses, travel, at, TONES)
        .context("the orientation is not observed: no passage of 30 frames with one vessel of known track at 3 to 40 km")?;
    let near = frames.iter().filter(|f| alone(courses, f.t_s).is_some()).count();
    Ok(Turn { correction: turn.correction, sd: turn.sd, quality: None, n: near, passages: turn.passages })
}

fn position_record(station: &Station, offset: &Offset, table: &Propagation) -> Value {
    let config = &station.config;
    let (sd_x_m, sd_y_m) = offset.sd_m();
    let (east, north) = config.local_east_north_m.unwrap_or((0.0, 0.0));
    let mut record = json!({
        "type": "position", "x_m": east + offset.east_m, "y_m": north + offset.north_m, "sd_x_m": sd_x_m, "sd_y_m": sd_y_m,
        "cov_xy_m2": offset.cov_m2[2], "moved_east_m": offset.east_m, "moved_north_m": offset.north_m,
        "n": offset.n, "passes": offset.passages, "table": table.name,
    });
    if let (Some((lat, lon)), Some(o)) = (config.lat_lon_deg, record.as_object_mut()) {
        let (lat, lon) = LocalFrame::new(lat, lon).lat_lon_deg(offset.east_m, offset.north_m);
        o.insert("lat_deg".into(), json!(lat));
        o.insert("lon_deg".into(), json!(lon));
    }
    record
}
