//! Records in memory, one after the other as they were written; where the memory survives a reset, so do they.
//!
//! What is dropped stays where it is until its room is needed; then the rest moves down, in steps of which each may be the
//! last before a reset. After every step [`Memory::keep`] is told the [`State`]; [`Retained`] writes it down twice in turn,
//! so that one copy is whole at any moment.

use super::store::{CLASSES, Class, Kept, Ledger, PerClass, RECORD_BYTES, Store};
use core::sync::atomic::{Ordering, compiler_fence};

/// Bytes before each record: length, class, ordinal, boot.
const HEAD: usize = 10;
/// Bytes of a usual record with its head.
const USUAL: u32 = 64;

/// What there is to know of a store besides its records' bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State {
    /// What the log has come to.
    pub(super) ledger: Ledger,
    /// Number of the first record of each class among the bytes; before the ledger's oldest they are dropped.
    pub(super) first: PerClass,
    /// Bytes in use.
    used: u32,
    /// While the rest moves down: bytes that have their place, where the others begin, and what is left of a record half moved.
    packed: u32,
    rest: u32,
    left: u32,
}

/// Words of a state as it is written down: a mark, a count of copies, a count of starts, the state, a checksum.
const WORDS: usize = 11 + 4 * CLASSES;
/// Bytes of one copy of a state.
const COPY: usize = 4 * WORDS;
/// Marks a copy, and this layout.
const MARK: u32 = 0x5ea1_0901;

/// Where a store keeps its bytes.
pub trait Memory {
    /// The bytes.
    fn bytes(&self) -> &[u8];

    /// The bytes, to write.
    fn bytes_mut(&mut self) -> &mut [u8];

    /// The state has changed.
    fn keep(&mut self, _: &State) {}
}

impl<const BYTES: usize> Memory for [u8; BYTES] {
    fn bytes(&self) -> &[u8] {
        self
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        self
    }
}

/// Memory that a reset leaves alone, whatever it does to the rest: static memory outside of what start-up clears, memory
/// with a battery, ferroelectric memory. Bytes must arrive in the order in which they are written.
#[derive(Debug)]
pub struct Retained<'a> {
    copies: [&'a mut [u8]; 2],
    bytes: &'a mut [u8],
    count: u32,
    starts: u32,
}

impl Memory for Retained<'_> {
    fn bytes(&self) -> &[u8] {
        self.bytes
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        self.bytes
    }

    fn keep(&mut self, state: &State) {
        self.count = self.count.wrapping_add(1);
        let words = state.words(self.count, self.starts);
        // The records are there before the state that counts them.
        compiler_fence(Ordering::SeqCst);
        let [even, odd] = &mut self.copies;
        let copy = if self.count & 1 == 0 { even } else { odd };
        for (to, from) in copy.iter_mut().zip(words.iter().flat_map(|w| w.to_le_bytes())) {
            *to = from;
        }
        compiler_fence(Ordering::SeqCst);
    }
}

impl State {
    fn words(&self, count: u32, starts: u32) -> [u32; WORDS] {
        let Ledger { log, ordinal, next, oldest, lost } = self.ledger;
        let numbers = [MARK, count, starts, u32::from(log.is_some()), log.unwrap_or(0), ordinal, self.used];
        let moving = [self.packed, self.rest, self.left];
        let all = numbers.into_iter().chain(moving).chain(next).chain(oldest).chain(lost).chain(self.first);
        let mut words = [0; WORDS];
        words.iter_mut().zip(all).for_each(|(to, from)| *to = from);
        let check = check(&words);
        if let Some(last) = words.last_mut() {
            *last = check;
        }
        words
    }

    /// A state that was written down, and its counts of copies and starts.
    fn read(copy: &[u8], room: usize) -> Option<(Self, u32, u32)> {
        let mut words = [0u32; WORDS];
        let (from, _) = copy.as_chunks::<4>();
        words.iter_mut().zip(from).for_each(|(to, from)| *to = u32::from_le_bytes(*from));
        if words.last() != Some(&check(&words)) {
            return None;
        }
        let mut words = words.into_iter();
        let mut next = || words.next();
        let (MARK, count, starts) = (next()?, next()?, next()?) else { return None };
        let log = next()?;
        let log = next().filter(|_| log != 0);
        let (ordinal, used) = (next()?, next()?);
        let mut state = Self { used, packed: next()?, rest: next()?, left: next()?, ..Self::default() };
        let Self { ledger, first, .. } = &mut state;
        (ledger.log, ledger.ordinal) = (log, ordinal);
        for to in [&mut ledger.next, &mut ledger.oldest, &mut ledger.lost, first] {
            to.iter_mut().zip(&mut words).for_each(|(to, from)| *to = from);
        }
        (used as usize <= room).then_some((state, count, starts))
    }
}

/// The checksum of all words but the last.
fn check(words: &[u32; WORDS]) -> u32 {
    let mut bytes = [0; COPY - 4];
    bytes.as_chunks_mut::<4>().0.iter_mut().zip(words).for_each(|(to, word)| *to = word.to_le_bytes());
    crate::hash::fnv1a(&bytes) as u32
}

/// Records in memory.
#[derive(Clone, Debug)]
pub struct ByteStore<M> {
    pub(super) state: State,
    memory: M,
}

/// Records in memory of its own, which a reset empties.
pub type MemoryStore<const BYTES: usize> = ByteStore<[u8; BYTES]>;

impl<const BYTES: usize> MemoryStore<BYTES> {
    /// An empty store.
    pub const fn new() -> Self {
        let none = [0; CLASSES];
        let ledger = Ledger { log: None, ordinal: 0, next: none, oldest: none, lost: none };
        let state = State { ledger, first: none, used: 0, packed: 0, rest: 0, left: 0 };
        Self { state, memory: [0; BYTES] }
    }
}

impl<const BYTES: usize> Default for MemoryStore<BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<'a> ByteStore<Retained<'a>> {
    /// Goes on with what memory kept over a reset, whenever that came; begins empty where it holds nothing, as after the
    /// first start. Beside it the number of this start, from 1: it is kept in the same memory.
    pub fn open(memory: &'a mut [u8]) -> (Self, u32) {
        let (copies, bytes) = memory.split_at_mut_checked(2 * COPY).unwrap_or_default();
        let (even, odd) = copies.split_at_mut_checked(COPY).unwrap_or_default();
        let of = |copy: &[u8]| State::read(copy, bytes.len());
        let newer = match (of(even), of(odd)) {
            (Some(a), Some(b)) => Some(if super::ahead(a.1, b.1) { a } else { b }),
            (a, b) => a.or(b),
        };
        let (state, count, starts) = newer.unwrap_or_default();
        let starts = starts.wrapping_add(1);
        let mut store = Self { state, memory: Retained { copies: [even, odd], bytes, count, starts } };
        store.memory.keep(&store.state);
        if store.state.rest > 0 {
            store.move_down();
        }
        (store, starts)
    }
}

impl<M: Memory> ByteStore<M> {
    /// Class and length, with its head, of the record at a place.
    fn at(&self, place: usize) -> Option<(u8, u32)> {
        let &[length, class] = self.memory.bytes().get(place..)?.first_chunk::<2>()?;
        Some((class, HEAD as u32 + u32::from(length)))
    }

    /// The records among the bytes, in the order of writing: class, head, and where the bytes begin.
    fn records(&self) -> impl Iterator<Item = (u8, Kept, usize)> + '_ {
        let mut at = 0;
        core::iter::from_fn(move || {
            let head =
                self.memory.bytes().get(..self.state.used as usize)?.get(at..)?.first_chunk::<HEAD>()?;
            let [length, class, ordinal @ .., b0, b1, b2, b3] = *head;
            let bytes = usize::from(length);
            let begin = at + HEAD;
            at = begin + bytes;
            let kept = Kept {
                ordinal: u32::from_le_bytes(ordinal),
                boot: u32::from_le_bytes([b0, b1, b2, b3]),
                bytes,
            };
            Some((class, kept, begin))
        })
    }

    /// Moves what is kept down over what was dropped, or goes on with that where a reset ended it.
    fn move_down(&mut self) {
        if self.state.rest == 0 && self.state.first == self.state.ledger.oldest {
            return;
        }
        while self.state.rest < self.state.used || self.state.left > 0 {
            let State { packed, rest, left, ref ledger, first, .. } = self.state;
            if left > 0 {
                // No more at once than there is room between, so that a step may be done twice.
                let n = left.min(rest.saturating_sub(packed));
                for i in 0..n {
                    let byte = self.memory.bytes().get((rest + i) as usize).copied().unwrap_or(0);
                    if let Some(to) = self.memory.bytes_mut().get_mut((packed + i) as usize) {
                        *to = byte;
                    }
                }
                if n == 0 {
                    break;
                }
                (self.state.packed, self.state.rest, self.state.left) = (packed + n, rest + n, left - n);
            } else {
                let Some((class, length)) = self.at(rest as usize) else { break };
                let of = usize::from(class);
                if first.get(of) != ledger.oldest.get(of) {
                    if let Some(first) = self.state.first.get_mut(of) {
                        *first = first.wrapping_add(1);
                    }
                    self.state.rest += length;
                } else if packed == rest {
                    (self.state.packed, self.state.rest) = (packed + length, rest + length);
                } else {
                    self.state.left = length;
                }
            }
            self.memory.keep(&self.state);
        }
        let state = &mut self.state;
        (state.used, state.packed, state.rest, state.left) = (state.packed, 0, 0, 0);
        self.memory.keep(&self.state);
    }
}

impl<M: Memory> Store for ByteStore<M> {
    fn ledger(&self) -> &Ledger {
        &self.state.ledger
    }

    fn begin(&mut self, log: u32) {
        self.state.ledger.log = Some(log);
        self.memory.keep(&self.state);
    }

    fn append(&mut self, class: Class, boot: u32, record: &[u8]) -> bool {
        let need = HEAD + record.len();
        if record.len() > RECORD_BYTES {
            return false;
        }
        if self.memory.bytes().len().saturating_sub(self.state.used as usize) < need {
            self.move_down();
        }
        let used = self.state.used as usize;
        let Some(free) = self.memory.bytes_mut().get_mut(used..).filter(|free| free.len() >= need) else {
            return false;
        };
        let [o0, o1, o2, o3] = self.state.ledger.ordinal.to_le_bytes();
        let [b0, b1, b2, b3] = boot.to_le_bytes();
        let head = [record.len() as u8, class as u8, o0, o1, o2, o3, b0, b1, b2, b3];
        for (to, from) in free.iter_mut().zip(head.iter().chain(record)) {
            *to = *from;
        }
        self.state.ledger.written(class);
        self.state.used += need as u32;
        self.memory.keep(&self.state);
        true
    }

    fn pass(&mut self, class: Class) {
        // What was dropped of the class must not be taken for what is passed.
        self.move_down();
        self.state.ledger.written(class);
        self.state.ledger.dropped(class, 1, 1);
        let oldest = self.state.ledger.oldest.get(class as usize).copied();
        if let Some((first, oldest)) = self.state.first.get_mut(class as usize).zip(oldest) {
            *first = oldest;
        }
        self.memory.keep(&self.state);
    }

    fn drop_oldest(&mut self, class: Class, count: u32, lost: u32) {
        self.state.ledger.dropped(class, count, lost);
        self.memory.keep(&self.state);
    }

    fn read(&self, class: Class, number: u32, into: &mut [u8]) -> Option<Kept> {
        let oldest = self.state.ledger.oldest.get(class as usize)?;
        let first = self.state.first.get(class as usize)?;
        if number.wrapping_sub(*oldest) >= self.state.ledger.kept(class) {
            return None;
        }
        let place = number.wrapping_sub(*first) as usize;
        let (_, kept, begin) = self.records().filter(|r| r.0 == class as u8).nth(place)?;
        let from = self.memory.bytes().get(begin..begin + kept.bytes)?;
        for (to, from) in into.iter_mut().zip(from) {
            *to = *from;
        }
        Some(kept)
    }

    fn half(&self) -> u32 {
        self.memory.bytes().len() as u32 / (2 * USUAL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn what_is_dropped_leaves_room_and_the_rest_stays_as_it_was() {
        let mut store = MemoryStore::<60>::new();
        assert!(store.append(Class::Bearing, 3, b"first bearing"));
        assert!(store.append(Class::Alarm, 3, b"alarm"));
        assert!(store.append(Class::Bearing, 4, b"b2"));
        assert!(!store.append(Class::Bearing, 4, b"no room"));
        store.drop_oldest(Class::Bearing, 1, 1);
        assert!(store.append(Class::Bearing, 4, b"b3, longer"));
        let mut bytes = [0; 16];
        let read = |class, number, bytes: &mut [u8]| store.read(class, number, bytes);
        assert_eq!(read(Class::Alarm, 0, &mut bytes), Some(Kept { ordinal: 1, boot: 3, bytes: 5 }));
        assert_eq!(&bytes[..5], b"alarm");
        assert_eq!(read(Class::Bearing, 0, &mut bytes), None);
        assert_eq!(read(Class::Bearing, 2, &mut bytes), Some(Kept { ordinal: 3, boot: 4, bytes: 10 }));
        assert_eq!(&bytes[..10], b"b3, longer");
        assert_eq!(read(Class::Bearing, 3, &mut bytes), None);
        assert_eq!(store.ledger().lost, [0, 0, 0, 1, 0]);
    }

    #[test]
    fn numbers_go_on_over_their_wrap() {
        let mut store = MemoryStore::<200>::new();
        (store.state.ledger.next[0], store.state.ledger.oldest[0]) = (u32::MAX, u32::MAX);
        store.state.first[0] = u32::MAX;
        for text in [b"a", b"b", b"c"] {
            assert!(store.append(Class::Alarm, 0, text));
        }
        let mut byte = [0];
        assert!(store.read(Class::Alarm, 1, &mut byte).is_some() && byte == *b"c");
        store.drop_oldest(Class::Alarm, 2, 0);
        assert!(store.read(Class::Alarm, 0, &mut byte).is_none());
        assert!(store.read(Class::Alarm, 1, &mut byte).is_some() && byte == *b"c");
        store.drop_oldest(Class::Alarm, 9, 0);
        store.pass(Class::Alarm);
        assert_eq!(
            (store.state.ledger.kept(Class::Alarm), store.state.ledger.next[0], store.state.ledger.lost[0]),
            (0, 3, 1)
        );
    }

    /// Memory whose power fails in the middle of a change.
    struct Failing {
        image: Vec<u8>,
        /// As it was after the change before.
        last: Vec<u8>,
        count: u32,
        /// Changes until then, and the byte of the change.
        left: usize,
        byte: usize,
        torn: Option<Vec<u8>>,
    }

    impl Memory for Failing {
        fn bytes(&self) -> &[u8] {
            &self.image[2 * COPY..]
        }

        fn bytes_mut(&mut self) -> &mut [u8] {
            &mut self.image[2 * COPY..]
        }

        fn keep(&mut self, state: &State) {
            let before = self.image.clone();
            let (copies, bytes) = self.image.split_at_mut(2 * COPY);
            let (even, odd) = copies.split_at_mut(COPY);
            let mut retained = Retained { copies: [even, odd], bytes, count: self.count, starts: 1 };
            retained.keep(state);
            self.count = retained.count;
            if self.left == 0 {
                // Bytes arrive in order: first the records', then the state's.
                let mut image = self.last.clone();
                let mut left = self.byte;
                for now in [&before, &self.image] {
                    for (to, from) in image.iter_mut().zip(now).filter(|(to, from)| to != from) {
                        if left > 0 {
                            (*to, left) = (*from, left - 1);
                        }
                    }
                }
                self.torn = Some(image);
            }
            self.left = self.left.wrapping_sub(1);
            self.last.clone_from(&self.image);
        }
    }

    fn record(n: u32) -> (Class, Vec<u8>) {
        let length = 5 + n * 13 % 60;
        (Class::ALL[(n * 7 % 4) as usize], (0..length).map(|i| (n * 31 + i) as u8).collect())
    }

    #[test]
    fn a_reset_at_any_byte_leaves_every_record_whole() {
        let (mut moving, mut begun) = (0, 0);
        for cut in 0..3000usize {
            let (left, byte) = (cut / 6, [0, 1, 7, 40, 60, 130][cut % 6]);
            let image = std::vec![0xa5; 2 * COPY + 500];
            let memory = Failing { last: image.clone(), image, count: 0, left, byte, torn: None };
            let mut store = ByteStore { state: State::default(), memory };
            store.begin(3);
            let mut said = 0;
            while store.memory.torn.is_none() {
                let (class, bytes) = record(said);
                while !store.append(class, said, &bytes) {
                    let least = store.ledger().least_kept().unwrap();
                    store.drop_oldest(least, 1 + said % 2, 1);
                }
                if said % 3 == 0 {
                    store.drop_oldest(class, said % 4, 0);
                }
                said += 1;
            }
            let mut image = store.memory.torn.unwrap();
            let half = [&image[..COPY], &image[COPY..2 * COPY]].map(|c| State::read(c, 500));
            moving += u32::from(half.iter().flatten().any(|s| s.0.rest > 0));
            let (mut store, starts) = ByteStore::open(&mut image);
            begun += u32::from(starts == 2);
            // All that was said before the change that failed, but for what was dropped, and nothing else.
            let ledger = *store.ledger();
            assert!((said.saturating_sub(1)..=said).contains(&ledger.ordinal), "{cut}: {ledger:?}");
            for class in Class::ALL {
                for n in 0..ledger.kept(class) {
                    let mut bytes = [0; 64];
                    let number = ledger.oldest[class as usize] + n;
                    let kept = store.read(class, number, &mut bytes).unwrap();
                    assert_eq!((class, bytes[..kept.bytes].to_vec()), record(kept.ordinal), "{cut}");
                    assert_eq!(kept.boot, kept.ordinal);
                }
            }
            // And it goes on.
            if let Some(least) = store.ledger().least_kept() {
                store.drop_oldest(least, ledger.kept(least), 0);
            }
            assert!(store.append(Class::Alarm, 9, b"more"), "{cut}");
        }
        assert!(moving > 500 && begun > 2900, "{moving} {begun}");
    }
}
