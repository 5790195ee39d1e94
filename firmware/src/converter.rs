//! ADS131M04-class converter: four channels sampled at the same instant, 24 bits, over SPI.
//!
//! Every frame is `status, channel 0..3, CRC`, words of 24 bits; the CRC is CRC-16/CCITT (polynomial 0x1021, start
//! 0xffff) of the words before it. A frame whose CRC is wrong becomes [`MISSING`](seabearing_core::block::MISSING) samples in the recording: nothing is
//! invented. SPI mode 1, at most 25 MHz; one frame of 18 bytes at 64 kHz is 9.2 Mbit/s.
//! Register names and numbers are those of the converter's data sheet (Texas Instruments SBAS890).

use seabearing_core::block::{CHANNELS, Frame};

/// Bytes of a word.
const WORD: usize = 3;
/// Bytes of a frame: status, four channels, CRC.
pub const FRAME_BYTES: usize = WORD * (CHANNELS + 2);

/// Frames the ring holds: 64 ms at 64 kHz. What eight vessels that turn at one instant cost in one block must fit it at four cycles an
/// instruction (`cargo xtask budget`).
pub const RING_FRAMES: usize = 4096;
/// Its length in bytes.
pub const RING_BYTES: usize = RING_FRAMES * FRAME_BYTES;

const RESET: u16 = 0x0011;
/// The answer to a reset of a converter with four channels.
const RESET_DONE: u16 = 0xff24;
const STANDBY: u16 = 0x0022;
const WAKE_UP: u16 = 0x0033;
const WRITE_REGISTER: u16 = 0x6000;
const READ_REGISTER: u16 = 0xa000;
const MODE: u16 = 0x02;
const CLOCK: u16 = 0x03;
const GAIN: u16 = 0x04;
/// Words of 24 bits, time-out of broken frames, the mark of a reset taken note of, and a check sum over the registers that the
/// converter compares all the time.
const MODE_SET: u16 = 0x2110;
/// All four channels on, high-resolution power mode.
const CLOCK_ON: u16 = 0x0f02;
/// Oversampling of 64: 64 kHz from a clock of 8.192 MHz.
const TURBO: u16 = 0x0020;
/// Bits of STATUS that say how the converter works: its filters began afresh (`F_RESYNC`), a register that changed by itself, error of a
/// command's CRC, kind of CRC, reset, length of words.
const STATUS_MASK: u16 = 0x7f00;
/// What they are after [`set_up`]: words of 24 bits and nothing else.
const STATUS_SET: u16 = 0x0100;
/// Of each channel (`DRDY3` to `DRDY0`) whether its code was not read before.
const STATUS_NEW: u16 = 0x000f;
/// From a reset to answers the data sheet allows 5 us; after power-on 250 us.
const AFTER_RESET_US: u32 = 300;

/// What a frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Read {
    /// Four samples.
    Samples(Frame),
    /// The CRC is wrong: nothing is known.
    Damaged,
    /// The converter is not as it was set up: it has reset itself, or began to convert afresh.
    Reset,
    /// No conversion was done since the frame before: the edge that began this one was none of the converter's.
    NotNew,
}

/// A converter that could not be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError {
    /// It did not answer a reset as a converter with four channels does: what it said.
    Unknown(u16),
    /// A register did not keep what was written: its number and what it held.
    Register(u16, u16),
}

/// The converter's bus, one frame at a time.
pub trait Bus {
    /// Selects the converter, exchanges a frame in place, ends the selection.
    fn exchange(&mut self, frame: &mut [u8; FRAME_BYTES]);

    /// Waits.
    fn wait_us(&mut self, us: u32);
}

/// Samples a second from a clock of 8.192 MHz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rate {
    /// 64 kHz (oversampling 64).
    Hz64000,
    /// 32 kHz (oversampling 128).
    Hz32000,
    /// 16 kHz (oversampling 256).
    Hz16000,
    /// 8 kHz (oversampling 512).
    Hz8000,
}

impl Rate {
    /// The rate a station asks for.
    pub fn of(rate_hz: f64) -> Option<Self> {
        [Self::Hz64000, Self::Hz32000, Self::Hz16000, Self::Hz8000]
            .into_iter()
            .find(|rate| f64::from(rate.hz()) == rate_hz)
    }

    /// Samples a second.
    pub fn hz(self) -> u32 {
        match self {
            Self::Hz64000 => 64_000,
            Self::Hz32000 => 32_000,
            Self::Hz16000 => 16_000,
            Self::Hz8000 => 8_000,
        }
    }

    /// The clock register.
    fn clock(self) -> u16 {
        let oversampling = match self {
            Self::Hz64000 => TURBO,
            Self::Hz32000 => 0,
            Self::Hz16000 => 1 << 2,
            Self::Hz8000 => 2 << 2,
        };
        CLOCK_ON | oversampling
    }
}

/// Resets the converter, sets rate and gain (the same power of two for all channels, 0 to 7: 1 to 128), and leaves it in
/// standby: no conversion is done before [`wake_up`].
///
/// # Errors
/// Says what did not answer as expected.
pub fn set_up(bus: &mut impl Bus, rate: Rate, gain_log2: u8) -> Result<(), SetupError> {
    command(bus, RESET, None);
    bus.wait_us(AFTER_RESET_US);
    let answer = command(bus, STANDBY, None);
    if answer != RESET_DONE {
        return Err(SetupError::Unknown(answer));
    }
    let gain = u16::from(gain_log2.min(7)) * 0x1111;
    for (register, value) in [(MODE, MODE_SET), (CLOCK, rate.clock()), (GAIN, gain)] {
        command(bus, WRITE_REGISTER | register << 7, Some(value));
        command(bus, READ_REGISTER | register << 7, None);
        let kept = command(bus, 0, None);
        if kept != value {
            return Err(SetupError::Register(register, kept));
        }
    }
    Ok(())
}

/// Lets the converter begin: its first result comes after at least three periods.
pub fn wake_up(bus: &mut impl Bus) {
    command(bus, WAKE_UP, None);
}

/// Sends one command and its argument; the first word of the answer belongs to the command before.
fn command(bus: &mut impl Bus, command: u16, argument: Option<u16>) -> u16 {
    let mut bytes = [0u8; FRAME_BYTES];
    let (first, rest) = bytes.split_at_mut(WORD);
    first[..2].copy_from_slice(&command.to_be_bytes());
    if let Some(argument) = argument {
        rest[..2].copy_from_slice(&argument.to_be_bytes());
    }
    bus.exchange(&mut bytes);
    u16::from_be_bytes([bytes[0], bytes[1]])
}

/// What a frame says that was read with nothing commanded.
pub fn parse(bytes: &[u8; FRAME_BYTES]) -> Read {
    let (body, tail) = bytes.split_at(FRAME_BYTES - WORD);
    if crc16(body).to_be_bytes() != tail[..2] {
        return Read::Damaged;
    }
    let status = u16::from_be_bytes([body[0], body[1]]);
    // The first word after the command that woke the converter is that command again.
    if status != WAKE_UP {
        if status & STATUS_MASK != STATUS_SET {
            return Read::Reset;
        }
        match status & STATUS_NEW {
            STATUS_NEW => {}
            0 => return Read::NotNew,
            // All channels convert at one instant.
            _ => return Read::Damaged,
        }
    }
    let mut frame = [0; CHANNELS];
    for (code, word) in frame.iter_mut().zip(body[WORD..].as_chunks::<WORD>().0) {
        *code = i32::from_be_bytes([word[0], word[1], word[2], 0]) >> 8;
    }
    Read::Samples(frame)
}

/// The converter's check sum: polynomial 0x1021, start 0xffff.
pub(crate) fn crc16(bytes: &[u8]) -> u16 {
    static CRC: crc::Crc<u16, crc::Table<1>> = crc::Crc::<u16, crc::Table<1>>::new(&crc::CRC_16_IBM_3740);
    CRC.checksum(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// A converter as its data sheet describes it, deaf for a while after a reset.
    #[derive(Default)]
    struct Mock {
        registers: [u16; 8],
        answer: u16,
        deaf_us: u32,
        deaf: u32,
        stuck: bool,
        awake: bool,
        log: Vec<u16>,
    }

    impl Bus for Mock {
        fn exchange(&mut self, bytes: &mut [u8; FRAME_BYTES]) {
            if self.deaf > 0 {
                bytes.fill(0);
                return;
            }
            let command = u16::from_be_bytes([bytes[0], bytes[1]]);
            let argument = u16::from_be_bytes([bytes[3], bytes[4]]);
            self.log.push(command);
            bytes[..2].copy_from_slice(&self.answer.to_be_bytes());
            let register = usize::from(command >> 7 & 7);
            self.answer = match command & 0xe000 {
                WRITE_REGISTER if self.stuck => 0,
                WRITE_REGISTER => {
                    self.registers[register] = argument;
                    0x4000 | command & 0x1fff
                }
                READ_REGISTER => self.registers[register],
                _ if command == RESET => {
                    self.deaf = self.deaf_us;
                    RESET_DONE
                }
                _ => 0x0100,
            };
            self.awake = command == WAKE_UP;
        }

        fn wait_us(&mut self, us: u32) {
            self.deaf = self.deaf.saturating_sub(us);
        }
    }

    /// A frame as the converter sends it.
    fn frame(status: u16, samples: Frame) -> [u8; FRAME_BYTES] {
        let mut bytes = [0; FRAME_BYTES];
        bytes[..2].copy_from_slice(&status.to_be_bytes());
        for (word, code) in bytes[3..15].chunks_mut(3).zip(samples) {
            word.copy_from_slice(&code.to_be_bytes()[1..]);
        }
        let crc = crc16(&bytes[..15]);
        bytes[15..17].copy_from_slice(&crc.to_be_bytes());
        bytes
    }

    #[test]
    fn the_crc_is_the_published_one() {
        // Check value of CRC-16/CCITT-FALSE for "123456789".
        assert_eq!(crc16(b"123456789"), 0x29b1);
    }

    #[test]
    fn set_up_writes_mode_clock_and_gain_reads_them_back_and_wakes_last() {
        let mut bus = Mock { deaf_us: 5, ..Mock::default() };
        assert_eq!(set_up(&mut bus, Rate::Hz64000, 3), Ok(()));
        assert_eq!(bus.registers[2..5], [0x2110, 0x0f22, 0x3333]);
        assert_eq!(bus.log[..2], [RESET, STANDBY]);
        assert!(!bus.awake);
        wake_up(&mut bus);
        assert!(bus.awake);
        let kept = set_up(&mut Mock { stuck: true, ..Mock::default() }, Rate::Hz8000, 0);
        assert_eq!(kept, Err(SetupError::Register(MODE, 0)));
        let mute = set_up(&mut Mock { deaf_us: 1 << 20, ..Mock::default() }, Rate::Hz8000, 0);
        assert_eq!(mute, Err(SetupError::Unknown(0)));
    }

    #[test]
    fn samples_keep_their_sign_and_full_scale() {
        let samples = [0, -1, 8_388_607, -8_388_608];
        assert_eq!(parse(&frame(0x010f, samples)), Read::Samples(samples));
        assert_eq!(parse(&frame(WAKE_UP, samples)), Read::Samples(samples));
    }

    #[test]
    fn a_frame_without_a_new_conversion_is_no_samples() {
        assert_eq!(parse(&frame(0x0100, [1; 4])), Read::NotNew);
        for some in 1..0xf {
            assert_eq!(parse(&frame(0x0100 | some, [1; 4])), Read::Damaged, "{some:x}");
        }
    }

    #[test]
    fn a_flipped_bit_anywhere_damages_the_frame() {
        for at in 0..FRAME_BYTES - 1 {
            let mut bytes = frame(0x010f, [5, 6, 7, -8]);
            bytes[at] ^= 0x10;
            assert_eq!(parse(&bytes), Read::Damaged, "byte {at}");
        }
    }

    #[test]
    fn a_reset_and_other_words_are_noticed_in_the_status() {
        for status in [0x050f, RESET_DONE, 0x000f, 0x020f, 0x110f, 0x090f, 0x210f, 0x410f, 0x4100] {
            assert_eq!(parse(&frame(status, [1; 4])), Read::Reset, "{status:#06x}");
        }
    }
}
