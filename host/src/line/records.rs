//! Records of a line's bearings: written by `process`, read by `orient`.

use super::LineBearing;
use crate::record::RecordFormat;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_locate::line::{Azimuths, azimuths};
use serde_json::{Value, json};
use std::path::Path;

/// The type of these records.
const TYPE: &str = "line_bearing";

/// What a line heard at one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Mean time of what it rests on, seconds.
    pub t_s: f64,
    /// Sines of the bearings of its sources, the strongest first.
    pub sines: Vec<f64>,
}

/// A bearing as a record; `orientation` is the azimuth of the line's axis, radians.
pub fn json(bearing: &LineBearing, orientation: f64, format: &RecordFormat) -> Value {
    let LineBearing { t_s, source, sine, sd, snr_db, frequencies } = *bearing;
    // On the horizon; farther up or down, both are nearer to the axis.
    let sides = match azimuths(sine, orientation, 1.0) {
        Some(Azimuths::Mirror(right, left)) => vec![right / RAD_PER_DEG, left / RAD_PER_DEG],
        Some(Azimuths::Endfire(one)) => vec![one / RAD_PER_DEG],
        None => Vec::new(),
    };
    let across = (1.0 - sine * sine).max(0.0).sqrt();
    let sd_deg = (across > 2.0 * sd).then(|| sd / across / RAD_PER_DEG);
    let mut record = json!({
        "type": TYPE, "t_s": t_s, "source": source, "sin_bearing": sine, "sd_sin_bearing": sd,
        "azimuths_deg": sides, "sd_azimuth_deg": sd_deg, "snr_db": snr_db, "frequencies": frequencies,
    });
    if let Some(utc) = format.utc(t_s) {
        record["utc"] = utc.into();
    }
    record
}

/// All bearings in a file of records, those of one time together as the sources of a step, in order of time. Lines of other types are
/// passed over; those that are no records are counted on standard error.
///
/// # Errors
/// The file cannot be read, or holds no bearing of a line.
pub fn read(path: &Path) -> Result<Vec<Step>> {
    let name = path.display();
    let text = std::fs::read(path).with_context(|| format!("cannot read {name}"))?;
    let (mut heard, mut bad) = (Vec::new(), 0);
    for text in text.split(|b| *b == b'\n').filter(|t| !t.trim_ascii().is_empty()) {
        let Ok(record) = serde_json::from_slice::<Value>(text) else {
            bad += 1;
            continue;
        };
        if record["type"] != TYPE {
            continue;
        }
        match (record["t_s"].as_f64(), record["sin_bearing"].as_f64()) {
            (Some(t_s), Some(sine)) if sine.abs() <= 1.5 => heard.push((t_s, sine)),
            _ => bad += 1,
        }
    }
    if bad > 0 {
        log::warn!("{name}: {bad} lines are no bearings of a line and were left out");
    }
    if heard.is_empty() {
        bail!(
            "{name}: no bearing of a line in it: `{TYPE}` records of `seabearing process`, or a table t_s,sin_bearing, are needed"
        );
    }
    // Stable: of one time the strongest source stays first.
    heard.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut out: Vec<Step> = Vec::new();
    for (t_s, sine) in heard {
        match out.last_mut().filter(|step| step.t_s == t_s) {
            Some(step) => step.sines.push(sine),
            None => out.push(Step { t_s, sines: vec![sine] }),
        }
    }
    Ok(out)
}
