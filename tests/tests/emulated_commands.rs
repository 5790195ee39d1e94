//! Commands to the emulated firmware over its serial port, with samples on a line of their own and from a file.
//!
//! Needs the firmware's image and QEMU; `cargo xtask test` builds the one, has the other, and runs this.

use seabearing::emulator::{self, Emulator, Engine, SamplePath};
use seabearing::sample_line::{SendTiming, Sender};
use seabearing::station::Station;
use seabearing::twin;
use seabearing_core::block::{Block, Frame};
use seabearing_core::recorder::Memory;
use seabearing_core::run::Application;
use seabearing_core::sbraw;
use seabearing_core::wire::{Command, Decoder, Encoder, End, Fault, FaultCode, Hello, Message, Reply};
use seabearing_testkit::emulated;
use seabearing_tests::ocean_bottom;
use std::io::Write;
use std::path::Path;
use std::sync::mpsc;

fn emulator(samples: SamplePath) -> Emulator {
    let firmware = emulator::firmware(None).unwrap();
    Emulator { firmware, count_instructions: false, samples, engine: Engine::Qemu }
}

/// What the base station's side has heard and says.
#[derive(Default)]
struct Base {
    decoder: Decoder,
    encoder: Encoder,
    heard: Vec<Message>,
}

impl Base {
    /// Takes bytes; `answer` is asked for the bytes to send after each message.
    fn hear(
        &mut self,
        bytes: &[u8],
        line: &mut dyn Write,
        mut answer: impl FnMut(&Message, &mut Encoder) -> Vec<u8>,
    ) -> anyhow::Result<()> {
        for byte in bytes {
            if let Some(received) = self.decoder.push::<Message>(*byte) {
                self.heard.push(received.message);
                line.write_all(&answer(&received.message, &mut self.encoder))?;
            }
        }
        Ok(())
    }

    fn position(&self, wanted: &Message) -> usize {
        self.heard
            .iter()
            .position(|m| m == wanted)
            .unwrap_or_else(|| panic!("no {wanted:?} in {:?}", self.heard))
    }
}

const fn done(token: u8) -> Message {
    Message::Reply(Reply { token, status: 0 })
}

#[test]
fn an_ocean_bottom_station_answers_while_its_sample_line_is_silent_and_while_it_works() {
    if !emulated("an_ocean_bottom_station_answers_while_its_sample_line_is_silent_and_while_it_works") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let record = ocean_bottom(folder.path(), 600.0).unwrap();
    let blob = seabearing::blob::of(&record.station).unwrap();
    let (go, gone) = mpsc::channel::<()>();
    let blocks = &record.blocks;
    let feed = move |out: &mut dyn Write| {
        // The first half; the second once the commands are answered.
        let mut sender = Sender::new(out, 50.0, SendTiming::Free);
        let half = blocks.partition_point(|b| b.0 < 15_000);
        for (n, (first_index, frames)) in blocks.iter().enumerate() {
            if n == half {
                gone.recv()?;
            }
            sender.block(Block { first_index: *first_index, frames })?;
        }
        sender.end()
    };
    let mut base = Base::default();
    let mut healths = 0;
    let answer = |message: &Message, encoder: &mut Encoder| match *message {
        // The session's start.
        Message::Hello(Hello { reset_cause: 0, .. }) => {
            encoder.frame(&Command::Identify { token: 7 }).to_vec()
        }
        Message::Reply(Reply { token: 7, .. }) => {
            // A command nobody knows, a damaged one, line noise, and a good one behind them.
            let mut bytes = encoder.frame(&99u8).to_vec();
            let at = bytes.len() + 3;
            bytes.extend_from_slice(encoder.frame(&Command::Stop { token: 1 }));
            bytes[at] ^= 4;
            bytes.extend_from_slice(&[0, 0, 17, 201, 0]);
            bytes.extend_from_slice(encoder.frame(&Command::HealthEvery { token: 8, seconds: 30 }));
            bytes
        }
        Message::Reply(Reply { token: 8, .. }) => {
            go.send(()).unwrap();
            Vec::new()
        }
        Message::Health(h) if h.index > 15_000 => {
            healths += 1;
            if healths == 4 { encoder.frame(&Command::Stop { token: 9 }).to_vec() } else { Vec::new() }
        }
        _ => Vec::new(),
    };
    let mut answer = answer;
    let summary = emulator(SamplePath::Uart)
        .run(&blob, feed, |bytes, line| base.hear(bytes, line, &mut answer))
        .unwrap();

    // Identify: who it is, how it is, done.
    let identified = base.position(&done(7));
    let [Message::Hello(first), ..] = base.heard[..] else { panic!("{:?}", base.heard) };
    assert_eq!(base.heard[identified - 2], Message::Hello(Hello { reset_cause: 255, ..first }));
    assert!(matches!(base.heard[identified - 1], Message::Health(_)), "{:?}", base.heard);
    // Three frames that were no commands, said and counted; none of them stopped it.
    let bad: Vec<i64> = base
        .heard
        .iter()
        .filter_map(|m| match m {
            Message::Fault(Fault { code: FaultCode::BadCommand, value, .. }) => Some(*value),
            _ => None,
        })
        .collect();
    assert_eq!(bad, [1, 2, 3]);
    // Health every 30 s of samples from then on.
    let every = base.position(&done(8));
    let indices: Vec<u64> = base.heard[every..]
        .iter()
        .filter_map(|m| if let Message::Health(h) = m { Some(h.index) } else { None })
        .filter(|i| *i > 15_360)
        .take(3)
        .collect();
    assert!(indices.windows(2).all(|w| (1024..=2048).contains(&(w[1] - w[0]))), "{indices:?}");
    // Stop: answered, then the final health and the end, before the input's.
    let stopped = base.position(&done(9));
    let [.., Message::Health(last), Message::End(End { index, .. })] = base.heard[..] else {
        panic!("{:?}", base.heard)
    };
    assert!(stopped < base.heard.len() - 2 && index < 30_000, "{index}");
    assert_eq!(last.processed + last.lost.iter().sum::<u64>(), index);
    assert_eq!(summary.index, index);
}

/// The n-th 512 instants of some sound.
fn half_a_thousand(n: u64) -> Vec<Frame> {
    let noise = |k: u64| ((n * 512 + k).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 44) as i32 - (1 << 19);
    (0..512).map(|k| [noise(k), noise(k + 7), noise(k + 31), noise(k + 97)]).collect()
}

/// What the host's recorder says when it is asked for its spectra of the step about `index`.
fn spectra_on_the_host(station: &Station, index: u64) -> Vec<Message> {
    let mut memory: Box<Memory<'_>> = Box::default();
    let mut recorder = memory.configure(&station.config, None).unwrap();
    for n in 0..index / 512 + 500 {
        recorder.push(Block { first_index: n * 512, frames: &half_a_thousand(n) }, &mut |_| ());
        let mut said = Vec::new();
        recorder.command(Command::SendSpectrum { token: 4, channels: 15 }, &mut |m| said.push(*m));
        said.retain(|m| matches!(m, Message::Spectrum(_)));
        if said.iter().any(|m| matches!(m, Message::Spectrum(s) if s.index == index)) {
            return said;
        }
    }
    Vec::new()
}

#[test]
fn an_array_answers_and_stops_while_samples_stream_in() {
    if !emulated("an_array_answers_and_stops_while_samples_stream_in") {
        return;
    }
    let station =
        Station::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/demo-station.toml")).unwrap();
    let blob = seabearing::blob::of(&station).unwrap();
    let feed = |out: &mut dyn Write| {
        out.write_all(&sbraw::MAGIC)?;
        // Without end: only the stop ends it.
        for n in 0u64.. {
            twin::write_block(out, Block { first_index: n * 512, frames: &half_a_thousand(n) })?;
        }
        Ok(())
    };
    let mut base = Base::default();
    let mut asked = false;
    let mut answer = |message: &Message, encoder: &mut Encoder| match *message {
        Message::Hello(Hello { reset_cause: 0, .. }) => {
            encoder.frame(&Command::Identify { token: 1 }).to_vec()
        }
        Message::Reply(Reply { token: 1, .. }) => {
            encoder.frame(&Command::HealthEvery { token: 2, seconds: 1 }).to_vec()
        }
        // Two healths after the change: then what it hears, and enough.
        Message::Health(h) if h.index >= 128_000 && !asked => {
            asked = true;
            let mut bytes = encoder.frame(&Command::SendSpectrum { token: 4, channels: 15 }).to_vec();
            let snippet = Command::SendSnippet { token: 5, channels: 15, instants: 64 };
            bytes.extend_from_slice(encoder.frame(&snippet));
            bytes
        }
        Message::Reply(Reply { token: 5, .. }) => encoder.frame(&Command::Stop { token: 3 }).to_vec(),
        _ => Vec::new(),
    };
    emulator(SamplePath::File).run(&blob, feed, |bytes, line| base.hear(bytes, line, &mut answer)).unwrap();
    assert!(
        base.position(&done(1)) < base.position(&done(2))
            && base.position(&done(2)) < base.position(&done(3))
    );
    // Its spectra are the host's, bit by bit; without a link it takes no snippet.
    let spectra: Vec<Message> =
        base.heard.iter().filter(|m| matches!(m, Message::Spectrum(_))).copied().collect();
    let [Message::Spectrum(first), ..] = spectra[..] else { panic!("{:?}", base.heard) };
    assert_eq!(spectra.len(), 4);
    assert_eq!(spectra, spectra_on_the_host(&station, first.index));
    assert!(base.position(&done(4)) < base.position(&Message::Reply(Reply { token: 5, status: 2 })));
    let [.., Message::Health(last), Message::End(End { index, .. })] = base.heard[..] else {
        panic!("{:?}", base.heard)
    };
    assert_eq!(last.processed + last.lost.iter().sum::<u64>(), index);
    assert_eq!(base.decoder.counters().damaged + base.decoder.counters().lost, 0);
}
