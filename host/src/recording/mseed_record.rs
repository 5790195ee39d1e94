//! One miniSEED record: checked before it is decoded, whatever its header's byte order.
//!
//! Decoding (Steim-1 and -2, integers, floats, versions 2 and 3) is `miniseed-rs`'s. It expects headers in big-endian
//! order and trusts offsets, so version 2 headers are checked here first and turned where they are little-endian; the
//! time correction that a header may carry but not have applied is applied.

use anyhow::{Result, anyhow, bail};
use miniseed_rs::crc::{compute_v3_crc, verify_v3_crc};
use miniseed_rs::{NanoTime, Samples, decode};
use seabearing_core::block::MISSING;
use std::borrow::Cow;
use time::{Date, OffsetDateTime, Time};

/// What a record's header tells.
pub(super) struct Header {
    /// Network, station and location, for messages.
    pub station: String,
    /// Channel code.
    pub channel: String,
    /// UTC of the first sample, nanoseconds since 1970.
    pub start_ns: i128,
    /// Samples a second.
    pub rate_hz: f64,
    /// Number of samples.
    pub count: usize,
    /// Bytes in the file.
    pub bytes: usize,
}

/// Bytes of the fixed header, of version 3 and version 2.
const HEADER_3: usize = 40;
const HEADER: usize = 48;

/// The longest record taken, bytes.
pub(super) const LONGEST: usize = 1 << 20;

/// Most samples a byte can hold: Steim-2 packs seven differences into four.
const DENSEST: usize = 2;

/// Reads the header of the record at the start of some bytes, which hold the whole record; samples are not decoded.
///
/// # Errors
/// Not a record, cut, or damaged.
pub(super) fn header(data: &[u8]) -> Result<Header> {
    let (raw, correction_s) = checked(data)?;
    let mut raw = raw.into_owned();
    let count = if raw.starts_with(b"MS\x03") {
        if !verify_v3_crc(&raw) {
            bail!("record with a wrong checksum");
        }
        let count = u32::from_le_bytes([raw[24], raw[25], raw[26], raw[27]]) as usize;
        raw[24..28].fill(0);
        compute_v3_crc(&mut raw);
        count
    } else {
        let count = usize::from(u16::from_be_bytes([raw[30], raw[31]]));
        raw[30..32].fill(0);
        count
    };
    if count > DENSEST * raw.len() {
        bail!("record of {} bytes that claims {count} samples", raw.len());
    }
    let r = decode(&raw).map_err(|e| anyhow!("{e}"))?;
    if !(r.sample_rate.is_finite() && r.sample_rate > 0.0) {
        bail!("record with a sample rate of {}", r.sample_rate);
    }
    Ok(Header {
        station: format!("{}.{}.{}", r.network, r.station, r.location),
        channel: r.channel.clone(),
        start_ns: nanoseconds(&r.start_time)? + (correction_s * 1e9) as i128,
        rate_hz: r.sample_rate,
        count,
        bytes: raw.len(),
    })
}

/// The samples of a record as codes; [`MISSING`] where a float was none.
///
/// # Errors
/// Not a record, cut, or damaged.
pub(super) fn samples(data: &[u8]) -> Result<Vec<i32>> {
    let (raw, _) = checked(data)?;
    if let Some(x) = plain(&raw) {
        return Ok(x);
    }
    let record = decode(&raw).map_err(|e| anyhow!("{e}"))?;
    Ok(match record.samples {
        Samples::Int(mut x) => {
            x.iter_mut().for_each(|x| *x = sample(*x));
            x
        }
        Samples::Float(x) => x.iter().map(|x| code_of(f64::from(*x))).collect(),
        Samples::Double(x) => x.iter().map(|x| code_of(*x)).collect(),
    })
}

/// The one code that stands for "missing" cannot be a sample.
fn sample(x: i32) -> i32 {
    x.max(-i32::MAX)
}

/// Number of the encoding of plain 32-bit numbers, and of the blockette that tells it.
const PLAIN: u8 = 3;
const ENCODING: usize = 1000;

/// The samples of a record of version 2 that are plain 32-bit numbers, by a quicker way than all encodings; `None` of any other.
fn plain(raw: &[u8]) -> Option<Vec<i32>> {
    let word = |at: usize| Some(usize::from(u16::from_be_bytes([*raw.get(at)?, *raw.get(at + 1)?])));
    if raw.starts_with(b"MS\x03")
        || word(46)? != HEADER
        || word(HEADER)? != ENCODING
        || *raw.get(HEADER + 4)? != PLAIN
    {
        return None;
    }
    let (count, first) = (word(30)?, word(44)?);
    let (numbers, _) = raw.get(first..first + 4 * count)?.as_chunks::<4>();
    let big = *raw.get(HEADER + 5)? == 1;
    let code = |x: &[u8; 4]| sample(if big { i32::from_be_bytes(*x) } else { i32::from_le_bytes(*x) });
    Some(numbers.iter().map(code).collect())
}

/// A number of counts as a code; [`MISSING`] where it is none.
pub(super) fn code_of(x: f64) -> i32 {
    if x.is_finite() { x.round().clamp(-2_147_483_647.0, 2_147_483_647.0) as i32 } else { MISSING }
}

/// The record at the start of some bytes, its header in the order that `miniseed-rs` expects, and the seconds by which its
/// time is to be corrected.
fn checked(data: &[u8]) -> Result<(Cow<'_, [u8]>, f64)> {
    if data.starts_with(b"MS\x03") {
        let Some(head) = data.get(..HEADER_3) else { bail!("record cut after {} bytes", data.len()) };
        let extra = usize::from(u16::from_le_bytes([head[34], head[35]]));
        let payload = u32::from_le_bytes([head[36], head[37], head[38], head[39]]) as usize;
        let length = HEADER_3 + usize::from(head[33]) + extra + payload;
        if length > LONGEST {
            bail!("record of {length} bytes; at most {LONGEST} are taken");
        }
        let Some(raw) = data.get(..length) else {
            bail!("record of {length} bytes cut after {}", data.len())
        };
        return Ok((raw.into(), 0.0));
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
            length = 1usize.checked_shl(u32::from(data[at + 6])).filter(|n| (64..=LONGEST).contains(n));
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
    let mut raw = Cow::from(raw);
    if !big {
        let raw = raw.to_mut();
        let header = [20, 22, 28, 30, 32, 34, 44, 46];
        for at in header.into_iter().chain(blockettes.into_iter().flat_map(|b| [b, b + 2])) {
            raw.swap(at, at + 1);
        }
    }
    Ok((raw, correction_s))
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
    use miniseed_rs::{ByteOrder, EncodingFormat, MseedRecord, encode};

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
                    assert_eq!(samples(&data).unwrap(), want, "{encoding:?} {order:?}");
                    let r = header(&data).unwrap();
                    assert_eq!((r.rate_hz, r.count, r.bytes, r.channel.as_str()), (50.0, 500, 4096, "BDH"));
                    assert_eq!(r.start_ns, 1_369_098_123_040_000_000);
                }
            }
        }
    }

    #[test]
    fn a_record_of_version_3_is_read_and_a_wrong_checksum_refused() {
        let r = MseedRecord::new_v3()
            .with_nslc("YV", "RR03", "00", "BDH")
            .with_start_time(NanoTime { year: 2013, day: 141, hour: 1, minute: 2, second: 3, nanosecond: 0 })
            .with_sample_rate(50.002)
            .with_encoding(EncodingFormat::Int32)
            .with_samples(Samples::Int((0..500).collect()));
        let mut b = encode(&r).unwrap();
        let h = header(&b).unwrap();
        assert_eq!((h.rate_hz, h.count, h.bytes), (50.002, 500, b.len()));
        assert_eq!(samples(&b).unwrap(), (0..500).collect::<Vec<_>>());
        b[24] ^= 1;
        assert!(header(&b).is_err() && samples(&b).is_err());
    }

    #[test]
    fn damage_is_an_error_and_never_worse() {
        let good = bytes(EncodingFormat::Steim2, ByteOrder::Big);
        assert!(header(&good[..100]).is_err());
        for at in 0..400 {
            for value in [0, 1, 0x30, 0x7f, 0xff] {
                let mut b = good.clone();
                b[at] = value;
                let _ = (header(&b), samples(&b));
            }
        }
        let mut loops = good.clone();
        loops[51] = 48;
        assert!(header(&loops).is_err());
    }

    #[test]
    fn a_time_correction_is_applied_once() {
        let mut b = bytes(EncodingFormat::Int32, ByteOrder::Big);
        b[40..44].copy_from_slice(&(-5000i32).to_be_bytes());
        assert_eq!(header(&b).unwrap().start_ns, 1_369_098_122_540_000_000);
        b[36] |= 2;
        assert_eq!(header(&b).unwrap().start_ns, 1_369_098_123_040_000_000);
    }
}
