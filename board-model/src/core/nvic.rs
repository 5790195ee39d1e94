//! Exceptions: what is pending, enabled and active, and which one is next (ARMv7-M, B1.5 and B3.4).

/// Exception numbers of the core; interrupts follow from 16 on.
pub mod number {
    /// Reset's relative that cannot be masked.
    pub const NMI: u16 = 2;
    /// Any fault that cannot be taken otherwise.
    pub const HARD_FAULT: u16 = 3;
    /// Memory protection.
    pub const MEMORY: u16 = 4;
    /// An access that the bus refused.
    pub const BUS: u16 = 5;
    /// An instruction that cannot be carried out.
    pub const USAGE: u16 = 6;
    /// Supervisor call.
    pub const SVC: u16 = 11;
    /// Deferred work of a supervisor.
    pub const PENDSV: u16 = 14;
    /// The core's own timer.
    pub const SYSTICK: u16 = 15;
    /// The first interrupt.
    pub const FIRST_INTERRUPT: u16 = 16;
}

/// Exceptions there can be.
const COUNT: usize = 256;
/// Lowest priority there is: that of thread mode.
pub(crate) const THREAD: i32 = 256;

/// A set of exceptions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Set(pub [u32; COUNT / 32]);

impl Set {
    pub fn get(&self, number: u16) -> bool {
        self.0[usize::from(number >> 5) & 7] >> (number & 31) & 1 != 0
    }
    pub fn put(&mut self, number: u16, value: bool) {
        let (word, bit) = (&mut self.0[usize::from(number >> 5) & 7], 1 << (number & 31));
        *word = if value { *word | bit } else { *word & !bit };
    }
    pub fn numbers(self) -> impl Iterator<Item = u16> {
        self.0.into_iter().enumerate().filter(|(_, word)| *word != 0).flat_map(|(i, word)| {
            (0..32u16).filter(move |bit| word >> bit & 1 != 0).map(move |bit| i as u16 * 32 + bit)
        })
    }
}

/// The interrupt controller and the core's masks.
#[derive(Clone, Debug)]
pub struct Nvic {
    pub(crate) enabled: Set,
    pub(crate) latched: Set,
    level: Set,
    pub(crate) active: Set,
    pub(crate) priority: [u8; COUNT],
    /// Exceptions taken, by number.
    pub taken: [u64; COUNT],
    pub(crate) primask: bool,
    pub(crate) faultmask: bool,
    pub(crate) basepri: u8,
    pub(crate) prigroup: u8,
    /// Priority of what runs, masks aside.
    running: i32,
    /// The best candidate, while nothing has changed.
    best: Option<(i32, u8, u16)>,
    stale: bool,
    /// An event for `WFE`.
    pub(crate) event: bool,
    pub(crate) send_event_on_pending: bool,
}

impl Default for Nvic {
    fn default() -> Self {
        let mut enabled = Set::default();
        for always in [number::NMI, number::HARD_FAULT, number::SVC, number::PENDSV, number::SYSTICK] {
            enabled.put(always, true);
        }
        Self {
            enabled,
            latched: Set::default(),
            level: Set::default(),
            active: Set::default(),
            priority: [0; COUNT],
            taken: [0; COUNT],
            primask: false,
            faultmask: false,
            basepri: 0,
            prigroup: 0,
            running: THREAD,
            best: None,
            stale: false,
            event: false,
            send_event_on_pending: false,
        }
    }
}

impl Nvic {
    /// A peripheral's interrupt line has this level.
    pub fn set_level(&mut self, interrupt: u16, high: bool) {
        let number = interrupt + number::FIRST_INTERRUPT;
        if self.level.get(number) != high {
            self.level.put(number, high);
            if high {
                self.pend(number);
            }
            self.stale = true;
        }
    }

    /// Makes an exception pending.
    pub fn pend(&mut self, number: u16) {
        if self.send_event_on_pending && !self.latched.get(number) {
            self.event = true;
        }
        self.latched.put(number, true);
        self.stale = true;
    }

    /// What software sees as pending.
    pub(crate) fn pending(&self) -> Set {
        let mut pending = self.latched;
        for i in 0..pending.0.len() {
            pending.0[i] |= self.level.0[i] & !self.active.0[i];
        }
        pending
    }

    /// Something was changed from outside that decides what comes next.
    pub(crate) fn changed(&mut self) {
        self.stale = true;
    }

    fn group(&self, priority: u8) -> i32 {
        i32::from(priority) >> (self.prigroup + 1) << (self.prigroup + 1)
    }

    /// Group priority of an exception.
    pub(crate) fn group_of(&self, exception: u16) -> i32 {
        match exception {
            number::NMI => -2,
            number::HARD_FAULT => -1,
            other => self.group(self.priority[usize::from(other) & 255]),
        }
    }

    fn refresh(&mut self) {
        self.stale = false;
        let mut wanted = self.pending();
        for i in 0..wanted.0.len() {
            wanted.0[i] &= self.enabled.0[i];
        }
        let key = |n: u16| (self.group_of(n), self.priority[usize::from(n) & 255], n);
        self.best = wanted.numbers().map(key).min();
        self.running = self.active.numbers().map(|n| self.group_of(n)).min().unwrap_or(THREAD);
    }

    /// Priority that an exception must beat; with the mask of `CPSID i` or without.
    pub(crate) fn barrier(&self, primask: bool) -> i32 {
        let mut barrier = self.running;
        if self.basepri != 0 {
            barrier = barrier.min(self.group(self.basepri));
        }
        if primask && self.primask {
            barrier = barrier.min(0);
        }
        if self.faultmask {
            barrier = barrier.min(-1);
        }
        barrier
    }

    /// The exception to take now.
    #[inline]
    pub(crate) fn next(&mut self) -> Option<u16> {
        if self.stale {
            self.refresh();
        }
        let (group, _, number) = self.best?;
        (group < self.barrier(true)).then_some(number)
    }

    /// Whether something ends a sleep: as `next`, but `PRIMASK` does not count.
    pub(crate) fn wakes(&mut self) -> bool {
        if self.stale {
            self.refresh();
        }
        self.best.is_some_and(|(group, ..)| group < self.barrier(false))
    }

    pub(crate) fn enter(&mut self, number: u16) {
        self.latched.put(number, false);
        self.active.put(number, true);
        self.taken[usize::from(number) & 255] += 1;
        self.event = true;
        self.refresh();
    }

    pub(crate) fn leave(&mut self, number: u16) {
        self.active.put(number, false);
        if number != number::NMI {
            self.faultmask = false;
        }
        self.event = true;
        self.refresh();
    }

    /// Interrupts taken since the start, faults and the core's own exceptions left out.
    pub fn interrupts(&self) -> u64 {
        self.taken[usize::from(number::FIRST_INTERRUPT)..].iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_stays_pending_until_it_falls_and_an_edge_while_active_counts() {
        let mut nvic = Nvic::default();
        nvic.enabled.put(16 + 5, true);
        nvic.set_level(5, true);
        assert_eq!(nvic.next(), Some(21));
        nvic.enter(21);
        assert_eq!(nvic.next(), None);
        nvic.leave(21);
        assert_eq!(nvic.next(), Some(21), "the line is still high");
        nvic.enter(21);
        nvic.set_level(5, false);
        nvic.set_level(5, true);
        nvic.set_level(5, false);
        nvic.leave(21);
        assert_eq!(nvic.next(), Some(21), "a pulse came while it was active");
    }

    #[test]
    fn priorities_nest_and_masks_hold_back() {
        let mut nvic = Nvic::default();
        for (number, priority) in [(20, 0x60), (21, 0x40), (22, 0x40)] {
            nvic.enabled.put(number, true);
            nvic.priority[usize::from(number)] = priority;
            nvic.pend(number);
        }
        assert_eq!(nvic.next(), Some(21), "the lower number of equals");
        nvic.enter(21);
        assert_eq!(nvic.next(), None, "equals do not preempt");
        nvic.priority[22] = 0x30;
        nvic.changed();
        nvic.primask = true;
        assert_eq!(nvic.next(), None);
        assert!(nvic.wakes());
        nvic.primask = false;
        assert_eq!(nvic.next(), Some(22));
        nvic.basepri = 0x30;
        assert_eq!(nvic.next(), None);
    }
}
