//! The recorder's writer on a simulated card: whatever happens, what the card had taken is there, with its right numbers, and
//! ordinary readers open every file.

use super::blank::Blank;
use super::kept::{self, Kept};
use super::medium::{Medium, Part};
use super::simulated::{Holder, Sectors, Simulated};
use super::{extents, name};
use proptest::prelude::*;
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::wire::Time;
use seabearing_firmware::card::clips::Clips;
use seabearing_firmware::card::layout::{Extent, LEAST_PAGES, Why};
use seabearing_firmware::card::search::STAGE_BYTES;
use seabearing_firmware::card::writer::{About, Event, Tables, Writer};
use seabearing_firmware::card::{PAGE, Trouble};
use std::cell::RefCell;
use std::rc::Rc;

mod clips;
mod pauses;

const RATE_HZ: u32 = 64_000;
/// Instants of a step of 1 ms.
const STEP: u64 = 64;
/// The board's ring.
const RING: usize = 25;

/// The codes of a sample: nothing else has them, and none of them is 0.
fn codes(session: u32, index: u64) -> Frame {
    let mut x = index.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(session) << 56;
    x = (x ^ x >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    [0, 16, 32, 40].map(|shift| ((x >> shift) as i32 & 0x7f_ffff | 1) - 0x40_0000)
}

fn blank(files: u32) -> Blank {
    Blank::new(1_400_000, Some(files), LEAST_PAGES, RATE_HZ).unwrap()
}

fn holder(files: u32) -> Rc<RefCell<Holder>> {
    let sectors = Sectors::of(&blank(files)).unwrap();
    Rc::new(RefCell::new(Holder { sectors, write_us: 2500, ..Holder::default() }))
}

/// What a start of the recorder does, and what it told.
struct Session<'a> {
    number: u32,
    writer: Writer<'a, Simulated>,
    index: u64,
    events: Vec<Event>,
}

/// Runs `play` with a recorder over a card.
fn session<R>(holder: &Rc<RefCell<Holder>>, number: u32, play: impl FnOnce(&mut Session<'_>) -> R) -> R {
    keeping(Clips::default(), holder, number, play)
}

/// The same with one that may keep clips only.
fn keeping<R>(
    clips: Clips,
    holder: &Rc<RefCell<Holder>>,
    number: u32,
    play: impl FnOnce(&mut Session<'_>) -> R,
) -> R {
    let mut pages = vec![[0; PAGE]; RING];
    let mut stage = [0; STAGE_BYTES];
    let mut tables = Box::new(Tables::new());
    let about = About { session: number, station: 3, rate_hz: RATE_HZ, config_hash: 77, clips };
    let mut writer = Writer::new(Simulated(Rc::clone(holder)), &mut pages, &mut stage, &mut tables, about);
    // The loop asks before the converter gives its first samples.
    writer.work();
    play(&mut Session { number, writer, index: 0, events: Vec::new() })
}

impl Session<'_> {
    /// A millisecond with or without samples; damaged ones where `damaged` says so.
    fn step(&mut self, sound: bool, damaged: impl Fn(u64) -> bool) {
        if sound {
            let frame = |index| if damaged(index) { [MISSING; 4] } else { codes(self.number, index) };
            let frames: Vec<Frame> = (self.index..self.index + STEP).map(frame).collect();
            self.writer.take(self.index, &frames);
        }
        self.index += STEP;
        for _ in 0..2 {
            self.writer.work();
            self.events.extend(self.writer.event());
        }
        self.writer.drive().0.borrow_mut().now_us += 1000;
    }

    fn steps(&mut self, count: u32) {
        (0..count).for_each(|_| self.step(true, |_| false));
    }

    fn finish(&mut self) {
        self.writer.finish();
        for _ in 0..2000 {
            self.step(false, |_| false);
        }
        assert!(self.writer.rests());
    }
}

/// What is on a card; every instant of it is held against its codes, and every file is opened by an ordinary reader.
fn read(sectors: &Sectors) -> Vec<Kept> {
    let mut medium = sectors;
    let mut all = Vec::new();
    for (number, extent) in extents(&mut medium).unwrap() {
        let mut file = Part { medium: &mut medium, first: extent.first };
        let Some(kept) = kept::recover(&mut file, extent.pages).unwrap() else {
            assert!(ordinary(sectors, Extent { pages: 1, ..extent }).is_empty(), "{}", name(number));
            continue;
        };
        let ordinary = ordinary(sectors, extent);
        let frames = kept::frames(&mut file, 0, kept.frames as usize).unwrap();
        assert!(frames.starts_with(&ordinary), "{}", name(number));
        assert_eq!(kept.label.file, number);
        let (mut index, mut gaps) = (kept.label.first_index, kept.gaps.iter().peekable());
        for (at, frame) in (0..).zip(&frames) {
            while let Some(gap) = gaps.next_if(|gap| gap.at == at) {
                index += gap.count;
            }
            assert_eq!(*frame, codes(kept.label.session, index), "{} at {at}, sample {index}", name(number));
            index += 1;
        }
        all.push(kept);
    }
    all
}

/// A file as an ordinary reader reads it.
fn ordinary(sectors: &Sectors, extent: Extent) -> Vec<Frame> {
    let bytes = Part { medium: &mut &*sectors, first: extent.first }.read(0, extent.pages * 32).unwrap();
    let mut reader = hound::WavReader::new(std::io::Cursor::new(bytes)).unwrap();
    let spec = reader.spec();
    assert_eq!((spec.channels, spec.bits_per_sample, spec.sample_rate), (4, 24, RATE_HZ));
    let samples: Vec<i32> = reader.samples::<i32>().map(Result::unwrap).collect();
    samples.as_chunks::<4>().0.to_vec()
}

/// A line of UTC at the nominal rate.
fn time(index: u64, utc_us: i64) -> Time {
    Time { index, utc_us, sd_s: 1e-6, drift: 0.0, sd_drift: 1e-9, correlation: 0.0 }
}

/// A card's files in a folder.
fn folder(sectors: &Sectors) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut medium = sectors;
    for (number, extent) in extents(&mut medium).unwrap() {
        let bytes = medium.read(extent.first, extent.pages * 32).unwrap();
        std::fs::write(folder.path().join(name(number)), bytes).unwrap();
    }
    folder
}

/// A station with an array.
fn station() -> crate::station::Station {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/demo-station.toml");
    crate::station::Station::of_recorder(&file).unwrap()
}

fn mix(n: u64) -> u64 {
    let x = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x ^ x >> 27
}

proptest! {
    #![proptest_config(seabearing_testkit::property(40))]

    #[test]
    fn power_cut_in_the_middle_of_any_write_loses_nothing_that_the_card_had_taken(
        seed in any::<u64>(), cuts in proptest::collection::vec(0u64..160, 1..4)
    ) {
        let holder = holder(8);
        let mut taken = Vec::new();
        for (cut, number) in cuts.iter().zip(1..) {
            session(&holder, number, |recorder| {
                let last = holder.borrow().writes + cut;
                for n in 0..6000 {
                    let key = mix(seed ^ n << 8 ^ u64::from(number));
                    let hour = key % 400;
                    // Now and then a slow card, a gap, damaged instants.
                    if hour == 1 {
                        holder.borrow_mut().stall_us = key % 400_000;
                    }
                    recorder.step(hour != 2, |index| hour == 3 && (index ^ key).is_multiple_of(7));
                    if holder.borrow().writes > last {
                        break;
                    }
                }
                let mut holder = holder.borrow_mut();
                prop_assert!(holder.writes > last, "the recorder has written less");
                if let Some((sector, bytes)) = holder.under_way.take() {
                    let torn = (mix(seed) as usize) % bytes.len();
                    holder.sectors.write(sector, &bytes[..torn]);
                }
                (holder.done_us, holder.stall_us) = (0, 0);
                taken.push((number, recorder.writer.recorded(), recorder.writer.lost()));
                Ok(())
            })?;
            let kept = read(&holder.borrow().sectors);
            for (number, taken, _) in &taken {
                let there: u64 =
                    kept.iter().filter(|k| k.label.session == *number).map(|k| u64::from(k.frames)).sum();
                // The last instant may be taken for one that was cut.
                prop_assert!(there + 1 >= *taken, "start {number}: {there} of {taken}");
            }
        }
    }
}

#[test]
fn a_recording_is_whole_over_files_stalls_and_gaps_and_ends_with_its_last_sample() {
    let holder = holder(6);
    let end = session(&holder, 1, |recorder| {
        recorder.steps(300);
        holder.borrow_mut().stall_us = 500_000;
        recorder.steps(1500);
        (0..50).for_each(|_| recorder.step(false, |_| false));
        recorder.writer.told(&time(64_000, 1_000_000));
        recorder.steps(1000);
        recorder.step(true, |index| index.is_multiple_of(2));
        recorder.steps(100);
        let end = recorder.index;
        recorder.finish();
        assert_eq!(recorder.events, []);
        assert_eq!(recorder.writer.lost(), 0);
        end
    });
    let kept = read(&holder.borrow().sectors);
    assert_eq!(kept.len(), 3);
    assert!(kept.iter().all(|k| k.closed && k.untold == 0 && k.label.session == 1 && k.label.station == 3));
    assert!(kept.windows(2).all(|pair| pair[0].end_index() == pair[1].label.first_index));
    // What came before the card was ready is there too.
    assert_eq!((kept[0].label.first_index, kept[2].end_index()), (0, end));
    let gaps: Vec<_> = kept.iter().flat_map(|k| &k.gaps).collect();
    assert_eq!((gaps[0].why, gaps[0].count), (Why::Gap, 50 * STEP));
    assert_eq!(gaps.iter().filter(|gap| gap.why == Why::Damaged).count(), STEP as usize / 2);
    assert_eq!(kept[1].utc_us(128_000), Some(2_000_000.0));
}

#[test]
fn a_folder_with_a_cards_files_is_the_recording_that_the_recorder_heard() {
    let holder = holder(8);
    let damaged = |index: u64| index.is_multiple_of(5);
    let gap = 50_048..51_200;
    for number in [1, 2] {
        session(&holder, number, |recorder| {
            for _ in 0..2000 {
                let at = recorder.index;
                recorder
                    .step(!gap.contains(&at), |index| (64_000..64_128).contains(&index) && damaged(index));
            }
            recorder.writer.told(&time(64_000, i64::from(number) * 5_000_000));
            recorder.finish();
        });
    }
    let (folder, station) = (folder(&holder.borrow().sectors), station());
    let mut source = crate::recording::open(&[folder.path().to_owned()], &station, None).unwrap();
    // Sample 64 000 of the first start was at 5 s, of the second at 10 s: sample 320 000 further.
    assert_eq!(source.start(), time::OffsetDateTime::from_unix_timestamp(4).ok());
    let mut wanted = [(1, 0), (2, 320_000)].into_iter().flat_map(|(number, from)| {
        let frame = move |index| match (64_000..64_128).contains(&index) && damaged(index) {
            true => [MISSING; 4],
            false => codes(number, index),
        };
        (0..2000 * STEP).filter(|index| !gap.contains(index)).map(move |index| (from + index, frame(index)))
    });
    while let Some(block) = source.next_block().unwrap() {
        for (index, frame) in (block.first_index..).zip(block.frames) {
            assert_eq!(Some((index, *frame)), wanted.next());
        }
    }
    assert_eq!(wanted.next(), None);
}

#[test]
fn a_card_that_stalls_for_too_long_is_named_and_what_is_lost_stands_in_the_file() {
    let holder = holder(6);
    session(&holder, 1, |recorder| {
        recorder.steps(300);
        holder.borrow_mut().stall_us = 800_000;
        recorder.steps(2000);
        recorder.finish();
        let [Event::Failed(Trouble::Stalled, 0), Event::Back(missed)] = recorder.events[..] else {
            panic!("{:?}", recorder.events)
        };
        let kept = read(&holder.borrow().sectors);
        let gap = kept.iter().flat_map(|k| &k.gaps).find(|gap| gap.why == Why::Card).unwrap();
        assert_eq!(gap.count, missed);
        assert!(missed > 10_000 && missed < 40_000, "{missed}");
    });
}

#[test]
fn an_error_that_passes_costs_no_sound() {
    for at in (300..420).step_by(7) {
        let holder = holder(6);
        session(&holder, 1, |recorder| {
            recorder.steps(at);
            for _ in 0..2 {
                holder.borrow_mut().trouble = Some(Trouble::Errors);
                recorder.steps(10);
                holder.borrow_mut().trouble = None;
                recorder.steps(1000);
            }
            recorder.finish();
            assert_eq!((recorder.events.clone(), recorder.writer.lost()), (Vec::new(), 0), "at {at}");
        });
        let kept = read(&holder.borrow().sectors);
        assert!(kept.iter().all(|k| k.gaps.is_empty() && k.closed), "at {at}");
        assert_eq!(kept.iter().map(|k| u64::from(k.frames)).sum::<u64>(), (u64::from(at) + 2020) * STEP);
    }
}

#[test]
fn a_gap_storm_fills_no_card() {
    let holder = holder(6);
    session(&holder, 1, |recorder| {
        recorder.steps(200);
        (0..1200).for_each(|_| recorder.step(true, |index| index.is_multiple_of(5)));
        recorder.finish();
    });
    let kept = read(&holder.borrow().sectors);
    assert!(kept.len() <= 2, "{}", kept.len());
    let (first, last) = (&kept[0], &kept[kept.len() - 1]);
    let there: u64 = kept.iter().map(|k| u64::from(k.frames)).sum();
    let missing: u64 = kept.iter().flat_map(|k| &k.gaps).map(|gap| gap.count).sum();
    assert_eq!(first.label.first_index + there + missing, last.end_index());
}

#[test]
fn a_card_that_is_full_wrong_pulled_or_broken_is_named_once() {
    let events = |holder: &Rc<RefCell<Holder>>, number| {
        session(holder, number, |recorder| {
            recorder.steps(4000);
            recorder.events.clone()
        })
    };
    let full = holder(1);
    let frames = u64::from(Extent { first: 0, pages: LEAST_PAGES }.frames());
    assert_eq!(events(&full, 1), [Event::Full(frames)]);
    assert_eq!(events(&full, 2), [Event::Full(0)]);
    assert_eq!(read(&full.borrow().sectors).len(), 1);
    let wrong = Rc::new(RefCell::new(Holder { write_us: 2500, ..Holder::default() }));
    assert!(matches!(events(&wrong, 1)[..], [Event::Failed(Trouble::NotPrepared, _)]));
    let pulled = holder(6);
    session(&pulled, 1, |recorder| {
        recorder.steps(500);
        pulled.borrow_mut().trouble = Some(Trouble::NoCard);
        recorder.steps(3000);
        assert!(matches!(recorder.events[..], [Event::Failed(Trouble::NoCard, _)]), "{:?}", recorder.events);
        pulled.borrow_mut().trouble = None;
        recorder.steps(12_000);
        let [_, Event::Back(missed)] = recorder.events[..] else { panic!("{:?}", recorder.events) };
        assert!(missed >= 3000 * STEP);
        let kept = read(&pulled.borrow().sectors);
        assert!(!kept[0].closed && kept[1].label.first_index - kept[0].end_index() <= missed);
    });
}

#[test]
fn the_card_is_what_another_reader_of_fat_takes_it_for() {
    let blank = blank(40);
    let mut sectors = Sectors::of(&blank).unwrap();
    let partition = sectors.read(8192, blank.sectors - 8192).unwrap();
    let system = fatfs::FileSystem::new(std::io::Cursor::new(partition), fatfs::FsOptions::new()).unwrap();
    assert_eq!(system.fat_type(), fatfs::FatType::Fat32);
    let mut names: Vec<_> = system.root_dir().iter().map(|entry| entry.unwrap()).collect();
    names.sort_by_key(|entry| entry.file_name());
    assert!(names.iter().map(|entry| entry.file_name()).eq((1..=40).map(name)));
    for entry in names {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry.to_file(), &mut bytes).unwrap();
        assert_eq!(bytes.len(), LEAST_PAGES as usize * PAGE);
        assert_eq!(hound::WavReader::new(&bytes[..]).unwrap().duration(), 0);
    }
    let found = extents(&mut sectors).unwrap();
    assert!(found.iter().map(|file| file.0).eq(1..=40));
    // A file in pieces is passed over: the entry of its second cluster, which holds the number of the third.
    let begins =
        |n: &u32| sectors.0.get(n).is_some_and(|sector| sector.starts_with(&[0xf8, 0xff, 0xff, 0x0f]));
    let table = (8192..9000).find(begins).unwrap();
    let mut entries = sectors.read(table, 1).unwrap();
    let ends = |at: &usize| entries[4 * at..4 * at + 4] == [0xff, 0xff, 0xff, 0x0f];
    let folder = (2..20).find(ends).unwrap();
    entries[4 * (folder + 2)] ^= 1;
    sectors.write(table, &entries);
    let holder = Rc::new(RefCell::new(Holder { sectors, write_us: 100, ..Holder::default() }));
    session(&holder, 1, |recorder| recorder.steps(200));
    let mut medium = &holder.borrow().sectors;
    let used = found.iter().find(|(_, extent)| {
        kept::recover(&mut Part { medium: &mut medium, first: extent.first }, extent.pages).unwrap().is_some()
    });
    assert_eq!(used.map(|file| file.0), Some(2));
}
