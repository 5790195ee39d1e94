//! Decoding 24-bit WAV: the reader of this project against `hound`'s iterator, over the same 16 s of four channels.

use divan::counter::ItemsCount;
use seabearing_host::recording::{self, write};
use seabearing_host::station::Station;
use std::path::{Path, PathBuf};

const STATION: &str = "[station]\nid = 1\nkind = \"array\"\n[sampling]\nrate_hz = 64000\n[array]\nhydrophones_m = \
    [[0.0,1.06,-0.38],[0.92,-0.53,-0.38],[-0.92,-0.53,-0.38],[0.0,0.0,1.13]]\n";
const FRAMES: i32 = 1 << 20;

fn main() {
    divan::main();
}

fn recorded(folder: &Path) -> PathBuf {
    let path = folder.join("r.wav");
    let frames = (0..FRAMES).map(|i| [i, -i, i << 2, i ^ 0x5555]);
    write::wav(&path, 64_000, write::Encoding::Int24, frames).expect("a writable temporary folder");
    path
}

#[divan::bench]
fn in_bulk(bencher: divan::Bencher<'_, '_>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let paths = [recorded(folder.path())];
    let station = Station::parse(STATION, "s", Path::new(".")).expect("a good station");
    bencher.counter(ItemsCount::new(FRAMES as usize * 4)).bench_local(|| {
        let mut source = recording::open(&paths, &station, None).expect("a good recording");
        let mut sum = 0i64;
        while let Some(block) = source.next_block().expect("a good recording") {
            sum += block.frames.iter().map(|f| i64::from(f[0] ^ f[1] ^ f[2] ^ f[3])).sum::<i64>();
        }
        sum
    });
}

#[divan::bench]
fn by_hound(bencher: divan::Bencher<'_, '_>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = recorded(folder.path());
    bencher.counter(ItemsCount::new(FRAMES as usize * 4)).bench_local(|| {
        let mut reader = hound::WavReader::open(&path).expect("a good recording");
        reader.samples::<i32>().map(|x| i64::from(x.expect("a good recording"))).fold(0, |a, x| a ^ x)
    });
}
