//! The picture of levels that recorders send of themselves: of each channel the density against time and frequency, the level of all
//! bands with percentiles over periods, and the spectrum's percentiles.

use super::told::{Percentiles, Told, mean_db};
use crate::plot::times::Times;
use crate::plot::{ColourMap, HeatMap, Plot, RGBColor, Scale, write_panels};
use anyhow::Result;
use seabearing_core::kit::quantile;
use std::path::Path;
use time::OffsetDateTime;

/// Most columns, and rows of the density.
const COLUMNS: usize = 360;
const ROWS: usize = 90;

/// Colour of single intervals under their percentiles.
const GREY: RGBColor = RGBColor(140, 140, 140);

/// Draws all channels into one picture.
///
/// # Errors
/// The file cannot be written.
pub fn draw(path: &Path, told: &[Told], period_s: impl Fn(&Told) -> f64) -> Result<()> {
    let mut figures = Vec::new();
    for one in told {
        let clock = Clock::of(one);
        figures.push(density(one, &clock));
        figures.push(spectrum(one));
        figures.push(over_time(one, &clock, period_s(one)));
        // Its place beside stays empty.
        figures.push(empty());
    }
    write_panels(path, &figures.iter().collect::<Vec<_>>(), 2)
}

fn empty() -> Plot {
    let mut figure = Plot::new("", "", "");
    figure.size(200, 150).words(vec![String::new()]);
    figure
}

/// Where the times of a channel's levels lie.
struct Clock {
    times: Times,
    begins_s: f64,
}

impl Clock {
    fn of(told: &Told) -> Self {
        let (from, to) = told.span_s();
        let begins_s = if told.is_utc { from } else { 0.0 };
        let start =
            OffsetDateTime::from_unix_timestamp_nanos((begins_s * 1e9) as i128).ok().filter(|_| told.is_utc);
        Self { times: Times::new(start, to - begins_s), begins_s }
    }

    fn at(&self, at_s: f64) -> f64 {
        self.times.at(at_s - self.begins_s)
    }
}

fn name(told: &Told) -> String {
    let station = told.station.map_or(String::new(), |s| format!("station {s}, "));
    format!("{station}channel {}", told.channel)
}

fn units(told: &Told) -> (String, String) {
    let density = match told.reference.as_str() {
        "1 µPa" => "dB re 1 µPa²/Hz".to_owned(),
        "1 nm/s" => "dB re 1 (nm/s)²/Hz".to_owned(),
        other => format!("dB re {other}²/Hz"),
    };
    (density, format!("dB re {}", told.reference))
}

/// Density against time and frequency.
fn density(told: &Told, clock: &Clock) -> Plot {
    let (from, to) = told.span_s();
    let intervals = ((to - from) / told.every_s()).round().max(1.0) as usize;
    let per = intervals.div_ceil(COLUMNS);
    let columns = intervals.div_ceil(per);
    let column_s = per as f64 * told.every_s();
    let mut of_column = vec![Vec::new(); columns];
    for row in &told.rows {
        if let Some(column) = of_column.get_mut(((row.at_s - from) / column_s) as usize) {
            column.push(row);
        }
    }
    let (lowest, highest) = (told.edges_hz[0], told.edges_hz[told.edges_hz.len() - 1]);
    let mut values = Vec::with_capacity(ROWS * columns);
    for k in 0..ROWS {
        let f = lowest * (highest / lowest).powf((k as f64 + 0.5) / ROWS as f64);
        let band = told.edges_hz.partition_point(|edge| *edge <= f).saturating_sub(1);
        values.extend(
            of_column
                .iter()
                .map(|rows| mean_db(rows.iter().map(|r| r.density_db.get(band).copied().flatten()))),
        );
    }
    let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) =
        (quantile(&mut finite, 0.01).unwrap_or(0.0), quantile(&mut finite, 0.995).unwrap_or(1.0));
    let mut figure = Plot::new(&format!("Spectra of the recorder, {}", name(told)), "", "frequency (Hz)");
    figure.size(760, 330).y_scale(Scale::Log).heat(HeatMap {
        x: (clock.at(from), clock.at(from + columns as f64 * column_s)),
        y: (lowest, highest),
        columns,
        values,
        strength: Vec::new(),
        range: Some((low.floor(), high.ceil().max(low.floor() + 1.0))),
        map: ColourMap::Amount,
        label: format!("density ({})", units(told).0),
    });
    clock.times.along(&mut figure);
    let mean = if per > 1 { format!(", means of {per} intervals") } else { String::new() };
    figure.caption(&format!(
        "Mean spectral density over each interval of {:.0} s as the recorder sent it (its bands are groups of bins{mean}); blank: nothing \
         measured.",
        told.every_s()
    ));
    figure
}

/// Level of all bands against time, with percentiles over periods.
fn over_time(told: &Told, clock: &Clock, period_s: f64) -> Plot {
    let (from, to) = told.span_s();
    let mut figure =
        Plot::new(&format!("Level of all bands, {}", name(told)), "", &format!("level ({})", units(told).1));
    let points: Vec<(f64, f64)> =
        told.rows.iter().filter_map(|row| Some((clock.at(row.at_s), row.broad_db()?))).collect();
    let (mut band, mut middle) = (Vec::new(), Vec::new());
    for (begins, p) in told.over_time(period_s) {
        // A step as long as the period, as far as there are data.
        let ends = [begins.max(from), (begins + period_s).min(to)].map(|at_s| clock.at(at_s));
        let [loud, median, quiet] = p.exceeded_db;
        band.push((ends[0], f64::NAN, f64::NAN));
        middle.push((ends[0], f64::NAN));
        for at in ends {
            band.push((at, quiet, loud));
            middle.push((at, median));
        }
    }
    figure.size(760, 300).points("each interval", &points).coloured(GREY).sized(1.3);
    figure.band("L95 to L5", &band).line("L50", &middle).same_colour();
    figure.x_range(clock.at(from), clock.at(to));
    clock.times.along(&mut figure);
    figure.caption(&format!(
        "Points: level of all bands together, {:.0} to {:.0} Hz, in each interval of {:.0} s. L5, L50, L95: levels exceeded for 5, 50, 95 % of the \
         intervals (ISO 1996-1:2016), over periods of {}.",
        told.edges_hz[0],
        told.edges_hz[told.edges_hz.len() - 1],
        told.every_s(),
        length(period_s),
    ));
    figure
}

/// A length of time in words.
pub fn length(period_s: f64) -> String {
    match period_s {
        s if s >= 86_400.0 && s % 86_400.0 == 0.0 => format!("{} d", s / 86_400.0),
        s if s >= 3600.0 && s % 3600.0 == 0.0 => format!("{} h", s / 3600.0),
        s if s >= 60.0 && s % 60.0 == 0.0 => format!("{} min", s / 60.0),
        s => format!("{s} s"),
    }
}

/// Percentiles of the density of each band.
fn spectrum(told: &Told) -> Plot {
    let label = format!("density ({})", units(told).0);
    let mut figure = Plot::new(&format!("Percentiles, {}", name(told)), "frequency (Hz)", &label);
    let (mut band, mut middle, mut mean) = (Vec::new(), Vec::new(), Vec::new());
    for (edges, p) in told.edges_hz.windows(2).zip(told.by_band(|row| &row.density_db)) {
        let nothing = Percentiles { n: 0, exceeded_db: [f64::NAN; 3], mean_db: f64::NAN };
        let p = p.unwrap_or(nothing);
        for f in edges {
            band.push((*f, p.exceeded_db[2], p.exceeded_db[0]));
            middle.push((*f, p.exceeded_db[1]));
            mean.push((*f, p.mean_db));
        }
    }
    figure.size(540, 330).x_scale(Scale::Log);
    figure.band("L95 to L5", &band).line("L50", &middle).same_colour().dashed("mean", &mean);
    figure.caption(
        "Density in each band: levels exceeded for 5, 50 and 95 % of the intervals (ISO 1996-1:2016), and that of the mean power.",
    );
    figure
}

#[cfg(test)]
mod tests {
    use super::super::told::{sorted, tests::spectra};
    use super::*;

    #[test]
    fn levels_are_drawn_in_utc_with_percentiles_and_words() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("levels.svg");
        let records = spectra((0..300).map(|k| 50.0 + f64::from(k % 7)));
        let (told, _) = sorted(records.iter());
        draw(&path, &told, Told::period_s).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        for words in [
            "time (UTC, 2024-05-01)",
            "L95 to L5",
            "L50",
            "02:00",
            "level (dB re 1 µPa)",
            "density (dB re 1 µPa²/Hz)",
        ] {
            assert!(svg.contains(&format!("\n{words}\n")), "{words}");
        }
        assert!(svg.contains("ISO 1996-1:2016") && svg.matches("<image").count() == 1);
        assert_eq!(
            (length(1800.0), length(3600.0), length(90.0)),
            ("30 min".into(), "1 h".into(), "90 s".into())
        );
    }
}
