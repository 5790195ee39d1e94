//! Timers: counting up by the clock, by a pin's edges or by another timer; compare, capture, update; interrupts and DMA
//! requests (RM0433, chapters 38 to 41).

use super::clocks::unknown;
use crate::board::{Bus, Refusal};
use crate::time::{NEVER, PER_SECOND, Ticks};

/// Where a timer stands: its base address, its clock's bus, its interrupts and its DMA requests.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub name: &'static str,
    pub base: u32,
    pub bus: u32,
    pub enable: (usize, u32),
    pub wide: bool,
    pub channels: usize,
    /// Interrupt of updates and of captures and compares.
    pub interrupts: (u16, u16),
    /// DMA requests: channel 1 (the others follow), and update; 0: none.
    pub requests: (u8, u8),
}

/// One timer.
#[derive(Debug)]
pub(super) struct Timer {
    pub place: Place,
    registers: [u32; 28],
    /// The prescaler in use; a written one is taken at an update.
    prescaler: u32,
    count: u32,
    /// Edges towards the next count in external clock mode.
    edges: u32,
    /// When the counter had `count`, while it runs by the clock.
    since: Ticks,
    /// DMA requests not yet served: channels 1 to 4 and update.
    pub requests: u8,
    levels: [bool; 2],
    /// Pulses on its trigger output.
    pub triggers: u32,
    /// Frequency of its clock.
    hz: u64,
    /// When something happens that is noticed outside.
    event: Ticks,
    /// Flags that asked for interrupts when last looked at.
    live: u32,
}

mod at {
    pub const CR1: usize = 0;
    pub const CR2: usize = 1;
    pub const SMCR: usize = 2;
    pub const DIER: usize = 3;
    pub const SR: usize = 4;
    pub const EGR: usize = 5;
    pub const CCMR1: usize = 6;
    pub const CCER: usize = 8;
    pub const CNT: usize = 9;
    pub const PSC: usize = 10;
    pub const ARR: usize = 11;
    pub const CCR1: usize = 13;
}

impl Timer {
    pub fn new(place: Place) -> Self {
        let mut timer = Self {
            place,
            registers: [0; 28],
            prescaler: 0,
            count: 0,
            edges: 0,
            since: 0,
            requests: 0,
            levels: [true; 2],
            triggers: 0,
            hz: 0,
            event: NEVER,
            live: 0,
        };
        timer.registers[at::ARR] = timer.mask();
        timer
    }

    fn mask(&self) -> u32 {
        if self.place.wide { u32::MAX } else { 0xffff }
    }

    fn on(&self) -> bool {
        self.registers[at::CR1] & 1 != 0
    }

    fn slave_mode(&self) -> u32 {
        self.registers[at::SMCR] & 7 | self.registers[at::SMCR] >> 13 & 8
    }

    fn trigger(&self) -> u32 {
        self.registers[at::SMCR] >> 4 & 7 | self.registers[at::SMCR] >> 17 & 0x18
    }

    fn counts_edges(&self) -> bool {
        self.slave_mode() == 7
    }

    fn top(&self) -> u64 {
        u64::from(self.registers[at::ARR] & self.mask()) + 1
    }

    fn input_of(&self, channel: usize) -> u32 {
        self.registers[at::CCMR1 + channel / 2] >> (8 * (channel % 2)) & 3
    }

    /// Whether a channel compares rather than captures.
    fn compares(&self, channel: usize) -> bool {
        self.input_of(channel) == 0
    }

    /// Ticks of a count.
    fn period(&self) -> (u64, u64) {
        (PER_SECOND * (u64::from(self.prescaler) + 1), self.hz.max(1))
    }

    /// Counts up by `n`, setting what is met on the way.
    fn count_up(&mut self, n: u64) {
        let top = self.top();
        if n == 0 || top == 1 {
            return;
        }
        let from = u64::from(self.count);
        for channel in 0..self.place.channels {
            let compare = u64::from(self.registers[at::CCR1 + channel] & self.mask());
            if self.compares(channel) && compare < top {
                let ahead = (compare + top - from - 1) % top + 1;
                if ahead <= n {
                    self.event(1 + channel);
                }
            }
        }
        if from + n >= top {
            self.event(0);
            self.prescaler = self.registers[at::PSC];
            if self.registers[at::CR1] & 8 != 0 {
                self.registers[at::CR1] &= !1;
            }
        }
        self.count = ((from + n) % top) as u32;
    }

    /// An update (0) or a channel's capture or compare (1 to 4): flag, DMA request, trigger output.
    fn event(&mut self, which: usize) {
        self.registers[at::SR] |= 1 << which;
        if self.registers[at::DIER] >> (8 + which) & 1 != 0 {
            self.requests |= 1 << which;
        }
        let trigger = match self.registers[at::CR2] >> 4 & 7 {
            2 => which == 0,
            3 => which == 1,
            mode @ 4.. => which == mode as usize - 3,
            _ => false,
        };
        self.triggers += u32::from(trigger);
    }

    /// Brings the counter to a moment.
    pub fn advance(&mut self, now: Ticks) {
        if !self.on() || self.counts_edges() {
            self.since = now;
        } else {
            let (numerator, hz) = self.period();
            let counts = u128::from(now - self.since) * u128::from(hz) / u128::from(numerator);
            self.since += (counts * u128::from(numerator)).div_ceil(u128::from(hz)) as u64;
            self.count_up(counts as u64);
        }
        self.event = self.coming_event();
    }

    /// Goes on at another frequency.
    pub fn set_hz(&mut self, now: Ticks, hz: u64) {
        self.advance(now);
        self.hz = hz;
        self.event = self.coming_event();
    }

    /// When something happens that is noticed outside.
    pub fn next_event(&self) -> Ticks {
        self.event
    }

    fn coming_event(&self) -> Ticks {
        if !self.on() || self.counts_edges() {
            return NEVER;
        }
        let enabled = self.registers[at::DIER];
        let top = self.top();
        let from = u64::from(self.count);
        let mut counts = u64::MAX;
        for which in 0..=self.place.channels {
            let noticed = enabled >> which & 1 != 0 && self.registers[at::SR] >> which & 1 == 0
                || enabled >> (8 + which) & 1 != 0
                || self.registers[at::CR2] >> 4 & 7 > 1;
            let target =
                if which == 0 { 0 } else { u64::from(self.registers[at::CCR1 + which - 1] & self.mask()) };
            if noticed && target < top && (which == 0 || self.compares(which - 1)) {
                counts = counts.min((target + top - from - 1) % top + 1);
            }
        }
        if counts == u64::MAX {
            return NEVER;
        }
        let (numerator, hz) = self.period();
        let ahead = (u128::from(counts) * u128::from(numerator)).div_ceil(u128::from(hz));
        self.since.saturating_add(ahead as u64)
    }

    /// How long the level of a pin must last to be seen, by the filter of its channel (RM0433, 38.4.8).
    fn filter(&self, channel: usize) -> Ticks {
        const OF: [(u64, u64); 16] = [
            (1, 0),
            (1, 2),
            (1, 4),
            (1, 8),
            (2, 6),
            (2, 8),
            (4, 6),
            (4, 8),
            (8, 6),
            (8, 8),
            (16, 5),
            (16, 6),
            (16, 8),
            (32, 5),
            (32, 6),
            (32, 8),
        ];
        let (divider, samples) = OF[(self.registers[at::CCMR1] >> (8 * channel + 4) & 15) as usize];
        // The slower sampling clock is CR1's, from the fourth on.
        let slower = if divider > 1 { 1 << (self.registers[at::CR1] >> 8 & 3) } else { 1 };
        PER_SECOND * divider * slower * samples / self.hz.max(1)
    }

    /// The pin of channel 1 or 2 (0 or 1) has this level, for so long. A level that does not last through the filter is not seen; the
    /// filter's delay is not modelled.
    pub fn pin(&mut self, channel: usize, high: bool, lasts: Ticks) {
        if self.levels[channel] == high || lasts < self.filter(channel) {
            return;
        }
        self.levels[channel] = high;
        let polarity = self.registers[at::CCER] >> (4 * channel);
        let wanted = match (polarity >> 1 & 1, polarity >> 3 & 1) {
            (0, 0) => high,
            (1, 0) => !high,
            _ => true,
        };
        let by_pin = match self.trigger() {
            4 => channel == 0,
            5 => channel == 0 && wanted,
            6 => channel == 1 && wanted,
            _ => false,
        };
        if self.on() && self.counts_edges() && by_pin {
            self.edge();
        }
        for capture in 0..self.place.channels.min(2) {
            // 1: its own input, 2: the other one of the pair.
            let own = self.input_of(capture) == 1 && capture == channel;
            let other = self.input_of(capture) == 2 && capture != channel;
            if wanted && self.registers[at::CCER] >> (4 * capture) & 1 != 0 && (own || other) {
                self.registers[at::CCR1 + capture] = self.count;
                // Captured again before the first was read.
                self.registers[at::SR] |= (self.registers[at::SR] >> (1 + capture) & 1) << (9 + capture);
                self.event(1 + capture);
            }
        }
    }

    /// A pulse of another timer's trigger output, its number in this one's list of inputs.
    pub fn internal_trigger(&mut self, input: u32) {
        if self.on() && self.counts_edges() && self.trigger() == input {
            self.edge();
        }
    }

    fn edge(&mut self) {
        self.edges += 1;
        if self.edges > self.prescaler {
            self.edges = 0;
            self.count_up(1);
        }
    }

    pub fn lines(&mut self, bus: &mut Bus<'_>) {
        let live = self.registers[at::SR] & self.registers[at::DIER];
        if std::mem::replace(&mut self.live, live) == live {
            return;
        }
        let (update, compare) = self.place.interrupts;
        if update == compare {
            bus.nvic.set_level(update, live & 0x1f != 0);
        } else {
            bus.nvic.set_level(update, live & 1 != 0);
            bus.nvic.set_level(compare, live & 0x1e != 0);
        }
    }

    pub fn read(&mut self, offset: usize) -> Result<u32, Refusal> {
        match offset / 4 {
            at::CNT => Ok(self.count),
            register @ at::CCR1..=16 if !self.compares(register - at::CCR1) => {
                // Reading what was captured clears its flag.
                self.registers[at::SR] &= !(2 << (register - at::CCR1));
                Ok(self.registers[register])
            }
            register => self.registers.get(register).copied().ok_or_else(|| unknown(self.place.name, offset)),
        }
    }

    pub fn write(&mut self, offset: usize, value: u32) -> Result<(), Refusal> {
        let name = self.place.name;
        match offset / 4 {
            at::CR1 if value & 0x70 != 0 => {
                return Refusal::stop(format!("{name} counts down, which is not modelled"));
            }
            at::SMCR => {
                self.registers[at::SMCR] = value;
                if !matches!(self.slave_mode(), 0 | 7) || value & 0x4000 != 0 {
                    return Refusal::stop(format!(
                        "slave mode {} of {name} is not modelled",
                        self.slave_mode()
                    ));
                }
            }
            at::SR => self.registers[at::SR] &= value,
            at::EGR => {
                if value & 1 != 0 {
                    self.count = 0;
                    self.edges = 0;
                    self.prescaler = self.registers[at::PSC];
                    // With URS only an overflow is an update.
                    if self.registers[at::CR1] & 4 == 0 {
                        self.event(0);
                    }
                }
                for channel in (1..=self.place.channels).filter(|c| value >> c & 1 != 0) {
                    self.event(channel);
                }
            }
            at::CNT => self.count = value & self.mask(),
            register if register < self.registers.len() => self.registers[register] = value,
            _ => return Err(unknown(name, offset)),
        }
        self.event = self.coming_event();
        Ok(())
    }
}
