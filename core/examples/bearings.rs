//! Blocks of samples in, bearings out: noise from 60° East of North, level with the array.

use seabearing_core::{
    block::Block, config::StationConfig, recorder::Memory, run::Application, wire::Message,
};

const HYDROPHONES_M: [[f64; 3]; 4] =
    [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let config = StationConfig::array(64_000.0, HYDROPHONES_M);
    let mut memory = Box::new(Memory::new());
    let mut recorder = memory.configure(&config, None)?;
    let (east, north) = 60f64.to_radians().sin_cos();
    // How many samples before the array's middle a hydrophone hears it, from 100 on.
    let lead = HYDROPHONES_M.map(|[x, y, _]| (100.5 + (x * east + y * north) / 1484.0 * 64e3) as i64);
    let noise = |n: i64| ((n as f64 * 12.9898).sin() * 43_758.547).fract() * 1e5;
    let mut print = |message: &Message| {
        if let Message::Bearing(b) = message {
            println!("{:5.1} s {:6.2}°", b.index as f64 / 64_000.0, b.azimuth.to_degrees());
        }
    };
    for first_index in (0..320_000).step_by(500) {
        let heard = |n: i64, c: usize| (noise(n + lead[c]) + 0.1 * noise(-4 * n - c as i64)) as i32;
        let frames: Vec<_> = (0..500).map(|i| [0, 1, 2, 3].map(|c| heard(first_index + i, c))).collect();
        recorder.push(Block { first_index: first_index as u64, frames: &frames }, &mut print);
    }
    recorder.finish(&mut print);
    Ok(())
}
