//! Pictures of an ocean-bottom recording: the counterparts of figures 2, 3 and 5 to 8 of \[O\].
//!
//! Each is one SVG: spectrogram, azigram (cyclic colours), azimuth log-likelihood with detections, cepstrogram before and
//! after the clutter filter, range log-likelihood with detections, presence with segments, tracks on a map with circles at
//! 50 and 100 km; [`model`] draws the interference model against range. Times are UTC where the recording has a clock.

use super::columns::{CEPSTRAL, COLUMNS, Column, Columns, ROWS};
use super::evidence::{Evidence, Of};
use super::far::tones::Listener;
use super::presence::{IMPULSIVE, TONAL, azimuths, presence, ranges};
use super::{pages, ships, stages};
use crate::angle::azimuth_deg;
use crate::course::EastNorth;
use crate::plot::times::Times;
use crate::plot::{ColourMap, HeatMap, Plot, RGBColor, Scale, cut_at_wraps, write_panels};
use crate::plot::{passage, ways};
use crate::propagation::Propagation;
use crate::recording::BlockSource;
use crate::station::Calibration;
use anyhow::{Context, Result};
use seabearing_core::block::Block;
use seabearing_core::config::StationConfig;
use seabearing_core::kit::quantile;
use seabearing_core::wire::Message;
use std::path::{Path, PathBuf};

/// Detections on dark cells: seen there and in the legend.
const DETECTION: RGBColor = RGBColor(232, 70, 70);
/// Colour of calls, apart from vessels and visible on the same map.
const CALL: RGBColor = RGBColor(120, 200, 255);
/// The truth over dark cells, where the dark line of other figures is not seen.
const TRUTH_OVER_DARK: RGBColor = RGBColor(255, 120, 215);
/// What a vessel really did, for comparison.
#[derive(Clone, Debug)]
pub struct TruthCurve {
    /// Its name.
    pub name: String,
    /// Time (s), azimuth (rad) and range (m) as they could be heard.
    pub heard: Vec<(f64, f64, f64)>,
    /// East and North along its way, m.
    pub places: Vec<EastNorth>,
}

impl TruthCurve {
    /// The vessels of a simulation's `truth.csv`, in the order of their first rows; other sounds are passed over.
    ///
    /// # Errors
    /// The file cannot be read, a column is missing or a vessel's row holds no numbers.
    pub fn read(path: &Path) -> Result<Vec<Self>> {
        let table = crate::csv::CsvTable::read(path)?;
        let (source, kind) = (table.column("source")?, table.column("kind")?);
        let columns = ["t_s", "x_m", "y_m", "heard_range_m", "heard_azimuth_deg"];
        let mut out: Vec<Self> = Vec::new();
        for (i, (line, row)) in table.numbers(columns)?.into_iter().enumerate() {
            if table.text(i, kind) != Some("ship") {
                continue;
            }
            let [t_s, x_m, y_m, range_m, azimuth_deg] =
                row.with_context(|| format!("{}, line {line}", path.display()))?;
            let name = table.text(i, source).unwrap_or_default();
            if out.iter().all(|t| t.name != name) {
                out.push(Self { name: name.to_owned(), heard: Vec::new(), places: Vec::new() });
            }
            if let Some(curve) = out.iter_mut().find(|t| t.name == name) {
                curve.heard.push((t_s, azimuth_deg.to_radians(), range_m));
                curve.places.push((x_m, y_m));
            }
        }
        Ok(out)
    }
}

/// Whole minutes of a recording below which there is nothing to draw against time.
pub(super) const LEAST_MINUTES: usize = 2;

/// Draws everything, and what is known of the ships (`pages.rs`); the files written, none where the recording is shorter than `LEAST_MINUTES`.
///
/// The recording is gone through once. What is kept of it is 10 MB and half a megabyte a day. Work: 3 s a day of recording.
///
/// # Errors
/// The recording is lost, or a file cannot be written.
pub fn draw(
    dir: &Path,
    source: &mut dyn BlockSource,
    config: &StationConfig,
    table: &Propagation,
    calibration: &Calibration,
    messages: &[Message],
    truth: &[TruthCurve],
) -> Result<Vec<PathBuf>> {
    let rate = config.rate_hz;
    let start = source.start();
    let mut all = Columns::new(0.5 * stages::length(rate) as f64 / rate);
    let mut evidence = Evidence::new(table);
    let mut listener = Listener::new(config)?;
    let mut end = 0;
    let mut block_came = |block: &Block<'_>| {
        end = block.first_index + block.frames.len() as u64;
        listener.push(block);
    };
    stages::each_frame(source, config, &mut block_came, &mut |frame| {
        all.take(&frame);
        evidence.take(frame);
    })?;
    all.finish();
    evidence.finish();
    if evidence.minutes() < LEAST_MINUTES {
        return Ok(Vec::new());
    }
    let times = &Times::new(start, all.last_s());
    let found = passage::ocean_bottom(messages, config);
    let source = times.source(&config.name);
    let mut written = Vec::new();
    let mut keep = |name: &str, figures: &[&Plot]| -> Result<()> {
        let path = dir.join(format!("{name}.svg"));
        write_panels(&path, figures, 1)?;
        written.push(path);
        Ok(())
    };
    let said = |mut figure: Plot, words: &str| {
        figure.caption(&format!("{words} {source}"));
        figure
    };
    let sound = "Spectral density of pressure against time and frequency: mean over the frames of each cell (Hann windows).";
    keep("spectrogram", &[&said(spectrogram(&all, times, config, calibration), sound)])?;
    let directions = "Azimuth that each cell of time and frequency comes from, by the horizontal active intensity; paler where the directions \
         of a cell agree less, grey where they do not agree at all.";
    keep("azigram", &[&said(azigram(&all, times), directions)])?;
    let (mut azimuth, each) =
        heat("Azimuth: log-likelihood ratio", "azimuth (°)", times, &evidence, Of::Azimuth);
    azimuth.y_scale(Scale::Degrees);
    azimuth.points("tonal", &azimuths(messages, rate, times, TONAL)).coloured(DETECTION);
    let calls = azimuths(messages, rate, times, IMPULSIVE);
    if !calls.is_empty() {
        azimuth.points("impulsive (calls)", &calls).coloured(CALL);
    }
    for t in truth {
        let points: Vec<(f64, f64)> = t.heard.iter().map(|h| (times.at(h.0), h.1.to_degrees())).collect();
        azimuth.truth(&t.name, &cut_at_wraps(&points)).coloured(TRUTH_OVER_DARK);
    }
    for p in &found.passages {
        azimuth.line(&p.name(), &p.azimuths(times)).coloured(p.look());
    }
    let words = format!(
        "Colours: natural logarithm of the likelihood of a vessel at each azimuth over that of none, {each}. Points: detections. \
         Coloured lines: tracks by their last solution, where the vessels were: sound is heard from there half a minute later at 40 km."
    );
    keep("azimuth", &[&said(azimuth, &words)])?;
    let before = cepstrogram("Cepstrogram", &all, times, &|c, row| c.raw[row]);
    let after = cepstrogram("Cepstrogram after the clutter filter", &all, times, &|c, row| c.filtered[row]);
    let after = said(
        after,
        "Magnitude of the cepstrum of pressure: ridges are delays between paths by surface and floor. Below without the part that stays for long.",
    );
    keep("cepstrogram", &[&before, &after])?;
    let (mut range, each) = heat("Range: log-likelihood ratio", "range (km)", times, &evidence, Of::Range);
    range.points("detections", &ranges(messages, rate, times)).coloured(DETECTION);
    for t in truth {
        let points: Vec<(f64, f64)> = t.heard.iter().map(|h| (times.at(h.0), h.2 / 1e3)).collect();
        range.truth(&t.name, &points).coloured(TRUTH_OVER_DARK);
    }
    for p in &found.passages {
        range.line(&p.name(), &p.ranges_km(times)).coloured(p.look());
    }
    range.y_range(0.0, 50.0);
    let words = format!(
        "Colours: natural logarithm of the likelihood of a vessel at each range over that of none, {each}. Points: detections. \
         Coloured lines: tracks by their last solution, where the vessels were: sound is heard from there half a minute later at 40 km."
    );
    keep("range", &[&said(range, &words)])?;
    let panels = presence(messages, rate, times, span(&all, times), &source);
    keep("presence", &panels.iter().collect::<Vec<_>>())?;
    let mut map = Plot::map("Tracks");
    map.range_circles(&[50_000.0, 100_000.0]);
    for t in truth {
        map.truth(&t.name, &t.places);
    }
    ways::courses(&mut map, &found, times);
    keep("map", &[&said(map, &ways::words(&found))])?;
    let ships = ships::known(&found, messages, config, table.depth_m, &listener.minutes);
    let doubted = ships::doubted(messages, config.rate_hz);
    let told = pages::Told {
        config,
        depth_m: table.depth_m,
        start,
        end_s: end as f64 / rate,
        messages,
        found: &found,
        ships: &ships,
        doubted: &doubted,
        truth,
    };
    written.extend(pages::write(dir, &told, &evidence)?);
    Ok(written)
}

/// From the beginning of the first column to the end of the last, on the axis.
fn span(all: &Columns, times: &Times) -> (f64, f64) {
    let (from_s, to_s) = all.span_s();
    (times.at(from_s), times.at(to_s))
}

/// Cells against time: columns and values row after row, between limits; whole circles in the colours of a circle.
fn grid(
    title: &str,
    y_label: &str,
    times: &Times,
    x: (f64, f64),
    y: (f64, f64),
    (columns, values, strength): (usize, Vec<f64>, Vec<f64>),
    limits: (f64, f64),
    label: &str,
) -> Plot {
    let map = if limits == (0.0, 360.0) { ColourMap::Cyclic } else { ColourMap::Amount };
    let mut f = Plot::new(title, "", y_label);
    times.along(&mut f);
    f.heat(HeatMap { x, y, columns, values, strength, range: Some(limits), map, label: label.to_owned() });
    f
}

/// Level of pressure against time and frequency (figure 2).
fn spectrogram(all: &Columns, times: &Times, config: &StationConfig, calibration: &Calibration) -> Plot {
    let rows = ROWS;
    // One-sided density of full scale squared under Hann's window.
    let (length, full_scale) = (stages::length(config.rate_hz) as f64, f64::from(config.full_scale));
    let scale = 2.0 / (config.rate_hz * 0.375 * length * full_scale * full_scale);
    let bin_hz = config.rate_hz / length;
    let (n, values) = all.cells(rows, &|c, row| {
        let more = calibration.db(bin_hz * (2.0 * row as f64 + 1.0)).unwrap_or(f64::NAN);
        10.0 * (scale * c.power[row] / (2.0 * c.frames as f64)).log10() + more
    });
    let mut sorted = values.clone();
    let mut at = |share: f64| quantile(&mut sorted, share).unwrap_or(0.0);
    let limits = (at(0.02).floor(), at(0.995).ceil());
    let label = match calibration.reference {
        "1 µPa" => "spectral density (dB re 1 µPa²/Hz)".to_owned(),
        other => format!("spectral density (dB re {other}²/Hz)"),
    };
    let x = span(all, times);
    grid(
        "Spectrogram of pressure",
        "frequency (Hz)",
        times,
        x,
        (0.0, 25.0),
        (n, values, Vec::new()),
        limits,
        &label,
    )
}

/// Azimuth of active intensity against time and frequency (figure 3b), faded where the azimuths of a cell do not agree.
fn azigram(all: &Columns, times: &Times) -> Plot {
    // Mean direction of a cell's azimuths as a vector, and how many there are.
    let mean = |c: &Column, row: usize| {
        let (s, c, n) = c.directions[row];
        let n = f64::from(n);
        (f64::from(s) / n, f64::from(c) / n, n)
    };
    let (n, values) = all.cells(ROWS, &|column, row| {
        let (s, c, _) = mean(column, row);
        azimuth_deg(s, c)
    });
    // Its squared length less what directions at random have.
    let (_, strength) = all.cells(ROWS, &|column, row| {
        let (s, c, n) = mean(column, row);
        ((n * (s * s + c * c) - 1.0) / (n - 1.0)).max(0.0).sqrt()
    });
    let (circle, label) = ((0.0, 360.0), "azimuth of the source (°)");
    let cells = (n, values, strength);
    grid("Azigram", "frequency (Hz)", times, span(all, times), (0.0, 25.0), cells, circle, label)
}

fn cepstrogram(title: &str, all: &Columns, times: &Times, of: &dyn Fn(&Column, usize) -> (f32, f32)) -> Plot {
    let (n, values) = all.cells(CEPSTRAL, &|column, row| {
        let (sum, count) = of(column, row);
        f64::from(sum) / f64::from(count)
    });
    let cells = (n, values, Vec::new());
    grid(title, "quefrency (s)", times, span(all, times), (0.4, 7.0), cells, (0.0, 0.08), "|cepstrum|")
}

/// A figure over its likelihood, and in words how many minutes a column is of.
fn heat(title: &str, y_label: &str, times: &Times, evidence: &Evidence<'_>, of: Of) -> (Plot, String) {
    let most = if of == Of::Azimuth { 60.0 } else { 40.0 };
    let cells = evidence.cells(of, (f64::NEG_INFINITY, f64::INFINITY), COLUMNS);
    let x = (times.at(cells.span_s.0), times.at(cells.span_s.1));
    let values = (cells.columns, cells.values, Vec::new());
    let figure = grid(title, y_label, times, x, of.edges(), values, (0.0, most), "ln likelihood ratio");
    (figure, cells.each)
}

/// The interference model against range: envelope of the pulses, and the branches' delays (figure 5b).
///
/// # Errors
/// The file cannot be written.
pub fn model(path: &Path, table: &Propagation) -> Result<()> {
    let (columns, rows) = (250usize, 165usize);
    let mut values = vec![0.0f64; columns * rows];
    let mut f = Plot::new("Interference model against range", "range (km)", "delay (s)");
    let names = ["13", "35", "57", "79", "9 11", "11 13"];
    let mut curves = Vec::new();
    for (b, strength) in table.strengths.iter().enumerate() {
        let mut curve = Vec::new();
        for c in 0..columns {
            let range = 50_000.0 * (c as f64 + 0.5) / columns as f64;
            let Some((tau, _)) = table.branch(b, (range / table.step_m).round() as usize) else { continue };
            curve.push((range / 1e3, tau));
            for (r, row) in values.chunks_mut(columns).enumerate() {
                let q = 0.4 + 6.6 * (r as f64 + 0.5) / rows as f64;
                row[c] += strength.at(range) * (-((q - tau) / table.width_s).powi(2)).exp();
            }
        }
        curves.push((names.get(b).copied().unwrap_or("farther"), curve));
    }
    f.heat(HeatMap {
        x: (0.0, 50.0),
        y: (0.4, 7.0),
        columns,
        values,
        strength: Vec::new(),
        range: None,
        map: ColourMap::Amount,
        label: "height of the pulse".into(),
    });
    for (name, curve) in &curves {
        f.dashed(name, curve);
    }
    f.y_range(0.4, 7.0);
    f.caption(
        "Colour: height of the pulses that pairs of paths make in the cepstrum, by the propagation table; dashed: the delay of each pair (numbers of the paths).",
    );
    f.write(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truth_of_a_simulation_is_read_vessel_by_vessel() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("truth.csv");
        let text = "t_s,source,kind,x_m,y_m,range_m,azimuth_deg,heard_range_m,heard_azimuth_deg,heard_radial_speed_m_s\n\
                    60,a,ship,10.0,20.0,22.4,26.6,23.0,90.000,1.0\n\
                    60,b,ship,1.0,2.0,2.2,26.6,2.3,30.000,1.0\n\
                    120,a,ship,11.0,21.0,23.7,27.6,24.0,91.000,1.0\n\
                    70.0,whale-1,whale,,,,120.000,,120.000,\n";
        std::fs::write(&path, text).unwrap();
        let [a, b] = &TruthCurve::read(&path).unwrap()[..] else { panic!("two vessels") };
        assert_eq!((a.name.as_str(), b.name.as_str(), a.heard.len(), b.places.len()), ("a", "b", 2, 1));
        assert_eq!((a.places[1], a.heard[0]), ((11.0, 21.0), (60.0, 90f64.to_radians(), 23.0)));
        std::fs::write(&path, text.replace("2.3,30.000", "2.3,north")).unwrap();
        assert!(format!("{:#}", TruthCurve::read(&path).unwrap_err()).contains("line 3"));
    }
}
