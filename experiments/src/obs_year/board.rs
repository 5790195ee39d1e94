//! The board's logic on the host, as the image has it: acquisition, samples, receiver, supply, the loop, records and
//! configurations in flash, what is kept over a reset. Only registers are missing.

use super::world::{Places, RATE_HZ, Records, World, cause};
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::outlet::Reliable;
use seabearing_core::port::{Chunk, Clock, Link as Line, SampleSource, Supervisor};
use seabearing_core::recorder::{Memory, configuration};
use seabearing_core::run::{BLOCK_FRAMES, run_over};
use seabearing_core::slots::Slots;
use seabearing_core::utc::Pair;
use seabearing_core::wait::wait;
use seabearing_core::wire::FaultCode;
use seabearing_core::wire::guard::Guard;
use seabearing_core::wire::link::flash::{Flash, FlashStore, Word};
use seabearing_core::wire::link::{Link, Settings};
use seabearing_firmware::acquisition::{Acquisition, Board as Converters};
use seabearing_firmware::converter::Read;
use seabearing_firmware::pace::Stamp;
use seabearing_firmware::receiver::{Pulse, Reception, Timed};
use seabearing_firmware::seismic::{Conversion, Seismic};
use seabearing_firmware::starts::Starts;
use seabearing_firmware::supply::{Detector, Supplied};
use std::cell::RefCell;
use std::rc::Rc;

/// The world, shared by all that a board has.
pub type Shared = Rc<RefCell<World>>;

/// Bits a second of the line, and the station's number.
pub const BAUD: u32 = 115_200;
pub const STATION: u16 = 1;
/// From one wake-up by edges to the next.
const WAKE_EDGES: u64 = 16;

/// The chips as the acquisition sees them.
struct Chips {
    world: Shared,
    armed: u64,
    noted: Stamp,
    last: Rc<RefCell<u64>>,
}

/// A number that has nothing to do with its neighbours' (the finaliser of SplitMix64).
fn mix(n: u64) -> u64 {
    let x = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

impl Converters for Chips {
    const RING_FRAMES: usize = 4096;
    const FRAME_BYTES: usize = 4;
    const LEAST_TIMED: u64 = 16;
    const MOMENTS: u8 = 1;
    const LOOK_EVERY: u8 = 1;

    fn hz(&self) -> u32 {
        RATE_HZ as u32
    }
    fn begins_us(&self) -> u64 {
        252_000
    }
    fn set_up(&mut self) -> bool {
        self.world.borrow_mut().set_up()
    }
    fn look_every_us(&self) -> Option<u64> {
        Some(1_000_000)
    }
    fn is_as_set(&mut self) -> bool {
        // Chips without supply say nothing, which is no answer.
        let world = self.world.borrow();
        world.set || !world.converts()
    }
    fn edges(&mut self) -> u64 {
        let world = self.world.borrow();
        if world.edges() >= self.noted.edges + WAKE_EDGES {
            self.noted = Stamp { edges: world.edges(), at_us: world.edge_board_us() };
        }
        world.edges()
    }
    fn stamp(&mut self) -> Stamp {
        self.edges();
        self.noted
    }
    fn now_us(&mut self) -> u64 {
        self.world.borrow().board_us()
    }
    fn arm(&mut self, _: bool) -> Option<u64> {
        self.armed = self.edges();
        Some(self.armed)
    }
    fn disarm(&mut self) {}
    fn received(&mut self) -> usize {
        let frames = self.edges() - self.armed;
        (frames % Self::RING_FRAMES as u64) as usize * Self::FRAME_BYTES
    }
    fn frame(&mut self, slot: usize) -> Read {
        // The newest conversion in that place of the ring.
        let whole = self.edges() - self.armed;
        let back = (whole.wrapping_sub(1).wrapping_sub(slot as u64)) % Self::RING_FRAMES as u64;
        let edge = self.armed + whole - 1 - back;
        *self.last.borrow_mut() = edge;
        let of = |channel: u64| (mix(4 * edge + channel) >> 40) as i32 - (1 << 23);
        Read::Samples(std::array::from_fn(|channel| of(channel as u64)))
    }
}

struct Receiver(Shared);

impl Reception for Receiver {
    fn pulse(&mut self) -> Option<Pulse> {
        self.0.borrow_mut().pulse.take()
    }
    fn byte(&mut self) -> Option<u8> {
        self.0.borrow_mut().sentences.pop_front()
    }
    fn now_us(&mut self) -> u64 {
        self.0.borrow().board_us()
    }
}

/// Notes which edge each conversion's number is of.
struct Noted<S> {
    source: S,
    world: Shared,
    last: Rc<RefCell<u64>>,
}

impl<S: SampleSource> SampleSource for Noted<S> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let chunk = self.source.read(frames);
        if let Chunk::Frames { first_index, count } = chunk {
            let first = *self.last.borrow() + 1 - count as u64;
            let mut world = self.world.borrow_mut();
            world.given += count as u64;
            let shifts = world.boots.last_mut().map(|boot| &mut boot.shifts);
            if let Some(shifts) = shifts
                && shifts.last().is_none_or(|(index, edge)| first_index - index != first - edge)
            {
                shifts.push((first_index, first));
            }
        }
        chunk
    }
    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.source.fault()
    }
    fn age_us(&mut self, index: u64) -> Option<u64> {
        self.source.age_us(index)
    }
    fn pair(&mut self) -> Option<Pair> {
        self.source.pair()
    }
}

struct Wire(Shared);

impl Line for Wire {
    fn send(&mut self, frame: &[u8]) -> bool {
        let mut world = self.0.borrow_mut();
        if world.line {
            world.to_base.extend(frame);
        }
        true
    }
    fn receive(&mut self) -> Option<u8> {
        self.0.borrow_mut().to_board.pop_front()
    }
}

/// Seconds and microseconds of what is computed: the loop knows nothing of what is not.
struct Ticker(Shared);

impl Clock for Ticker {
    fn ticks(&mut self) -> u32 {
        0
    }
    fn seconds(&mut self) -> u32 {
        (self.micros() / 1_000_000) as u32
    }
    fn micros(&mut self) -> u64 {
        self.0.borrow().computed_us
    }
}

struct Supplies(Shared);

impl Detector for Supplies {
    fn is_low(&mut self) -> bool {
        self.0.borrow().supply_low
    }
    fn now_us(&mut self) -> u64 {
        self.0.borrow().board_us()
    }
}

/// Sleep, the reason of the start, and the base station, which hears while the board sleeps.
struct Guardian<'a> {
    world: Shared,
    base: &'a mut dyn FnMut(&Shared),
    starts: Starts,
    /// Turns of the loop since it slept.
    awake: u32,
}

/// More turns than any backlog takes.
const MOST_AWAKE: u32 = 200;

impl Supervisor for Guardian<'_> {
    fn feed(&mut self) {
        let mut world = self.world.borrow_mut();
        if self.starts.works(world.board_us()) {
            world.starts = self.starts.counts();
        }
        world.crash();
        drop(world);
        // At its end the loop does not sleep, and time goes on all the same.
        self.awake += 1;
        if self.awake > MOST_AWAKE {
            self.idle();
        }
    }
    fn idle(&mut self) {
        self.awake = 0;
        self.world.borrow_mut().sleep();
        (self.base)(&self.world);
    }
    fn reset_cause(&self) -> u8 {
        self.world.borrow().cause
    }
    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        self.world.borrow_mut().fault.take().map(|record| record.told())
    }
    fn over(&mut self) -> bool {
        let world = self.world.clone();
        world.borrow().over() || self.starts.over(&mut Supplies(world.clone()))
    }
}

/// A source that ends with the year.
struct Ending<S>(S, Shared);

impl<S: SampleSource> SampleSource for Ending<S> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        if self.1.borrow().over() { Chunk::End } else { self.0.read(frames) }
    }
    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.0.fault()
    }
    fn age_us(&mut self, index: u64) -> Option<u64> {
        self.0.age_us(index)
    }
    fn pair(&mut self) -> Option<Pair> {
        self.0.pair()
    }
}

/// Part of the flash, whose power may go with a write.
#[derive(Clone)]
struct Part<F>(Rc<RefCell<Box<F>>>, Shared);

/// Whether the power went.
trait Cut {
    fn is_cut(&self) -> bool;
}

impl Cut for Records {
    fn is_cut(&self) -> bool {
        self.is_off()
    }
}

impl Cut for Places {
    fn is_cut(&self) -> bool {
        self.is_off()
    }
}

impl<F: Flash + Cut> Part<F> {
    fn after(&self) {
        let off = self.0.borrow().is_cut();
        self.1.borrow_mut().written(off);
    }
}

impl<F: Flash + Cut> Flash for Part<F> {
    const SECTORS: u8 = F::SECTORS;
    const WORDS: u16 = F::WORDS;

    fn read(&self, sector: u8, word: u16) -> Option<Word> {
        self.0.borrow().read(sector, word)
    }
    fn write(&mut self, sector: u8, word: u16, value: &Word) {
        self.0.borrow_mut().write(sector, word, value);
        self.after();
    }
    fn erase(&mut self, sector: u8) {
        self.0.borrow_mut().erase(sector);
        self.after();
    }
    fn busy(&self) -> bool {
        self.0.borrow().busy()
    }
}

/// One start and what follows, until the software starts again by itself or the year is over; a reset ends it by unwinding.
pub fn boot(world: &Shared, built_in: &[u8], base: &mut dyn FnMut(&Shared)) {
    let mut starts = world.borrow_mut().start();
    let (records, places) = {
        let world = world.borrow();
        (world.records.clone(), world.places.clone())
    };
    // What a board has in statics.
    let scratch: &'static mut [u8] = Box::leak(vec![0; built_in.len()].into_boxed_slice());
    let mut blob = vec![0; built_in.len()];
    let usable = |blob: &[u8]| {
        configuration(blob, STATION).is_some_and(|config| Conversion::of(config.rate_hz).is_some())
    };
    let mut slots = Slots::new(Part(places, world.clone()), scratch, usable);
    let found = slots.choose(&mut blob);
    let blob = found.and_then(|found| blob.get(..found.length)).unwrap_or(built_in);

    let (Ok(config), table) = (config_blob::station(blob), config_blob::section(blob, PROPAGATION).ok())
    else {
        return world.borrow_mut().start_again();
    };
    let mut memory: Box<Memory<'_>> = Box::default();
    let (recorder, conversion) = (memory.configure(&config, table), Conversion::of(config.rate_hz));
    let recorder = match (starts.must_wait(), recorder, conversion) {
        (Some(reason), ..) => Err(reason),
        (_, Ok(recorder), Some(conversion)) => Ok((recorder, conversion)),
        _ => Err((FaultCode::BadConfiguration, 1)),
    };
    let store: FlashStore<_, 64> = FlashStore::open(Part(records, world.clone()));
    let boot = store.starts();
    world.borrow_mut().boots.last_mut().into_iter().for_each(|known| known.number = boot);
    let mut link = Link::new(Settings::serial(BAUD), STATION, boot, config.hash(), store);
    let mut line = Wire(world.clone());
    let mut outlet = Reliable::with(&mut line, &mut link, Guard::open(), slots);
    let (mut clock, mut supervisor) =
        (Ticker(world.clone()), Guardian { world: world.clone(), base, starts, awake: 0 });
    let reason = match recorder {
        Ok((mut recorder, conversion)) => {
            let last = Rc::new(RefCell::new(0));
            let chips = Chips { world: world.clone(), armed: 0, noted: Stamp::default(), last: last.clone() };
            let timed = Timed::new(Acquisition::new(chips), Receiver(world.clone()));
            let noted = Noted { source: timed, world: world.clone(), last };
            let seismic = Ending(Seismic::new(noted, conversion), world.clone());
            let mut samples = Supplied::new(seismic, Supplies(world.clone()));
            let mut frames = [[0; 4]; BLOCK_FRAMES];
            run_over(&mut recorder, &mut samples, &mut outlet, &mut clock, &mut supervisor, &mut frames);
            let reason = samples.has_failed().then(|| supervisor.starts.supply_failed());
            world.borrow_mut().starts = supervisor.starts.counts();
            reason
        }
        Err(reason) => Some(reason),
    };
    if world.borrow().over() {
        return;
    }
    if !outlet.restarts() {
        wait(STATION, reason, &mut outlet, &mut clock, &mut supervisor);
    }
    supervisor.starts.again(&mut Supplies(world.clone()));
    world.borrow_mut().starts = supervisor.starts.counts();
    world.borrow_mut().start_again();
    debug_assert_ne!(world.borrow().cause, cause::WATCHDOG);
}
