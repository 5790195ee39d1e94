//! The card of the modelled board: prepared before a run, and held against what the converter gave after it.

use super::BoardRun;
use anyhow::{Result, anyhow, bail, ensure};
use seabearing_board_model::ads131m04::Codes;
use seabearing_board_model::sd_card::SdCard;
use seabearing_core::config_blob;
use seabearing_core::wire::Message;
use seabearing_firmware::card::clips::{Claims, Clips};
use seabearing_firmware::card::layout::{Extent, Why};
use seabearing_host::card::blank::Blank;
use seabearing_host::card::kept::{self, Kept};
use seabearing_host::card::medium::{Medium, Part};
use seabearing_host::card::simulated::Sectors;
use seabearing_host::card::{extents, in_order};
use std::collections::{HashMap, VecDeque};

/// Instants compared at a time.
const AT_ONCE: u32 = 4096;

/// Instants of a start's first file that tell whose it is.
const AT_FIRST: u32 = 16;

/// A file on the card: its number, where it is, what is in it.
type Found = (u32, Extent, Kept);

/// A card of 4 GB with so many files of so many pages.
///
/// # Errors
/// They do not fit.
pub fn blank(files: u32, pages: u32, rate_hz: f64) -> Result<Blank> {
    const SECTORS: u32 = 7_800_000;
    Blank::new(SECTORS, Some(files), pages, rate_hz.round() as u32)
}

/// What is put into the holder.
pub(super) fn insert(blank: Option<&Blank>) -> Result<SdCard> {
    Ok(match blank {
        Some(blank) => SdCard::new(blank.sectors, Sectors::of(blank)?.0),
        None => SdCard::none(),
    })
}

/// Sound found on a card, against the truth.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sound {
    /// Files with sound, and how many were not ended by the recorder.
    pub files: usize,
    /// Of these, not ended by the recorder.
    pub open: usize,
    /// Instants on the card.
    pub instants: u64,
    /// Instants missing up to the last of each start that were not left out on purpose; of clips those that a detection claims.
    pub missing: u64,
    /// Most instants that the board had read before an end (of a start, of the run) and the card had not taken.
    pub untaken: u64,
    /// Instants whose codes are not those that the converter gave.
    pub wrong: u64,
    /// The first index of each start, and the one after its last.
    pub spans: Vec<(u64, u64)>,
}

/// The card's sound against the conversions that were read, of each start, and against the detections where clips are kept.
/// `off`: what numbers after a gap are off by where the board told them to be an estimate (0: they must be exact).
///
/// # Errors
/// The card cannot be read any more, or the configuration.
pub fn sound(run: &BoardRun, blob: &[u8], off: i64) -> Result<Sound> {
    let Some(card) = &run.card else { bail!("there is no card") };
    let config = config_blob::station(blob).map_err(|e| anyhow!("{e}"))?;
    let mut sound = Sound::default();
    let mut medium = card;
    let mut files: Vec<Found> = Vec::new();
    for (number, extent) in extents(&mut medium)? {
        let mut file = Part { medium: &mut medium, first: extent.first };
        let Some(kept) = kept::recover(&mut file, extent.pages)? else { continue };
        if kept.label.file != number {
            bail!("file {number} says that it is file {}", kept.label.file);
        }
        files.push((number, extent, kept));
    }
    in_order(&mut files, |file| Some(&file.2), |file| file.0);
    let mut groups: VecDeque<&[Found]> =
        files.chunk_by(|(_, _, before), (_, _, kept)| !kept.begins_anew(before)).collect();
    for start in 0..run.starts.len() {
        let truth = truth(run, start, off);
        // A start that was reset within its first moments has recorded nothing; what is there is a later one's.
        let later = run.starts.len() - start > groups.len();
        let mine = match groups.front() {
            Some([(_, extent, kept), ..]) if later => {
                let mut file = Part { medium: &mut medium, first: extent.first };
                let begin = kept::frames(&mut file, 0, kept.frames.min(AT_FIRST) as usize)?;
                (kept.label.first_index..).zip(&begin).any(|(index, frame)| truth.get(&index) == Some(frame))
            }
            group => group.is_some(),
        };
        let files = if mine { groups.pop_front().unwrap_or_default() } else { &[] };
        for (_, extent, kept) in files {
            let mut file = Part { medium: &mut medium, first: extent.first };
            sound.wrong += wrong(&mut file, kept, &truth)?;
            sound.files += 1;
            sound.open += usize::from(!kept.closed);
            sound.instants += u64::from(kept.frames);
        }
        let kept: Vec<&Kept> = files.iter().map(|file| &file.2).collect();
        sound.missing += missing(&kept);
        if let [first, .., last] | [first @ last] = kept[..] {
            sound.spans.push((first.label.first_index, last.end_index()));
        }
        let last = truth.keys().max().map_or(0, |last| last + 1);
        let taken = kept.last().map_or(0, |kept| kept.end_index());
        sound.untaken = sound.untaken.max(last.saturating_sub(taken));
        if config.clips.are_kept() {
            sound.missing += unkept(run, &kept, Clips::new(config.clips, config.rate_hz as u32), last);
        }
    }
    ensure!(groups.is_empty(), "{} starts on the card are of no start of the board", groups.len());
    Ok(sound)
}

/// The codes that the converter gave by the numbers of a start.
fn truth(run: &BoardRun, start: usize, off: i64) -> HashMap<u64, Codes> {
    let begin = run.starts.get(start).map_or(0, |start| start.1);
    let end = run.starts.get(start + 1).map_or(run.numbers.len(), |next| next.1);
    let base = run.numbers.get(begin).copied().unwrap_or(0);
    let numbers = &run.numbers[begin..end];
    let gap = numbers.windows(2).position(|w| w[1] > w[0] + 1).map_or(numbers.len(), |at| at + 1);
    let given =
        |(n, number): (usize, &u64)| (number - base).saturating_add_signed(if n < gap { 0 } else { off });
    numbers.iter().enumerate().map(given).zip(run.codes[begin..end].iter().copied()).collect()
}

/// Instants of a file that are not those of their numbers.
fn wrong(file: &mut impl Medium, kept: &Kept, truth: &HashMap<u64, Codes>) -> Result<u64> {
    let mut wrong = 0;
    let mut index = kept.label.first_index;
    let mut gaps = kept.gaps.iter().peekable();
    let mut at = 0;
    while at < kept.frames {
        while let Some(gap) = gaps.next_if(|gap| gap.at == at) {
            index += gap.count;
        }
        let until = gaps.peek().map_or(kept.frames, |gap| gap.at).min(at + AT_ONCE);
        for frame in kept::frames(file, at, (until - at) as usize)? {
            wrong += u64::from(truth.get(&index) != Some(&frame));
            index += 1;
        }
        at = until;
    }
    Ok(wrong)
}

/// Instants up to the last of a start that are on none of its files, and were not left out on purpose.
fn missing(files: &[&Kept]) -> u64 {
    let gaps = files.iter().flat_map(|kept| &kept.gaps);
    let within: u64 = gaps.filter(|gap| gap.why != Why::Pause).map(|gap| gap.count).sum();
    let between = |pair: &[&Kept]| match pair {
        [before, kept] if !kept.is_next_clip(before) => kept.label.first_index - before.end_index(),
        _ => 0,
    };
    let before = files.first().filter(|kept| !kept.clips).map_or(0, |kept| kept.label.first_index);
    before + within + files.windows(2).map(between).sum::<u64>()
}

/// Instants before `end` that a detection claims and no file has; of a board that has started once.
fn unkept(run: &BoardRun, files: &[&Kept], clips: Clips, end: u64) -> u64 {
    let mut claims = Box::new(Claims::new());
    claims.begin(clips);
    let there = |index: &u64| files.iter().any(|k| (k.label.first_index..k.end_index()).contains(index));
    let claimed = run.said.iter().filter_map(|said| match &said.message {
        Message::Bearing(bearing) => claims.heard(bearing.index),
        _ => None,
    });
    claimed.map(|claim| (claim.start..claim.end.min(end)).filter(|index| !there(index)).count() as u64).sum()
}
