//! The simulated sea around an array: vessels, their sound, ambient noise and a recorder with its faults.
//!
//! Enters: an [`ArrayScenario`]. Leaves: an iterator over frames ([`SimulatedArray`]), or files ([`fn@write`]). Physical levels
//! throughout: pressures are µPa, densities µPa²/Hz. Assumed: a homogeneous ocean (straight rays), a flat surface, no
//! absorption (1 dB/km at 10 kHz: 2 dB at the ranges of interest), point sources. `docs/simulate.md` has the details.

pub mod array;
pub mod converter;
pub mod noise;
pub mod scenario;
pub mod source;
pub mod truth;

pub use array::SimulatedArray;
pub use scenario::ArrayScenario;

use crate::recording::write::wav;
use crate::recording::written_time::WrittenTime;
use crate::scenario::Written;
use anyhow::{Result, bail};
use std::path::Path;

/// Simulates a scenario into a folder: recordings, `truth.csv`, `station.toml`.
///
/// # Errors
/// Files cannot be written or read, or the sample rate is no whole number.
pub fn write(scenario: &ArrayScenario, folder: &Path) -> Result<Written> {
    let config = &scenario.station.config;
    let rate = config.rate_hz;
    if rate.fract() != 0.0 {
        bail!("WAV files need a whole number of samples a second, the station file says {rate}");
    }
    let mut array = SimulatedArray::new(scenario)?;
    let bar = crate::progress::bar(array.total(), "simulating");
    let mut recordings = Vec::new();
    let name: String =
        config.name.chars().map(|c| if c.is_alphanumeric() || c == '-' { c } else { '-' }).collect();
    let mut at = 0u64;
    for (from, to) in spans(scenario) {
        if from > at {
            array.by_ref().take((from - at) as usize).for_each(drop);
        }
        let start = scenario.start + time::Duration::nanoseconds((from as f64 / rate * 1e9).round() as i64);
        let path = folder.join(format!("{name}_{}.wav", WrittenTime::name(start)));
        let frames = array.by_ref().take((to - from) as usize).enumerate().map(|(i, frame)| {
            if i % 65_536 == 0 {
                bar.set_position(from + i as u64);
            }
            frame
        });
        wav(&path, rate as u32, scenario.recorder.encoding, frames)?;
        recordings.push(path);
        at = to;
    }
    bar.finish_and_clear();
    let truth = folder.join("truth.csv");
    crate::atomic::write(&truth, truth::csv(scenario)?.as_bytes())?;
    let station = folder.join("station.toml");
    crate::atomic::write(&station, scenario.station_text.as_bytes())?;
    Ok(Written { recordings, truth, tracks: None, station, table: None })
}

/// First index of every file and the index after its last.
fn spans(scenario: &ArrayScenario) -> Vec<(u64, u64)> {
    let rate = scenario.station.config.rate_hz;
    let index = |t: f64| (t * rate).round() as u64;
    let total = index(scenario.duration_s);
    let mut between = Vec::new();
    let mut from = 0;
    for gap in &scenario.gaps {
        between.push((from, index(gap.start_s).min(total)));
        from = index(gap.start_s + gap.duration_s);
    }
    between.push((from, total));
    let longest =
        if scenario.recorder.file_s > 0.0 { index(scenario.recorder.file_s).max(1) } else { u64::MAX };
    let mut spans = Vec::new();
    for (mut from, to) in between {
        while from < to {
            let end = to.min(from.saturating_add(longest));
            spans.push((from, end));
            from = end;
        }
    }
    spans
}
