//! SAC files: one component as 32-bit floating-point numbers behind a header of 632 bytes.
//!
//! Versions 6 and 7 of the header (SAC User Manual, "SAC Data File Format"), evenly sampled time series, in either order of
//! bytes. Numbers are taken for counts; those of a file in physical units would all round to nothing, and it is refused.

use super::mseed_record::code_of;
use anyhow::{Context, Result, anyhow, bail};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use time::{Date, OffsetDateTime, Time};

/// Bytes of the header.
pub(super) const HEADER: u64 = 632;

/// Where the header's version stands, bytes from the start.
pub(super) const VERSION_AT: usize = 304;

/// The order of a number's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// The least first.
    Little,
    /// The greatest first.
    Big,
}

impl Order {
    /// The order in which a header's version makes sense; `None` where the file is no SAC file.
    pub(super) fn of(version: [u8; 4]) -> Option<Self> {
        match (i32::from_le_bytes(version), i32::from_be_bytes(version)) {
            (6 | 7, _) => Some(Self::Little),
            (_, 6 | 7) => Some(Self::Big),
            _ => None,
        }
    }

    fn bits(self, b: [u8; 4]) -> u32 {
        match self {
            Self::Little => u32::from_le_bytes(b),
            Self::Big => u32::from_be_bytes(b),
        }
    }
}

/// What a header tells.
pub(super) struct About {
    /// Order of the bytes.
    pub order: Order,
    /// Network, station and location.
    pub station: String,
    /// Component.
    pub channel: String,
    /// UTC of the first sample, nanoseconds since 1970.
    pub start_ns: i128,
    /// Samples a second.
    pub rate_hz: f64,
    /// Samples.
    pub count: usize,
}

/// Reads a header.
///
/// # Errors
/// It is damaged, or the samples are none that can be used.
pub(super) fn header(path: &Path) -> Result<About> {
    let name = path.display();
    let mut file = File::open(path).with_context(|| format!("cannot read {name}"))?;
    let mut head = [0u8; HEADER as usize];
    file.read_exact(&mut head).map_err(|_| anyhow!("{name}: cut short within the SAC header"))?;
    let bytes = |at: usize| -> [u8; 4] { std::array::from_fn(|i| head[at + i]) };
    let order = Order::of(bytes(VERSION_AT)).ok_or_else(|| anyhow!("{name}: no SAC header"))?;
    let real = |word: usize| f64::from(f32::from_bits(order.bits(bytes(4 * word))));
    let whole = |word: usize| order.bits(bytes(4 * word)) as i32;
    let text = |at: usize| {
        let text = String::from_utf8_lossy(&head[at..at + 8]).trim_matches([' ', '\0']).to_owned();
        if text.starts_with("-12345") { String::new() } else { text }
    };
    if whole(85) != 1 || whole(105) != 1 {
        bail!("{name}: a SAC file, but no evenly sampled time series");
    }
    // A step of 0.02 s as a 32-bit number is 50.0000011 Hz.
    let exact = 1.0 / real(0);
    let rounded = (exact * 1000.0).round() / 1000.0;
    let rate_hz = if (exact / rounded - 1.0).abs() < 1e-6 { rounded } else { exact };
    let stated = usize::try_from(whole(79)).unwrap_or(0);
    let there = (file.metadata()?.len().saturating_sub(HEADER) / 4) as usize;
    if !(rate_hz.is_finite() && rate_hz > 0.0) || stated == 0 || there == 0 {
        bail!("{name}: a SAC header without step or samples");
    }
    if there < stated {
        super::complain(&format!("{name}: cut short: its first {there} of {stated} samples are used"));
    }
    let field = |word: usize| u8::try_from(whole(word)).unwrap_or(u8::MAX);
    let moment = || -> Option<OffsetDateTime> {
        let date = Date::from_ordinal_date(whole(70), u16::try_from(whole(71)).ok()?).ok()?;
        let milli = u16::try_from(whole(75)).ok()?;
        Some(date.with_time(Time::from_hms_milli(field(72), field(73), field(74), milli).ok()?).assume_utc())
    };
    let at = moment().ok_or_else(|| anyhow!("{name}: the SAC header tells no time"))?;
    let begins_s = if real(5) == -12345.0 { 0.0 } else { real(5) };
    // A second's worth in the middle: what is in metres a second rounds to nothing.
    let count = stated.min(there);
    file.seek(SeekFrom::Start(HEADER + 4 * (count / 2) as u64))?;
    let mut some = Vec::new();
    file.take(4 * rate_hz.ceil() as u64).read_to_end(&mut some)?;
    let values = some.as_chunks::<4>().0.iter().map(|b| f32::from_bits(order.bits(*b)));
    let largest = values.fold(0f32, |a, x| a.max(x.abs()));
    if largest > 0.0 && largest < 1.0 {
        bail!(
            "{name}: values below one ({largest:e}): counts are needed, multiply by the instrument's sensitivity"
        );
    }
    Ok(About {
        order,
        station: format!("{}.{}.{}", text(608), text(440), text(464)),
        channel: text(600),
        start_ns: at.unix_timestamp_nanos() + (begins_s * 1e9).round() as i128,
        rate_hz,
        count,
    })
}

/// Samples as codes.
pub(super) fn samples(bytes: &[u8], order: Order) -> Vec<i32> {
    bytes.as_chunks::<4>().0.iter().map(|b| code_of(f64::from(f32::from_bits(order.bits(*b))))).collect()
}
