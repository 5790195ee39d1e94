//! What is known of ships in words: a table for people, CSV and records for programs.
//!
//! Times are UTC where the recording has a clock, else counted from its first sample; ± is one standard deviation. What is not observable is a
//! dash for people, empty in CSV and `null` in records.

use super::{Doubt, Doubted, Ship};
use crate::angle::wrap_deg;
use crate::csv::CsvText;
use crate::plot::times::Times;
use crate::record::{finite, utc};
use seabearing_core::wire::Track;
use serde_json::{Value, json};
use std::fmt::Write;
use time::OffsetDateTime;

/// Names of the table's columns.
const HEADER: [&str; 12] = [
    "track",
    "heard",
    "azimuths, ranges",
    "segments",
    "closest",
    "range there",
    "azimuth",
    "heading",
    "speed",
    "tones (Hz)",
    "comb (Hz)",
    "remarks",
];

/// Tones in the table.
const TONES: usize = 8;

/// What the columns of the table mean.
pub const WORDS: &str = "One row for each track: when it was heard, by how many azimuths (in which share of the minutes) and ranges, the recorder's segments of that time; its closest point, its horizontal range, azimuth, heading and speed there, ± one standard deviation; \
     tones as radiated; the spacing of which most of them, three at least, are neighbouring multiples: a blade or shaft rate.";

impl Doubt {
    /// In a word or three.
    pub fn words(self) -> String {
        match self {
            Self::Running => "not ended".to_owned(),
            Self::NoRange => "no range".to_owned(),
            Self::LooseRange => "loose range".to_owned(),
            Self::FewRanges => "few ranges".to_owned(),
            Self::Beside(id) => format!("beside track {id}"),
            Self::SetUp => "set-up in doubt".to_owned(),
        }
    }

    /// As records tell it.
    fn name(self) -> String {
        match self {
            Self::Beside(id) => format!("beside-{id}"),
            other => other.words().replace(' ', "-"),
        }
    }
}

/// A value with its deviation to two digits, or a dash.
fn pm(value: f64, sd: f64, unit: &str) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    if !sd.is_finite() {
        return format!("{value:.1}{unit}");
    }
    let digits = if sd > 0.0 { (1.0 - sd.log10().floor()).clamp(0.0, 3.0) as usize } else { 1 };
    format!("{value:.digits$} ± {sd:.digits$}{unit}")
}

/// A ship's numbers in a person's units, with their deviations.
struct Numbers {
    range_km: (f64, f64),
    heading_deg: (f64, f64),
    speed_m_s: (f64, f64),
    azimuth_deg: f64,
}

fn numbers(t: &Track) -> Numbers {
    let seen = |x: f32| if t.range_observable { f64::from(x) } else { f64::NAN };
    let degrees = |x: f32| f64::from(x).to_degrees();
    Numbers {
        range_km: (seen(t.cpa_range_m) / 1e3, f64::from(t.sd_cpa_range_m) / 1e3),
        heading_deg: (wrap_deg(degrees(t.heading)), degrees(t.sd_heading)),
        speed_m_s: (seen(t.speed_m_s), t.sd_speed_m_s.into()),
        azimuth_deg: wrap_deg(degrees(t.cpa_azimuth)),
    }
}

/// The rows of the table, the first its header.
pub fn rows(ships: &[Ship], times: &Times) -> Vec<Vec<String>> {
    let row = |ship: &Ship| {
        let t = &ship.track;
        let n = numbers(t);
        let mut tones: Vec<f64> = ship.tones.iter().take(TONES).map(|tone| tone.hz).collect();
        tones.sort_by(f64::total_cmp);
        let tones: Vec<String> = tones.iter().map(|hz| format!("{hz:.1}")).collect();
        let doubts: Vec<String> = ship.doubts.iter().map(|d| d.words()).collect();
        let or_dash = |text: String| if text.is_empty() { "–".to_owned() } else { text };
        vec![
            t.id.to_string(),
            format!("{} to {}", times.minute(ship.heard_s.0), times.minute_after(ship.heard_s)),
            format!("{} ({:.0} %), {}", ship.azimuths, 100.0 * ship.heard_share, ship.ranges),
            or_dash(ship.segments.iter().map(u16::to_string).collect::<Vec<_>>().join(" ")),
            format!("{} ± {:.0} s", times.to_within(t.cpa_time_s, t.sd_cpa_time_s.into()), t.sd_cpa_time_s),
            pm(n.range_km.0, n.range_km.1, " km"),
            format!("{:.1}°", n.azimuth_deg),
            pm(n.heading_deg.0, n.heading_deg.1, "°"),
            pm(n.speed_m_s.0, n.speed_m_s.1, " m/s"),
            or_dash(tones.join(" ")),
            ship.comb.map_or("–".to_owned(), |comb| format!("{:.2}", comb.hz)),
            doubts.join(", "),
        ]
    };
    std::iter::once(HEADER.map(str::to_owned).to_vec()).chain(ships.iter().map(row)).collect()
}

/// What the station doubted, in lines of text.
pub fn warnings(doubted: &[Doubted], times: &Times) -> Vec<String> {
    doubted.iter().map(|d| format!("The station doubted its set-up {}.", d.words(times))).collect()
}

/// The table as text, columns below each other, what it means, and what the station doubted.
pub fn text(ships: &[Ship], doubted: &[Doubted], times: &Times, station: &str) -> String {
    let mut out = String::new();
    if ships.is_empty() {
        out.push_str("No ship was tracked.\n");
    } else {
        let rows = rows(ships, times);
        let width =
            |c: usize| rows.iter().filter_map(|r| r.get(c)).map(|s| s.chars().count()).max().unwrap_or(0);
        for row in &rows {
            let line = row.iter().enumerate().fold(String::new(), |mut line, (c, cell)| {
                let _ = write!(line, "{cell:width$}  ", width = width(c));
                line
            });
            let _ = writeln!(out, "{}", line.trim_end());
        }
        let _ = writeln!(out, "\n{WORDS}");
    }
    for line in warnings(doubted, times) {
        let _ = writeln!(out, "{line}");
    }
    let _ = writeln!(out, "{}", times.source(station));
    out
}

/// UTC of a time to a tenth of a second, where the recording has a clock.
fn utc_at(start: Option<OffsetDateTime>, t_s: f64) -> Option<String> {
    let start = start?.checked_add(time::Duration::checked_seconds_f64(t_s)?)?;
    let tenths = (f64::from(start.nanosecond()) * 1e-8).round() as i64;
    Some(utc(start.replace_nanosecond(0).ok()?.checked_add(time::Duration::milliseconds(100 * tenths))?))
}

/// The record of a ship; `start`: UTC of the first sample.
pub fn record(ship: &Ship, start: Option<OffsetDateTime>) -> Value {
    let t = &ship.track;
    let n = numbers(t);
    let or_null = |x: f64| finite((1e6 * x).round() / 1e6);
    // A deviation of what is not observable says nothing.
    let sd = |(value, sd): (f64, f64)| if value.is_finite() { or_null(sd) } else { Value::Null };
    let mut out = json!({
        "type": "ship", "track": t.id, "final": t.stage == Track::FINAL,
        "from_s": ship.heard_s.0, "to_s": ship.heard_s.1,
        "cpa_time_s": or_null(t.cpa_time_s), "sd_cpa_time_s": or_null(t.sd_cpa_time_s.into()),
        "cpa_range_m": or_null(1e3 * n.range_km.0), "sd_cpa_range_m": sd((n.range_km.0, 1e3 * n.range_km.1)),
        "cpa_azimuth_deg": or_null(n.azimuth_deg),
        "heading_deg": or_null(n.heading_deg.0), "sd_heading_deg": sd(n.heading_deg),
        "speed_m_s": or_null(n.speed_m_s.0), "sd_speed_m_s": sd(n.speed_m_s),
        "side": if t.starboard { "starboard" } else { "port" },
        "tones_hz": ship.tones.iter().map(|tone| or_null(tone.hz)).collect::<Vec<_>>(),
        "tone_shares": ship.tones.iter().map(|tone| or_null(tone.share)).collect::<Vec<_>>(),
        "comb_hz": ship.comb.map(|comb| or_null(comb.hz)), "sd_comb_hz": ship.comb.map(|comb| or_null(comb.sd_hz)),
        "azimuths": ship.azimuths, "ranges": ship.ranges, "heard_share": or_null(ship.heard_share), "n": t.n,
        "segments": ship.segments,
        "doubts": ship.doubts.iter().map(|d| d.name()).collect::<Vec<_>>(),
    });
    let utc = [("utc_from", ship.heard_s.0), ("utc_to", ship.heard_s.1), ("utc_cpa", t.cpa_time_s)];
    for (key, t_s) in utc {
        if let (Some(text), Some(object)) = (utc_at(start, t_s), out.as_object_mut()) {
            object.insert(key.to_owned(), text.into());
        }
    }
    out
}

/// Columns of the CSV: keys of the record.
const COLUMNS: [&str; 25] = [
    "track",
    "final",
    "utc_from",
    "utc_to",
    "utc_cpa",
    "from_s",
    "to_s",
    "cpa_time_s",
    "sd_cpa_time_s",
    "cpa_range_m",
    "sd_cpa_range_m",
    "cpa_azimuth_deg",
    "heading_deg",
    "sd_heading_deg",
    "speed_m_s",
    "sd_speed_m_s",
    "side",
    "tones_hz",
    "comb_hz",
    "azimuths",
    "ranges",
    "heard_share",
    "segments",
    "doubts",
    "sd_comb_hz",
];

/// All ships as CSV, a row each; lists have blanks between their members.
pub fn csv(ships: &[Ship], start: Option<OffsetDateTime>) -> String {
    fn cell(value: Option<&Value>) -> String {
        match value {
            None | Some(Value::Null) => String::new(),
            Some(Value::String(text)) => text.clone(),
            Some(Value::Array(all)) => all.iter().map(|v| cell(Some(v))).collect::<Vec<_>>().join(" "),
            Some(other) => other.to_string(),
        }
    }
    let mut out = CsvText::new(&COLUMNS.join(","));
    for ship in ships {
        let record = record(ship, start);
        let cells = COLUMNS.map(|key| cell(record.get(key)));
        let cells: Vec<&dyn std::fmt::Display> = cells.iter().map(|c| c as &dyn std::fmt::Display).collect();
        out.row(&cells);
    }
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::super::{Comb, ShipTone};
    use super::*;
    use crate::csv::CsvTable;
    use crate::plot::heard::tests::track;
    use seabearing_core::wire::{Fault, FaultCode};

    fn ship(range_observable: bool) -> Ship {
        let mut track = track(3, Track::FINAL, 7200.0, (3600.0, 12_345.0));
        (track.range_observable, track.sd_speed_m_s, track.sd_cpa_range_m) = (range_observable, 0.024, 41.0);
        Ship {
            track,
            heard_s: (600.0, 90_600.0),
            azimuths: 90,
            heard_share: 0.9,
            ranges: 70,
            segments: vec![2, 5],
            tones: vec![ShipTone { hz: 16.2, share: 0.8 }, ShipTone { hz: 10.8, share: 0.7 }],
            comb: Some(Comb { hz: 5.4, sd_hz: 0.0012 }),
            doubts: vec![Doubt::Beside(4), Doubt::SetUp],
        }
    }

    #[test]
    fn a_ship_is_told_alike_as_text_csv_and_record() {
        let start = OffsetDateTime::from_unix_timestamp(1_369_094_400).ok();
        let times = Times::new(start, 90_000.0);
        let (ships, bare) = ([ship(true), ship(false)], [ship(false)]);
        let fault = Fault { code: FaultCode::Exchanged, index: 0, value: 1 };
        let doubted = [Doubted { fault, from_s: 3600.0, to_s: Some(7200.0) }];
        let text = text(&ships, &doubted, &times, "RR03");
        for words in [
            "21 May 00:10 to 22 May 01:10",
            "21 May 01:00:00 ± 0 s",
            "12.345 ± 0.041 km",
            "90.00 ± 0.57°",
            "7.000 ± 0.024 m/s",
            "10.8 16.2",
            "90 (90 %), 70",
            "2 5",
            "5.40",
            "beside track 4, set-up in doubt",
            "The station doubted its set-up 21 May 01:00 to 02:00, Exchanged: the vertical component and north",
            "Data: station RR03, recorded from 2013-05-21",
        ] {
            assert!(text.contains(words), "{words}\n{text}");
        }
        let lines: Vec<&str> = text.lines().collect();
        let place = |line: &str| line.split("set-up").next().map(|l| l.chars().count());
        assert_eq!(place(lines[1]), place(lines[2]), "{text}");
        let table = CsvTable::parse(&csv(&ships, start), "ships.csv").unwrap();
        let at = |row, column| table.text(row, table.column(column).unwrap()).unwrap();
        assert_eq!(
            (at(0, "utc_cpa"), at(0, "cpa_range_m"), at(1, "cpa_range_m")),
            ("2013-05-21T01:00:00Z", "12345.0", "")
        );
        assert_eq!((at(0, "comb_hz"), at(0, "sd_comb_hz")), ("5.4", "0.0012"));
        assert_eq!(
            (at(0, "tones_hz"), at(0, "segments"), at(0, "doubts")),
            ("16.2 10.8", "2 5", "beside-4 set-up-in-doubt")
        );
        let record = record(&bare[0], None);
        assert!(
            record["speed_m_s"].is_null()
                && record["sd_cpa_range_m"].is_null()
                && record.get("utc_cpa").is_none()
        );
        assert!(super::text(&[], &[], &times, "").starts_with("No ship was tracked."));
    }
}
