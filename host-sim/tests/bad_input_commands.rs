//! Every subcommand with hostile input and output: a non-zero exit, one clear line, no panic, nothing half-written.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The command of this very build.
const BINARY: &str = env!("CARGO_BIN_EXE_seabearing");

/// What a run left.
struct Ran {
    code: Option<i32>,
    stderr: String,
    stdout_bytes: usize,
}

/// Runs a command line (words, no quoting) in a folder.
fn run(folder: &Path, line: &str, stdout: Stdio) -> Ran {
    let mut command = Command::new(BINARY);
    command.args(line.split_whitespace()).current_dir(folder).stdin(Stdio::null());
    let output = command.stdout(stdout).stderr(Stdio::piped()).output().unwrap();
    Ran {
        code: output.status.code(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        stdout_bytes: output.stdout.len(),
    }
}

/// The rule for every refusal.
fn refused(line: &str, ran: &Ran) {
    let Ran { code, stderr, .. } = ran;
    assert!(matches!(code, Some(1 | 2)), "{line}: exit {code:?}, {stderr}");
    assert_eq!(stderr.lines().count(), 1, "{line}: {stderr}");
    assert!(stderr.starts_with("seabearing: ") && stderr.len() < 700, "{line}: {stderr}");
}

/// A folder with what good command lines need.
fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    for name in ["demo-station.toml", "ocean-profile.csv"] {
        std::fs::copy(root.join("scenarios").join(name), dir.path().join(name)).unwrap();
    }
    std::fs::rename(dir.path().join("demo-station.toml"), dir.path().join("array.toml")).unwrap();
    write(
        "line.toml",
        "[station]\nid = 1\nkind = \"line\"\n[line]\nsensors = 23\nspacing_m = 0.75\n[sampling]\nrate_hz = 702\n",
    );
    write(
        "obs.toml",
        "[station]\nid = 1\nkind = \"obs\"\n[sampling]\nrate_hz = 50\n[obs]\ncomponents = { pressure = \"BDH\", north = \
         \"BH1\", east = \"BH2\", vertical = \"BHZ\" }\npropagation = \"table.toml\"\n",
    );
    write(
        "network.toml",
        "[[stations]]\nid = 1\nname = \"a\"\nposition = { local_m = [0.0, 0.0, -10.0] }\n\
         [[stations]]\nid = 2\nname = \"b\"\nposition = { local_m = [500.0, 0.0, -10.0] }\n",
    );
    let station = |id: u8, x: f64| {
        format!("[[stations]]\nid = {id}\nposition = {{ local_m = [{x:.1}, 0.0, -50.0] }}\n")
    };
    write("twice.toml", &(station(1, 0.0) + &station(1, 300.0).replace("id", "name = \"b\"\nid")));
    write("same.toml", &(station(1, 0.0) + &station(2, 0.0)));
    write("track.csv", "t_s,x_m,y_m\n0,-350,400\n100,350,400\n");
    let mut bearings = String::from("t_s,azimuth_deg\n");
    for k in 0..=100 {
        let x = 7.0 * f64::from(k) - 350.0;
        bearings += &format!("{},{}\n", k, x.atan2(400.0).to_degrees().rem_euclid(360.0));
    }
    write("bearings.csv", &bearings);
    write("fixes.csv", "t_s,station,azimuth_deg,elevation_deg\n0,a,45.0,0.0\n0,b,315.0,0.0\n");
    write(
        "tdoa.csv",
        "t_s,tdoa01_s,tdoa02_s,tdoa03_s,tdoa12_s,tdoa13_s,tdoa23_s\n0,-0.00048515,-0.00122482,-0.00067107,-0.00073967,-0.00018592,0.00055375\n1,-0.00048515,-0.00122482,-0.00067107,-0.00073967,-0.00018592,0.00055375\n2,-0.00048515,-0.00122482,-0.00067107,-0.00073967,-0.00018592,0.00055375\n",
    );
    write(
        "short.toml",
        &std::fs::read_to_string(root.join("scenarios/demo.toml"))
            .unwrap()
            .replace("demo-station.toml", "array.toml"),
    );
    let mut ais = String::from("Time,MMSI,Latitude_degrees,Longitude_degrees,COG_degrees,SOG_knots\n");
    for (vessel, speed) in [(7, 10), (8, 14)] {
        for (minute, lon) in [(30, -1.010), (32, -1.003), (34, -0.996), (36, -0.990)] {
            ais += &format!("2012-12-05 19:{minute}:00,{vessel},50.001,{lon},90,{speed}\n");
        }
    }
    write("ais.csv", &ais);
    dir
}

/// Whether anything unfinished lies in a folder or below.
fn unfinished(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(".seabearing-") {
            found.push(entry.path());
        }
        if entry.path().is_dir() {
            found.extend(unfinished(&entry.path()));
        }
    }
    found
}

/// Command lines whose input, in place of `IN`, is hostile.
const INPUTS: [&str; 37] = [
    "simulate IN --out o",
    "process --station IN IN",
    "process --station array.toml IN",
    "process --station obs.toml IN",
    "bearing --station array.toml IN",
    "bearing --station IN tdoa.csv",
    "track IN",
    "levels IN",
    "track bearings.csv --known-track IN",
    "shaft-rate --station array.toml IN",
    "shaft-rate --station IN IN",
    "calls --station obs.toml IN",
    "calls --station IN IN",
    "locate --stations IN fixes.csv",
    "locate --stations network.toml IN",
    "orient --station array.toml --track track.csv IN",
    "orient --station line.toml --track track.csv IN",
    "orient --station obs.toml --track track.csv IN",
    "orient --station array.toml --track IN bearings.csv",
    "orient --station IN --track track.csv bearings.csv",
    "twin --station array.toml IN",
    "twin --station IN IN",
    "twin --station obs.toml --samples uart IN",
    "base IN",
    "base --station IN IN",
    "demo --host-only --scenario IN --out o",
    "blob --station IN --out o/x.sbcf",
    "propagation --profile IN --depth-m 4340 --out o/t.toml",
    "propagation --profile ocean-profile.csv --depth-m 4340 --ray-table IN --out o/t.toml",
    "propagation --ray-table IN --out o/t.toml",
    "config check IN",
    "plan IN",
    "ais speeds IN --lat-deg 50 --lon-deg -1",
    "reproduce IN --out o",
    "process --station array.toml IN --plots o --truth IN",
    "process --station array.toml IN --start IN",
    "nonsense IN",
];

#[test]
fn hostile_input_is_refused_on_one_line_by_every_command() {
    let dir = folder();
    let write = |name: &str, bytes: &[u8]| std::fs::write(dir.path().join(name), bytes).unwrap();
    write("empty", b"");
    write("zeros", &[0; 4096]);
    let noise: Vec<u8> = (0..5000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    write("noise", &noise);
    write("text", b"hello\nworld,,\n1,2,3\n\n\"");
    std::fs::create_dir(dir.path().join("folder")).unwrap();
    for line in INPUTS {
        for hostile in ["missing", "folder", "empty", "zeros", "noise", "text"] {
            let line = line.replace("IN", hostile);
            let ran = run(dir.path(), &line, Stdio::piped());
            refused(&line, &ran);
            // Only the header of a base station's stream of records may come before the end is known.
            assert!(ran.stdout_bytes < 2000, "{line}: {} bytes of results", ran.stdout_bytes);
        }
    }
    assert!(!dir.path().join("o").exists() && unfinished(dir.path()).is_empty());
}

/// Command lines with good input and a value that no command can work with.
const OPTIONS: [&str; 45] = [
    "base acknowledge --store . 3",
    "base --listen 127.0.0.1:0 --store o --alarms bearings.csv",
    "base --listen 127.0.0.1:0 --store o --nmea 127.0.0.1:0",
    "plan line.toml",
    "plan array.toml --duty 0",
    "plan array.toml --battery-wh 100",
    "plan array.toml --vessels-a-day nan",
    "plan array.toml --at-once 9",
    "reproduce several-vessels --runs 0 --out o",
    "reproduce several-vessels --runs -1 --out o",
    "track bearings.csv --height-m inf",
    "track bearings.csv --sigma-elevation-deg inf",
    "track bearings.csv --sigma-deg nan",
    "track bearings.csv --tau-s inf",
    "track bearings.csv --speed inf",
    "track bearings.csv --sound-speed nan",
    "track bearings.csv --min-range-m 100 --max-range-m 50",
    "track bearings.csv --model none",
    "track bearings.csv --gate-sd nan --estimator recursive",
    "locate --stations network.toml fixes.csv --max-range-m nan",
    "config check network.toml --max-range-m 0",
    "config check network.toml --sigma-azimuth-deg nan",
    "config check network.toml --depth-m inf",
    "config check network.toml --every-s 0.0001",
    "config check network.toml --depth-m 500",
    "config check network.toml --depth-m -3",
    "config check network.toml --sigma-azimuth-deg 400",
    "config check twice.toml",
    "config check same.toml",
    "config check array.toml --sigma-azimuth-deg 2",
    "config check array.toml --depth-m 4",
    "config check line.toml --every-s 4",
    "config check obs.toml --speed 4",
    "config check array.toml --minutes 60",
    "config check array.toml --speed -1",
    "locate --stations network.toml fixes.csv --depth-m inf",
    "locate --stations network.toml fixes.csv --tau-s -1 --motion",
    "orient --station array.toml --track track.csv bearings.csv --max-gap-s 0",
    "orient --station array.toml --track track.csv bearings.csv --search-m nan",
    "orient --station line.toml --track track.csv bearings.csv --method other",
    "propagation --profile ocean-profile.csv --depth-m 4340 --rows 720 --range-m nan --out o/t.toml",
    "propagation --profile ocean-profile.csv --depth-m 4340 --rows 999999999 --out o/t.toml",
    "propagation --profile ocean-profile.csv --depth-m nan --rows 720 --out o/t.toml",
    "propagation --profile ocean-profile.csv --depth-m 4340 --step-m nan --out o/t.toml",
    "ais speeds bearings.csv --lat-deg nan --lon-deg 0",
];

#[test]
fn a_station_of_another_kind_is_named_as_that() {
    let dir = folder();
    for line in ["calls --station array.toml bearings.csv", "ships --station array.toml bearings.csv"] {
        let ran = run(dir.path(), line, Stdio::null());
        refused(line, &ran);
        assert!(ran.stderr.contains("an ocean-bottom station is needed"), "{line}: {}", ran.stderr);
    }
}

#[test]
fn impossible_options_are_refused_on_one_line_and_nothing_is_written() {
    let dir = folder();
    for line in OPTIONS {
        let ran = run(dir.path(), line, Stdio::piped());
        refused(line, &ran);
        assert_eq!(ran.stdout_bytes, 0, "{line}");
    }
    assert!(!dir.path().join("o").exists() && unfinished(dir.path()).is_empty());
}

/// Command lines with good input; `OUT` is a place that cannot be written.
const OUTPUTS: [&str; 8] = [
    "simulate short.toml --out OUT",
    "blob --station array.toml --out OUT",
    "propagation --profile ocean-profile.csv --depth-m 4340 --rows 180 --step-m 280 --out OUT",
    "track bearings.csv --plot OUT",
    "ais speeds ais.csv --lat-deg 50 --lon-deg -1 --out OUT",
    "process --station array.toml short.wav --telemetry OUT",
    "process --station array.toml short.wav --plots OUT",
    "reproduce obs-appendix-b --runs 1 --out OUT",
];

#[test]
fn a_place_that_cannot_be_written_is_named_on_one_line() {
    let dir = folder();
    short_recording(dir.path());
    std::fs::create_dir(dir.path().join("taken")).unwrap();
    for line in OUTPUTS {
        // Below a file; and, where a file is to be written, a folder in its place.
        let line = line.replace("OUT", "bearings.csv/x");
        let ran = run(dir.path(), &line, Stdio::piped());
        refused(&line, &ran);
        assert!(ran.stderr.contains("bearings.csv/x"), "{line}: {}", ran.stderr);
        // It is said before the work.
        assert!(ran.stdout_bytes == 0 || !line.starts_with("process"), "{line}");
    }
    for line in ["blob --station array.toml --out taken", "track bearings.csv --plot taken"] {
        refused(line, &run(dir.path(), line, Stdio::piped()));
    }
    assert!(unfinished(dir.path()).is_empty());
}

/// Half a second of noise on four channels.
fn short_recording(folder: &Path) {
    let frames = (0..32_000u64).map(|n| {
        [0u64, 1, 2, 3].map(|c| ((n * 4 + c).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 44) as i32 - (1 << 19))
    });
    let encoding = seabearing::recording::write::Encoding::Int24;
    seabearing::recording::write::wav(&folder.join("short.wav"), 64_000, encoding, frames).unwrap();
}

/// Command lines that print results.
const PRINTING: [&str; 12] = [
    "process --station array.toml short.wav",
    "bearing --station array.toml tdoa.csv",
    "track bearings.csv",
    "track bearings.csv --json",
    "locate --stations network.toml fixes.csv",
    "orient --station obs.toml --track track.csv bearings.csv",
    "base telemetry.bin",
    "base telemetry.bin --json",
    "config check array.toml",
    "ais speeds ais.csv --lat-deg 50 --lon-deg -1",
    "propagation --profile ocean-profile.csv --depth-m 4340 --rows 180 --step-m 280 --out t.toml",
    "reproduce",
];

#[test]
fn a_full_disk_behind_standard_output_is_said_and_a_reader_that_has_gone_is_not() {
    if !Path::new("/dev/full").exists() {
        seabearing_testkit::skipped("bad_input_commands", "no /dev/full here");
        return;
    }
    let dir = folder();
    short_recording(dir.path());
    let line = "process --station array.toml short.wav --telemetry telemetry.bin";
    assert_eq!(run(dir.path(), line, Stdio::piped()).code, Some(0));
    for line in PRINTING {
        let good = run(dir.path(), line, Stdio::piped());
        assert_eq!((good.code, good.stdout_bytes > 0), (Some(0), true), "{line}: {}", good.stderr);
        let full = File::options().write(true).open("/dev/full").unwrap();
        let ran = run(dir.path(), line, full.into());
        refused(line, &ran);
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let ran = run(dir.path(), line, writer.into());
        assert_eq!(ran.code, Some(0), "{line}: {}", ran.stderr);
        assert!(!ran.stderr.contains("panicked"), "{line}: {}", ran.stderr);
    }
}

#[test]
fn an_interrupted_command_leaves_nothing_unfinished_and_a_killed_one_is_cleared_up_after() {
    if !Path::new("/proc/self").exists() {
        seabearing_testkit::skipped("bad_input_commands", "no /proc here");
        return;
    }
    let dir = folder();
    let out = dir.path().join("o");
    let begin = || {
        let mut command = Command::new(BINARY);
        command.args(["simulate", "short.toml", "--out", "o"]).current_dir(dir.path());
        let child =
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let begun = Instant::now();
        while unfinished(&out).is_empty() {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing was begun");
            std::thread::sleep(Duration::from_millis(5));
        }
        child
    };
    let signal = |name: &str, pid: u32| {
        assert!(Command::new("kill").args(["-s", name, &pid.to_string()]).status().unwrap().success());
    };
    let mut child = begin();
    signal("TERM", child.id());
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(!child.wait().unwrap().success());
    assert_eq!(said, "seabearing: interrupted; what was unfinished is removed\n");
    assert!(std::fs::read_dir(&out).unwrap().next().is_none(), "nothing is left");

    let mut child = begin();
    signal("KILL", child.id());
    child.wait().unwrap();
    assert_eq!(unfinished(&out).len(), 1);
    let ran = run(dir.path(), "blob --station array.toml --out o/x.sbcf", Stdio::piped());
    assert_eq!((ran.code, ran.stderr.lines().count()), (Some(0), 1), "{}", ran.stderr);
    assert!(ran.stderr.contains("unfinished") && unfinished(&out).is_empty(), "{}", ran.stderr);
}
