//! The recorder of sound: samples into a ring of pages in RAM, pages onto the card one after the other, and between them
//! what makes a file of them.
//!
//! [`Writer::take`] only copies; [`Writer::work`] asks the driver and, where it rests, begins the next thing:
//!
//! 1. a slot, before the sound after something missing is written, and before a file's first sound;
//! 2. slot and sector 0, every two seconds and at a file's end;
//! 3. the oldest page that waits;
//! 4. the search for the next unused file, so that it is known long before it is wanted.

use super::clips::{Claims, Clips};
use super::layout::{self, Label, Slot};
use super::search::{Found, STAGE_BYTES, Search, Want};
use super::sheet::Sheet;
use super::{Drive, PAGE, PAGE_SECTORS, Progress, SECTOR, Trouble};
use core::ops::Range;
use seabearing_core::utc::Pair;
mod fill;

/// Most pages of a ring.
pub const MOST_RING: usize = 64;
/// From one telling of a file's length to the next.
const COMMIT_US: u64 = 2_000_000;
/// From a failure to the next attempt, the first time and from then on.
const RETRY_US: [u64; 2] = [1_000_000, 10_000_000];
/// From an error of the card or its line to the next attempt while sound can wait, and how many there are: the ring lasts for them.
const AGAIN_US: u64 = 50_000;
const MOST_TRIES: u8 = 6;
/// The same with a card that is full: somebody may have changed it.
const FULL_RETRY_US: u64 = 60_000_000;

/// Something about the card that is to be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// It takes no sound; so many instants were not recorded since it last took any.
    Failed(Trouble, u64),
    /// It takes sound again, after so many instants.
    Back(u64),
    /// All its files are used; it has taken so many instants of this start.
    Full(u64),
}

/// Whose sound it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct About {
    /// The recorder's start.
    pub session: u32,
    /// The station.
    pub station: u16,
    /// Samples a second.
    pub rate_hz: u32,
    /// Hash of its configuration.
    pub config_hash: u64,
    /// Which sound is kept.
    pub clips: Clips,
}

/// What is known of the card, of the files being written, and of the ring's pages: too much for the stack.
#[derive(Debug)]
pub struct Tables {
    search: Search,
    sheets: [Option<Sheet>; 2],
    claims: Claims,
    metas: [Meta; MOST_RING],
}

impl Tables {
    /// Of no card.
    pub const fn new() -> Self {
        Self {
            search: Search::new(),
            sheets: [const { None }; 2],
            claims: Claims::new(),
            metas: [Meta::NONE; MOST_RING],
        }
    }

    /// Nothing more of this sheet, which is too large to be moved over the stack.
    fn drop_sheet(&mut self, which: usize) {
        self.sheets.get_mut(which).into_iter().for_each(|sheet| *sheet = None);
    }
}

impl Default for Tables {
    fn default() -> Self {
        Self::new()
    }
}

/// What a page of the ring holds.
#[derive(Clone, Copy, Debug, Default)]
struct Meta {
    /// Which of the sheets, and which page of its file.
    sheet: usize,
    page: u32,
    /// Bytes in it.
    bytes: usize,
    /// Whole instants of the file up to its end.
    frames: u32,
    /// Changes of the sheet's list before its end.
    version: u32,
}

impl Meta {
    const NONE: Self = Self { sheet: 0, page: 0, bytes: 0, frames: 0, version: 0 };
}

/// What the driver is doing for us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Doing {
    Nothing,
    Read(u32),
    Page,
    /// A slot; sector 0 follows, or not.
    Slot {
        head: bool,
    },
    Head,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off {
        retry_us: u64,
    },
    On,
    /// It made an error: it is started again, and what was under way begun once more.
    Again {
        retry_us: u64,
    },
}

/// How far the file being written is known on the card.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    sequence: u32,
    /// Changes of the list that a slot says; `None` before the first.
    version: Option<u32>,
    /// Instants that sector 0 says.
    frames: u32,
    /// The last slot said that no more follows.
    closed: bool,
    /// Sector 0 of a file that is filled again says that nothing is in it.
    emptied: bool,
    due_us: u64,
}

/// The recorder of sound.
#[derive(Debug)]
pub struct Writer<'a, D> {
    drive: D,
    pages: &'a mut [[u8; PAGE]],
    stage: &'a mut [u8; STAGE_BYTES],
    tables: &'a mut Tables,
    about: About,
    state: State,
    doing: Doing,
    /// The next file, once it was found, or that there is none.
    next: Option<Found>,
    full: bool,
    /// Page being filled, its bytes, its place in the file; the oldest that waits, and how many do.
    head: usize,
    at: usize,
    page: u32,
    tail: usize,
    waiting: usize,
    /// Sheets being filled and written.
    filling: usize,
    writing: usize,
    /// Changes of the filled sheet's list.
    version: u32,
    known: Known,
    /// Index of the next sample if none is missing.
    expected: Option<u64>,
    /// The newest line of UTC.
    times: [Option<Pair>; 2],
    /// Samples that are left out on purpose.
    rests: Range<u64>,
    /// Samples before this index are given up.
    until: u64,
    /// The ring was full and is not half empty yet.
    overrun: bool,
    finished: bool,
    /// Instants not recorded since the start, and since the card last took any; those that were.
    lost: u64,
    missed: u64,
    recorded: u64,
    /// What the card's trouble was when it was last told.
    told: Option<Trouble>,
    told_full: bool,
    /// It has failed and taken no sound since.
    failing: bool,
    /// Errors in a row.
    tries: u8,
    event: Option<Event>,
}

impl<'a, D: Drive> Writer<'a, D> {
    /// With a ring of as many pages, [`MOST_RING`] at most; the card is started at the first [`Self::work`].
    pub fn new(
        drive: D,
        pages: &'a mut [[u8; PAGE]],
        stage: &'a mut [u8; STAGE_BYTES],
        tables: &'a mut Tables,
        about: About,
    ) -> Self {
        let count = pages.len().min(MOST_RING);
        tables.claims.begin(about.clips);
        Self {
            drive,
            pages: pages.split_at_mut(count).0,
            stage,
            tables,
            about,
            state: State::Off { retry_us: 0 },
            doing: Doing::Nothing,
            next: None,
            full: false,
            head: 0,
            at: SECTOR,
            page: 0,
            tail: 0,
            waiting: 0,
            filling: 0,
            writing: 0,
            version: 0,
            known: Known::default(),
            expected: None,
            times: [None; 2],
            rests: 0..0,
            until: 0,
            overrun: false,
            finished: false,
            lost: 0,
            missed: 0,
            recorded: 0,
            told: None,
            told_full: false,
            failing: false,
            tries: 0,
            event: None,
        }
    }

    /// What is to be told, once.
    pub fn event(&mut self) -> Option<Event> {
        self.event.take()
    }

    /// Whether everything taken is on the card, or cannot be.
    pub fn rests(&self) -> bool {
        self.doing == Doing::Nothing && self.tables.sheets.iter().all(Option::is_none)
    }

    /// Instants that are not on the card and will not be, so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Instants that the card has taken.
    pub fn recorded(&self) -> u64 {
        self.recorded
    }

    /// The driver.
    pub fn drive(&self) -> &D {
        &self.drive
    }

    fn tell(&mut self, trouble: Trouble) {
        if self.told.replace(trouble) != Some(trouble) {
            self.event = Some(Event::Failed(trouble, self.missed));
        }
    }

    fn lose(&mut self, count: u64) {
        self.lost = self.lost.saturating_add(count);
        self.missed = self.missed.saturating_add(count);
    }

    fn sheet(&self, which: usize) -> Option<&Sheet> {
        self.tables.sheets.get(which)?.as_ref()
    }

    fn sheet_mut(&mut self, which: usize) -> Option<&mut Sheet> {
        self.tables.sheets.get_mut(which)?.as_mut()
    }

    /// Goes on with the card: to be called every few milliseconds.
    pub fn work(&mut self) {
        let now_us = self.drive.now_us();
        if let State::Off { retry_us } = self.state {
            if now_us >= retry_us && !self.finished {
                self.drive.restart();
                self.tables.search.begin();
                self.tables.claims.forget_files();
                (self.state, self.next, self.full) = (State::On, None, false);
            }
            return;
        }
        if let State::Again { retry_us } = self.state {
            if now_us >= retry_us {
                self.drive.restart();
                self.state = State::On;
            }
            return;
        }
        match self.drive.poll() {
            Progress::Working => {}
            Progress::Failed(Trouble::Errors) if self.can_try_again() => self.again(now_us),
            Progress::Failed(trouble) => self.fail(trouble, now_us),
            Progress::Rests => {
                self.done();
                self.begin(now_us);
            }
        }
    }

    /// Whether sound can wait for another attempt.
    fn can_try_again(&self) -> bool {
        self.tries < MOST_TRIES && 4 * self.waiting < 3 * self.pages.len() && !self.failing
    }

    /// The same once more, in a while.
    fn again(&mut self, now_us: u64) {
        self.tries += 1;
        if matches!(self.doing, Doing::Slot { .. } | Doing::Head) {
            // Whether it came through nobody knows.
            self.known.version = None;
        }
        (self.doing, self.state) = (Doing::Nothing, State::Again { retry_us: now_us + AGAIN_US });
    }

    /// Gives the card up for a while, and with it what waits.
    fn fail(&mut self, trouble: Trouble, now_us: u64) {
        let waits = |sheet: &Sheet| u64::from(sheet.frames - sheet.acknowledged.min(sheet.frames));
        self.lose(self.tables.sheets.iter().flatten().map(waits).sum());
        (0..2).for_each(|which| self.tables.drop_sheet(which));
        (self.doing, self.next, self.full) = (Doing::Nothing, None, false);
        (self.tail, self.waiting, self.at, self.overrun) = (self.head, 0, SECTOR, false);
        let [first, then] = RETRY_US;
        let wait_us = if core::mem::replace(&mut self.failing, true) { then } else { first };
        self.state = State::Off { retry_us: now_us + wait_us };
        self.tell(trouble);
    }

    /// What was begun is on the card, or was read.
    fn done(&mut self) {
        match core::mem::replace(&mut self.doing, Doing::Nothing) {
            Doing::Nothing => {}
            Doing::Read(sectors) => {
                let bytes = self.stage.get(..sectors as usize * SECTOR).unwrap_or_default();
                self.tables.search.take(bytes);
            }
            Doing::Page => {
                let meta = self.tables.metas.get(self.tail).copied().unwrap_or_default();
                if let Some(sheet) = self.sheet_mut(meta.sheet) {
                    let before = core::mem::replace(&mut sheet.acknowledged, meta.frames);
                    self.recorded += u64::from(meta.frames.saturating_sub(before));
                }
                self.tail = (self.tail + 1) % self.pages.len().max(1);
                self.waiting = self.waiting.saturating_sub(1);
                self.tries = 0;
                if !self.overrun {
                    let missed = core::mem::take(&mut self.missed);
                    (self.told_full, self.failing) = (false, false);
                    if self.told.take().is_some() {
                        self.event = Some(Event::Back(missed));
                    }
                }
            }
            Doing::Slot { head: true } => self.begin_head(),
            Doing::Slot { head: false } => {}
            Doing::Head => {
                if self.known.closed {
                    let sheet = self.sheet(self.writing).filter(|sheet| !sheet.claimed && !self.finished);
                    let unclaimed = sheet.and_then(|sheet| Some((sheet.found?, sheet.samples())));
                    if let Some((found, samples)) = unclaimed {
                        let found = Found { sequence: self.known.sequence, ..found };
                        self.tables.claims.hold(found, samples);
                    }
                    self.tables.drop_sheet(self.writing);
                    self.writing ^= 1;
                    self.known = Known::default();
                }
            }
        }
    }

    /// Begins what is wanted most.
    fn begin(&mut self, now_us: u64) {
        if self.doing != Doing::Nothing {
            return;
        }
        let meta = self.tables.metas.get(self.tail).copied().filter(|_| self.waiting > 0);
        let ours = meta.filter(|meta| meta.sheet == self.writing);
        if let Some(sheet) = self.sheet(self.writing).filter(|sheet| sheet.found.is_some()) {
            let told = self.known.frames;
            let all = sheet.closed && ours.is_none();
            let behind =
                ours.is_some_and(|meta| self.known.version.is_none_or(|version| version < meta.version));
            let due = now_us >= self.known.due_us && sheet.acknowledged > told;
            let hurried = self.waiting > self.pages.len() / 2;
            if self.known.version.is_none() && sheet.is_again() && !self.known.emptied {
                self.known.emptied = true;
                return self.begin_head();
            }
            if self.known.version.is_none() || all || due && !hurried {
                return self.begin_slot(all, true, now_us);
            }
            if behind {
                return self.begin_slot(false, false, now_us);
            }
            if let Some(meta) = ours {
                return self.begin_page(meta);
            }
        }
        if !self.finished || self.seeks() {
            self.look(now_us);
        }
    }

    fn begin_page(&mut self, meta: Meta) {
        let from = if meta.page == 0 { SECTOR } else { 0 };
        let Some(found) = self.sheet(meta.sheet).and_then(|sheet| sheet.found) else { return };
        let sector = found.extent.first + meta.page * PAGE_SECTORS + (from / SECTOR) as u32;
        let Some(bytes) = self.pages.get(self.tail).and_then(|page| page.get(from..meta.bytes)) else {
            return;
        };
        self.drive.begin_write(sector, bytes);
        self.doing = Doing::Page;
    }

    fn label(&self, sheet: &Sheet) -> Label {
        Label {
            file: sheet.found.map_or(0, |found| found.number),
            session: self.about.session,
            station: self.about.station,
            rate_hz: self.about.rate_hz,
            config_hash: self.about.config_hash,
            first_index: sheet.first_index,
        }
    }

    fn begin_slot(&mut self, closed: bool, head: bool, now_us: u64) {
        let Some(sheet) = self.sheet(self.writing) else { return };
        let Some(found) = sheet.found else { return };
        let sequence = self.known.sequence.max(found.sequence) + 1;
        let slot = Slot {
            sequence,
            used: true,
            closed,
            again: sheet.is_again(),
            clips: self.about.clips.are_kept(),
            label: self.label(sheet),
            frames: sheet.acknowledged,
            lost: self.lost,
            times: sheet.times,
            detections: sheet.detections,
            first_detection: sheet.first_detection,
        };
        let sector = found.extent.slot(sequence);
        let (version, frames) = (self.version, sheet.acknowledged);
        let Some(sheet) = self.tables.sheets.get(self.writing).and_then(Option::as_ref) else { return };
        let length = slot.encode(&sheet.gaps, self.stage);
        let bytes = self.stage.get(..length.next_multiple_of(SECTOR)).unwrap_or_default();
        self.drive.begin_write(sector, bytes);
        self.doing = Doing::Slot { head };
        let (frames, due_us) =
            if head { (frames, now_us + COMMIT_US) } else { (self.known.frames, self.known.due_us) };
        self.known = Known { sequence, version: Some(version), frames, closed, due_us, ..self.known };
    }

    fn begin_head(&mut self) {
        let Some(sheet) = self.sheet(self.writing) else { return };
        let Some(found) = sheet.found else { return };
        let (label, first) = (self.label(sheet), found.extent.first);
        let Some(place) = self.stage.first_chunk_mut() else { return };
        layout::head(&label, self.known.frames, place);
        self.drive.begin_write(first, place);
        self.doing = Doing::Head;
    }

    /// This file is used from now on.
    fn took(&mut self, found: Found) {
        // One that is filled again does not move the search for unused ones.
        if found.sequence == 0 {
            self.tables.search.after(found.number);
        }
    }

    /// Looks for the next file.
    fn look(&mut self, now_us: u64) {
        if self.seeks()
            && let Some(found) = self.next.take()
        {
            let filling = self.filling;
            self.sheet_mut(filling).into_iter().for_each(|sheet| sheet.found = Some(found));
            self.took(found);
        }
        if self.next.is_none()
            && let Some(index) = self.expected
        {
            self.next = self.tables.claims.again(index);
        }
        if self.next.is_some() {
            return;
        }
        if self.full {
            if self.seeks() {
                self.abandon();
            }
            if self.sheet(self.filling).is_none() {
                if !core::mem::replace(&mut self.told_full, true) {
                    self.event = Some(Event::Full(self.recorded));
                }
                self.state = State::Off { retry_us: now_us + FULL_RETRY_US };
            }
            return;
        }
        match self.tables.search.want() {
            Want::Read(sector, sectors) => {
                if let Some(into) = self.stage.get_mut(..sectors as usize * SECTOR) {
                    self.drive.begin_read(sector, into);
                    self.doing = Doing::Read(sectors);
                }
            }
            Want::Found(found) => self.next = Some(found),
            Want::Full => self.full = true,
            Want::NotPrepared => self.fail(Trouble::NotPrepared, now_us),
        }
    }
}
