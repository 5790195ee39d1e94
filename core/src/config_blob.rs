//! The configuration as one blob of bytes: how a station reaches the recorder's flash.
//!
//! ```text
//! blob    = "SBCF" version:u8=1 length:u32le section*      (length: bytes of all sections)
//! section = tag:[u8;4] length:u32le crc:u32le body:[u8;length]
//! ```
//! The CRC is CRC-32/ISO-HDLC of the body. Section `STAT` is the postcard form of [`StationConfig`] and must be
//! there; `PROP` is an ocean-bottom station's propagation table; `LEVL` says which levels are sent unasked, none where it is
//! not there: seconds:u16le channel:u8; `DUTY` when it listens, always where it is not there: every_s:u32le on_s:u32le;
//! `CLIP` which sound a card keeps, all where it is not there: before_s:u16le after_s:u16le apart_s:u32le; `DEVS` standard deviations of what
//! is not known of an ocean-bottom station, 0 where it is not there: orientation_deg:f32le gain_db:f32le table_depth_m:f32le. Unknown sections are skipped, and so is whatever follows the blob, so that a whole page
//! of flash may be given to the reader.

use crate::config::{Clips, ConfigError, Doubts, Levels, Schedule, StationConfig};

/// First bytes of every blob: magic and version.
pub const HEADER: [u8; 5] = *b"SBCF\x01";
/// Tag of the station's section.
pub const STATION: [u8; 4] = *b"STAT";
/// Tag of the propagation table's section.
pub const PROPAGATION: [u8; 4] = *b"PROP";
/// Tag of the section of the levels sent unasked.
pub const LEVELS: [u8; 4] = *b"LEVL";
/// Tag of the section that says when the recorder listens.
pub const SCHEDULE: [u8; 4] = *b"DUTY";
/// Tag of the section that says which sound a card keeps.
pub const CLIPS: [u8; 4] = *b"CLIP";
/// Tag of the section of what is not known of an ocean-bottom station.
pub const DOUBTS: [u8; 4] = *b"DEVS";
/// Bytes of a section before its body.
const SECTION_HEAD: usize = 12;
/// Bytes before the first section.
const HEAD: usize = HEADER.len() + 4;

/// The checksum of sections and of whole configurations on their way.
pub static CRC: crc::Crc<u32, crc::Table<1>> = crc::Crc::<u32, crc::Table<1>>::new(&crc::CRC_32_ISO_HDLC);

/// What is wrong with a blob.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlobError {
    /// It does not begin with [`HEADER`]: not a configuration, or one of another version.
    Header,
    /// It ends within a section, or a section's length cannot be.
    Truncated,
    /// The CRC of this section is wrong.
    Crc([u8; 4]),
    /// The section asked for is not there.
    Missing([u8; 4]),
    /// The section cannot be decoded: made by another version.
    Decode([u8; 4]),
    /// It decodes to a configuration that is not valid.
    Invalid(ConfigError),
    /// The buffer to write into is too small.
    Full,
}

impl core::fmt::Display for BlobError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let name = |tag: &[u8; 4]| tag.map(char::from);
        let (section, what) = match self {
            Self::Header => return f.write_str("no configuration, or one of another version"),
            Self::Truncated => return f.write_str("the configuration ends within a section"),
            Self::Full => return f.write_str("the configuration does not fit"),
            Self::Invalid(e) => return e.fmt(f),
            Self::Crc(tag) => (name(tag), "is damaged"),
            Self::Missing(tag) => (name(tag), "is missing"),
            Self::Decode(tag) => (name(tag), "was made by another version"),
        };
        f.write_str("section ")?;
        section.iter().try_for_each(|c| write!(f, "{c}"))?;
        write!(f, " of the configuration {what}")
    }
}

impl core::error::Error for BlobError {}

/// The body of the first section with this tag, its CRC checked.
///
/// # Errors
/// What is wrong with the blob.
pub fn section(blob: &[u8], tag: [u8; 4]) -> Result<&[u8], BlobError> {
    let (total, rest) = blob
        .strip_prefix(&HEADER)
        .ok_or(BlobError::Header)?
        .split_first_chunk::<4>()
        .ok_or(BlobError::Truncated)?;
    let mut rest = rest.get(..u32::from_le_bytes(*total) as usize).ok_or(BlobError::Truncated)?;
    while let Some((name, after)) = rest.split_first_chunk::<4>() {
        let (length, after) = after.split_first_chunk::<4>().ok_or(BlobError::Truncated)?;
        let (crc, after) = after.split_first_chunk::<4>().ok_or(BlobError::Truncated)?;
        let length = u32::from_le_bytes(*length) as usize;
        let (body, next) = after.split_at_checked(length).ok_or(BlobError::Truncated)?;
        if *name == tag {
            let whole = CRC.checksum(body) == u32::from_le_bytes(*crc);
            return if whole { Ok(body) } else { Err(BlobError::Crc(tag)) };
        }
        rest = next;
    }
    Err(BlobError::Missing(tag))
}

/// The station's configuration, decoded and validated.
///
/// # Errors
/// What is wrong with the blob or with the configuration in it.
pub fn station(blob: &[u8]) -> Result<StationConfig, BlobError> {
    let body = section(blob, STATION)?;
    let mut config: StationConfig = postcard::from_bytes(body).map_err(|_| BlobError::Decode(STATION))?;
    config.levels = small(blob, LEVELS)?.map_or(Levels::default(), Levels::of);
    config.schedule = small(blob, SCHEDULE)?.map_or(Schedule::default(), Schedule::of);
    config.clips = small(blob, CLIPS)?.map_or(Clips::default(), Clips::of);
    config.doubts = small(blob, DOUBTS)?.map_or(Doubts::default(), Doubts::of);
    config.validate().map_err(BlobError::Invalid)?;
    Ok(config)
}

/// The body of a section of fixed length, which need not be there.
// Apart: what looks for the other sections of a blob that is known when the image is built is to stay open to the optimiser.
#[inline(never)]
fn small<const N: usize>(blob: &[u8], tag: [u8; 4]) -> Result<Option<[u8; N]>, BlobError> {
    match section(blob, tag) {
        Ok(body) => body.first_chunk().copied().map(Some).ok_or(BlobError::Crc(tag)),
        Err(BlobError::Missing(_)) => Ok(None),
        Err(_) => Err(BlobError::Crc(tag)),
    }
}

/// Writes a blob section by section into a caller's buffer.
#[derive(Debug)]
pub struct Writer<'a> {
    buffer: &'a mut [u8],
    used: usize,
}

impl<'a> Writer<'a> {
    /// Begins a blob.
    ///
    /// # Errors
    /// [`BlobError::Full`] if not even the header fits.
    pub fn new(buffer: &'a mut [u8]) -> Result<Self, BlobError> {
        let (head, rest) = buffer.split_first_chunk_mut().ok_or(BlobError::Full)?;
        *head = HEADER;
        rest.first_chunk_mut::<4>().ok_or(BlobError::Full)?.fill(0);
        Ok(Self { buffer, used: HEAD })
    }

    /// Adds a section whose body `fill` writes, returning its length.
    ///
    /// # Errors
    /// [`BlobError::Full`] if it does not fit.
    pub fn section(
        &mut self,
        tag: [u8; 4],
        fill: impl FnOnce(&mut [u8]) -> Option<usize>,
    ) -> Result<(), BlobError> {
        let free = self.buffer.get_mut(self.used..).ok_or(BlobError::Full)?;
        let (head, body) = free.split_first_chunk_mut::<SECTION_HEAD>().ok_or(BlobError::Full)?;
        let length = fill(body).ok_or(BlobError::Full)?;
        let crc = CRC.checksum(body.get(..length).ok_or(BlobError::Full)?);
        let words = [tag, (length as u32).to_le_bytes(), crc.to_le_bytes()];
        for (to, from) in head.iter_mut().zip(words.iter().flatten()) {
            *to = *from;
        }
        self.used += SECTION_HEAD + length;
        Ok(())
    }

    /// Adds the station's section, that of the levels where any are sent, that of the schedule where there is one, that of
    /// the clips where not all sound is kept, and that of the doubts where there are any.
    ///
    /// # Errors
    /// [`BlobError::Full`] if it does not fit.
    pub fn station(&mut self, config: &StationConfig) -> Result<(), BlobError> {
        self.section(STATION, |body| postcard::to_slice(config, body).ok().map(|b| b.len()))?;
        if config.levels.every_s > 0 {
            self.small(LEVELS, config.levels.bytes())?;
        }
        if config.schedule.every_s > 0 {
            self.small(SCHEDULE, config.schedule.bytes())?;
        }
        if config.clips.are_kept() {
            self.small(CLIPS, config.clips.bytes())?;
        }
        if config.doubts.are_any() {
            self.small(DOUBTS, config.doubts.bytes())?;
        }
        Ok(())
    }

    fn small<const N: usize>(&mut self, tag: [u8; 4], bytes: [u8; N]) -> Result<(), BlobError> {
        self.section(tag, |body| {
            *body.first_chunk_mut()? = bytes;
            Some(N)
        })
    }

    /// The finished blob's length.
    pub fn finish(self) -> usize {
        let length = (self.used.saturating_sub(HEAD) as u32).to_le_bytes();
        for (to, from) in self.buffer.iter_mut().skip(HEADER.len()).zip(length) {
            *to = from;
        }
        self.used
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Kind, LineConfig, Tracking};
    use std::vec::Vec;

    fn config() -> StationConfig {
        StationConfig {
            id: 3,
            name: "east".try_into().unwrap(),
            lat_lon_deg: None,
            local_east_north_m: Some((4.5, -21.2)),
            depth_m: 168.0,
            orientation_deg: 0.0,
            sound_speed_m_s: 1484.0,
            rate_hz: 64000.0,
            full_scale: 1 << 23,
            kind: Kind::Line(LineConfig { sensors: 23, spacing_m: 0.75 }),
            tracking: Tracking::default(),
            levels: Levels::default(),
            schedule: Schedule { every_s: 3600, on_s: 600 },
            clips: Clips::default(),
            doubts: Doubts::default(),
        }
    }

    fn blob() -> Vec<u8> {
        let mut buffer = std::vec![0u8; 512];
        let mut writer = Writer::new(&mut buffer).unwrap();
        writer
            .section(*b"XTRA", |b| {
                b[..3].copy_from_slice(b"abc");
                Some(3)
            })
            .unwrap();
        writer.station(&config()).unwrap();
        let n = writer.finish();
        buffer.truncate(n);
        buffer
    }

    #[test]
    fn what_was_written_is_read_and_unknown_sections_are_skipped() {
        assert_eq!(station(&blob()), Ok(config()));
        let doubts = Doubts { orientation_deg: 5.0, gain_db: 0.5, table_depth_m: 100.0 };
        let doubtful = StationConfig { doubts, ..config() };
        let mut buffer = [0u8; 512];
        let mut writer = Writer::new(&mut buffer).unwrap();
        writer.station(&doubtful).unwrap();
        let n = writer.finish();
        assert_eq!(station(&buffer[..n]), Ok(doubtful.clone()));
        assert_ne!(doubtful.hash(), config().hash());
        assert_eq!(station(&[blob(), std::vec![0xff; 100]].concat()), Ok(config()));
        assert_eq!(section(&blob(), *b"XTRA"), Ok(&b"abc"[..]));
        assert_eq!(section(&blob(), PROPAGATION), Err(BlobError::Missing(PROPAGATION)));
    }

    #[test]
    fn damage_and_truncation_are_named() {
        let good = blob();
        assert_eq!(station(&[]), Err(BlobError::Header));
        for cut in HEADER.len() + 1..good.len() {
            assert!(station(&good[..cut]).is_err(), "cut at {cut}");
        }
        let mut bad = good.clone();
        *bad.last_mut().unwrap() ^= 1;
        assert_eq!(station(&bad), Err(BlobError::Crc(SCHEDULE)));
        assert_eq!(station(&good[..HEADER.len()]), Err(BlobError::Truncated));
        let mut invalid = config();
        invalid.sound_speed_m_s = 1.0;
        let mut buffer = [0u8; 512];
        let mut writer = Writer::new(&mut buffer).unwrap();
        writer.station(&invalid).unwrap();
        let n = writer.finish();
        assert!(matches!(station(&buffer[..n]), Err(BlobError::Invalid(_))));
        assert_eq!(Writer::new(&mut [0u8; 24]).unwrap().station(&config()), Err(BlobError::Full));
    }
}
