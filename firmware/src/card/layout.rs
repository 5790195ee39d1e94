//! What stands in a file of the card.
//!
//! ```text
//! sector 0           RIFF, fmt (four channels, 24 bits), a chunk `sbrg` with the label, the head of `data`
//! sector 1 ...       samples, four times three bytes an instant, in recorder channel order
//! last page          two slots of 16 sectors, written in turns: label, length, what is missing, times, with a CRC
//! ```
//!
//! A file has whole pages of 16 KiB. The length in sector 0 is what an ordinary reader believes; it is written after the
//! slot that says the same. If its write is cut, a mix of old and new bytes is no more than the new length, because
//! lengths only grow and their low bytes come first. A slot that was cut fails its CRC, and the other one counts. Sound
//! that the card had taken after the last length was told follows it without a break, up to the zeros of a prepared file; of
//! it the last instant may be taken for one that was cut (`host/src/card/kept.rs`).
//!
//! A file that is filled again, because nothing claimed its sound ([`super::clips`]), gets length 0 in sector 0, then a slot
//! that says the same, then sound. Beyond the length told stands older sound, so there that length counts. All numbers are
//! little-endian.

use super::{PAGE, PAGE_SECTORS, SECTOR};
use seabearing_core::block::CHANNELS;
use seabearing_core::config_blob::CRC;
use seabearing_core::utc::Pair;

/// Bytes of an instant.
pub const FRAME_BYTES: usize = 3 * CHANNELS;
/// Entries of a slot's list of what is missing.
pub const GAPS: usize = 500;
/// Sectors of a slot.
pub const SLOT_SECTORS: u32 = PAGE_SECTORS / 2;
/// Bytes of a slot.
pub const SLOT_BYTES: usize = SLOT_SECTORS as usize * SECTOR;
/// Fewest pages of a file: the sound that waits in RAM must not reach over a whole one.
pub const LEAST_PAGES: u32 = 64;
/// Most pages of a file: one less than four gigabytes.
pub const MOST_PAGES: u32 = 262_143;

/// What a slot begins with.
const MAGIC: [u8; 8] = *b"SBSLOT1\0";
/// Where a slot's parts stand.
const CRC_AT: usize = 8;
const FROM: usize = 12;
const DETECTIONS_AT: usize = 20;
const LABEL_AT: usize = 24;
const FIRST_DETECTION_AT: usize = LABEL_AT + Label::BYTES;
const LENGTH_AT: usize = 64;
const PAIRS_AT: usize = 80;
const GAPS_AT: usize = 128;
const GAP_BYTES: usize = 16;
/// Bits of a slot's flags.
const USED: u8 = 1;
const AGAIN: u8 = 2;
const CLIPS: u8 = 4;
/// Where the label's chunk stands in sector 0, and the head of `data`.
const CHUNK_AT: usize = 36;
const DATA_AT: usize = SECTOR - 8;

/// A file in one piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// Its first sector.
    pub first: u32,
    /// Its whole pages.
    pub pages: u32,
}

impl Extent {
    /// Whole instants that fit.
    pub fn frames(&self) -> u32 {
        let bytes = u64::from(self.pages.saturating_sub(1)) * PAGE as u64;
        (bytes.saturating_sub(SECTOR as u64) / FRAME_BYTES as u64) as u32
    }

    /// First sector of a slot (0 or 1).
    pub fn slot(&self, which: u32) -> u32 {
        self.first + self.pages.saturating_sub(1) * PAGE_SECTORS + (which & 1) * SLOT_SECTORS
    }
}

/// What samples a file holds; all zeros but the rate in a file that is prepared and not used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Label {
    /// Number in the file's name.
    pub file: u32,
    /// The recorder's start (its boot) in which it was recorded.
    pub session: u32,
    /// The station.
    pub station: u16,
    /// Whole samples a second.
    pub rate_hz: u32,
    /// Hash of the station's configuration.
    pub config_hash: u64,
    /// Index of its first sample.
    pub first_index: u64,
}

impl Label {
    /// Bytes of it.
    const BYTES: usize = 32;

    fn put(&self, to: &mut [u8]) {
        let mut fields = Fields(to);
        fields.put(&self.file.to_le_bytes());
        fields.put(&self.session.to_le_bytes());
        fields.put(&u32::from(self.station).to_le_bytes());
        fields.put(&self.rate_hz.to_le_bytes());
        fields.put(&self.config_hash.to_le_bytes());
        fields.put(&self.first_index.to_le_bytes());
    }

    fn get(from: &[u8]) -> Option<Self> {
        Some(Self {
            file: u32_at(from, 0)?,
            session: u32_at(from, 4)?,
            station: u32_at(from, 8)? as u16,
            rate_hz: u32_at(from, 12)?,
            config_hash: u64_at(from, 16)?,
            first_index: u64_at(from, 24)?,
        })
    }
}

/// Why samples are missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Why {
    /// They never came: the index jumped.
    Gap = 0,
    /// They came damaged.
    Damaged = 1,
    /// The card was too slow, or the list too full to name each.
    Card = 2,
    /// The recorder paused, as its schedule says.
    Pause = 3,
}

/// Samples that are missing in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Instants of the file before it.
    pub at: u32,
    /// Why.
    pub why: Why,
    /// How many are missing.
    pub count: u64,
}

/// What a slot says beside its gaps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slot {
    /// Grows with every slot written.
    pub sequence: u32,
    /// Whether anything was recorded; in a prepared file not.
    pub used: bool,
    /// No more will be written.
    pub closed: bool,
    /// The file was filled before: beyond the length told stands older sound, not zeros.
    pub again: bool,
    /// Only clips are kept: what is missing before the file was given up on purpose, where the card has lost nothing since.
    pub clips: bool,
    /// What the file holds.
    pub label: Label,
    /// Instants on the card.
    pub frames: u32,
    /// Instants of the session lost so far because of the card.
    pub lost: u64,
    /// Two points of the line of UTC that the recorder told last, some time apart.
    pub times: [Option<Pair>; 2],
    /// Detections told while it was filled.
    pub detections: u32,
    /// Index of the first of them, which may stand at the end of the file before.
    pub first_detection: u64,
}

impl Slot {
    /// Writes it with its gaps; how many bytes count.
    pub fn encode(&self, gaps: &[Gap], to: &mut [u8; SLOT_BYTES]) -> usize {
        let gaps = gaps.get(..GAPS).unwrap_or(gaps);
        to.fill(0);
        let (head, list) = to.split_at_mut(GAPS_AT);
        let mut fields = Fields(head);
        fields.put(&MAGIC);
        fields.put(&[0; 4]);
        fields.put(&(gaps.len() as u16).to_le_bytes());
        let flag = |set, bit| if set { bit } else { 0 };
        fields.put(&[
            flag(self.used, USED) | flag(self.again, AGAIN) | flag(self.clips, CLIPS),
            u8::from(self.closed),
        ]);
        fields.put(&self.sequence.to_le_bytes());
        fields.put(&self.detections.to_le_bytes());
        self.label.put(fields.take(Label::BYTES));
        fields.put(&self.first_detection.to_le_bytes());
        fields.put(&u64::from(self.frames).to_le_bytes());
        fields.put(&self.lost.to_le_bytes());
        for pair in self.times {
            // A time that is not known has no deviation.
            let pair = pair.unwrap_or(Pair { index: 0, utc_us: 0, sd_s: f64::INFINITY });
            fields.put(&pair.index.to_le_bytes());
            fields.put(&pair.utc_us.to_le_bytes());
            fields.put(&pair.sd_s.to_le_bytes());
        }
        for (entry, gap) in list.as_chunks_mut::<GAP_BYTES>().0.iter_mut().zip(gaps) {
            let mut fields = Fields(entry);
            fields.put(&gap.at.to_le_bytes());
            fields.put(&(gap.why as u32).to_le_bytes());
            fields.put(&gap.count.to_le_bytes());
        }
        let length = GAPS_AT + GAP_BYTES * gaps.len();
        let crc = CRC.checksum(to.get(FROM..length).unwrap_or_default());
        if let Some(place) = to.get_mut(CRC_AT..FROM) {
            place.copy_from_slice(&crc.to_le_bytes());
        }
        length
    }

    /// Reads a slot that is whole; of a list that is longer than what is given only the head, unchecked, is not taken.
    pub fn decode(from: &[u8]) -> Option<(Self, impl Iterator<Item = Gap>)> {
        let gaps = u16_at(from, FROM)?;
        let length = GAPS_AT + GAP_BYTES * usize::from(gaps);
        let whole = from.get(..length).filter(|_| usize::from(gaps) <= GAPS)?;
        let crc = CRC.checksum(whole.get(FROM..)?);
        if !whole.starts_with(&MAGIC) || u32_at(whole, CRC_AT) != Some(crc) {
            return None;
        }
        let time = |at: usize| {
            let sd_s = f64::from_bits(u64_at(whole, at + 16)?);
            let pair = Pair { index: u64_at(whole, at)?, utc_us: u64_at(whole, at + 8)? as i64, sd_s };
            sd_s.is_finite().then_some(pair)
        };
        let [flags, closed] = [*whole.get(14)?, *whole.get(15)?];
        let has = |bit| flags & bit != 0;
        let slot = Self {
            sequence: u32_at(whole, 16)?,
            used: has(USED),
            closed: closed != 0,
            again: has(AGAIN),
            clips: has(CLIPS),
            label: Label::get(whole.get(LABEL_AT..)?)?,
            frames: u32::try_from(u64_at(whole, LENGTH_AT)?).ok()?,
            lost: u64_at(whole, LENGTH_AT + 8)?,
            times: [time(PAIRS_AT), time(PAIRS_AT + 24)],
            detections: u32_at(whole, DETECTIONS_AT)?,
            first_detection: u64_at(whole, FIRST_DETECTION_AT)?,
        };
        let list = whole.get(GAPS_AT..)?.as_chunks::<GAP_BYTES>().0.iter().filter_map(|entry| {
            let why = [Why::Gap, Why::Damaged, Why::Card, Why::Pause];
            let why = *why.get(u32_at(entry, 4)? as usize)?;
            Some(Gap { at: u32_at(entry, 0)?, why, count: u64_at(entry, 8)? })
        });
        Some((slot, list))
    }
}

/// Writes sector 0 of a file with so many instants.
pub fn head(label: &Label, frames: u32, to: &mut [u8; SECTOR]) {
    const CHUNK_BYTES: u32 = (DATA_AT - CHUNK_AT - 8) as u32;
    let (data, rate) = (frames * FRAME_BYTES as u32, label.rate_hz);
    to.fill(0);
    let (before, last) = to.split_at_mut(DATA_AT);
    let mut fields = Fields(before);
    fields.put(b"RIFF");
    fields.put(&(data + SECTOR as u32 - 8).to_le_bytes());
    fields.put(b"WAVEfmt ");
    fields.put(&16u32.to_le_bytes());
    fields.put(&1u16.to_le_bytes());
    fields.put(&(CHANNELS as u16).to_le_bytes());
    fields.put(&rate.to_le_bytes());
    fields.put(&(rate * FRAME_BYTES as u32).to_le_bytes());
    fields.put(&(FRAME_BYTES as u16).to_le_bytes());
    fields.put(&24u16.to_le_bytes());
    fields.put(b"sbrg");
    fields.put(&CHUNK_BYTES.to_le_bytes());
    label.put(fields.take(Label::BYTES));
    let mut fields = Fields(last);
    fields.put(b"data");
    fields.put(&data.to_le_bytes());
}

/// The label in sector 0, where the file is one of the card's.
pub fn label_of(sector: &[u8]) -> Option<Label> {
    let ours = sector.get(..4)? == b"RIFF"
        && sector.get(CHUNK_AT..CHUNK_AT + 4)? == b"sbrg"
        && sector.get(DATA_AT..DATA_AT + 4)? == b"data";
    if ours { Label::get(sector.get(CHUNK_AT + 8..)?) } else { None }
}

/// The bytes of an instant.
pub fn bytes_of(frame: &[i32; CHANNELS]) -> [u8; FRAME_BYTES] {
    let mut bytes = [0; FRAME_BYTES];
    for (to, code) in bytes.as_chunks_mut::<3>().0.iter_mut().zip(frame) {
        let [a, b, c, _] = code.to_le_bytes();
        *to = [a, b, c];
    }
    bytes
}

/// Bytes that are filled from the front.
struct Fields<'a>(&'a mut [u8]);

impl<'a> Fields<'a> {
    /// The next bytes; fewer at the end.
    fn take(&mut self, count: usize) -> &'a mut [u8] {
        let all = core::mem::take(&mut self.0);
        let (front, rest) = all.split_at_mut(count.min(all.len()));
        self.0 = rest;
        front
    }

    fn put(&mut self, bytes: &[u8]) {
        for (to, from) in self.take(bytes.len()).iter_mut().zip(bytes) {
            *to = *from;
        }
    }
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|b| u16::from_le_bytes(*b))
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|b| u32::from_le_bytes(*b))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..)?.first_chunk().map(|b| u64::from_le_bytes(*b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const LABEL: Label = Label {
        file: 7,
        session: 3,
        station: 9,
        rate_hz: 64_000,
        config_hash: 0x0123_4567_89ab_cdef,
        first_index: 1 << 40,
    };

    #[test]
    fn a_slot_comes_back_whole_or_not_at_all() {
        let pair = Pair { index: 5, utc_us: -7, sd_s: 2e-6 };
        let slot = Slot {
            sequence: 8,
            used: true,
            closed: false,
            again: true,
            clips: false,
            label: LABEL,
            frames: 77,
            lost: 6,
            times: [Some(pair), None],
            detections: 3,
            first_detection: 1 << 41,
        };
        let gaps: Vec<Gap> =
            (0..GAPS as u32).map(|n| Gap { at: n, why: Why::Card, count: 1 << 33 }).collect();
        let mut bytes = [0xaa; SLOT_BYTES];
        let length = slot.encode(&gaps, &mut bytes);
        let (back, list) = Slot::decode(&bytes).unwrap();
        assert_eq!((back, list.collect::<Vec<_>>()), (slot, gaps));
        for at in (8..length).step_by(3) {
            let mut torn = bytes;
            torn[at] ^= 0x10;
            assert!(Slot::decode(&torn).is_none(), "byte {at}");
        }
    }

    proptest::proptest! {
        #![proptest_config(seabearing_testkit::property(300))]

        #[test]
        fn a_length_that_was_cut_while_it_was_written_is_not_too_long(
            lengths in proptest::array::uniform2(0..300_000_000u32), cut in 0..=SECTOR
        ) {
            let [old, new] = [lengths[0].min(lengths[1]), lengths[0].max(lengths[1])];
            let [mut before, mut after] = [[0; SECTOR]; 2];
            head(&LABEL, old, &mut before);
            head(&LABEL, new, &mut after);
            before[..cut].copy_from_slice(&after[..cut]);
            assert_eq!(label_of(&before), Some(LABEL));
            assert!(u32_at(&before, DATA_AT + 4).unwrap() <= new * FRAME_BYTES as u32);
        }
    }
}
