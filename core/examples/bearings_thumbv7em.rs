//! The same on a Cortex-M7 without an operating system; `cargo xtask example` runs both and compares what they print.
#![no_std]
#![no_main]
use cortex_m_semihosting::{debug, hprintln};
use seabearing_core::{
    block::Block, config::StationConfig, recorder::Memory, run::Application, wire::Message,
};
use {cortex_m::singleton, panic_semihosting as _};

const HYDROPHONES_M: [[f64; 3]; 4] =
    [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

#[cortex_m_rt::entry]
fn main() -> ! {
    let config = StationConfig::array(64_000.0, HYDROPHONES_M);
    let memory = singleton!(: Memory<'static> = Memory::new()).unwrap();
    let mut recorder = memory.configure(&config, None).unwrap();
    let lead = HYDROPHONES_M.map(|[x, y, _]| (100.5 + (x * 0.866 + y * 0.5) / 1484.0 * 64e3) as u32);
    let noise = |n: u32| (n.wrapping_mul(n ^ 0x9E37_79B9).wrapping_mul(0x85EB_CA6B) as i32) >> 14;
    let mut print = |message: &Message| {
        if let Message::Bearing(b) = message {
            hprintln!("{:.1} s {:.2}°", b.index as f32 / 64e3, b.azimuth.to_degrees());
        }
    };
    for first in (0..320_000).step_by(500) {
        let heard = |n: u32, c: usize| noise(n + lead[c]) + noise(!(4 * n + c as u32)) / 8;
        let frames: [_; 500] = core::array::from_fn(|i| [0, 1, 2, 3].map(|c| heard(first + i as u32, c)));
        recorder.push(Block { first_index: first.into(), frames: &frames }, &mut print);
    }
    recorder.finish(&mut print);
    loop {
        debug::exit(debug::EXIT_SUCCESS)
    }
}
