//! A store in flash: records written one after the other into sectors that are erased in turn, so that all wear alike. It
//! opens after power was cut at any write and at any erase.
//!
//! One sector is written (the head), the one after it in the ring is blank or being erased, the others hold what came
//! before. When the head is full the blank one becomes the head, and the oldest is given up: what is kept there of faults
//! and final tracks is brought along, 32 records at most, so that it outlasts everything else; other records there are
//! lost if they were not acknowledged, and counted. A flash cannot be read while it works: what comes meanwhile waits
//! in memory, and is not given out before it is in flash, so that no number is ever used twice.
//!
//! What was acknowledged is noted at the next record, so that power cut before makes it go out again: the other end
//! knows it by its number.

mod entry;
mod model;
mod records;
#[cfg(test)]
mod tests;

pub use model::{Cut, ModelFlash};

use super::ahead;
use super::store::{CLASSES, Class, Ledger, RECORD_BYTES};
use core::cell::Cell;
use core::mem::MaybeUninit;
use entry::{Found, Head, Kind};

/// Bytes of a flash word: what is written, and protected against wrong bits, as one.
pub const WORD_BYTES: usize = 32;
/// A flash word.
pub type Word = [u8; WORD_BYTES];
/// A word that was erased and not written.
pub(super) const ERASED: Word = [0xff; WORD_BYTES];
/// Most sectors of a store.
const MOST_SECTORS: u8 = 16;
/// Records brought along from a sector that is given up.
const MOST_MOVED: u16 = 32;
/// Words before a sector's first record.
const FIRST: u16 = 4;
/// Words at a sector's end that only starts are noted in: as many follow each other before a board waits, each of them while the
/// next sector's erasing is cut short.
const STARTS: u16 = 8;

/// Most words written between two looks at [`Flash::busy`]: a sector is opened, everything is brought along that may be, and
/// what has changed is noted twice.
pub const MOST_WRITES: usize = MOST_MOVED as usize * entry::words(RECORD_BYTES) as usize
    + 2 * CLASSES
    + 2 * entry::words(RECORD_BYTES) as usize;

/// A flash, as a store needs it: words are written once between two erases of their sector, in the order in which they are
/// given. Nothing is read or written while it is busy; a flash that takes its time may put off what it is told until it is
/// next asked whether it is, and must then hold [`MOST_WRITES`] words and an erase, and give out what it holds.
pub trait Flash {
    /// Number of sectors, 3 to 16.
    const SECTORS: u8;
    /// Words of a sector, at least 256.
    const WORDS: u16;

    /// The word at a place; `None` where it cannot be read, because power was cut when it was written or erased.
    fn read(&self, sector: u8, word: u16) -> Option<Word>;

    /// Writes a word.
    fn write(&mut self, sector: u8, word: u16, value: &Word);

    /// Begins to erase a sector, after what was written before.
    fn erase(&mut self, sector: u8);

    /// Whether it writes or erases; begins with what was put off.
    fn busy(&self) -> bool;
}

/// Bits of the text of a record that waits.
const SLOT_BITS: usize = RECORD_BYTES * 8;
/// Where the bits of each class begin, and where the last class's end.
type Marks = [u32; CLASSES + 1];

/// A record that waits in memory until it can be written.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    head: Head,
    text: [u8; RECORD_BYTES],
}

/// The sector that is written.
#[derive(Clone, Copy, Debug)]
struct Writing {
    sector: u8,
    sequence: u32,
    /// The next word.
    word: u16,
}

/// The store; `WAITING` records wait in memory at most.
#[derive(Clone, Debug)]
pub struct FlashStore<F, const WAITING: usize> {
    flash: F,
    ledger: Ledger,
    starts: u32,
    writing: Option<Writing>,
    /// The sector after the one that is written is blank.
    blank: bool,
    erasing: Option<u8>,
    /// Sectors that hold records, as bits.
    live: u16,
    /// Classes whose part of the ledger is not noted in flash.
    unnoted: [bool; CLASSES],
    /// This start is not noted in flash.
    start_unnoted: bool,
    /// Where the record found last stands, by class: sector and word.
    seek: Cell<[(u8, u16); CLASSES]>,
    /// A record that was asked for and cannot be read any more, or the last of several.
    missing: Cell<Option<(Class, u32)>>,
    waiting: [Option<Waiting>; WAITING],
    /// The first of those that wait, and how many.
    first: usize,
    waits: usize,
}

impl<F: Flash, const WAITING: usize> FlashStore<F, WAITING> {
    /// Records that a flash can hold: of a word each.
    const MOST_RECORDS: u32 = F::SECTORS as u32 * F::WORDS as u32;
    /// Bits in the memory of what waits.
    const BITS: u32 = (WAITING * SLOT_BITS) as u32;

    /// Opens what a flash holds, or begins anew where that is nothing; counts the start.
    pub fn open(flash: F) -> Self {
        let mut store = Self::unread(flash);
        store.look(|| {});
        store
    }

    /// The same where the store is to stay: it is too large to be moved over a small stack. `alive` is called at each sector
    /// that was read: a full store takes long enough for a watchdog.
    pub fn open_in(place: &mut MaybeUninit<Self>, flash: F, alive: impl FnMut()) -> &mut Self {
        let store = place.write(Self::unread(flash));
        store.look(alive);
        store
    }

    /// Over a flash of which nothing is known yet.
    #[inline(always)]
    fn unread(flash: F) -> Self {
        Self {
            flash,
            ledger: Ledger::default(),
            starts: 0,
            writing: None,
            blank: false,
            erasing: None,
            live: 0,
            unnoted: [false; CLASSES],
            start_unnoted: false,
            seek: Cell::new([(0, 0); CLASSES]),
            missing: Cell::new(None),
            waiting: [const { None }; WAITING],
            first: 0,
            waits: 0,
        }
    }

    /// Looks what the flash holds.
    fn look(&mut self, mut alive: impl FnMut()) {
        for sector in 0..F::SECTORS.min(MOST_SECTORS) {
            let Some((sequence, ledger, starts)) = self.opened(sector) else { continue };
            self.live |= 1 << sector;
            if self.writing.is_none_or(|w| sequence > w.sequence) {
                self.writing = Some(Writing { sector, sequence, word: FIRST });
                (self.ledger, self.starts) = (ledger, starts);
            }
        }
        if let Some(writing) = self.writing {
            self.go_over(writing);
            alive();
            self.heal(&mut alive);
            self.blank = self.is_blank(next::<F>(writing.sector), writing.sequence);
        }
        self.starts = self.starts.wrapping_add(1);
        self.note_start();
        match self.writing {
            None => self.begin_erase(0),
            Some(writing) if !self.blank => {
                // Where an erase was cut short something was brought along before.
                let marks = self.marks();
                self.mark(&marks, writing.sector);
                alive();
                self.give_up_oldest(Some(&marks));
                self.forget_marks();
            }
            Some(_) => self.open_for_start(),
        }
        alive();
    }

    /// A start that found no room opens the next sector, which says how many there were; else its number would be used twice.
    fn open_for_start(&mut self) {
        if self.start_unnoted
            && self.blank
            && let Some(writing) = self.writing
        {
            self.note();
            self.begin_sector(next::<F>(writing.sector), writing.sequence.wrapping_add(1));
            self.give_up_oldest(None);
        }
    }

    /// Starts of the software so far, this one included.
    pub fn starts(&self) -> u32 {
        self.starts
    }

    /// The flash, to look at.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// The flash, to have its power cut.
    pub fn flash_mut(&mut self) -> &mut F {
        &mut self.flash
    }

    /// The flash, to open it again.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Whether everything it was given is in flash, and nothing is being erased.
    pub fn rests(&self) -> bool {
        self.waits == 0 && !self.flash.busy()
    }

    /// Records that wait in memory.
    pub fn waiting(&self) -> usize {
        self.waits
    }

    /// The sequence number with which a sector was opened, and the ledger then.
    fn opened(&self, sector: u8) -> Option<(u32, Ledger, u32)> {
        let Found::Entry(head, _) = entry::look(&self.flash, sector, 1) else { return None };
        let mut text = [0; RECORD_BYTES];
        let whole = head.kind == Kind::Opened && entry::text(&self.flash, sector, 1, &head, &mut text);
        whole.then(|| {
            let (ledger, starts) = entry::ledger(&text);
            (head.numbers[0], ledger, starts)
        })
    }

    /// Whether a sector was erased to its end after the head was opened, and not written since.
    fn is_blank(&self, sector: u8, sequence: u32) -> bool {
        let mut text = [0; RECORD_BYTES];
        let Found::Entry(head, _) = entry::look(&self.flash, sector, 0) else { return false };
        head.kind == Kind::Blank
            && head.numbers[0] == sequence
            && entry::text(&self.flash, sector, 0, &head, &mut text)
            && (1..FIRST).all(|word| self.flash.read(sector, word) == Some(ERASED))
    }

    /// Goes over the head: the ledger follows what was written, and the next word is found.
    fn go_over(&mut self, mut writing: Writing) {
        let mut text = [0; RECORD_BYTES];
        loop {
            let words = match entry::look(&self.flash, writing.sector, writing.word) {
                Found::End => break,
                Found::Broken(words) => words,
                Found::Entry(head, words) => {
                    if entry::text(&self.flash, writing.sector, writing.word, &head, &mut text) {
                        self.follow(&head, &text);
                    }
                    words
                }
            };
            writing.word = writing.word.saturating_add(words);
        }
        self.writing = Some(writing);
    }

    /// The ledger follows an entry.
    fn follow(&mut self, head: &Head, text: &[u8]) {
        let [a, b, c] = head.numbers;
        match (head.kind, entry::class(head)) {
            (Kind::Record, Some(class)) => {
                if let Some(next) = self.ledger.next.get_mut(class as usize) {
                    *next = a.wrapping_add(1);
                }
                self.ledger.ordinal = b.wrapping_add(1);
            }
            (Kind::Mark, Some(class)) => {
                let of = class as usize;
                let ledger = &mut self.ledger;
                let parts = [&mut ledger.next, &mut ledger.oldest, &mut ledger.lost];
                for (part, number) in parts.into_iter().zip([a, b, c]) {
                    if let Some(to) = part.get_mut(of) {
                        *to = number;
                    }
                }
                let ordinal = text.first_chunk().map_or(0, |b| u32::from_le_bytes(*b));
                if ahead(ordinal, ledger.ordinal) {
                    ledger.ordinal = ordinal;
                }
            }
            (Kind::Start, _) => {
                self.starts = a;
                self.ledger.log = (c != 0).then_some(b);
            }
            _ => {}
        }
    }

    /// What should be kept and is not there any more is lost, and everything of its class before it. Each sector is read once,
    /// whatever is missing.
    fn heal(&mut self, mut alive: impl FnMut()) {
        let marks = self.marks();
        for sector in 0..F::SECTORS.min(MOST_SECTORS) {
            self.mark(&marks, sector);
            alive();
        }
        for class in Class::ALL {
            let of = class as usize;
            let (Some(from), Some(to), Some(next)) =
                (marks.get(of), marks.get(of + 1), self.ledger.next.get(of).copied())
            else {
                continue;
            };
            let there = (*from..*to).take_while(|bit| self.is_marked(*bit)).count() as u32;
            if there < self.ledger.kept(class) {
                self.lose(class, next.wrapping_sub(there).wrapping_sub(1));
            }
        }
        self.forget_marks();
        // What is oldest stands in the oldest sector, or was brought along from it.
        if let Some(writing) = self.writing {
            self.seek.set([(next::<F>(next::<F>(writing.sector)), 0); CLASSES]);
        }
    }

    /// Makes the memory of what waits, while the store opens and nothing does, bits in which records are marked as found.
    fn marks(&mut self) -> Marks {
        const { assert!(Self::BITS >= Self::MOST_RECORDS, "a bit for each record") };
        let numbers = [0; 3];
        for slot in &mut self.waiting {
            let head = Head { kind: Kind::Record, class: 0, length: 0, numbers };
            *slot = Some(Waiting { head, text: [0; RECORD_BYTES] });
        }
        let (mut marks, mut end) = ([0; CLASSES + 1], 0u32);
        for (class, to) in Class::ALL.into_iter().zip(marks.iter_mut().skip(1)) {
            // More cannot be there.
            end = end.saturating_add(self.ledger.kept(class).min(Self::MOST_RECORDS)).min(Self::BITS);
            *to = end;
        }
        marks
    }

    /// The memory is again for what waits.
    fn forget_marks(&mut self) {
        self.waiting.iter_mut().for_each(|slot| *slot = None);
    }

    /// Marks the records of a sector that are kept.
    fn mark(&mut self, marks: &Marks, sector: u8) {
        if self.live >> sector & 1 == 0 {
            return;
        }
        self.each_kept(sector, Class::Spectrum, |store, class, head, _| {
            if let Some(bit) = store.bit(marks, class, head.numbers[0])
                && let Some(Some(slot)) = store.waiting.get_mut(bit as usize / SLOT_BITS)
                && let Some(byte) = slot.text.get_mut(bit as usize % SLOT_BITS / 8)
            {
                *byte |= 1 << (bit % 8);
            }
            0
        });
    }

    /// The bit of a record; the newest of each class come first.
    fn bit(&self, marks: &Marks, class: Class, number: u32) -> Option<u32> {
        let of = class as usize;
        let back = self.ledger.next.get(of)?.wrapping_sub(1).wrapping_sub(number);
        let (from, to) = (*marks.get(of)?, *marks.get(of + 1)?);
        (back < to.saturating_sub(from)).then(|| from.saturating_add(back))
    }

    fn is_marked(&self, bit: u32) -> bool {
        let slot = self.waiting.get(bit as usize / SLOT_BITS).and_then(Option::as_ref);
        let byte = slot.and_then(|slot| slot.text.get(bit as usize % SLOT_BITS / 8));
        byte.is_some_and(|byte| byte >> (bit % 8) & 1 != 0)
    }

    /// A class's records up to this one are lost.
    fn lose(&mut self, class: Class, number: u32) {
        let Some(oldest) = self.ledger.oldest.get(class as usize) else { return };
        let count = number.wrapping_add(1).wrapping_sub(*oldest);
        if count <= self.ledger.kept(class) {
            self.ledger.dropped(class, count, count);
            self.change(class);
        }
    }

    fn change(&mut self, class: Class) {
        if let Some(unnoted) = self.unnoted.get_mut(class as usize) {
            *unnoted = true;
        }
    }

    /// Where a record stands: sector, word and head. Sought from where the last of its class was found. Where it is not there,
    /// the last of those missing with it.
    fn find(&self, class: Class, number: u32) -> Result<(u8, u16, Head), u32> {
        // How far it is to the next that is there.
        let end = self.ledger.next.get(class as usize).copied().unwrap_or(number);
        let waits = self.slots().filter(|w| w.head.class == class as u8).map(|w| w.head.numbers[0]);
        let mut gap = waits.chain([end]).map(|n| n.wrapping_sub(number)).min().unwrap_or(0).max(1);
        let mut seek = self.seek.get();
        let (first, from) = seek.get(class as usize).copied().unwrap_or_default();
        let mut sector = first.min(F::SECTORS.saturating_sub(1));
        // The last turn is the part of the first sector that was left out.
        for turn in 0..=F::SECTORS {
            let (begin, end) = match turn {
                0 => (from, F::WORDS),
                turn if turn == F::SECTORS => (0, from),
                _ => (0, F::WORDS),
            };
            if let Some((word, head)) = self.find_in(sector, (begin, end), class, number, &mut gap) {
                if let Some(at) = seek.get_mut(class as usize) {
                    *at = (sector, word);
                }
                self.seek.set(seek);
                return Ok((sector, word, head));
            }
            sector = next::<F>(sector);
        }
        Err(number.wrapping_add(gap).wrapping_sub(1))
    }

    fn find_in(
        &self,
        sector: u8,
        (begin, end): (u16, u16),
        class: Class,
        number: u32,
        gap: &mut u32,
    ) -> Option<(u16, Head)> {
        if self.live >> sector & 1 == 0 {
            return None;
        }
        let mut word = begin.max(FIRST);
        while word < end {
            word = match entry::look(&self.flash, sector, word) {
                Found::End => return None,
                Found::Broken(words) => word.saturating_add(words),
                Found::Entry(head, words) => {
                    let far = head.numbers[0].wrapping_sub(number);
                    let wanted = matches!(head.kind, Kind::Record | Kind::Moved)
                        && head.class == class as u8
                        && far < *gap;
                    let mut text = [0; RECORD_BYTES];
                    if wanted && entry::text(&self.flash, sector, word, &head, &mut text) {
                        if far == 0 {
                            return Some((word, head));
                        }
                        *gap = far;
                    }
                    word.saturating_add(words)
                }
            };
        }
        None
    }

    /// Writes an entry into the head, where it has room.
    fn write(&mut self, head: &Head, text: &[u8]) -> bool {
        let Some(writing) = self.writing.as_mut() else { return false };
        let words = entry::words(text.len());
        if words > F::WORDS.saturating_sub(writing.word) {
            return false;
        }
        entry::write(&mut self.flash, writing.sector, writing.word, head, text);
        writing.word = writing.word.saturating_add(words);
        true
    }

    /// Notes what has changed of the ledger.
    fn note(&mut self) {
        for class in Class::ALL {
            let of = class as usize;
            let numbers = [self.ledger.next, self.ledger.oldest, self.ledger.lost]
                .map(|part| part.get(of).copied().unwrap_or(0));
            let ordinal = self.ledger.ordinal.to_le_bytes();
            let mark = Head { kind: Kind::Mark, class: of as u8, length: 4, numbers };
            // What waits is not in flash yet: its numbers are noted with it.
            let waits = self.slots().any(|w| w.head.class == of as u8);
            if self.unnoted.get(of) == Some(&true)
                && !waits
                && self.write(&mark, &ordinal)
                && let Some(unnoted) = self.unnoted.get_mut(of)
            {
                *unnoted = false;
            }
        }
    }

    fn note_start(&mut self) {
        let log = self.ledger.log;
        let numbers = [self.starts, log.unwrap_or(0), log.is_some().into()];
        self.start_unnoted = !self.write(&Head { kind: Kind::Start, class: 0, length: 0, numbers }, &[]);
    }

    /// The records that wait, in order.
    fn slots(&self) -> impl Iterator<Item = &Waiting> {
        let (front, back) = self.waiting.split_at_checked(self.first).unwrap_or((&[], &[]));
        back.iter().chain(front).take(self.waits).flatten()
    }

    /// Whether a record could be written now; opens the next sector where the head is full.
    fn has_room(&mut self) -> bool {
        // Room for the longest record, for what changes with it and before the next sector, and for starts.
        let wanted = entry::words(RECORD_BYTES) + 2 * CLASSES as u16 + STARTS;
        loop {
            if self.flash.busy() || self.erasing.is_some() && self.writing.is_none() {
                return false;
            }
            match self.writing {
                Some(writing) if F::WORDS.saturating_sub(writing.word) >= wanted => return true,
                Some(writing) if self.blank => {
                    // What was acknowledged is known even if power goes before the next sector is the head.
                    self.note();
                    self.begin_sector(next::<F>(writing.sector), writing.sequence.wrapping_add(1));
                    self.give_up_oldest(None);
                }
                _ => return false,
            }
        }
    }

    /// A blank sector becomes the head.
    fn begin_sector(&mut self, sector: u8, sequence: u32) {
        // Of what waits nothing is known to the flash yet.
        let mut ledger = self.ledger;
        for waiting in self.slots() {
            if let Some(next) = ledger.next.get_mut(usize::from(waiting.head.class)) {
                *next = if ahead(*next, waiting.head.numbers[0]) { waiting.head.numbers[0] } else { *next };
            }
        }
        ledger.ordinal = self.slots().next().map_or(ledger.ordinal, |w| w.head.numbers[1]);
        let text = entry::of_ledger(&ledger, self.starts);
        let head = Head { kind: Kind::Opened, class: 0, length: text.len() as u8, numbers: [sequence, 0, 0] };
        entry::write(&mut self.flash, sector, 1, &head, &text);
        self.writing = Some(Writing { sector, sequence, word: FIRST });
        self.live |= 1 << sector;
        (self.blank, self.start_unnoted) = (false, false);
    }

    /// Brings along what must outlast the oldest sector, and begins to erase it. Of what is marked that was done before.
    fn give_up_oldest(&mut self, before: Option<&Marks>) {
        let Some(writing) = self.writing else { return };
        let oldest = next::<F>(writing.sector);
        if self.live >> oldest & 1 != 0 {
            let urgent = self.each_kept(oldest, Class::Final, |_, _, _, _| 1);
            let mut left_out = urgent.saturating_sub(MOST_MOVED);
            self.each_kept(oldest, Class::Spectrum, |store, class, head, text| {
                let mut moved = false;
                if class <= Class::Final {
                    let bit = before.and_then(|marks| store.bit(marks, class, head.numbers[0]));
                    moved = bit.is_some_and(|bit| store.is_marked(bit));
                    if moved {
                        left_out = left_out.saturating_sub(1);
                    } else if left_out == 0 {
                        moved = store.write(&Head { kind: Kind::Moved, ..*head }, text);
                    } else {
                        left_out -= 1;
                    }
                }
                if !moved {
                    store.lose(class, head.numbers[0]);
                }
                u16::from(moved)
            });
            self.note();
        }
        self.begin_erase(oldest);
    }

    /// Does something with each record of a sector that is kept, of the classes up to `last`; the sum of what that gives.
    fn each_kept(
        &mut self,
        sector: u8,
        last: Class,
        mut work: impl FnMut(&mut Self, Class, &Head, &[u8]) -> u16,
    ) -> u16 {
        let (mut word, mut sum) = (FIRST, 0u16);
        let mut text = [0; RECORD_BYTES];
        loop {
            let words = match entry::look(&self.flash, sector, word) {
                Found::End => return sum,
                Found::Broken(words) => words,
                Found::Entry(head, words) => {
                    let record = matches!(head.kind, Kind::Record | Kind::Moved);
                    if let Some(class) = entry::class(&head).filter(|class| record && *class <= last)
                        && let Some(oldest) = self.ledger.oldest.get(class as usize)
                        && head.numbers[0].wrapping_sub(*oldest) < self.ledger.kept(class)
                        && entry::text(&self.flash, sector, word, &head, &mut text)
                    {
                        let text = text.get(..usize::from(head.length)).unwrap_or_default();
                        sum = sum.saturating_add(work(self, class, &head, text));
                    }
                    words
                }
            };
            word = word.saturating_add(words);
        }
    }

    fn begin_erase(&mut self, sector: u8) {
        self.live &= !(1 << sector);
        self.blank = false;
        self.erasing = Some(sector);
        self.flash.erase(sector);
    }

    /// What follows when a sector has been erased: that is noted in it, and of an empty flash it becomes the head.
    fn erased(&mut self) {
        let Some(sector) = self.erasing.filter(|_| !self.flash.busy()) else { return };
        self.erasing = None;
        let sequence = self.writing.map_or(0, |w| w.sequence);
        let blank = Head { kind: Kind::Blank, class: 0, length: 0, numbers: [sequence, 0, 0] };
        entry::write(&mut self.flash, sector, 0, &blank, &[]);
        self.blank = true;
        if self.writing.is_none() {
            self.begin_sector(sector, 1);
            self.begin_erase(next::<F>(sector));
        }
        self.open_for_start();
    }

    /// Writes a record and what has changed.
    fn put(&mut self, waiting: &Waiting) -> bool {
        let text = waiting.text.get(..usize::from(waiting.head.length)).unwrap_or_default();
        self.has_room() && self.write(&waiting.head, text)
    }
}

/// The sector after this one in the ring.
fn next<F: Flash>(sector: u8) -> u8 {
    if sector + 1 >= F::SECTORS { 0 } else { sector + 1 }
}
