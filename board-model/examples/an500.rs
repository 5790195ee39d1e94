//! dev
use seabearing_board_model::{Image, mps2_an500};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let image = Image::parse(&std::fs::read(&a[1]).unwrap()).unwrap();
    let blob = std::fs::read(&a[2]).unwrap();
    let mut m = mps2_an500::machine(image, &blob, Box::new(std::fs::File::open(&a[3]).unwrap())).unwrap();
    let t = std::time::Instant::now();
    let r = m.run(u64::MAX);
    let c = m.counts();
    let n = c.thread.instructions + c.handlers.instructions;
    eprintln!("{r:?} {n} instructions {:.1} M/s {:?}", n as f64 / t.elapsed().as_secs_f64() / 1e6, t.elapsed());
    eprintln!("{}", m.board.console);
    let w: Vec<u64> = m.board.summary.chunks(8).map(|w| u64::from_le_bytes(w.try_into().unwrap())).collect();
    eprintln!("{w:?} telemetry {}", m.board.telemetry.len());
    std::fs::write(&a[4], &m.board.telemetry).unwrap();
}
