//! Two places for a station's configuration, of which one is always whole: a new one is written into the other, tried once after
//! a restart, and kept if the recorder came up with it and reached a base station; else the recorder goes back to what it had,
//! and says so.
//!
//! A place is a sector of a flash. Its first words are marks, each written once: the configuration is whole; it has been tried;
//! it is kept; it failed, and why; it was given up; that was told. A mark that cannot be read, because power was cut when it was written,
//! counts against the configuration. So power may be cut at any of these writes.

use crate::config_blob::CRC;
use crate::keeper::{DONE, Done, Keeper, REFUSED};
use crate::wire::configure::{Configure, PIECE_BYTES};
use crate::wire::link::flash::{Flash, WORD_BYTES, Word};
use crate::wire::{Fault, FaultCode};

/// Words of marks before the configuration.
const HEAD: u16 = 8;
/// Bytes before a place's configuration.
pub const HEAD_BYTES: usize = HEAD as usize * WORD_BYTES;
const ERASED: Word = [0xff; WORD_BYTES];
const WORDS_A_PIECE: u16 = (PIECE_BYTES / WORD_BYTES) as u16;
/// Seconds within which a recorder must have samples and have been heard by a base station.
pub const TRIAL_S: u32 = 150;
/// Seconds after a base station was heard in which what is told at a start has come to stand in flash: an erasure of two sectors goes before,
/// 4 s. Until then each start tells it again.
const TOLD_S: u32 = 30;
/// Longest configuration of an array's recorder and of an ocean-bottom recorder, whose propagation table is in it, bytes.
pub const LONGEST: [usize; 2] = [4096, 32_768];

/// What the marks say, by their word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
enum Mark {
    Whole = 0,
    Tried = 1,
    Kept = 2,
    Failed = 3,
    GivenUp = 4,
    Told = 5,
}

/// Why a recorder went back to the configuration before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// It started again before it was kept: a panic, the watchdog, a loss of power.
    StartedAgain = 1,
    /// No samples within the time allowed.
    NoSamples = 2,
    /// The recorder cannot be set up with it.
    Unusable = 3,
    /// What was written cannot be read any more.
    Damaged = 4,
    /// No word from a base station within the time allowed.
    NotReached = 5,
}

impl Reason {
    /// As a mark says it; what cannot be read says that the recorder started again.
    fn of(mark: Option<Word>) -> Self {
        let all = [Self::NoSamples, Self::Unusable, Self::Damaged, Self::NotReached];
        let of = |reason: &Self| mark == Some([*reason as u8; WORD_BYTES]);
        all.into_iter().find(of).unwrap_or(Self::StartedAgain)
    }
}

/// A configuration that was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// Bytes of it in the buffer.
    pub length: usize,
    slot: u8,
    sequence: u32,
    /// It is tried, and not kept yet.
    pub trial: bool,
}

/// What is being received.
#[derive(Clone, Copy, Debug)]
struct Coming {
    length: u32,
    crc: u32,
    /// Number of the next piece.
    next: u16,
}

/// What is under way, and the token of the order that began it.
#[derive(Clone, Copy, Debug)]
enum Work {
    Erase(u8),
    Erasing(u8),
    Write(u8, [[u8; WORD_BYTES]; 3]),
    Writing(u8),
    Check(u8),
    Marking(u8),
    /// The configuration has failed, and the recorder starts again.
    GiveUp(Reason),
    GivingUp(Found),
    /// The recorder is about to start again: nothing more is taken.
    Leaving,
}

/// The two places, in two sectors of a flash.
pub struct Slots<F, C> {
    flash: F,
    /// Whether a configuration could be run here.
    check: C,
    /// Where what is received is put together to be checked.
    scratch: &'static mut [u8],
    /// What the recorder runs with, if not with what was built in.
    running: Option<Found>,
    /// When its trial began.
    since_s: Option<u32>,
    sampled: bool,
    coming: Option<Coming>,
    work: Option<Work>,
    given_up: Option<(u32, Reason)>,
    /// Where what was given up stands, until it is marked as told.
    untold: Option<u8>,
    /// It was said at this start, and a base station heard since so many seconds.
    said: bool,
    heard_s: Option<u32>,
}

fn u32_at(word: &Word, at: usize) -> u32 {
    word.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b))
}

/// The mark of a whole configuration.
fn whole(sequence: u32, length: u32, crc: u32) -> Word {
    let mut word = [0; WORD_BYTES];
    let numbers = [u32::from_le_bytes(*b"SBCS"), sequence, length, crc];
    for (to, from) in word.as_chunks_mut::<4>().0.iter_mut().zip(numbers) {
        *to = from.to_le_bytes();
    }
    let check = CRC.checksum(word.get(..16).unwrap_or_default());
    if let Some(to) = word.get_mut(16..20) {
        to.iter_mut().zip(check.to_le_bytes()).for_each(|(to, from)| *to = from);
    }
    word
}

/// The words of a place that holds a configuration which is kept from the start, as a person with a probe writes them; what follows
/// in the sector is erased. The other place is to be erased too. Cost: one pass over the configuration.
pub fn written(blob: &[u8]) -> impl Iterator<Item = Word> + '_ {
    let mark = |mark: u16| match mark {
        _ if mark == Mark::Whole as u16 => whole(1, blob.len() as u32, CRC.checksum(blob)),
        _ if mark == Mark::Tried as u16 || mark == Mark::Kept as u16 => [mark as u8; WORD_BYTES],
        _ => ERASED,
    };
    let word = |bytes: &[u8]| {
        let mut word = ERASED;
        word.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        word
    };
    (0..HEAD).map(mark).chain(blob.chunks(WORD_BYTES).map(word))
}

impl<F: Flash, C: FnMut(&[u8]) -> bool> Slots<F, C> {
    /// The places in the first two sectors of a flash. What is longer than `scratch` is not taken.
    pub fn new(flash: F, scratch: &'static mut [u8], check: C) -> Self {
        Self {
            flash,
            check,
            scratch,
            running: None,
            since_s: None,
            sampled: false,
            coming: None,
            work: None,
            given_up: None,
            untold: None,
            said: false,
            heard_s: None,
        }
    }

    fn settle(&self) {
        while self.flash.busy() {}
    }

    fn mark(&mut self, slot: u8, mark: Mark, value: u8) {
        let word = [value; WORD_BYTES];
        self.flash.write(slot, mark as u16, &word);
    }

    fn is_blank(&self, slot: u8, mark: Mark) -> bool {
        self.flash.read(slot, mark as u16) == Some(ERASED)
    }

    /// The sequence number, length and CRC of what a place holds, if it is whole.
    fn held(&self, slot: u8) -> Option<(u32, u32, u32)> {
        let word = self.flash.read(slot, Mark::Whole as u16)?;
        let [sequence, length, crc] = [4, 8, 12].map(|at| u32_at(&word, at));
        (word == whole(sequence, length, crc)).then_some((sequence, length, crc))
    }

    /// Copies what a place holds into `into`; its length if it is as it was written.
    fn copy(&self, slot: u8, (length, crc): (u32, u32), into: &mut [u8]) -> Option<usize> {
        let to = into.get_mut(..length as usize)?;
        for (word, to) in (HEAD..F::WORDS).zip(to.chunks_mut(WORD_BYTES)) {
            let from = self.flash.read(slot, word)?;
            to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
        }
        (CRC.checksum(to) == crc).then_some(length as usize)
    }

    /// What to run with, copied into `into`, or `None`: what was built in. What is given up for it is the [`Keeper::news`].
    /// Called once, at the start, before anything else uses the flash; it waits for what it writes.
    pub fn choose(&mut self, into: &mut [u8]) -> Option<Found> {
        self.settle();
        let mut newest = [0, 1].map(|slot| self.held(slot).map(|held| (held, slot)));
        newest.sort_unstable_by_key(|of| core::cmp::Reverse(of.map_or(0, |(held, _)| held.0)));
        for ((sequence, length, crc), slot) in newest.into_iter().flatten() {
            let [tried, kept, failed, given_up, told] =
                [Mark::Tried, Mark::Kept, Mark::Failed, Mark::GivenUp, Mark::Told]
                    .map(|mark| self.flash.read(slot, mark as u16));
            let is = |mark: Option<Word>| mark != Some(ERASED);
            if is(given_up) {
                if !is(told) {
                    self.gave_up(slot, sequence, Reason::of(given_up));
                }
                continue;
            }
            let lost = is(tried) && kept != Some([Mark::Kept as u8; WORD_BYTES]);
            let reason = match self.copy(slot, (length, crc), into) {
                _ if is(failed) || lost => Reason::of(failed),
                None => Reason::Damaged,
                Some(length) if !into.get(..length).is_some_and(&mut self.check) => Reason::Unusable,
                Some(length) => {
                    let trial = !is(tried);
                    if trial {
                        self.mark(slot, Mark::Tried, Mark::Tried as u8);
                        self.settle();
                        // What cannot be marked could hang again and again.
                        if self.is_blank(slot, Mark::Tried) {
                            continue;
                        }
                    }
                    self.running = Some(Found { length, slot, sequence, trial });
                    return self.running;
                }
            };
            self.mark(slot, Mark::GivenUp, reason as u8);
            self.settle();
            self.gave_up(slot, sequence, reason);
        }
        None
    }

    /// To be told, if nothing newer is.
    fn gave_up(&mut self, slot: u8, sequence: u32, reason: Reason) {
        if self.given_up.is_none() {
            (self.given_up, self.untold) = (Some((sequence, reason)), Some(slot));
        }
    }

    /// Marks what was given up as told, once it must have come to stand in flash.
    fn mark_told(&mut self, now_s: u32, reached: bool) {
        let Some(slot) = self.untold.filter(|_| self.said && reached && self.work.is_none()) else { return };
        let heard_s = *self.heard_s.get_or_insert(now_s);
        if now_s.wrapping_sub(heard_s) >= TOLD_S && !self.flash.busy() {
            self.mark(slot, Mark::Told, Mark::Told as u8);
            self.untold = None;
        }
    }

    /// What the recorder runs with, if not with what was built in.
    pub fn running(&self) -> Option<Found> {
        self.running
    }

    /// The recorder cannot be set up with what it runs with.
    pub fn give_up(&mut self) {
        if self.running.is_some() {
            self.work = Some(Work::GiveUp(Reason::Unusable));
        }
    }

    fn spare(&self) -> u8 {
        self.running.map_or(0, |found| 1 - found.slot.min(1))
    }

    /// Takes an order; [`Slots::work`] answers it. While one is under way, or a configuration is tried, others are refused.
    pub fn take(&mut self, order: &Configure) -> Option<Done> {
        let token = order.token();
        let refused = Some(Done::Reply(token, REFUSED));
        let room = self.scratch.len().min(usize::from(F::WORDS.saturating_sub(HEAD)) * WORD_BYTES);
        if self.work.is_some() || self.running.is_some_and(|found| found.trial) {
            return refused;
        }
        self.work = match (*order, &mut self.coming) {
            (Configure::Begin { length, crc, .. }, coming) if length > 0 && length as usize <= room => {
                *coming = Some(Coming { length, crc, next: 0 });
                Some(Work::Erase(token))
            }
            (Configure::Piece { number, bytes, .. }, Some(coming))
                if number == coming.next
                    && usize::from(number) < (coming.length as usize).div_ceil(PIECE_BYTES) =>
            {
                Some(Work::Write(token, bytes))
            }
            (Configure::Take { .. }, Some(coming))
                if usize::from(coming.next) == (coming.length as usize).div_ceil(PIECE_BYTES) =>
            {
                Some(Work::Check(token))
            }
            _ => return refused,
        };
        None
    }

    /// Does what is due; never waits for the flash.
    pub fn work(&mut self, now_s: u32, reached: bool) -> Option<Done> {
        self.mark_told(now_s, reached);
        if let Some(found) = self.running.filter(|found| found.trial && self.work.is_none()) {
            let since_s = *self.since_s.get_or_insert(now_s);
            let late = now_s.wrapping_sub(since_s) >= TRIAL_S;
            match (self.sampled, reached) {
                (true, true) if !self.flash.busy() => {
                    self.mark(found.slot, Mark::Kept, Mark::Kept as u8);
                    self.running = Some(Found { trial: false, ..found });
                }
                (true, true) => {}
                (false, _) if late => self.work = Some(Work::GiveUp(Reason::NoSamples)),
                (true, false) if late => self.work = Some(Work::GiveUp(Reason::NotReached)),
                _ => {}
            }
        }
        let work = self.work?;
        if self.flash.busy() {
            return None;
        }
        let spare = self.spare();
        let (next, done) = match work {
            Work::Erase(token) => {
                // Its marks go too.
                self.untold = self.untold.filter(|slot| *slot != spare);
                self.flash.erase(spare);
                (Some(Work::Erasing(token)), None)
            }
            Work::Write(token, bytes) => {
                let coming = self.coming.as_mut()?;
                let first = HEAD.saturating_add(coming.next.saturating_mul(WORDS_A_PIECE));
                coming.next = coming.next.saturating_add(1);
                for (word, bytes) in (first..F::WORDS).zip(&bytes) {
                    self.flash.write(spare, word, bytes);
                }
                (Some(Work::Writing(token)), None)
            }
            Work::Erasing(token) | Work::Writing(token) => (None, Some(Done::Reply(token, DONE))),
            Work::Check(token) if self.is_good(spare) => (Some(Work::Marking(token)), None),
            Work::Check(token) => {
                self.coming = None;
                (None, Some(Done::Reply(token, REFUSED)))
            }
            Work::Marking(token) => (Some(Work::Leaving), Some(Done::Restart(Some(token)))),
            Work::GiveUp(reason) => {
                let found = self.running?;
                self.mark(found.slot, Mark::Failed, reason as u8);
                (Some(Work::GivingUp(found)), None)
            }
            // A flash that takes no mark would start it again and again.
            Work::GivingUp(found) if self.is_blank(found.slot, Mark::Failed) => {
                self.running = Some(Found { trial: false, ..found });
                (None, None)
            }
            Work::GivingUp(_) => (Some(Work::Leaving), Some(Done::Restart(None))),
            Work::Leaving => return None,
        };
        self.work = next;
        done
    }

    /// Whether what was received is what was announced and could be run; then it is marked as whole.
    fn is_good(&mut self, spare: u8) -> bool {
        let Some(Coming { length, crc, .. }) = self.coming else { return false };
        let scratch = core::mem::take(&mut self.scratch);
        let copied = self.copy(spare, (length, crc), scratch);
        let good = copied.and_then(|n| scratch.get(..n)).is_some_and(&mut self.check);
        self.scratch = scratch;
        if good {
            let held = [0, 1].map(|slot| self.held(slot).map_or(0, |held| held.0));
            let sequence = held.into_iter().fold(0, u32::max).saturating_add(1);
            self.flash.write(spare, Mark::Whole as u16, &whole(sequence, length, crc));
        }
        good
    }
}

impl<F: Flash, C: FnMut(&[u8]) -> bool> Keeper for Slots<F, C> {
    fn take(&mut self, order: &Configure) -> Option<Done> {
        Slots::take(self, order)
    }

    fn work(&mut self, now_s: u32, reached: bool) -> Option<Done> {
        Slots::work(self, now_s, reached)
    }

    fn sampled(&mut self) {
        self.sampled = true;
    }

    fn news(&mut self) -> Option<Fault> {
        let (sequence, reason) = self.given_up.take()?;
        self.said = true;
        Some(Fault { code: FaultCode::RolledBack, index: 0, value: i64::from(sequence) << 8 | reason as i64 })
    }
}

#[cfg(test)]
mod tests;
