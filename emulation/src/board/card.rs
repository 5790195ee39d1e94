//! The card of the modelled board: prepared before a run, and held against what the converter gave after it.

use super::BoardRun;
use anyhow::{Result, bail};
use seabearing_board_model::ads131m04::Codes;
use seabearing_board_model::sd_card::SdCard;
use seabearing_host::card::blank::Blank;
use seabearing_host::card::extents;
use seabearing_host::card::kept::{self, Kept};
use seabearing_host::card::medium::Part;
use seabearing_host::card::simulated::Sectors;
use std::collections::HashMap;

/// Instants compared at a time.
const AT_ONCE: u32 = 4096;

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
    /// Instants missing up to the last of each start.
    pub missing: u64,
    /// Instants whose codes are not those that the converter gave.
    pub wrong: u64,
    /// The first index of each start, and the one after its last.
    pub spans: Vec<(u64, u64)>,
}

/// The card's sound against the conversions that were read, of each start.
///
/// # Errors
/// The card cannot be read any more.
pub fn sound(run: &BoardRun) -> Result<Sound> {
    let Some(card) = &run.card else { bail!("there is no card") };
    let mut sound = Sound::default();
    let mut medium = card;
    let mut sessions: Vec<Vec<Kept>> = Vec::new();
    for (number, extent) in extents(&mut medium)? {
        let mut file = Part { medium: &mut medium, first: extent.first };
        let Some(kept) = kept::recover(&mut file, extent.pages)? else { continue };
        if sessions.last().and_then(|all| all.last()).is_none_or(|before| kept.begins_anew(before)) {
            sessions.push(Vec::new());
        }
        // Every start of the core has recorded something.
        let start = sessions.len() - 1;
        let begin = run.starts.get(start).map_or(0, |start| start.1);
        let end = run.starts.get(start + 1).map_or(run.numbers.len(), |next| next.1);
        let base = run.numbers.get(begin).copied().unwrap_or(0);
        let truth: HashMap<u64, Codes> = run.numbers[begin..end]
            .iter()
            .map(|n| n - base)
            .zip(run.codes[begin..end].iter().copied())
            .collect();
        if kept.label.file != number {
            bail!("file {number} says that it is file {}", kept.label.file);
        }
        sound.files += 1;
        sound.open += usize::from(!kept.closed);
        sound.instants += u64::from(kept.frames);
        let mut index = kept.label.first_index;
        let mut gaps = kept.gaps.iter().peekable();
        let mut at = 0;
        while at < kept.frames {
            while let Some(gap) = gaps.next_if(|gap| gap.at == at) {
                index += gap.count;
            }
            let until = gaps.peek().map_or(kept.frames, |gap| gap.at).min(at + AT_ONCE);
            for frame in kept::frames(&mut file, at, (until - at) as usize)? {
                sound.wrong += u64::from(truth.get(&index) != Some(&frame));
                index += 1;
            }
            at = until;
        }
        sessions.last_mut().into_iter().for_each(|all| all.push(kept.clone()));
    }
    for files in sessions {
        let [Some(first), Some(last)] = [files.first(), files.last()] else { continue };
        let span = (first.label.first_index, last.end_index());
        let there: u64 = files.iter().map(|kept| u64::from(kept.frames)).sum();
        sound.missing += span.1.saturating_sub(there);
        sound.spans.push(span);
    }
    Ok(sound)
}
