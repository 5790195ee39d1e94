//! Vessel reports from AIS files, and the passes of vessels by a point that they contain.
//!
//! Three layouts are known by their headers: MarineTraffic exports (`MMSI,STATUS,SPEED,...`, speed in tenths of a
//! knot), CLS exports (`mmsi;source;locDate;...`, knots) and plain ones (`Time,MMSI,Latitude_degrees,...`, knots).

use crate::course::{Fix, nearest};
use crate::csv::shown;
use crate::geodesy::LocalFrame;
use anyhow::{Context, Result, anyhow, bail};
use lzma_rust2::XzReader;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;
use time::format_description::well_known::Rfc3339;
use time::macros::format_description;
use time::{Date, OffsetDateTime, PrimitiveDateTime, Time};

/// Metres a second in a knot.
const KNOT_M_S: f64 = 1852.0 / 3600.0;
/// Faster than any vessel, m/s: a leg that needs more joins wrong positions.
pub const IMPOSSIBLE_M_S: f64 = 30.0;

/// Longest text of a packed file, bytes: some four million reports, more than a year about one station.
const LONGEST: u64 = 256 << 20;
/// Memory for unpacking, KiB: twice the dictionary of `xz -9`.
const DICTIONARY_KIB: u32 = 128 << 10;

/// How times are written.
const TIME: &str = "UTC like 2024-05-01 09:00:00 or 2024-05-01T09:00:00Z";
const TIME_PARTS: &str = "a date like 05/12/2012 and a time like 19:32:09";

/// One position report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AisReport {
    /// Vessel's number.
    pub mmsi: u64,
    /// Seconds since 1970 UTC.
    pub t_s: f64,
    /// Latitude and longitude, degrees.
    pub lat_lon_deg: (f64, f64),
    /// Speed over ground, m/s, where given.
    pub speed_m_s: Option<f64>,
    /// Navigational status, where given: 0 is under way by engine.
    pub status: Option<u8>,
    /// Type of ship and cargo, where given: 70 to 89 are merchant vessels.
    pub ship_type: Option<u8>,
    /// Whether a receiver on land heard it, where given.
    pub terrestrial: Option<bool>,
    /// Length of the vessel, m, where given.
    pub length_m: Option<f64>,
}

/// One vessel going by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pass {
    /// Vessel's number.
    pub mmsi: u64,
    /// Time of the closest point, seconds since 1970 UTC.
    pub t_s: f64,
    /// Distance there, m.
    pub cpa_m: f64,
    /// Speed there, m/s.
    pub speed_m_s: f64,
    /// Heading there, degrees.
    pub heading_deg: f64,
}

/// Which passes count.
#[derive(Clone, Copy, Debug)]
pub struct Selection {
    /// Latitude and longitude of the point, degrees.
    pub lat_lon_deg: (f64, f64),
    /// Farthest closest point, m.
    pub max_range_m: f64,
    /// Least speed, m/s: moored and drifting vessels are no passes.
    pub min_speed_m_s: f64,
    /// Longest gap between reports that a straight leg may bridge, s.
    pub max_gap_s: f64,
}

/// Reads a file, packed with xz or not. Rows that cannot be read are counted, the first ones named by line.
///
/// # Errors
/// The file cannot be read, its layout is unknown, or no row is good.
pub fn read(path: &Path) -> Result<(Vec<AisReport>, Vec<String>)> {
    parse(&text(path)?, &path.display().to_string())
}

/// The text of a file, unpacked where it is packed with xz.
///
/// # Errors
/// The file cannot be read, is damaged, or holds no text.
pub fn text(path: &Path) -> Result<String> {
    let name = path.display();
    let mut bytes = std::fs::read(path).with_context(|| format!("cannot read {name}"))?;
    if bytes.starts_with(&[0xfd, b'7', b'z', b'X', b'Z', 0]) {
        bytes = unpacked(&bytes, LONGEST).with_context(|| name.to_string())?;
    }
    if bytes.contains(&0) {
        bail!("{name}: not a text file");
    }
    // Vessels' names may be in any single-byte code; what is read of a file is not.
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Unpacks xz to at most so many bytes.
fn unpacked(packed: &[u8], longest: u64) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let reader = XzReader::new_mem_limit(packed, true, DICTIONARY_KIB);
    reader.take(longest + 1).read_to_end(&mut out).map_err(|e| anyhow!("damaged xz file: {e}"))?;
    if out.len() as u64 > longest {
        bail!("unpacks to more than {} MiB: split it by time or place", longest >> 20);
    }
    Ok(out)
}

/// Parses text; `name` stands in messages.
///
/// # Errors
/// As [`read`].
pub fn parse(text: &str, name: &str) -> Result<(Vec<AisReport>, Vec<String>)> {
    let header = text.trim_start_matches('\u{feff}').lines().next().unwrap_or_default();
    let delimiter = if header.contains(';') { b';' } else { b',' };
    let mark = char::from(delimiter).to_string();
    // Names of vessels hold whatever their crews typed: a quotation mark there means nothing.
    let mut reader = ::csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .quoting(false)
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(text.as_bytes());
    let titles: Vec<String> = reader.headers()?.iter().map(str::to_owned).collect();
    let columns: Vec<String> = titles.iter().map(|title| title.to_lowercase()).collect();
    let find = |names: &[&str]| columns.iter().position(|c| names.contains(&c.as_str()));
    let (Some(mmsi), Some(lat), Some(lon)) =
        (find(&["mmsi"]), find(&["lat", "latitude_degrees"]), find(&["lon", "longitude_degrees"]))
    else {
        bail!(
            "{name}: unknown AIS layout; columns for MMSI, latitude and longitude are needed, the header is `{}`",
            shown(header)
        );
    };
    // What lies above stands for "not available" or "beyond the scale".
    let (knots, scale, most) = match find(&["sog", "sog_knots"]) {
        Some(i) => (Some(i), KNOT_M_S, 102.1),
        None => (find(&["speed"]), 0.1 * KNOT_M_S, 1021.0),
    };
    // Of one provider's files alone it is known; a speed in knots is written the same.
    if knots.is_some() && scale < KNOT_M_S && find(&["timestamp utc"]).is_none() {
        log::warn!("{name}: column `speed` is taken for tenths of a knot; call it `sog` if it is in knots");
    }
    let (status, ship_type) = (find(&["status", "navigationstatus"]), find(&["aisshiptype"]));
    let (receiver, length) = (find(&["station"]), find(&["shiplength", "length_m"]));
    let whole = find(&["time", "timestamp utc", "timestamp", "basedatetime"]);
    let parts = find(&["locdate"]).zip(find(&["loctime"]));
    if whole.is_none() && parts.is_none() {
        bail!(
            "{name}: unknown AIS layout; a column for the time is needed (`time`, `timestamp`, `timestamp utc` or `basedatetime`, or `locdate` \
             and `loctime`), the header is `{}`",
            shown(header)
        );
    }
    let (mut reports, mut bad, mut first) = (Vec::new(), Vec::new(), None);
    for record in reader.records() {
        let record = record.with_context(|| format!("{name}: unreadable"))?;
        let cells: Vec<&str> = record.iter().collect();
        let cell = |k: usize| cells.get(k).copied().unwrap_or("");
        let number = |k: usize, lo: f64, hi: f64| -> Option<f64> {
            cell(k).parse::<f64>().ok().filter(|x| (lo..=hi).contains(x))
        };
        // Where a row is wrong, and what was expected there.
        let report = (|| {
            let t_s = match (whole, parts) {
                (Some(k), _) => seconds(cell(k)).ok_or((k, TIME)),
                (_, Some((d, t))) => seconds_of_parts(cell(d), cell(t)).ok_or((d, TIME_PARTS)),
                _ => Err((0, TIME)),
            };
            Ok(AisReport {
                mmsi: cell(mmsi).parse().map_err(|_| (mmsi, "a vessel's number"))?,
                t_s: t_s?,
                lat_lon_deg: (
                    number(lat, -90.0, 90.0).ok_or((lat, "degrees, -90 to 90"))?,
                    number(lon, -180.0, 360.0).ok_or((lon, "degrees, -180 to 360"))?,
                ),
                speed_m_s: knots.and_then(|k| number(k, 0.0, most)).map(|v| v * scale),
                status: status.and_then(|k| cell(k).parse().ok()),
                ship_type: ship_type.and_then(|k| cell(k).parse().ok()),
                terrestrial: receiver.map(|k| cell(k) == "TER"),
                // 0 is "not available".
                length_m: length.and_then(|k| number(k, 1.0, 1022.0)),
            })
        })();
        match report {
            Ok(r) => reports.push(r),
            Err((column, expected)) => {
                let (line, text) = (record.position().map_or(0, |p| p.line()), cells.join(&mark));
                let title = titles.get(column).map_or("", String::as_str);
                first.get_or_insert_with(|| {
                    format!(
                        "line {line}, column `{title}`: {expected} expected, there is `{}`",
                        shown(cell(column))
                    )
                });
                bad.push(format!("{name}, line {line}: no MMSI, time or position in `{text}`"));
            }
        }
    }
    if reports.is_empty() {
        let first = first.map_or(String::new(), |first| format!("; {first}"));
        bail!("{name}: no usable report in {} rows{first}", bad.len());
    }
    Ok((reports, bad))
}

/// `2012-10-29 00:04` with optional seconds, or RFC 3339.
fn seconds(text: &str) -> Option<f64> {
    if let Ok(at) = OffsetDateTime::parse(text, &Rfc3339) {
        return Some(at.unix_timestamp() as f64 + f64::from(at.nanosecond()) * 1e-9);
    }
    let long = format_description!("[year]-[month]-[day] [hour]:[minute]:[second]");
    let short = format_description!("[year]-[month]-[day] [hour]:[minute]");
    let text = text.replace('T', " ");
    let (head, fraction) = text.split_once('.').unwrap_or((&text, "0"));
    let at =
        PrimitiveDateTime::parse(head, &long).or_else(|_| PrimitiveDateTime::parse(head, &short)).ok()?;
    let part: f64 = format!("0.{}", fraction.trim_end_matches('Z')).parse().ok()?;
    Some(at.assume_utc().unix_timestamp() as f64 + part)
}

/// `05/12/2012` and `19:32:09`.
fn seconds_of_parts(date: &str, clock: &str) -> Option<f64> {
    let date = Date::parse(date, &format_description!("[day]/[month]/[year]")).ok()?;
    let clock = Time::parse(clock, &format_description!("[hour]:[minute]:[second]")).ok()?;
    Some(PrimitiveDateTime::new(date, clock).assume_utc().unix_timestamp() as f64)
}

/// Every vessel's fixes about a point (latitude, longitude in degrees) with the speeds it reported (m/s), in order of time; of
/// those at one time the first.
pub fn tracks(reports: &[AisReport], lat_lon_deg: (f64, f64)) -> BTreeMap<u64, Vec<(Fix, Option<f64>)>> {
    let frame = LocalFrame::new(lat_lon_deg.0, lat_lon_deg.1);
    let mut vessels: BTreeMap<u64, Vec<(Fix, Option<f64>)>> = BTreeMap::new();
    for r in reports {
        let fix = (r.t_s, frame.east_north_m(r.lat_lon_deg.0, r.lat_lon_deg.1));
        vessels.entry(r.mmsi).or_default().push((fix, r.speed_m_s));
    }
    for track in vessels.values_mut() {
        track.sort_by(|(a, _), (b, _)| a.0.total_cmp(&b.0));
        track.dedup_by_key(|(fix, _)| fix.0);
    }
    vessels
}

/// The passes in the reports, in order of vessel and time. A pass is one stretch of legs within the range whose
/// closest point lies inside it.
pub fn passes(reports: &[AisReport], selection: &Selection) -> Vec<Pass> {
    let mut out = Vec::new();
    for (mmsi, track) in tracks(reports, selection.lat_lon_deg) {
        // The nearest point of the current stretch, whether a later leg has moved away from it, and whether the
        // stretch began with a leg that came nearer.
        let mut held: Option<Pass> = None;
        let mut last_interior = false;
        let mut flush = |held: &mut Option<Pass>, interior: bool| {
            if let Some(p) = held.take()
                && interior
                && p.speed_m_s >= selection.min_speed_m_s
            {
                out.push(p);
            }
        };
        for pair in track.windows(2) {
            let [((ta, a), speed_a), ((tb, b), speed_b)] = *pair else { continue };
            let (dx, dy, dt) = (b.0 - a.0, b.1 - a.1, tb - ta);
            let (f, cpa_m) = nearest(a, b);
            let wrong = dt > selection.max_gap_s || dx.hypot(dy) > IMPOSSIBLE_M_S * dt;
            if wrong || cpa_m > selection.max_range_m {
                flush(&mut held, last_interior);
                continue;
            }
            let speed_m_s = match (speed_a, speed_b) {
                (Some(u), Some(v)) => u + f * (v - u),
                (Some(u), None) | (None, Some(u)) => u,
                (None, None) => dx.hypot(dy) / dt,
            };
            let heading_deg = crate::angle::azimuth_deg(dx, dy);
            let pass = Pass { mmsi, t_s: ta + f * dt, cpa_m, speed_m_s, heading_deg };
            match &held {
                None => {
                    held = Some(pass);
                    last_interior = f > 0.0 && f < 1.0;
                }
                Some(p) if cpa_m < p.cpa_m => {
                    held = Some(pass);
                    last_interior = f < 1.0;
                }
                // Moving away again: the nearest point lay at the end of the leg before.
                Some(_) => last_interior = true,
            }
        }
        flush(&mut held, last_interior);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Selection =
        Selection { lat_lon_deg: (50.0, -1.0), max_range_m: 3000.0, min_speed_m_s: 1.0, max_gap_s: 600.0 };

    #[test]
    fn layouts_agree() {
        let plain = "Time,MMSI,Latitude_degrees,Longitude_degrees,COG_degrees,SOG_knots\n\
            2012-12-05 19:32:09.500,7,50.01,-1.0,180,10\n";
        let cls = "mmsi;source;locDate;locTime;lon;lat;sog\n7;ASS;05/12/2012;19:32:09;-1.0;50.01;10\n";
        let marine = "MMSI,STATUS,SPEED,COURSE,HEADING,LAT,LON,TIMESTAMP UTC,STATION\n\
            7,0,100,180,180,50.01,-1.0,2012-12-05 19:32,TER\nx,,,\n";
        let all: Vec<_> = [plain, cls, marine].iter().map(|t| parse(t, "x").unwrap()).collect();
        for (r, _) in &all {
            assert_eq!((r[0].mmsi, r[0].lat_lon_deg), (7, (50.01, -1.0)));
            assert!(
                (r[0].speed_m_s.unwrap() - 5.1444).abs() < 1e-3 && (r[0].t_s - 1_354_735_929.0).abs() < 10.0
            );
        }
        // The columns of the United States' files.
        let us = "MMSI,BaseDateTime,LAT,LON,SOG\n7,2012-12-05T19:32:09,50.01,-1.0,10\n";
        assert_eq!(parse(us, "x").unwrap().0[0], AisReport { t_s: all[1].0[0].t_s, ..all[1].0[0] });
        let said = parse("MMSI,when,LAT,LON\n7,1,50.0,-1.0\n", "x").unwrap_err().to_string();
        assert!(said.contains("`basedatetime`") && said.lines().count() == 1, "{said}");
        assert_eq!(all[2].1, ["x, line 3: no MMSI, time or position in `x,,,`"]);
        assert!(parse("a,b\n1,2\n", "x").is_err());
    }

    #[test]
    fn times_of_rfc_3339_are_read_and_a_file_without_any_report_says_where_and_what_was_expected() {
        let file = |time: &str| format!("mmsi,Time,lat,lon\n7,{time},50.0,-1.0\n");
        for time in
            ["2024-05-01T09:00:00Z", "2024-05-01T11:00:00+02:00", "2024-05-01 09:00:00", "2024-05-01T09:00"]
        {
            assert_eq!(parse(&file(time), "x").unwrap().0[0].t_s, 1_714_554_000.0, "{time}");
        }
        assert_eq!(parse(&file("2024-05-01T09:00:00.25Z"), "x").unwrap().0[0].t_s, 1_714_554_000.25);
        let wrong = |text: &str| parse(text, "x").unwrap_err().to_string();
        assert_eq!(
            wrong(&file("noon")),
            "x: no usable report in 1 rows; line 2, column `Time`: UTC like 2024-05-01 09:00:00 or 2024-05-01T09:00:00Z \
             expected, there is `noon`"
        );
        let south = wrong("mmsi,time,lat,lon\n7,2024-05-01 09:00,91,0\n");
        assert!(
            south.ends_with("line 2, column `lat`: degrees, -90 to 90 expected, there is `91`"),
            "{south}"
        );
        assert_eq!(wrong("mmsi,time,lat,lon\n"), "x: no usable report in 0 rows");
    }

    fn packed(bytes: &[u8]) -> Vec<u8> {
        let mut writer =
            lzma_rust2::XzWriter::new(Vec::new(), lzma_rust2::XzOptions::with_preset(1)).unwrap();
        std::io::Write::write_all(&mut writer, bytes).unwrap();
        writer.finish().unwrap()
    }

    #[test]
    fn what_unpacks_without_end_is_refused_before_it_is_held() {
        let bomb = packed(&vec![b'7'; 3 << 20]);
        assert!(bomb.len() < 1 << 12, "{}", bomb.len());
        assert_eq!(unpacked(&bomb, 3 << 20).unwrap().len(), 3 << 20);
        let e = unpacked(&bomb, 2 << 20).unwrap_err().to_string();
        assert_eq!(e, "unpacks to more than 2 MiB: split it by time or place");
    }

    #[test]
    fn speeds_that_are_not_available_are_none() {
        // Code 1023 of the message is "not available", 1022 "102.2 knots or more": neither is a speed.
        let speed = |header: &str, value: &str| {
            let text = format!("MMSI,LAT,LON,TIMESTAMP UTC,{header}\n7,50.0,-1.0,2012-12-05 19:32,{value}\n");
            parse(&text, "x").unwrap().0[0].speed_m_s
        };
        for value in ["102.3", "102.2", "1023", ""] {
            assert_eq!(speed("SOG", value), None, "{value} knots");
        }
        assert_eq!(speed("SPEED", "1023"), None);
        assert_eq!(speed("SPEED", "1022"), None);
        assert!((speed("SOG", "102.1").unwrap() - 52.525).abs() < 0.01);
        assert!((speed("SPEED", "123").unwrap() - 6.328).abs() < 0.01);
    }

    #[test]
    fn a_packed_file_reads_as_the_plain_one_and_a_damaged_one_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let plain = "mmsi;source;locDate;locTime;lon;lat;sog\n7;ASS;05/12/2012;19:32:09;-1.0;50.01;10\n";
        let packed = packed(plain.as_bytes());
        let path = dir.path().join("traffic.csv.xz");
        std::fs::write(&path, &packed).unwrap();
        assert_eq!(read(&path).unwrap(), parse(plain, "x").unwrap());
        std::fs::write(&path, &packed[..packed.len() - 9]).unwrap();
        assert!(format!("{:#}", read(&path).unwrap_err()).contains("traffic.csv.xz: damaged xz file"));
        std::fs::write(&path, b"RIFF\0\0\0\0WAVE").unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("not a text file"));
    }

    #[test]
    fn a_pass_is_found_where_it_is_nearest() {
        // Due south along a meridian 1000 m to the east, a report every 60 s at 10 m/s.
        let frame = LocalFrame::new(50.0, -1.0);
        let reports: Vec<_> = (-7..=7)
            .map(|k| AisReport {
                mmsi: 1,
                t_s: 60.0 * f64::from(k) + 20.0,
                lat_lon_deg: frame.lat_lon_deg(1000.0, -600.0 * f64::from(k)),
                speed_m_s: None,
                status: None,
                ship_type: None,
                terrestrial: None,
                length_m: None,
            })
            .collect();
        let found = passes(&reports, &HERE);
        assert_eq!(found.len(), 1);
        assert!((found[0].cpa_m - 1000.0).abs() < 1.0 && (found[0].speed_m_s - 10.0).abs() < 0.01);
        assert!((found[0].t_s - 20.0).abs() < 0.1 && (found[0].heading_deg - 180.0).abs() < 0.1, "{found:?}");
        // Half a pass is none; a moored vessel is none.
        assert!(passes(&reports[..6], &HERE).is_empty());
        let moored: Vec<_> =
            reports.iter().map(|r| AisReport { lat_lon_deg: (50.001, -1.0), ..*r }).collect();
        assert!(passes(&moored, &HERE).is_empty());
    }
}
