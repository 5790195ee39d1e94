//! Azimuths with the courses over them, and where ranges or tones tell the distance, the ways on a map.

use super::Track;
use super::heard::Direction;
use crate::plot::times::Times;
use crate::plot::{Look, Plot, Scale, cut_at_wraps, write_panels};
use anyhow::Result;
use std::path::Path;
use time::OffsetDateTime;

/// Points of a way.
const POINTS: u32 = 300;

/// Draws tracks over all azimuths that were heard. `start`: UTC of time 0, where it is known.
///
/// # Errors
/// The file cannot be written.
pub fn draw(tracks: &[Track], all: &[Direction], start: Option<OffsetDateTime>, path: &Path) -> Result<()> {
    let (first, last) =
        all.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |s, d| (s.0.min(d.t_s), s.1.max(d.t_s)));
    let axis = Times::new(start, (last - first).max(60.0));
    let mut angles = Plot::new("Azimuths and the vessels they are of", "", "azimuth (°)");
    axis.along(&mut angles);
    let heard: Vec<_> =
        all.iter().map(|d| (axis.at(d.t_s), d.azimuth.to_degrees().rem_euclid(360.0))).collect();
    angles.y_scale(Scale::Degrees).points("heard", &heard);
    let mut map = Plot::map("Ways past the station");
    let mut drawn = false;
    for (n, t) in tracks.iter().enumerate() {
        let (Some(a), Some(b)) = (t.directions.first(), t.directions.last()) else { continue };
        let times = (0..=POINTS).map(|k| a.t_s + (b.t_s - a.t_s) * f64::from(k) / f64::from(POINTS));
        let line: Vec<_> =
            times.clone().map(|t_s| (axis.at(t_s), t.course.azimuth(t_s).value.to_degrees())).collect();
        let name = format!("track {}", n + 1);
        // The first colour is that of what was heard; a track has one in both figures.
        let look = Look::of(n + 1);
        angles.line(&name, &cut_at_wraps(&line)).coloured(look);
        let way: Vec<_> = times.filter_map(|t_s| t.place_m(t_s)).collect();
        if !way.is_empty() {
            map.line(&name, &way).coloured(look);
            drawn = true;
        }
    }
    angles.caption(
        "Points: tonal azimuths as the recorder told them, degrees clockwise from true North. Lines: azimuths of the straight courses fitted to each \
         vessel's, while it was heard.",
    );
    if !drawn {
        return angles.write(path);
    }
    map.caption(
        "Ways of the vessels whose distance is known, by ranges or by the fall of their tones. Black triangle: the station.",
    );
    write_panels(path, &[&angles, &map], 1)
}
