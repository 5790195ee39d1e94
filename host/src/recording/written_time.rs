//! Start times in file names, as recorders write them.
//!
//! Recognised: a date of eight digits (`20240131`; or six, `240131`, as some recorders write) and a time of six,
//! together or with one of `T`, `t`, `_`, `-`, `.` between, and a fraction after `.`: `east_20240131T120000.125Z.wav`,
//! `20240131_120000.wav`, `AMAR.20240131.120000.flac`, `5731.240131120000.wav`. Times are UTC. The last match in the
//! name counts; serial numbers come first.

use time::{Date, Month, OffsetDateTime, PrimitiveDateTime, Time};

/// A start time and how finely it was written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrittenTime {
    /// The time, UTC.
    pub at: OffsetDateTime,
    /// Its last digit, seconds.
    pub resolution_s: f64,
}

impl WrittenTime {
    /// The time in a file name.
    pub fn in_name(name: &str) -> Option<Self> {
        let bytes = name.as_bytes();
        (0..bytes.len()).rev().find_map(|at| {
            let begins = at == 0 || !bytes[at - 1].is_ascii_digit();
            if begins {
                date_and_time(&name[at..], 8).or_else(|| date_and_time(&name[at..], 6))
            } else {
                None
            }
        })
    }

    /// The time written as RFC 3339.
    pub fn parse(text: &str) -> Option<Self> {
        let at = OffsetDateTime::parse(text.trim(), &time::format_description::well_known::Rfc3339).ok()?;
        let fraction =
            text.split_once('.').map_or(0, |(_, f)| f.bytes().take_while(u8::is_ascii_digit).count());
        Some(Self { at: at.to_offset(time::UtcOffset::UTC), resolution_s: 10f64.powi(-(fraction as i32)) })
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

fn date_and_time(text: &str, digits: usize) -> Option<WrittenTime> {
    let number = |from: usize, n: usize| -> Option<i32> {
        let part = text.get(from..from + n)?;
        part.bytes().all(|b| b.is_ascii_digit()).then(|| part.parse().ok())?
    };
    let y = digits - 4;
    let year = number(0, y)? + if y == 2 { 2000 } else { 0 };
    let month = Month::try_from(u8::try_from(number(y, 2)?).ok()?).ok()?;
    let date = Date::from_calendar_date(year, month, number(y + 2, 2)? as u8).ok()?;
    if !(1950..2150).contains(&year) {
        return None;
    }
    let between = usize::from(matches!(text.as_bytes().get(digits), Some(b'T' | b't' | b'_' | b'-' | b'.')));
    let t = digits + between;
    let (h, m, s) = (number(t, 2)? as u8, number(t + 2, 2)? as u8, number(t + 4, 2)? as u8);
    let rest = text.get(t + 6..)?;
    if rest.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let fraction: String = match rest.strip_prefix('.') {
        Some(f) => f.chars().take_while(char::is_ascii_digit).take(9).collect(),
        None => String::new(),
    };
    let nano = if fraction.is_empty() { 0 } else { format!("{fraction:0<9}").parse().ok()? };
    let time = Time::from_hms_nano(h, m, s, nano).ok()?;
    Some(WrittenTime {
        at: PrimitiveDateTime::new(date, time).assume_utc(),
        resolution_s: 10f64.powi(-(fraction.len() as i32)),
    })
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
        ] {
            assert_eq!(
                WrittenTime::in_name(name),
                Some(WrittenTime { at: noon, resolution_s: 1.0 }),
                "{name}"
            );
        }
        let fine = WrittenTime::in_name("x_20240131T120000.015625Z.wav").unwrap();
        assert_eq!(fine.at, noon + time::Duration::microseconds(15_625));
        assert!((fine.resolution_s - 1e-6).abs() < 1e-12);
        for name in ["pass.wav", "part-12.wav", "20241399T250000.wav", "123456789012345.wav"] {
            assert_eq!(WrittenTime::in_name(name), None, "{name}");
        }
        assert_eq!(WrittenTime::in_name(&format!("a_{}.wav", WrittenTime::name(fine.at))), Some(fine));
        assert_eq!(WrittenTime::parse("2024-01-31T13:00:00+01:00\n").unwrap().at, noon);
    }
}
