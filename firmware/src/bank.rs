//! A bank of flash whose controller works by itself: what is to be written and erased waits in a queue, so that the loop never
//! waits for it. A look at whether the bank is busy gives the controller the next piece of work.

use core::cell::RefCell;
use seabearing_core::wire::link::flash::{Flash, MOST_WRITES, Word};

/// What a bank's controller does. It is given one thing at a time, and the bank is not read meanwhile.
pub trait Controller {
    /// The flash word of this number in the bank; `None` where too many of its bits are wrong.
    fn read(&self, word: u32) -> Option<Word>;

    /// Begins to program a word.
    fn program(&mut self, word: u32, value: &Word);

    /// Begins to erase a sector.
    fn erase(&mut self, sector: u8);

    /// Whether it works.
    fn works(&self) -> bool;
}

/// Flash words of a sector.
pub const SECTOR_WORDS: u16 = 4096;
/// The most that a store may put off, and its erase.
const QUEUE: usize = MOST_WRITES + 1;
/// In place of a word's number: its sector is to be erased.
const ERASE: u32 = 1 << 31;

/// A piece of work.
#[derive(Clone, Copy, Debug)]
struct Work {
    /// Number of the word in the bank; with [`ERASE`] that of the sector.
    at: u32,
    value: Word,
}

/// What waits, in a ring.
#[derive(Debug)]
struct Queue<C> {
    controller: C,
    ring: &'static mut Ring,
    first: usize,
    count: usize,
    /// Sectors of which something waited since the queue was empty, as bits: of the others nothing has to be looked for.
    sectors: u32,
    /// Pieces of work that found no room.
    overrun: u32,
}

/// The memory of a bank's queue.
#[derive(Debug)]
pub struct Ring([Work; QUEUE]);

impl Ring {
    /// All zeros.
    pub const fn new() -> Self {
        Self([Work { at: 0, value: [0; 32] }; QUEUE])
    }
}

impl Default for Ring {
    fn default() -> Self {
        Self::new()
    }
}

/// A sector's bit; a bank has eight.
fn bit(sector: u32) -> u32 {
    1 << (sector % 32)
}

impl<C: Controller> Queue<C> {
    fn put(&mut self, work: Work) {
        let at = (self.first + self.count) % QUEUE;
        match self.ring.0.get_mut(at) {
            Some(slot) if self.count < QUEUE => {
                *slot = work;
                self.count += 1;
                self.sectors |= bit(match work.at & ERASE {
                    0 => work.at / u32::from(SECTOR_WORDS),
                    _ => work.at & !ERASE,
                });
            }
            _ => self.overrun = self.overrun.saturating_add(1),
        }
    }

    /// What waits, in order.
    fn waiting(&self) -> impl DoubleEndedIterator<Item = &Work> {
        let (front, back) = self.ring.0.split_at_checked(self.first).unwrap_or((&[], &[]));
        let behind = self.count.saturating_sub(back.len());
        back.iter().take(self.count).chain(front.iter().take(behind))
    }

    fn read(&self, word: u32) -> Option<Word> {
        if self.count > 0 && self.sectors & bit(word / u32::from(SECTOR_WORDS)) != 0 {
            for work in self.waiting().rev() {
                match work.at & !ERASE {
                    at if at == word && work.at & ERASE == 0 => return Some(work.value),
                    sector if work.at & ERASE != 0 && word / u32::from(SECTOR_WORDS) == sector => {
                        return Some([0xff; 32]);
                    }
                    _ => {}
                }
            }
        }
        self.controller.read(word)
    }

    /// Whether anything is left to do; begins with the next where the controller rests.
    fn go_on(&mut self) -> bool {
        if self.controller.works() {
            return true;
        }
        let Some(work) = self.ring.0.get(self.first).copied().filter(|_| self.count > 0) else {
            self.sectors = 0;
            return false;
        };
        self.first = (self.first + 1) % QUEUE;
        self.count -= 1;
        match work.at & ERASE {
            0 => self.controller.program(work.at, &work.value),
            _ => self.controller.erase((work.at & !ERASE) as u8),
        }
        true
    }
}

/// A bank, shared by those who have their parts of it.
#[derive(Debug)]
pub struct Bank<C>(RefCell<Queue<C>>);

impl<C: Controller> Bank<C> {
    /// The bank of a controller, with nothing to do.
    pub fn new(controller: C, ring: &'static mut Ring) -> Self {
        Self(RefCell::new(Queue { controller, ring, first: 0, count: 0, sectors: 0, overrun: 0 }))
    }

    /// Does what `f` does with the queue, which nothing else holds at the time.
    fn with<R>(&self, otherwise: R, f: impl FnOnce(&mut Queue<C>) -> R) -> R {
        match self.0.try_borrow_mut() {
            Ok(mut queue) => f(&mut queue),
            Err(_) => otherwise,
        }
    }

    /// Whether anything is left to do; begins with the next where the controller rests.
    pub fn works(&self) -> bool {
        self.with(true, Queue::go_on)
    }

    /// Pieces of work given up because the queue was full: none, where its users keep to the trait.
    pub fn overrun(&self) -> u32 {
        self.with(0, |queue| queue.overrun)
    }
}

/// `COUNT` sectors of a bank from the sector `FIRST` on.
#[derive(Debug)]
pub struct Part<'a, C, const FIRST: u8, const COUNT: u8>(&'a Bank<C>);

impl<'a, C: Controller, const FIRST: u8, const COUNT: u8> Part<'a, C, FIRST, COUNT> {
    /// That part of this bank.
    pub fn of(bank: &'a Bank<C>) -> Self {
        Self(bank)
    }

    fn place(sector: u8, word: u16) -> Option<u32> {
        let inside = sector < COUNT && word < SECTOR_WORDS;
        inside.then(|| u32::from(FIRST + sector) * u32::from(SECTOR_WORDS) + u32::from(word))
    }
}

impl<C: Controller, const FIRST: u8, const COUNT: u8> Flash for Part<'_, C, FIRST, COUNT> {
    const SECTORS: u8 = COUNT;
    const WORDS: u16 = SECTOR_WORDS;

    fn read(&self, sector: u8, word: u16) -> Option<Word> {
        let at = Self::place(sector, word)?;
        self.0.with(None, |queue| queue.read(at))
    }

    fn write(&mut self, sector: u8, word: u16, value: &Word) {
        if let Some(at) = Self::place(sector, word) {
            self.0.with((), |queue| queue.put(Work { at, value: *value }));
        }
    }

    fn erase(&mut self, sector: u8) {
        if sector < COUNT {
            let at = ERASE | u32::from(FIRST + sector);
            self.0.with((), |queue| queue.put(Work { at, value: [0; 32] }));
        }
    }

    fn busy(&self) -> bool {
        self.0.works()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::wire::link::flash::{FlashStore, ModelFlash};
    use seabearing_core::wire::link::{Class, Store};
    use std::boxed::Box;
    use std::rc::Rc;

    /// A bank of three sectors that is busy for some looks after each piece of work, and refuses what a bank refuses.
    #[derive(Clone)]
    struct Slow(Rc<RefCell<Inner>>);

    struct Inner {
        words: Box<ModelFlash<3, { SECTOR_WORDS as usize }>>,
        looks: u32,
    }

    impl Slow {
        fn rests(&self) {
            assert_eq!(self.0.borrow().looks, 0, "the bank works");
        }

        fn of(word: u32) -> (u8, u16) {
            ((word / u32::from(SECTOR_WORDS)) as u8, (word % u32::from(SECTOR_WORDS)) as u16)
        }
    }

    impl Controller for Slow {
        fn read(&self, word: u32) -> Option<Word> {
            self.rests();
            let (sector, word) = Self::of(word);
            self.0.borrow().words.read(sector, word)
        }

        fn program(&mut self, word: u32, value: &Word) {
            self.rests();
            let mut inner = self.0.borrow_mut();
            let (sector, word) = Self::of(word);
            inner.words.write(sector, word, value);
            inner.looks = 2;
        }

        fn erase(&mut self, sector: u8) {
            self.rests();
            let mut inner = self.0.borrow_mut();
            inner.words.erase_looks = 0;
            inner.words.erase(sector);
            inner.looks = 9;
        }

        fn works(&self) -> bool {
            let mut inner = self.0.borrow_mut();
            inner.looks = inner.looks.saturating_sub(1);
            inner.looks > 0
        }
    }

    fn ring() -> &'static mut Ring {
        Box::leak(Box::default())
    }

    #[test]
    fn a_store_over_a_slow_bank_never_meets_it_at_work_and_loses_nothing() {
        let slow = Slow(Rc::new(RefCell::new(Inner { words: Box::default(), looks: 0 })));
        let mut ordinal = 0u32;
        for start in 0..3 {
            let bank = Bank::new(slow.clone(), ring());
            let mut store = FlashStore::<_, 64>::open(Part::<_, 0, 3>::of(&bank));
            if start == 0 {
                store.begin(1);
            }
            assert_eq!(store.ledger().ordinal, ordinal);
            // Two rings of sectors, with alarms that must be brought along.
            for _ in 0..6000 {
                let class = if ordinal.is_multiple_of(40) { Class::Alarm } else { Class::Bearing };
                assert!(store.append(class, start, &ordinal.to_le_bytes().repeat(20)));
                ordinal += 1;
                if store.ledger().kept(Class::Alarm) > 30 {
                    store.drop_oldest(Class::Alarm, 5, 0);
                }
                if store.ledger().kept(Class::Bearing) > 500 {
                    store.drop_oldest(Class::Bearing, 50, 0);
                }
                (0..12).for_each(|_| store.work());
            }
            (0..2000).for_each(|_| store.work());
            assert_eq!((store.waiting(), bank.overrun(), store.ledger().lost), (0, 0, [0; 5]));
            for class in [Class::Alarm, Class::Bearing] {
                let of = class as usize;
                let (from, to) = (store.ledger().oldest[of], store.ledger().next[of]);
                assert!((from..to).all(|n| store.read(class, n, &mut []).is_some()), "{class:?}");
            }
        }
        assert_eq!(slow.0.borrow().words.misuses(), 0);
    }

    #[test]
    fn what_waits_is_read_as_if_it_were_written() {
        let slow = Slow(Rc::new(RefCell::new(Inner { words: Box::default(), looks: 0 })));
        let bank = Bank::new(slow, ring());
        let mut part = Part::<_, 1, 2>::of(&bank);
        part.write(0, 3, &[7; 32]);
        assert_eq!(
            (part.read(0, 3), part.read(0, 4), part.read(2, 0)),
            (Some([7; 32]), Some([0xff; 32]), None)
        );
        part.erase(0);
        assert_eq!(part.read(0, 3), Some([0xff; 32]));
        part.write(0, 3, &[8; 32]);
        assert_eq!(part.read(0, 3), Some([8; 32]));
        while part.busy() {}
        assert_eq!(Part::<_, 0, 3>::of(&bank).read(1, 3), Some([8; 32]));
        // More than fits is given up and counted.
        (0..QUEUE as u16 + 3).for_each(|word| part.write(1, word, &[1; 32]));
        assert_eq!(bank.overrun(), 3);
    }
}
