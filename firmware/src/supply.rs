//! The supply of a board: where it falls low the recording ends in order, and begins again when it has been good for a while.

use seabearing_core::block::Frame;
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::utc::Pair;
use seabearing_core::wire::{FaultCode, Time};

/// Low for so long is low: shorter is a transmitter's or a card's start.
const LOW_US: u64 = 20_000;
/// The detector's threshold, mV, the number that goes with [`FaultCode::SupplyLow`].
pub const THRESHOLD_MV: u32 = 2850;

/// A detector of low supply.
pub trait Detector {
    /// Whether the supply is below the threshold now.
    fn is_low(&mut self) -> bool;

    /// Microseconds of the board's clock.
    fn now_us(&mut self) -> u64;
}

/// How long the supply has been as it is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Supply {
    low: bool,
    since_us: u64,
}

impl Supply {
    /// Not known to be good: that begins with the first look which says so.
    pub const fn failed() -> Self {
        Self { low: true, since_us: 0 }
    }

    /// A look at the detector: for how long it has said so, in µs, and what.
    fn look(&mut self, detector: &mut impl Detector) -> (bool, u64) {
        let (low, now_us) = (detector.is_low(), detector.now_us());
        if low != self.low {
            *self = Self { low, since_us: now_us };
        }
        (low, now_us.saturating_sub(self.since_us))
    }

    /// Whether it has fallen low for good.
    pub fn has_failed(&mut self, detector: &mut impl Detector) -> bool {
        matches!(self.look(detector), (true, us) if us >= LOW_US)
    }

    /// Whether it has been good for so long, in µs.
    pub fn has_recovered(&mut self, detector: &mut impl Detector, good_us: u64) -> bool {
        matches!(self.look(detector), (false, us) if us >= good_us)
    }
}

/// Turns of the loop from one look at the detector to the next: some milliseconds.
const LOOK_EVERY: u8 = 8;

/// A source that ends when the supply is low.
#[derive(Debug)]
pub struct Supplied<S, D> {
    source: S,
    detector: D,
    supply: Supply,
    failed: bool,
    told: bool,
    turn: u8,
}

impl<S: SampleSource, D: Detector> Supplied<S, D> {
    /// The supply is good so far.
    pub fn new(source: S, detector: D) -> Self {
        Self { source, detector, supply: Supply::default(), failed: false, told: false, turn: 0 }
    }

    /// Whether it ended by the supply.
    pub fn has_failed(&self) -> bool {
        self.failed
    }
}

impl<S: SampleSource, D: Detector> SampleSource for Supplied<S, D> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        self.turn = self.turn.wrapping_add(1);
        if self.turn.is_multiple_of(LOOK_EVERY) {
            self.failed |= self.supply.has_failed(&mut self.detector);
        }
        if self.failed { Chunk::End } else { self.source.read(frames) }
    }

    fn waits(&self) -> bool {
        self.source.waits()
    }

    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        if self.failed && !core::mem::replace(&mut self.told, true) {
            return Some((FaultCode::SupplyLow, u64::from(THRESHOLD_MV)));
        }
        self.source.fault()
    }

    fn age_us(&mut self, index: u64) -> Option<u64> {
        self.source.age_us(index)
    }

    fn pair(&mut self) -> Option<Pair> {
        self.source.pair()
    }

    fn told(&mut self, time: &Time) {
        self.source.told(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    struct Samples;

    impl SampleSource for Samples {
        fn read(&mut self, _: &mut [Frame]) -> Chunk {
            Chunk::Idle
        }
    }

    /// Low or not, and the time.
    struct Battery<'a>(&'a Cell<(bool, u64)>);

    impl Detector for Battery<'_> {
        fn is_low(&mut self) -> bool {
            self.0.get().0
        }
        fn now_us(&mut self) -> u64 {
            self.0.get().1
        }
    }

    #[test]
    fn a_dip_is_nothing_and_low_ends_the_recording_once() {
        let battery = Cell::new((false, 0));
        let mut source = Supplied::new(Samples, Battery(&battery));
        let mut read = |low: bool, us: u64| {
            battery.set((low, us));
            let read = (0..LOOK_EVERY).map(|_| source.read(&mut [])).last();
            (read.unwrap(), source.fault(), source.has_failed())
        };
        // Low since power-on, and dips shorter than what counts.
        assert_eq!(read(true, 5_000), (Chunk::Idle, None, false));
        assert_eq!(read(false, 24_000), (Chunk::Idle, None, false));
        assert_eq!(read(true, 30_000), (Chunk::Idle, None, false));
        assert_eq!(read(true, 49_999), (Chunk::Idle, None, false));
        assert_eq!(read(true, 50_000), (Chunk::End, Some((FaultCode::SupplyLow, 2850)), true));
        // It stays ended, whatever the supply does, and is told once.
        assert_eq!(read(false, 60_000_000), (Chunk::End, None, true));
    }

    #[test]
    fn a_supply_that_comes_and_goes_has_not_recovered() {
        let battery = Cell::new((true, 0));
        let mut supply = Supply::default();
        let mut recovered = |low: bool, s: u64| {
            battery.set((low, 1_000_000 * s));
            supply.has_recovered(&mut Battery(&battery), 5_000_000)
        };
        for s in 0..100 {
            assert!(!recovered(s % 4 == 0, s), "{s}");
        }
        assert!(recovered(false, 103));
    }
}
