//! Four seismic converters of the ADS1282 kind, one channel each, on one line: clock, commands, reset and SYNC are common,
//! every chip has its own line back. So they are set in one go, convert at the same instants, and are read at once.
//!
//! A chip gives words of 32 bits, the most significant first: 31 bits of code and once more the sign, which is turned round
//! where the code is at its limit. There is no checksum. SPI mode 0, at most half the chips' clock of 4.096 MHz; between the
//! bytes of commands 24 of its periods at least. Names and numbers are those of the data sheet (Texas Instruments SBAS418): commands,
//! registers, their values after a reset and that pause agree with the maker's example code, the rest (mode, filter, times after a reset and
//! SYNC, the second sign) is **from memory, not checked**.

use seabearing_core::block::{CHANNELS, Frame, MISSING};

/// Bytes of a conversion of one chip.
pub const WORD_BYTES: usize = 4;
/// The largest code; the smallest is one further.
pub const FULL_SCALE: i32 = (1 << 30) - 1;
/// Samples of its own by which a chip's linear-phase filter delays the sound.
pub const DELAY: u64 = 31;
/// Periods from SYNC to the first conversion, in which that filter settles.
const SETTLES: u64 = 63;

const READ_CONTINUOUSLY: u8 = 0x10;
const STOP_READING: u8 = 0x11;
const READ_REGISTERS: u8 = 0x20;
const WRITE_REGISTERS: u8 = 0x40;
/// The first register that is set: CONFIG0, CONFIG1, and the low half of a corner of a filter that is not used.
const FIRST: u8 = 1;
/// Pulses on SYNC begin a conversion; filter of linear phase without high-pass.
const CONFIG0: u8 = 0x42;
/// Input 1, chopping on.
const CONFIG1: u8 = 0x08;
/// A reset makes it 0x32.
const MARK: u8 = 0xa5;

/// From byte to byte of a command: 24 periods of the clock are 5.9 us.
const BYTE_US: u32 = 7;
/// From the end of a reset to the first command.
const RESET_US: u32 = 1000;

/// The chips' common line.
pub trait Bus {
    /// Says a byte to all chips; what each says meanwhile.
    fn exchange(&mut self, byte: u8) -> [u8; CHANNELS];

    /// Waits.
    fn wait_us(&mut self, us: u32);

    /// Level of the line that holds all chips in reset while it is low.
    fn reset(&mut self, high: bool);

    /// Level of SYNC, whose rising edge begins all chips' conversions anew.
    fn sync(&mut self, high: bool);
}

/// How the chips are set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Conversions a second: 250, 500 or 1000.
    pub rate: Rate,
    /// Gain, a power of two: 0 to 6.
    pub gain_log2: u8,
}

/// Conversions a second, from a clock of 4.096 MHz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rate {
    /// 250 a second.
    Sps250,
    /// 500 a second.
    Sps500,
    /// 1000 a second.
    Sps1000,
}

impl Rate {
    /// Conversions a second.
    pub fn hz(self) -> u32 {
        match self {
            Self::Sps250 => 250,
            Self::Sps500 => 500,
            Self::Sps1000 => 1000,
        }
    }

    /// From SYNC to the first conversion, at least, µs.
    pub fn settles_us(self) -> u64 {
        SETTLES * 1_000_000 / u64::from(self.hz())
    }
}

impl Settings {
    /// The registers from [`FIRST`] on.
    fn registers(self) -> [u8; 3] {
        let rate = match self.rate {
            Rate::Sps250 => 0,
            Rate::Sps500 => 1 << 3,
            Rate::Sps1000 => 2 << 3,
        };
        [CONFIG0 | rate, CONFIG1 | self.gain_log2.min(6), MARK]
    }
}

/// How a chip's registers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// As they were set.
    Set,
    /// Otherwise: it has reset itself, or a bit has changed.
    Otherwise,
    /// It says nothing.
    Silent,
}

/// A command's bytes, all the time its distance apart.
fn say<const N: usize>(bus: &mut impl Bus, bytes: [u8; N]) -> [[u8; CHANNELS]; N] {
    bytes.map(|byte| {
        let heard = bus.exchange(byte);
        bus.wait_us(BYTE_US);
        heard
    })
}

/// Reads the registers back.
fn answers(bus: &mut impl Bus, settings: Settings) -> [Answer; CHANNELS] {
    let set = settings.registers();
    let [_, _, a, b, c] = say(bus, [READ_REGISTERS | FIRST, set.len() as u8 - 1, 0, 0, 0]);
    let mut chips = a.into_iter().zip(b).zip(c);
    [(); CHANNELS].map(|()| match chips.next() {
        Some(((a, b), c)) if [a, b, c] == set => Answer::Set,
        Some(((0, 0), 0) | ((0xff, 0xff), 0xff)) | None => Answer::Silent,
        Some(_) => Answer::Otherwise,
    })
}

/// Resets all chips, sets them, reads that back and begins; what each chip answered.
pub fn set_up(bus: &mut impl Bus, settings: Settings) -> [Answer; CHANNELS] {
    bus.sync(false);
    bus.reset(false);
    bus.wait_us(BYTE_US);
    bus.reset(true);
    bus.wait_us(RESET_US);
    let [a, b, c] = settings.registers();
    say(bus, [STOP_READING]);
    say(bus, [WRITE_REGISTERS | FIRST, 2, a, b, c]);
    let answers = answers(bus, settings);
    say(bus, [READ_CONTINUOUSLY]);
    bus.sync(true);
    answers
}

/// Looks at the registers between two conversions; no conversion is lost by that if it ends before the next.
pub fn look(bus: &mut impl Bus, settings: Settings) -> [Answer; CHANNELS] {
    say(bus, [STOP_READING]);
    let answers = answers(bus, settings);
    say(bus, [READ_CONTINUOUSLY]);
    answers
}

/// The codes of four words as they came: 31 bits. A word whose second sign is wrong away from the limits was damaged.
pub fn parse(words: [u32; CHANNELS]) -> Frame {
    words.map(|word| {
        let (code, sign) = (word as i32 >> 1, word & 1 != 0);
        let limited = code == FULL_SCALE || code == -FULL_SCALE - 1;
        if sign == (code < 0) || limited { code } else { MISSING }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Registers and lines of four chips; a dead one's line is high.
    #[derive(Default)]
    struct Mock {
        registers: [[u8; 4]; CHANNELS],
        dead: [bool; CHANNELS],
        stuck: bool,
        log: Vec<u8>,
        waited_us: u32,
        lines: Vec<(char, bool)>,
    }

    impl Bus for Mock {
        fn exchange(&mut self, byte: u8) -> [u8; CHANNELS] {
            assert!(self.log.is_empty() || self.waited_us >= 6, "no pause before {byte:#x}");
            self.waited_us = 0;
            self.log.push(byte);
            let mut heard = [0; CHANNELS];
            for (chip, said) in heard.iter_mut().enumerate() {
                if self.dead[chip] {
                    *said = 0xff;
                    continue;
                }
                let registers = &mut self.registers[chip];
                match self.log[..] {
                    [.., 0x41, 2, a, b, c] if !self.stuck => registers[1..].copy_from_slice(&[a, b, c]),
                    [.., 0x21, 2, _] => *said = registers[1],
                    [.., 0x21, 2, _, _] => *said = registers[2],
                    [.., 0x21, 2, _, _, _] => *said = registers[3],
                    _ => {}
                }
            }
            heard
        }
        fn wait_us(&mut self, us: u32) {
            self.waited_us += us;
        }
        fn reset(&mut self, high: bool) {
            self.lines.push(('R', high));
            self.registers = [[0, 0x52, 0x08, 0x32]; CHANNELS];
        }
        fn sync(&mut self, high: bool) {
            self.lines.push(('S', high));
        }
    }

    const SETTINGS: Settings = Settings { rate: Rate::Sps250, gain_log2: 3 };

    #[test]
    fn set_up_resets_sets_reads_back_and_begins_all_at_once() {
        let mut bus = Mock::default();
        assert_eq!(set_up(&mut bus, SETTINGS), [Answer::Set; 4]);
        assert_eq!(bus.registers, [[0, 0x42, 0x0b, 0xa5]; 4]);
        assert_eq!((bus.log[0], bus.log.last()), (0x11, Some(&0x10)));
        assert_eq!(bus.lines, [('S', false), ('R', false), ('R', true), ('S', true)]);
        let mut one = Mock { dead: [false, false, true, false], ..Mock::default() };
        assert_eq!(set_up(&mut one, SETTINGS), [Answer::Set, Answer::Set, Answer::Silent, Answer::Set]);
        assert_eq!(set_up(&mut Mock { stuck: true, ..Mock::default() }, SETTINGS), [Answer::Otherwise; 4]);
    }

    #[test]
    fn a_chip_that_reset_itself_or_changed_or_fell_silent_is_told_from_the_others() {
        // At 1000 a second and no gain every register but the mark is what a reset makes it.
        let settings = Settings { rate: Rate::Sps1000, gain_log2: 0 };
        let mut bus = Mock::default();
        set_up(&mut bus, settings);
        assert_eq!(look(&mut bus, settings), [Answer::Set; 4]);
        bus.registers[1] = [0, 0x52, 0x08, 0x32];
        bus.registers[2][2] ^= 2;
        bus.dead[3] = true;
        let expected = [Answer::Set, Answer::Otherwise, Answer::Otherwise, Answer::Silent];
        assert_eq!(look(&mut bus, settings), expected);
    }

    #[test]
    fn codes_keep_sign_and_limits_and_a_wrong_second_sign_is_damage() {
        let word = |code: i32| (code << 1) as u32 | u32::from(code < 0);
        assert_eq!(
            parse([0, word(-1), word(FULL_SCALE - 1), word(-FULL_SCALE)]),
            [0, -1, FULL_SCALE - 1, -FULL_SCALE]
        );
        // Beyond its range a chip turns the second sign round.
        assert_eq!(
            parse([0x7fff_ffff, 0x8000_0000, 0x7fff_fffe, 0x8000_0001]),
            [FULL_SCALE, -FULL_SCALE - 1, FULL_SCALE, -FULL_SCALE - 1]
        );
        assert_eq!(parse([1, word(-5) ^ 1, word(77) ^ 1 << 31, word(9)]), [MISSING, MISSING, MISSING, 9]);
    }
}
