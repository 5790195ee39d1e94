//! The hardware board's twin: its image runs on the modelled board, what the converter delivered goes through the host's
//! loop too, and both must say the same.

use crate::twin::frames;
use anyhow::{Context, Result, anyhow, bail};
use seabearing_board_model::ads131m04::{Codes, REGISTER_ACQUISITION};
use seabearing_board_model::core::Work;
use seabearing_board_model::stm32h743::{self, Parameters, Stm32h743, cause};
use seabearing_board_model::time::{PER_SECOND, Ticks};
use seabearing_board_model::{Costs, Counts, Ending, Image, Machine};
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::port::{Chunk, Link, NoClock, SampleSource, Supervisor};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_core::wire::FaultCode;
use std::cell::RefCell;
use std::path::Path;

/// Something that goes wrong while the board runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InjectedFault {
    /// The converter resets itself at this second.
    ConverterReset(f64),
    /// The converter is dead from this second on, for so many seconds.
    ConverterDead(f64, f64),
    /// Every so many bytes one bit is wrong on the way from the converter.
    SpiBits(u64),
    /// The line from the converter is cut at this second, for so many seconds; it goes on converting.
    ConverterMute(f64, f64),
    /// The core is held at this second, for so many seconds; everything else goes on.
    CoreHeld(f64, f64),
    /// The core takes a hard fault at this second.
    HardFault(f64),
    /// The reset pin is pulled at this second.
    PinReset(f64),
    /// The supply sags at this second.
    BrownOut(f64),
}

impl std::str::FromStr for InjectedFault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || {
            format!(
                "`{text}`: converter-reset@S, converter-dead@S or @S:LENGTH, converter-mute@S:LENGTH, core-held@S:LENGTH, hard-fault@S, spi-bits@BYTES, pin-reset@S or brown-out@S"
            )
        };
        let (kind, at) = text.split_once('@').ok_or_else(bad)?;
        let seconds =
            |text: &str| text.parse().ok().filter(|s: &f64| *s >= 0.0 && s.is_finite()).ok_or_else(bad);
        Ok(match kind {
            "converter-reset" => Self::ConverterReset(seconds(at)?),
            "converter-dead" | "converter-mute" | "core-held" => {
                let (at, length) = match at.split_once(':') {
                    Some((at, length)) => (seconds(at)?, seconds(length)?),
                    None => (seconds(at)?, f64::INFINITY),
                };
                match kind {
                    "converter-dead" => Self::ConverterDead(at, length),
                    "converter-mute" => Self::ConverterMute(at, length),
                    _ if length.is_finite() => Self::CoreHeld(at, length),
                    _ => return Err(bad()),
                }
            }
            "hard-fault" => Self::HardFault(seconds(at)?),
            "spi-bits" => Self::SpiBits(at.parse().ok().filter(|n| *n > 0).ok_or_else(bad)?),
            "pin-reset" => Self::PinReset(seconds(at)?),
            "brown-out" => Self::BrownOut(seconds(at)?),
            _ => return Err(bad()),
        })
    }
}

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
        }
    }
}

/// What came of a run.
#[derive(Debug, Clone)]
pub struct BoardRun {
    /// What the board sent.
    pub firmware: Vec<u8>,
    /// What the host's loop said of the same conversions.
    pub host: Vec<u8>,
    /// Conversions done while recording, and those delivered.
    pub converted: u64,
    /// Conversions read whole: their numbers, and what was read.
    pub numbers: Vec<u64>,
    /// Codes of each.
    pub codes: Vec<Codes>,
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
}

impl BoardRun {
    /// Whether board and host said the same.
    pub fn identical(&self) -> bool {
        self.firmware == self.host
    }

    /// What the host says of the conversions outside these stretches of numbers (first, and after the last).
    ///
    /// # Errors
    /// The configuration cannot be run.
    pub fn host_without(&self, blob: &[u8], gaps: &[(u64, u64)]) -> Result<Vec<u8>> {
        let taken = |number: u64| !gaps.iter().any(|(from, to)| (*from..*to).contains(&number));
        let (numbers, codes): (Vec<u64>, Vec<Codes>) =
            self.numbers.iter().zip(&self.codes).filter(|(n, _)| taken(**n)).unzip();
        host(blob, &numbers, &codes)
    }

    /// One line about where they differ.
    pub fn difference(&self) -> String {
        let (host, firmware) = (frames(&self.host), frames(&self.firmware));
        let at = host.iter().zip(&firmware).take_while(|(a, b)| a.0 == b.0).count();
        let show = |f: Option<&(Vec<u8>, _)>| match f {
            Some((_, Some(message))) => format!("{message:?}"),
            Some((bytes, None)) => format!("{} undecodable bytes", bytes.len()),
            None => "nothing".to_owned(),
        };
        format!(
            "telemetry differs from frame {at} (host {} bytes, board {} bytes): host says {} | board says {}",
            self.host.len(),
            self.firmware.len(),
            show(host.get(at)),
            show(firmware.get(at))
        )
    }
}

/// Time after the last conversion in which the board may still work and send.
const DRAIN: Ticks = PER_SECOND / 2;
/// Longest wait for the first conversion.
const PATIENCE: Ticks = 5 * PER_SECOND;
/// Step between two looks at the board.
const STEP: Ticks = PER_SECOND / 2000;

/// Runs an image that holds this configuration over conversions at `rate_hz`, then the host over what was delivered.
///
/// # Errors
/// The image is not the station's, the software did something the board does not allow, or it never read a conversion.
pub fn twin(
    image: &Path,
    blob: &[u8],
    rate_hz: f64,
    setup: &Setup,
    source: impl FnMut() -> Option<Codes> + Send + 'static,
) -> Result<BoardRun> {
    let mut file = std::fs::read(image).with_context(|| {
        format!("no image at {}: run `cargo xtask build-firmware --board stm32h743`", image.display())
    })?;
    let Some(at) = file.windows(blob.len()).position(|window| window == blob) else {
        bail!(
            "{} holds another station's configuration: build it with `cargo xtask build-firmware --board stm32h743 \
             --station STATION.toml`",
            image.display()
        );
    };
    if setup.damaged_configuration {
        file[at + blob.len() / 2] ^= 0x10;
    }
    let image = Image::parse(&file).map_err(|e| anyhow!("{}: {e}", image.display()))?;
    let mut machine = stm32h743::machine(image, setup.costs, &setup.parameters, Box::new(source), rate_hz)
        .map_err(anyhow::Error::msg)?;
    machine.board.converter.acquisition = (setup.acquisition_s * PER_SECOND as f64) as Ticks;
    for (at, bytes) in &setup.commands {
        machine.board.send(ticks(*at), bytes);
    }
    let (began, ended) = run_board(&mut machine, setup)?;
    let converter = &machine.board.converter;
    let host = host(blob, &converter.delivered, &converter.codes)?;
    let span = match (converter.delivered.first(), converter.delivered.last()) {
        (Some(first), Some(last)) => last - first + 1,
        _ => 0,
    };
    let ticks = ended.1 - began.1;
    Ok(BoardRun {
        firmware: machine.board.sent().to_vec(),
        host,
        converted: converter.converted(),
        delivered: converter.delivered.len() as u64,
        numbers: converter.delivered.clone(),
        codes: converter.codes.clone(),
        lost: span - converter.delivered.len() as u64,
        seconds: ticks as f64 / PER_SECOND as f64,
        handlers: ended.0.handlers.since(&began.0.handlers),
        thread: ended.0.thread.since(&began.0.thread),
        interrupts_per_s: (ended.0.interrupts - began.0.interrupts) as f64 * PER_SECOND as f64 / ticks as f64,
        idle: (ended.0.asleep - began.0.asleep) as f64 / ticks as f64,
        resets: ended.0.resets,
        dma_items: machine.board.dma_items,
        spi_hz: machine.board.spi_hz(),
    })
}

type Moment = (Counts, Ticks);

/// A [`InjectedFault`] that has a beginning and an end in the machine's time.
struct Due {
    at: Ticks,
    fault: InjectedFault,
    ends: bool,
}

fn ticks(seconds: f64) -> Ticks {
    // A moment that never comes is far away.
    (seconds.min(1e6) * PER_SECOND as f64) as Ticks
}

/// What happens when, and what is so from the start.
fn schedule(machine: &mut Machine<Stm32h743>, faults: &[InjectedFault]) -> Vec<Due> {
    let mut due = Vec::new();
    for &fault in faults {
        let (at, length) = match fault {
            InjectedFault::SpiBits(every) => {
                machine.board.converter.bit_errors_every = every;
                continue;
            }
            InjectedFault::ConverterDead(at, length) | InjectedFault::ConverterMute(at, length) => {
                (at, length)
            }
            InjectedFault::ConverterReset(at)
            | InjectedFault::CoreHeld(at, _)
            | InjectedFault::HardFault(at)
            | InjectedFault::PinReset(at)
            | InjectedFault::BrownOut(at) => (at, f64::INFINITY),
        };
        due.push(Due { at: ticks(at), fault, ends: false });
        if length.is_finite() {
            due.push(Due { at: ticks(at + length), fault, ends: true });
        }
    }
    due
}

fn inject(machine: &mut Machine<Stm32h743>, due: &Due) -> Result<()> {
    let now = machine.now();
    let converter = &mut machine.board.converter;
    match due.fault {
        InjectedFault::ConverterReset(_) => converter.reset(now),
        InjectedFault::ConverterDead(..) => converter.set_dead(!due.ends, now),
        InjectedFault::ConverterMute(..) => converter.mute = !due.ends,
        InjectedFault::CoreHeld(_, length) => {
            machine.hold(now + ticks(length)).map_err(anyhow::Error::msg)?
        }
        InjectedFault::HardFault(_) => {
            machine.nvic.pend(seabearing_board_model::core::nvic::number::HARD_FAULT)
        }
        InjectedFault::PinReset(_) => machine.reset(|board| board.reset(cause::PIN)),
        InjectedFault::BrownOut(_) => machine.reset(|board| board.reset(cause::BROWN_OUT)),
        InjectedFault::SpiBits(_) => {}
    }
    Ok(())
}

/// Runs to the end of the conversions, or for a while; the costs at the first and the last delivered.
fn run_board(machine: &mut Machine<Stm32h743>, setup: &Setup) -> Result<(Moment, Moment)> {
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
        let counts = machine.counts();
        if !machine.board.converter.delivered.is_empty() {
            began.get_or_insert((counts, now));
        } else if now > PATIENCE && setup.most_s.is_none() {
            bail!("the board has read no conversion within {} s", PATIENCE / PER_SECOND);
        }
        if machine.board.converter.exhausted() {
            let (_, end) = *ended.get_or_insert((counts, now));
            if now > end + DRAIN {
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

/// What a run of the host has sent, and how much of it before the input's end.
#[derive(Default)]
struct Heard {
    bytes: Vec<u8>,
    at_end: Option<usize>,
}

struct Telemetry<'a>(&'a RefCell<Heard>);

impl Link for Telemetry<'_> {
    fn send(&mut self, frame: &[u8]) -> bool {
        self.0.borrow_mut().bytes.extend_from_slice(frame);
        true
    }
    fn receive(&mut self) -> Option<u8> {
        None
    }
}

/// Conversions with their numbers, from the first on.
struct Delivered<'a> {
    numbers: &'a [u64],
    codes: &'a [Codes],
    next: usize,
    heard: &'a RefCell<Heard>,
}

impl SampleSource for Delivered<'_> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let Some(first) = self.numbers.get(self.next) else {
            let mut heard = self.heard.borrow_mut();
            heard.at_end = Some(heard.bytes.len());
            return Chunk::End;
        };
        let mut count = 0;
        for slot in frames.iter_mut() {
            let at = self.next + count;
            if self.numbers.get(at) != Some(&(first + count as u64)) {
                break;
            }
            *slot = self.codes[at];
            count += 1;
        }
        self.next += count;
        Chunk::Frames { first_index: *first, count }
    }
}

struct PowerOn;

impl Supervisor for PowerOn {
    fn feed(&mut self) {}
    fn idle(&mut self) {}
    fn reset_cause(&self) -> u8 {
        0
    }
    fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
        None
    }
}

/// What the host's loop says of these conversions, without what it would say at an end: a board has none.
fn host(blob: &[u8], numbers: &[u64], codes: &[Codes]) -> Result<Vec<u8>> {
    let config = config_blob::station(blob).map_err(|e| anyhow!("configuration blob: {e:?}"))?;
    let table = config_blob::section(blob, PROPAGATION).ok();
    let mut memory: Box<Memory<'_>> = Box::default();
    let mut recorder = memory.configure(&config, table).map_err(|e| anyhow!("{}: {e}", config.name))?;
    let heard = RefCell::new(Heard::default());
    let mut source = Delivered { numbers, codes, next: 0, heard: &heard };
    let mut frames: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    run(&mut recorder, &mut source, &mut Telemetry(&heard), &mut NoClock, &mut PowerOn, &mut frames);
    let Heard { mut bytes, at_end } = heard.into_inner();
    bytes.truncate(at_end.unwrap_or(0));
    Ok(bytes)
}

/// A frame of a recording as a converter of 24 bits gives it; a missing sample is zero.
pub fn codes(frame: &Frame) -> Codes {
    frame.map(|code| if code == MISSING { 0 } else { code.clamp(-(1 << 23), (1 << 23) - 1) })
}
