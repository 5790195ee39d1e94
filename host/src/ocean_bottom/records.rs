//! Azimuth and range records of `seabearing process`, read back: what orientation and place are estimated from when the
//! recording itself is not at hand.

use super::stages::{MomentEvidence, RANGE_STEP_M, RANGES};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Least standard deviation with which a range is taken, m: the step of the evidence and the errors that neighbouring
/// ranges share.
const LEAST_SD_M: f64 = 100.0;
/// Ranges a wrong one may be at, m.
const SPAN_M: f64 = 50_000.0;
/// Weight from which on an azimuth is the moment's own, not one of several.
const CHIEF: f64 = 0.5;

/// What the records say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Detected {
    /// Detected ranges of each moment, in order of time.
    pub ranges: Vec<MomentEvidence>,
    /// Time (s) and azimuth (rad) of detected tonal sources, in order of time.
    pub azimuths: Vec<(f64, f64)>,
}

/// Whether a file holds records: its first line is a JSON object.
pub fn is_records(path: &Path) -> bool {
    use std::io::{BufRead, BufReader, Read};
    let Ok(file) = std::fs::File::open(path) else { return false };
    let mut line = Vec::new();
    let read = BufReader::new(file.take(1 << 16)).read_until(b'\n', &mut line);
    read.is_ok() && serde_json::from_slice::<Value>(&line).is_ok_and(|v| v.is_object())
}

/// Reads files of records. Lines that are none are named on standard error and skipped.
///
/// # Errors
/// A file cannot be read, or there is no detected azimuth or range in any.
pub fn read(paths: &[impl AsRef<Path>]) -> Result<Detected> {
    let mut modes: BTreeMap<u64, Vec<Mode>> = BTreeMap::new();
    let mut records = Detected::default();
    for path in paths {
        let name = path.as_ref().display();
        let bytes = std::fs::read(path.as_ref()).with_context(|| format!("cannot read {name}"))?;
        let mut bad = 0;
        for (n, line) in bytes.split(|b| *b == b'\n').enumerate() {
            if line.trim_ascii().is_empty() {
                continue;
            }
            match serde_json::from_slice::<Value>(line).ok().and_then(|v| take(&v, &mut modes, &mut records))
            {
                Some(()) => {}
                None => {
                    bad += 1;
                    if bad <= 5 {
                        log::warn!("skipped {name}, line {}: no record of `process`", n + 1);
                    }
                }
            }
        }
        if bad > 5 {
            log::warn!("skipped {} more lines of {name}", bad - 5);
        }
    }
    if modes.is_empty() && records.azimuths.is_empty() {
        bail!(
            "no detected azimuth or range in {}",
            paths.iter().map(|p| p.as_ref().display().to_string()).collect::<Vec<_>>().join(", ")
        );
    }
    records.ranges = modes.into_iter().map(|(ms, modes)| evidence(ms as f64 / 1000.0, &modes)).collect();
    records.azimuths.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(records)
}

/// A range with its standard deviation (m) and weight.
type Mode = (f64, f64, f64);

/// Takes a record; `None` if it is none.
fn take(record: &Value, modes: &mut BTreeMap<u64, Vec<Mode>>, records: &mut Detected) -> Option<()> {
    let number = |key: &str| record.get(key).and_then(Value::as_f64);
    // What is not known is null: a record all the same, that tells nothing here.
    let null = |key: &str| record.get(key).is_some_and(Value::is_null);
    let detected = record.get("detected").and_then(Value::as_bool) == Some(true);
    match record.get("type")?.as_str()? {
        "azimuth" if null("azimuth_deg") => {}
        "range" if null("range_m") => {}
        "azimuth" => {
            let (t_s, azimuth_deg) = (number("t_s")?, number("azimuth_deg")?);
            let tonal = record.get("source").is_none_or(|s| s == "tonal");
            if detected && tonal && number("weight").is_none_or(|w| w >= CHIEF) {
                records.azimuths.push((t_s, azimuth_deg.to_radians()));
            }
        }
        "range" => {
            let (t_s, range_m) = (number("t_s")?, number("range_m")?);
            // Times before the start are no times of a recording.
            if detected && range_m > 0.0 && t_s >= 0.0 {
                let sd_m = number("sd_range_m").unwrap_or(LEAST_SD_M).max(LEAST_SD_M);
                let weight = number("weight").unwrap_or(1.0).clamp(0.0, 1.0);
                modes.entry((1000.0 * t_s).round() as u64).or_default().push((range_m, sd_m, weight));
            }
        }
        _ => {}
    }
    Some(())
}

/// The modes of a moment as a log-likelihood ratio against a range anywhere.
fn evidence(t_s: f64, modes: &[Mode]) -> MomentEvidence {
    let log_ratio = (0..RANGES).map(|j| {
        let range = RANGE_STEP_M * j as f64;
        let density: f64 = modes
            .iter()
            .map(|(at, sd, weight)| {
                let z = (range - at) / sd;
                weight * (-0.5 * z * z).exp() / (sd * std::f64::consts::TAU.sqrt())
            })
            .sum();
        (SPAN_M * density).max(1e-12).ln() as f32
    });
    MomentEvidence { t_s, log_ratio: log_ratio.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_become_evidence_and_wrong_lines_are_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.jsonl");
        let text = r#"{"type":"hello","wire_version":1}
{"type":"azimuth","t_s":120.0,"azimuth_deg":90.0,"weight":1.0,"detected":true,"source":"tonal"}
{"type":"azimuth","t_s":60.0,"azimuth_deg":80.0,"weight":1.0,"detected":true,"source":"impulsive"}
{"type":"range","t_s":60.0,"range_m":7000.0,"sd_range_m":40.0,"weight":0.7,"detected":true}
{"type":"range","t_s":60.0,"range_m":14000.0,"sd_range_m":40.0,"weight":0.3,"detected":true}
{"type":"range","t_s":120.0,"range_m":0.0,"sd_range_m":null,"weight":0.0,"detected":false}
not a record
"#;
        std::fs::write(&path, text).unwrap();
        assert!(is_records(&path));
        let records = read(&[&path]).unwrap();
        assert_eq!(records.azimuths, [(120.0, 90f64.to_radians())]);
        let [minute] = &records.ranges[..] else { panic!("{records:?}") };
        assert_eq!((minute.t_s, minute.log_ratio.len()), (60.0, RANGES));
        assert!(minute.log_ratio[100] > 4.5 && minute.log_ratio[200] > 3.5 && minute.log_ratio[150] < -20.0);
        std::fs::write(&path, "t_s,azimuth_deg\n1,2\n").unwrap();
        assert!(!is_records(&path) && read(&[&path]).is_err());
    }

    #[test]
    fn what_is_not_known_is_a_record_all_the_same() {
        let (mut modes, mut records) = (BTreeMap::new(), Detected::default());
        let mut taken = |text: &str| take(&serde_json::from_str(text).unwrap(), &mut modes, &mut records);
        assert!(taken(r#"{"type":"azimuth","t_s":60.0,"azimuth_deg":null,"detected":false}"#).is_some());
        assert!(taken(r#"{"type":"range","t_s":60.0,"range_m":null,"detected":false}"#).is_some());
        assert!(taken(r#"{"type":"azimuth","t_s":60.0,"detected":true}"#).is_none());
        assert!(modes.is_empty() && records == Detected::default());
    }
}
