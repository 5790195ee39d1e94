//! Bearings of a network from the records of its recorders (`process`, or `records.jsonl` of a base station's store).
//!
//! Each file tells its station in its `hello` record, or every record does. Where all files have a clock (`utc`) the
//! times are seconds since the earliest bearing; otherwise `t_s` is taken as it is, which is right only for recordings
//! that began together.

use super::network_file::{Network, NetworkBearings};
use super::sets::BearingRow;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use serde_json::Value;
use std::path::PathBuf;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// A bearing with both its times.
struct UtcRow {
    utc: Option<OffsetDateTime>,
    /// What the recorder states of its clock.
    sd_utc_s: Option<f64>,
    row: BearingRow,
}

/// Reads the bearings of all files, in order of time, with what is told of their clocks. `sd` (azimuth, elevation;
/// radians) is joined to each record's own.
///
/// # Errors
/// A file cannot be read, holds no bearing, or does not tell its station.
pub fn read(files: &[PathBuf], network: &Network, sd: (f64, f64), relative: bool) -> Result<NetworkBearings> {
    let mut found: Vec<UtcRow> = Vec::new();
    for file in files {
        let before = found.len();
        one_file(file, network, sd, relative, &mut found).with_context(|| format!("{}", file.display()))?;
        if found.len() == before {
            bail!("{}: no `bearing` record of the whole band", file.display());
        }
    }
    let start = found.iter().map(|d| d.utc).min().flatten();
    if start.is_none() && files.len() > 1 {
        log::warn!("not all files have a clock (`utc`): their recordings are taken to begin together");
    }
    let mut sd_clock_s = vec![None; network.stations.len()];
    for d in &found {
        let sd_s: &mut Option<f64> = &mut sd_clock_s[d.row.station];
        *sd_s = d.sd_utc_s.map(|x| sd_s.unwrap_or(0.0).max(x)).or(*sd_s);
    }
    let mut rows: Vec<BearingRow> = found
        .into_iter()
        .map(|d| match (start, d.utc) {
            (Some(start), Some(utc)) => BearingRow { t_s: (utc - start).as_seconds_f64(), ..d.row },
            _ => d.row,
        })
        .collect();
    rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    Ok(NetworkBearings { rows, start, sd_clock_s })
}

fn one_file(
    file: &PathBuf,
    network: &Network,
    sd: (f64, f64),
    relative: bool,
    found: &mut Vec<UtcRow>,
) -> Result<()> {
    let text = std::fs::read_to_string(file)?;
    let mut speaker: Option<u64> = None;
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let here = || format!("line {}", i + 1);
        let record: Value = serde_json::from_str(line).with_context(here)?;
        let number = |key: &str| record.get(key).and_then(Value::as_f64);
        if let Some(id) = record.get("station").and_then(Value::as_u64) {
            speaker = Some(id);
        }
        let whole_band = number("band").is_none_or(|b| b == 0.0);
        let accepted = record.get("accepted").and_then(Value::as_bool) != Some(false);
        if record.get("type").and_then(Value::as_str) != Some("bearing") || !whole_band || !accepted {
            continue;
        }
        let Some(id) = speaker else {
            bail!("{}: no record has told the station yet (`hello`, or a key `station`)", here())
        };
        let station = network.find(&id.to_string()).with_context(here)?;
        let (Some(t_s), Some(azimuth_deg)) = (number("t_s"), number("azimuth_deg")) else {
            bail!("{}: a bearing needs `t_s` and `azimuth_deg`", here())
        };
        let turn = if relative { network.stations[station].orientation_deg } else { 0.0 };
        let own = |key: &str| number(key).unwrap_or(0.0) * RAD_PER_DEG;
        let utc =
            record.get("utc").and_then(Value::as_str).and_then(|t| OffsetDateTime::parse(t, &Rfc3339).ok());
        found.push(UtcRow {
            utc,
            sd_utc_s: number("sd_utc_s").filter(|x| x.is_finite() && *x >= 0.0),
            row: BearingRow {
                t_s,
                station,
                azimuth: wrap_tau((azimuth_deg + turn) * RAD_PER_DEG),
                elevation: number("elevation_deg").map(|e| e * RAD_PER_DEG),
                sd: (sd.0.hypot(own("sd_azimuth_deg")), sd.1.hypot(own("sd_elevation_deg"))),
            },
        });
    }
    Ok(())
}
