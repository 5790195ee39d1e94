//! Bearings of one array from a CSV file, `t_s,azimuth_deg` and optionally `sigma_deg` (or `sd_azimuth_deg`, as records call
//! it), `elevation_deg`, `sd_elevation_deg`, or from the records of `seabearing process`.

use crate::csv::{CsvTable, good_rows};
use crate::ocean_bottom::records::is_records;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_tau};
use seabearing_locate::motion::ml::Sample;
use serde_json::Value;
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Reads the bearings in order of time. `sd_rad`: standard deviation of an azimuth where no column `sigma_deg` says
/// another; `sd_elevation_rad`: that of elevations, which are read only where it is given. Rows that cannot be used are
/// named on standard error and left out.
///
/// # Errors
/// The file cannot be read, or no row of it is usable.
pub fn read(path: &Path, sd_rad: f64, sd_elevation_rad: Option<f64>) -> Result<Vec<Sample>> {
    let name = path.display().to_string();
    let rows = if is_records(path) {
        of_records(path, sd_elevation_rad.is_some())?
    } else {
        of_table(&CsvTable::read(path)?, sd_rad, sd_elevation_rad)?
    };
    if rows.is_empty() {
        bail!("{name}: no bearing of an array in it");
    }
    let mut samples = good_rows(&name, rows)?;
    if !samples.is_sorted_by(|a, b| a.t_s <= b.t_s) {
        log::warn!("{name}: rows are not in order of time; sorted");
        samples.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    }
    Ok(samples)
}

/// Whether a file holds records, whose deviations count what lasts of the errors as well.
pub fn are_recorded(path: &Path) -> bool {
    is_records(path)
}

/// UTC of time 0, where the first bearing tells its own.
pub fn start(path: &Path) -> Option<OffsetDateTime> {
    let (utc, t_s) = if is_records(path) {
        let text = std::fs::read_to_string(path).ok()?;
        let mut records = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let first = records.find(|r| r["type"] == "bearing")?;
        (first["utc"].as_str()?.to_owned(), first["t_s"].as_f64()?)
    } else {
        let table = CsvTable::read(path).ok()?;
        let (utc, t_s) = (table.column("utc").ok()?, table.column("t_s").ok()?);
        let mut rows =
            (0..table.len()).filter_map(|row| Some((table.text(row, utc)?, table.text(row, t_s)?)));
        let (utc, t_s) = rows.find(|(utc, _)| !utc.is_empty())?;
        (utc.to_owned(), t_s.parse().ok()?)
    };
    let at = OffsetDateTime::parse(&utc, &Rfc3339).ok()?;
    at.checked_sub(time::Duration::checked_seconds_f64(t_s)?)
}

/// The strongest source's bearings among records, each with the errors it states.
fn of_records(path: &Path, elevations: bool) -> Result<Vec<(usize, Result<Sample>)>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let bearing = |(n, line): (usize, &str)| {
        let place = || format!("{}, line {}", path.display(), n + 1);
        let record = match serde_json::from_str::<Value>(line) {
            Ok(record) => record,
            Err(_) if line.trim().is_empty() => return None,
            Err(_) => return Some((n + 1, Err(anyhow!("{}: no record", place())))),
        };
        let number = |key: &str| record.get(key).and_then(Value::as_f64);
        let is_one = record.get("type")?.as_str()? == "bearing" && number("band") == Some(0.0);
        let rad = |key: &str| Some(number(key)? * RAD_PER_DEG);
        let sample = || {
            let (azimuth, sd) = (wrap_tau(rad("azimuth_deg")?), rad("sd_azimuth_deg")?);
            let mut sample = Sample::azimuth(number("t_s")?, azimuth, sd);
            if let (true, Some(e), Some(sd)) = (elevations, rad("elevation_deg"), rad("sd_elevation_deg")) {
                sample.elevation_rad = (e as f32, sd as f32);
            }
            Some(sample)
        };
        let missing = || format!("{}: a bearing without time, azimuth or error", place());
        is_one.then(|| (n + 1, sample().with_context(missing)))
    };
    Ok(text.lines().enumerate().filter_map(bearing).collect())
}

/// The rows of a table.
fn of_table(
    table: &CsvTable,
    sd_rad: f64,
    sd_elevation_rad: Option<f64>,
) -> Result<Vec<(usize, Result<Sample>)>> {
    let name = table.name();
    let column = |key: &str, wanted: bool| -> Result<_> {
        (wanted && table.has(key)).then(|| table.numbers([key])).transpose()
    };
    let sigma = if table.has("sigma_deg") { "sigma_deg" } else { "sd_azimuth_deg" };
    let sigmas = column(sigma, true)?;
    let elevations = column("elevation_deg", sd_elevation_rad.is_some())?;
    let sd_elevations = column("sd_elevation_deg", sd_elevation_rad.is_some())?;
    // A table of records: the strongest source's bearings.
    let places = |key: &str| table.has(key).then(|| table.column(key)).transpose();
    let (of_type, of_band) = (places("type")?, places("band")?);
    let is_bearing = |i: usize| {
        let says = |column: Option<usize>, wanted: &str| {
            column.is_none_or(|c| table.text(i, c).is_some_and(|cell| cell.trim() == wanted))
        };
        of_type.is_none() || says(of_type, "bearing") && says(of_band, "0")
    };
    let mut rows = Vec::new();
    for (i, (line, row)) in table.numbers(["t_s", "azimuth_deg"])?.into_iter().enumerate() {
        if !is_bearing(i) {
            continue;
        }
        let one = row.and_then(|[t_s, azimuth_deg]| {
            let sd_rad = match sigmas.as_ref().and_then(|s| s.get(i)) {
                Some((_, Ok([s]))) if *s > 0.0 => s * RAD_PER_DEG,
                Some((_, Ok([s]))) => bail!("{name}, line {line}: `{sigma}` is {s}, it must be above 0"),
                Some((_, Err(e))) => bail!("{e:#}"),
                None => sd_rad,
            };
            let mut sample = Sample::azimuth(t_s, wrap_tau(azimuth_deg * RAD_PER_DEG), sd_rad);
            // A row may do without an elevation.
            if let (Some((_, Ok([e]))), Some(sd)) =
                (elevations.as_ref().and_then(|e| e.get(i)), sd_elevation_rad)
            {
                let own = sd_elevations.as_ref().and_then(|s| s.get(i));
                let sd = match own {
                    Some((_, Ok([s]))) if *s > 0.0 => s * RAD_PER_DEG,
                    _ => sd,
                };
                sample.elevation_rad = ((e * RAD_PER_DEG) as f32, sd as f32);
            }
            Ok(sample)
        });
        rows.push((line, one));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_records_gives_its_bearings_with_their_errors() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("records.csv");
        let text = "type,t_s,azimuth_deg,sd_azimuth_deg,elevation_deg,sd_elevation_deg,band\n\
                    hello,,,,,,\nbearing,1.0,10,0.5,20,1.5,0\nbearing,1.0,12,3,20,4,2\nhealth,2.0,,,,,\n\
                    bearing,2.0,11,0.25,,,0\n";
        std::fs::write(&path, text).unwrap();
        let samples = read(&path, 1.0, Some(1.0)).unwrap();
        assert_eq!(start(&path), None);
        let sd: Vec<f64> = samples.iter().map(|s| f64::from(s.sd_rad) / RAD_PER_DEG).collect();
        assert!(sd.len() == 2 && (sd[0] - 0.5).abs() < 1e-6 && (sd[1] - 0.25).abs() < 1e-6, "{samples:?}");
        assert!((f64::from(samples[0].elevation_rad.1) / RAD_PER_DEG - 1.5).abs() < 1e-5, "{samples:?}");
    }

    #[test]
    fn the_start_is_that_of_the_first_bearing_whose_utc_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let (lines, table) = (dir.path().join("r.jsonl"), dir.path().join("r.csv"));
        let record =
            r#"{"type":"bearing","t_s":2.5,"utc":"2024-05-01T09:00:02.5Z","azimuth_deg":1.0,"band":0}"#;
        std::fs::write(&lines, format!("{}\n{record}\n", r#"{"type":"hello","station":1}"#)).unwrap();
        std::fs::write(&table, "type,t_s,utc\nhello,,\nbearing,2.5,2024-05-01T09:00:02.5Z\n").unwrap();
        let began = Some(time::macros::datetime!(2024-05-01 09:00:00 UTC));
        assert_eq!((start(&lines), start(&table)), (began, began));
    }

    #[test]
    fn bearings_are_read_from_records() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("records.jsonl");
        let bearing = |t_s: f64, band: u8| {
            format!(
                "{{\"type\":\"bearing\",\"t_s\":{t_s},\"azimuth_deg\":30.0,\"elevation_deg\":9.0,\
                 \"sd_azimuth_deg\":0.5,\"sd_elevation_deg\":1.5,\"band\":{band}}}\n"
            )
        };
        let cut = "{\"type\":\"bear";
        let text =
            ["{\"type\":\"hello\"}\n", &bearing(1.0, 0), &bearing(1.0, 1), &bearing(1.5, 0), cut].concat();
        std::fs::write(&path, text).unwrap();
        // What is cut off is named.
        let bad: Vec<String> = of_records(&path, false)
            .unwrap()
            .into_iter()
            .filter_map(|r| Some(r.1.err()?.to_string()))
            .collect();
        assert!(matches!(&bad[..], [one] if one.ends_with("records.jsonl, line 5: no record")), "{bad:?}");
        let samples = read(&path, 1.0, Some(1.0)).unwrap();
        assert_eq!(start(&path), None);
        let mut first = Sample::azimuth(1.0, 30.0 * RAD_PER_DEG, 0.5 * RAD_PER_DEG);
        first.elevation_rad = ((9.0 * RAD_PER_DEG) as f32, (1.5 * RAD_PER_DEG) as f32);
        assert_eq!(samples[0], first);
        assert_eq!(samples.iter().map(|s| s.t_s).collect::<Vec<_>>(), [1.0, 1.5]);
        assert!(read(&path, 1.0, None).unwrap()[0].elevation_rad.1.is_infinite());
    }
}
