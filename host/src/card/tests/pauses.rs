//! A recorder with a schedule: what `process` makes of its card is what it said itself.

use super::*;
use crate::replay::replay;
use seabearing_core::config::Schedule;
use seabearing_core::port::{Chunk, Link, NoBoard, NoClock, SampleSource};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_core::utc::Pair;
use seabearing_core::wire::{Decoder, FaultCode, Message};
use seabearing_firmware::card::source::Recorded;

const SCHEDULE: Schedule = Schedule { every_s: 40, on_s: 15 };
/// Two pauses, and what follows them.
const SECONDS: u64 = 90;
/// Samples that never came, while it listens.
const GAP: std::ops::Range<u64> = 60 * 42 * 1024..60 * 42 * 1024 + 6400;

/// Noise with a gap; every block a millisecond.
struct Noise {
    next: u64,
    /// UTC that is known once this sample has come.
    utc: Option<Pair>,
    holder: Rc<RefCell<Holder>>,
}

impl SampleSource for Noise {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        if self.next >= SECONDS * u64::from(RATE_HZ) {
            return Chunk::End;
        }
        if GAP.contains(&self.next) {
            self.next = GAP.end;
        }
        let (first_index, count) = (self.next, STEP as usize);
        (first_index..).zip(frames.iter_mut()).for_each(|(index, frame)| *frame = codes(1, index));
        self.next += STEP;
        self.holder.borrow_mut().now_us += 1000;
        Chunk::Frames { first_index, count }
    }
    fn pair(&mut self) -> Option<Pair> {
        let known = self.utc.filter(|pair| pair.index < self.next);
        if known.is_some() {
            self.utc = None;
        }
        known
    }
}

#[derive(Default)]
struct Line(Vec<u8>);

impl Link for Line {
    fn send(&mut self, frame: &[u8]) -> bool {
        self.0.extend_from_slice(frame);
        true
    }
    fn receive(&mut self) -> Option<u8> {
        None
    }
}

/// What a recorder with a schedule said, its card, and what `process` says of that.
fn played(utc: Option<Pair>) -> (Vec<Message>, Vec<Kept>, Vec<Message>) {
    let holder = holder(60);
    let mut config = station().config;
    config.schedule = SCHEDULE;
    let mut memory: Box<Memory<'_>> = Box::default();
    let mut recorder = memory.configure(&config, None).unwrap();
    let (mut line, mut frames) = (Line::default(), [[0; 4]; BLOCK_FRAMES]);
    session(&holder, 1, |session| {
        let mut pages = vec![[0; PAGE]; RING];
        let mut stage = [0; STAGE_BYTES];
        let mut tables = Box::new(Tables::new());
        let about = About { session: 1, station: 1, rate_hz: RATE_HZ, ..About::default() };
        let drive = session.writer.drive().clone();
        let writer = Writer::new(drive, &mut pages, &mut stage, &mut tables, about);
        let mut source = Recorded::new(Noise { next: 0, utc, holder: Rc::clone(&holder) }, writer);
        run(&mut recorder, &mut source, &mut line, &mut NoClock, &mut NoBoard, &mut frames);
        let now = || {
            holder.borrow_mut().now_us += 500;
            holder.borrow().now_us
        };
        source.settle(&mut NoBoard, now);
    });
    let mut decoder = Decoder::default();
    let said: Vec<Message> =
        line.0.iter().filter_map(|byte| decoder.push(*byte).map(|said| said.message)).collect();
    let folder = folder(&holder.borrow().sectors);
    let mut source = crate::recording::open(&[folder.path().to_owned()], &station(), None).unwrap();
    let mut replayed = Vec::new();
    replay(&config, None, &mut *source, |message| {
        replayed.push(*message);
        Ok(())
    })
    .unwrap();
    let kept = read(&holder.borrow().sectors);
    (said, kept, replayed)
}

fn faults(all: &[Message]) -> Vec<(FaultCode, u64, i64)> {
    let of = |m: &Message| if let Message::Fault(f) = m { Some((f.code, f.index, f.value)) } else { None };
    all.iter().filter_map(of).collect()
}

#[test]
fn a_pause_on_a_card_is_told_as_a_pause() {
    let (said, _, replayed) = played(None);
    let (rate, pause) = (u64::from(RATE_HZ), 25 * i64::from(RATE_HZ));
    let gap = (FaultCode::Gap, GAP.end, (GAP.end - GAP.start) as i64);
    let paused = |second: u64| (FaultCode::Paused, second * rate, pause);
    assert_eq!(faults(&said), [paused(15), gap, paused(55)]);
    assert_eq!(replayed, said);
}

#[test]
fn a_pause_that_utc_cuts_short_ends_on_the_card_too() {
    let at = |second: u64| second * u64::from(RATE_HZ);
    // At 25 s, ten into a pause that would last to 40 s, it turns out that a period began at 12 s: it listens until 27 s, and from 52 s
    // to 67 s. The gap lies in a pause.
    let utc = Pair { index: at(25), utc_us: 1_600_000_013_000_000, sd_s: 1e-6 };
    let (said, kept, replayed) = played(Some(utc));
    let spoken = faults(&said);
    assert_eq!(spoken[0], (FaultCode::Paused, at(15), at(25) as i64));
    assert!(spoken.iter().all(|fault| fault.0 == FaultCode::Paused), "{spoken:?}");
    let missing: Vec<_> = kept.iter().flat_map(|k| &k.gaps).map(|gap| (gap.why, gap.count)).collect();
    let pause = |from: u64, to: u64| (Why::Pause, to - from);
    assert_eq!(missing, [pause(at(15), at(25) + STEP), pause(at(27), at(52))]);
    let last = |all: &[Message]| {
        let of = |m: &Message| if let Message::Health(h) = m { Some((h.processed, h.lost[0])) } else { None };
        all.iter().rev().find_map(of)
    };
    assert_eq!(last(&said).map(|(processed, _)| processed), last(&replayed).map(|(processed, _)| processed));
    // UTC on the card is the recorder's, also of the files that begin later.
    let told = kept.last().and_then(|k| k.utc_us(utc.index as i64)).unwrap();
    assert!((told - utc.utc_us as f64).abs() < 1.0, "{told}");
    assert!(kept.iter().filter(|k| k.label.first_index > utc.index).all(|k| k.times[1].is_some()));
}
