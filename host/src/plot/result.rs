//! Pictures of what a recorder reports: bearings against time, tracks on a map, correlations of the pairs.

use super::correlation::Correlations;
use super::directions::{self, Angle, Direction, Z95};
use super::heard::{Belonging, Heard};
use super::times::Times;
use super::{Plot, TRUTH, cut_at_wraps, ways};
use crate::angle::turn_deg;
use crate::world::truth::Truth;
use anyhow::{Result, anyhow};
use seabearing_core::block::Frame;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_core::wire::{Bearing, Track};
use time::OffsetDateTime;

/// Pictures of what an array's recorder said.
pub struct Pictures {
    /// Azimuths against time, a colour and a band for each track, and the truth where known.
    pub azimuths: Plot,
    /// Elevations likewise.
    pub elevations: Plot,
    /// The tracks on a map.
    pub tracks: Plot,
}

impl Pictures {
    /// Of bearings and reported tracks in the order of time; `station`: its name, or nothing.
    pub fn new(
        bearings: &[Bearing],
        reports: &[Track],
        rate_hz: f64,
        times: &Times,
        truth: &[(String, Vec<Truth>)],
        station: &str,
    ) -> Self {
        let heard: Vec<Heard> = bearings.iter().map(|b| Heard::of(b, rate_hz)).collect();
        let found = Belonging::of_array(reports, &heard, rate_hz);
        let always = (f64::NEG_INFINITY, f64::INFINITY);
        let source = times.source(station);
        let panel = |angle| {
            let mut figure = directions::panel(angle, bearings, &found, rate_hz, times, always, None);
            figure.caption(&format!("{} {source}", directions::words(angle, false)));
            figure
        };
        let mut azimuths = panel(Angle::Azimuth);
        for (i, (_, rows)) in truth.iter().enumerate() {
            let line: Vec<_> = rows.iter().map(|r| (times.at(r.t_s), r.arrival_azimuth_deg)).collect();
            azimuths.truth(&legend(truth, i), &cut_at_wraps(&line));
        }
        let mut elevations = panel(Angle::Elevation);
        for (i, (_, rows)) in truth.iter().enumerate() {
            let line: Vec<_> = rows.iter().map(|r| (times.at(r.t_s), r.arrival_elevation_deg)).collect();
            elevations.truth(&legend(truth, i), &line);
        }
        let told = truth.iter().flat_map(|(_, rows)| rows.iter().map(|r| r.arrival_elevation_deg));
        elevations.y_range = elevations.y_range.map(|ends| {
            told.filter(|e| e.is_finite()).fold(ends, |(low, high), e| (low.min(e), high.max(e)))
        });
        // One axis for both.
        let rows = truth.iter().flat_map(|(_, rows)| rows.iter().map(|r| r.t_s));
        let heard_s = bearings.iter().map(|b| b.index as f64 / rate_hz);
        let (from, to) =
            rows.chain(heard_s).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
        for figure in [&mut azimuths, &mut elevations] {
            figure.x_range(times.at(from), times.at(to));
        }
        let mut tracks = Plot::map("Tracks");
        for (i, (_, rows)) in truth.iter().enumerate() {
            let line: Vec<_> = rows.iter().map(|r| (r.x_m, r.y_m)).collect();
            tracks.truth(&legend(truth, i), &line);
        }
        ways::courses(&mut tracks, &found, times);
        tracks.caption(&format!("{} {source}", ways::words(&found)));
        Self { azimuths, elevations, tracks }
    }
}

/// One entry for all vessels: their lines look alike.
fn legend(truth: &[(String, Vec<Truth>)], i: usize) -> String {
    let names: Vec<&str> = truth.iter().map(|(n, _)| n.as_str()).collect();
    if i == 0 { format!("truth: {}", names.join(", ")) } else { String::new() }
}

/// What an axis of errors reaches at least, degrees.
const LEAST_REACH_DEG: f64 = 1e-3;

/// Share of intervals and errors that an axis of errors shows, and how many times as far an error may lie to be shown too.
const ALL_BUT: f64 = 0.95;
const FAR: f64 = 2.0;

/// The value that such a share of all stays within; 0 of none.
fn most(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_unstable_by(f64::total_cmp);
    all.get(((all.len() as f64 * share) as usize).min(all.len().saturating_sub(1))).copied().unwrap_or(0.0)
}

/// Error of each azimuth against the nearest vessel's truth, with the 95 % band the recorder states.
pub fn bearing_errors(
    bearings: &[Bearing],
    rate_hz: f64,
    times: &Times,
    truth: &[(String, Vec<Truth>)],
) -> Plot {
    let mut figure = Plot::new("Errors of the bearings", "", "azimuth error (°)");
    times.along(&mut figure);
    // Of each vessel.
    let mut stated: Vec<Vec<Direction>> = vec![Vec::new(); truth.len()];
    let mut errors: Vec<Vec<(f64, f64)>> = vec![Vec::new(); truth.len()];
    for b in bearings {
        let t = b.index as f64 / rate_hz;
        let azimuth = f64::from(b.azimuth).to_degrees();
        let nearest = truth
            .iter()
            .enumerate()
            .filter_map(|(k, (_, rows))| Some((k, turn_deg(Truth::azimuth_at(rows, t)?, azimuth))))
            .min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        if let Some((k, error)) = nearest
            && let (Some(stated), Some(errors)) = (stated.get_mut(k), errors.get_mut(k))
        {
            let half = Z95 * f64::from(b.var_azimuth.max(0.0).sqrt()).to_degrees();
            stated.push(Direction { at: times.at(t), t_s: t, value: 0.0, half });
            errors.push((times.at(t), error));
        }
    }
    // An interval of a bearing that says nothing would hide the others: one in twenty may be cut. So would bearings of nobody.
    let usual = most(stated.iter().flatten().map(|d| d.half), ALL_BUT).min(180.0);
    let off = || errors.iter().flatten().map(|e| e.1.abs());
    let far = most(off(), 1.0).min(FAR * most(off(), ALL_BUT));
    let reach = far.max(usual).max(LEAST_REACH_DEG) * 1.2;
    let mut words = "95 % stated";
    let mut beyond = Vec::new();
    for ((name, _), (stated, errors)) in truth.iter().zip(stated.iter().zip(errors)) {
        let (inside, outside): (Vec<_>, Vec<_>) = errors.into_iter().partition(|e| e.1.abs() <= reach);
        beyond.extend(outside.into_iter().map(|(at, error)| (at, reach.copysign(error))));
        if !stated.is_empty() {
            figure.band(std::mem::take(&mut words), &directions::band(stated, false));
            figure.points(name, &inside).same_colour().sized(1.7);
        }
    }
    if !beyond.is_empty() {
        let name = format!("{} beyond ±{reach:.2}°, at the edge", beyond.len());
        figure.points(&name, &beyond).coloured(TRUTH).sized(2.6);
    }
    figure.y_range(-reach, reach);
    figure.caption(
        "Azimuth of each bearing less that of the nearest vessel of the truth, degrees, a colour for each vessel. Shaded about zero: the 95 % interval that the recorder \
         states. What lies beyond the axis is drawn at its edge.",
    );
    figure
}

/// Cross-correlations of the six pairs against lag, in the order of [`PAIRS`]; the delays of a bearing are marked.
/// `when`: the time of the bearing, and `source`: where the data are from, in words.
pub fn correlations(found: &Correlations, delays_s: &[f64; 6], when: &str, source: &str) -> [Plot; 6] {
    std::array::from_fn(|p| {
        let (i, j) = PAIRS[p];
        let mut figure = Plot::new(&format!("Hydrophones {i} and {j}, {when}"), "lag (ms)", "correlation");
        figure.size(420, 300);
        let points: Vec<_> = found.lags_s.iter().zip(&found.curves[p]).map(|(l, v)| (l * 1e3, *v)).collect();
        let (lo, hi) = points.iter().fold((0.0f64, 0.0f64), |(a, b), p| (a.min(p.1), b.max(p.1)));
        let lag = delays_s[p] * 1e3;
        figure.line("correlation (PHAT)", &points).dashed("delay of the bearing", &[(lag, lo), (lag, hi)]);
        figure.caption(&format!(
            "Cross-correlation with the phase transform, against how much later the second hydrophone hears. {source}"
        ));
        figure
    })
}

/// Delays of the six pairs, s, for sound from a direction (radians) at the station's reference range: positive where the
/// second hydrophone hears later.
///
/// # Errors
/// The station is no array.
pub fn delays(config: &StationConfig, azimuth: f64, elevation: f64) -> Result<[f64; 6]> {
    let geometry = config.geometry().map_err(|e| anyhow!("{e:?}"))?;
    let Kind::Array(array) = &config.kind else { return Err(anyhow!("delays need a station of kind array")) };
    // Half the Earth's circumference away is as good as infinitely far.
    let range = array.reference_range_m.min(2e7);
    let (sa, ca) = azimuth.sin_cos();
    let (se, ce) = elevation.sin_cos();
    let source = [range * sa * ce, range * ca * ce, range * se];
    let arrival = geometry.position_m.map(|h| {
        let d: f64 = source.iter().zip(h).map(|(s, h)| (s - f64::from(h)).powi(2)).sum();
        d.sqrt() / f64::from(geometry.sound_speed_m_s)
    });
    Ok(PAIRS.map(|(i, j)| arrival[j] - arrival[i]))
}

/// All pictures of one array recording: `bearings.svg` (azimuths and elevations), `tracks.svg`, with truth `errors.svg`, and with the samples of a
/// segment about a bearing `correlations.svg`. `start`: UTC of sample 0.
///
/// # Errors
/// The folder cannot be written.
pub fn write_all(
    folder: &std::path::Path,
    config: &StationConfig,
    start: Option<OffsetDateTime>,
    (found, reports): (&[Bearing], &[Track]),
    truth: &[(String, Vec<Truth>)],
    segment: Option<(&Bearing, &[Frame])>,
) -> Result<()> {
    let longest_s = found.last().map_or(0.0, |b| b.index as f64 / config.rate_hz);
    let times = Times::new(start, longest_s);
    let pictures = Pictures::new(found, reports, config.rate_hz, &times, truth, &config.name);
    super::write_panels(&folder.join("bearings.svg"), &[&pictures.azimuths, &pictures.elevations], 1)?;
    pictures.tracks.write(&folder.join("tracks.svg"))?;
    if !truth.is_empty() {
        bearing_errors(found, config.rate_hz, &times, truth).write(&folder.join("errors.svg"))?;
    }
    if let Some((bearing, frames)) = segment {
        let curves = super::correlation::correlations(frames, config)?;
        let delays = delays(config, bearing.azimuth.into(), bearing.elevation.into())?;
        let when = times.moment(bearing.index as f64 / config.rate_hz);
        let figures = correlations(&curves, &delays, &when, &times.source(&config.name));
        let all: Vec<&Plot> = figures.iter().collect();
        super::write_panels(&folder.join("correlations.svg"), &all, 3)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::heard::tests::{RATE_HZ, bearing, track};
    use super::*;
    use cpu_time::ThreadTime;

    /// Vessels one after the other and two at a time, each for two hours, over so many seconds; a bearing of each every `step_s`.
    fn passages(seconds: f64, step_s: f64) -> (Vec<Bearing>, Vec<Track>) {
        let (mut bearings, mut reports) = (Vec::new(), Vec::new());
        for k in 0..(seconds / 3600.0) as u16 {
            let begins = 3600.0 * f64::from(k);
            let way = (begins + 3600.0, if k % 2 == 0 { 800.0 } else { -500.0 });
            let times = |step: f64| (0..(7200.0 / step) as usize).map(move |n| begins + n as f64 * step);
            bearings.extend(times(step_s).map(|t| Bearing { var_azimuth: 1e-3, ..bearing(t, way) }));
            reports.extend(times(60.0).map(|t| track(k, 0, t, way)));
            reports.push(track(k, Track::FINAL, begins + 7199.0, way));
        }
        bearings.sort_by_key(|b| b.index);
        reports.sort_by_key(|t| t.index);
        (bearings, reports)
    }

    /// Bearings of a passage with the truth of each.
    fn told() -> (Vec<Bearing>, Vec<(String, Vec<Truth>)>) {
        let way = (600.0, 300.0);
        let bearings: Vec<Bearing> =
            (0..200).map(|k| Bearing { var_azimuth: 1e-5, ..bearing(500.0 + f64::from(k), way) }).collect();
        let row = |b: &Bearing| Truth {
            t_s: b.index as f64 / RATE_HZ,
            x_m: 0.0,
            y_m: 0.0,
            arrival_azimuth_deg: f64::from(b.azimuth).to_degrees(),
            arrival_elevation_deg: 40.0,
            heading_deg: 0.0,
            cpa_time_s: 0.0,
            cpa_range_m: 0.0,
        };
        let rows = bearings.iter().map(row).collect();
        (bearings, vec![("ferry".to_owned(), rows)])
    }

    #[test]
    fn bearings_of_nobody_do_not_hide_the_errors_of_the_others() {
        let (mut bearings, truth) = told();
        for k in [50, 120] {
            bearings[k].azimuth += 0.15;
        }
        let figure = bearing_errors(&bearings, RATE_HZ, &Times::new(None, 800.0), &truth);
        let (low, high) = figure.y_range.unwrap();
        assert!(low == -high && high < 1.0, "{high}");
        let named = |words: &str| figure.series.iter().filter(|s| s.name.starts_with(words)).count();
        assert_eq!((named("95 % stated"), named("2 beyond"), named("ferry")), (1, 1, 1));
        let svg = figure.svg().unwrap();
        assert!(svg.contains("\n95 % stated\n"), "the band is in the legend");
    }

    #[test]
    fn elevations_have_their_truth() {
        let (bearings, truth) = told();
        let drawn = Pictures::new(&bearings, &[], RATE_HZ, &Times::new(None, 800.0), &truth, "east");
        for figure in [&drawn.azimuths, &drawn.elevations] {
            assert!(figure.series.iter().any(|s| s.name == "truth: ferry"));
        }
        assert!(drawn.elevations.y_range.is_some_and(|(low, high)| (low..=high).contains(&40.0)));
    }

    #[test]
    fn a_week_of_vessels_is_drawn_in_seconds_and_a_few_hundred_kilobytes() {
        let (bearings, reports) = passages(604_800.0, 12.0);
        assert!(bearings.len() > 100_000);
        let dir = tempfile::tempdir().unwrap();
        let begun = ThreadTime::now();
        let start = OffsetDateTime::from_unix_timestamp(1_714_521_600).unwrap();
        let times = Times::new(Some(start), 604_800.0);
        let pictures = Pictures::new(&bearings, &reports, RATE_HZ, &times, &[], "east");
        let (angles, map) = (dir.path().join("bearings.svg"), dir.path().join("tracks.svg"));
        super::super::write_panels(&angles, &[&pictures.azimuths, &pictures.elevations], 1).unwrap();
        pictures.tracks.write(&map).unwrap();
        assert!(begun.elapsed().as_secs_f64() < 10.0, "{:?}", begun.elapsed());
        let [angles, map] = [angles, map].map(|path| std::fs::read_to_string(path).unwrap());
        assert!(angles.len() < 500_000 && map.len() < 500_000, "{} {}", angles.len(), map.len());
        // Seven days, tracks that are named as far as there is room, and all courses.
        for words in ["2 May", "7 May", "time (UTC, 2024-05-01 to 2024-05-08)", "track 7"] {
            assert!(angles.contains(&format!("\n{words}\n")), "{words}");
        }
        assert!(angles.contains("more\n") && map.matches("<polyline").count() > 2 * 168);
        // Both panels show one time.
        assert!(
            pictures.azimuths.x_range.is_some() && pictures.azimuths.x_range == pictures.elevations.x_range
        );
        // Every bearing belongs to its vessel: the colours of two at a time are there in the middle of the week.
        let heard: Vec<Heard> = bearings.iter().map(|b| Heard::of(b, RATE_HZ)).collect();
        let found = Belonging::of_array(&reports, &heard, RATE_HZ);
        assert!(found.whose.iter().all(Option::is_some));
    }
}
