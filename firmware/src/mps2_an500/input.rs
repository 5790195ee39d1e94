//! Where samples come from: a file or FIFO of the host, or the sample line on UART1.

use super::host::File;
use seabearing_core::block::Frame;
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::sbraw::{self, Ending};

#[cfg(feature = "obs")]
use super::{host, uart::Uart};
#[cfg(feature = "obs")]
use seabearing_core::sample_line;

/// Samples in. One is made, and there is no heap to box its larger half on.
#[allow(clippy::large_enum_variant)]
pub enum Input {
    /// By semihosting.
    File(sbraw::Reader<File>),
    /// Over UART1: slow enough only for an ocean-bottom station.
    #[cfg(feature = "obs")]
    Line(sample_line::Reader<Uart>),
}

impl Input {
    /// What the command line asks for; the reason where it cannot be had.
    pub fn open() -> Result<Self, &'static core::ffi::CStr> {
        #[cfg(feature = "obs")]
        if host::command_line().starts_with(b"samples=uart\0") {
            return Ok(Self::Line(sample_line::Reader::new(Uart::samples())));
        }
        let file = File::read_from(c"samples.sbraw").ok_or(c"cannot open samples.sbraw\n")?;
        Ok(Self::File(sbraw::Reader::new(file)))
    }

    /// Frames of the sample line that were damaged, and lost (damaged ones included).
    pub fn losses(&self) -> (u64, u64) {
        match self {
            Self::File(_) => (0, 0),
            #[cfg(feature = "obs")]
            Self::Line(line) => (line.counters().damaged, line.counters().lost),
        }
    }

    /// Whether the input ended as it should; the reason where it did not.
    pub fn ending(&self) -> Result<(), &'static core::ffi::CStr> {
        match self {
            Self::File(file) => match file.ending() {
                Ending::NotSbraw => Err(c"samples.sbraw is not an .sbraw stream\n"),
                Ending::Truncated => Err(c"samples.sbraw ends within a record\n"),
                Ending::Clean | Ending::Open => Ok(()),
            },
            #[cfg(feature = "obs")]
            Self::Line(_) => Ok(()),
        }
    }
}

impl SampleSource for Input {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        match self {
            Self::File(file) => file.read(frames),
            #[cfg(feature = "obs")]
            Self::Line(line) => line.read(frames),
        }
    }

    fn waits(&self) -> bool {
        matches!(self, Self::File(_))
    }
}
