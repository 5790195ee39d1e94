//! WAV: the header as recorders really write it, and 16, 24, 32-bit or floating-point samples decoded in bulk.
//!
//! `hound` (which writes our files) reads sample by sample and refuses files over 4 GiB and headers that a recorder
//! never finished; a day of four channels at 64 kHz is 66 GB, and the interesting file is often the unfinished one.
//! Hence this reader: RIFF, RF64 and BW64 (EBU Tech 3306), any chunks before `data`, sizes of 0 or 2³² − 1.

use anyhow::{Context, Result, bail};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// What a header says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Info {
    /// Samples a second.
    pub rate_hz: f64,
    /// Channels.
    pub channels: u16,
    /// Whole frames that are really there, where that can be told.
    pub frames: Option<u64>,
    /// Frames the header promises; more than `frames` in a truncated file.
    pub promised: Option<u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Code {
    Int16,
    Int24,
    Int32,
    Float32,
    Float64,
}

impl Code {
    fn bytes(self) -> usize {
        match self {
            Self::Int16 => 2,
            Self::Int24 => 3,
            Self::Int32 | Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }
}

/// Frames decoded at a time: 16384 frames of 24 bits are 196 KB, which stays in the second-level cache.
const FRAMES: usize = 16_384;

/// An open WAV file, at its first sample.
pub(super) struct Wav {
    file: File,
    code: Code,
    /// Channels of the file, and which of them become the recorder's.
    channels: usize,
    pick: [usize; CHANNELS],
    left: u64,
    bytes: Vec<u8>,
}

impl Wav {
    /// Reads the header.
    ///
    /// # Errors
    /// It is not whole, or the samples are of a kind that no recorder writes.
    pub(super) fn open(path: &Path) -> Result<(Self, Info)> {
        let mut file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let length = file.metadata().with_context(|| format!("cannot read {}", path.display()))?.len();
        let name = path.display();
        let mut head = [0u8; 12];
        if file.read_exact(&mut head).is_err() {
            bail!("{name}: cut short within the WAV header, nothing to use");
        }
        let mut at = 12u64;
        let mut format: Option<Format> = None;
        let mut long_data: Option<u64> = None;
        loop {
            let mut chunk = [0u8; 8];
            file.seek(SeekFrom::Start(at)).with_context(|| format!("cannot read {name}"))?;
            if file.read_exact(&mut chunk).is_err() {
                bail!("{name}: the WAV header ends before any samples (no `data` chunk), nothing to use");
            }
            let size = u64::from(le32(&chunk, 4));
            at += 8;
            match &chunk[..4] {
                b"fmt " => {
                    let mut body = vec![0u8; size.min(40) as usize];
                    if file.read_exact(&mut body).is_err() {
                        bail!("{name}: cut short within the WAV header, nothing to use");
                    }
                    format = Some(Format::parse(&body).with_context(|| name.to_string())?);
                }
                b"ds64" => {
                    let mut body = [0u8; 16];
                    if file.read_exact(&mut body).is_ok() {
                        long_data = Some(u64::from(le32(&body, 8)) | u64::from(le32(&body, 12)) << 32);
                    }
                }
                b"data" => {
                    let Some(format) = format else { bail!("{name}: WAV `data` comes before `fmt `") };
                    let there = length.saturating_sub(at);
                    // 0 and values close to 2^32 stand for "not known yet": the recorder never came back to fill in.
                    let promised = match (size, long_data) {
                        (0xffff_ffff, Some(long)) => Some(long),
                        (0 | 0xffff_f000.., _) => None,
                        _ => Some(size),
                    };
                    let channels = usize::from(format.channels.max(1));
                    let frame = (format.code.bytes() * channels) as u64;
                    let left = promised.unwrap_or(there).min(there) / frame;
                    let info = Info {
                        rate_hz: f64::from(format.rate_hz),
                        channels: format.channels,
                        frames: Some(left),
                        promised: promised.map(|p| p / frame),
                    };
                    file.seek(SeekFrom::Start(at)).with_context(|| format!("cannot read {name}"))?;
                    let bytes = vec![0u8; FRAMES * channels * format.code.bytes()];
                    let pick = super::pick::FIRST;
                    return Ok((Self { file, code: format.code, channels, pick, left, bytes }, info));
                }
                _ => {}
            }
            at += size + size % 2;
        }
    }

    /// Which of the file's channels, all of which it has, become the recorder's.
    pub(super) fn pick(&mut self, pick: [usize; CHANNELS]) {
        self.pick = pick;
    }

    /// Passes over frames.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(super) fn skip(&mut self, frames: u64) -> Result<()> {
        let frames = frames.min(self.left);
        self.left -= frames;
        let bytes = frames * (self.channels * self.code.bytes()) as u64;
        Ok(self.file.seek_relative(i64::try_from(bytes)?)?)
    }

    /// Decodes the next frames into `out` (emptied first); none at the end.
    pub(super) fn read(&mut self, out: &mut Vec<Frame>) -> Result<()> {
        out.clear();
        let width = self.code.bytes();
        let want = (FRAMES as u64).min(self.left) as usize * self.channels * width;
        let mut got = 0;
        while let Some(space) = self.bytes.get_mut(got..want).filter(|s| !s.is_empty()) {
            match self.file.read(space) {
                Ok(0) => break,
                Ok(n) => got += n,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e.into()),
            }
        }
        let bytes = self.bytes.get(..got).unwrap_or(&[]);
        let from = (self.channels, self.pick);
        match self.code {
            Code::Int16 => decode::<2>(bytes, from, out, |b| {
                let x = i32::from(i16::from_le_bytes(b)) << 8;
                if x == 0x7fff00 { 0x7f_ffff } else { x }
            }),
            Code::Int24 => decode::<3>(bytes, from, out, |[a, b, c]| i32::from_le_bytes([0, a, b, c]) >> 8),
            Code::Int32 => decode::<4>(bytes, from, out, |b| i32::from_le_bytes(b) >> 8),
            Code::Float32 => decode::<4>(bytes, from, out, |b| from_float(f64::from(f32::from_le_bytes(b)))),
            Code::Float64 => decode::<8>(bytes, from, out, |b| from_float(f64::from_le_bytes(b))),
        }
        // A file that shrank under us ends here.
        self.left = if out.len() * self.channels * width < want { 0 } else { self.left - out.len() as u64 };
        Ok(())
    }
}

/// A floating-point sample (full scale ±1) as a 24-bit code.
fn from_float(x: f64) -> i32 {
    if x.is_finite() { (x * 8_388_608.0).round().clamp(-8_388_608.0, 8_388_607.0) as i32 } else { MISSING }
}

/// Decodes interleaved samples of `N` bytes of so many channels; a fraction of a frame at the end is left.
fn decode<const N: usize>(
    bytes: &[u8],
    (channels, pick): (usize, [usize; CHANNELS]),
    out: &mut Vec<Frame>,
    code: impl Fn([u8; N]) -> i32,
) {
    if channels != CHANNELS || pick != super::pick::FIRST {
        out.extend(bytes.chunks_exact(channels * N).map(|frame| {
            let samples = frame.as_chunks::<N>().0;
            pick.map(|c| samples.get(c).map_or(MISSING, |s| code(*s)))
        }));
        return;
    }
    out.extend(bytes.chunks_exact(CHANNELS * N).map(|frame| {
        let mut samples = [0; CHANNELS];
        for (to, from) in samples.iter_mut().zip(frame.as_chunks::<N>().0) {
            *to = code(*from);
        }
        samples
    }));
}

fn le32(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes)
}

fn le16(bytes: &[u8], at: usize) -> u16 {
    bytes.get(at..at + 2).and_then(|b| b.try_into().ok()).map_or(0, u16::from_le_bytes)
}

#[derive(Clone, Copy)]
struct Format {
    code: Code,
    channels: u16,
    rate_hz: u32,
}

impl Format {
    fn parse(body: &[u8]) -> Result<Self> {
        if body.len() < 16 {
            bail!("the WAV format chunk is too short");
        }
        let bits = le16(body, 14);
        let tag = match le16(body, 0) {
            // Extensible: the sub-format's first two bytes are the tag.
            0xfffe => le16(body, 24),
            tag => tag,
        };
        let code = match (tag, bits) {
            (1, 16) => Code::Int16,
            (1, 24) => Code::Int24,
            (1, 32) => Code::Int32,
            (3, 32) => Code::Float32,
            (3, 64) => Code::Float64,
            (1 | 3, _) => bail!("{bits}-bit samples; 16, 24 or 32-bit integers or floating point are read"),
            _ => bail!("compressed WAV (format {tag}); convert it to PCM or FLAC"),
        };
        Ok(Self { code, channels: le16(body, 2), rate_hz: le32(body, 4) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(bits: u16, format: hound::SampleFormat, samples: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
        let spec =
            hound::WavSpec { channels: 4, sample_rate: 64_000, bits_per_sample: bits, sample_format: format };
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut w = hound::WavWriter::new(&mut bytes, spec).unwrap();
        samples(&mut w);
        w.finalize().unwrap();
        bytes.into_inner()
    }
    type Writer<'a> = hound::WavWriter<&'a mut std::io::Cursor<Vec<u8>>>;

    fn read(bytes: &[u8]) -> (Vec<Frame>, Info) {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let (mut wav, info) = Wav::open(file.path()).unwrap();
        let (mut all, mut some) = (Vec::new(), Vec::new());
        loop {
            wav.read(&mut some).unwrap();
            if some.is_empty() {
                return (all, info);
            }
            all.extend_from_slice(&some);
        }
    }

    #[test]
    fn every_sample_kind_comes_out_as_24_bit_codes() {
        use hound::SampleFormat::{Float, Int};
        let ints = [-8_388_608i32, -1, 77, 8_388_607];
        let b = write(24, Int, |w| ints.iter().for_each(|x| w.write_sample(*x).unwrap()));
        assert_eq!(read(&b).0, [ints]);
        let b = write(32, Int, |w| ints.iter().for_each(|x| w.write_sample(*x << 8 | 0x55).unwrap()));
        assert_eq!(read(&b).0, [ints]);
        let b =
            write(16, Int, |w| [-32768i16, -1, 77, 32767].iter().for_each(|x| w.write_sample(*x).unwrap()));
        assert_eq!(read(&b).0, [[-8_388_608, -256, 77 * 256, 8_388_607]]);
        let floats = [f32::NAN, -2.0, 0.5, 1.0];
        let b = write(32, Float, |w| floats.iter().for_each(|x| w.write_sample(*x).unwrap()));
        assert_eq!(read(&b).0, [[MISSING, -8_388_608, 4_194_304, 8_388_607]]);
    }

    #[test]
    fn truncated_and_unfinished_files_give_what_is_there() {
        let whole =
            write(24, hound::SampleFormat::Int, |w| (0..40_000).for_each(|x| w.write_sample(x).unwrap()));
        let (frames, info) = read(&whole);
        assert_eq!((frames.len(), info.frames, info.promised), (10_000, Some(10_000), Some(10_000)));
        let (cut, info) = read(&whole[..whole.len() - 12 * 400 - 5]);
        assert_eq!((cut.len(), info.promised), (9599, Some(10_000)));
        assert_eq!(cut[..], frames[..9599]);
        // Sizes never filled in: both zero, as after a power cut.
        let mut unfinished = whole.clone();
        let data = whole.windows(4).position(|w| w == b"data").unwrap();
        unfinished[data + 4..data + 8].fill(0);
        assert_eq!(read(&unfinished).0.len(), 10_000);
    }

    #[test]
    fn more_than_four_gigabytes_are_announced_in_ds64() {
        let whole =
            write(24, hound::SampleFormat::Int, |w| (0..400).for_each(|x| w.write_sample(x).unwrap()));
        let mut long = whole.clone();
        long[..4].copy_from_slice(b"RF64");
        let data = whole.windows(4).position(|w| w == b"data").unwrap();
        long[data + 4..data + 8].fill(0xff);
        let mut ds64 = b"ds64\x1c\0\0\0".to_vec();
        ds64.extend_from_slice(&[0u8; 8]);
        ds64.extend_from_slice(&(5_000_000_400u64 * 12).to_le_bytes());
        ds64.extend_from_slice(&[0u8; 12]);
        long.splice(12..12, ds64);
        let (frames, info) = read(&long);
        assert_eq!((frames.len(), info.promised), (100, Some(5_000_000_400)));
    }
}
