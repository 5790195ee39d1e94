//! A four-channel converter of the ADS131M04 kind as its data sheet describes it (Texas Instruments SBAS890): words of
//! 24 bits, registers, CRC, status, reset, output two deep.

use crate::board::Refusal;
use crate::time::{NEVER, PER_SECOND, Ticks};
use std::collections::VecDeque;

/// Frequency of the converter's clock.
pub const CLOCK_HZ: u64 = 8_192_000;
/// What is kept of a conversion that arrived with a wrong bit: no code of 24 bits.
pub const DAMAGED: i32 = i32::MIN;
/// Codes of one conversion.
pub type Codes = [i32; 4];

const WORD: usize = 3;
const STATUS: usize = 1;
const MODE: usize = 2;
const CLOCK: usize = 3;
const GAIN: usize = 4;
const RESET_BIT: u16 = 1 << 10;
/// In MODE: a check sum over the registers is compared all the time; in STATUS: it is another than it was.
const REGISTER_CRC: u16 = 1 << 13;
const REGISTERS_CHANGED: u16 = 1 << 13;
const CRC_ERROR: u16 = 1 << 12;
const INPUT_CRC: u16 = 1 << 12;
const RESYNCHRONISED: u16 = 1 << 14;
const LOCKED: u16 = 1 << 15;
/// From a reset to answers: 5 µs.
pub const REGISTER_ACQUISITION: Ticks = PER_SECOND / 200_000;
/// Shortest low pulse on SYNC/RESET that resets, in clocks.
const RESET_PULSE_CLOCKS: u64 = 2048;

/// Conversions whose codes come from outside: `None` when there are no more.
pub type Source = Box<dyn FnMut() -> Option<Codes> + Send>;

/// The converter.
pub struct Ads131m04 {
    registers: [u16; 64],
    source: Source,
    /// What conversions at the rate to be recorded are read from; at other rates they are zeros.
    rate_hz: f64,
    /// Ticks of the board's clock for a tick of this one's: its relative error.
    stretch: f64,
    phase: f64,
    next_conversion: Ticks,
    /// Conversions waiting to be read: number in the source, if it came from there, and codes.
    output: VecDeque<(Option<u64>, Codes)>,
    shown: (Option<u64>, Codes),
    next_number: u64,
    /// When the newest numbered conversion was due.
    numbered_at: f64,
    exhausted: bool,
    /// No conversions are done.
    standby: bool,
    /// The line from the converter is cut: nothing it says arrives, while it goes on converting.
    pub mute: bool,
    /// A bit of the frame under way arrived wrong.
    damaged: bool,
    /// Not converting and not answering.
    pub dead: bool,
    /// First word of the next frame, where it is not the status.
    answer: Option<u16>,
    answers: Vec<u16>,
    deaf_until: Ticks,
    /// Time from a reset to answers, [`REGISTER_ACQUISITION`] unless changed.
    pub acquisition: Ticks,
    frame_in: Vec<u8>,
    frame_out: Vec<u8>,
    /// The result that the frame being clocked out is of, whatever becomes of those that wait.
    clocked: Option<(Option<u64>, Codes)>,
    selected: bool,
    ready: bool,
    edges: VecDeque<(bool, Ticks)>,
    /// When something else than the converter turns the data-ready line round, and for how long; in order.
    pub glitches: VecDeque<(Ticks, Ticks)>,
    /// The next of them, when it is due after a conversion.
    pulse: Option<(Ticks, Ticks)>,
    /// When its filters are to begin afresh.
    afresh: Option<Ticks>,
    low_since: Option<Ticks>,
    /// Flips one bit of every n-th byte that is read, where n is not 0.
    pub bit_errors_every: u64,
    bytes: u64,
    /// Numbers of the conversions that were read whole, in order, by frames without a command: with one it is the answer that
    /// counts.
    pub delivered: Vec<u64>,
    /// What was read of them, for the host.
    pub codes: Vec<Codes>,
    /// When each number's conversion was done; [`NEVER`] for those the converter left out.
    pub moments: Vec<Ticks>,
}

impl std::fmt::Debug for Ads131m04 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ads131m04").field("delivered", &self.delivered.len()).finish_non_exhaustive()
    }
}

/// CRC-16/CCITT with start 0xffff.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |crc, byte| {
        (0..8)
            .fold(crc ^ u16::from(*byte) << 8, |crc, _| crc << 1 ^ if crc & 0x8000 != 0 { 0x1021 } else { 0 })
    })
}

impl Ads131m04 {
    /// A converter at power-on that is to record at `rate_hz`; its clock is fast by `error` (relative) against the
    /// board's.
    pub fn new(source: Source, rate_hz: f64, error: f64) -> Self {
        let mut converter = Self {
            registers: [0; 64],
            source,
            rate_hz,
            stretch: 1.0 / (1.0 + error),
            phase: 0.0,
            next_conversion: NEVER,
            output: VecDeque::new(),
            shown: (None, [0; 4]),
            next_number: 0,
            numbered_at: 0.0,
            exhausted: false,
            standby: false,
            mute: false,
            damaged: false,
            dead: false,
            answer: None,
            answers: Vec::new(),
            deaf_until: 0,
            acquisition: REGISTER_ACQUISITION,
            frame_in: Vec::new(),
            frame_out: Vec::new(),
            clocked: None,
            selected: false,
            ready: true,
            edges: VecDeque::new(),
            glitches: VecDeque::new(),
            pulse: None,
            afresh: None,
            low_since: None,
            bit_errors_every: 0,
            bytes: 0,
            delivered: Vec::new(),
            codes: Vec::new(),
            moments: Vec::new(),
        };
        converter.reset(0);
        converter
    }

    /// Everything as after a reset: of the supply, by command, by the pin, or by a disturbance.
    pub fn reset(&mut self, now: Ticks) {
        self.registers = [0; 64];
        self.registers[0] = 0x2403;
        self.registers[STATUS] = 0x0500;
        self.registers[MODE] = 0x0510;
        self.registers[CLOCK] = 0x0f0e;
        self.registers[6] = 0x0600;
        self.output.clear();
        self.standby = false;
        self.answer = Some(0xff24);
        self.answers.clear();
        self.deaf_until = now + self.acquisition;
        self.restart(now);
    }

    /// Samples a second as the clock register says.
    pub fn rate(&self) -> f64 {
        let clock = self.registers[CLOCK];
        let modulator = CLOCK_HZ as f64 / [8.0, 4.0, 2.0, 2.0][usize::from(clock & 3)];
        let oversampling = if clock & 0x20 != 0 { 64.0 } else { f64::from(128u32 << (clock >> 2 & 7)) };
        modulator / oversampling
    }

    /// Ticks of a conversion.
    fn period(&self) -> f64 {
        PER_SECOND as f64 / self.rate() * self.stretch
    }

    /// The filters start afresh: the first result comes when they have settled.
    fn restart(&mut self, now: Ticks) {
        self.phase = now as f64 + 3.0 * self.period();
        self.next_conversion = if self.dead || self.standby { NEVER } else { self.phase as Ticks };
    }

    /// Conversions of the source that are done.
    pub fn converted(&self) -> u64 {
        self.next_number
    }

    /// Whether the source has ended.
    pub fn exhausted(&self) -> bool {
        self.exhausted
    }

    /// Stops converting and answering, or begins anew.
    pub fn set_dead(&mut self, dead: bool, now: Ticks) {
        self.dead = dead;
        if dead { self.next_conversion = NEVER } else { self.reset(now) }
    }

    /// Flips a bit of a register, as a disturbance does: it goes on so, and says so in its status where it was told to check.
    pub fn upset(&mut self, register: usize, bit: u32, now: Ticks) {
        self.registers[register] ^= 1 << bit;
        if self.registers[MODE] & REGISTER_CRC != 0 {
            self.registers[STATUS] |= REGISTERS_CHANGED;
        }
        if register == CLOCK {
            self.restart(now);
        }
    }

    /// When it next has a result, or something happens to its line.
    pub fn next_event(&self) -> Ticks {
        let pulses = self.glitches.front().into_iter().chain(&self.pulse).map(|(at, _)| *at);
        pulses.chain(self.afresh).fold(self.next_conversion, Ticks::min)
    }

    /// Levels of the data-ready line since the last look, in order, and how long each lasted at least; a level that lasts has no end.
    pub fn next_edge(&mut self) -> Option<(bool, Ticks)> {
        self.edges.pop_front()
    }

    fn set_ready_line(&mut self, high: bool) {
        if self.ready != high {
            self.ready = high;
            self.edges.push_back((high, NEVER));
        }
    }

    fn glitch(&mut self, lasts: Ticks) {
        self.edges.extend([(!self.ready, lasts), (self.ready, NEVER)]);
    }

    /// The converter's clock stops for so many conversions: they come later, and nothing is reset.
    pub fn stop_clock(&mut self, conversions: f64) {
        if self.next_conversion != NEVER {
            self.phase += conversions * self.period();
            self.next_conversion = self.phase as Ticks;
        }
    }

    /// So long after a conversion as it was to be after a whole number of periods: when the converter began is the firmware's affair.
    fn in_phase(&self, at: Ticks) -> Ticks {
        self.next_conversion + at % (self.period() as Ticks).max(1)
    }

    /// Its filters begin afresh so long after the next conversion as this is after a whole number of periods.
    pub fn resynchronise_in_phase(&mut self, at: Ticks) {
        if self.next_conversion != NEVER {
            self.afresh = Some(self.in_phase(at));
        }
    }

    /// A conversion is done, if it is due.
    pub fn advance(&mut self, now: Ticks) {
        while self.glitches.front().is_some_and(|glitch| glitch.0 <= now)
            && let Some((at, lasts)) = self.glitches.pop_front()
        {
            if self.pulse.is_none() && self.next_conversion != NEVER {
                self.pulse = Some((self.in_phase(at), lasts));
            }
        }
        while self.next_conversion <= now {
            self.pulses(self.next_conversion);
            let done = self.next_conversion;
            self.phase += self.period();
            self.next_conversion = self.phase as Ticks;
            let recording = (self.rate() - self.rate_hz).abs() < 1e-6 * self.rate_hz;
            // What comes before the recording begins is of no sound.
            let result =
                if recording || self.next_number > 0 { self.record(recording) } else { Some((None, [0; 4])) };
            let Some(result) = result else {
                self.exhausted = true;
                self.next_conversion = NEVER;
                return;
            };
            if let Some(number) = result.0 {
                self.moments.resize(number as usize, NEVER);
                self.moments.push(done);
            }
            if self.output.len() == 2 {
                self.output.pop_front();
            }
            self.output.push_back(result);
            // A line that is still low goes high for a moment first: four periods of its clock, from memory of the data sheet.
            if !self.ready {
                self.glitch(4 * PER_SECOND / CLOCK_HZ);
            }
            self.set_ready_line(false);
        }
        self.pulses(now);
        if let Some(at) = self.afresh.take_if(|at| *at <= now) {
            self.resynchronise(at);
        }
    }

    /// The pulse on the line that is due, if any.
    fn pulses(&mut self, now: Ticks) {
        if let Some((_, lasts)) = self.pulse.take_if(|(at, _)| *at <= now) {
            self.glitch(lasts);
        }
    }

    /// The source at this moment. Where the converter stood still or had another rate the source went on: a number is an
    /// instant of its time. Conversions at another rate have none.
    fn record(&mut self, counted: bool) -> Option<(Option<u64>, Codes)> {
        let due = self.phase - self.period();
        let instant = PER_SECOND as f64 / self.rate_hz * self.stretch;
        if self.next_number > 0 {
            let passed = ((due - self.numbered_at) / instant).round() as u64;
            if passed == 0 && !counted {
                return Some((None, self.shown.1));
            }
            for _ in 1..passed {
                (self.source)()?;
                self.next_number += 1;
            }
        }
        self.numbered_at = due;
        let codes = (self.source)()?;
        self.next_number += 1;
        Some((counted.then_some(self.next_number - 1), codes))
    }

    /// The chip select has this level: low begins a frame, high ends it.
    pub fn select(&mut self, selected: bool, now: Ticks) {
        if selected == self.selected {
            return;
        }
        self.selected = selected;
        if selected {
            self.begin();
        } else {
            self.end(now);
        }
    }

    fn begin(&mut self) {
        self.frame_in.clear();
        self.frame_out.clear();
        self.damaged = false;
        let mut status = self.registers[STATUS];
        if !self.output.is_empty() {
            status |= 0xf;
        }
        self.registers[STATUS] = status;
        self.clocked = self.output.front().copied();
        let first = self.answer.take().unwrap_or(status);
        let mut word = |value: u32| self.frame_out.extend(&value.to_be_bytes()[1..]);
        word(u32::from(first) << 8);
        if self.answers.is_empty() {
            // The older result where two wait; the last one again where none does.
            self.shown = self.clocked.unwrap_or(self.shown);
            let gains = self.registers[GAIN];
            for (channel, code) in self.shown.1.iter().enumerate() {
                let gain = gains >> (4 * channel) & 7;
                word((code << gain).clamp(-(1 << 23), (1 << 23) - 1) as u32 & 0xff_ffff);
            }
        } else {
            self.answers.drain(..).for_each(|value| word(u32::from(value) << 8));
        }
        let crc = crc16(&self.frame_out);
        self.frame_out.extend([(crc >> 8) as u8, crc as u8, 0]);
    }

    /// One byte each way.
    pub fn exchange(&mut self, byte: u8, now: Ticks) -> u8 {
        // Without a driver the line floats up.
        if !self.selected || self.dead || now < self.deaf_until {
            return if self.selected && !self.dead { 0 } else { 0xff };
        }
        let out = self.frame_out.get(self.frame_in.len()).copied().unwrap_or(0);
        self.frame_in.push(byte);
        if self.frame_in.len() == WORD {
            self.set_ready_line(true);
        }
        if self.mute {
            self.damaged = true;
            return 0xff;
        }
        self.bytes += 1;
        if self.bit_errors_every > 0 && self.bytes.is_multiple_of(self.bit_errors_every) {
            // The last byte of a frame says nothing.
            self.damaged |= self.frame_in.len() < self.frame_out.len();
            return out ^ 1 << (self.bytes / self.bit_errors_every % 8);
        }
        out
    }

    fn end(&mut self, now: Ticks) {
        // What was clocked out before its supply failed was delivered; the last byte of a frame says nothing.
        let clocked = self.frame_in.len() + usize::from(self.dead);
        if self.frame_in.is_empty() || clocked < self.frame_out.len() {
            return;
        }
        let input = std::mem::take(&mut self.frame_in);
        let word =
            |i: usize| input.get(i * WORD..i * WORD + 2).map_or(0, |b| u16::from_be_bytes([b[0], b[1]]));
        let command = word(0);
        let clocked = self.clocked.take();
        // Its filters may have begun afresh meanwhile, or a third result have come.
        if clocked.is_some() && self.output.front().copied() == clocked {
            self.output.pop_front();
        }
        if let Some((Some(number), codes)) = clocked
            && command == 0
        {
            self.delivered.push(number);
            self.codes.push(if self.damaged { [DAMAGED; 4] } else { codes });
        }
        if self.output.is_empty() {
            self.registers[STATUS] &= !0xf;
        }
        if self.dead {
            return;
        }
        let writes = if command & 0xe000 == 0x6000 { usize::from(command & 0x7f) + 1 } else { 0 };
        let sent = input.get(..(1 + writes) * WORD);
        if self.registers[MODE] & INPUT_CRC != 0 && sent.is_none_or(|sent| crc16(sent) != word(1 + writes)) {
            self.registers[STATUS] |= CRC_ERROR;
            return;
        }
        self.registers[STATUS] &= !(CRC_ERROR | RESYNCHRONISED);
        self.carry_out(command, word, now);
    }

    fn carry_out(&mut self, command: u16, word: impl Fn(usize) -> u16, now: Ticks) {
        let (register, count) = (usize::from(command >> 7 & 0x3f), usize::from(command & 0x7f) + 1);
        let locked = self.registers[STATUS] & LOCKED != 0;
        match command {
            0x0011 if !locked => self.reset(now),
            0x0022 | 0x0033 => {
                self.answer = Some(command);
                self.standby = command == 0x0022;
                self.output.clear();
                self.restart(now);
            }
            0x0555 => {
                self.registers[STATUS] |= LOCKED;
                self.answer = Some(command);
            }
            0x0655 => {
                self.registers[STATUS] &= !LOCKED;
                self.answer = Some(command);
            }
            _ if command & 0xe000 == 0xa000 => {
                let read = |i: usize| self.registers[(register + i) & 63];
                if count == 1 {
                    self.answer = Some(read(0));
                } else {
                    self.answer = Some(0xe000 | command & 0x1fff);
                    self.answers = (0..count).map(read).collect();
                }
            }
            _ if command & 0xe000 == 0x6000 && !locked => {
                for i in 0..count {
                    self.write((register + i) & 63, word(1 + i), now);
                }
                self.answer = Some(0x4000 | command & 0x1fff);
            }
            _ => {}
        }
    }

    fn write(&mut self, register: usize, value: u16, now: Ticks) {
        if register <= STATUS {
            return;
        }
        let before = std::mem::replace(&mut self.registers[register], value);
        if register == MODE {
            let status = &mut self.registers[STATUS];
            *status = *status & !RESET_BIT | value & RESET_BIT;
        }
        if register == CLOCK && before != value {
            self.output.clear();
            self.restart(now);
        }
    }

    /// The SYNC/RESET pin has this level: a short low pulse restarts the conversions, a long one resets.
    pub fn sync(&mut self, high: bool, now: Ticks) {
        if !high {
            self.low_since.get_or_insert(now);
        } else if let Some(since) = self.low_since.take() {
            if now - since >= RESET_PULSE_CLOCKS * PER_SECOND / CLOCK_HZ {
                self.reset(now);
            } else {
                self.resynchronise(now);
            }
        }
    }

    /// Its filters begin afresh, as after a short pulse on SYNC/RESET.
    pub fn resynchronise(&mut self, now: Ticks) {
        self.output.clear();
        self.registers[STATUS] |= RESYNCHRONISED;
        self.restart(now);
    }

    /// Checks that the bus is set up as the converter needs it.
    ///
    /// # Errors
    /// The mode or the frequency is not the data sheet's.
    pub fn check_bus(&self, mode: u32, hz: u64) -> Result<(), Refusal> {
        const MOST_HZ: u64 = 25_000_000;
        if mode != 1 {
            return Refusal::stop(
                "the converter is read with the wrong clock polarity or phase: it needs SPI mode 1",
            );
        }
        if hz > MOST_HZ {
            return Refusal::stop(format!("the converter is clocked at {hz} Hz; 25 MHz is its limit"));
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "ads131m04_tests.rs"]
mod tests;
