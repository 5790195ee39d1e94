//! ADS131M04-class converter: four channels sampled at the same instant, 24 bits, over SPI.
//!
//! Every frame is `status, channel 0..3, CRC`, words of 24 bits; the CRC is CRC-16/CCITT (polynomial 0x1021, start
//! 0xffff) of the words before it. A frame whose CRC is wrong is an error here and becomes [`MISSING`] samples in the
//! recording: nothing is invented. SPI mode 1, at most 25 MHz; one frame of 18 bytes at 64 kHz is 9.2 Mbit/s.
//! Register names and numbers are those of the converter's data sheet (Texas Instruments SBAS890).

use embedded_hal_async::spi::{Operation, SpiDevice};
use seabearing_core::block::{CHANNELS, Frame, MISSING};

/// Bytes of a word.
const WORD: usize = 3;
/// Bytes of a frame: status, four channels, CRC.
pub const FRAME_BYTES: usize = WORD * (CHANNELS + 2);

const RESET: u16 = 0x0011;
/// The answer to a reset of a converter with four channels.
const RESET_DONE: u16 = 0xff24;
const WRITE_REGISTER: u16 = 0x6000;
const READ_REGISTER: u16 = 0xa000;
const CLOCK: u16 = 0x03;
const GAIN: u16 = 0x04;
/// All four channels on, high-resolution power mode.
const CLOCK_ON: u16 = 0x0f02;
/// Oversampling of 64: 64 kHz from a clock of 8.192 MHz.
const TURBO: u16 = 0x0020;

/// A frame that could not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError<E> {
    /// The bus failed.
    Bus(E),
    /// The CRC was wrong.
    Crc,
}

/// A converter that could not be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError<E> {
    /// The bus failed.
    Bus(E),
    /// It did not answer a reset as a converter with four channels does: what it said.
    Unknown(u16),
    /// A register did not keep what was written: its number and what it held.
    Register(u16, u16),
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
        [(64e3, Self::Hz64000), (32e3, Self::Hz32000), (16e3, Self::Hz16000), (8e3, Self::Hz8000)]
            .into_iter()
            .find_map(|(hz, rate)| (hz == rate_hz).then_some(rate))
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

/// The converter behind an SPI device that selects it.
pub struct Converter<S> {
    spi: S,
}

impl<S: SpiDevice> Converter<S> {
    /// Resets the converter and sets rate and gain (the same power of two for all channels, 0 to 7: 1 to 128).
    ///
    /// # Errors
    /// Says what did not answer as expected.
    pub async fn new(spi: S, rate: Rate, gain_log2: u8) -> Result<Self, SetupError<S::Error>> {
        let mut converter = Self { spi };
        converter.command(RESET, None).await.map_err(SetupError::Bus)?;
        let answer = converter.command(0, None).await.map_err(SetupError::Bus)?;
        if answer != RESET_DONE {
            return Err(SetupError::Unknown(answer));
        }
        let gain = u16::from(gain_log2.min(7)) * 0x1111;
        for (register, value) in [(CLOCK, rate.clock()), (GAIN, gain)] {
            converter.command(WRITE_REGISTER | register << 7, Some(value)).await.map_err(SetupError::Bus)?;
            converter.command(READ_REGISTER | register << 7, None).await.map_err(SetupError::Bus)?;
            let kept = converter.command(0, None).await.map_err(SetupError::Bus)?;
            if kept != value {
                return Err(SetupError::Register(register, kept));
            }
        }
        Ok(converter)
    }

    /// Sends one command and its argument; the first word of the answer belongs to the command before.
    async fn command(&mut self, command: u16, argument: Option<u16>) -> Result<u16, S::Error> {
        let mut bytes = [0u8; FRAME_BYTES];
        bytes[..2].copy_from_slice(&command.to_be_bytes());
        if let Some(argument) = argument {
            bytes[WORD..WORD + 2].copy_from_slice(&argument.to_be_bytes());
        }
        self.spi.transaction(&mut [Operation::TransferInPlace(&mut bytes)]).await?;
        Ok(u16::from_be_bytes([bytes[0], bytes[1]]))
    }

    /// Reads the frame that is ready.
    ///
    /// # Errors
    /// The bus failed, or the frame's CRC is wrong.
    pub async fn read(&mut self) -> Result<Frame, FrameError<S::Error>> {
        let mut bytes = [0u8; FRAME_BYTES];
        self.spi.transaction(&mut [Operation::TransferInPlace(&mut bytes)]).await.map_err(FrameError::Bus)?;
        parse(&bytes).ok_or(FrameError::Crc)
    }

    /// Reads the frame that is ready; one that cannot be used is [`MISSING`] on every channel.
    pub async fn read_or_missing(&mut self) -> Frame {
        self.read().await.unwrap_or([MISSING; CHANNELS])
    }
}

/// The samples of a frame whose CRC is right.
fn parse(bytes: &[u8; FRAME_BYTES]) -> Option<Frame> {
    let (body, tail) = bytes.split_at(FRAME_BYTES - WORD);
    if crc16(body).to_be_bytes() != tail[..2] {
        return None;
    }
    let mut frame = [0; CHANNELS];
    for (code, word) in frame.iter_mut().zip(body[WORD..].as_chunks::<WORD>().0) {
        *code = i32::from_be_bytes([word[0], word[1], word[2], 0]) >> 8;
    }
    Some(frame)
}

/// The converter's check sum: polynomial 0x1021, start 0xffff.
fn crc16(bytes: &[u8]) -> u16 {
    static CRC: crc::Crc<u16, crc::Table<1>> = crc::Crc::<u16, crc::Table<1>>::new(&crc::CRC_16_IBM_3740);
    CRC.checksum(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::convert::Infallible;
    use core::future::Future;
    use core::pin::pin;
    use core::task::{Context, Poll, Waker};
    use embedded_hal_async::spi::ErrorType;
    use std::vec::Vec;

    /// A converter as its data sheet describes it, on a bus without delays.
    #[derive(Default)]
    struct Mock {
        registers: [u16; 8],
        answer: u16,
        samples: Frame,
        damage: Option<usize>,
        stuck: bool,
        log: Vec<u16>,
    }

    impl ErrorType for Mock {
        type Error = Infallible;
    }

    impl SpiDevice for Mock {
        async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
            for operation in operations {
                let Operation::TransferInPlace(bytes) = operation else { panic!("unexpected operation") };
                let command = u16::from_be_bytes([bytes[0], bytes[1]]);
                let argument = u16::from_be_bytes([bytes[3], bytes[4]]);
                self.log.push(command);
                bytes[..2].copy_from_slice(&self.answer.to_be_bytes());
                bytes[2] = 0;
                for (word, code) in bytes[3..15].chunks_mut(3).zip(self.samples) {
                    word.copy_from_slice(&code.to_be_bytes()[1..]);
                }
                let crc = crc16(&bytes[..15]);
                bytes[15..17].copy_from_slice(&crc.to_be_bytes());
                bytes[17] = 0;
                if let Some(at) = self.damage {
                    bytes[at] ^= 0x10;
                }
                let register = usize::from(command >> 7 & 7);
                self.answer = match command & 0xe000 {
                    WRITE_REGISTER if self.stuck => 0,
                    WRITE_REGISTER => {
                        self.registers[register] = argument;
                        0x4000 | command & 0x1fff
                    }
                    READ_REGISTER => self.registers[register],
                    _ if command == RESET => RESET_DONE,
                    _ => 0x0500,
                };
            }
            Ok(())
        }
    }

    fn block_on<F: Future>(future: F) -> F::Output {
        let mut future = pin!(future);
        loop {
            if let Poll::Ready(out) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                return out;
            }
        }
    }

    #[test]
    fn the_crc_is_the_published_one() {
        // Check value of CRC-16/CCITT-FALSE for "123456789".
        assert_eq!(crc16(b"123456789"), 0x29b1);
    }

    #[test]
    fn set_up_writes_clock_and_gain_and_reads_them_back() {
        let converter = block_on(Converter::new(Mock::default(), Rate::Hz64000, 3)).unwrap();
        assert_eq!(converter.spi.registers[3], 0x0f22);
        assert_eq!(converter.spi.registers[4], 0x3333);
        assert_eq!(converter.spi.log[0], RESET);
        let kept = block_on(Converter::new(Mock { stuck: true, ..Mock::default() }, Rate::Hz8000, 0)).err();
        assert_eq!(kept, Some(SetupError::Register(CLOCK, 0)));
    }

    #[test]
    fn samples_keep_their_sign_and_full_scale() {
        let mut converter = block_on(Converter::new(Mock::default(), Rate::Hz32000, 0)).unwrap();
        converter.spi.samples = [0, -1, 8_388_607, -8_388_608];
        assert_eq!(block_on(converter.read()), Ok([0, -1, 8_388_607, -8_388_608]));
    }

    #[test]
    fn a_flipped_bit_anywhere_makes_the_frame_missing() {
        let mut converter = block_on(Converter::new(Mock::default(), Rate::Hz16000, 0)).unwrap();
        converter.spi.samples = [5, 6, 7, -8];
        for at in 0..FRAME_BYTES - 1 {
            converter.spi.damage = Some(at);
            assert_eq!(block_on(converter.read()), Err(FrameError::Crc), "byte {at}");
            assert_eq!(block_on(converter.read_or_missing()), [MISSING; 4]);
        }
        converter.spi.damage = None;
        assert_eq!(block_on(converter.read()), Ok([5, 6, 7, -8]));
    }
}
