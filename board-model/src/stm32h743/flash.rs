//! The second bank of the flash: programmed by flash words of 256 bits with error correction, erased by sectors of 128 KiB,
//! while the core executes from the first (RM0433, chapter 4; durations from the data sheet, to be checked).
//!
//! Strict: what the manual forbids, and what would stall the core (reading a bank that works, a write that finds no room),
//! stops the run.

use crate::board::{Refusal, Width};
use crate::time::{NEVER, PER_SECOND, Ticks};

/// Where the bank stands in the map, and its length.
pub const BANK_2: (u32, u32) = (0x0810_0000, 1 << 20);
const WORD: usize = 32;
const WORDS: usize = BANK_2.1 as usize / WORD;
const SECTOR_WORDS: usize = (128 << 10) / WORD;

/// Registers of a bank by their offset from its key register (4.9.2 to 4.9.21).
mod at {
    pub const KEY: usize = 0x00;
    pub const CONTROL: usize = 0x08;
    pub const STATUS: usize = 0x0c;
    pub const CLEAR: usize = 0x10;
}

/// Bits of `FLASH_CR` (4.9.4).
mod control {
    pub const LOCK: u32 = 1;
    pub const PROGRAM: u32 = 1 << 1;
    pub const ERASE: u32 = 1 << 2;
    pub const BANK_ERASE: u32 = 1 << 3;
    pub const START: u32 = 1 << 7;
    pub const END_INTERRUPT: u32 = 1 << 16;
}

/// Bits of `FLASH_SR` (4.9.5).
mod status {
    pub const BUSY: u32 = 1;
    pub const PARTLY: u32 = 1 << 1;
    pub const QUEUED: u32 = 1 << 2;
    pub const END: u32 = 1 << 16;
    pub const CORRECTED: u32 = 1 << 25;
    pub const TWO_BITS: u32 = 1 << 26;
    pub const ERRORS: u32 = 0x07ee_0000;
}

/// What opens the control register, in this order (4.5.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

/// What is known of a word besides its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Virgin,
    Written,
    /// One bit is wrong: corrected when it is read.
    OneBit,
    /// More are, as after power was cut.
    Damaged,
}

/// What the bank is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    Program(usize),
    Erase(usize),
}

/// How long it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlashTimes {
    /// To program a flash word with 64 bits at once, µs.
    pub program_us: f64,
    /// To erase a sector, s.
    pub erase_s: f64,
}

impl Default for FlashTimes {
    /// The longest that the data sheet gives.
    fn default() -> Self {
        Self { program_us: 200.0, erase_s: 2.0 }
    }
}

/// The bank: its words, its registers, and what it is doing.
#[derive(Debug)]
pub struct Flash {
    bytes: Vec<u8>,
    states: Vec<State>,
    times: FlashTimes,
    keys: usize,
    control: u32,
    status: u32,
    /// The word that is being brought, and how much of it has come.
    buffer: Option<(usize, [u8; WORD], usize)>,
    work: Option<(Work, [u8; WORD], Ticks)>,
    /// Words programmed and sectors erased, or begun to be.
    pub operations: u32,
    /// Power fails in the middle of the operation of this number.
    pub cut_at: Option<u32>,
    cut: Option<Ticks>,
    /// Sectors erased.
    pub erased: u32,
    /// Whoever reads it takes a hard fault.
    pub crashes: bool,
}

fn key_of(n: usize) -> u64 {
    let x = (n as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (x ^ x >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 8
}

impl Flash {
    /// As it comes from the factory.
    pub(super) fn new(times: FlashTimes) -> Self {
        Self {
            bytes: vec![0xff; BANK_2.1 as usize],
            states: vec![State::Virgin; WORDS],
            times,
            keys: 0,
            control: control::LOCK,
            status: 0,
            buffer: None,
            work: None,
            operations: 0,
            cut_at: None,
            cut: None,
            erased: 0,
            crashes: false,
        }
    }

    /// A reset ends what is under way in the middle of it, and leaves what was written.
    pub(super) fn reset(&mut self) {
        self.interrupt();
        (self.keys, self.control, self.status, self.buffer, self.cut) = (0, control::LOCK, 0, None, None);
    }

    /// What a reset or a loss of power leaves of the work under way: some bits, which error correction mostly notices.
    fn interrupt(&mut self) {
        let Some((work, value, _)) = self.work.take() else { return };
        match work {
            Work::Program(word) => {
                let chance = key_of(self.operations as usize);
                for (n, (to, from)) in self.of_word(word).iter_mut().zip(value).enumerate() {
                    *to = if chance >> (n % 16) & 1 == 0 { from } else { 0xff };
                }
                self.states[word] = State::Damaged;
            }
            Work::Erase(sector) => {
                for word in sector * SECTOR_WORDS..(sector + 1) * SECTOR_WORDS {
                    match key_of(word) % 4 {
                        0 => {}
                        1 => self.states[word] = State::Damaged,
                        _ => self.blank(word),
                    }
                }
            }
        }
    }

    fn of_word(&mut self, word: usize) -> &mut [u8] {
        &mut self.bytes[word * WORD..(word + 1) * WORD]
    }

    fn blank(&mut self, word: usize) {
        self.of_word(word).fill(0xff);
        self.states[word] = State::Virgin;
    }

    /// A probe writes these bytes to the bank's beginning; what it leaves erased can still be programmed. Whether they fit.
    #[must_use]
    pub fn probe(&mut self, bytes: &[u8]) -> bool {
        for (word, bytes) in bytes.chunks(WORD).enumerate().take(WORDS) {
            self.blank(word);
            self.of_word(word)[..bytes.len()].copy_from_slice(bytes);
            if bytes.iter().any(|byte| *byte != 0xff) {
                self.states[word] = State::Written;
            }
        }
        bytes.len() <= WORDS * WORD
    }

    /// Bits of a word of the bank (counted from its start) go wrong.
    pub fn upset(&mut self, word: usize, bits: u32) {
        let state = &mut self.states[word % WORDS];
        *state = if bits == 1 && *state != State::Damaged { State::OneBit } else { State::Damaged };
    }

    /// Words of the bank that were written.
    pub fn written(&self) -> impl Iterator<Item = usize> + '_ {
        self.states.iter().enumerate().filter(|(_, s)| **s == State::Written).map(|(n, _)| n)
    }

    pub(super) fn next_event(&self) -> Ticks {
        self.work.map_or(NEVER, |work| work.2).min(self.cut.unwrap_or(NEVER))
    }

    /// Ends what is due; whether power fails now.
    pub(super) fn advance(&mut self, now: Ticks) -> bool {
        if self.cut.is_some_and(|at| at <= now) {
            self.reset();
            self.cut_at = None;
            return true;
        }
        if let Some((work, value, ends)) = self.work
            && ends <= now
        {
            self.work = None;
            if self.control & control::END_INTERRUPT != 0 {
                self.status |= status::END;
            }
            match work {
                Work::Program(word) => {
                    self.of_word(word).copy_from_slice(&value);
                    self.states[word] = State::Written;
                }
                Work::Erase(sector) => {
                    self.erased += 1;
                    (sector * SECTOR_WORDS..(sector + 1) * SECTOR_WORDS).for_each(|word| self.blank(word));
                }
            }
        }
        false
    }

    /// Whether the end of a piece of work asks for an interrupt.
    pub(super) fn interrupting(&self) -> bool {
        self.control & control::END_INTERRUPT != 0 && self.status & status::END != 0
    }

    fn begin(&mut self, work: Work, value: [u8; WORD], seconds: f64, now: Ticks) {
        let ticks = (seconds * PER_SECOND as f64) as Ticks;
        if self.cut_at == Some(self.operations) {
            self.cut = Some(now + ticks / 2);
        }
        self.operations += 1;
        self.work = Some((work, value, now + ticks));
    }

    /// Reads a register of the bank.
    pub(super) fn read(&self, offset: usize) -> Result<u32, Refusal> {
        Ok(match offset {
            at::CONTROL => self.control,
            at::STATUS => {
                let working = if self.work.is_some() { status::BUSY | status::QUEUED } else { 0 };
                self.status | working | if self.buffer.is_some() { status::PARTLY } else { 0 }
            }
            _ => return Refusal::stop(format!("register {offset:#x} of a flash bank is not modelled")),
        })
    }

    /// Writes a register of the bank; `fast_enough`: delays between the bank's signals are set for its clock.
    pub(super) fn write(
        &mut self,
        offset: usize,
        value: u32,
        now: Ticks,
        fast_enough: bool,
    ) -> Result<(), Refusal> {
        match offset {
            at::KEY if self.keys < 2 && value == KEYS[self.keys] => {
                self.keys += 1;
                if self.keys == 2 {
                    self.control &= !control::LOCK;
                }
            }
            at::KEY => {
                return Refusal::stop(
                    "a wrong key: the flash's control register is locked until the next reset",
                );
            }
            at::CONTROL if self.control & control::LOCK != 0 => {
                return Refusal::stop("the flash's control register is written while it is locked");
            }
            at::CONTROL if self.work.is_some() || self.buffer.is_some() => {
                return Refusal::stop("the flash's control register is written while the bank works");
            }
            at::CONTROL => {
                self.control = value & !control::START;
                if value & control::LOCK != 0 {
                    self.keys = 0;
                }
                if value & (control::PROGRAM | control::ERASE) != 0 && !fast_enough {
                    return Refusal::stop("FLASH_ACR.WRHIGHFREQ is too low for programming at this clock");
                }
                if value & control::BANK_ERASE != 0 {
                    return Refusal::stop("the whole bank is erased");
                }
                if value & control::START != 0 {
                    self.check_errors()?;
                    if value & (control::PROGRAM | control::ERASE) != control::ERASE {
                        return Refusal::stop("FLASH_CR.START without SER, or with PG");
                    }
                    let slower = self.slower(value);
                    let sector = (value >> 8 & 7) as usize;
                    self.begin(Work::Erase(sector), [0xff; WORD], self.times.erase_s * slower.1, now);
                }
            }
            at::CLEAR => self.status &= !(value & (status::ERRORS | status::END)),
            _ => return Refusal::stop(format!("register {offset:#x} of a flash bank is not modelled")),
        }
        Ok(())
    }

    /// How much longer programming and erasing take with fewer bits at once (`PSIZE`).
    fn slower(&self, control: u32) -> (f64, f64) {
        [(2.9, 2.0), (1.8, 1.8), (1.3, 1.1), (1.0, 1.0)][(control >> 4 & 3) as usize]
    }

    fn check_errors(&self) -> Result<(), Refusal> {
        if self.status & status::ERRORS & !status::CORRECTED != 0 {
            return Refusal::stop(format!(
                "the flash works on with errors in its status, {:#010x}",
                self.status
            ));
        }
        Ok(())
    }

    /// Reads the bank's memory.
    pub(super) fn load(&mut self, address: u32, width: Width) -> Result<u32, Refusal> {
        if self.work.is_some() {
            return Refusal::stop(format!(
                "{address:#010x} is read while its bank works: the core would stall"
            ));
        }
        let offset = (address - BANK_2.0) as usize;
        match self.states[offset / WORD] {
            State::Damaged => {
                self.status |= status::TWO_BITS;
                return Err(Refusal::BusFault);
            }
            State::OneBit => self.status |= status::CORRECTED,
            State::Virgin | State::Written => {}
        }
        let mut word = [0; 4];
        let bytes = width.bytes() as usize;
        word[..bytes].copy_from_slice(&self.bytes[offset..offset + bytes]);
        Ok(u32::from_le_bytes(word))
    }

    /// Writes the bank's memory: eight words in a row are programmed as one.
    pub(super) fn store(
        &mut self,
        address: u32,
        value: u32,
        width: Width,
        now: Ticks,
    ) -> Result<(), Refusal> {
        let offset = (address - BANK_2.0) as usize;
        let (word, byte) = (offset / WORD, offset % WORD);
        if self.control & (control::LOCK | control::PROGRAM) != control::PROGRAM {
            return Refusal::stop(format!("{address:#010x} is written without FLASH_CR.PG"));
        }
        if self.work.is_some() {
            return Refusal::stop(format!(
                "{address:#010x} is written while its bank works: the core would stall"
            ));
        }
        if width != Width::Word {
            return Refusal::stop("flash is written by less than 32 bits");
        }
        self.check_errors()?;
        let (of, mut bytes, had) = self.buffer.unwrap_or((word, [0xff; WORD], 0));
        if of != word || had != byte {
            return Refusal::stop(format!("{address:#010x} is not the next of the flash word being written"));
        }
        if self.states[word] != State::Virgin {
            return Refusal::stop(format!("the flash word at {address:#010x} is written twice"));
        }
        bytes[byte..byte + 4].copy_from_slice(&value.to_le_bytes());
        self.buffer = Some((word, bytes, had + 4));
        if had + 4 == WORD {
            self.buffer = None;
            let seconds = self.times.program_us * 1e-6 * self.slower(self.control).0;
            self.begin(Work::Program(word), bytes, seconds, now);
        }
        Ok(())
    }
}
