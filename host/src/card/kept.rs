//! What a file of a card holds, after whatever end.

use super::medium::Medium;
use anyhow::{Result, bail};
use seabearing_core::block::{CHANNELS, Frame};
use seabearing_core::utc::Pair;
use seabearing_firmware::card::layout::{Extent, FRAME_BYTES, Gap, Label, SLOT_SECTORS, Slot, Why};
use seabearing_firmware::card::{PAGE_SECTORS, SECTOR};

/// Sound that is on a card.
#[derive(Debug, Clone, PartialEq)]
pub struct Kept {
    /// Whose, and from which sample on.
    pub label: Label,
    /// Instants that are there.
    pub frames: u32,
    /// Of these, those that the card had taken after the last length was told.
    pub untold: u32,
    /// What is missing between them, in order.
    pub gaps: Vec<Gap>,
    /// Two points of the line of UTC that the recorder told last.
    pub times: [Option<Pair>; 2],
    /// The recorder ended it; where not, power or the card was cut.
    pub closed: bool,
    /// Instants of the session that the card had lost by then.
    pub lost: u64,
    /// Only clips about detections were kept.
    pub clips: bool,
    /// Detections told while it was filled.
    pub detections: u32,
    /// Index of the first of them, where there is one; it may stand at the end of the file before.
    pub first_detection: Option<u64>,
}

impl Kept {
    /// Index after its last sample.
    pub fn end_index(&self) -> u64 {
        let missing: u64 = self.gaps.iter().map(|gap| gap.count).sum();
        self.label.first_index + u64::from(self.frames) + missing
    }

    /// Whether all that is missing between a file of the same start and this one was given up on purpose, away from detections: the
    /// card lost nothing meanwhile.
    pub fn is_next_clip(&self, before: &Self) -> bool {
        let own: u64 = self.gaps.iter().filter(|gap| gap.why == Why::Card).map(|gap| gap.count).sum();
        self.clips && !self.begins_anew(before) && self.lost <= before.lost.saturating_add(own)
    }

    /// Whether it was recorded after another start of the recorder than what stands in the file before it.
    pub fn begins_anew(&self, before: &Self) -> bool {
        self.label.session != before.label.session || self.label.first_index < before.end_index()
    }

    /// UTC of a sample in microseconds, where a time was told.
    pub fn utc_us(&self, index: i64) -> Option<f64> {
        let [first, latest] = self.times;
        let (first, latest) = (first?, latest?);
        let instants = latest.index.abs_diff(first.index);
        // Two times tell the pace if they are far enough apart.
        let pace = if instants >= u64::from(self.label.rate_hz) * 10 {
            (latest.utc_us - first.utc_us) as f64 / instants as f64
        } else {
            1e6 / f64::from(self.label.rate_hz)
        };
        Some(latest.utc_us as f64 + (index - latest.index as i64) as f64 * pace)
    }
}

/// What a file of so many pages holds; `None` where it is unused.
///
/// # Errors
/// It cannot be read, or is no file of a card.
pub fn recover(file: &mut impl Medium, pages: u32) -> Result<Option<Kept>> {
    let extent = Extent { first: 0, pages };
    if pages < 2 {
        bail!("too short for a file of a card");
    }
    let mut newest: Option<(Slot, Vec<Gap>)> = None;
    for which in [0, 1] {
        let bytes = file.read(extent.slot(which), SLOT_SECTORS)?;
        if let Some((slot, gaps)) = Slot::decode(&bytes)
            && newest.as_ref().is_none_or(|(newest, _)| newest.sequence < slot.sequence)
        {
            newest = Some((slot, gaps.collect()));
        }
    }
    let Some((slot, mut gaps)) = newest else { bail!("neither of its two slots can be read") };
    if !slot.used {
        return Ok(None);
    }
    let told = slot.frames.min(extent.frames());
    // Behind the length told of a file that was filled before stands older sound.
    let frames = if slot.closed || slot.again { told } else { written(file, &extent, told)? };
    // What is missing after the last sample says nothing yet.
    gaps.retain(|gap| gap.at < frames);
    let (label, times) = (slot.label, slot.times);
    Ok(Some(Kept {
        label,
        frames,
        untold: frames - told,
        gaps,
        times,
        closed: slot.closed,
        lost: slot.lost,
        clips: slot.clips,
        detections: slot.detections,
        first_detection: (slot.detections > 0).then_some(slot.first_detection),
    }))
}

/// Instants that the card had taken, of which so many were told: sectors without a break up to one of zeros, as it was
/// prepared. The last of them may have been cut while it was written: an instant that reaches into the zeros at its end does not
/// count, which may be one that was whole.
fn written(file: &mut impl Medium, extent: &Extent, told: u32) -> Result<u32> {
    let end = (extent.pages - 1) * PAGE_SECTORS;
    let begin = ((SECTOR + told as usize * FRAME_BYTES) / SECTOR) as u32;
    let (mut low, mut high) = (begin.min(end), end);
    while low < high {
        let middle = low.midpoint(high);
        if file.read(middle, 1)?.iter().any(|byte| *byte != 0) { low = middle + 1 } else { high = middle }
    }
    let zeros = match low > begin {
        true => file.read(low - 1, 1)?.iter().rev().take_while(|byte| **byte == 0).count(),
        false => 0,
    };
    let bytes = (low as usize * SECTOR).saturating_sub(SECTOR + zeros);
    Ok(((bytes / FRAME_BYTES) as u32).clamp(told, extent.frames()))
}

/// Reads so many of a file's instants.
///
/// # Errors
/// The card cannot be read.
pub fn frames(file: &mut impl Medium, from: u32, count: usize) -> Result<Vec<Frame>> {
    let at = SECTOR + from as usize * FRAME_BYTES;
    let end = at + count * FRAME_BYTES;
    let (first, last) = (at / SECTOR, end.div_ceil(SECTOR));
    let bytes = file.read(first as u32, (last - first) as u32)?;
    let ours = bytes.get(at - first * SECTOR..end - first * SECTOR).unwrap_or_default();
    let frame = |bytes: &[u8; FRAME_BYTES]| -> Frame {
        let codes = bytes.as_chunks::<3>().0;
        core::array::from_fn(|c| {
            codes.get(c).map_or(0, |[low, middle, high]| i32::from_le_bytes([0, *low, *middle, *high]) >> 8)
        })
    };
    const _: () = assert!(FRAME_BYTES == 3 * CHANNELS);
    Ok(ours.as_chunks().0.iter().map(frame).collect())
}
