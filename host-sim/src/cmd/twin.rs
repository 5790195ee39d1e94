//! `seabearing twin`: run the firmware in an emulator and the host over the same input and compare their telemetry.

use super::mistake;
use crate::emulator::{self, Emulator, SamplePath};
use crate::plan::telemetry::Tally;
use crate::progress;
use crate::recording::Container;
use crate::sample_line::{SendTiming, Sender};
use crate::station::Station;
use crate::twin::Listener;
use crate::{blob, recording, twin};
use anyhow::{Context, Result, bail};
use seabearing_core::block::Block;
use seabearing_core::config::Kind;
use seabearing_core::sbraw;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `seabearing twin`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  cargo xtask build-firmware\n  \
    seabearing twin --station out/station.toml out/east.wav\n  \
    seabearing twin --station out/station.toml --samples uart --speed 1 out/*.mseed   # as a converter would\n  \
    cargo xtask build-firmware --board stm32h743 --station out/station.toml\n  \
    seabearing twin --board stm32h743 --station out/station.toml --seconds 3 --cycles 2.5 --register-cycles 30 \
    out/east.wav\n\n\
    RECORDING is what `process` takes, or one .sbraw stream (docs/firmware.md).")]
pub struct Args {
    /// Station file
    #[arg(long, value_name = "STATION.toml", value_parser = super::input())]
    station: PathBuf,
    /// Board: mps2-an500 in QEMU, or stm32h743, the image for hardware on the modelled board (docs/board-model.md)
    #[arg(long, value_enum, default_value = "mps2-an500")]
    board: Board,
    /// What runs the mps2-an500: QEMU, or the interpreter that is part of this program
    #[arg(long, value_enum, default_value = "qemu")]
    emulator: Engine,
    /// Firmware image [default: target/firmware/images/BOARD.elf of the checkout]
    #[arg(long, value_name = "ELF")]
    firmware: Option<PathBuf>,
    /// Count instructions (slower; the cost is printed)
    #[arg(long)]
    count_instructions: bool,
    /// How samples reach the firmware: by semihosting, or over a second serial line (ocean-bottom stations)
    #[arg(long, value_enum, default_value = "file")]
    samples: Samples,
    /// With --samples uart: so many times real time (1: real time) [default: as fast as the line takes them]
    #[arg(long, value_name = "FACTOR")]
    speed: Option<f64>,
    /// Keep the firmware's telemetry in this file
    #[arg(long, value_name = "FILE", value_parser = super::output())]
    keep: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    board_options: super::twin_board::BoardOptions,
    /// Recordings
    #[arg(required_unless_present = "rehearse", value_name = "RECORDING", value_parser = super::input())]
    input: Vec<PathBuf>,
}

/// What runs the mps2-an500.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Engine {
    /// qemu-system-arm
    Qemu,
    /// The interpreter of the board model
    Model,
}

/// Boards there are.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Board {
    /// ARM MPS2+ in QEMU
    #[value(name = "mps2-an500")]
    Mps2An500,
    /// STM32H743 with its converter, modelled
    #[value(name = "stm32h743")]
    Stm32h743,
}

/// How samples reach the firmware.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Samples {
    /// An .sbraw stream by semihosting
    File,
    /// Frames on UART1, at most about 10 kB/s
    Uart,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    let station = Station::of_recorder(&args.station)?;
    if args.board == Board::Stm32h743 {
        let keep = args.keep.as_deref();
        return super::twin_board::run(
            &args.board_options,
            &station,
            args.firmware,
            args.input,
            keep,
            args.json,
        );
    }
    let (samples, pace) = match (args.samples, args.speed) {
        (Samples::File, None) => (SamplePath::File, SendTiming::Free),
        (Samples::File, Some(_)) => mistake!("--speed goes with --samples uart"),
        (Samples::Uart, _) if !matches!(station.config.kind, Kind::Obs(_)) => {
            mistake!("--samples uart is for ocean-bottom stations: the line carries no array's samples")
        }
        (Samples::Uart, None) => (SamplePath::Uart, SendTiming::Free),
        (Samples::Uart, Some(x)) if x > 0.0 && x.is_finite() => (SamplePath::Uart, SendTiming::Times(x)),
        (Samples::Uart, Some(x)) => mistake!("--speed is {x}; a positive number is needed"),
    };
    let raw = matches!(&args.input[..], [one] if is_raw(one));
    if raw && samples == SamplePath::Uart {
        bail!("{}: --samples uart takes recordings, not an .sbraw stream", args.input[0].display());
    }
    let firmware = emulator::firmware(args.firmware)?;
    let engine = match args.emulator {
        Engine::Qemu => emulator::Engine::Qemu,
        Engine::Model => emulator::Engine::Model,
    };
    let emulator = Emulator { firmware, count_instructions: args.count_instructions, samples, engine };
    let blob = blob::of(&station)?;
    let feed = |out: &mut dyn Write, listener| match (&args.input[..], samples) {
        ([path], SamplePath::File) if raw => copy(path, out),
        (paths, SamplePath::File) => {
            out.write_all(&sbraw::MAGIC)?;
            each_block(paths, &station, |block| Ok(twin::write_block(out, block)?))
        }
        (paths, SamplePath::Uart) => {
            let pace = if listener == Listener::Firmware { pace } else { SendTiming::Free };
            let mut sender = Sender::new(out, station.config.rate_hz, pace);
            each_block(paths, &station, |block| sender.block(block))?;
            sender.end()
        }
    };
    // Complaints about the input are heard before QEMU starts.
    if !raw {
        recording::open(&args.input, &station, None)?;
    }
    let twins = twin::both(&emulator, &blob, feed)?;
    if let Some(path) = &args.keep {
        crate::atomic::write(path, &twins.firmware)?;
    }
    let messages = twins.agree(station.config.rate_hz)?;
    let seconds = twins.summary.instants as f64 / station.config.rate_hz;
    let counted = |ticks: u64| {
        let million = ticks as f64 * emulator::INSTRUCTIONS_PER_TICK as f64 / 1e6;
        args.count_instructions.then_some(million)
    };
    let work = counted(twins.summary.busy_ticks).map(|all| all / seconds.max(1e-9));
    let worst = counted(twins.summary.worst_block_ticks);
    let tally = Tally::of(&messages);
    let mut out = std::io::stdout().lock();
    if args.json {
        let record = serde_json::json!({
            "type": "twin", "identical": true, "bytes": twins.host.len(), "messages": messages.len(), "seconds": seconds,
            "million_instructions_per_s": work, "worst_block_million_instructions": worst,
            "stack_bytes": twins.summary.stack_used,
            "bearings": tally.bearings, "bearing_bytes": tally.bearing_bytes, "other_bytes": tally.other_bytes,
            "line_damaged": twins.summary.line_damaged, "line_lost": twins.summary.line_lost,
        });
        writeln!(out, "{record}")?;
    } else {
        let (bytes, count) = (twins.host.len(), messages.len());
        writeln!(out, "identical: {bytes} bytes, {count} messages over {seconds:.1} s of samples")?;
        if let (Some(work), Some(worst)) = (work, worst) {
            writeln!(
                out,
                "work: {work:.2} million instructions per second of samples, {worst:.2} million at most after one block"
            )?;
        }
    }
    Ok(())
}

/// A ready stream goes as it is.
fn copy(path: &Path, out: &mut dyn Write) -> Result<()> {
    let name = || format!("cannot read {}", path.display());
    let mut file = std::fs::File::open(path).with_context(name)?;
    let mut magic = [0u8; sbraw::MAGIC.len()];
    let read = std::io::Read::read(&mut file, &mut magic).with_context(name)?;
    if read != magic.len() || magic != sbraw::MAGIC {
        anyhow::bail!("{}: not an .sbraw stream (docs/firmware.md)", path.display());
    }
    out.write_all(&magic)?;
    std::io::copy(&mut file, out)?;
    Ok(())
}

/// Whether it is an .sbraw stream. One that comes through a pipe is known by its name: its first bytes can be read once.
fn is_raw(path: &Path) -> bool {
    match path.is_file() {
        true => Container::of(path).is_ok_and(|container| container == Some(Container::Raw)),
        false => path.extension().is_some_and(|e| e == "sbraw"),
    }
}

/// The blocks of recordings, with a progress bar.
fn each_block(
    paths: &[PathBuf],
    station: &Station,
    mut send: impl FnMut(Block<'_>) -> Result<()>,
) -> Result<()> {
    let mut source = recording::open(paths, station, None)?;
    let bar = progress::bar(source.expected_end().unwrap_or(0), "samples");
    while let Some(block) = source.next_block()? {
        bar.set_position(block.first_index + block.frames.len() as u64);
        send(block)?;
    }
    bar.finish_and_clear();
    Ok(())
}
