//! Budgets: work, stack, memory and flash of the target, against their bars and against a committed snapshot.
//!
//! Work is counted, not timed: QEMU's `-icount shift=0` makes one tick of the emulated 25 MHz core clock 40
//! instructions. They are instructions, not cycles of the hardware.

mod card;
mod modelled;

use crate::elf::Elf;
use crate::firmware::{
    self, EMULATED_ARRAY, EMULATED_FIT, EMULATED_OBS, EMULATED_TRACKS, EMULATED_TWICE, Image,
};
use crate::process::{host, run, say};
use crate::scenario::Recording;
use crate::stack_bound;
use crate::toolchain::{Toolchain, emulator};
use crate::{root, scenario};
use anyhow::{Context, Result, bail};
use modelled::{HARDWARE_CYCLES, HARDWARE_REGISTER};
use std::fmt::Write;
use std::path::Path;

/// The snapshot, beside the documentation.
const SNAPSHOT: &str = "docs/budget.txt";
/// Difference to the snapshot that is an ordinary change of compiler or code. Bars have none.
const TOLERANCE: f64 = 0.03;
/// Clock of the hardware's core.
const CORE_HZ: f64 = 480e6;
/// The same of the ocean-bottom recorder's, MHz.
const OCEAN_BOTTOM_MHZ: f64 = 64.0;
/// Where the length of the hardware's sample queue stands.
const ACQUISITION: &str = include_str!("../../firmware/src/converter.rs");

/// One kind of recorder and what it may cost.
struct Recorder {
    name: &'static str,
    image: &'static Image,
    scenario: &'static str,
    /// Million instructions per second of samples.
    work: f64,
    /// Statics and stack, bytes.
    memory: f64,
    /// Flash, bytes.
    flash: f64,
    /// Samples a second that fill the hardware's queue, where it has a converter for this kind.
    queue_hz: Option<f64>,
}

const RECORDERS: [Recorder; 2] = [
    Recorder {
        name: "array",
        image: &EMULATED_ARRAY,
        scenario: "demo",
        work: 18.0,
        memory: 102_400.0,
        flash: 262_144.0,
        queue_hz: Some(64_000.0),
    },
    Recorder {
        name: "obs",
        image: &EMULATED_OBS,
        scenario: "ocean-bottom",
        work: 0.5,
        memory: 196_608.0,
        flash: 262_144.0,
        queue_hz: None,
    },
];

/// One line of the snapshot.
struct Figure {
    name: String,
    value: f64,
    /// The most it may be, but for what [`LEAST`] says.
    bar: Option<f64>,
}

/// Ends the name of a figure whose bar is the least it may be.
const LEAST: &str = "asleep, %";

impl Figure {
    fn missed(&self) -> bool {
        let least = self.name.ends_with(LEAST);
        self.bar.is_some_and(|bar| if least { self.value < bar } else { self.value > bar })
    }
}

/// Measures, prints, and compares with the bars and with the snapshot.
pub fn check(toolchain: &Toolchain) -> Result<()> {
    let (figures, _) = figures(toolchain)?;
    let kept = std::fs::read_to_string(root().join(SNAPSHOT))
        .with_context(|| format!("{SNAPSHOT}: run with --bless"))?;
    within_bars(&figures)?;
    let moved: Vec<String> = figures.iter().filter_map(|f| moved(f, &kept)).collect();
    if moved.is_empty() {
        say("budget: within its bars, and as in the snapshot");
        return Ok(());
    }
    bail!("the budget has moved (`cargo xtask budget --bless` accepts it): {}", moved.join("; "))
}

/// Measures, prints, and rewrites the snapshot; a missed bar stays an error.
pub fn bless(toolchain: &Toolchain) -> Result<()> {
    let (figures, text) = figures(toolchain)?;
    std::fs::write(root().join(SNAPSHOT), text).context(SNAPSHOT)?;
    within_bars(&figures)
}

/// An error that names every bar missed.
fn within_bars(figures: &[Figure]) -> Result<()> {
    let missed: Vec<String> = figures
        .iter()
        .filter(|f| f.missed())
        .map(|f| format!("{} is {}, bar {}", f.name, f.value, f.bar.unwrap_or_default()))
        .collect();
    if missed.is_empty() { Ok(()) } else { bail!("the budget misses its bars: {}", missed.join("; ")) }
}

/// The figures, printed, and the snapshot they make.
fn figures(toolchain: &Toolchain) -> Result<(Vec<Figure>, String)> {
    emulator()?;
    let [array, ocean_bottom] = RECORDERS.each_ref().map(|recorder| scenario::simulate(recorder.scenario));
    let (array, ocean_bottom) = (array?, ocean_bottom?);
    // An emulator keeps one core busy: the two boards' run beside each other.
    let (emulated, hardware) = std::thread::scope(|scope| {
        let emulated = scope.spawn(|| on_the_emulated_board(toolchain, [&array, &ocean_bottom]));
        let hardware = on_the_modelled_board(toolchain, &ocean_bottom);
        (emulated.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), hardware)
    });
    let mut figures = emulated?;
    figures.extend(hardware?);
    let mut text = format!(
        "# Budgets of the target: `cargo xtask budget` measures, `--bless` rewrites; tolerance {} %.\n\
         # Instructions are counted by QEMU over the scenario named; they are not cycles. `stm32h743`: the image for hardware\n\
         # on the modelled board (docs/board-model.md), {HARDWARE_CYCLES} cycles an instruction and {HARDWARE_REGISTER} a register access.\n",
        TOLERANCE * 100.0
    );
    for figure in &figures {
        let bar = figure.bar.map_or(String::new(), |bar| {
            format!("  (bar {bar}: {})", if figure.missed() { "MISSED" } else { "met" })
        });
        writeln!(text, "{:38} {:>10}{bar}", figure.name, figure.value)?;
    }
    print!("{text}");
    Ok((figures, text))
}

/// What QEMU counts, over a recording for each kind of recorder.
fn on_the_emulated_board(toolchain: &Toolchain, recordings: [&Recording; 2]) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for (recorder, recording) in RECORDERS.iter().zip(recordings) {
        let image = firmware::build(toolchain, recorder.image)?;
        figures.extend(measure(recorder, &image, recording)?);
        let twice = firmware::build(toolchain, &EMULATED_TWICE)?;
        figures.push(configured_twice(recorder, &twice, recording)?);
    }
    figures.extend(slower(&firmware::build(toolchain, &EMULATED_ARRAY)?)?);
    figures.extend(fit(&firmware::build(toolchain, &EMULATED_FIT)?)?);
    figures.extend(tracks(&firmware::build(toolchain, &EMULATED_TRACKS)?)?);
    figures.extend(together(&figures)?);
    Ok(figures)
}

/// What the images for hardware cost.
fn on_the_modelled_board(toolchain: &Toolchain, recording: &Recording) -> Result<Vec<Figure>> {
    let mut figures = modelled::hardware(toolchain)?;
    figures.extend(modelled::store(toolchain)?);
    figures.extend(modelled::ocean_bottom(toolchain, recording)?);
    figures.extend(card::figures(toolchain)?);
    Ok(figures)
}

/// The number of a key in a line of JSON.
fn number(json: &str, key: &str) -> Option<f64> {
    let (_, rest) = json.split_once(&format!("\"{key}\":"))?;
    rest.split([',', '}']).next()?.trim().parse().ok()
}

/// What differs from the snapshot by more than the tolerance.
fn moved(figure: &Figure, snapshot: &str) -> Option<String> {
    let line = snapshot.lines().find(|l| l.starts_with(&figure.name));
    let rest = line.and_then(|l| l.get(figure.name.len()..));
    let was: Option<f64> = rest.and_then(|r| r.split_whitespace().next()).and_then(|w| w.parse().ok());
    match was {
        Some(was) if (figure.value - was).abs() <= TOLERANCE * was => None,
        Some(was) => Some(format!("{} was {was}, is {}", figure.name, figure.value)),
        None => Some(format!("{} is new: {}", figure.name, figure.value)),
    }
}

fn measure(recorder: &Recorder, image: &Path, recording: &Recording) -> Result<Vec<Figure>> {
    let name = |what: &str| format!("{} {what}", recorder.name);
    let elf = Elf::read(image)?;
    let (flash, statics) = (f64::from(elf.flash()), f64::from(elf.statics()));
    let mut figures = vec![
        Figure { name: name("flash, bytes"), value: flash, bar: Some(recorder.flash) },
        Figure { name: name("statics, bytes"), value: statics, bar: None },
    ];
    say(&format!(
        "counting the instructions of the {} recorder over scenarios/{}.toml",
        recorder.name, recorder.scenario
    ));
    let said = counted(image, recording)?;
    let get = |key: &str| told(&said, key);
    let work = thousandths(get("million_instructions_per_s")?);
    let stack = get("stack_bytes")?;
    figures.push(Figure { name: name("stack used, bytes"), value: stack, bar: None });
    figures.push(stack_bound(recorder.name, &elf, stack)?);
    let memory = statics + stack;
    figures.push(Figure {
        name: name("statics and stack, bytes"),
        value: memory,
        bar: Some(recorder.memory),
    });
    figures.push(Figure {
        name: name("work, million instructions/s"),
        value: work,
        bar: Some(recorder.work),
    });
    if let Some(rate_hz) = recorder.queue_hz {
        figures.push(Figure {
            name: name("worst block, million instr."),
            value: thousandths(get("worst_block_million_instructions")?),
            bar: Some(half_a_queue(rate_hz)?),
        });
    }
    // What one vessel, heard all the time, brings to the line; health reports come to it.
    let minutes = get("seconds")? / 60.0;
    for (what, value) in [
        ("bearings a minute, one vessel", get("bearings")? / minutes),
        ("bearing frame, bytes", get("bearing_bytes")? / get("bearings")?.max(1.0)),
        ("other telemetry, bytes/min", get("other_bytes")? / minutes),
    ] {
        if value > 0.0 {
            figures.push(Figure { name: name(what), value: thousandths(value), bar: None });
        }
    }
    figures.extend(levels(recorder, image, recording, &said)?);
    Ok(figures)
}

/// The most that levels may add, instructions a second.
const LEVELS_WORK: f64 = 1e6;

/// What levels each minute add to a run without them, of which this was said.
fn levels(recorder: &Recorder, image: &Path, recording: &Recording, without: &str) -> Result<[Figure; 2]> {
    say(&format!("the same with levels each minute: {}", recorder.name));
    let station = recording.station.with_file_name("station-with-levels.toml");
    let text = std::fs::read_to_string(&recording.station).context("the scenario's station file")?;
    std::fs::write(&station, text + "\n[levels]\nevery_s = 60\n").context("a station file with levels")?;
    let said = counted(image, &Recording { station, files: recording.files.clone() })?;
    let more = |key: &str| Ok::<_, anyhow::Error>(told(&said, key)? - told(without, key)?);
    let name = |what: &str| format!("{} levels each minute, {what}", recorder.name);
    let (work, minutes) = (1e6 * more("million_instructions_per_s")?, told(&said, "seconds")? / 60.0);
    Ok([
        Figure { name: name("instr./s"), value: work.round(), bar: Some(LEVELS_WORK) },
        Figure { name: name("bytes/min"), value: thousandths(more("other_bytes")? / minutes), bar: None },
    ])
}

/// The most stack that an image can need, which must be there; less than was used would be a defect of the bound.
fn stack_bound(image: &str, elf: &Elf, used: f64) -> Result<Figure> {
    let bound = stack_bound::of(elf).with_context(|| format!("the stack of {image}"))?;
    let most = f64::from(bound.all());
    if most < used {
        bail!("{image} used {used} bytes of stack, more than the bound of {most} read from its code");
    }
    Ok(Figure { name: format!("{image} stack bound, bytes"), value: most, bar: Some(f64::from(bound.size)) })
}

fn thousandths(x: f64) -> f64 {
    (x * 1000.0).round() / 1000.0
}

/// What `seabearing twin` with these arguments prints as JSON.
fn twin(arguments: &[&str], image: &Path, recording: &Recording) -> Result<String> {
    let mut command = host(&["twin", "--json"]);
    command.args(arguments).arg("--firmware").arg(image);
    command.arg("--station").arg(&recording.station).args(&recording.files);
    let output = command.output().context("seabearing twin")?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The same of a run whose instructions QEMU counts.
fn counted(image: &Path, recording: &Recording) -> Result<String> {
    twin(&["--count-instructions"], image, recording)
}

fn told(said: &str, key: &str) -> Result<f64> {
    number(said, key).with_context(|| format!("`seabearing twin` told no {key}"))
}

/// The array recorder's work at another rate, and with another step: what `seabearing plan` scales it by.
fn slower(image: &Path) -> Result<Vec<Figure>> {
    let rate = ("rate_hz = 64000", "rate_hz = 16000");
    let step = ("[array]", "[array]\nstep_s = 1.0");
    let work = |name: &str, folder: &str, changes: &[(&str, &str)]| -> Result<Figure> {
        let recording = scenario::simulate_changed(folder, changes)?;
        say(&format!("counting the instructions of the array recorder: {name}"));
        let work = told(&counted(image, &recording)?, "million_instructions_per_s")?;
        Ok(Figure { name: format!("array {name}"), value: thousandths(work), bar: None })
    };
    Ok(vec![
        work("at 16 kHz, million instr./s", "demo-16-khz", &[rate])?,
        work("at 16 kHz, 1 s steps, million/s", "demo-16-khz-1-s", &[rate, step])?,
    ])
}

/// Frames the hardware's sample queue holds. Work after one block may take half of it: the other half is for what comes
/// meanwhile.
fn queue_frames() -> Result<f64> {
    let (_, rest) = ACQUISITION
        .split_once("RING_FRAMES: usize = ")
        .context("firmware/src/converter.rs: no RING_FRAMES")?;
    let number = rest.split(';').next().unwrap_or_default().replace('_', "");
    number.parse().with_context(|| format!("RING_FRAMES is `{number}`"))
}

/// Work and memory of one batch motion fit of 401 bearings: the bar of the first line of both kinds.
const FIT_WORK: f64 = 60.0;
const FIT_MEMORY: f64 = 65_536.0;
/// Instructions per tick of the emulated core clock with `-icount shift=0`.
const INSTRUCTIONS_PER_TICK: f64 = 40.0;

/// Work while half of it fills, million instructions.
fn half_a_queue(rate_hz: f64) -> Result<f64> {
    Ok(thousandths(queue_frames()? / 2.0 / rate_hz * CORE_HZ / HARDWARE_CYCLES / 1e6))
}

/// Cycles an instruction that the board must bear at least, whatever it hears.
const LEAST_CYCLES: f64 = 4.0;

/// Work while all of it fills at [`LEAST_CYCLES`], million instructions: a longer one loses samples.
fn a_queue(rate_hz: f64) -> Result<f64> {
    Ok(thousandths(queue_frames()? / rate_hz * CORE_HZ / LEAST_CYCLES / 1e6))
}

/// Runs an image that leaves a summary and reads its words; `blob` is the configuration it finds, if it needs one.
fn summary(image: &Path, name: &str, blob: Option<&Path>) -> Result<Vec<u64>> {
    let folder = root().join("target/firmware").join(name);
    std::fs::create_dir_all(&folder).with_context(|| format!("target/firmware/{name}"))?;
    let mut command = std::process::Command::new("qemu-system-arm");
    command.args(["-M", "mps2-an500", "-display", "none", "-monitor", "none", "-serial", "none"]);
    command.args(["-semihosting-config", "enable=on,target=native", "-icount", "shift=0"]);
    if let Some(blob) = blob {
        command.arg("-device").arg(format!("loader,file={},addr=0x60000000,force-raw=on", blob.display()));
    }
    let output =
        command.arg("-kernel").arg(image).current_dir(&folder).output().context("qemu-system-arm")?;
    if !output.status.success() {
        bail!("{name} on the target: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let left =
        std::fs::read(folder.join("summary.bin")).with_context(|| format!("{name} left no summary"))?;
    Ok(left.as_chunks().0.iter().map(|w| u64::from_le_bytes(*w)).collect())
}

/// Stack that taking a configuration a second time needs beyond the first.
fn configured_twice(recorder: &Recorder, image: &Path, recording: &Recording) -> Result<Figure> {
    let blob = root().join("target/firmware/configure-twice.sbcf");
    run(host(&["blob", "--station"]).arg(&recording.station).arg("--out").arg(&blob), "seabearing blob")?;
    let words = summary(image, "configure-twice", Some(&blob))?;
    let [first, both] = words[..] else { bail!("the summary of two configurations is not two words") };
    Ok(Figure {
        name: format!("{} configured again, more stack", recorder.name),
        value: both.saturating_sub(first) as f64,
        bar: Some(0.0),
    })
}

/// Million instructions of so many ticks.
fn millions(ticks: u64) -> f64 {
    (ticks as f64 * INSTRUCTIONS_PER_TICK / 1e4).round() / 1e2
}

/// Runs the image that tracks eight vessels.
fn tracks(image: &Path) -> Result<Vec<Figure>> {
    say("counting the instructions of eight vessels' tracks");
    let words = summary(image, "tracks", None)?;
    let [heard, ending, _, bytes, _, stack] = words[..] else {
        bail!("the tracks' summary is not six words")
    };
    let figure = |what: &str, value, bar| Figure { name: format!("tracks {what}"), value, bar };
    let bar = half_a_queue(64_000.0)?;
    Ok(vec![
        figure("state of eight, bytes", bytes as f64, None),
        figure("stack used, bytes", stack as f64, None),
        stack_bound("tracks", &Elf::read(image)?, stack as f64)?,
        figure("worst 512 instants, million instr.", millions(heard), Some(bar)),
        figure("worst 512, eight ending at once", millions(ending), Some(bar)),
    ])
}

/// The array's worst block, in which one vessel's track has its part, and the worst of eight tracks at the same moment: no less
/// than what one block can bring.
fn together(figures: &[Figure]) -> Result<Vec<Figure>> {
    let value = |name: &str| {
        let found = figures.iter().find(|f| f.name == name).map(|f| f.value);
        found.with_context(|| format!("there is no figure `{name}`"))
    };
    let chain = value("array worst block, million instr.")?;
    let sum = |what: &str, with: &str, bar| -> Result<Figure> {
        Ok(Figure {
            name: format!("array worst block and {what}"),
            value: thousandths(chain + value(with)?),
            bar,
        })
    };
    Ok(vec![
        sum("eight ending", "tracks worst 512, eight ending at once", Some(half_a_queue(64_000.0)?))?,
        // All eight turning at one instant takes longer than half the queue, and must not take longer than all of it.
        sum("eight turning", "tracks worst 512 instants, million instr.", Some(a_queue(64_000.0)?))?,
    ])
}

/// Runs the image that fits and reads what it leaves.
fn fit(image: &Path) -> Result<Vec<Figure>> {
    say("counting the instructions of one motion fit of 401 bearings");
    let words = summary(image, "motion-fit", None)?;
    let [short, long, _, stack] = words[..] else { bail!("the motion fit's summary is not four words") };
    let statics = f64::from(Elf::read(image)?.statics());
    let figure = |what: &str, value, bar| Figure { name: format!("motion fit {what}"), value, bar };
    Ok(vec![
        figure("statics and stack, bytes", statics + stack as f64, Some(FIT_MEMORY)),
        figure("work, million instructions", millions(short), Some(FIT_WORK)),
        figure("by Levinson, million instr.", millions(long), None),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_bar_is_an_error_however_near_the_snapshot_is() {
        let figure = |value| Figure { name: "obs statics".into(), value, bar: Some(262_144.0) };
        let snapshot = "obs statics    260612  (bar 262144: met)";
        assert!(moved(&figure(263_000.0), snapshot).is_none());
        let missed = within_bars(&[figure(263_000.0)]).unwrap_err().to_string();
        assert!(missed.contains("obs statics is 263000, bar 262144"), "{missed}");
        assert!(within_bars(&[figure(262_144.0)]).is_ok());
    }

    #[test]
    fn the_least_time_asleep_is_a_bar_from_below() {
        let asleep = |value| Figure { name: format!("stm32h743 {LEAST}"), value, bar: Some(60.0) };
        assert!(within_bars(&[asleep(59.9)]).is_err() && within_bars(&[asleep(60.1)]).is_ok());
    }

    #[test]
    fn the_length_of_the_sample_queue_is_read_where_it_stands() {
        assert!(queue_frames().unwrap() >= 1024.0);
    }
}
