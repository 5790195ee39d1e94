//! Bearings of a line against time, drawn.

use super::LineBearing;
use crate::plot::Plot;
use crate::record::utc;
use crate::station::Station;
use anyhow::Result;
use std::path::Path;
use time::OffsetDateTime;

/// Half the width of a 95 % interval of a Gaussian, in standard deviations.
const Z95: f64 = 1.959_964;

/// Writes `bearings.svg`: the angle from broadside of every source, that of the strongest with its 95 % band.
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
    let x_label = match start {
        Some(at) => format!("time after {} (s)", utc(at)),
        None => "time (s)".to_owned(),
    };
    let mut figure = Plot::new(&title, &x_label, "sine of the bearing from broadside");
    let of = |source: usize| bearings.iter().filter(move |b| b.source == source);
    let band: Vec<_> = of(0).map(|b| (b.t_s, b.sine - Z95 * b.sd, b.sine + Z95 * b.sd)).collect();
    let points = |source: usize| of(source).map(|b| (b.t_s, b.sine)).collect::<Vec<_>>();
    figure.band("95 % band", &band).points("strongest source", &points(0)).same_colour();
    for (source, name) in [(1, "second source"), (2, "third source"), (3, "fourth source")] {
        let points = points(source);
        if !points.is_empty() {
            figure.points(name, &points);
        }
    }
    figure.write(&folder.join("bearings.svg"))
}
