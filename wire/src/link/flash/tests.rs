use super::*;
use crate::link::store::Store;
use std::collections::BTreeMap;
use std::vec::Vec;

type Small = ModelFlash<3, 256>;
type Tested = FlashStore<Small, 16>;

/// A record that says which it is.
fn record(n: u32) -> Vec<u8> {
    let length = 1 + (n as usize * 37) % RECORD_BYTES;
    (0..length).map(|i| (n as usize * 31 + i) as u8).collect()
}

fn class_of(n: u32) -> Class {
    Class::ALL[[3, 3, 2, 3, 4, 3, 0, 3, 3, 1, 3, 4][n as usize % 12]]
}

/// What can be read: by class and number, the bytes and the boot.
fn readable(store: &Tested) -> BTreeMap<(u8, u32), (Vec<u8>, u32)> {
    let mut all = BTreeMap::new();
    for class in Class::ALL {
        let (oldest, next) = (store.ledger().oldest[class as usize], store.ledger().next[class as usize]);
        for number in oldest..next {
            let mut bytes = [0; RECORD_BYTES];
            if let Some(kept) = store.read(class, number, &mut bytes) {
                all.insert((class as u8, number), (bytes[..kept.bytes].to_vec(), kept.boot));
            }
        }
    }
    all
}

/// Takes `records` records, acknowledged to some extent or not at all; what could be read when the power went, and what
/// of it was not acknowledged.
fn run(store: &mut Tested, records: std::ops::Range<u32>, acknowledged: bool) {
    for n in records {
        if store.flash().is_off() {
            return;
        }
        store.append(class_of(n), store.starts(), &record(n));
        // A base station that takes what it can read, a little later.
        if acknowledged && n % 5 == 0 {
            for class in Class::ALL {
                let kept = store.ledger().kept(class);
                let oldest = store.ledger().oldest[class as usize];
                let there =
                    (0..kept).take_while(|i| store.read(class, oldest + i, &mut []).is_some()).count();
                if there as u32 > 2 {
                    store.drop_oldest(class, there as u32 - 2, 0);
                }
            }
        }
        store.work();
    }
}

fn settle(store: &mut Tested) {
    (0..100).for_each(|_| store.work());
}

#[test]
fn what_was_written_is_there_after_a_reset_and_numbers_go_on() {
    let mut store = Tested::open(Small::new());
    store.begin(7);
    run(&mut store, 0..20, false);
    settle(&mut store);
    let before = readable(&store);
    assert_eq!((before.len(), store.waiting(), store.starts()), (20, 0, 1));
    let ledger = *store.ledger();
    let mut store = Tested::open(store.into_flash());
    assert_eq!((readable(&store), store.starts()), (before, 2));
    assert_eq!(*store.ledger(), ledger);
    assert!(store.append(Class::Alarm, 2, b"later"));
    assert_eq!(store.ledger().next[0], ledger.next[0] + 1);
    assert_eq!(store.flash().misuses(), 0);
}

#[test]
fn a_store_that_opens_where_it_stays_is_the_same_and_a_link_may_borrow_it() {
    use crate::link::{Link, Settings};
    let mut store = Tested::open(Small::new());
    run(&mut store, 0..20, false);
    settle(&mut store);
    let (before, ledger) = (readable(&store), *store.ledger());
    let mut place = MaybeUninit::uninit();
    let store = Tested::open_in(&mut place, store.into_flash(), || {});
    assert_eq!((readable(store), *store.ledger(), store.starts()), (before, ledger, 2));
    let mut link = Link::new(Settings::serial(115_200), 1, 2, 3, &mut *store);
    link.offer(Class::Alarm, b"later");
    assert_eq!(link.store().ledger().next[0], ledger.next[0] + 1);
    settle(store);
    assert_eq!(readable(store)[&(0, ledger.next[0])], (b"later".to_vec(), 2));
}

#[test]
fn the_oldest_goes_first_but_alarms_and_final_tracks_last() {
    let mut store = Tested::open(Small::new());
    store.begin(1);
    assert!(store.append(Class::Alarm, 1, b"the first of all"));
    settle(&mut store);
    for n in 0..600u32 {
        store.append(if n % 50 == 0 { Class::Final } else { Class::Bearing }, 1, &record(n));
        settle(&mut store);
    }
    let kept = readable(&store);
    assert_eq!(kept.get(&(0, 0)).map(|r| r.0.as_slice()), Some(&b"the first of all"[..]));
    assert_eq!(kept.keys().filter(|k| k.0 == Class::Final as u8).count(), 12);
    let (ledger, bearing) = (store.ledger(), Class::Bearing as usize);
    assert_eq!((ledger.lost[0], ledger.lost[1]), (0, 0));
    assert!(ledger.lost[bearing] > 300 && ledger.lost[bearing] == ledger.oldest[bearing], "{ledger:?}");
    // Every sector wears as the others do.
    let erases = store.flash().erases();
    assert!(erases.iter().max().unwrap() - erases.iter().min().unwrap() <= 1, "{erases:?}");
    assert_eq!(store.flash().misuses(), 0);
}

#[test]
fn a_record_that_cannot_be_read_any_more_is_counted_and_the_others_go_on() {
    let mut store = Tested::open(Small::new());
    store.begin(1);
    (0..5).for_each(|n| assert!(store.append(Class::Alarm, 1, &[n; 100])));
    settle(&mut store);
    let (sector, word, _) = store.find(Class::Alarm, 1).unwrap();
    store.flash_mut().damage(sector, word + 1);
    let settings = crate::link::Settings::serial(921_600);
    let mut link = crate::link::Link::new(settings, 7, 1, 0, store);
    let far = crate::link::MemoryStore::<500>::new();
    let mut base = crate::link::Link::new(crate::link::Settings { leads: false, ..settings }, 0, 1, 0, far);
    let mut came = Came::default();
    for now in (0..20_000_000).step_by(1000) {
        for byte in link.send(now).map(<[u8]>::to_vec).unwrap_or_default() {
            base.receive(now, byte, &mut came);
        }
        for byte in base.send(now).map(<[u8]>::to_vec).unwrap_or_default() {
            link.receive(now, byte, &mut Came::default());
        }
    }
    // Numbers 0 and 1 went with the damage if 0 had not come before it was noticed.
    assert!(came.records.ends_with(&[2, 3, 4]) && came.lost >= 1, "{came:?}");
    assert_eq!(came.records.len() as u32 + came.lost, 5);
}

#[derive(Debug, Default)]
struct Came {
    records: Vec<u32>,
    lost: u32,
}

impl crate::link::Inbox for Came {
    fn recall(&mut self, _: &crate::link::Session) -> Option<crate::link::Progress> {
        None
    }

    fn take(&mut self, arrival: crate::link::Arrival<'_>) {
        match arrival {
            crate::link::Arrival::Record(record) => self.records.push(record.number),
            crate::link::Arrival::Lost(loss) => self.lost += loss.count,
            _ => {}
        }
    }
}

/// Power cut at every write and erase of a run: the store opens, has all that could be read before, and goes on.
fn cut_everywhere(records: u32, acknowledged: bool) -> u32 {
    let mut flash = Small::new();
    flash.erase_looks = 3;
    let mut whole = Tested::open(flash);
    whole.begin(1);
    for n in 0..records {
        let before = readable(&whole);
        let from = whole.clone();
        run(&mut whole, n..n + 1, acknowledged);
        for at in from.flash.operations()..whole.flash.operations() {
            for cut in [Cut::Before, Cut::During, Cut::After] {
                let mut store = from.clone();
                store.flash.cut_at(at, cut);
                run(&mut store, n..n + 1, acknowledged);
                assert!(store.flash.is_off());
                after_a_cut(store, &before, records, acknowledged, &std::format!("{at} {cut:?}"));
            }
        }
    }
    assert!(whole.flash.erases().iter().all(|n| *n > 1), "{:?}", whole.flash.erases());
    whole.flash.operations()
}

/// The store opens again, has what could be read `before`, and takes more.
fn after_a_cut(
    store: Tested,
    before: &BTreeMap<(u8, u32), (Vec<u8>, u32)>,
    records: u32,
    acknowledged: bool,
    at: &str,
) {
    let mut flash = store.into_flash();
    flash.switch_on();
    let mut store = Tested::open(flash);
    settle(&mut store);
    let after = readable(&store);
    for ((class, number), was) in before {
        let of = usize::from(*class);
        // What was acknowledged since, and what went for want of room, is counted.
        let gone = *number < store.ledger().oldest[of];
        assert!(gone || after.get(&(*class, *number)) == Some(was), "{at} {class} {number}");
        assert!(!gone || acknowledged || store.ledger().lost[of] > *number, "{at} {class}");
        assert!(store.ledger().next[of] > *number, "{at}: {class} {number} twice");
    }
    assert!(!acknowledged || store.ledger().lost == [0; CLASSES], "{at}");
    run(&mut store, records..records + 30, acknowledged);
    settle(&mut store);
    assert_eq!(store.waiting(), 0);
    let there = readable(&store);
    for class in Class::ALL {
        let of_class = there.keys().filter(|k| k.0 == class as u8).count();
        assert_eq!(of_class as u32, store.ledger().kept(class), "{at} {class:?}");
    }
    assert_eq!(store.flash().misuses(), 0, "{at}");
}

#[test]
fn power_cut_at_every_write_loses_nothing_that_could_be_read() {
    assert!(cut_everywhere(420, true) > 1500);
}

#[test]
fn power_cut_at_every_write_of_a_full_store_counts_what_is_lost() {
    assert!(cut_everywhere(330, false) > 1000);
}

/// A store whose head holds as much as it takes before the next sector is opened.
fn with_a_full_head(acknowledged: bool) -> Tested {
    let mut store = Tested::open(Small::new());
    store.begin(1);
    let mut n = 0;
    while store.writing.is_none_or(|w| w.sequence < 3) {
        run(&mut store, n..n + 1, acknowledged);
        settle(&mut store);
        n += 1;
    }
    let sequence = store.writing.map(|w| w.sequence);
    loop {
        let before = store.clone();
        run(&mut store, n..n + 1, acknowledged);
        settle(&mut store);
        n += 1;
        if store.writing.map(|w| w.sequence) != sequence {
            return before;
        }
    }
}

#[test]
fn no_start_has_the_number_of_another_however_many_follow_each_other() {
    let mut store = with_a_full_head(true);
    let kept = readable(&store);
    for _ in 0..3 * 256 {
        let before = store.starts();
        store = Tested::open(store.into_flash());
        assert_eq!(store.starts(), before + 1);
        settle(&mut store);
    }
    let there = readable(&store);
    let lost = kept.keys().filter(|key| !there.contains_key(key)).count() as u32;
    assert!(lost <= store.ledger().lost.iter().sum(), "{lost} gone, {:?}", store.ledger());
    assert_eq!(store.flash().misuses(), 0);
}

#[test]
fn starts_are_counted_while_the_next_sector_is_never_erased_to_its_end() {
    for acknowledged in [true, false] {
        let mut store = with_a_full_head(acknowledged);
        // As little room as a record leaves.
        while store.writing.is_some_and(|w| Small::WORDS - w.word > STARTS) {
            store.note_start();
        }
        // The head is full and the next sector is the one whose erasing is cut short.
        let mut flash = store.flash().clone();
        flash.erase(next::<Small>(store.writing.unwrap().sector));
        flash.switch_on();
        for _ in 0..8 {
            let before = store.starts();
            store = Tested::open(flash);
            assert_eq!(store.starts(), before + 1, "{acknowledged}");
            flash = store.flash().clone();
            flash.switch_on();
        }
        // And once it is erased the number goes on from there.
        store = Tested::open(flash);
        let last = store.starts();
        settle(&mut store);
        assert!(!store.start_unnoted);
        assert_eq!(Tested::open(store.into_flash()).starts(), last + 1, "{acknowledged}");
    }
}

#[test]
fn an_erase_that_is_cut_short_again_and_again_loses_no_start_and_nothing_that_is_brought_along() {
    let mut store = Tested::open(Small::new());
    store.begin(1);
    // Until the first sector, full of faults, fewer than are brought along, is about to be erased.
    let go = |store: &mut Tested, n: u32| {
        store.append(if n < 24 { Class::Alarm } else { Class::Bearing }, 1, &[7; 100]);
        settle(store);
    };
    let mut n = 0;
    let before = loop {
        let before = store.clone();
        go(&mut store, n);
        if store.flash.erases()[0] == 2 {
            break before;
        }
        n += 1;
    };
    let erase = (before.flash.operations()..).find(|at| {
        let mut cut = before.clone();
        cut.flash_mut().cut_at(*at, Cut::After);
        go(&mut cut, n);
        cut.flash.erases()[0] == 2
    });
    store = before;
    store.flash_mut().cut_at(erase.unwrap(), Cut::Before);
    go(&mut store, n);
    assert!(store.flash().is_off());
    for _ in 0..24 {
        let (before, erased) = (store.starts(), store.flash().erases()[0]);
        let mut flash = store.into_flash();
        flash.switch_on();
        // One word for the start, and then the erase.
        let erase = flash.operations() + 1;
        flash.cut_at(erase, Cut::Before);
        store = Tested::open(flash);
        assert!(store.flash().is_off());
        assert_eq!(store.starts(), before + 1);
        assert_eq!(store.flash().erases()[0], erased + 1, "no copies, and then the erase");
    }
    let mut flash = store.into_flash();
    flash.switch_on();
    let mut store = Tested::open(flash);
    settle(&mut store);
    assert_eq!((store.ledger().lost[0], store.ledger().kept(Class::Alarm)), (0, 24));
    assert_eq!(readable(&store).keys().filter(|key| key.0 == 0).count(), 24);
}

/// A flash that counts what is read of it.
#[derive(Clone)]
struct Counting {
    words: std::boxed::Box<ModelFlash<6, 1024>>,
    reads: std::rc::Rc<Cell<u32>>,
}

/// Its words.
const LARGE_WORDS: u32 = 6 * 1024;
type Large = FlashStore<Counting, 64>;

impl Flash for Counting {
    const SECTORS: u8 = 6;
    const WORDS: u16 = 1024;

    fn read(&self, sector: u8, word: u16) -> Option<Word> {
        self.reads.set(self.reads.get() + 1);
        self.words.read(sector, word)
    }

    fn write(&mut self, sector: u8, word: u16, value: &Word) {
        self.words.write(sector, word, value);
    }

    fn erase(&mut self, sector: u8) {
        self.words.erase(sector);
    }

    fn busy(&self) -> bool {
        self.words.busy()
    }
}

/// A store that was gone round more than twice, of which nothing was acknowledged; most reads of a record's being taken.
fn full(bytes: usize, class: impl Fn(u32) -> Class) -> (Large, u32) {
    let (words, reads) = (std::boxed::Box::default(), std::rc::Rc::default());
    let mut store = Large::open(Counting { words, reads });
    store.begin(1);
    let (mut n, mut most) = (0u32, 0);
    while store.flash.words.erases().iter().any(|erases| *erases < 3) || n % 100 != 0 {
        let before = store.flash.reads.get();
        assert!(store.append(class(n), 1, &[n as u8; RECORD_BYTES][..bytes]));
        most = most.max(store.flash.reads.get() - before);
        for _ in 0..8 {
            let before = store.flash.reads.get();
            store.work();
            most = most.max(store.flash.reads.get() - before);
        }
        n += 1;
    }
    (store, most)
}

/// Opens it again: the reads it took, of sectors in between as `alive` was called, and that everything kept is there.
fn reopened(store: Large) -> (Large, u32) {
    let mut flash = store.into_flash();
    flash.words.switch_on();
    let reads = flash.reads.clone();
    reads.set(0);
    let (mut last, mut apart) = (0, 0);
    let mut place = MaybeUninit::uninit();
    let store = Large::open_in(&mut place, flash, || {
        apart = apart.max(reads.get() - last);
        last = reads.get();
    });
    let took = reads.get();
    assert!(apart.max(took - last) <= 4 * 1024, "{apart} reads without a sign of life");
    let mut store = store.clone();
    (0..20).for_each(|_| store.work());
    for class in Class::ALL {
        let (oldest, kept) = (store.ledger().oldest[class as usize], store.ledger().kept(class));
        for i in 0..kept {
            assert!(store.read(class, oldest + i, &mut []).is_some(), "{class:?} {oldest} + {i}");
        }
    }
    (store, took)
}

#[test]
fn a_full_store_is_opened_with_few_reads_of_each_word() {
    for bytes in [8, 30, 60, 140] {
        for class in [class_of, |_| Class::Bearing, |_| Class::Final] {
            let (store, _) = full(bytes, class);
            let (ledger, starts) = (store.ledger, store.starts);
            let (store, took) = reopened(store);
            assert!(took <= 3 * LARGE_WORDS, "{bytes} bytes: {took} reads of {LARGE_WORDS} words");
            assert_eq!((store.ledger, store.starts), (ledger, starts + 1));
        }
    }
}

#[test]
fn a_full_store_with_words_that_cannot_be_read_is_opened_with_few_reads_of_each_word() {
    for bytes in [8, 30, 60, 140] {
        for class in [class_of, |_| Class::Bearing, |_| Class::Final] {
            let (whole, _) = full(bytes, class);
            let head = whole.writing.unwrap().sector;
            for behind in 1..6 {
                let sector = (head + 6 - behind) % 6;
                let opened = [1].to_vec();
                let hundred = (0..100).map(|n| 9 + n * 10).collect::<Vec<_>>();
                for bad in [opened, hundred] {
                    let mut store = whole.clone();
                    bad.iter().for_each(|word| store.flash.words.damage(sector, *word));
                    let before = store.ledger;
                    let (store, took) = reopened(store);
                    assert!(took <= 3 * LARGE_WORDS, "{bytes} bytes, {bad:?}: {took} reads");
                    // What is gone is counted, and nothing has a number twice.
                    for of in 0..CLASSES {
                        let gone = store.ledger.oldest[of] - before.oldest[of];
                        assert_eq!(store.ledger.lost[of] - before.lost[of], gone);
                        assert_eq!(store.ledger.next[of], before.next[of]);
                    }
                }
            }
        }
    }
}

#[test]
fn a_sector_change_reads_few_words_however_many_urgent_records_there_are() {
    for every in [1, 2, 10, 45] {
        for bytes in [8, 30, 60] {
            let class = |n: u32| if n.is_multiple_of(every) { Class::Alarm } else { Class::Bearing };
            let (_, most) = full(bytes, class);
            assert!(most <= 4 * 1024, "1 in {every} of {bytes} bytes: {most} reads of 1024 words");
        }
    }
}

#[test]
fn what_was_brought_along_before_an_erase_was_cut_short_is_found_with_few_reads() {
    let class = |n: u32| if n.is_multiple_of(2) { Class::Alarm } else { Class::Bearing };
    let (mut store, _) = full(30, class);
    let mut n = 0u32;
    // The next erase is never begun, and what it was to erase is there still.
    let (before, erase) = loop {
        let (before, erases) = (store.clone(), store.flash.words.erases().to_vec());
        store.append(class(n), 1, &[7; 30]);
        (0..8).for_each(|_| store.work());
        n += 1;
        if store.flash.words.erases().to_vec() != erases {
            break (before, n - 1);
        }
    };
    let found = (before.flash.words.operations()..store.flash.words.operations()).rev().find_map(|at| {
        let mut cut = before.clone();
        cut.flash.words.cut_at(at, Cut::Before);
        cut.append(class(erase), 1, &[7; 30]);
        (0..8).for_each(|_| cut.work());
        let writes = at - before.flash.words.operations();
        (cut.flash.words.erases() == before.flash.words.erases() && writes > 60).then_some(cut)
    });
    let cut = found.unwrap();
    let ledger = cut.ledger;
    let (store, took) = reopened(cut);
    assert!(took <= 3 * LARGE_WORDS, "{took} reads");
    assert_eq!(store.ledger.oldest[0], ledger.oldest[0]);
}

#[test]
fn a_sector_that_goes_bad_while_the_store_is_open_is_given_up_at_once() {
    for class in [class_of, |_| Class::Bearing] {
        let (mut store, _) = full(30, class);
        let head = store.writing.unwrap().sector;
        let before = store.ledger;
        (1..1024).for_each(|word| store.flash.words.damage((head + 4) % 6, word));
        let of = Class::Bearing as usize;
        let (mut number, mut there, mut missed) = (before.oldest[of], 0, 0);
        while number != store.ledger.next[of] {
            if store.read(Class::Bearing, number, &mut []).is_some() {
                there += 1;
                number += 1;
            } else {
                missed += 1;
                store.work();
                number = number.max(store.ledger.oldest[of]);
            }
        }
        let lost = store.ledger.lost[of] - before.lost[of];
        assert!(lost > 100 && missed == 1, "{lost} lost, {missed} times missed");
        assert_eq!(store.ledger.oldest[of] - before.oldest[of], lost);
        // Those before it were read before they were given up with it.
        assert!(there >= store.ledger.kept(Class::Bearing));
    }
}
