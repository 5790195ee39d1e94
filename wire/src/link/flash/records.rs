//! What a link asks of the store: records appended, dropped and read.

use super::super::store::{Class, Kept, Ledger, RECORD_BYTES, Store};
use super::entry::{self, Head, Kind};
use super::{FIRST, Flash, FlashStore, Waiting};

impl<F: Flash, const WAITING: usize> Store for FlashStore<F, WAITING> {
    fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    fn begin(&mut self, log: u32) {
        self.ledger.log = Some(log);
        if !self.flash.busy() {
            self.note_start();
        }
    }

    fn append(&mut self, class: Class, boot: u32, record: &[u8]) -> bool {
        let mut text = [0; RECORD_BYTES];
        let (Some(to), Ok(length)) = (text.get_mut(..record.len()), u8::try_from(record.len())) else {
            return false;
        };
        for (to, from) in to.iter_mut().zip(record) {
            *to = *from;
        }
        self.work();
        // A new sector begins with the ledger: before this record has its number.
        let room = self.waits == 0 && self.has_room();
        let (number, ordinal) = self.ledger.written(class);
        let head = Head { kind: Kind::Record, class: class as u8, length, numbers: [number, ordinal, boot] };
        let waiting = Waiting { head, text };
        if room && self.write(&head, record) {
            self.note();
            return true;
        }
        let at = (self.first + self.waits).checked_rem(WAITING).unwrap_or(0);
        match self.waiting.get_mut(at) {
            Some(slot) if self.waits < WAITING => {
                *slot = Some(waiting);
                self.waits += 1;
            }
            // No room in memory either: the flash has been busy for too long.
            _ => self.lose(class, number),
        }
        true
    }

    fn pass(&mut self, class: Class) {
        self.ledger.written(class);
        self.ledger.dropped(class, 1, 1);
        self.change(class);
    }

    fn drop_oldest(&mut self, class: Class, count: u32, lost: u32) {
        self.ledger.dropped(class, count, lost);
        self.change(class);
    }

    fn read(&self, class: Class, number: u32, into: &mut [u8]) -> Option<Kept> {
        let oldest = self.ledger.oldest.get(class as usize)?;
        let waits = |w: &Waiting| (w.head.class, w.head.numbers[0]) == (class as u8, number);
        if number.wrapping_sub(*oldest) >= self.ledger.kept(class)
            || self.flash.busy()
            || self.slots().any(waits)
        {
            return None;
        }
        let (sector, word, head) = match self.find(class, number) {
            Ok(found) => found,
            Err(last) => {
                self.missing.set(Some((class, last)));
                return None;
            }
        };
        let mut text = [0; RECORD_BYTES];
        entry::text(&self.flash, sector, word, &head, &mut text).then(|| {
            for (to, from) in into.iter_mut().zip(text.iter().take(usize::from(head.length))) {
                *to = *from;
            }
            let [_, ordinal, boot] = head.numbers;
            Kept { ordinal, boot, bytes: usize::from(head.length) }
        })
    }

    fn half(&self) -> u32 {
        const USUAL_BYTES: usize = 60;
        // One sector is always blank, and one may be as good as empty.
        let sectors = u32::from(F::SECTORS.saturating_sub(2));
        let a_sector = F::WORDS.saturating_sub(FIRST).checked_div(entry::words(USUAL_BYTES)).unwrap_or(0);
        sectors * u32::from(a_sector) / 2
    }

    fn work(&mut self) {
        if self.flash.busy() {
            return;
        }
        self.erased();
        // Worn out, or never written: it would be waited for for ever.
        if let Some((class, number)) = self.missing.take() {
            self.lose(class, number);
        }
        while let Some(Some(waiting)) = self.waiting.get(self.first).copied().filter(|_| self.waits > 0) {
            if !self.put(&waiting) {
                return;
            }
            self.first = (self.first + 1).checked_rem(WAITING).unwrap_or(0);
            self.waits -= 1;
        }
    }
}
