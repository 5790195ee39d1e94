//! Four one-channel seismic converters of the ADS1282 kind (Texas Instruments SBAS418) on one line: clock, data in, reset and
//! SYNC are common. Commands, registers, data ready, continuous reading, filters' settling. Commands, registers, their values after a
//! reset and the pause between bytes agree with the maker's example code; **the rest is from memory of the data sheet, not checked**: by that
//! code a chip says nothing unasked after a reset, here it does.

use crate::ads131m04::{Codes, Source};
use crate::board::Refusal;
use crate::time::{NEVER, PER_SECOND, Ticks};
use std::collections::VecDeque;

/// Frequency of the chips' clock.
pub const CLOCK_HZ: u64 = 4_096_000;
/// Chips.
pub const CHIPS: usize = 4;
/// Samples of a chip's own by which its filter of linear phase delays the sound.
pub const DELAY: u64 = 31;
/// What the registers hold after a reset.
const REGISTERS: [u8; 11] = [0x40, 0x52, 0x08, 0x32, 0x03, 0, 0, 0, 0, 0, 0x40];
const CONFIG0: usize = 1;
const CONFIG1: usize = 2;
/// From a reset to the first command, in clocks.
const DEAF_CLOCKS: u64 = 64;
/// Least pause between the bytes of commands, in clocks.
const PAUSE_CLOCKS: u64 = 24;
/// From the start of conversions to the first result: periods, and clocks more.
const SETTLES: (f64, f64) = (62.98, 468.0);
/// Largest code, of 31 bits.
const FULL_SCALE: i64 = (1 << 30) - 1;
/// Finer than the source's codes of 24 bits.
const FINER: i64 = 1 << 7;

/// Ticks of so many clocks.
fn clocks(n: u64) -> Ticks {
    n * PER_SECOND / CLOCK_HZ
}

/// What the chips hear: a source at the rate that is to be recorded, numbered by its time.
struct Sound {
    source: Source,
    rate_hz: f64,
    /// Ticks of the board's clock for a tick of the chips': its relative error.
    stretch: f64,
    next_number: u64,
    numbered_at: f64,
    codes: Codes,
    exhausted: bool,
    moments: Vec<Ticks>,
}

impl Sound {
    /// The number of a conversion at this moment; where the chips stood still the source went on.
    fn number(&mut self, due: f64) -> Option<u64> {
        let period = PER_SECOND as f64 / self.rate_hz * self.stretch;
        let passed = match self.next_number {
            0 => 1,
            _ => ((due - self.numbered_at) / period).round() as u64,
        };
        for _ in 0..passed {
            match (self.source)() {
                Some(codes) => self.codes = codes,
                None => {
                    self.exhausted = true;
                    return None;
                }
            }
            self.next_number += 1;
            self.moments.push(NEVER);
        }
        if passed > 0 {
            self.numbered_at = due;
        }
        if let Some(moment) = self.moments.last_mut() {
            *moment = (due - DELAY as f64 * period).max(0.0) as Ticks;
        }
        Some(self.next_number - 1)
    }
}

/// A command under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Command {
    None,
    /// How many registers come: the first, and whether they are written.
    Count(usize, bool),
    Write(usize, u8),
    Read(usize, u8),
}

/// One chip.
#[derive(Debug)]
struct Chip {
    registers: [u8; REGISTERS.len()],
    continuous: bool,
    standby: bool,
    command: Command,
    phase: f64,
    next: Ticks,
    /// The newest conversion: its number, its word, and how much of that was read.
    number: Option<u64>,
    word: [u8; 4],
    position: usize,
    /// A conversion ended while the one before was being read.
    torn: bool,
    dead: bool,
    held: bool,
    deaf_until: Ticks,
    byte_end: Ticks,
    ready: bool,
}

impl Chip {
    fn new() -> Self {
        Self {
            registers: REGISTERS,
            continuous: true,
            standby: false,
            command: Command::None,
            phase: 0.0,
            next: NEVER,
            number: None,
            word: [0; 4],
            position: 4,
            torn: false,
            dead: false,
            held: false,
            deaf_until: 0,
            byte_end: 0,
            ready: true,
        }
    }

    /// Conversions a second, as the register says.
    fn rate(&self) -> f64 {
        f64::from(250u32 << (self.registers[CONFIG0] >> 3 & 7).min(4))
    }

    fn period(&self, stretch: f64) -> f64 {
        PER_SECOND as f64 / self.rate() * stretch
    }

    /// Conversions begin anew: the filter settles first.
    fn restart(&mut self, now: Ticks, stretch: f64) {
        let settles = SETTLES.0 * self.period(stretch) + SETTLES.1 * stretch * clocks(1) as f64;
        self.phase = now as f64 + settles;
        self.next = if self.dead || self.held || self.standby { NEVER } else { self.phase as Ticks };
        self.position = 4;
    }

    fn reset(&mut self, now: Ticks, stretch: f64) {
        let (dead, held) = (self.dead, self.held);
        *self = Self { dead, held, deaf_until: now + clocks(DEAF_CLOCKS), ..Self::new() };
        self.restart(now, stretch);
    }

    /// A conversion has this value of 24 bits, with the chip's own noise.
    fn convert(&mut self, number: Option<u64>, code: i32, noise: i64) {
        let gain = i64::from(self.registers[CONFIG1] & 7).min(6);
        let code = (i64::from(code) * FINER + noise) << gain;
        let limited = code.clamp(-FULL_SCALE - 1, FULL_SCALE);
        let sign = (limited < 0) != (limited != code);
        self.word = ((limited << 1) as u32 | u32::from(sign)).to_be_bytes();
        self.number = number;
        self.torn = (1..4).contains(&self.position);
        self.position = 0;
    }

    /// One byte each way, whose first bit went at `begun`; what must not be done is a complaint.
    fn exchange(&mut self, byte: u8, begun: Ticks, now: Ticks, stretch: f64) -> Result<u8, &'static str> {
        if self.dead {
            return Ok(0xff);
        }
        if self.held || now < self.deaf_until {
            return Ok(0);
        }
        let pause = begun.saturating_sub(std::mem::replace(&mut self.byte_end, now));
        if self.continuous && byte == 0 {
            let out = self.word.get(self.position).copied().unwrap_or(0);
            self.position += 1;
            return Ok(out);
        }
        if pause < clocks(PAUSE_CLOCKS) {
            return Err("the bytes of a command come faster than 24 of the converter's clocks apart");
        }
        if self.continuous {
            self.continuous = byte != 0x11;
            return if byte == 0x11 { Ok(0) } else { Err("a command while data are read continuously") };
        }
        let mut out = 0;
        self.command = match std::mem::replace(&mut self.command, Command::None) {
            Command::None => return self.begin(byte, now, stretch).map(|()| 0),
            Command::Count(first, true) => Command::Write(first, byte + 1),
            Command::Count(first, false) => Command::Read(first, byte + 1),
            Command::Write(first, left) => {
                match self.registers.get_mut(first) {
                    Some(register) if first > 0 => *register = byte,
                    _ => return Err("a register that cannot be written"),
                }
                if first == CONFIG0 {
                    self.restart(now, stretch);
                }
                Command::Write(first + 1, left - 1)
            }
            Command::Read(first, left) => {
                out = *self.registers.get(first).ok_or("a register that is none")?;
                Command::Read(first + 1, left - 1)
            }
        };
        if matches!(self.command, Command::Write(_, 0) | Command::Read(_, 0)) {
            self.command = Command::None;
        }
        Ok(out)
    }

    fn begin(&mut self, byte: u8, now: Ticks, stretch: f64) -> Result<(), &'static str> {
        match byte {
            0 | 1 if self.standby => {
                self.standby = false;
                self.restart(now, stretch);
            }
            0 | 1 | 0x11 => {}
            2 | 3 => (self.standby, self.next) = (true, NEVER),
            4 | 5 => self.restart(now, stretch),
            6 | 7 => self.reset(now, stretch),
            0x10 => self.continuous = true,
            0x20..0x2b => self.command = Command::Count(usize::from(byte & 15), false),
            0x40..0x4b => self.command = Command::Count(usize::from(byte & 15), true),
            _ => return Err("a command that is none"),
        }
        Ok(())
    }
}

/// The four chips.
pub struct Ads1282s {
    sound: Sound,
    chips: [Chip; CHIPS],
    edges: VecDeque<(usize, bool, Ticks)>,
    /// When something else than the first chip turns its data-ready line round, and for how long; in order.
    pub glitches: VecDeque<(Ticks, Ticks)>,
    reset_high: bool,
    sync_high: bool,
    /// What came over the lines of the conversion that is being read.
    wire: [u32; CHIPS],
    /// The lines from the chips are cut.
    pub mute: bool,
    /// Flips one bit of one in n bytes that are read, any chip's and any of a word, where n is not 0.
    pub bit_errors_every: u64,
    bytes: u64,
    complaint: Option<&'static str>,
    /// Numbers of the conversions that were read whole.
    pub delivered: Vec<u64>,
    /// The words that came of them, as they came.
    pub codes: Vec<Codes>,
}

impl std::fmt::Debug for Ads1282s {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ads1282s").field("delivered", &self.delivered.len()).finish_non_exhaustive()
    }
}

impl Ads1282s {
    /// Four chips at power-on that are to record at `rate_hz`; their clock is fast by `error` (relative) against the board's.
    pub fn new(source: Source, rate_hz: f64, error: f64) -> Self {
        let sound = Sound {
            source,
            rate_hz,
            stretch: 1.0 / (1.0 + error),
            next_number: 0,
            numbered_at: 0.0,
            codes: [0; 4],
            exhausted: false,
            moments: Vec::new(),
        };
        let mut chips = [(); CHIPS].map(|()| Chip::new());
        chips.iter_mut().for_each(|chip| chip.reset(0, sound.stretch));
        Self {
            sound,
            chips,
            edges: VecDeque::new(),
            glitches: VecDeque::new(),
            reset_high: true,
            sync_high: true,
            wire: [0; CHIPS],
            mute: false,
            bit_errors_every: 0,
            bytes: 0,
            complaint: None,
            delivered: Vec::new(),
            codes: Vec::new(),
        }
    }

    /// Conversions of the source that are done.
    pub fn converted(&self) -> u64 {
        self.sound.next_number
    }

    /// Whether the source has ended.
    pub fn exhausted(&self) -> bool {
        self.sound.exhausted
    }

    /// When the sound of each number was; [`NEVER`] for those left out.
    pub fn moments(&self) -> &[Ticks] {
        &self.sound.moments
    }

    /// A chip, or all, as after a reset.
    pub fn reset_chips(&mut self, chip: Option<usize>, now: Ticks) {
        let stretch = self.sound.stretch;
        self.those(chip).for_each(|chip| chip.reset(now, stretch));
    }

    /// A chip, or all, stops converting and answering, or begins anew.
    pub fn set_dead(&mut self, chip: Option<usize>, dead: bool, now: Ticks) {
        let stretch = self.sound.stretch;
        self.those(chip).for_each(|chip| {
            chip.dead = dead;
            chip.reset(now, stretch);
        });
    }

    fn those(&mut self, chip: Option<usize>) -> impl Iterator<Item = &mut Chip> {
        self.chips
            .iter_mut()
            .enumerate()
            .filter(move |(n, _)| chip.is_none_or(|c| c == *n))
            .map(|(_, chip)| chip)
    }

    /// Flips a bit of a chip's register, as a disturbance does.
    pub fn upset(&mut self, chip: usize, register: usize, bit: u32, now: Ticks) {
        let stretch = self.sound.stretch;
        if let Some(chip) = self.chips.get_mut(chip) {
            chip.registers[register] ^= 1 << bit;
            if register == CONFIG0 {
                chip.restart(now, stretch);
            }
        }
    }

    /// When one of them next has a result.
    fn next_result(&self) -> Ticks {
        self.chips.iter().map(|chip| chip.next).min().unwrap_or(NEVER)
    }

    /// When one of them next has a result, or something happens to the first one's line.
    pub fn next_event(&self) -> Ticks {
        self.glitches.front().map_or(NEVER, |glitch| glitch.0).min(self.next_result())
    }

    fn glitch(&mut self, chip: usize, lasts: Ticks) {
        let level = self.chips[chip].ready;
        self.edges.extend([(chip, !level, lasts), (chip, level, NEVER)]);
    }

    /// Their common clock stops for so many conversions: they come later, and nothing is reset.
    pub fn stop_clock(&mut self, conversions: f64) {
        for chip in self.chips.iter_mut().filter(|chip| chip.next != NEVER) {
            chip.phase += conversions * chip.period(self.sound.stretch);
            chip.next = chip.phase as Ticks;
        }
    }

    /// Levels of the data-ready lines since the last look, in order: which chip's, the level, and how long that lasted at least.
    pub fn next_edge(&mut self) -> Option<(usize, bool, Ticks)> {
        self.edges.pop_front()
    }

    fn set_ready_line(&mut self, chip: usize, high: bool) {
        if std::mem::replace(&mut self.chips[chip].ready, high) != high {
            self.edges.push_back((chip, high, NEVER));
        }
    }

    /// Conversions that are due are done.
    pub fn advance(&mut self, now: Ticks) {
        while self.glitches.front().is_some_and(|glitch| glitch.0 <= now)
            && let Some((_, lasts)) = self.glitches.pop_front()
        {
            self.glitch(0, lasts);
        }
        while self.next_result() <= now {
            let Some(at) = self.chips.iter().position(|chip| chip.next == self.next_result()) else { return };
            let (due, rate) = (self.chips[at].phase, self.chips[at].rate());
            let period = self.chips[at].period(self.sound.stretch);
            self.chips[at].phase += period;
            self.chips[at].next = self.chips[at].phase as Ticks;
            let recording = (rate - self.sound.rate_hz).abs() < 1e-6 * rate;
            // The first that lives says which instants there are.
            let leads = self.chips.iter().position(|chip| !chip.dead) == Some(at);
            let number = if recording && leads { self.sound.number(due) } else { None };
            if self.sound.exhausted {
                self.chips.iter_mut().for_each(|chip| chip.next = NEVER);
                return;
            }
            // Some steps of the source's codes: what a chip has of its own.
            let noise = (mix(due as u64 ^ at as u64) >> 54) as i64 - 512;
            let code = self.sound.codes[at];
            self.chips[at].convert(number, code, noise);
            // A line that is still low goes high for four periods of the clock (from memory of the data sheet).
            if !self.chips[at].ready {
                self.glitch(at, 4 * PER_SECOND / CLOCK_HZ);
            }
            self.set_ready_line(at, false);
        }
    }

    /// One byte to all, and what each says meanwhile; the line runs at `hz`.
    pub fn exchange(&mut self, byte: u8, now: Ticks, hz: u64) -> [u8; CHIPS] {
        let stretch = self.sound.stretch;
        let begun = now.saturating_sub(8 * PER_SECOND / hz.max(1));
        let lead = self.chips.iter().position(|chip| !chip.dead);
        let mut out = [0xff; CHIPS];
        for (at, said) in out.iter_mut().enumerate() {
            match self.chips[at].exchange(byte, begun, now, stretch) {
                Ok(byte) => *said = byte,
                Err(why) => self.complaint = Some(why),
            }
            if self.chips[at].continuous {
                self.set_ready_line(at, true);
            }
            if self.mute {
                *said = 0xff;
            }
            self.bytes += 1;
            let chance = mix(self.bytes);
            if self.bit_errors_every > 0 && chance.is_multiple_of(self.bit_errors_every) {
                *said ^= 1 << (chance / self.bit_errors_every % 8);
            }
        }
        if let Some(lead) = lead.map(|at| &self.chips[at])
            && lead.continuous
            && byte == 0
        {
            self.wire = std::array::from_fn(|at| self.wire[at] << 8 | u32::from(out[at]));
            if lead.position == 4
                && !lead.torn
                && let Some(number) = lead.number
            {
                self.delivered.push(number);
                self.codes.push(self.wire.map(|word| word as i32));
            }
        }
        out
    }

    /// Levels of the reset and SYNC lines.
    pub fn lines(&mut self, reset_high: bool, sync_high: bool, now: Ticks) {
        let stretch = self.sound.stretch;
        if std::mem::replace(&mut self.reset_high, reset_high) != reset_high {
            for chip in &mut self.chips {
                chip.held = !reset_high;
                chip.reset(now, stretch);
            }
        }
        if !std::mem::replace(&mut self.sync_high, sync_high) && sync_high {
            self.chips.iter_mut().for_each(|chip| chip.restart(now, stretch));
        }
    }

    /// Checks that the bus is set up as the chips need it, and that nothing was asked of them that must not be.
    ///
    /// # Errors
    /// The mode, the frequency or a command is not the data sheet's.
    pub fn check(&mut self, mode: u32, hz: u64) -> Result<(), Refusal> {
        if let Some(complaint) = self.complaint.take() {
            return Refusal::stop(format!("converter: {complaint}"));
        }
        if mode != 0 {
            return Refusal::stop("the converters are read in the wrong mode: they need SPI mode 0");
        }
        if hz > CLOCK_HZ / 2 {
            return Refusal::stop(format!(
                "the converters are clocked at {hz} Hz; half their clock is the limit"
            ));
        }
        Ok(())
    }
}

/// A number that has nothing to do with its neighbours' (the finaliser of SplitMix64).
fn mix(n: u64) -> u64 {
    let x = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

#[cfg(test)]
mod tests {
    use super::*;

    const HZ: u64 = 2_000_000;
    const MILLISECOND: Ticks = PER_SECOND / 1000;

    /// Four chips that hear a ramp, and the time.
    struct Bench(Ads1282s, Ticks);

    impl Bench {
        fn new(conversions: i32) -> Self {
            let mut next = 0;
            let source = move || {
                next += 1;
                (next <= conversions).then_some([next << 12; 4])
            };
            Self(Ads1282s::new(Box::new(source), 250.0, 0.0), MILLISECOND)
        }

        /// Bytes with the pauses that commands need.
        fn say(&mut self, bytes: &[u8]) -> Vec<[u8; CHIPS]> {
            let one = |byte: &u8| {
                self.1 += MILLISECOND / 50;
                self.0.exchange(*byte, self.1, HZ)
            };
            bytes.iter().map(one).collect()
        }

        fn set_up(&mut self) {
            self.say(&[0x11, 0x41, 0, 0x42, 0x10]);
            self.0.lines(true, false, self.1);
            self.0.lines(true, true, self.1);
        }

        /// The words of the next conversion.
        fn next(&mut self) -> [i32; CHIPS] {
            self.1 = self.0.next_event();
            self.0.advance(self.1);
            let mut words = [0u32; CHIPS];
            for _ in 0..4 {
                self.1 += 8 * PER_SECOND / HZ;
                let bytes = self.0.exchange(0, self.1, HZ);
                words.iter_mut().zip(bytes).for_each(|(word, byte)| *word = *word << 8 | u32::from(byte));
            }
            words.map(|word| word as i32)
        }
    }

    #[test]
    fn registers_are_written_and_read_and_the_rules_of_the_line_are_kept() {
        let mut bench = Bench::new(9);
        bench.say(&[0x11]);
        let all = bench.say(&[0x20, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert!(all[2..].iter().map(|byte| byte[3]).eq(REGISTERS));
        bench.say(&[0x41, 2, 0x42, 0x0b, 0xa5]);
        assert_eq!(bench.say(&[0x22, 1, 0, 0])[2..], [[0x0b; 4], [0xa5; 4]]);
        assert!(bench.0.check(0, HZ).is_ok());
        assert!(bench.0.check(1, HZ).is_err() && bench.0.check(0, 2_100_000).is_err());
        // Two bytes without a pause; a command that is none; one while data are read.
        bench.0.exchange(0x20, bench.1 + 4 * PER_SECOND / 1_000_000, HZ);
        assert!(bench.0.check(0, HZ).is_err());
        bench.say(&[0x99]);
        assert!(bench.0.check(0, HZ).is_err());
        bench.say(&[0x10, 0x21]);
        assert!(bench.0.check(0, HZ).is_err());
    }

    #[test]
    fn conversions_come_together_after_the_filter_has_settled_and_once() {
        let mut bench = Bench::new(5);
        bench.set_up();
        let begun = bench.1;
        let first = bench.next();
        let settled = (bench.0.moments()[0] + DELAY * 4 * MILLISECOND - begun) as f64 / MILLISECOND as f64;
        assert!((settled - 252.0).abs() < 0.1, "{settled}");
        assert!(first.iter().all(|word| (word >> 8).abs_diff(1 << 12) <= 4), "{first:?}");
        (0..4).for_each(|_| _ = bench.next());
        assert_eq!(bench.0.delivered, [0, 1, 2, 3, 4]);
        assert_eq!(bench.0.codes[0], first);
        // What was read is not given twice.
        assert_eq!(bench.0.exchange(0, bench.1 + MILLISECOND, HZ), [0; 4]);
        bench.next();
        assert!(bench.0.exhausted());
    }

    #[test]
    fn a_conversion_that_ends_while_the_one_before_is_read_spoils_it() {
        let mut bench = Bench::new(9);
        bench.set_up();
        bench.next();
        bench.0.advance(bench.0.next_event());
        bench.0.exchange(0, bench.1 + 4 * MILLISECOND, HZ);
        bench.next();
        assert_eq!(bench.0.delivered, [0]);
        bench.next();
        assert_eq!(bench.0.delivered, [0, 3]);
    }

    #[test]
    fn one_chip_dead_or_reset_leaves_the_others_and_their_numbers() {
        let mut bench = Bench::new(3000);
        bench.set_up();
        bench.next();
        bench.0.set_dead(Some(2), true, bench.1);
        let words = bench.next();
        assert_eq!((words[2], bench.0.delivered.len()), (-1, 2));
        // With the first dead the second's edges are the ones that come.
        bench.0.set_dead(Some(0), true, bench.1);
        while bench.0.next_edge().is_some() {}
        bench.next();
        assert_eq!((bench.0.next_edge(), bench.0.delivered.len()), (Some((1, false, NEVER)), 3));
        // One that reset itself converts at its own rate.
        bench.0.reset_chips(Some(3), bench.1);
        assert_eq!((bench.0.chips[3].rate(), bench.0.chips[1].rate()), (1000.0, 250.0));
    }

    #[test]
    fn beyond_its_range_the_second_sign_is_turned_round() {
        let mut chip = Chip::new();
        chip.convert(None, 8_388_607, 512);
        assert_eq!(u32::from_be_bytes(chip.word), 0x7fff_ffff);
        chip.convert(None, -8_388_608, -512);
        assert_eq!(u32::from_be_bytes(chip.word), 0x8000_0000);
        chip.convert(None, -1, 0);
        assert_eq!(u32::from_be_bytes(chip.word), (-256i32) as u32 | 1);
    }
}
