//! Samples over the emulated serial line: the firmware's telemetry is the host's, byte for byte, and damage on the line
//! is counted and leaves gaps.
//!
//! Needs the firmware's image and QEMU; `cargo xtask test` builds the one, has the other, and runs this.

use seabearing::emulator::{self, Emulator, Engine, SamplePath};
use seabearing::sample_line::{SendTiming, Sender};
use seabearing::twin;
use seabearing_core::block::Block;
use seabearing_core::sbraw;
use seabearing_core::wire::{FaultCode, Message};
use seabearing_testkit::emulated;
use seabearing_tests::{OceanBottom, ocean_bottom};
use std::io::Write;

fn emulator() -> Emulator {
    let firmware = emulator::firmware(None).unwrap();
    Emulator { firmware, count_instructions: false, samples: SamplePath::Uart, engine: Engine::Qemu }
}

fn send(record: &OceanBottom, out: &mut dyn Write) -> anyhow::Result<()> {
    let mut sender = Sender::new(out, record.station.config.rate_hz, SendTiming::Free);
    for (first_index, frames) in &record.blocks {
        sender.block(Block { first_index: *first_index, frames })?;
    }
    sender.end()
}

/// A line that damages: counts the frames that pass, and hands each with its number to `damage`.
struct Damaging<'a, D> {
    out: &'a mut dyn Write,
    frame: usize,
    damage: D,
}

impl<D: FnMut(usize, &mut Vec<u8>)> Write for Damaging<'_, D> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        assert_eq!(bytes.last(), Some(&0), "the sender writes whole frames");
        let mut damaged = bytes.to_vec();
        (self.damage)(self.frame, &mut damaged);
        self.frame += 1;
        self.out.write_all(&damaged)?;
        Ok(bytes.len())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}

#[test]
fn samples_over_the_line_give_the_telemetry_of_the_host_from_a_file() {
    if !emulated("samples_over_the_line_give_the_telemetry_of_the_host_from_a_file") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let record = ocean_bottom(folder.path(), 900.0).unwrap();
    let blob = seabearing::blob::of(&record.station).unwrap();
    let twins = twin::both(&emulator(), &blob, |out, _| send(&record, out)).unwrap();
    let messages = twins.agree(50.0).unwrap();
    assert!(messages.iter().any(|m| matches!(m, Message::Azimuth(a) if a.detected)), "{messages:?}");
    assert!(!messages.iter().any(|m| matches!(m, Message::Fault(_))), "{messages:?}");
    assert_eq!((twins.summary.line_damaged, twins.summary.line_lost), (0, 0));
    assert_eq!(twins.summary.instants, 45_000);

    let mut from_file = Vec::new();
    let feed = |out: &mut dyn Write| {
        out.write_all(&sbraw::MAGIC)?;
        for (first_index, frames) in &record.blocks {
            twin::write_block(out, Block { first_index: *first_index, frames })?;
        }
        Ok(())
    };
    twin::host(&blob, SamplePath::File, feed, |frame| {
        from_file.extend_from_slice(frame);
        Ok(())
    })
    .unwrap();
    assert_eq!(from_file, twins.firmware);
}

#[test]
fn damage_on_the_line_is_counted_and_leaves_gaps() {
    if !emulated("damage_on_the_line_is_counted_and_leaves_gaps") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let record = ocean_bottom(folder.path(), 600.0).unwrap();
    let blob = seabearing::blob::of(&record.station).unwrap();
    // Frames of eight instants: 3750 with samples, then the ends.
    let damage = |n: usize, frame: &mut Vec<u8>| match n {
        // A bit turned.
        500 => frame[60] ^= 0x08,
        // A frame gone.
        1000 => frame.clear(),
        // The delimiter gone: two frames become one.
        1500 => drop(frame.pop()),
        // Zeros within: the pieces are no frames.
        2000 => frame[30..90].fill(0),
        // A burst over ten frames; the last one's delimiter goes, and the next frame with it.
        2500..2510 => frame.iter_mut().zip(n..).for_each(|(b, k)| *b = b.wrapping_mul(151) ^ (k as u8)),
        // The last two frames with samples, and the first end.
        3748 | 3749 => frame.clear(),
        3750 => frame[4] ^= 1,
        _ => {}
    };
    let twins =
        twin::both(&emulator(), &blob, |out, _| send(&record, &mut Damaging { out, frame: 0, damage }))
            .unwrap();
    let messages = twins.agree(50.0).unwrap();
    let gaps: Vec<(u64, i64)> = messages
        .iter()
        .filter_map(|m| match m {
            Message::Fault(f) if f.code == FaultCode::Gap => Some((f.index, f.value)),
            _ => None,
        })
        .collect();
    let expected = [(4000, 8), (8000, 8), (12_000, 16), (16_000, 8), (20_000, 88), (29_984, 15)];
    let lengths: Vec<i64> = gaps.iter().map(|g| g.1).collect();
    assert_eq!(lengths, expected.map(|g| g.1), "{gaps:?}");
    for ((at, _), (from, n)) in gaps.iter().zip(expected) {
        assert!((from..=from + n as u64).contains(at), "{gaps:?}");
    }
    // Eighteen frames that carried samples, and the first end.
    assert_eq!(twins.summary.line_lost, 19);
    assert_eq!(twins.summary.line_damaged, 10);
    // Every instant is accounted for.
    let health =
        messages.iter().rev().find_map(|m| if let Message::Health(h) = m { Some(*h) } else { None }).unwrap();
    assert_eq!(health.processed + health.lost.iter().sum::<u64>(), 30_000, "{health:?}");
    assert_eq!(health.lost[0], expected.map(|g| g.1 as u64).iter().sum::<u64>(), "{health:?}");
}

#[test]
fn a_silent_line_is_reported_by_the_boards_clock() {
    if !emulated("a_silent_line_is_reported_by_the_boards_clock") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let record = ocean_bottom(folder.path(), 600.0).unwrap();
    let blob = seabearing::blob::of(&record.station).unwrap();
    let mut bytes = Vec::new();
    let feed = |out: &mut dyn Write| {
        // Longer than the ten seconds after which a source is called silent.
        std::thread::sleep(std::time::Duration::from_secs(14));
        send(&record, out)
    };
    emulator()
        .run(&blob, feed, |heard, _| {
            bytes.extend_from_slice(heard);
            Ok(())
        })
        .unwrap();
    let mut decoder = seabearing_core::wire::Decoder::default();
    let messages: Vec<Message> = bytes.iter().filter_map(|b| decoder.push(*b).map(|r| r.message)).collect();
    let silent =
        messages.iter().position(|m| matches!(m, Message::Fault(f) if f.code == FaultCode::NoSamples));
    let first = messages.iter().position(|m| matches!(m, Message::Azimuth(_)));
    assert!(silent.is_some() && silent < first, "{messages:?}");
}
