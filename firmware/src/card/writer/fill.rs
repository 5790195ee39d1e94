//! Samples into the ring.

use super::super::layout::{FRAME_BYTES, Why, bytes_of};
use super::super::search::Found;
use super::super::sheet::Sheet;
use super::super::{Drive, PAGE, SECTOR, Trouble};
use super::{Meta, State, Writer};
use core::ops::Range;
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::utc::{Pair, along};
use seabearing_core::wire::Time;

/// Seconds from one to the other of the two points that tell a file's line of UTC.
const APART_S: u64 = 100;

impl<D: Drive> Writer<'_, D> {
    /// Takes consecutive samples.
    pub fn take(&mut self, first_index: u64, frames: &[Frame]) {
        if frames.is_empty() || self.finished {
            return;
        }
        let expected = self.expected.replace(first_index.saturating_add(frames.len() as u64));
        match expected {
            Some(expected) if first_index > expected => self.lack(expected..first_index),
            // Time begins again, and with it a file.
            Some(expected) if first_index < expected => self.close(),
            _ => {}
        }
        let (mut index, mut rest) = (first_index, frames);
        while let Some((frame, after)) = rest.split_first() {
            let run = self.put_run(index, rest);
            if run > 0 {
                (index, rest) = (index + run as u64, rest.get(run..).unwrap_or_default());
                continue;
            }
            if frame.contains(&MISSING) {
                self.miss(Why::Damaged, 1, index);
            } else if index < self.until || !self.has_room() {
                self.miss(Why::Card, 1, index);
            } else {
                self.put(index, frame);
            }
            (index, rest) = (index + 1, after);
        }
    }

    /// Puts in what fits into the page without ending it or the file; how many instants.
    fn put_run(&mut self, index: u64, frames: &[Frame]) -> usize {
        if self.overrun || index < self.until {
            return 0;
        }
        let Some(Some(sheet)) = self.tables.sheets.get_mut(self.filling) else { return 0 };
        let Some(place) = self.pages.get_mut(self.head).and_then(|page| page.get_mut(self.at..PAGE - 1))
        else {
            return 0;
        };
        if sheet.closed {
            return 0;
        }
        let room = sheet.room().saturating_sub(1) as usize;
        let places = place.as_chunks_mut().0.iter_mut().take(room);
        let good = frames.iter().take_while(|frame| !frame.contains(&MISSING));
        let run = places.zip(good).map(|(to, frame)| *to = bytes_of(frame)).count();
        sheet.frames += run as u32;
        self.at += run * FRAME_BYTES;
        run
    }

    /// These samples are not wanted: what is missing of them is no gap.
    pub fn rest(&mut self, samples: Range<u64>) {
        self.rests = samples;
    }

    /// These samples did not come.
    fn lack(&mut self, Range { start, end }: Range<u64>) {
        let rests = self.rests.start.clamp(start, end)..self.rests.end.clamp(start, end);
        for (why, from, to) in [
            (Why::Gap, start, rests.start),
            (Why::Pause, rests.start, rests.end),
            (Why::Gap, rests.end.max(rests.start), end),
        ] {
            if from < to {
                self.miss(why, to - from, from);
            }
        }
    }

    /// Something was heard about this sample.
    pub fn heard(&mut self, index: u64) {
        let filling = self.filling;
        self.sheet_mut(filling).into_iter().for_each(|sheet| sheet.heard(index));
        if let Some(claim) = self.tables.claims.heard(index) {
            self.tables.sheets.iter_mut().flatten().for_each(|sheet| sheet.claim(&claim));
        }
    }

    /// UTC is known so from now on, as the recorder tells it.
    pub fn told(&mut self, time: &Time) {
        let rate_hz = f64::from(self.about.rate_hz);
        let pair = |index: u64| {
            let (utc_us, sd_s) = along(time, index, rate_hz);
            Pair { index, utc_us, sd_s }
        };
        self.times =
            [0, APART_S].map(|s| Some(pair(time.index.saturating_add(s * u64::from(self.about.rate_hz)))));
        let (filling, times) = (self.filling, self.times);
        self.sheet_mut(filling).into_iter().for_each(|sheet| sheet.times = times);
    }

    /// No more comes: what is there is written, and the file ended.
    pub fn finish(&mut self) {
        self.finished = true;
        self.close();
    }

    /// Whether an instant finds room in the ring, and a file.
    fn has_room(&mut self) -> bool {
        if !self.open() {
            return false;
        }
        let free = self.pages.len().saturating_sub(self.waiting);
        if self.overrun {
            self.overrun = free <= self.pages.len() / 2;
        } else if self.at + FRAME_BYTES >= PAGE && free < 2 {
            if self.seeks() && self.writing == self.filling {
                // A card that starts slowly: the sound on it begins later.
                self.abandon();
                return self.open();
            }
            self.overrun = true;
            self.tell(Trouble::Stalled);
        }
        !self.overrun
    }

    /// Whether there is a file for the next sample, or may be.
    fn open(&mut self) -> bool {
        let starts = !matches!(self.state, State::Off { .. });
        let possible = starts && (self.next.is_some() || !self.full);
        match self.sheet(self.filling) {
            Some(sheet) if !sheet.closed => return true,
            // The other one may still be written, a third not.
            Some(_) if possible && self.sheet(self.filling ^ 1).is_none() => self.filling ^= 1,
            Some(_) => return false,
            None => {}
        }
        possible
    }

    /// Whether what is filled has no file yet.
    pub(super) fn seeks(&self) -> bool {
        self.sheet(self.filling).is_some_and(|sheet| sheet.found.is_none())
    }

    /// Gives up what is filled and has no file; all of the ring is its.
    pub(super) fn abandon(&mut self) {
        let filling = self.filling;
        let frames = self.sheet(filling).map_or(0, |sheet| sheet.frames);
        self.lose(frames.into());
        self.tables.drop_sheet(filling);
        (self.tail, self.waiting, self.at, self.page) = (self.head, 0, SECTOR, 0);
    }

    /// Begins a file with the sample of this index.
    // Apart: its sheet passes over the stack, which must not stay taken.
    #[inline(never)]
    fn begin_file(&mut self, found: Option<Found>, index: u64) {
        let filling = self.filling;
        if let Some(sheet) = self.tables.sheets.get_mut(filling) {
            let claimed = self.tables.claims.reaches(index);
            *sheet = Some(Sheet { claimed, times: self.times, ..Sheet::new(found, index) });
        }
        found.into_iter().for_each(|found| self.took(found));
        (self.at, self.page) = (SECTOR, 0);
        if self.sheet(filling ^ 1).is_none() {
            (self.writing, self.known) = (filling, super::Known::default());
        }
    }

    /// Samples from `index` on are not put in.
    fn miss(&mut self, why: Why, count: u64, index: u64) {
        if why == Why::Card {
            self.lose(count);
        }
        let filling = self.filling;
        let Some(sheet) = self.sheet_mut(filling) else { return };
        if sheet.closed {
            return;
        }
        let begun = sheet.gaps.last().is_none_or(|last| last.at != sheet.frames);
        let apart = sheet.apart();
        if sheet.miss(why, count) {
            self.version = self.version.wrapping_add(1);
            if begun {
                self.until = self.until.max(index.saturating_add(apart));
            }
        } else {
            self.close();
        }
    }

    fn put(&mut self, index: u64, frame: &Frame) {
        if self.sheet(self.filling).is_none() {
            let found = self.next.take();
            self.begin_file(found, index);
        }
        let bytes = bytes_of(frame);
        let Some(page) = self.pages.get_mut(self.head) else { return };
        if let Some(place) = page.get_mut(self.at..self.at + bytes.len()) {
            place.copy_from_slice(&bytes);
            self.at += bytes.len();
            if self.at == PAGE {
                self.count();
                self.complete();
                return self.end_if_full();
            }
        } else {
            let (here, rest) = bytes.split_at(PAGE.saturating_sub(self.at).min(bytes.len()));
            if let Some(place) = page.get_mut(self.at..) {
                place.copy_from_slice(here);
            }
            self.at = PAGE;
            self.complete();
            if let Some(place) = self.pages.get_mut(self.head).and_then(|page| page.get_mut(..rest.len())) {
                place.copy_from_slice(rest);
            }
            self.at = rest.len();
        }
        self.count();
        self.end_if_full();
    }

    fn count(&mut self) {
        let filling = self.filling;
        if let Some(sheet) = self.sheet_mut(filling) {
            sheet.frames += 1;
        }
    }

    fn end_if_full(&mut self) {
        if self.sheet(self.filling).is_some_and(|sheet| sheet.room() == 0) {
            self.close();
        }
    }

    /// The page being filled waits for the card now.
    fn complete(&mut self) {
        let bytes = self.at.next_multiple_of(SECTOR).min(PAGE);
        if let Some(rest) = self.pages.get_mut(self.head).and_then(|page| page.get_mut(self.at..bytes)) {
            rest.fill(0);
        }
        let frames = self.sheet(self.filling).map_or(0, |sheet| sheet.frames);
        let meta = Meta { sheet: self.filling, page: self.page, bytes, frames, version: self.version };
        if let Some(place) = self.tables.metas.get_mut(self.head) {
            *place = meta;
        }
        self.waiting += 1;
        self.head = (self.head + 1) % self.pages.len().max(1);
        (self.at, self.page) = (0, self.page + 1);
    }

    /// Nothing more goes into the file being filled.
    fn close(&mut self) {
        let least = if self.page == 0 { SECTOR } else { 0 };
        let filling = self.filling;
        let Some(sheet) = self.sheet_mut(filling) else { return };
        if core::mem::replace(&mut sheet.closed, true) {
            return;
        }
        if self.at > least {
            self.complete();
        }
        (self.at, self.page) = (SECTOR, 0);
    }
}
