//! A compact array's geometry and orientation from one pass, and the station file with what was found.

use super::known_vessel::MOST_LEANING;
use super::measured_delays::Measurer;
use crate::csv::{CsvTable, good_rows};
use crate::delays::COLUMNS;
use crate::recording::BlockSource;
use crate::toml_file::TomlFile;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::config::{ArrayConfig, Kind, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use seabearing_locate::orient::geometry::{Doubts, Mended, TimedDelays, geometry};

/// Accuracy of positions that is asked for, metres: beyond it a line says what the pass does not tell.
pub const WANTED_M: f64 = 0.002;

/// The compact array of a station whose positions are doubted.
///
/// # Errors
/// It is no compact array, or its station file calls the positions exact.
pub fn doubted(config: &StationConfig) -> Result<&ArrayConfig> {
    let Kind::Array(array) = &config.kind else {
        bail!("the station is no compact array (kind = \"array\"), which --geometry needs");
    };
    if !(array.position_sd_m > 0.0) {
        bail!(
            "the station file calls its hydrophones' positions exact: `position_sd_m` in [array] says how far they may be off, \
             as 0.01"
        );
    }
    Ok(array)
}

/// Delays from a table of `t_s,tdoa01_s,…`, in order of time.
///
/// # Errors
/// A column is missing, or no row is usable.
pub fn of_table(table: &CsvTable) -> Result<Vec<TimedDelays>> {
    let mut rows = good_rows(table.name(), table.numbers(COLUMNS)?)?;
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    Ok(rows.into_iter().map(|[t_s, tdoa_s @ ..]| TimedDelays { t_s, tdoa_s }).collect())
}

/// Delays measured in a recording; times count from its first sample.
///
/// # Errors
/// The recording is lost, or nothing is heard in it.
pub fn of_recording(
    config: &StationConfig,
    array: &ArrayConfig,
    source: &mut dyn BlockSource,
) -> Result<Vec<TimedDelays>> {
    let mut measurer = Measurer::new(config, array);
    while let Some(block) = source.next_block()? {
        measurer.take(&block);
    }
    let sets = measurer.finish();
    if sets.is_empty() {
        bail!("nothing that all hydrophones hear stands out of the noise in the recording");
    }
    Ok(sets)
}

/// How far the image in the surface may pull the height from which a vessel is heard, m² ([`Doubts::image_m2`]): that of a vessel twice as
/// deep as the station expects. 0 where it expects no image.
pub fn image_m2(array: &ArrayConfig) -> f64 {
    2.0 * (2.0 * array.vessel_depth_m).powi(2)
}

/// Mends the geometry; with it of how many sets the track tells nothing. `doubts` without positions and speed of sound, which the
/// station file tells.
///
/// # Errors
/// The data do not tell; the array would not hang upright.
pub fn mend(
    config: &StationConfig,
    sets: &[TimedDelays],
    track: &[TrackPoint],
    gap_s: f64,
    doubts: &Doubts,
) -> Result<(Mended, usize)> {
    let array = doubted(config)?;
    let doubts =
        Doubts { position_m: array.position_sd_m, sound_speed_m_s: array.sound_speed_sd_m_s, ..*doubts };
    let off_track = sets.iter().filter(|s| position_at(track, s.t_s, gap_s).is_none()).count();
    let found = geometry(sets, track, gap_s, &array.hydrophones_m, config.sound_speed_m_s, &doubts)?;
    let [_, _, [_, _, up]] = found.matrix;
    let lean = up.clamp(-1.0, 1.0).acos();
    if lean > MOST_LEANING {
        bail!(
            "the array would lean by {:.0}°: tdoaIJ is the arrival at J minus that at I; are signs or pairs mirrored, two channels \
             exchanged, or the hydrophones upside down? (An array that fell over is not mended: its bearings and `orient` alone tell how \
             it lies.)",
            lean / RAD_PER_DEG
        );
    }
    Ok((found, off_track))
}

/// What the pass does not tell, in a line; `None` where it tells all to [`WANTED_M`].
pub fn untold(found: &Mended) -> Option<String> {
    let (rms_m, largest_m) = found.sd_m;
    (largest_m > WANTED_M).then(|| {
        let mm = |x: f64| 1e3 * x;
        let why = if found.untold > 0.5 {
            "; it is a straight course's plane: one that turns near the array, or a second one across it, tells the rest"
        } else {
            ""
        };
        format!(
            "this pass does not tell the geometry to {:.0} mm: {:.1} of the 6 numbers of its shape stay as uncertain as they were, and \
             positions by {:.1} mm on average and up to {:.1} mm{why}",
            mm(WANTED_M),
            found.untold,
            mm(rms_m),
            mm(largest_m)
        )
    })
}

/// How many of its own standard deviations a thing may be from where it was said to be.
const FAR_SD: f64 = 3.5;
/// Fewest independent errors in a pass whose residuals are errors of measurement.
const LEAST_STRETCHES: f64 = 10.0;

/// What the pass contradicts of what was said beforehand, a clause each: then the deviations, which rest on it, do not hold.
pub fn contradicted(
    config: &StationConfig,
    array: &ArrayConfig,
    found: &Mended,
    doubts: &Doubts,
) -> Vec<String> {
    let mut all = Vec::new();
    // A common displacement is none.
    let moved: Vec<[f64; 3]> = found
        .position_m
        .iter()
        .zip(&array.hydrophones_m)
        .map(|(a, b)| [0, 1, 2].map(|k: usize| a[k] - b[k]))
        .collect();
    let mean = [0, 1, 2].map(|k: usize| moved.iter().map(|x| x[k]).sum::<f64>() / moved.len() as f64);
    let square: f64 = moved.iter().flat_map(|x| [0, 1, 2].map(|k: usize| (x[k] - mean[k]).powi(2))).sum();
    // Of the shape's six numbers, those the pass tells.
    let told = (6.0 - found.untold).max(1.0);
    let sd_m = array.position_sd_m;
    if square > sd_m * sd_m * (told + FAR_SD * (2.0 * told).sqrt()) {
        all.push(format!(
            "hydrophones {:.1} cm from where they are said to be (root mean square), with position_sd_m = {sd_m}",
            100.0 * (square / 4.0).sqrt()
        ));
    }
    // Errors of measurement change from set to set, those of what was said last.
    let sets = (found.n + found.wrong) as f64 / PAIRS.len() as f64;
    if sets < LEAST_STRETCHES * found.correlated {
        all.push(format!(
            "delays miss the fit by {:.1} µs for {:.0} sets of {sets:.0} on end, as hydrophones, a track or a clock do that are farther off \
             than told",
            1e6 * found.scale_s,
            found.correlated
        ));
    }
    let mut far = |what: &str, off: f64, sd: f64, unit: &str, option: &str| {
        if sd > 0.0 && off.abs() > FAR_SD * sd {
            all.push(format!("{what} {off:.1} {unit} off, with {option} {sd}"));
        }
    };
    let [east, north, up] = found.track_m.0;
    far("a track to the East", east, doubts.track_m, "m", "--track-sd-m");
    far("a track to the North", north, doubts.track_m, "m", "--track-sd-m");
    far("a source's height", up, doubts.height_m, "m", "--source-depth-sd-m");
    far("a clock", found.late_s.0, doubts.clock_s, "s", "--clock-sd-s");
    let faster = found.sound_speed_m_s.0 - config.sound_speed_m_s;
    far("a speed of sound", faster, array.sound_speed_sd_m_s, "m/s", "sound_speed_sd_m_s =");
    all
}

/// The largest standard deviation of a coordinate in the frame of the station file, metres: what `position_sd_m` is from now on.
pub fn largest_sd_m(found: &Mended) -> f64 {
    found.sd_level_m.iter().flatten().fold(0.0, |a, b| a.max(*b))
}

/// The station file's text with what was found: `hydrophones_m`, `orientation_deg`, `position_sd_m`, and the speed of sound with its own.
///
/// # Errors
/// The text is no station file's.
pub fn station_text(file: &TomlFile, found: &Mended) -> Result<String> {
    let rows: Vec<String> =
        found.level_m.iter().map(|[x, y, z]| format!("[{x:.4}, {y:.4}, {z:.4}]")).collect();
    // To a tenth of a millimetre, and never less than the rounding.
    let position_sd_m = largest_sd_m(found).max(1e-4);
    let (speed, speed_sd) = found.sound_speed_m_s;
    let values = [
        ("station", "orientation_deg", format!("{:.3}", found.heading / RAD_PER_DEG)),
        ("station", "sound_speed_m_s", format!("{speed:.2}")),
        ("array", "hydrophones_m", format!("[{}]", rows.join(", "))),
        ("array", "position_sd_m", format!("{position_sd_m:.4}")),
        ("array", "sound_speed_sd_m_s", format!("{speed_sd:.2}")),
    ];
    let mut file = file.clone();
    for (table, key, value) in values {
        let text = if file.has(&format!("{table}.{key}")) {
            file.text_with(table, key, &value)
        } else {
            with_key(file.text(), table, key, &value)
        };
        file = TomlFile::of(&text, file.name());
    }
    file.table().with_context(|| "the station file with what was found".to_owned())?;
    Ok(file.text().to_owned())
}

/// The text with another key at the beginning of a table.
fn with_key(text: &str, table: &str, key: &str, value: &str) -> String {
    let header = format!("[{table}]");
    let mut out = String::new();
    for line in text.lines() {
        out += line;
        out.push('\n');
        if line.split('#').next().is_some_and(|l| l.trim() == header) {
            out += &format!("{key} = {value}\n");
        }
    }
    out
}
