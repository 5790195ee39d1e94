//! One miniSEED record: checked before it is decoded, whatever its header's byte order.
//!
//! Decoding (Steim-1 and -2, integers, floats, versions 2 and 3) is `miniseed-rs`'s. It expects headers in big-endian
//! order and trusts offsets, so version 2 headers are checked here first and turned where they are little-endian; the
//! time correction that a header may carry but not have applied is applied.

use anyhow::{Result, anyhow, bail};
use miniseed_rs::{MseedRecord, NanoTime, Samples, decode};
use seabearing_core::block::MISSING;
use time::{Date, OffsetDateTime, Time};

/// A decoded record.
pub(super) struct Record {
    /// Network, station and location, for messages.
    pub station: String,
    /// Channel code.
    pub channel: String,
    /// UTC of the first sample, nanoseconds since 1970.
    pub start_ns: i128,
    /// Samples a second.
    pub rate_hz: f64,
    /// The samples as codes; [`MISSING`] where a float was none.
    pub samples: Vec<i32>,
    /// Bytes in the file.
    pub bytes: usize,
}

/// Bytes of the fixed header.
const HEADER: usize = 48;

/// Reads the record at the start of some bytes.
///
/// # Errors
/// Not a record, cut, or damaged.
pub(super) fn read(data: &[u8]) -> Result<Record> {
    if data.starts_with(b"MS\x03") {
        return finish(&decode(data).map_err(|e| anyhow!("{e}"))?, 0.0);
    }
    if data.len() < HEADER + 8 {
        bail!("record cut after {} bytes", data.len());
    }
    if !data[..6].iter().all(|b| b.is_ascii_digit() || *b == b' ') || !b"DRQM".contains(&data[6]) {
        bail!("no record header");
    }
    let plausible = |year: u16| (1950..2200).contains(&year);
    let big = plausible(u16::from_be_bytes([data[20], data[21]]));
    if !big && !plausible(u16::from_le_bytes([data[20], data[21]])) {
        bail!("record header with an impossible year");
    }
    let word = |at: usize| -> usize {
        let pair = [data[at], data[at + 1]];
        usize::from(if big { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) })
    };
    // Walk the blockettes, which must lie behind one another, to the one that tells the record's length.
    let mut blockettes = Vec::new();
    let mut at = word(46);
    let mut length = None;
    while at != 0 {
        if at < HEADER || at + 8 > data.len() || blockettes.last().is_some_and(|b| *b >= at) {
            bail!("damaged blockettes");
        }
        blockettes.push(at);
        if word(at) == 1000 {
            length = 1usize.checked_shl(u32::from(data[at + 6])).filter(|n| (64..=1 << 20).contains(n));
        }
        at = word(at + 2);
    }
    let Some(length) = length else { bail!("no blockette 1000: the record does not tell its length") };
    let Some(raw) = data.get(..length) else {
        bail!("record of {length} bytes cut after {}", data.len());
    };
    if word(44) > length || (word(30) > 0 && word(44) < HEADER) {
        bail!("damaged header: data would start at byte {} of {length}", word(44));
    }
    if word(32) == 0 || word(34) == 0 {
        bail!("record without a sample rate");
    }
    if word(28) >= 10_000 {
        bail!("record header with an impossible time");
    }
    let applied = data[36] & 2 != 0;
    let quad = [data[40], data[41], data[42], data[43]];
    let correction = if big { i32::from_be_bytes(quad) } else { i32::from_le_bytes(quad) };
    let correction_s = if applied { 0.0 } else { f64::from(correction) * 1e-4 };
    let record = if big {
        decode(raw)
    } else {
        let mut turned = raw.to_vec();
        let header = [20, 22, 28, 30, 32, 34, 44, 46];
        for at in header.into_iter().chain(blockettes.into_iter().flat_map(|b| [b, b + 2])) {
            turned.swap(at, at + 1);
        }
        decode(&turned)
    };
    finish(&record.map_err(|e| anyhow!("{e}"))?, correction_s)
}

fn finish(r: &MseedRecord, correction_s: f64) -> Result<Record> {
    if !(r.sample_rate.is_finite() && r.sample_rate > 0.0) {
        bail!("record with a sample rate of {}", r.sample_rate);
    }
    let code = |x: f64| {
        if x.is_finite() { x.round().clamp(-2_147_483_647.0, 2_147_483_647.0) as i32 } else { MISSING }
    };
    let samples = match &r.samples {
        // The one code that stands for "missing" cannot be a sample.
        Samples::Int(x) => x.iter().map(|x| (*x).max(-i32::MAX)).collect(),
        Samples::Float(x) => x.iter().map(|x| code(f64::from(*x))).collect(),
        Samples::Double(x) => x.iter().map(|x| code(*x)).collect(),
    };
    Ok(Record {
        station: format!("{}.{}.{}", r.network, r.station, r.location),
        channel: r.channel.clone(),
        start_ns: nanoseconds(&r.start_time)? + (correction_s * 1e9) as i128,
        rate_hz: r.sample_rate,
        samples,
        bytes: r.record_length as usize,
    })
}

fn nanoseconds(t: &NanoTime) -> Result<i128> {
    let wrong = || anyhow!("record with an impossible time: {t}");
    let date = Date::from_ordinal_date(i32::from(t.year), t.day).map_err(|_| wrong())?;
    let clock = Time::from_hms_nano(t.hour, t.minute, t.second.min(59), t.nanosecond).map_err(|_| wrong())?;
    Ok(OffsetDateTime::new_utc(date, clock).unix_timestamp_nanos()
        + i128::from(t.second / 60) * 1_000_000_000)
}

/// The time as records write it.
pub(crate) fn nano_time(t: OffsetDateTime) -> NanoTime {
    NanoTime {
        year: t.year().clamp(0, 9999) as u16,
        day: t.ordinal(),
        hour: t.hour(),
        minute: t.minute(),
        second: t.second(),
        nanosecond: t.nanosecond(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use miniseed_rs::{ByteOrder, EncodingFormat, encode};

    fn bytes(encoding: EncodingFormat, order: ByteOrder) -> Vec<u8> {
        let mut r = MseedRecord::new()
            .with_nslc("YV", "RR03", "00", "BDH")
            .with_start_time(NanoTime {
                year: 2013,
                day: 141,
                hour: 1,
                minute: 2,
                second: 3,
                nanosecond: 40_000_000,
            })
            .with_sample_rate(50.0)
            .with_encoding(encoding)
            .with_record_length(4096)
            .with_samples(Samples::Int((0..500).map(|i| i * i - 300 * i).collect()));
        r.byte_order = order;
        encode(&r).unwrap()
    }

    fn little_header(mut b: Vec<u8>) -> Vec<u8> {
        for at in [20, 22, 28, 30, 32, 34, 44, 46, 48, 50] {
            b.swap(at, at + 1);
        }
        b
    }

    #[test]
    fn every_encoding_and_byte_order() {
        let want: Vec<i32> = (0..500).map(|i| i * i - 300 * i).collect();
        for encoding in [EncodingFormat::Steim1, EncodingFormat::Steim2, EncodingFormat::Int32] {
            for order in [ByteOrder::Big, ByteOrder::Little] {
                for data in [bytes(encoding, order), little_header(bytes(encoding, order))] {
                    let r = read(&data).unwrap();
                    assert_eq!(r.samples, want, "{encoding:?} {order:?}");
                    assert_eq!((r.rate_hz, r.bytes, r.channel.as_str()), (50.0, 4096, "BDH"));
                    assert_eq!(r.start_ns, 1_369_098_123_040_000_000);
                }
            }
        }
    }

    #[test]
    fn damage_is_an_error_and_never_worse() {
        let good = bytes(EncodingFormat::Steim2, ByteOrder::Big);
        assert!(read(&good[..100]).is_err());
        for at in 0..400 {
            for value in [0, 1, 0x30, 0x7f, 0xff] {
                let mut b = good.clone();
                b[at] = value;
                let _ = read(&b);
            }
        }
        let mut loops = good.clone();
        loops[51] = 48;
        assert!(read(&loops).is_err());
    }

    #[test]
    fn a_time_correction_is_applied_once() {
        let mut b = bytes(EncodingFormat::Int32, ByteOrder::Big);
        b[40..44].copy_from_slice(&(-5000i32).to_be_bytes());
        assert_eq!(read(&b).unwrap().start_ns, 1_369_098_122_540_000_000);
        b[36] |= 2;
        assert_eq!(read(&b).unwrap().start_ns, 1_369_098_123_040_000_000);
    }
}
