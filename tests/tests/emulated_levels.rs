//! Levels that a recorder sends of itself: the firmware's bytes are the host's, with what happens to recordings.
//!
//! Needs the firmware's image and QEMU; `cargo xtask test` builds the one, has the other, and runs this.

use seabearing::emulator::{self, Emulator, Engine, SamplePath};
use seabearing::station::Station;
use seabearing::twin;
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::Levels;
use seabearing_core::sbraw;
use seabearing_core::wire::{Message, Spectrum};
use seabearing_testkit::emulated;
use seabearing_tests::ocean_bottom;
use std::path::Path;

/// The spectra that both send, if they send the same bytes.
fn spectra(station: &Station, blocks: &[(u64, Vec<Frame>)]) -> Vec<Spectrum> {
    let firmware = emulator::firmware(None).unwrap();
    let emulator =
        Emulator { firmware, count_instructions: false, samples: SamplePath::File, engine: Engine::Qemu };
    let blob = seabearing::blob::of(station).unwrap();
    let twins = twin::both(&emulator, &blob, |out, _| {
        out.write_all(&sbraw::MAGIC)?;
        for (first_index, frames) in blocks {
            twin::write_block(out, Block { first_index: *first_index, frames })?;
        }
        Ok(())
    });
    let messages = twins.unwrap().agree(station.config.rate_hz).unwrap();
    let spectrum = |m: Message| if let Message::Spectrum(s) = m { Some(s) } else { None };
    messages.into_iter().filter_map(spectrum).collect()
}

#[test]
fn levels_of_an_array_are_the_same_on_the_target() {
    if !emulated("levels_of_an_array_are_the_same_on_the_target") {
        return;
    }
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/demo-station.toml");
    let text = std::fs::read_to_string(file).unwrap().replace("rate_hz = 64000", "rate_hz = 8000");
    let text = text + "[levels]\nevery_s = 10\nchannel = 1\n";
    let station = Station::parse(&text, "station.toml", Path::new(".")).unwrap();
    assert_eq!(station.config.levels, Levels { every_s: 10, channel: 1 });
    let noise = |k: u64| (k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 44) as i32 - (1 << 19);
    // Ten seconds on a channel that is dead, a gap, and an index that begins again.
    let sound = |n: u64| -> Vec<Frame> {
        let of = |k: u64| {
            [noise(k), if (156..320).contains(&n) { 77 } else { noise(k + 31) }, noise(k + 7), noise(k + 97)]
        };
        (n * 512..(n + 1) * 512).map(of).collect()
    };
    let blocks: Vec<(u64, Vec<Frame>)> = (0..700u64)
        .filter(|n| !(400..450).contains(n))
        .map(|n| (if n < 600 { n } else { n - 600 } * 512, sound(n)))
        .collect();
    let all = spectra(&station, &blocks);
    let intervals: Vec<u64> = all.iter().map(|s| s.index / 80_000).collect();
    assert_eq!(intervals, [0, 1, 2, 3, 0]);
    assert!(all.iter().all(|s| s.is_unasked() && s.channel == 1 && s.frames < 180), "{all:?}");
    assert!(all[0].frames > 170 && all[1].frames < 5 && all[2].frames < all[0].frames, "{all:?}");
}

#[test]
fn levels_of_an_ocean_bottom_are_the_same_on_the_target() {
    if !emulated("levels_of_an_ocean_bottom_are_the_same_on_the_target") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut record = ocean_bottom(folder.path(), 600.0).unwrap();
    record.station.config.levels = Levels { every_s: 120, channel: 0 };
    record.blocks.retain(|(first, _)| !(7000..9000).contains(first));
    let all = spectra(&record.station, &record.blocks);
    let intervals: Vec<u64> = all.iter().map(|s| s.index / 6000).collect();
    assert_eq!(intervals, [0, 1, 2, 3, 4], "{all:?}");
    assert!(all[1].frames < all[2].frames && all[2].frames >= 11, "{all:?}");
    assert!(
        all.iter()
            .all(|s| s.is_unasked() && s.tenth_db.iter().filter(|l| **l != Spectrum::NOTHING).count() > 20)
    );
}
