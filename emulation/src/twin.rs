//! The twin: the firmware in QEMU and the same loop on the host over the same samples, telemetry compared.

use crate::emulator::{Emulator, FirmwareSummary, SamplePath, feed_all, joined};
use crate::record::RecordFormat as Records;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_core::block::{Block, Frame};
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::port::{Link, NoBoard, NoClock};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_core::sample_line::{self, Arrival, ByteSource};
use seabearing_core::sbraw::{self, ReadBytes, Reader};
use seabearing_core::wire::{Decoder, DecoderCounters, Message};
use std::io::{BufReader, Read, Write};
use std::os::unix::net::UnixStream;

/// Writes one block as a record of an `.sbraw` stream.
///
/// # Errors
/// The reader has gone.
pub fn write_block(out: &mut dyn Write, block: Block<'_>) -> std::io::Result<()> {
    out.write_all(&sbraw::record_head(block.first_index, block.frames.len() as u32))?;
    block.frames.iter().try_for_each(|frame| out.write_all(&sbraw::frame_bytes(frame)))
}

struct Bytes<R>(R);

impl<R: Read> ReadBytes for Bytes<R> {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        let mut got = 0;
        while got < bytes.len() {
            match self.0.read(&mut bytes[got..]) {
                Ok(0) => break,
                Ok(n) => got += n,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        got
    }
}

impl<R: Read> ByteSource for Bytes<R> {
    fn next(&mut self) -> Arrival {
        let mut byte = [0];
        if ReadBytes::read(self, &mut byte) == 1 { Arrival::Byte(byte[0]) } else { Arrival::Closed }
    }
}

/// A line whose other end is a function.
struct Heard<F> {
    listener: F,
    failed: Option<anyhow::Error>,
}

impl<F: FnMut(&[u8]) -> Result<()>> Link for Heard<F> {
    fn send(&mut self, frame: &[u8]) -> bool {
        if self.failed.is_none() {
            self.failed = (self.listener)(frame).err();
        }
        self.failed.is_none()
    }
    fn receive(&mut self) -> Option<u8> {
        None
    }
}

/// Runs the host's own loop over what `feed` writes (an `.sbraw` stream or the sample line's bytes); `heard` gets the
/// telemetry frame by frame. What the sample line counted comes back.
///
/// # Errors
/// The configuration blob or the stream is not valid, or what `heard` says.
pub fn host(
    blob: &[u8],
    samples: SamplePath,
    feed: impl FnOnce(&mut dyn Write) -> Result<()> + Send,
    heard: impl FnMut(&[u8]) -> Result<()>,
) -> Result<DecoderCounters> {
    let config = config_blob::station(blob).map_err(|e| anyhow!("configuration blob: {e:?}"))?;
    let (near, far) = UnixStream::pair()?;
    std::thread::scope(|scope| {
        let feeder = scope.spawn(move || feed_all(feed, near));
        let bytes = Bytes(BufReader::with_capacity(1 << 16, far));
        let mut link = Heard { listener: heard, failed: None };
        let mut frames: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
        let table = config_blob::section(blob, PROPAGATION).ok();
        // The recorder's memory is large: it is built in place, on the heap.
        let mut memory: Box<Memory<'_>> = Box::default();
        let mut recorder = memory.configure(&config, table).map_err(|e| anyhow!("{}: {e}", config.name))?;
        let counters = match samples {
            SamplePath::File => {
                let mut reader = Reader::new(bytes);
                run(&mut recorder, &mut reader, &mut link, &mut NoClock, &mut NoBoard, &mut frames);
                DecoderCounters::default()
            }
            SamplePath::Uart => {
                let mut reader = sample_line::Reader::new(bytes);
                run(&mut recorder, &mut reader, &mut link, &mut NoClock, &mut NoBoard, &mut frames);
                reader.counters()
            }
        };
        // A sample line is left at its first end; a sender that repeats it is let go.
        joined(feeder)?;
        link.failed.map_or(Ok(counters), Err)
    })
}

/// Both telemetries and what the firmware's run cost.
#[derive(Debug, Clone)]
pub struct Twins {
    /// The host's bytes.
    pub host: Vec<u8>,
    /// The firmware's bytes.
    pub firmware: Vec<u8>,
    /// What the firmware left behind.
    pub summary: FirmwareSummary,
}

/// For whom a stream is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listener {
    /// The firmware, which may want it at the pace of a converter.
    Firmware,
    /// The host.
    Host,
}

/// Runs both over the same stream, which `feed` writes twice.
///
/// # Errors
/// One of them cannot run, or they counted the sample line differently.
pub fn both(
    emulator: &Emulator,
    blob: &[u8],
    feed: impl Fn(&mut dyn Write, Listener) -> Result<()> + Send + Sync,
) -> Result<Twins> {
    let mut firmware = Vec::new();
    let summary = emulator.run(
        blob,
        |out| feed(out, Listener::Firmware),
        |bytes, _| {
            firmware.extend_from_slice(bytes);
            Ok(())
        },
    )?;
    let mut telemetry = Vec::new();
    let feed = |out: &mut dyn Write| feed(out, Listener::Host);
    let counters = host(blob, emulator.samples, feed, |frame| {
        telemetry.extend_from_slice(frame);
        Ok(())
    })
    .context("the host's run")?;
    let (host, board) = ((counters.damaged, counters.lost), (summary.line_damaged, summary.line_lost));
    if host != board {
        bail!("damaged and lost frames of the sample line: host {host:?}, firmware {board:?}");
    }
    Ok(Twins { host: telemetry, firmware, summary })
}

impl Twins {
    /// Messages of the host, if both sent the same bytes.
    ///
    /// # Errors
    /// Where they first differ, with the messages there.
    pub fn agree(&self, rate_hz: f64) -> Result<Vec<Message>> {
        let (host, firmware) = (frames(&self.host), frames(&self.firmware));
        if self.host == self.firmware {
            return Ok(host.into_iter().filter_map(|f| f.1).collect());
        }
        let byte = self.host.iter().zip(&self.firmware).take_while(|(a, b)| a == b).count();
        let at = host.iter().zip(&firmware).take_while(|(a, b)| a.0 == b.0).count();
        let records = Records { rate_hz, start: None, times: Default::default() };
        let show = |f: Option<&Framed>| match f {
            Some((_, Some(message))) => records.json(message).to_string(),
            Some((bytes, None)) => format!("{} undecodable bytes", bytes.len()),
            None => "nothing (ended)".into(),
        };
        bail!(
            "telemetry differs from byte {byte}, frame {at} (host {} bytes, firmware {} bytes): host says {} | firmware \
             says {} | before it both said {}",
            self.host.len(),
            self.firmware.len(),
            show(host.get(at)),
            show(firmware.get(at)),
            show(at.checked_sub(1).and_then(|i| host.get(i))),
        )
    }
}

/// A frame's bytes and what they say.
type Framed = (Vec<u8>, Option<Message>);

/// The frames of a telemetry stream.
pub fn frames(bytes: &[u8]) -> Vec<Framed> {
    let mut decoder = Decoder::default();
    let mut decode = |frame: &[u8]| frame.iter().filter_map(|b| decoder.push(*b)).last().map(|r| r.message);
    bytes.split_inclusive(|b| *b == 0).map(|f| (f.to_vec(), decode(f))).collect()
}
