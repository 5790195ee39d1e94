//! Bearings of a network from the records of its recorders (`process`, or `records.jsonl` of a base station's store).
//!
//! Of an ocean-bottom station the detected tonal azimuths are bearings: those that hold most of their minute's evidence. A detected
//! range of the same minute, which also holds most of its own, stands in its elevation, `atan(depth / range)`: for a source of known depth at the
//! surface one is the other. Only the azimuth's spread is joined to `sd` then; a range's own is what it is.
//!
//! Each file tells its station in its `hello` record, or every record does. Where all files have a clock (`utc`) the
//! times are seconds since sample 0 of the recording that began first, as in the recorders' own records; otherwise `t_s` is
//! taken as it is, which is right only for recordings that began together.

use super::network_file::{Network, NetworkBearings};
use super::over_time::SOURCE_DEPTH_M;
use super::sets::BearingRow;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use serde_json::Value;
use std::path::PathBuf;
use time::format_description::well_known::Rfc3339;
use time::{Duration, OffsetDateTime};

/// Share of a minute's evidence from which on an azimuth or a range is the minute's own.
const CHIEF: f64 = 0.5;

/// Least standard deviation with which a range is taken, m: the step of the recorder's ranges, whose neighbours share errors.
const LEAST_RANGE_SD_M: f64 = 70.0;

/// A bearing with both its times.
struct UtcRow {
    utc: Option<OffsetDateTime>,
    /// What the recorder states of its clock.
    sd_utc_s: Option<f64>,
    /// It is an ocean-bottom station's.
    of_the_floor: bool,
    row: BearingRow,
}

impl UtcRow {
    /// UTC of sample 0 of its recording, where there is a clock.
    fn sample_0(&self) -> Option<OffsetDateTime> {
        self.utc?.checked_sub(Duration::checked_seconds_f64(self.row.t_s)?)
    }
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
            bail!(
                "{}: no `bearing` record of the whole band, and no detected tonal `azimuth`",
                file.display()
            );
        }
    }
    let start = found.iter().map(UtcRow::sample_0).min().flatten();
    if start.is_none() && files.len() > 1 {
        log::warn!("not all files have a clock (`utc`): their recordings are taken to begin together");
    }
    let of_the_floor = found.iter().any(|d| d.of_the_floor);
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
    Ok(NetworkBearings { rows, start, sd_clock_s, of_the_floor })
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
    // Ranges of ocean-bottom stations, by station and time.
    let mut ranges: Vec<(usize, f64, f64, f64)> = Vec::new();
    let first = found.len();
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let here = || format!("line {}", i + 1);
        let record: Value = serde_json::from_str(line).with_context(here)?;
        let number = |key: &str| record.get(key).and_then(Value::as_f64);
        if let Some(id) = record.get("station").and_then(Value::as_u64) {
            speaker = Some(id);
        }
        let whole_band = number("band").is_none_or(|b| b == 0.0);
        let accepted = record.get("accepted").and_then(Value::as_bool) != Some(false);
        let kind = record.get("type").and_then(Value::as_str).unwrap_or_default();
        let detected = record.get("detected").and_then(Value::as_bool) == Some(true);
        let chief = detected && number("weight").is_none_or(|w| w >= CHIEF);
        let tonal = record.get("source").and_then(Value::as_str) != Some("impulsive");
        let deep = match kind {
            "bearing" if whole_band && accepted => false,
            "azimuth" if chief && tonal => true,
            "range" if chief => true,
            _ => continue,
        };
        let Some(id) = speaker else {
            bail!("{}: no record has told the station yet (`hello`, or a key `station`)", here())
        };
        let station = network.find(&id.to_string()).with_context(here)?;
        if kind == "range" {
            let (Some(t_s), Some(range_m), Some(sd_m)) =
                (number("t_s"), number("range_m"), number("sd_range_m"))
            else {
                bail!("{}: a detected range needs `t_s`, `range_m` and `sd_range_m`", here())
            };
            ranges.push((station, t_s, range_m, sd_m.max(LEAST_RANGE_SD_M)));
            continue;
        }
        let (Some(t_s), Some(azimuth_deg)) = (number("t_s"), number("azimuth_deg")) else {
            bail!("{}: a bearing or a detected azimuth needs `t_s` and `azimuth_deg`", here())
        };
        let turn = if relative { network.stations[station].orientation_deg } else { 0.0 };
        let own = |key: &str| number(key).unwrap_or(0.0) * RAD_PER_DEG;
        let utc =
            record.get("utc").and_then(Value::as_str).and_then(|t| OffsetDateTime::parse(t, &Rfc3339).ok());
        found.push(UtcRow {
            utc,
            of_the_floor: false,
            sd_utc_s: number("sd_utc_s").filter(|x| x.is_finite() && *x >= 0.0),
            row: BearingRow {
                t_s,
                station,
                azimuth: wrap_tau((azimuth_deg + turn) * RAD_PER_DEG),
                elevation: number("elevation_deg").map(|e| e * RAD_PER_DEG),
                sd: (
                    sd.0.hypot(own(if deep { "sd_deg" } else { "sd_azimuth_deg" })),
                    sd.1.hypot(own("sd_elevation_deg")),
                ),
            },
        });
        if deep && let Some(last) = found.last_mut() {
            last.of_the_floor = true;
        }
    }
    for row in found.iter_mut().skip(first).filter(|r| r.of_the_floor).map(|r| &mut r.row) {
        let same = ranges.iter().find(|r| r.0 == row.station && (r.1 - row.t_s).abs() < 1e-3);
        let depth_m = -network.arrays_m[row.station][2] - SOURCE_DEPTH_M;
        if let Some((_, _, range_m, sd_m)) = same.filter(|_| depth_m > 0.0) {
            // d atan(z / r) = z dr / (r² + z²).
            row.elevation = Some(depth_m.atan2(*range_m));
            row.sd.1 = depth_m * sd_m / (range_m * range_m + depth_m * depth_m);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn azimuths_and_ranges_of_ocean_bottom_stations_are_bearings() {
        let folder = tempfile::tempdir().unwrap();
        let (list, records) = (folder.path().join("n.toml"), folder.path().join("r.jsonl"));
        let station = |id: u8, x: f64| {
            format!("[[stations]]\nid = {id}\nposition = {{ local_m = [{x:.1}, 0.0, -4005.0] }}\n")
        };
        std::fs::write(&list, station(1, 0.0) + &station(2, 9000.0)).unwrap();
        let azimuth = |t: f64, source: &str, weight: f64, detected: bool| {
            format!(
                "{{\"type\":\"azimuth\",\"station\":2,\"t_s\":{t},\"azimuth_deg\":40.0,\"sd_deg\":1.0,\
                 \"weight\":{weight},\"detected\":{detected},\"source\":\"{source}\"}}\n"
            )
        };
        let range = "{\"type\":\"range\",\"station\":2,\"t_s\":120.0,\"range_m\":12000.0,\"sd_range_m\":80.0,\"weight\":0.97,\
                     \"detected\":true}\n";
        let text = azimuth(60.0, "tonal", 0.9, true)
            + &azimuth(60.0, "tonal", 0.1, true)
            + &azimuth(60.0, "impulsive", 0.9, true)
            + &azimuth(120.0, "tonal", 0.9, true)
            + range
            + &azimuth(180.0, "tonal", 0.9, false);
        std::fs::write(&records, text).unwrap();
        let network = Network::read(&list).unwrap();
        let heard = read(&[records], &network, (0.0, 0.0), false).unwrap();
        assert!(heard.of_the_floor);
        let [without, with] = heard.rows.as_slice() else { panic!("{} rows", heard.rows.len()) };
        assert_eq!((without.elevation, with.station), (None, 1));
        let elevation = with.elevation.unwrap();
        assert!((4000.0 / elevation.tan() - 12_000.0).abs() < 1e-6, "{elevation}");
        // A range of one deviation more has an elevation of one deviation less.
        let less = 4000f64.atan2(12_080.0);
        assert!(((elevation - less) / with.sd.1 - 1.0).abs() < 0.01, "{}", with.sd.1);
        assert!((with.sd.0 - RAD_PER_DEG).abs() < 1e-12);
    }
}
