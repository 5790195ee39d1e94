//! The time in what a satellite receiver says: sentences RMC and ZDA of NMEA 0183.
//!
//! Only a sentence with a right checksum counts, of a receiver that says its position is good, and of a whole second: the
//! pulse is what it names. Sixty seconds (a leap second) and impossible dates are none. General parsers (`nmea`,
//! `nmea0183`) read far more; here two fields of two sentences are wanted, without a path to a panic.

use seabearing_core::heapless;

/// Longest sentence, `$` and the line's end not counted (NMEA 0183 allows 82 with them).
const LONGEST: usize = 80;
/// Years believed: a receiver that has miscounted its weeks (1024 of them) is 19.6 years off.
const YEARS: core::ops::RangeInclusive<i64> = 2024..=2040;

/// Collects sentences byte by byte.
#[derive(Clone, Debug)]
pub struct Sentences {
    line: heapless::Vec<u8, LONGEST>,
    inside: bool,
    /// The newest RMC said that the receiver knows no position: a ZDA beside it is from its own clock.
    void: bool,
}

impl Default for Sentences {
    fn default() -> Self {
        Self::new()
    }
}

impl Sentences {
    /// Nothing heard.
    pub const fn new() -> Self {
        Self { line: heapless::Vec::new(), inside: false, void: false }
    }

    /// Takes a byte; seconds since 1970-01-01 where it ends a sentence that tells them.
    pub fn push(&mut self, byte: u8) -> Option<i64> {
        match byte {
            b'$' => {
                self.line.clear();
                self.inside = true;
                None
            }
            b'\r' | b'\n' => {
                let whole = core::mem::replace(&mut self.inside, false);
                if whole { self.sentence() } else { None }
            }
            _ => {
                self.inside &= byte.is_ascii_graphic() && self.line.push(byte).is_ok();
                None
            }
        }
    }

    fn sentence(&mut self) -> Option<i64> {
        let body = checked(&self.line)?;
        let mut fields = body.split(|b| *b == b',');
        // Whatever satellites the talker hears: two letters before the sentence's three.
        let &[_, _, ref kind @ ..] = fields.next()? else { return None };
        let of_day = of_day(fields.next()?);
        let date = match kind {
            b"RMC" => {
                self.void = fields.next()? != b"A";
                // Position, speed and course are not wanted; the date is the ninth field.
                let date = fields.nth(6)?;
                let mode = fields.nth(2).and_then(|mode| mode.first());
                // Autonomous, differential, fixed, float, precise; not estimated, by hand or simulated.
                self.void |= mode.is_some_and(|mode| !b"ADRFP".contains(mode));
                let &[d1, d0, m1, m0, y1, y0] = date else { return None };
                (2000 + digits(&[y1, y0])?, digits(&[m1, m0])?, digits(&[d1, d0])?)
            }
            b"ZDA" => {
                let (day, month) = (digits(fields.next()?)?, digits(fields.next()?)?);
                (digits(fields.next()?)?, month, day)
            }
            _ => return None,
        };
        if self.void {
            return None;
        }
        Some(86_400 * days(date)? + of_day?)
    }
}

/// What a line says, where its checksum is right: the exclusive or of all before `*`.
fn checked(line: &[u8]) -> Option<&[u8]> {
    let (body, &[b'*', high, low]) = line.split_last_chunk::<3>()? else { return None };
    let hex = |digit: u8| char::from(digit).to_digit(16);
    let said = hex(high)? << 4 | hex(low)?;
    let sum = body.iter().fold(0, |sum, byte| sum ^ byte);
    (u32::from(sum) == said).then_some(body)
}

/// A number of at most four digits, and nothing else.
fn digits(text: &[u8]) -> Option<i64> {
    let fits = (1..=4).contains(&text.len()) && text.iter().all(u8::is_ascii_digit);
    fits.then(|| text.iter().fold(0, |n, digit| 10 * n + i64::from(digit - b'0')))
}

/// Seconds of the day of `hhmmss` or `hhmmss.000`.
fn of_day(text: &[u8]) -> Option<i64> {
    let (clock, fraction) = text.split_at_checked(6)?;
    let whole = match fraction {
        [] => true,
        [b'.', rest @ ..] => rest.iter().all(|digit| *digit == b'0'),
        _ => false,
    };
    let &[h1, h0, m1, m0, s1, s0] = clock else { return None };
    let (hour, minute, second) = (digits(&[h1, h0])?, digits(&[m1, m0])?, digits(&[s1, s0])?);
    (whole && hour < 24 && minute < 60 && second < 60).then_some(3600 * hour + 60 * minute + second)
}

/// Days since 1970-01-01 of a date that there is.
fn days((year, month, day): (i64, i64, i64)) -> Option<i64> {
    let leap = i64::from(year % 4 == 0 && (year % 100 != 0 || year % 400 == 0));
    let length = match month {
        2 => 28 + leap,
        4 | 6 | 9 | 11 => 30,
        1..=12 => 31,
        _ => return None,
    };
    if !YEARS.contains(&year) || !(1..=length).contains(&day) {
        return None;
    }
    // Months counted from March, so that the leap day is the year's last.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let of_year = (153 * month + 2) / 5 + day - 1;
    Some(365 * year + year / 4 - year / 100 + year / 400 + of_year - 719_468)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::string::String;

    /// A sentence with its checksum.
    fn sentence(body: &str) -> String {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\r\n")
    }

    fn hear(sentences: &mut Sentences, text: &[u8]) -> std::vec::Vec<i64> {
        text.iter().filter_map(|byte| sentences.push(*byte)).collect()
    }

    fn alone(body: &str) -> Option<i64> {
        hear(&mut Sentences::new(), sentence(body).as_bytes()).first().copied()
    }

    #[test]
    fn rmc_and_zda_tell_the_same_second() {
        // date -u -d '2026-09-21 14:13:20' +%s
        const SECOND: i64 = 1_790_000_000;
        for body in [
            "GPRMC,141320.00,A,4902.4,N,12319.2,W,0.0,0.0,210926,,,A",
            "GNRMC,141320,A,4902.4,N,12319.2,W,0.0,,210926,,,D,V",
            "GPRMC,141320.000,A,,,,,,,210926,,",
            "GPZDA,141320.00,21,09,2026,00,00",
        ] {
            assert_eq!(alone(body), Some(SECOND), "{body}");
        }
        assert_eq!(alone("GPZDA,000000,29,02,2028,00,00"), Some(1_835_395_200));
        assert_eq!(alone("GPZDA,235959,31,12,2026,00,00"), Some(1_798_761_599));
    }

    #[test]
    fn what_tells_no_good_whole_second_is_none() {
        for body in [
            "GPRMC,141320.50,A,,,,,,,210926,,",
            "GPRMC,141360,A,,,,,,,210926,,",
            "GPRMC,241320,A,,,,,,,210926,,",
            "GPRMC,141320,V,,,,,,,210926,,",
            "GPRMC,141320,A,,,,,,,210926,,,E",
            "GPRMC,141320,A,,,,,,,310926,,",
            "GPRMC,141320,A,,,,,,,290227,,",
            "GPRMC,141320,A,,,,,,,210906,,",
            "GPRMC,141320,A,,,,,,,,,",
            "GPRMC,,A,,,,,,,210926,,",
            "GPRMC,+41320,A,,,,,,,210926,,",
            "GPZDA,141320,21,09,20266,00,00",
            "GPZDA,141320,21,09",
            "GPGGA,141320,4902.4,N,12319.2,W,1,8,1.0,0.0,M,,,,",
            "RMC",
            "",
        ] {
            assert_eq!(alone(body), None, "{body}");
        }
        // A date beside a void position is from the receiver's own clock, until there is a position again.
        let mut sentences = Sentences::new();
        let zda = sentence("GPZDA,141320.00,21,09,2026,00,00");
        let void = sentence("GPRMC,141320,V,,,,,,,210926,,");
        let good = sentence("GPRMC,141321,A,,,,,,,210926,,");
        assert_eq!(hear(&mut sentences, format!("{void}{zda}{good}{zda}").as_bytes()).len(), 2);
    }

    #[test]
    fn no_damaged_sentence_tells_another_second() {
        let good = sentence("GPRMC,141320.00,A,4902.4,N,12319.2,W,0.0,0.0,210926,,,A");
        for at in 0..good.len() {
            for bit in 0..8 {
                let mut bytes = good.clone().into_bytes();
                bytes[at] ^= 1 << bit;
                let told = hear(&mut Sentences::new(), &bytes);
                assert!(told.iter().all(|second| *second == 1_790_000_000), "{at} {bit}: {told:?}");
            }
        }
        // Noise for as long as it likes, then a good one.
        let mut sentences = Sentences::new();
        let noise: std::vec::Vec<u8> =
            (0..100_000u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        assert_eq!(hear(&mut sentences, &noise), []);
        assert_eq!(hear(&mut sentences, good.as_bytes()), [1_790_000_000]);
    }
}
