//! Project automation: set-up, firmware, emulation, tests and budgets. `cargo xtask help` lists the tasks.

mod book;
mod budget;
mod elf;
mod example;
mod firmware;
mod fuzz;
mod lines;
mod pace;
mod panic_free;
mod process;
mod python;
mod scenario;
mod stack_bound;
mod suite;
mod thumb;
mod toolchain;

use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "\
cargo xtask TASK

  demo [--no-page]  build the firmware, boot it in QEMU, stream a vessel pass into it, show its track beside the truth; then
                  two recorders live on the base station's page, whose address is named (not with --no-page)
  demo --two [--shorter N]  two recorders in QEMU and a base station: a line is pulled for a minute, the power goes, the base
                  station is killed; then an account of every record (N: all times divided by it)
  test            set up and run every test, the emulated ones included
  test --random N property tests with other cases than always, N times as many; counterexamples are kept as FILE.cases
  setup           install what is missing: the Rust target (or a compiler that can build it) and QEMU
  build-firmware  [--board mps2-an500|link|stm32h743|stm32h743-link|stm32h743-obs|all] [--station STATION.toml] [--key FILE]
  flash           [--board stm32h743-link|stm32h743-obs] [--station STATION.toml] [--key FILE]  build for stm32h743, write it with probe-rs and show its faults
  flash --configuration STATION.toml  write a configuration alone, beside an image with a link, which starts with it
  example         run the core's example on the host and, in QEMU, on the target; they print the same
  budget          [--bless]  instructions, stack, memory and flash against their bars and docs/budget.txt
  stack IMAGE.elf  the most stack an image can need, and the way to it
  rehearse        [--bless]  the image for hardware on the modelled board: its bytes, then every fault against the table kept
  panic-free      link the recorder with a panic handler that cannot be linked
  fuzz [--inputs N] [--target NAME]  hostile input in great numbers: N mutated inputs (of slow targets a share); panics, false
                  frames and hangs are counted
  fuzz --guided SECONDS [--target NAME]  the same targets for so long each, guided by coverage (libFuzzer; needs a C++ compiler)
  book            the book out of docs/ into target/book, by mdBook, which is installed into target/ where it is missing
  python [--bless | --wheel]  the Python package in an environment of its own: tests, types, notebooks, whose pages are compared
                  or, with --bless, written anew; --wheel builds a wheel into target/wheels
  lines           [REVISION]  lines of code outside tests, package by package
  pace REVISION   processor time of the command over recordings, beside that of a revision of git
  check           format, lints and documentation, warnings as errors

`demo` and `test` take --host-only: leave the firmware out and run the host's twin of it instead.
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> Result<()> {
    let (task, options) = match arguments.split_first() {
        Some((task, options)) => (task.as_str(), options),
        None => ("help", arguments),
    };
    match task {
        "demo" => demo(options),
        "setup" => toolchain::set_up().map(|_| ()),
        "build-firmware" => firmware::command(options),
        "budget" => match options {
            [] => budget::check(&toolchain::Toolchain::find()?),
            [flag] if flag == "--bless" => budget::bless(&toolchain::Toolchain::find()?),
            _ => bail!("budget takes nothing, or --bless"),
        },
        "example" => example::check(&toolchain::Toolchain::find()?),
        "flash" => firmware::flash(options),
        "rehearse" => match options {
            [] => suite::rehearse(false),
            [flag] if flag == "--bless" => suite::rehearse(true),
            _ => bail!("rehearse takes nothing, or --bless"),
        },
        "panic-free" => panic_free::check(&toolchain::Toolchain::find()?),
        "pace" => match options {
            [revision] => pace::command(revision),
            _ => bail!("pace takes a revision of git"),
        },
        "stack" => match options {
            [image] => stack_bound::command(Path::new(image)),
            _ => bail!("stack takes an image: target/firmware/images/NAME.elf"),
        },
        "check" => process::check(),
        "lines" => match options {
            [] => lines::command(None),
            [revision] => lines::command(Some(revision)),
            _ => bail!("lines takes nothing, or a revision of git"),
        },
        "fuzz" => fuzz::command(options),
        "python" => python::command(options),
        "book" => book::build(),
        "test" => suite::command(options),
        "help" | "-h" | "--help" => {
            print!("{HELP}");
            Ok(())
        }
        other => bail!("there is no task `{other}`; `cargo xtask help` lists them"),
    }
}

/// The demonstration; its work is done by `seabearing demo`.
fn demo(options: &[String]) -> Result<()> {
    let has = |flag: &str| options.iter().any(|o| o == flag);
    const PASS: &str = "a pass of 200 s through the recorder";
    let alone = has("--no-page") || has("--host-only");
    let (parts, images, what): (_, &[_], _) = match has("--two") {
        true => (&process::WITH_BASE, &[&firmware::EMULATED_LINK], "two recorders, one base station"),
        false if alone => (&process::WITHOUT_EXPERIMENTS, &[&firmware::EMULATED], PASS),
        false => (&process::WITH_PAGE, &[&firmware::EMULATED, &firmware::EMULATED_LINK], PASS),
    };
    process::say("building the host's command");
    let build = process::Beside::build(parts)?;
    if !has("--host-only") {
        let toolchain = toolchain::set_up()?;
        for image in images {
            firmware::build(&toolchain, image)?;
        }
    }
    build.join()?;
    process::say(what);
    // Without the page there is nothing to leave out.
    let options = options.iter().map(String::as_str).filter(|o| *o != "--no-page");
    let arguments: Vec<&str> = std::iter::once("demo").chain(options).collect();
    process::run(&mut process::host_with(parts, &arguments), "the demonstration")
}

/// The workspace's folder.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_path_buf).unwrap_or_default()
}
