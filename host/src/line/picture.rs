//! Bearings of a line against time, drawn.

use super::LineBearing;
use crate::plot::Plot;
use crate::plot::directions::{Direction, Z95, band};
use crate::plot::times::Times;
use crate::station::Station;
use anyhow::Result;
use std::path::Path;
use time::OffsetDateTime;

/// Writes `bearings.svg`: the angle from broadside of every source with its 95 % band.
///
/// # Errors
/// The folder cannot be written.
pub fn draw(
    folder: &Path,
    bearings: &[LineBearing],
    station: &Station,
    start: Option<OffsetDateTime>,
) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    let title = format!("Bearings of {}", station.config.name.as_str());
    let times = Times::new(start, bearings.last().map_or(0.0, |b| b.t_s));
    let mut figure = Plot::new(&title, "", "sine of the bearing from broadside");
    times.along(&mut figure);
    for (source, name) in
        ["strongest source", "second source", "third source", "fourth source"].iter().enumerate()
    {
        let own = bearings.iter().filter(|b| b.source == source);
        let values: Vec<Direction> = own
            .map(|b| Direction { at: times.at(b.t_s), t_s: b.t_s, value: b.sine, half: Z95 * b.sd })
            .collect();
        if !values.is_empty() {
            let points: Vec<_> = values.iter().map(|d| (d.at, d.value)).collect();
            figure.band("", &band(&values, false)).points(name, &points).same_colour();
        }
    }
    figure.caption(&format!(
        "Sine of the angle from broadside of each source, the strongest first. Shaded: the 95 % interval of each bearing. {}",
        times.source(&station.config.name)
    ));
    figure.write(&folder.join("bearings.svg"))
}
