//! FLAC, decoded by `claxon` frame by frame.

use super::wav::Info;
use anyhow::{Context, Result, bail};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// An open FLAC file.
pub(super) struct Flac {
    reader: claxon::FlacReader<File>,
    /// Left shift that makes 24-bit codes; negative: right.
    shift: i32,
    /// Which of the file's channels become the recorder's.
    pick: [usize; CHANNELS],
    buffer: Vec<i32>,
}

impl Flac {
    /// Reads the header.
    ///
    /// # Errors
    /// It is damaged.
    pub(super) fn open(path: &Path) -> Result<(Self, Info)> {
        let mut file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        begin(&mut file).with_context(|| format!("cannot read {}", path.display()))?;
        let Ok(reader) = claxon::FlacReader::new(file) else {
            bail!("{}: the FLAC header is damaged or cut short, nothing to use", path.display());
        };
        let about = reader.streaminfo();
        let info = Info {
            rate_hz: f64::from(about.sample_rate),
            channels: about.channels as u16,
            frames: about.samples,
            promised: about.samples,
        };
        let shift = 24 - about.bits_per_sample as i32;
        Ok((Self { reader, shift, pick: super::pick::FIRST, buffer: Vec::new() }, info))
    }

    /// Which of the file's channels, all of which it has, become the recorder's.
    pub(super) fn pick(&mut self, pick: [usize; CHANNELS]) {
        self.pick = pick;
    }

    /// Decodes the next frames into `out` (emptied first); none at the end.
    ///
    /// # Errors
    /// The data are damaged or cut short from here on.
    pub(super) fn read(&mut self, out: &mut Vec<Frame>) -> Result<()> {
        out.clear();
        let buffer = std::mem::take(&mut self.buffer);
        let Some(block) = self.reader.blocks().read_next_or_eof(buffer)? else { return Ok(()) };
        let greatest = if self.shift > 0 { (1 << (23 - self.shift)) - 1 } else { i32::MAX };
        let code = |x: i32| match self.shift {
            s if s > 0 && x == greatest => 0x7f_ffff,
            s if s >= 0 => x << s,
            s => x >> -s,
        };
        let there = block.channels();
        let channels = self.pick.map(|c| if (c as u32) < there { block.channel(c as u32) } else { &[] });
        out.extend(
            (0..block.duration() as usize).map(|i| channels.map(|c| c.get(i).map_or(MISSING, |x| code(*x)))),
        );
        self.buffer = block.into_buffer();
        Ok(())
    }
}

/// Whether a file's first bytes are those of FLAC or of an ID3v2 tag, which some programs put before it.
pub(super) fn begins(head: &[u8]) -> bool {
    head.starts_with(b"fLaC") || head.starts_with(TAG)
}

/// How an ID3v2 tag begins; two bytes of version, one of flags and its length without this header follow, four digits to the
/// base of 128 (ID3v2.4, 3.1).
const TAG: &[u8] = b"ID3";

/// Goes to where FLAC begins: behind tags.
fn begin(file: &mut File) -> std::io::Result<()> {
    loop {
        let at = file.stream_position()?;
        let mut head = [0; 10];
        if file.read_exact(&mut head).is_err() || !head.starts_with(TAG) {
            return file.seek(SeekFrom::Start(at)).map(drop);
        }
        let [.., flags, a, b, c, d] = head;
        let length = [a, b, c, d].iter().fold(0, |sum, digit| sum << 7 | u64::from(digit & 0x7f));
        // A footer is a copy of the header.
        let footer = if flags & 0x10 == 0 { 0 } else { 10 };
        file.seek(SeekFrom::Start(at + 10 + length + footer))?;
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A FLAC stream of verbatim subframes (RFC 9639), 16 frames of `BLOCK` samples at most.
    pub(crate) fn encode(frames: &[[i32; 4]], bits: u8, rate_hz: u32) -> Vec<u8> {
        const BLOCK: usize = 256;
        let mut out = b"fLaC\x80\0\0\x22".to_vec();
        out.extend_from_slice(&(BLOCK as u16).to_be_bytes());
        out.extend_from_slice(&(BLOCK as u16).to_be_bytes());
        out.extend_from_slice(&[0; 6]);
        let packed = u64::from(rate_hz) << 44 | 3 << 41 | u64::from(bits - 1) << 36 | frames.len() as u64;
        out.extend_from_slice(&packed.to_be_bytes());
        out.extend_from_slice(&[0; 16]);
        let crc8 = crc::Crc::<u8>::new(&crc::CRC_8_SMBUS);
        let crc16 = crc::Crc::<u16>::new(&crc::CRC_16_UMTS);
        for (number, block) in frames.chunks_exact(BLOCK).enumerate() {
            let size = if bits == 16 { 0b100 } else { 0b110 };
            // 256 samples (code 8), rate from the header (0), four channels (3), sample size.
            let mut frame = vec![0xff, 0xf8, 0x80, 3 << 4 | size << 1, number as u8];
            frame.push(crc8.checksum(&frame));
            for c in 0..4 {
                frame.push(0b0000_0010);
                for f in block {
                    frame.extend_from_slice(&f[c].to_be_bytes()[4 - usize::from(bits / 8)..]);
                }
            }
            frame.extend_from_slice(&crc16.checksum(&frame).to_be_bytes());
            out.extend_from_slice(&frame);
        }
        out
    }

    #[test]
    fn a_tag_before_the_stream_is_passed_over() {
        let frames: Vec<[i32; 4]> = (0..256).map(|i| [i, -i, 7, 8]).collect();
        let mut bytes = b"ID3\x04\0\0\0\0\x01\x02".to_vec();
        bytes.extend([b'x'; 130]);
        bytes.extend(encode(&frames, 24, 64_000));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &bytes).unwrap();
        assert_eq!(super::super::Container::of(file.path()).unwrap(), Some(super::super::Container::Flac));
        let (mut flac, _) = Flac::open(file.path()).unwrap();
        let mut some = Vec::new();
        flac.read(&mut some).unwrap();
        assert_eq!((some.len(), some[9]), (256, [9, -9, 7, 8]));
        // A tag that says it is longer than the file, and one that is cut short.
        for cut in [6, 100] {
            std::fs::write(file.path(), &bytes[..cut]).unwrap();
            assert!(Flac::open(file.path()).is_err());
        }
    }

    #[test]
    fn both_common_widths_decode_and_a_cut_keeps_the_whole_frames() {
        for (bits, greatest) in [(16u8, 32_767), (24, 8_388_607)] {
            let frames: Vec<[i32; 4]> = (0..1024).map(|i| [i, -i, greatest, -greatest - 1]).collect();
            let bytes = encode(&frames, bits, 64_000);
            let file = tempfile::NamedTempFile::new().unwrap();
            let decode = |bytes: &[u8]| {
                std::fs::write(file.path(), bytes).unwrap();
                let (mut flac, info) = Flac::open(file.path()).unwrap();
                assert_eq!((info.rate_hz, info.channels, info.frames), (64_000.0, 4, Some(1024)));
                let (mut all, mut some) = (Vec::new(), Vec::new());
                loop {
                    match flac.read(&mut some) {
                        Ok(()) if some.is_empty() => return (all, false),
                        Ok(()) => all.extend_from_slice(&some),
                        Err(_) => return (all, true),
                    }
                }
            };
            let scale = 1 << (24 - bits);
            let want: Vec<Frame> =
                (0..1024).map(|i| [i * scale, -i * scale, 8_388_607, -8_388_608]).collect();
            assert_eq!(decode(&bytes), (want.clone(), false));
            assert_eq!(decode(&bytes[..bytes.len() - 10]), (want[..768].to_vec(), true));
        }
    }
}
