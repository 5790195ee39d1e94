//! The hardware board's twin: its image runs on the modelled board, what the converter delivered goes through the host's
//! loop too, and both must say the same.

mod base;
mod card;
mod host;
mod injection;
mod satellites;
mod seismic;

pub use card::{Sound, blank, sound};
pub use host::host;
pub(crate) use injection::mix;
pub use injection::{Has, InjectedFault, PANIC_LINE};
pub use satellites::utc_us;
pub use seismic::{BAUD as SEISMIC_BAUD, conversion, heard};

use crate::twin::frames;
use anyhow::{Context, Result, anyhow, bail};
use base::Base;
use injection::{Sent, inject, schedule, to_the_board};
use seabearing_board_model::ads131m04::{Codes, REGISTER_ACQUISITION, Source};
use seabearing_board_model::core::Work;
use seabearing_board_model::stm32h743::{self, Parameters, Stm32h743};
use seabearing_board_model::time::{NEVER, PER_SECOND, Ticks};
use seabearing_board_model::{Costs, Counts, Ending, Image, Machine};
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::wire::{Decoder, Margins, Message};
use seabearing_firmware::seismic::Conversion;
use seabearing_host::card::blank::Blank;
use seabearing_host::card::simulated::Sectors;
use std::path::Path;

/// How the board runs.
#[derive(Debug, Clone)]
pub struct Setup {
    /// What instructions and accesses cost.
    pub costs: Costs,
    /// The board's own.
    pub parameters: Parameters,
    /// Seconds from a converter's reset to its answers.
    pub acquisition_s: f64,
    /// What goes wrong.
    pub faults: Vec<InjectedFault>,
    /// The run ends at this second at the latest, whether conversions were read or not.
    pub most_s: Option<f64>,
    /// Commands sent to the board: when each begins, s.
    pub commands: Vec<(f64, Vec<u8>)>,
    /// A bit of the configuration is wrong in the image's flash.
    pub damaged_configuration: bool,
    /// A satellite receiver is there for so many seconds.
    pub receiver_s: f64,
    /// The image's records wait until a base station has them, which is at the other end of the line.
    pub link: bool,
    /// What card is in the holder.
    pub card: Option<Blank>,
    /// What the second bank of flash holds at the first start, from its beginning; the rest is erased. With it the image need not
    /// be the station's.
    pub bank_two: Vec<u8>,
    /// Words of it in which too many bits are wrong, by their number.
    pub unreadable: Vec<usize>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            costs: Costs::IDEAL,
            parameters: Parameters::default(),
            acquisition_s: REGISTER_ACQUISITION as f64 / PER_SECOND as f64,
            faults: Vec::new(),
            most_s: None,
            commands: Vec::new(),
            damaged_configuration: false,
            receiver_s: 0.0,
            link: false,
            card: None,
            bank_two: Vec::new(),
            unreadable: Vec::new(),
        }
    }
}

/// A message that the board sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Said {
    /// When it had left or, of a record, had come, s.
    pub at_s: f64,
    /// The number of its frame; of a record 0 where a session begins.
    pub sequence: u16,
    /// Of a record the boot in which it was written; of a frame 0.
    pub boot: u32,
    /// What it says.
    pub message: Message,
}

/// What came of a run.
#[derive(Debug, Clone)]
pub struct BoardRun {
    /// What the board sent.
    pub firmware: Vec<u8>,
    /// The same frame by frame; of records those that came, in their order.
    pub said: Vec<Said>,
    /// The image's records wait until a base station has them.
    pub linked: bool,
    /// How samples are made of the conversions, on the ocean-bottom board.
    pub seismic: Option<Conversion>,
    /// Records that did not come once and in order.
    pub missing: u32,
    /// Flash words programmed, sectors erased.
    pub flash: (u32, u32),
    /// Starts of the core: when, s, and conversions delivered before.
    pub starts: Vec<(f64, usize)>,
    /// Conversions done while recording, and those delivered.
    pub converted: u64,
    /// Conversions read whole: their numbers, and what was read.
    pub numbers: Vec<u64>,
    /// Codes of each.
    pub codes: Vec<Codes>,
    /// When the conversion of each number was done, s of the truth; infinite for those the converter left out.
    pub moments_s: Vec<f64>,
    /// How many.
    pub delivered: u64,
    /// Conversions between the first and the last delivered that were not.
    pub lost: u64,
    /// Seconds from the first conversion delivered to the last.
    pub seconds: f64,
    /// Work in interrupts and in the thread over that time.
    pub handlers: Work,
    /// Work outside of interrupts.
    pub thread: Work,
    /// Interrupts a second.
    pub interrupts_per_s: f64,
    /// Share of the time the core slept.
    pub idle: f64,
    /// Times the core was reset.
    pub resets: u32,
    /// Items moved by DMA, over the whole run.
    pub dma_items: u64,
    /// Frequency of the converter's bus.
    pub spi_hz: u64,
    /// The card afterwards, where there was one.
    pub card: Option<Sectors>,
    /// Bytes of stack there are, and the most that was used since the last start.
    pub stack: (u32, u32),
}

impl BoardRun {
    /// What the board said of itself.
    pub fn margins(&self) -> impl DoubleEndedIterator<Item = &Margins> {
        self.said.iter().filter_map(|said| match &said.message {
            Message::Margins(margins) => Some(margins),
            _ => None,
        })
    }

    /// The host's loop over the same conversions: `None` if it says the same bytes, else one line about where they differ.
    ///
    /// # Errors
    /// The configuration cannot be run.
    pub fn difference(&self, blob: &[u8]) -> Result<Option<String>> {
        const POWER: u8 = 0;
        let margins: Vec<Margins> = self.margins().copied().collect();
        let said =
            host(blob, self.seismic, (POWER, &margins), &self.numbers, &self.codes, false, &mut |_| true)?;
        if self.linked {
            return Ok(self.differing_record(&frames(&said)));
        }
        if said == self.firmware {
            return Ok(None);
        }
        let (host, firmware) = (frames(&said), frames(&self.firmware));
        let at = host.iter().zip(&firmware).take_while(|(a, b)| a.0 == b.0).count();
        let show = |f: Option<&(Vec<u8>, _)>| match f {
            Some((_, Some(message))) => format!("{message:?}"),
            Some((bytes, None)) => format!("{} undecodable bytes", bytes.len()),
            None => "nothing".to_owned(),
        };
        Ok(Some(format!(
            "telemetry differs from frame {at} (host {} bytes, board {} bytes): host says {} | board says {}",
            said.len(),
            self.firmware.len(),
            show(host.get(at)),
            show(firmware.get(at))
        )))
    }
}

impl BoardRun {
    /// One line about the first record that is not the host's message, or about what did not come.
    fn differing_record(&self, host: &[(Vec<u8>, Option<Message>)]) -> Option<String> {
        let host: Vec<Message> = host.iter().filter_map(|(_, message)| *message).collect();
        let board: Vec<Message> = self.said.iter().map(|said| said.message).collect();
        if self.missing > 0 {
            return Some(format!("{} records are missing at the base station", self.missing));
        }
        if host == board {
            return None;
        }
        let at = host.iter().zip(&board).take_while(|(a, b)| a == b).count();
        let show = |m: Option<&Message>| m.map_or("nothing".to_owned(), |m| format!("{m:?}"));
        Some(format!(
            "records differ from {at} (host {}, board {}): host says {} | board says {}",
            host.len(),
            board.len(),
            show(host.get(at)),
            show(board.get(at))
        ))
    }
}

/// Time after the last conversion in which the board may still work and send.
const DRAIN: Ticks = PER_SECOND / 2;
/// The same where it takes that long to see that no more come.
const SLOW_DRAIN: Ticks = PER_SECOND;
/// Longest wait for the first conversion.
const PATIENCE: Ticks = 5 * PER_SECOND;
/// Step between two looks at the board.
const STEP: Ticks = PER_SECOND / 2000;

/// Runs an image that holds this configuration over conversions at `rate_hz`; on the ocean-bottom board (as the parameters say)
/// over samples at that rate, of which the converters hear more.
///
/// # Errors
/// The image is not the station's, the software did something the board does not allow, or it never read a conversion.
pub fn play(
    image: &Path,
    blob: &[u8],
    rate_hz: f64,
    setup: &Setup,
    source: impl FnMut() -> Option<Codes> + Send + 'static,
) -> Result<BoardRun> {
    let mut file = std::fs::read(image).with_context(|| {
        format!("no image at {}: run `cargo xtask build-firmware --board stm32h743`", image.display())
    })?;
    let found = file.windows(blob.len()).position(|window| window == blob);
    if found.is_none() && setup.bank_two.is_empty() {
        bail!(
            "{} holds another station's configuration: build it with `cargo xtask build-firmware --board stm32h743 \
             --station STATION.toml`",
            image.display()
        );
    }
    if let Some(at) = found.filter(|_| setup.damaged_configuration) {
        file[at + blob.len() / 2] ^= 0x10;
    }
    let image = Image::parse(&file).map_err(|e| anyhow!("{}: {e}", image.display()))?;
    let stack =
        image.symbol("_stack_end").zip(image.symbol("_stack_start")).context("no stack in the image")?;
    let conversion = match setup.parameters.seismic {
        true => Some(conversion(blob).context("the ocean-bottom board has no such rate")?),
        false => None,
    };
    let (source, rate_hz): (Source, f64) = match conversion {
        Some(conversion) => (heard(conversion, source), f64::from(conversion.rate.hz())),
        None => (Box::new(source), rate_hz),
    };
    let mut machine = stm32h743::machine(image, setup.costs, &setup.parameters, source, rate_hz)
        .map_err(anyhow::Error::msg)?;
    if !machine.board.flash.probe(&setup.bank_two) {
        bail!("the second bank of flash has 1 MiB, which is less than what is to be in it");
    }
    for word in &setup.unreadable {
        machine.board.flash.upset(*word, 2);
    }
    machine.board.card = card::insert(setup.card.as_ref())?;
    machine.board.converter.acquisition = (setup.acquisition_s * PER_SECOND as f64) as Ticks;
    let mut to_come = to_the_board(&setup.commands, &setup.faults, setup.parameters.baud);
    if !setup.link {
        for (at, bytes) in to_come.drain(..) {
            machine.board.disturb(at, bytes);
        }
    }
    let board_clock_error = setup.parameters.board_clock_error;
    satellites::fill(&mut machine, &setup.faults, board_clock_error, setup.receiver_s);
    let mut starts = vec![(0.0, 0)];
    let mut base = setup.link.then(|| Base::new(setup.parameters.baud));
    let (began, ended) = run_board(&mut machine, setup, to_come, &mut starts, base.as_mut())?;
    let (said, missing) = match &base {
        Some(base) => base.said()?,
        None => (said(&machine.board), 0),
    };
    let converter = machine.board.conversions();
    let span = match (converter.delivered.first(), converter.delivered.last()) {
        (Some(first), Some(last)) => last - first + 1,
        _ => 0,
    };
    let ticks = ended.1 - began.1;
    Ok(BoardRun {
        firmware: machine.board.sent().to_vec(),
        said,
        linked: setup.link,
        missing,
        flash: (machine.board.flash.operations - machine.board.flash.erased, machine.board.flash.erased),
        starts,
        seismic: conversion,
        converted: converter.done,
        delivered: converter.delivered.len() as u64,
        numbers: converter.delivered.to_vec(),
        codes: converter.codes.to_vec(),
        moments_s: converter.moments.iter().map(|at| truth_s(*at, board_clock_error)).collect(),
        lost: span - converter.delivered.len() as u64,
        seconds: ticks as f64 / PER_SECOND as f64,
        handlers: ended.0.handlers.since(&began.0.handlers),
        thread: ended.0.thread.since(&began.0.thread),
        interrupts_per_s: (ended.0.interrupts - began.0.interrupts) as f64 * PER_SECOND as f64 / ticks as f64,
        idle: (ended.0.asleep - began.0.asleep) as f64 / ticks as f64,
        resets: ended.0.resets,
        dma_items: machine.board.dma_items,
        spi_hz: machine.board.spi_hz(),
        card: setup.card.map(|_| Sectors(machine.board.card.sectors().clone())),
        stack: stack_use(&machine, stack),
    })
}

/// Bytes from the far end of the stack to its start, and how many of them were used: start-up code paints the stack, use
/// wipes the paint off.
fn stack_use(machine: &Machine<Stm32h743>, (end, start): (u32, u32)) -> (u32, u32) {
    const PAINT: [u8; 4] = [0xcc; 4];
    let size = start.saturating_sub(end);
    let words = machine.memory.bytes(end, size).unwrap_or_default().as_chunks().0;
    let painted = words.iter().take_while(|word| **word == PAINT).count() as u32;
    (size, size - 4 * painted)
}

/// The frames among what the board has sent.
fn said(board: &Stm32h743) -> Vec<Said> {
    let mut decoder = Decoder::default();
    let bytes = board.sent().iter().zip(board.sent_at());
    bytes
        .filter_map(|(byte, at)| {
            let received = decoder.push(*byte)?;
            let at_s = seconds(*at);
            Some(Said { at_s, sequence: received.sequence, boot: 0, message: received.message })
        })
        .collect()
}

type Moment = (Counts, Ticks);

/// A moment of the board's time in seconds of the truth.
fn truth_s(at: Ticks, board_clock_error: f64) -> f64 {
    if at == NEVER { f64::INFINITY } else { seconds(at) / (1.0 + board_clock_error) }
}

fn seconds(ticks: Ticks) -> f64 {
    ticks as f64 / PER_SECOND as f64
}

fn ticks(seconds: f64) -> Ticks {
    // A moment that never comes is far away.
    (seconds.min(1e6) * PER_SECOND as f64) as Ticks
}

/// Runs to the end of the conversions, or for a while; the costs at the first and the last delivered. Every reset is noted.
fn run_board(
    machine: &mut Machine<Stm32h743>,
    setup: &Setup,
    mut to_come: Vec<Sent>,
    starts: &mut Vec<(f64, usize)>,
    mut base: Option<&mut Base>,
) -> Result<(Moment, Moment)> {
    let mut pending = schedule(machine, &setup.faults);
    let (mut began, mut ended): (Option<Moment>, Option<Moment>) = (None, None);
    let mut until = 0;
    loop {
        until += STEP;
        match machine.run(until).map_err(anyhow::Error::msg)? {
            Ending::Time => {}
            Ending::Exit(status) => bail!("the image left with status {status}"),
        }
        let now = machine.now();
        until = until.max(now);
        for due in pending.extract_if(.., |due| due.at <= now) {
            inject(machine, &due)?;
        }
        // Between what the base station says.
        for (_, bytes) in to_come.extract_if(.., |sent| sent.0 <= now) {
            machine.board.disturb(now, bytes);
        }
        if let Some(base) = &mut base {
            base.look(machine);
        }
        let counts = machine.counts();
        if counts.resets as usize >= starts.len() {
            starts.push((seconds(now), machine.board.conversions().delivered.len()));
        }
        if !machine.board.conversions().delivered.is_empty() {
            began.get_or_insert((counts, now));
        } else if now > PATIENCE && setup.most_s.is_none() {
            bail!("the board has read no conversion within {} s", PATIENCE / PER_SECOND);
        }
        if machine.board.conversions().exhausted {
            let (_, end) = *ended.get_or_insert((counts, now));
            if now > end + if setup.parameters.seismic { SLOW_DRAIN } else { DRAIN } {
                break;
            }
        }
        if setup.most_s.is_some_and(|most| now > ticks(most)) {
            ended.get_or_insert((counts, now));
            break;
        }
    }
    let ended = ended.context("the conversions did not end")?;
    Ok((began.unwrap_or((Counts::default(), 0)), ended))
}

/// A frame of a recording as a converter of 24 bits gives it; a missing sample is zero.
pub fn codes(frame: &Frame) -> Codes {
    frame.map(|code| if code == MISSING { 0 } else { code.clamp(-(1 << 23), (1 << 23) - 1) })
}
