//! What a recorder of a test stands on: a line, a clock, and noise.

use seabearing_core::block::Frame;
use seabearing_core::port::{self, Chunk, Clock, SampleSource};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// A line of this computer.
pub struct Line(TcpStream);

impl Line {
    pub fn over(stream: TcpStream) -> Self {
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        Self(stream)
    }
}

impl port::Link for Line {
    fn send(&mut self, frame: &[u8]) -> bool {
        self.0.write_all(frame).is_ok()
    }

    fn receive(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.0.read(&mut byte).ok()? == 1).then_some(byte[0])
    }
}

/// A clock.
#[derive(Clone, Copy)]
pub struct Since(Instant);

impl Since {
    pub fn now() -> Self {
        Self(Instant::now())
    }
}

impl Clock for Since {
    fn ticks(&mut self) -> u32 {
        0
    }

    fn seconds(&mut self) -> u32 {
        self.0.elapsed().as_secs() as u32
    }

    fn micros(&mut self) -> u64 {
        self.0.elapsed().as_micros() as u64
    }
}

/// Noise, as fast as time goes by; or the end of everything at once.
pub struct Noise {
    since: Instant,
    rate_hz: f64,
    index: u64,
    hangs: bool,
}

/// The codes of an instant: white, uniform over 2¹⁸ (splitmix64 of the number of the code).
pub fn codes(index: u64) -> Frame {
    [0, 1, 2, 3].map(|k| {
        let z = (4 * index + k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 46) as i32 - (1 << 17)
    })
}

impl Noise {
    pub fn new(rate_hz: f64, hangs: bool) -> Self {
        Self { since: Instant::now(), rate_hz, index: 0, hangs }
    }
}

impl SampleSource for Noise {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        if self.hangs {
            return Chunk::End;
        }
        let count = frames.len();
        if ((self.index + count as u64) as f64) > self.since.elapsed().as_secs_f64() * self.rate_hz {
            std::thread::sleep(Duration::from_micros(200));
            return Chunk::Idle;
        }
        for (n, frame) in (self.index..).zip(frames) {
            *frame = codes(n);
        }
        self.index += count as u64;
        Chunk::Frames { first_index: self.index - count as u64, count }
    }
}
