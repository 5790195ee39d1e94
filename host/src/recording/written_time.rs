//! Start times in file names, as recorders write them.
//!
//! Recognised: a date of eight digits (`20240131`; or six, `240131`, as some recorders write) and a time of six,
//! together or with one of `T`, `t`, `_`, `-`, `.` or a blank between, and a fraction after `.`: `east_20240131T120000.125Z.wav`,
//! `20240131_120000.wav`, `AMAR.20240131.120000.flac`, `5731.240131120000.wav`; either may be parted by `-`, `_` or `.`
//! (a time by `:` as well), `2024-01-31_12-00-00.wav`. The last match in the
//! name counts; serial numbers come first. Behind `T` an offset from UTC may follow, `20240131T220000+1000`. A name that says
//! neither `Z` nor an offset is in UTC, or in the zone its reader is told.

use time::{Date, Month, OffsetDateTime, PrimitiveDateTime, Time, UtcOffset};

/// A start time and how finely it was written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrittenTime {
    /// The time, UTC.
    pub at: OffsetDateTime,
    /// Its last digit, seconds.
    pub resolution_s: f64,
}

impl WrittenTime {
    /// The time in a file name; `zone` is that of names that tell none.
    pub fn in_name(name: &str, zone: UtcOffset) -> Option<Self> {
        let bytes = name.as_bytes();
        let last = |of_year: usize, between: &[u8]| {
            (0..bytes.len()).rev().find_map(|at| {
                let begins = bytes[at].is_ascii_digit() && (at == 0 || !bytes[at - 1].is_ascii_digit());
                if begins { of_digits(&name[at..], of_year, between, zone) } else { None }
            })
        };
        // Where a year is written out, six digits are no date but a time or a serial number.
        last(4, b"-_.").or_else(|| last(2, b""))
    }

    /// The time written as RFC 3339.
    pub fn parse(text: &str) -> Option<Self> {
        let at = OffsetDateTime::parse(text.trim(), &time::format_description::well_known::Rfc3339).ok()?;
        let fraction =
            text.split_once('.').map_or(0, |(_, f)| f.bytes().take_while(u8::is_ascii_digit).count());
        Some(Self { at: at.to_offset(UtcOffset::UTC), resolution_s: 10f64.powi(-(fraction as i32)) })
    }

    /// The form [`WrittenTime::in_name`] reads, with microseconds: `20240131T120000.000000Z`.
    pub fn name(at: OffsetDateTime) -> String {
        format!(
            "{:04}{:02}{:02}T{:02}{:02}{:02}.{:06}Z",
            at.year(),
            u8::from(at.month()),
            at.day(),
            at.hour(),
            at.minute(),
            at.second(),
            at.microsecond()
        )
    }
}

/// Three numbers of so many digits, together or with one and the same of these bytes between them, and what follows.
fn three<'a>(text: &'a str, digits: [usize; 3], between: &[u8]) -> Option<([i32; 3], &'a str)> {
    let [first, ..] = digits;
    let parted = text.as_bytes().get(first).copied().filter(|b| between.contains(b));
    let mut rest = text;
    let mut out = [0; 3];
    for (i, (digits, number)) in digits.into_iter().zip(&mut out).enumerate() {
        if let (Some(by), 1..) = (parted, i) {
            rest = rest.strip_prefix(char::from(by))?;
        }
        let part = rest.get(..digits).filter(|p| p.bytes().all(|b| b.is_ascii_digit()))?;
        *number = part.parse().ok()?;
        rest = &rest[digits..];
    }
    Some((out, rest))
}

/// A date whose year has so many digits, and the time after it.
fn of_digits(text: &str, of_year: usize, between: &[u8], zone: UtcOffset) -> Option<WrittenTime> {
    let ([year, month, day], behind) = three(text, [of_year, 2, 2], between)?;
    let year = year + if of_year == 2 { 2000 } else { 0 };
    let date = Date::from_calendar_date(year, Month::try_from(month as u8).ok()?, day as u8).ok()?;
    if !(1950..2150).contains(&year) {
        return None;
    }
    let iso = behind.starts_with('T');
    let ([h, m, s], rest) =
        three(behind.strip_prefix(['T', 't', '_', '-', '.', ' ']).unwrap_or(behind), [2; 3], b"-_.:")?;
    let (h, m, s) = (h as u8, m as u8, s as u8);
    if rest.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let fraction: String = match rest.strip_prefix('.') {
        Some(f) => f.chars().take_while(char::is_ascii_digit).take(9).collect(),
        None => String::new(),
    };
    let nano = if fraction.is_empty() { 0 } else { format!("{fraction:0<9}").parse().ok()? };
    let time = Time::from_hms_nano(h, m, s, nano).ok()?;
    let behind = rest.strip_prefix('.').map_or(rest, |f| f.trim_start_matches(|c: char| c.is_ascii_digit()));
    let zone = match behind.as_bytes().first() {
        Some(b'Z' | b'z') => UtcOffset::UTC,
        // Without the `T` of ISO 8601 what follows may be a serial number.
        Some(b'+' | b'-') if iso && tells_minutes(behind) => offset(behind).unwrap_or(zone),
        _ => zone,
    };
    Some(WrittenTime {
        at: PrimitiveDateTime::new(date, time).assume_offset(zone).to_offset(UtcOffset::UTC),
        resolution_s: 10f64.powi(-(fraction.len() as i32)),
    })
}

/// Whether an offset tells its minutes: two digits alone behind a time may be a serial number.
fn tells_minutes(text: &str) -> bool {
    let digits = text.bytes().skip(1).filter(|b| *b != b':').take_while(u8::is_ascii_digit);
    digits.count() == 4
}

/// An offset from UTC at the start of a text: `+1000`, `-03:30`, `+10`. Hours up to 14, and quarters of an hour.
pub fn offset(text: &str) -> Option<UtcOffset> {
    let sign = match text.as_bytes().first()? {
        b'+' => 1,
        b'-' => -1,
        _ => return None,
    };
    let hours: i8 = text.get(1..3)?.parse().ok()?;
    let rest = text.get(3..)?;
    let minutes = rest.strip_prefix(':').unwrap_or(rest);
    let minutes = minutes.get(..2).filter(|m| m.bytes().all(|b| b.is_ascii_digit()));
    let minutes: i8 = minutes.map_or(Some(0), |m| m.parse().ok())?;
    (hours <= 14 && minutes < 60 && minutes % 15 == 0).then_some(())?;
    UtcOffset::from_hms(sign * hours, sign * minutes, 0).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::macros::datetime;

    #[test]
    fn the_names_recorders_use() {
        let noon = datetime!(2024-01-31 12:00:00 UTC);
        for name in [
            "20240131T120000Z.wav",
            "east_20240131_120000.wav",
            "AMAR123.20240131.120000.flac",
            "5731.240131120000.wav",
            "20240131120000.wav",
            "x_2024-01-31_12-00-00.wav",
            "2024-01-31T12:00:00Z.flac",
            "2024_01_31_12_00_00.wav",
            "2024-01-31 12.00.00.wav",
            "2024-01-31_120000_7.wav",
            "20240131_12-00-00.wav",
            "x_20240131_120000_123456.wav",
            "PAM_20240131_120000_101112.wav",
            "20240131T120000-01.wav",
            "2024-01-31T12-00-00-02.wav",
        ] {
            assert_eq!(
                WrittenTime::in_name(name, UtcOffset::UTC),
                Some(WrittenTime { at: noon, resolution_s: 1.0 }),
                "{name}"
            );
        }
        let fine = WrittenTime::in_name("x_20240131T120000.015625Z.wav", UtcOffset::UTC).unwrap();
        assert_eq!(fine.at, noon + time::Duration::microseconds(15_625));
        assert!((fine.resolution_s - 1e-6).abs() < 1e-12);
        let name = "Überfahrt – 20240131T120000Z é.wav";
        assert_eq!(WrittenTime::in_name(name, UtcOffset::UTC).unwrap().at, noon);
        for name in [
            "pass.wav",
            "part-12.wav",
            "20241399T250000.wav",
            "123456789012345.wav",
            "Ärmelkanal 1é2.wav",
            "2024-01_31_12-00-00.wav",
            "2024-13-31_12-00-00.wav",
            "2024-01-31_12-00.wav",
            "2024-01-31_12-00-001.wav",
        ] {
            assert_eq!(WrittenTime::in_name(name, UtcOffset::UTC), None, "{name}");
        }
        let name = format!("a_{}.wav", WrittenTime::name(fine.at));
        assert_eq!(WrittenTime::in_name(&name, UtcOffset::UTC), Some(fine));
        assert_eq!(WrittenTime::parse("2024-01-31T13:00:00+01:00\n").unwrap().at, noon);
    }
    #[test]
    fn names_in_local_time_tell_their_offset_or_are_told_it() {
        let noon = Some(datetime!(2024-01-31 12:00:00 UTC));
        let east = offset("+10:00").unwrap();
        let at = |name: &str| WrittenTime::in_name(name, east).map(|t| t.at);
        for name in [
            "20240131_220000.wav",
            "20240131T120000Z.wav",
            "20240131T220000+1000_rec.wav",
            "20240131T083000.000-0330.wav",
            "20240131_220000-0001.wav",
            "20240131_220000-0800.wav",
        ] {
            assert_eq!(at(name), noon, "{name}");
        }
        for wrong in ["10", "+1", "+15:00", "+01:07", "UTC"] {
            assert_eq!(offset(wrong), None, "{wrong}");
        }
    }
}
