//! Writing recordings: four-channel WAV, 24-bit or floating point, atomically.

use anyhow::{Context, Result, bail};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use std::path::Path;

/// How samples are stored.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// 24-bit integers.
    Int24,
    /// 32-bit floating point, full scale ±1; [`MISSING`] becomes NaN.
    Float,
}

/// Writes codes of so many channels, instant after instant, as a WAV file: of 24 bits, of 32 where one of them needs that; a
/// missing one as zero.
///
/// # Errors
/// The file cannot be written.
pub fn codes(path: &Path, rate_hz: u32, channels: u16, codes: &[Option<i32>]) -> Result<()> {
    let short = codes.iter().flatten().all(|code| (-(1 << 23)..1 << 23).contains(code));
    let bits_per_sample = if short { 24 } else { 32 };
    let sample_format = hound::SampleFormat::Int;
    let spec = hound::WavSpec { channels, sample_rate: rate_hz, bits_per_sample, sample_format };
    crate::atomic::write_with(path, |out| {
        let cannot = || format!("cannot write {}", path.display());
        let mut writer = hound::WavWriter::new(out, spec).with_context(cannot)?;
        for code in codes {
            writer.write_sample(code.unwrap_or(0)).with_context(cannot)?;
        }
        writer.finalize().with_context(cannot)
    })
}

/// Writes 24-bit codes as a WAV file. 24-bit files cannot say [`MISSING`]: it is written as zero.
///
/// # Errors
/// The file cannot be written, or would be larger than a WAV file may be (4 GiB).
pub fn wav(path: &Path, rate_hz: u32, encoding: Encoding, frames: impl Iterator<Item = Frame>) -> Result<()> {
    let (bits_per_sample, sample_format) = match encoding {
        Encoding::Int24 => (24, hound::SampleFormat::Int),
        Encoding::Float => (32, hound::SampleFormat::Float),
    };
    let spec =
        hound::WavSpec { channels: CHANNELS as u16, sample_rate: rate_hz, bits_per_sample, sample_format };
    let most = (u64::from(u32::MAX) - 128) / (CHANNELS as u64 * u64::from(bits_per_sample) / 8);
    crate::atomic::write_with(path, |out| {
        let cannot = || format!("cannot write {}", path.display());
        let mut writer = hound::WavWriter::new(out, spec).with_context(cannot)?;
        for (n, frame) in (0u64..).zip(frames) {
            if n >= most {
                bail!("{}: longer than the 4 GiB a WAV file may have: write shorter files", path.display());
            }
            for code in frame {
                let missing = code == MISSING;
                match encoding {
                    Encoding::Int24 => writer.write_sample(if missing { 0 } else { code }),
                    Encoding::Float => {
                        writer.write_sample(if missing { f32::NAN } else { code as f32 / 8_388_608.0 })
                    }
                }
                .with_context(cannot)?;
            }
        }
        writer.finalize().with_context(cannot)
    })
}
