//! Pages of a recording of days: azimuth and range against UTC, tracks over likelihoods, and what is known of each ship.
//!
//! Enters: what each minute says of azimuth and range, the chain's messages, the ships, and where they truly were if that is known. Leaves:
//! `ships.svg` of the whole recording, of one longer than a day and a quarter also `ships-DATE.svg` of each day (UTC where the recording has a
//! clock, else `ships-day-N.svg` of 24 hours from its first sample), `ships.txt` and `ships.csv`. A page is smaller than half a megabyte.

use super::evidence::{Evidence, Of};
use super::far::tones::Listener;
use super::pictures::{LEAST_MINUTES, TruthCurve};
use super::presence::{IMPULSIVE, azimuths};
use super::ships::{self, Doubted, Ship, Way, belongs, told};
use super::stages;
use crate::atomic;
use crate::plot::directions::{Direction, band};
use crate::plot::heard::Belonging;
use crate::plot::times::Times;
use crate::plot::{ColourMap, HeatMap, Plot, RGBColor, Scale, TRUTH, cut_at_wraps, passage, write_panels};
use crate::propagation::Propagation;
use crate::recording::BlockSource;
use anyhow::Result;
use seabearing_core::block::Block;
use seabearing_core::config::StationConfig;
use seabearing_core::wire::Message;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

const DAY_S: f64 = 86_400.0;
/// A recording longer than this has a page for each of its days, s.
const SEVERAL_DAYS_S: f64 = 1.25 * DAY_S;
/// Width and heights of a page's figures, points.
const WIDTH: u32 = 1100;
const AZIMUTH_HIGH: u32 = 470;
const RANGE_HIGH: u32 = 400;
/// Columns of cells: more than two to three points are not seen apart.
const COLUMNS: usize = 480;
/// Rows of a page's table; all are in the files beside it.
const MOST_ROWS: usize = 40;
/// Greatest range that is drawn, km, and the greatest logarithms of the likelihood ratios.
const FARTHEST_KM: f64 = 50.0;
const MOST: [f64; 2] = [60.0, 25.0];

/// How far apart numbers are, as shares of the page's axes.
const NUMBER_APART: (f64, f64) = (0.025, 0.05);
/// How far above its closest range a track's number stands, km.
const NUMBER_ABOVE_KM: f64 = 2.5;

/// Colours of what belongs to no track, of calls, and of times without a recording.
const NOBODY: RGBColor = RGBColor(60, 60, 60);
const CALL: RGBColor = RGBColor(214, 0, 200);
const UNRECORDED: RGBColor = RGBColor(190, 150, 90);
/// Colour of times at which the station doubted its set-up, and the height of their band as a share of the axis.
const DOUBTED: RGBColor = RGBColor(214, 40, 20);
const DOUBTED_HIGH: f64 = 0.04;

/// Goes through a recording for its pages alone, and draws them; the ships, and the files written. Of less than two minutes there are tables and no page.
///
/// Kept are half a megabyte a day and the lines of its minutes. Work: 3 s a day of recording.
///
/// # Errors
/// The recording is lost, or a file cannot be written.
pub fn draw(
    dir: &Path,
    source: &mut dyn BlockSource,
    config: &StationConfig,
    table: &Propagation,
    messages: &[Message],
    truth: &[TruthCurve],
) -> Result<(Vec<Ship>, Vec<PathBuf>)> {
    let start = source.start();
    let (mut evidence, mut listener) = (Evidence::new(table), Listener::new(config)?);
    let mut end = 0;
    let mut block_came = |block: &Block<'_>| {
        end = block.first_index + block.frames.len() as u64;
        listener.push(block);
    };
    stages::each_frame(source, config, &mut block_came, &mut |frame| evidence.take(frame))?;
    evidence.finish();
    let found = &passage::ocean_bottom(messages, config);
    let depth_m = table.depth_m;
    let ships = ships::known(found, messages, config, depth_m, &listener.minutes);
    let end_s = end as f64 / config.rate_hz;
    let doubted = &ships::doubted(messages, config.rate_hz);
    let told = Told { config, depth_m, start, end_s, messages, found, ships: &ships, doubted, truth };
    let written =
        if evidence.minutes() < LEAST_MINUTES { tables(dir, &told)? } else { write(dir, &told, &evidence)? };
    Ok((ships, written))
}

/// All that pages are made of.
pub(super) struct Told<'a> {
    pub(super) config: &'a StationConfig,
    /// Depth of the floor, m.
    pub(super) depth_m: f64,
    /// UTC of the first sample.
    pub(super) start: Option<OffsetDateTime>,
    /// End of the recording, s.
    pub(super) end_s: f64,
    pub(super) messages: &'a [Message],
    pub(super) found: &'a Belonging,
    /// One for each passage.
    pub(super) ships: &'a [Ship],
    /// When the station doubted its set-up.
    pub(super) doubted: &'a [Doubted],
    pub(super) truth: &'a [TruthCurve],
}

/// Writes all pages and the files beside them; which.
///
/// # Errors
/// A file cannot be written.
pub(super) fn write(dir: &Path, told: &Told<'_>, evidence: &Evidence<'_>) -> Result<Vec<PathBuf>> {
    let mut written = tables(dir, told)?;
    let mut page = |name: &str, span_s: (f64, f64)| -> Result<()> {
        let path = dir.join(format!("{name}.svg"));
        let figures = figures(told, evidence, span_s);
        write_panels(&path, &figures.iter().collect::<Vec<_>>(), 1)?;
        written.push(path);
        Ok(())
    };
    page("ships", (0.0, told.end_s))?;
    if told.end_s > SEVERAL_DAYS_S {
        for (name, span_s) in days(told.start, told.end_s) {
            page(&format!("ships-{name}"), span_s)?;
        }
    }
    Ok(written)
}

/// Writes what is known of the ships: `ships.txt` and `ships.csv`; which.
///
/// # Errors
/// A file cannot be written.
pub(super) fn tables(dir: &Path, told: &Told<'_>) -> Result<Vec<PathBuf>> {
    let (text, csv) = (dir.join("ships.txt"), dir.join("ships.csv"));
    let times = Times::new(told.start, told.end_s);
    atomic::write(&text, told::text(told.ships, told.doubted, &times, &told.config.name).as_bytes())?;
    atomic::write(&csv, told::csv(told.ships, told.start).as_bytes())?;
    Ok(vec![text, csv])
}

/// Names and spans (s) of the days of a recording.
fn days(start: Option<OffsetDateTime>, end_s: f64) -> Vec<(String, (f64, f64))> {
    // Seconds from midnight to the first sample.
    let late = start.map_or(0.0, |s| (s - s.replace_time(time::Time::MIDNIGHT)).as_seconds_f64());
    let count = ((end_s + late) / DAY_S).ceil() as i64;
    let day = |n: i64| {
        let from = DAY_S * n as f64 - late;
        let name = match start.and_then(|s| s.date().checked_add(time::Duration::days(n))) {
            Some(date) => date.to_string(),
            None => format!("day-{}", n + 1),
        };
        // Days are whole, so that one can be laid beside another.
        (name, (from, from + DAY_S))
    };
    (0..count).map(day).collect()
}

/// The figures of a page.
fn figures(told: &Told<'_>, evidence: &Evidence<'_>, span_s: (f64, f64)) -> Vec<Plot> {
    let times = Times::new(told.start, told.end_s);
    let source = times.source(&told.config.name);
    let shown: Vec<usize> = (0..told.ships.len())
        .filter(|k| told.ships.get(*k).is_some_and(|s| s.heard_s.1 >= span_s.0 && s.heard_s.0 <= span_s.1))
        .collect();
    let mut azimuth = over(evidence, Of::Azimuth, &times, span_s);
    let mut range = over(evidence, Of::Range, &times, span_s);
    detections(told, &mut azimuth, &mut range, &times, span_s, &shown);
    tracks(told, &mut azimuth, &mut range, &times, span_s, &shown);
    truths(told, &mut azimuth, &mut range, &times, span_s);
    let doubted = doubts(told, &mut azimuth, &mut range, &times, span_s);
    let mut table = Plot::new("What is known of each ship", "", "");
    if shown.is_empty() {
        table
            .size(WIDTH, 150)
            .words(vec!["No ship was tracked.".to_owned()])
            .caption(&format!("{doubted}{source}"));
    } else {
        let ships: Vec<Ship> =
            shown.iter().take(MOST_ROWS).filter_map(|k| told.ships.get(*k)).cloned().collect();
        let looks = shown.iter().filter_map(|k| told.found.passages.get(*k)).map(|p| p.look()).collect();
        table.table(told::rows(&ships, &times), looks);
        let rest = match shown.len().saturating_sub(MOST_ROWS) {
            0 => String::new(),
            n => format!(" {n} more in ships.txt."),
        };
        table.caption(&format!("{doubted}{}{rest} {source}", told::WORDS));
    }
    // The table is as wide as its words.
    let width = table.width().max(WIDTH);
    azimuth.y_scale(Scale::Degrees).y_range(0.0, 360.0).size(width, AZIMUTH_HIGH);
    range.y_range(0.0, FARTHEST_KM).size(width, RANGE_HIGH);
    for figure in [&mut azimuth, &mut range] {
        figure.x_range(times.at(span_s.0), times.at(span_s.1));
    }
    vec![azimuth, range, table]
}

/// An empty figure over its likelihood.
fn over(evidence: &Evidence<'_>, of: Of, times: &Times, span_s: (f64, f64)) -> Plot {
    let cells = evidence.cells(of, span_s, COLUMNS);
    let (title, label, most) = match of {
        Of::Azimuth => ("Azimuth", "azimuth (°)", MOST[0]),
        Of::Range => ("Range", "range (km)", MOST[1]),
    };
    let mut figure = Plot::new(title, "", label);
    times.along(&mut figure);
    let (what, line) = match of {
        Of::Azimuth => ("azimuth", "azimuth, clockwise from true North,"),
        Of::Range => ("range", "horizontal range"),
    };
    figure.caption(&format!(
        "Grey: natural logarithm of the likelihood of a vessel at each {what} over that of none, {}. Points: detections, those of a track in its \
         colour. Lines: {line} of each track's straight course through the closest point of its last solution, with the 95 % band of closest time and range, heading and speed as \
         stated; number at the closest point. Sound is heard from there half a minute later at 40 km.",
        cells.each
    ));
    if cells.columns > 0 {
        figure.heat(HeatMap {
            x: (times.at(cells.span_s.0), times.at(cells.span_s.1)),
            y: of.edges(),
            columns: cells.columns,
            values: cells.values,
            strength: Vec::new(),
            range: Some((0.0, most)),
            map: ColourMap::Under,
            label: "ln likelihood ratio".into(),
        });
    }
    let (low, high) = of.edges();
    for (n, (from_s, to_s)) in evidence.unknown(span_s).into_iter().enumerate() {
        let corners = [(times.at(from_s), low, high), (times.at(to_s), low, high)];
        figure.band(if n == 0 { "not recorded" } else { "" }, &corners).coloured(UNRECORDED);
    }
    figure
}

/// Points of the detections: of no track, of calls, of each track.
fn detections(
    told: &Told<'_>,
    azimuth: &mut Plot,
    range: &mut Plot,
    times: &Times,
    span_s: (f64, f64),
    shown: &[usize],
) {
    let rate_hz = told.config.rate_hz;
    let in_span = |t_s: f64| (span_s.0..=span_s.1).contains(&t_s);
    let heard = passage::tonal(told.messages, rate_hz);
    let of = |whose: Option<usize>| -> Vec<(f64, f64)> {
        let these = heard.iter().zip(&told.found.whose).filter(|(h, w)| **w == whose && in_span(h.t_s));
        these.map(|(h, _)| (times.at(h.t_s), h.azimuth_deg)).collect()
    };
    let ways: Vec<Way<'_>> =
        told.found.passages.iter().map(|p| Way::of(p, told.config, told.depth_m)).collect();
    let mut ranges: Vec<Vec<(f64, f64)>> = vec![Vec::new(); ways.len() + 1];
    for message in told.messages {
        let Message::Range(r) = message else { continue };
        let t_s = r.index as f64 / rate_hz;
        if !r.detected || !in_span(t_s) {
            continue;
        }
        let own = ways.iter().zip(&told.found.passages).position(|(way, p)| belongs(r, way, p, rate_hz));
        ranges[own.unwrap_or(ways.len())].push((times.at(t_s), f64::from(r.range_m) / 1e3));
    }
    let nobody = [of(None), ranges.pop().unwrap_or_default()];
    for (figure, points) in [&mut *azimuth, &mut *range].into_iter().zip(nobody) {
        if !points.is_empty() {
            figure.points("of no track", &points).coloured(NOBODY).sized(1.4);
        }
    }
    let (from, to) = (times.at(span_s.0), times.at(span_s.1));
    let calls: Vec<(f64, f64)> = azimuths(told.messages, rate_hz, times, IMPULSIVE)
        .into_iter()
        .filter(|c| (from..=to).contains(&c.0))
        .collect();
    if !calls.is_empty() {
        azimuth.points("calls", &calls).coloured(CALL).sized(1.4);
    }
    for k in shown {
        let Some(passage) = told.found.passages.get(*k) else { continue };
        azimuth.points("", &of(Some(*k))).coloured(passage.look()).sized(1.2);
        range.points("", ranges.get(*k).map_or(&[], Vec::as_slice)).coloured(passage.look()).sized(1.2);
    }
}

/// Lines and bands of the tracks, and their numbers.
fn tracks(
    told: &Told<'_>,
    azimuth: &mut Plot,
    range: &mut Plot,
    times: &Times,
    span_s: (f64, f64),
    shown: &[usize],
) {
    let mut numbers = [Vec::new(), Vec::new()];
    for k in shown {
        let Some(passage) = told.found.passages.get(*k) else { continue };
        let way = Way::of(passage, told.config, told.depth_m);
        let curves = [way.azimuths(|t_s| times.at(t_s)), way.ranges_km(|t_s| times.at(t_s))];
        let figures = [&mut *azimuth, &mut *range];
        for (n, (figure, curve)) in figures.into_iter().zip(curves).enumerate() {
            let circle = n == 0;
            if curve.is_empty() {
                continue;
            }
            let line: Vec<(f64, f64)> = curve.iter().map(|d| (d.at, d.value)).collect();
            figure.band("", &band(&curve, circle)).coloured(passage.look());
            let line = if circle { cut_at_wraps(&line) } else { line };
            figure.line(&passage.name(), &line).coloured(passage.look());
            // Above the closest range there is nothing of the course.
            let (above, most) = if circle { (0.0, 360.0) } else { (NUMBER_ABOVE_KM, FARTHEST_KM) };
            if let Some((at, value)) = number_at(&curve, passage.last.cpa_time_s, span_s)
                && value + above < most
            {
                let apart = (NUMBER_APART.0 * (span_s.1 - span_s.0), NUMBER_APART.1 * most);
                let at = beside(&numbers[n], (at, value + above), apart, times.at(1.0) - times.at(0.0));
                numbers[n].push((at, passage.last.id.to_string()));
            }
        }
    }
    let [azimuths, ranges] = numbers;
    azimuth.notes(azimuths);
    range.notes(ranges);
}

/// A place for a number where it does not lie on those that are there: above them. `apart`: s and units of the axis; `second`: one on the axis.
fn beside(taken: &[((f64, f64), String)], wanted: (f64, f64), apart: (f64, f64), second: f64) -> (f64, f64) {
    let (x, mut y) = wanted;
    let hit =
        |y: f64| taken.iter().any(|((a, b), _)| (a - x).abs() < apart.0 * second && (b - y).abs() < apart.1);
    for _ in 0..taken.len() {
        if !hit(y) {
            break;
        }
        y += apart.1;
    }
    (x, y)
}

/// Where a track's number stands: at its closest point, or where it is nearest to that within the page.
fn number_at(curve: &[Direction], cpa_s: f64, (from_s, to_s): (f64, f64)) -> Option<(f64, f64)> {
    // Not at the edge, where there is no room for it.
    let room = 0.02 * (to_s - from_s);
    let within = curve.iter().filter(|d| (from_s + room..=to_s - room).contains(&d.t_s));
    let nearest = within.min_by(|a, b| (a.t_s - cpa_s).abs().total_cmp(&(b.t_s - cpa_s).abs()))?;
    Some((nearest.at, nearest.value))
}

/// Bands over the times at which the station doubted its set-up, at the upper edge; what it doubted in words.
fn doubts(
    told: &Told<'_>,
    azimuth: &mut Plot,
    range: &mut Plot,
    times: &Times,
    span_s: (f64, f64),
) -> String {
    let mut words = String::new();
    let mut named: Vec<String> = Vec::new();
    for d in told.doubted.iter().filter(|d| d.within(span_s)) {
        let (from, to) = (d.from_s.max(span_s.0), d.to_s.unwrap_or(told.end_s).min(span_s.1));
        let name = format!("set-up in doubt: {}", d.name());
        let legend = if named.contains(&name) { "" } else { name.as_str() };
        for (figure, high) in [(&mut *azimuth, 360.0), (&mut *range, FARTHEST_KM)] {
            let corners = [from, to].map(|t_s| (times.at(t_s), (1.0 - DOUBTED_HIGH) * high, high));
            figure.band(legend, &corners).coloured(DOUBTED);
        }
        words += &format!("{} ", told::warnings(std::slice::from_ref(d), times).concat());
        named.push(name);
    }
    words
}

/// Where the ships truly were, as it could be heard.
fn truths(told: &Told<'_>, azimuth: &mut Plot, range: &mut Plot, times: &Times, span_s: (f64, f64)) {
    let mut name = "truth";
    for t in told.truth {
        let heard: Vec<_> = t.heard.iter().filter(|h| (span_s.0..=span_s.1).contains(&h.0)).collect();
        if heard.is_empty() {
            continue;
        }
        let azimuths: Vec<_> =
            heard.iter().map(|h| (times.at(h.0), h.1.to_degrees().rem_euclid(360.0))).collect();
        let ranges: Vec<_> = heard.iter().map(|h| (times.at(h.0), h.2 / 1e3)).collect();
        azimuth.dashed(name, &cut_at_wraps(&azimuths)).coloured(TRUTH).sized(1.2);
        range.dashed(name, &ranges).coloured(TRUTH).sized(1.2);
        // They look alike: one entry of the legend stands for all.
        name = "";
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_utc_where_there_is_a_clock() {
        // Six hours before midnight.
        let start = OffsetDateTime::from_unix_timestamp(1_369_072_800 + 18 * 3600 - 18 * 3600).unwrap();
        let late = f64::from(start.hour()) * 3600.0;
        let all = days(Some(start), 2.0 * DAY_S);
        let names: Vec<&str> = all.iter().map(|d| d.0.as_str()).collect();
        assert_eq!(names, ["2013-05-20", "2013-05-21", "2013-05-22"]);
        assert_eq!(all[0].1, (-late, DAY_S - late));
        let without = days(None, 2.0 * DAY_S);
        assert_eq!(without.len(), 2);
        assert_eq!(without[1], ("day-2".to_owned(), (DAY_S, 2.0 * DAY_S)));
    }
}
