//! Files of a recorder's card as a recording: every sample has the index that the recorder gave it.
//!
//! What is missing stays missing: a gap is a jump of the index, a damaged instant has no codes. The starts of a recorder
//! follow each other by their UTC where all of them tell it, else after a pause of a second whose length means nothing.

use super::BlockSource;
use crate::card::kept::{self, Kept};
use crate::card::medium::Single;
use crate::card::{CardFile, Content};
use anyhow::{Context, Result};
use seabearing_core::block::{Block, CHANNELS, Frame, MISSING};
use seabearing_firmware::card::layout::{Gap, Why};
use std::collections::VecDeque;
use std::path::PathBuf;
use time::{Duration, OffsetDateTime};

/// Frames of a block.
const FRAMES: u32 = 16_384;

/// A file, and what is added to its indices.
#[derive(Debug, Clone)]
struct Piece {
    path: PathBuf,
    kept: Kept,
    shift: i64,
}

/// Files in their order.
#[derive(Debug, Clone)]
pub(super) struct Pieces {
    pieces: Vec<Piece>,
    /// Samples a second.
    pub rate_hz: f64,
}

impl Pieces {
    /// Puts files in order; `None` where none has sound.
    pub(super) fn of(files: Vec<CardFile>) -> Option<Self> {
        let kept = |file: &CardFile| match &file.content {
            Content::Sound(kept) => Some(kept.clone()),
            _ => None,
        };
        let mut files: Vec<_> = files.into_iter().map(|file| (kept(&file), file)).collect();
        crate::card::in_order(&mut files, |(kept, _)| kept.as_ref(), |(_, file)| file.number);
        let mut pieces: Vec<Piece> = Vec::new();
        for (_, file) in files {
            match file.content {
                Content::Sound(kept) => pieces.push(Piece { path: file.path, kept, shift: 0 }),
                Content::Unused => {}
                Content::Damaged(why) => super::complain(&format!("left out {}: {why}", file.path.display())),
            }
        }
        let rate_hz = f64::from(pieces.first()?.kept.label.rate_hz);
        pieces.retain(|piece| {
            let same = f64::from(piece.kept.label.rate_hz) == rate_hz;
            if !same {
                super::complain(&format!("left out {}: another rate", piece.path.display()));
            }
            same
        });
        share_times(&mut pieces);
        place(&mut pieces, rate_hz);
        Some(Self { pieces, rate_hz })
    }

    fn utc_of_0(&self) -> Option<OffsetDateTime> {
        let first = self.pieces.iter().find_map(|piece| piece.kept.utc_us(-piece.shift))?;
        OffsetDateTime::UNIX_EPOCH.checked_add(Duration::microseconds(first.round() as i64))
    }

    /// When each file began and ended, where all tell it.
    pub(super) fn spans(&self) -> Option<Vec<(OffsetDateTime, OffsetDateTime)>> {
        let start = self.utc_of_0()?;
        let at = |index: u64, shift: i64| {
            start + Duration::seconds_f64(index.saturating_add_signed(shift) as f64 / self.rate_hz)
        };
        let span = |p: &Piece| (at(p.kept.label.first_index, p.shift), at(p.kept.end_index(), p.shift));
        Some(self.pieces.iter().map(span).collect())
    }

    /// The files.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        self.pieces.iter().map(|piece| piece.path.clone()).collect()
    }

    /// From the first sample on; index 0 was at `start`, where the card does not tell it.
    pub(super) fn open(&self, start: Option<OffsetDateTime>) -> Reader {
        let end = self.pieces.last().map_or(0, |p| p.kept.end_index().saturating_add_signed(p.shift));
        Reader {
            pieces: self.pieces.clone().into(),
            now: None,
            start: self.utc_of_0().or(start),
            end,
            frames: Vec::new(),
        }
    }
}

/// A file whose recorder knew no time yet has those of the file after it, or before it, of the same start.
fn share_times(pieces: &mut [Piece]) {
    let anew: Vec<bool> = pieces.windows(2).map(|pair| pair[1].kept.begins_anew(&pair[0].kept)).collect();
    let mut share = |from: usize, to: usize, anew: bool| {
        let times = pieces.get(from).map_or([None; 2], |piece| piece.kept.times);
        if let Some(piece) = pieces.get_mut(to).filter(|piece| !anew && piece.kept.times[1].is_none()) {
            piece.kept.times = times;
        }
    };
    anew.iter().enumerate().rev().for_each(|(n, anew)| share(n + 1, n, *anew));
    anew.iter().enumerate().for_each(|(n, anew)| share(n, n + 1, *anew));
}

/// Where each start of the recorder stands.
fn place(pieces: &mut [Piece], rate_hz: f64) {
    let mut before: Option<Piece> = None;
    for piece in pieces {
        if let Some(before) = before {
            piece.shift = before.shift;
            if piece.kept.begins_anew(&before.kept) {
                let end = before.kept.end_index().saturating_add_signed(before.shift) as i64;
                let first = piece.kept.label.first_index as i64;
                let by_clock = before
                    .kept
                    .utc_us(-before.shift)
                    .zip(piece.kept.utc_us(0))
                    .map(|(zero, own)| ((own - zero) * 1e-6 * rate_hz).round() as i64);
                // What a clock says counts if time does not go back by it.
                let by_clock = by_clock.filter(|shift| first + shift >= end);
                piece.shift = by_clock.unwrap_or(end + rate_hz as i64 - first);
            }
        }
        before = Some(piece.clone());
    }
}

/// What is being read of a file.
struct Reading {
    medium: Single,
    kept: Kept,
    gaps: VecDeque<Gap>,
    at: u32,
    index: u64,
    /// Up to here the recorder left samples out on purpose, which is still to be said.
    left_out: Option<u64>,
}

/// The samples of a card.
pub(super) struct Reader {
    pieces: VecDeque<Piece>,
    now: Option<Reading>,
    start: Option<OffsetDateTime>,
    end: u64,
    frames: Vec<Frame>,
}

impl Reading {
    /// The file after another one.
    fn open(piece: Piece, before: Option<&Kept>) -> Result<Self> {
        let medium = Single::open(&piece.path)?;
        let index = piece.kept.label.first_index.saturating_add_signed(piece.shift);
        let left_out = before.is_some_and(|before| piece.kept.is_next_clip(before)).then_some(index);
        Ok(Self { medium, gaps: piece.kept.gaps.clone().into(), kept: piece.kept, at: 0, index, left_out })
    }

    /// Passes over a pause, if one is next: the index at which it ends.
    fn pause(&mut self) -> Option<u64> {
        while let Some(gap) =
            self.gaps.front().copied().filter(|gap| gap.at == self.at && gap.why == Why::Pause)
        {
            self.gaps.pop_front();
            self.index += gap.count;
            self.left_out = Some(self.index);
        }
        self.left_out.take()
    }

    /// Whether nothing is left of it.
    fn is_over(&self) -> bool {
        self.at >= self.kept.frames && self.gaps.is_empty()
    }

    /// Fills `frames` from the next index, which is given back; `None` at the end.
    fn next(&mut self, frames: &mut Vec<Frame>) -> Result<Option<u64>> {
        while let Some(gap) = self.gaps.front_mut().filter(|gap| gap.at == self.at) {
            let damaged = gap.why == Why::Damaged;
            let count = if damaged { gap.count.min(u64::from(FRAMES)) } else { gap.count };
            gap.count -= count;
            if gap.count == 0 {
                self.gaps.pop_front();
            }
            let first = self.index;
            self.index += count;
            if damaged && count > 0 {
                frames.resize(count as usize, [MISSING; CHANNELS]);
                return Ok(Some(first));
            }
        }
        let until =
            self.gaps.front().map_or(self.kept.frames, |gap| gap.at).min(self.at.saturating_add(FRAMES));
        let count = until.saturating_sub(self.at);
        if count == 0 {
            return Ok(None);
        }
        *frames = kept::frames(&mut self.medium, self.at, count as usize)?;
        let first = self.index;
        (self.at, self.index) = (until, first + u64::from(count));
        Ok(Some(first))
    }
}

impl Reader {
    /// Goes on to the next file; whether there is one.
    fn open_next(&mut self) -> Result<bool> {
        let Some(piece) = self.pieces.pop_front() else { return Ok(false) };
        let name = piece.path.display().to_string();
        let before = self.now.take();
        self.now = Some(Reading::open(piece, before.as_ref().map(|b| &b.kept)).context(name)?);
        Ok(true)
    }
}

impl BlockSource for Reader {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        Some(self.end)
    }

    fn left_out(&mut self) -> Result<Option<u64>> {
        while self.now.as_ref().is_none_or(Reading::is_over) {
            if !self.open_next()? {
                break;
            }
        }
        Ok(self.now.as_mut().and_then(Reading::pause))
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        loop {
            self.frames.clear();
            if let Some(reading) = &mut self.now
                && let Some(first_index) = reading.next(&mut self.frames)?
            {
                return Ok(Some(Block { first_index, frames: &self.frames }));
            }
            if !self.open_next()? {
                return Ok(None);
            }
        }
    }
}
