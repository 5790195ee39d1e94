//! The picture of a recording's levels: of each channel the long-term spectral average (density against time and frequency)
//! and the spectrum's mean and percentiles.

use super::{Meter, db};
use crate::plot::times::Times;
use crate::plot::{ColourMap, HeatMap, Plot, Scale, write_panels};
use crate::record::Level;
use anyhow::Result;
use seabearing_core::kit::quantile;
use seabearing_core::levels::bands::{edge_hz, middle_hz};
use seabearing_core::levels::percentiles_db;
use std::path::Path;
use time::OffsetDateTime;

/// Most columns, and cells of a row: what can be seen, in a file of bounded size.
const COLUMNS: usize = 120;
const ROW: usize = 2;

/// Draws `levels.svg` into a folder, of the intervals of a recording (seconds since sample 0, and levels); nothing where
/// nothing was measured. `start`: UTC of sample 0; `station`: its name.
///
/// # Errors
/// The file cannot be written.
pub fn draw(
    folder: &Path,
    meter: &Meter,
    levels: &[(f64, Level)],
    start: Option<OffsetDateTime>,
    station: &str,
) -> Result<()> {
    let mut figures = Vec::new();
    let longest_s = levels.last().map_or(0.0, |(t_s, level)| t_s + level.duration_s);
    let times = Times::new(start, longest_s);
    let source = times.source(station);
    for channel in 0..4u8 {
        let own: Vec<&(f64, Level)> = levels.iter().filter(|(_, l)| l.channel == channel).collect();
        if own.iter().any(|(_, level)| level.psd_db.iter().any(Option::is_some)) {
            figures.push(average(&own, &times, &source));
            figures.push(spectrum(meter, &own));
        }
    }
    if figures.is_empty() {
        return Ok(());
    }
    write_panels(&folder.join("levels.svg"), &figures.iter().collect::<Vec<_>>(), 2)
}

/// What a channel is called, and the unit of its densities.
fn names(level: &Level) -> (String, String) {
    let quantity = level.quantity.replace('_', " ");
    let unit = match level.reference {
        "1 µPa" => "dB re 1 µPa²/Hz".to_owned(),
        "1 nm/s" => "dB re 1 (nm/s)²/Hz".to_owned(),
        other => format!("dB re {other}²/Hz"),
    };
    (format!("channel {}, {quantity}", level.channel), unit)
}

fn power(db: Option<f64>) -> Option<f64> {
    db.map(|db| 10f64.powf(db / 10.0))
}

/// The mean of what there is, dB.
fn mean_db(levels: impl Iterator<Item = Option<f64>>) -> f64 {
    let (sum, n) = levels.filter_map(power).fold((0.0, 0), |(sum, n), p| (sum + p, n + 1));
    if n > 0 { db(sum / f64::from(n)) } else { f64::NAN }
}

fn average(own: &[&(f64, Level)], times: &Times, source: &str) -> Plot {
    let (first, last) = (own[0], own[own.len() - 1]);
    let (begins, ends) = (first.0, last.0 + last.1.duration_s);
    let duration_s = own.iter().map(|(_, l)| l.duration_s).fold(0.0, f64::max);
    let intervals = ((ends - begins) / duration_s).round().max(1.0) as usize;
    let per = intervals.div_ceil(COLUMNS);
    let columns = intervals.div_ceil(per);
    let mut of_column: Vec<Vec<&Level>> = vec![Vec::new(); columns];
    for (t_s, level) in own {
        let at = ((t_s - begins) / duration_s).round() as usize / per;
        if let Some(column) = of_column.get_mut(at) {
            column.push(level);
        }
    }
    let psd = |level: &Level, cell: usize| level.psd_db.get(cell).copied().flatten();
    let resolved = |cell: &usize| own.iter().any(|(_, l)| psd(l, *cell).is_some());
    let cells = first.1.psd_hz.len();
    let lowest = (0..cells).find(resolved).unwrap_or(0);
    let rows = ((cells - lowest) / ROW).max(1);
    let mut values = Vec::with_capacity(rows * columns);
    for row in 0..rows {
        let cells = lowest + ROW * row..lowest + ROW * (row + 1);
        values.extend(
            of_column.iter().map(|c| mean_db(c.iter().flat_map(|l| cells.clone().map(|cell| psd(l, cell))))),
        );
    }
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) =
        (quantile(&mut sorted, 0.01).unwrap_or(0.0), quantile(&mut sorted, 0.995).unwrap_or(1.0));
    let (name, label) = names(&first.1);
    let mut figure = Plot::new(&format!("Long-term spectral average, {name}"), "", "frequency (Hz)");
    times.along(&mut figure);
    figure.caption(&format!(
        "Spectral density against time and frequency: means over {:.0} s, of the power; blank: nothing measured. {source}",
        duration_s * per as f64
    ));
    let half_cell = 10f64.powf(1.0 / 80.0);
    let from_hz = first.1.psd_hz[lowest] / half_cell;
    let to_hz = from_hz * half_cell.powi(2 * (ROW * rows) as i32);
    figure.size(760, 330).y_scale(Scale::Log).heat(HeatMap {
        x: (times.at(begins), times.at(begins + duration_s * (per * columns) as f64)),
        y: (from_hz, to_hz),
        columns,
        values,
        strength: Vec::new(),
        range: Some((low.floor(), high.ceil().max(low.floor() + 1.0))),
        map: ColourMap::Amount,
        label,
    });
    figure
}

fn spectrum(meter: &Meter, own: &[&(f64, Level)]) -> Plot {
    let level = &own[0].1;
    let (name, unit) = names(level);
    let channel = usize::from(level.channel);
    let mut band = Vec::new();
    let (mut median, mut mean) = (Vec::new(), Vec::new());
    for (place, cell) in meter.plan.cells().enumerate() {
        let f = middle_hz(cell);
        if !meter.plan.is_resolved(cell) {
            continue;
        }
        let more = meter.maker.calibration[channel].db(f).unwrap_or(f64::NAN)
            - db(edge_hz(cell + 1) - edge_hz(cell));
        let [low, middle, high] = percentiles_db(&meter.whole, place, channel)
            .map(|level| level.map_or(f64::NAN, |x| f64::from(x) + more));
        if low.is_finite() && high.is_finite() {
            band.push((f, low, high));
        }
        median.push((f, middle));
        mean.push((f, mean_db(own.iter().map(|(_, l)| l.psd_db.get(place).copied().flatten()))));
    }
    let label = format!("spectral density ({unit})");
    let mut figure = Plot::new(&format!("Spectrum, {name}"), "frequency (Hz)", &label);
    figure.size(620, 330).x_scale(Scale::Log);
    if !band.is_empty() {
        figure.band("5 to 95 % of snapshots", &band);
    }
    figure.line("median", &median).same_colour().dashed("mean", &mean);
    figure.caption(
        "Spectral density over the whole recording: level of the mean power, median, and the levels that 5 and 95 % of the snapshots (of a second or \
         more) are below.",
    );
    figure
}
