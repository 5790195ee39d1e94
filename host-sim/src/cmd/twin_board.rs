//! `seabearing twin --board stm32h743`: the hardware board's image on the modelled board, and the host.

use crate::board::{self, BoardRun, Has, InjectedFault, Setup, Sound};
use crate::rehearsal::{self, Length, OceanBottom, Row, Stage};
use crate::station::Station;
use crate::{blob, emulator, recording};
use anyhow::{Context, Result, bail};
use seabearing_board_model::Costs;
use seabearing_board_model::stm32h743::Parameters;
use seabearing_core::block::Frame;
use seabearing_core::config::Kind;
use seabearing_host::record::Margins;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc;

/// With --board stm32h743: what takes how long, and what goes wrong.
#[derive(clap::Args)]
#[command(next_help_heading = "With --board stm32h743")]
pub struct BoardOptions {
    /// Seconds of the recording [default: all]
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Cycles an instruction
    #[arg(long, value_name = "CYCLES", default_value_t = 1.0)]
    cycles: f64,
    /// Cycles more for an access to a peripheral's register
    #[arg(long, value_name = "CYCLES", default_value_t = 0.0)]
    register_cycles: f64,
    /// Cycles more for a load or store of tightly coupled memory
    #[arg(long, value_name = "CYCLES", default_value_t = 0.0)]
    tcm_cycles: f64,
    /// Cycles more for a load or store of other RAM
    #[arg(long, value_name = "CYCLES", default_value_t = 0.0)]
    axi_cycles: f64,
    /// Cycles more for a load of flash
    #[arg(long, value_name = "CYCLES", default_value_t = 0.0)]
    flash_cycles: f64,
    /// Cycles to enter an interrupt
    #[arg(long, value_name = "CYCLES", default_value_t = 12.0)]
    interrupt_cycles: f64,
    /// Error of the board's clock
    #[arg(long, value_name = "PPM", default_value_t = 0.0, allow_negative_numbers = true)]
    board_clock_ppm: f64,
    /// Error of the converter's clock
    #[arg(long, value_name = "PPM", default_value_t = 0.0, allow_negative_numbers = true)]
    converter_clock_ppm: f64,
    /// Microseconds from a converter's reset until it answers
    #[arg(long, value_name = "US", default_value_t = 5.0)]
    converter_start_us: f64,
    /// What goes wrong and when (s): converter-reset@S, converter-upset@S, converter-dead@S or @S:LENGTH,
    /// converter-gain@S, converter-mute@S:LENGTH, core-held@S:LENGTH, supply-low@S:LENGTH, line-noise@S:LENGTH, hard-fault@S,
    /// panic@S, settings-bit@S:N, memory-bit@S:N, memory-bits@S:N, clocks-fail@S:LENGTH, pin-reset@S, brown-out@S,
    /// flash-cut@WORK, flash-bits@S, flash-crash@S, card-stall@S:LENGTH, card-pulled@S or @S:LENGTH, card-errors@S:LENGTH,
    /// card-cut@SECTOR, spi-bits@BYTES; of the ocean-bottom board's chips N, 0 to 3, chipN-dead@S or @S:LENGTH,
    /// chipN-reset@S, chipN-upset@S
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<InjectedFault>,
    /// The image whose records wait in flash until a base station has them, and one at the other end of the line; always so
    /// with an ocean-bottom station
    #[arg(long)]
    link: bool,
    /// The image that records on a card too (its records wait as with --link), and a prepared card of 20 files of 4 MiB
    #[arg(long)]
    card: bool,
    /// What a probe wrote into the second bank of flash before the first start, as of `blob --places`: the image may then hold
    /// another station's configuration; with --link or --card, and with an ocean-bottom station
    #[arg(long, value_name = "FILE", value_parser = super::input())]
    places: Option<PathBuf>,
    /// Play every way of going wrong with noise instead of a recording, outages of up to so many seconds (60 are asked
    /// for, and take minutes), and print the table of what came of it; with --card what a card can do
    #[arg(long, value_name = "S")]
    pub(super) rehearse: Option<f64>,
}

/// Longer than a recording, s: what goes wrong is told within 10.
const PATIENCE_S: f64 = 15.0;

/// Least of a recording for the images whose records wait in flash, s: a first start erases two sectors of 2 s before the first leaves.
const LEAST_LINK_S: f64 = 4.5;

/// Outages rehearsed, s.
const OUTAGES_S: [f64; 6] = [0.001, 0.01, 0.1, 1.0, 10.0, 60.0];

/// Prints the table of the rehearsal; conversions lost are counted over `pace_s`.
fn rehearse(
    image: &Path,
    station: &Station,
    card: bool,
    (longest_s, pace_s): (f64, Option<f64>),
    json: bool,
) -> Result<()> {
    let blob = blob::of(station)?;
    let outages_s = OUTAGES_S.into_iter().filter(|s| *s <= longest_s).collect();
    let mut say = |row: &Row| {
        let line = if json {
            let (case, told, outcome) = (&row.case, &row.told, &row.outcome);
            serde_json::json!({
                "type": "rehearsal", "case": case, "told": told, "outcome": outcome, "right": row.right,
            })
            .to_string()
        } else {
            row.to_string()
        };
        // A person who has gone is no reason to stop.
        _ = writeln!(std::io::stdout(), "{line}");
    };
    if matches!(station.config.kind, Kind::Obs(_)) {
        let stage = Stage { image, link_image: image, blob: &blob, rate_hz: station.config.rate_hz };
        let cuts = if longest_s < 10.0 { 6 } else { 32 };
        let length = OceanBottom { pace_s: pace_s.unwrap_or(300.0), outages_s, short: false, cuts };
        return rehearsal::verdict(&stage.rehearse_ocean_bottom(&length, say)?);
    }
    if card {
        let stage = Stage { image, link_image: image, blob: &blob, rate_hz: station.config.rate_hz };
        let cuts = if longest_s < 10.0 { 6 } else { 32 };
        return rehearsal::verdict(&stage.rehearse_card(cuts, &mut say)?);
    }
    let link_image = image.with_file_name("stm32h743-link.elf");
    if !link_image.is_file() {
        bail!(
            "no image at {}: run `cargo xtask build-firmware --board stm32h743-link`, with --station where it is another's",
            link_image.display()
        );
    }
    let stage = Stage { image, link_image: &link_image, blob: &blob, rate_hz: station.config.rate_hz };
    let length = Length {
        pace_s: pace_s.unwrap_or(5.0),
        costs: rehearsal::COSTS.to_vec(),
        outages_s,
        cuts: (longest_s < 10.0).then_some(6),
    };
    let rows = stage.rehearse(&length, &mut say)?;
    rehearsal::verdict(&rows)
}

/// Runs the command for that board. `keep`: where the firmware's telemetry goes.
///
/// # Errors
/// One line for a person; also where telemetry differs.
pub(super) fn run(
    options: &BoardOptions,
    station: &Station,
    firmware: Option<PathBuf>,
    input: Vec<PathBuf>,
    keep: Option<&Path>,
    json: bool,
) -> Result<()> {
    let seismic = matches!(station.config.kind, Kind::Obs(_));
    let (name, build) = match (seismic, options.link) {
        (true, _) if options.card => bail!("--card: the ocean-bottom board's image records no sound"),
        (false, _) if options.card => {
            ("stm32h743-card.elf", "cargo xtask build-firmware --board stm32h743-card")
        }
        (true, _) => ("stm32h743-obs.elf", "cargo xtask build-firmware --board stm32h743-obs"),
        (false, true) => ("stm32h743-link.elf", "cargo xtask build-firmware --board stm32h743-link"),
        (false, false) => ("stm32h743.elf", "cargo xtask build-firmware --board stm32h743"),
    };
    let image = emulator::image(firmware, name, build)?;
    let rate_hz = station.config.rate_hz;
    for (option, value) in [("--seconds", options.seconds), ("--rehearse", options.rehearse)] {
        if let Some(value) = value.filter(|s| !(s.is_finite() && *s > 0.0)) {
            bail!("{option} {value}: more than 0 was expected");
        }
    }
    let has = Has { seismic, link: seismic || options.link || options.card, card: options.card };
    if let Some(fault) = options.faults.iter().find(|fault| !fault.can_happen(&has)) {
        bail!(
            "--fault {fault:?}: nothing in this run can have it; see --card, --link and the station's kind"
        );
    }
    if let Some(longest_s) = options.rehearse {
        if !options.faults.is_empty() || !input.is_empty() || options.places.is_some() {
            bail!("--rehearse plays faults and noise of its own: leave out --fault, --places and recordings");
        }
        return rehearse(&image, station, options.card, (longest_s, options.seconds), json);
    }
    let mut setup = setup(options)?;
    if seismic {
        (setup.parameters.seismic, setup.parameters.baud) = (true, board::SEISMIC_BAUD);
        setup.link = true;
    }
    let blob = blob::of(station)?;
    if let Some(path) = &options.places {
        if !has.link {
            bail!("--places: the image has no places for a configuration; see --link and --card");
        }
        setup.bank_two = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        if !blob::holds(&setup.bank_two, &blob) {
            bail!(
                "{}: station {} of --station is in neither place; write it with `seabearing blob --places --station`",
                path.display(),
                station.config.id
            );
        }
    }
    if options.card {
        // Short files, so that those without a claim are filled again in a short run.
        let (files, pages) = if station.config.clips.are_kept() { (60, 64) } else { (20, 256) };
        setup.card = Some(board::blank(files, pages, rate_hz)?);
    }
    let most = options.seconds.map(|s| (s * rate_hz).round() as u64);
    // Complaints about the input are heard before the board starts.
    let length = recording::open(&input, station, None)?.expected_end();
    let length_s = [length, most].into_iter().flatten().min().map(|instants| instants as f64 / rate_hz);
    if let Some(length_s) = length_s.filter(|s| has.link && *s < LEAST_LINK_S) {
        bail!(
            "{length_s:.2} s of recording: a first start erases flash for 4 s before a record leaves; {LEAST_LINK_S} s at least"
        );
    }
    if !setup.faults.is_empty() {
        // A converter that stays dead never ends.
        setup.most_s = length_s.map(|length_s| length_s + PATIENCE_S);
    }
    // The recording is read while the board runs; it stops being read when the board has ended.
    let (send, receive) = mpsc::sync_channel::<Vec<Frame>>(64);
    let report = std::thread::scope(|scope| -> Result<BoardRun> {
        let reader = scope.spawn(move || -> Result<()> {
            let mut source = recording::open(&input, station, None)?;
            let mut left = most.unwrap_or(u64::MAX);
            while left > 0
                && let Some(block) = source.next_block()?
            {
                let take = block.frames.len().min(usize::try_from(left).unwrap_or(usize::MAX));
                left -= take as u64;
                if send.send(block.frames[..take].to_vec()).is_err() {
                    break;
                }
            }
            Ok(())
        });
        let mut waiting = Vec::new().into_iter();
        let next = move || {
            loop {
                if let Some(frame) = waiting.next() {
                    return Some(board::codes(&frame));
                }
                waiting = receive.recv().ok()?.into_iter();
            }
        };
        let report = board::play(&image, &blob, rate_hz, &setup, next);
        match reader.join() {
            Ok(read) => read?,
            Err(_) => bail!("the reader of the recording has panicked"),
        }
        report
    })?;
    if let Some(path) = keep {
        crate::atomic::write(path, &report.firmware)?;
    }
    let difference = report.difference(&blob)?;
    let sound = report.card.is_some().then(|| board::sound(&report, &blob, 0)).transpose()?;
    say(&report, sound.as_ref(), difference.is_none(), json)?;
    if let Some(sound) = sound.filter(|sound| sound.wrong > 0) {
        bail!("{} instants on the card are not those of the converter", sound.wrong);
    }
    difference.map_or(Ok(()), |difference| bail!("{difference}"))
}

fn setup(options: &BoardOptions) -> Result<Setup> {
    let costs = Costs {
        instruction: options.cycles,
        register: options.register_cycles,
        tightly_coupled: options.tcm_cycles,
        axi: options.axi_cycles,
        sram: options.axi_cycles,
        flash: options.flash_cycles,
        interrupt_entry: options.interrupt_cycles,
        ..Costs::IDEAL
    };
    let all = [
        costs.instruction,
        costs.register,
        costs.tightly_coupled,
        costs.axi,
        costs.flash,
        costs.interrupt_entry,
    ];
    if !(all.iter().all(|c| (0.0..=1e4).contains(c)) && costs.instruction > 0.0) {
        bail!("costs are cycles from 0 to 10000, and an instruction takes some");
    }
    if ![options.board_clock_ppm, options.converter_clock_ppm].iter().all(|ppm| ppm.abs() <= 1e5) {
        bail!("a clock's error is at most 100000 ppm");
    }
    let parameters = Parameters {
        board_clock_error: options.board_clock_ppm * 1e-6,
        converter_clock_error: options.converter_clock_ppm * 1e-6,
        ..Parameters::default()
    };
    let faults: Vec<InjectedFault> = options.faults.clone();
    Ok(Setup {
        costs,
        parameters,
        acquisition_s: options.converter_start_us * 1e-6,
        faults,
        link: options.link || options.card,
        ..Setup::default()
    })
}

fn say(report: &BoardRun, sound: Option<&Sound>, identical: bool, json: bool) -> Result<()> {
    let per = |count: u64| count as f64 / (report.delivered as f64).max(1.0);
    let round = |x: f64| (x * 10.0).round() / 10.0;
    let (handlers, thread) = (report.handlers, report.thread);
    let registers = per(handlers.register_reads
        + handlers.register_writes
        + thread.register_reads
        + thread.register_writes);
    let memory = per(handlers.loads + handlers.stores + thread.loads + thread.stores);
    let mut out = std::io::stdout().lock();
    if json {
        let mut record = serde_json::json!({
            "type": "twin", "board": "stm32h743", "identical": identical, "bytes": report.firmware.len(),
            "seconds": report.seconds, "conversions": report.converted, "delivered": report.delivered,
            "lost": report.lost, "interrupts_per_s": round(report.interrupts_per_s), "idle": report.idle,
            "resets": report.resets, "spi_hz": report.spi_hz, "dma_items": report.dma_items,
            "instructions_in_interrupts_per_conversion": per(handlers.instructions),
            "instructions_in_thread_per_conversion": per(thread.instructions),
            "register_accesses_per_conversion": registers,
            "memory_loads_per_conversion": per(handlers.loads + thread.loads),
            "memory_accesses_per_conversion": memory,
            "flash_words": report.flash.0, "flash_sectors": report.flash.1,
            "margins": report.margins().last().map(Margins::from),
            "stack_bytes": report.stack.1, "stack_size_bytes": report.stack.0,
        });
        if let (Some(sound), Some(record)) = (sound, record.as_object_mut()) {
            record.insert("card_instants".to_owned(), sound.instants.into());
            record.insert("card_missing".to_owned(), sound.missing.into());
            record.insert("card_wrong".to_owned(), sound.wrong.into());
        }
        writeln!(out, "{record}")?;
        return Ok(());
    }
    let same = if identical { "identical" } else { "DIFFERENT" };
    writeln!(out, "{same}: {} bytes over {:.2} s of conversions", report.firmware.len(), report.seconds)?;
    writeln!(
        out,
        "conversions: {} done, {} delivered, {} lost between the first and the last",
        report.converted, report.delivered, report.lost
    )?;
    writeln!(
        out,
        "processor: {:.1} % idle, {:.0} interrupts a second, {} resets, converter's bus {:.1} MHz",
        report.idle * 100.0,
        report.interrupts_per_s,
        report.resets,
        report.spi_hz as f64 / 1e6
    )?;
    writeln!(
        out,
        "per conversion: {:.0} instructions in interrupts, {:.0} in the thread, {registers:.1} register accesses, {:.0} \
         loads of memory",
        per(handlers.instructions),
        per(thread.instructions),
        per(handlers.loads + thread.loads)
    )?;
    if let Some(sound) = sound {
        let (first, end) =
            (sound.spans.first().map_or(0, |span| span.0), sound.spans.last().map_or(0, |span| span.1));
        writeln!(
            out,
            "card: {} instants in {} files, from sample {first} to {end}; {} missing, {} wrong",
            sound.instants, sound.files, sound.missing, sound.wrong
        )?;
    }
    writeln!(out, "stack: {} bytes used of {}", report.stack.1, report.stack.0)?;
    // Told after each health report, a minute apart.
    if let Some(told) = report.margins().last().map(Margins::from) {
        let volts = |v: Option<f64>| v.map_or("not measured".to_owned(), |v| format!("{v:.2} V"));
        let (supply, cell) = (volts(told.supply_v), volts(told.battery_v));
        writeln!(
            out,
            "margins told: supply {supply}, cell {cell}, {} bytes never used, longest work {:.1} ms",
            told.memory_free_bytes,
            1000.0 * told.longest_s
        )?;
    }
    Ok(())
}
