//! How a compact array is turned, from bearings of a vessel of known track.
//!
//! Enters: bearings, from a table or from the records of `process`, with the errors they state; the track. Leaves: the rotation, and how
//! late the array's clock is. Every shift of the clock is fitted with the same bearings and counts as likely as they, and what is known of
//! clocks, make it; where a shift needs the track beyond its ends it goes on straight. How many successive bearings share one error is measured on
//! what the likeliest shift leaves; what hydrophones' places and the speed of sound may be off by, as told, does not average out and is added.
//!
//! Refused are bearings that cannot be a vessel's on the surface: mirrored ones.

use super::compact_doubts::{Missed, doubts};
use super::known_vessel::{MOST_LEANING, on_track};
use super::track_file::heard_at;
use crate::bounds::bearing::lasting;
use crate::csv::{CsvTable, good_rows};
use crate::delays::correlated as shared;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::{Huber, median};
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use seabearing_locate::orient::rotation::{DirectionPair, Rotation, rotation};

/// Shifts of a grid.
const SHIFTS: usize = 40;
/// Cost beyond which a shift counts for nothing: five standard deviations.
const FARTHEST: f64 = 12.5;
/// Where the loss of a direction's error goes on straight, standard deviations of one component.
const CORNER: Huber = Huber { corner: 2.5 };
/// Below the horizon by so much is no vessel's direction, degrees, in most bearings, of a station whose vessels are well above.
const BELOW_DEG: f64 = 3.0;
/// Lean from which bearings below the horizon are those of a mirrored array, radians (8°): of one that leans less, a vessel's may be.
const LEANING: f64 = 8.0 * RAD_PER_DEG;

/// What is searched.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    /// Longest gap of the track that is interpolated, seconds.
    pub gap_s: f64,
    /// How many successive bearings share one error at least.
    pub correlated: f64,
    /// Largest shift either way, seconds; else the larger of six bearings and a tenth of the record.
    pub max_shift_s: Option<f64>,
    /// Standard deviation of the recorder's clock against the track's, seconds; 0: they agree.
    pub clock_sd_s: f64,
}

/// How an array is turned.
#[derive(Clone, Debug)]
pub struct Turned {
    /// The rotation at the likeliest shift, its deviations those over all shifts.
    pub rotation: Rotation,
    /// How late the array's clock is, and its standard deviation, seconds.
    pub shift_s: (f64, f64),
    /// How many successive bearings share one error.
    pub correlated: f64,
    /// Bearings of which the track tells nothing.
    pub off_track: usize,
    /// What it says against itself, a clause each: then the deviations do not hold.
    pub doubts: Vec<String>,
}

/// One bearing: time, direction, standard deviation (1 where none is stated).
struct Row {
    t_s: f64,
    measured: [f64; 3],
    sd: f64,
    stated: bool,
}

impl Row {
    fn of(t_s: f64, azimuth_deg: f64, elevation_deg: f64, sd_deg: Option<(f64, f64)>) -> Self {
        let (sa, ca) = (azimuth_deg * RAD_PER_DEG).sin_cos();
        let (se, ce) = (elevation_deg * RAD_PER_DEG).sin_cos();
        let sd = sd_deg.map_or(1.0, |(a, e)| (0.5 * ((a * ce).powi(2) + e * e)).sqrt() * RAD_PER_DEG);
        Self { t_s, measured: [sa * ce, ca * ce, se], sd, stated: sd_deg.is_some() }
    }
}

/// Where the vessel was when the sound that arrives at a time left it; beyond its ends the track goes on straight.
fn heard_beyond(track: &[TrackPoint], t_s: f64, sound_speed_m_s: f64) -> Option<[f64; 3]> {
    let at = |t_s: f64| -> Option<[f64; 3]> {
        let (a, b) = match track {
            [first, second, ..] if t_s < first.t_s => (first, second),
            [.., before, last] if t_s > last.t_s => (before, last),
            _ => return position_at(track, t_s, f64::INFINITY),
        };
        let share = (t_s - a.t_s) / (b.t_s - a.t_s);
        Some(std::array::from_fn(|k| a.position_m[k] + share * (b.position_m[k] - a.position_m[k])))
    };
    let [x, y, z] = at(t_s)?;
    at(t_s - (x * x + y * y + z * z).sqrt() / sound_speed_m_s)
}

/// The rows of a table `t_s,azimuth_deg,elevation_deg`, and `sd_azimuth_deg,sd_elevation_deg` where it has them.
fn of_table(table: &CsvTable) -> Result<Vec<Row>> {
    let name = table.name();
    if table.has("sd_azimuth_deg") && table.has("sd_elevation_deg") {
        let columns = ["t_s", "azimuth_deg", "elevation_deg", "sd_azimuth_deg", "sd_elevation_deg"];
        let rows = table.numbers(columns)?.into_iter().map(|(line, row)| {
            let row = row.and_then(|[t_s, azimuth, elevation, sa, se]| {
                if !(sa > 0.0 && se > 0.0) {
                    bail!("{name}, line {line}: standard deviations {sa} and {se}; they must be above 0");
                }
                Ok(Row::of(t_s, azimuth, elevation, Some((sa, se))))
            });
            (line, row)
        });
        return good_rows(name, rows.collect());
    }
    let rows = good_rows(name, table.numbers(["t_s", "azimuth_deg", "elevation_deg"])?)?;
    Ok(rows.into_iter().map(|[t_s, azimuth, elevation]| Row::of(t_s, azimuth, elevation, None)).collect())
}

/// Bearings of the strongest source in a file of records, with the errors they state.
fn of_records(path: &std::path::Path) -> Result<Vec<Row>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let row = |line: &str| {
        let record: serde_json::Value = serde_json::from_str(line).ok()?;
        let number = |key: &str| record.get(key).and_then(serde_json::Value::as_f64);
        let is_one = record.get("type")?.as_str()? == "bearing" && number("band").is_none_or(|b| b == 0.0);
        let refused = record.get("accepted").and_then(serde_json::Value::as_bool) == Some(false);
        let sd =
            number("sd_azimuth_deg").zip(number("sd_elevation_deg")).filter(|(a, e)| *a > 0.0 && *e > 0.0);
        (is_one && !refused).then(|| {
            Some(Row::of(number("t_s")?, number("azimuth_deg")?, number("elevation_deg")?, Some(sd?)))
        })?
    };
    let rows: Vec<Row> = text.lines().filter_map(row).collect();
    if rows.is_empty() {
        bail!("{}: no bearing with azimuth, elevation and their errors in it", path.display());
    }
    Ok(rows)
}

/// The turn of a compact array from a table of bearings.
///
/// # Errors
/// As [`of_file`].
pub fn array(
    station: &StationConfig,
    table: &CsvTable,
    track: &[TrackPoint],
    search: &Search,
) -> Result<Turned> {
    turned(station, table.name(), of_table(table)?, track, search)
}

/// The same from the records of `process`.
///
/// # Errors
/// A column is missing, or the data do not tell; bearings are below the horizon, or the array would lie on its side, and stand upright if the
/// signs of what it measured were mirrored.
pub fn of_file(
    station: &StationConfig,
    records: &std::path::Path,
    track: &[TrackPoint],
    search: &Search,
) -> Result<Turned> {
    turned(station, &records.display().to_string(), of_records(records)?, track, search)
}

fn turned(
    station: &StationConfig,
    name: &str,
    mut rows: Vec<Row>,
    track: &[TrackPoint],
    search: &Search,
) -> Result<Turned> {
    rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    let c = station.sound_speed_m_s;
    let (rows, off_track) = on_track(name, rows, |r| heard_at(track, r.t_s, search.gap_s, c));
    let rows: Vec<Row> = rows.into_iter().map(|(row, _)| row).collect();
    let directions = |shift_s: f64| -> Vec<DirectionPair> {
        let pair = |r: &Row| {
            let p = heard_beyond(track, r.t_s - shift_s, c)?;
            let n = p.iter().map(|x| x * x).sum::<f64>().sqrt();
            (n > 0.0).then(|| DirectionPair { measured: r.measured, known: p.map(|x| x / n), sd: r.sd })
        };
        rows.iter().filter_map(pair).collect()
    };
    let fit = |shift_s: f64, correlated: f64| rotation(&directions(shift_s), correlated);
    let none = fit(0.0, search.correlated).with_context(|| name.to_owned());
    let most_s = if search.clock_sd_s > 0.0 { most_shift(&rows, search.max_shift_s) } else { 0.0 };
    let grid = |low: f64, high: f64| (0..=SHIFTS).map(move |k| low + (high - low) * k as f64 / SHIFTS as f64);
    // The narrowest scatter scales the cost of all.
    let rough: Vec<(f64, Rotation)> =
        grid(-most_s, most_s).filter_map(|s| Some((s, fit(s, 1.0).ok()?))).collect();
    let of_scatter = |(s, r): &(f64, Rotation)| (scatter(&directions(*s), r), *s, *r);
    let Some((scale, near_s, found)) = rough.iter().map(of_scatter).min_by(|a, b| a.0.total_cmp(&b.0)) else {
        return Err(none.err().unwrap_or_else(|| anyhow::anyhow!("{name}: no bearing is on the track")));
    };
    let correlated = successive(&directions(near_s), &found).max(search.correlated);
    let cost = |s: f64, r: &Rotation| -> f64 {
        let losses = directions(s).into_iter().map(|d| CORNER.loss(error(&d, r) / (scale * d.sd)));
        // What is known of clocks: Student's law of two degrees, for some are far off.
        let prior = 1.5 * (0.5 * (s / search.clock_sd_s.max(1e-9)).powi(2)).ln_1p();
        losses.sum::<f64>() / correlated + if most_s > 0.0 { prior } else { 0.0 }
    };
    let costs: Vec<(f64, f64)> = rough.iter().map(|(s, r)| (*s, cost(*s, r))).collect();
    let least = costs.iter().fold(f64::INFINITY, |least, (_, c)| least.min(*c));
    let step_s = 2.0 * most_s / SHIFTS as f64;
    let likely = || costs.iter().filter(|(_, c)| *c < least + FARTHEST).map(|(s, _)| *s);
    let low = (likely().fold(f64::INFINITY, f64::min) - step_s).max(-most_s);
    let high = (likely().fold(f64::NEG_INFINITY, f64::max) + step_s).min(most_s);
    let fine: Vec<(f64, Rotation, f64)> = grid(low, high)
        .filter_map(|s| {
            let r = fit(s, correlated).ok()?;
            Some((s, r, cost(s, &r)))
        })
        .collect();
    let Some(best) = fine.iter().min_by(|a, b| a.2.total_cmp(&b.2)) else {
        return Err(none
            .err()
            .unwrap_or_else(|| anyhow::anyhow!("{name}: the bearings do not tell how it is turned")));
    };
    let weight = |f: &(f64, Rotation, f64)| (best.2 - f.2).exp();
    let sum: f64 = fine.iter().map(weight).sum();
    let moments = |of: &dyn Fn(&(f64, Rotation, f64)) -> f64| {
        let mean = fine.iter().map(|f| weight(f) * of(f)).sum::<f64>() / sum;
        (mean, fine.iter().map(|f| weight(f) * (of(f) - mean).powi(2)).sum::<f64>() / sum)
    };
    let shift = moments(&|f| f.0);
    // At the mean shift, so that errors lie about what is given.
    let mut found = fit(shift.0, correlated).unwrap_or(best.1);
    let off = |of: fn(&Rotation) -> f64| {
        let (_, variance) = moments(&|f| seabearing_core::angle::wrap_pi(of(&f.1) - of(&best.1)));
        variance
    };
    let by_shift = [off(|r| r.heading), off(|r| r.pitch), off(|r| r.roll)];
    let by_places = lasting_variance(station, &directions(shift.0));
    for ((sd, by_shift), by_places) in found.sd.iter_mut().zip(by_shift).zip(by_places) {
        *sd = (*sd * *sd + by_shift + by_places).sqrt();
    }
    refuse_mirrored(station, name, &directions(shift.0), &found, correlated)?;
    let shift_s = (shift.0, shift.1.sqrt());
    let missed: Vec<Missed> = rows
        .iter()
        .filter_map(|row| {
            let p = heard_beyond(track, row.t_s - shift.0, c)?;
            let range_m = p.iter().map(|x| x * x).sum::<f64>().sqrt();
            let pair = DirectionPair { measured: row.measured, known: p.map(|x| x / range_m), sd: row.sd };
            let [along, up] = apart(&pair, &found);
            let sd = row.stated.then_some(row.sd);
            (range_m > 0.0).then_some(Missed { along, up, sd, range_m })
        })
        .collect();
    let places = by_places[0].max(by_places[1]);
    let doubts = doubts(&missed, places, shift_s, most_s, step_s);
    Ok(Turned { rotation: found, shift_s, correlated, off_track, doubts })
}

/// Largest shift that is searched, seconds.
fn most_shift(rows: &[Row], given: Option<f64>) -> f64 {
    let mut steps: Vec<f64> = rows.windows(2).map(|w| w[1].t_s - w[0].t_s).filter(|d| *d > 0.0).collect();
    let duration_s = rows.last().zip(rows.first()).map_or(0.0, |(b, a)| b.t_s - a.t_s);
    given.unwrap_or((6.0 * median(&mut steps).unwrap_or(1.0)).max(0.1 * duration_s))
}

/// A measured direction, turned.
fn turn(d: &DirectionPair, r: &Rotation) -> [f64; 3] {
    r.matrix.map(|row| row.iter().zip(&d.measured).map(|(a, b)| a * b).sum())
}

/// Angle between a turned direction and the known one, radians.
fn error(d: &DirectionPair, r: &Rotation) -> f64 {
    let p = turn(d, r);
    let chord: f64 = p.iter().zip(&d.known).map(|(a, b)| (a - b) * (a - b)).sum();
    2.0 * (0.5 * chord.sqrt()).min(1.0).asin()
}

/// Robust standard deviation of one component of the errors, in units of those stated; the median of a Rayleigh variable is 1.1774 of them.
fn scatter(directions: &[DirectionPair], r: &Rotation) -> f64 {
    let mut errors: Vec<f64> = directions.iter().map(|d| error(d, r) / d.sd).collect();
    (median(&mut errors).unwrap_or(1.0) / 1.1774).max(1e-9)
}

/// How many successive directions share one error: the more of what azimuths and elevations show.
fn successive(directions: &[DirectionPair], r: &Rotation) -> f64 {
    let (mut along, mut up) = (Vec::new(), Vec::new());
    let scale = scatter(directions, r);
    for d in directions {
        // Wrong bearings are no part of what lasts.
        let [a, u] = apart(d, r).map(|x| CORNER.clipped(x / (scale * d.sd)));
        along.push(a);
        up.push(u);
    }
    shared(&along, 2.0).max(shared(&up, 2.0)).max(1.0)
}

/// By how much a turned direction misses the known one along the horizon and upwards, radians.
fn apart(d: &DirectionPair, r: &Rotation) -> [f64; 2] {
    let ([px, py, pz], [ux, uy, uz]) = (turn(d, r), d.known);
    let level = ux.hypot(uy).max(1e-9);
    [(px * uy - py * ux) / level, pz.clamp(-1.0, 1.0).asin() - uz.clamp(-1.0, 1.0).asin()]
}

/// What places of the hydrophones and the speed of sound, as told, leave in heading, pitch and roll: the mean over the pass, radians².
fn lasting_variance(station: &StationConfig, directions: &[DirectionPair]) -> [f64; 3] {
    let (Kind::Array(array), Ok(geometry)) = (&station.kind, station.geometry()) else { return [0.0; 3] };
    let of = |d: &DirectionPair| {
        let [x, y, z] = d.measured;
        lasting(&geometry, station, array, (x.atan2(y), z.clamp(-1.0, 1.0).asin()))
    };
    let (mut azimuth, mut elevation, mut n) = (0.0, 0.0, 0.0);
    for found in directions.iter().filter_map(of) {
        azimuth += found.azimuth * found.azimuth;
        elevation += found.elevation * found.elevation;
        n += 1.0;
    }
    if n > 0.0 { [azimuth / n, elevation / n, elevation / n] } else { [0.0; 3] }
}

/// Refuses directions that cannot be of a vessel on the surface.
fn refuse_mirrored(
    station: &StationConfig,
    name: &str,
    directions: &[DirectionPair],
    found: &Rotation,
    correlated: f64,
) -> Result<()> {
    let leaning = lean(found);
    let least = (BELOW_DEG * RAD_PER_DEG).sin();
    let below = directions.iter().filter(|d| d.measured[2] < -least).count();
    let above = directions.iter().filter(|d| d.known[2] > least).count();
    if 2 * below > directions.len() && 2 * above > directions.len() && leaning > LEANING {
        bail!(
            "{name}: {below} of {} bearings point below the horizon, where no vessel is, unless the array, {:.0} m deep, leans by {:.0}°: \
             are the signs mirrored, or the hydrophones upside down?",
            directions.len(),
            station.depth_m,
            leaning / RAD_PER_DEG
        );
    }
    if leaning > MOST_LEANING
        && let Some((mirror, least)) = upright_mirror(directions, correlated)
        && least < leaning
    {
        bail!(
            "{name}: the array would lean by {:.0}°, and by {:.0}° if {}",
            leaning / RAD_PER_DEG,
            least / RAD_PER_DEG,
            mirror.said
        );
    }
    Ok(())
}

/// How far the Up axis of a rotation is from the vertical, radians.
fn lean(of: &Rotation) -> f64 {
    let [_, _, [_, _, up]] = of.matrix;
    up.clamp(-1.0, 1.0).acos()
}

/// A way in which directions can be mirrored.
struct Mirror {
    /// What East, North and Up of a measured direction are multiplied by.
    signs: [f64; 3],
    /// As it ends a line.
    said: &'static str,
}

const MIRRORS: [Mirror; 3] = [
    Mirror {
        signs: [-1.0; 3],
        said: "all directions were opposite: are the signs mirrored, or the hydrophones upside down?",
    },
    Mirror {
        signs: [-1.0, 1.0, 1.0],
        said: "azimuths ran the other way round: are two channels exchanged, or East and North in `hydrophones_m`?",
    },
    Mirror {
        signs: [1.0, 1.0, -1.0],
        said: "elevations had the other sign: are the hydrophones upside down?",
    },
];

/// The mirror by which the array would lean least, and by how much. The directions of one pass lie nearly in a plane, in which a
/// mirrored array is one that is turned over: vessels are seen from upright ones.
fn upright_mirror(directions: &[DirectionPair], correlated: f64) -> Option<(&'static Mirror, f64)> {
    let leaning = |mirror: &'static Mirror| {
        let mirrored: Vec<_> = directions
            .iter()
            .map(|d| DirectionPair {
                measured: std::array::from_fn(|k| mirror.signs[k] * d.measured[k]),
                ..*d
            })
            .collect();
        rotation(&mirrored, correlated).ok().map(|r| (mirror, lean(&r)))
    };
    MIRRORS.iter().filter_map(leaning).min_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use rayon::prelude::*;

    const SEARCH: Search = Search { gap_s: 60.0, correlated: 1.0, max_shift_s: None, clock_sd_s: 1.0 };
    const DEPTH_M: f64 = 60.0;

    fn station() -> StationConfig {
        let h = [[0.0, 1.06, -0.38], [0.92, -0.53, -0.38], [-0.92, -0.53, -0.38], [0.0, 0.0, 1.13]];
        StationConfig { depth_m: DEPTH_M, ..StationConfig::array(64_000.0, h) }
    }

    fn track() -> Vec<TrackPoint> {
        let at = |t_s: f64| TrackPoint { t_s, position_m: [300.0, 6.0 * (t_s - 100.0), DEPTH_M - 5.0] };
        (0..201).map(|k| at(f64::from(k))).collect()
    }

    /// 190 bearings of an array turned by 25°, of a clock that is so late, with errors of 1° of which each has a share of the one before; what
    /// East, North and Up are multiplied by.
    fn rows(late_s: f64, share: f64, signs: [f64; 3], seed: u64) -> Vec<Row> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let (track, mut lasts) = (track(), [0.0; 2]);
        (2..192)
            .map(|k| {
                let t_s = f64::from(k);
                for e in &mut lasts {
                    *e = share * *e + (1.0 - share * share).sqrt() * normal();
                }
                let [x, y, z] = heard_beyond(&track, t_s - late_s, 1484.0).unwrap();
                let azimuth = (x.atan2(y) / RAD_PER_DEG - 25.0 + lasts[0]) * RAD_PER_DEG;
                let elevation = (z.atan2(x.hypot(y)) / RAD_PER_DEG + lasts[1]) * RAD_PER_DEG;
                let u = [azimuth.sin() * elevation.cos(), azimuth.cos() * elevation.cos(), elevation.sin()];
                Row { t_s, measured: std::array::from_fn(|k| signs[k] * u[k]), sd: 1.0, stated: false }
            })
            .collect()
    }

    fn errors(late_s: f64, share: f64) -> Vec<f64> {
        let of = |seed| {
            let rows = rows(late_s, share, [1.0; 3], seed);
            let found = turned(&station(), "test", rows, &track(), &SEARCH).unwrap();
            assert!((found.shift_s.0 - late_s).abs() < 4.0 * found.shift_s.1, "{found:?}");
            assert!(found.rotation.sd[0] < 1.5 * RAD_PER_DEG && found.doubts.is_empty(), "{found:?}");
            seabearing_core::angle::wrap_pi(found.rotation.heading - 25.0 * RAD_PER_DEG)
                / found.rotation.sd[0]
        };
        (0..24).into_par_iter().map(of).collect()
    }

    #[test]
    fn a_late_clock_and_errors_that_last_are_in_what_is_stated() {
        for (late_s, share) in [(3.0, 0.0), (0.0, 0.9)] {
            let found = errors(late_s, share);
            let rms = (found.iter().map(|x| x * x).sum::<f64>() / found.len() as f64).sqrt();
            assert!(rms < 1.4, "{late_s} {share}: {rms} {found:?}");
        }
    }

    #[test]
    fn another_vessel_and_a_clock_farther_off_than_searched_are_doubted() {
        // One that passes on another course; the bearings state 1°, or nothing.
        let at = |t_s: f64| TrackPoint { t_s, position_m: [5.0 * (t_s - 60.0), 420.0, DEPTH_M - 5.0] };
        let other: Vec<_> = (0..201).map(|k| at(f64::from(k))).collect();
        let told = |late_s, stated| -> Vec<Row> {
            let sd = if stated { RAD_PER_DEG } else { 1.0 };
            rows(late_s, 0.0, [1.0; 3], 3).into_iter().map(|r| Row { sd, stated, ..r }).collect()
        };
        let well = turned(&station(), "test", told(0.0, true), &track(), &SEARCH).unwrap();
        assert!(well.doubts.is_empty(), "{well:?}");
        for (late_s, stated, track) in [(0.0, true, &other), (0.0, false, &other), (30.0, false, &track())] {
            // Or nothing is told.
            let found = turned(&station(), "test", told(late_s, stated), track, &SEARCH);
            assert!(found.as_ref().map_or(true, |f| !f.doubts.is_empty()), "{stated} {late_s}: {found:?}");
        }
    }

    #[test]
    fn mirrored_signs_are_refused() {
        for signs in [[-1.0; 3], [1.0, 1.0, -1.0]] {
            let found = turned(&station(), "test", rows(0.0, 0.0, signs, 3), &track(), &SEARCH);
            let said = format!("{:#}", found.expect_err("refused"));
            assert!(said.lines().count() == 1 && said.contains("test"), "{said}");
        }
    }
}
