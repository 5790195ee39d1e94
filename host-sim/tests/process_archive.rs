//! Archives: every day of a station on its own, at once or one after another, interrupted and gone on with.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing::recording::write::{Encoding, wav};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

const STATION: &str = "[station]\nid = 1\nname = \"east\"\nkind = \"array\"\n[sampling]\nrate_hz = 16000\n[array]\n\
    hydrophones_m = [[0.0,1.06,-0.38],[0.92,-0.53,-0.38],[-0.92,-0.53,-0.38],[0.0,0.0,1.13]]\n";

/// By how many samples each hydrophone hears a wave from azimuth 328°, elevation 40°, at 1500 m/s, before the last of them.
const EARLIER: [usize; 4] = [15, 0, 8, 18];

/// Noise from that direction, so many seconds on each of five days, one of them over midnight.
fn archive(folder: &Path, seconds: usize) {
    std::fs::write(folder.join("east.toml"), STATION).unwrap();
    for (day, time) in [(1, "120000"), (2, "120000"), (3, "000000"), (4, "235958"), (7, "010000")] {
        let mut noise = ChaCha8Rng::seed_from_u64(day);
        let frames = 16_000 * seconds;
        let codes: Vec<i32> = (0..frames + 100).map(|_| noise.random_range(-100_000..100_000)).collect();
        let frames = (0..frames)
            .map(|i| EARLIER.map(|earlier| codes[i + earlier] + noise.random_range(-20_000..20_000)));
        let path = folder.join(format!("data/2024-05/{day}/a_2024050{day}_{time}.wav"));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        wav(&path, 16_000, Encoding::Int24, frames).unwrap();
    }
}

fn command(folder: &Path, more: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.args(["process", "--station", "east.toml", "data"]).args(more.split_whitespace());
    command.current_dir(folder).stdin(Stdio::null());
    command
}

fn run(folder: &Path, more: &str) -> Output {
    command(folder, more).output().unwrap()
}

/// Names and contents of the files in a folder.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap())).collect()
}

#[test]
fn units_are_the_same_at_once_one_by_one_and_shared_out() {
    let dir = tempfile::tempdir().unwrap();
    archive(dir.path(), 3);
    let out = |more: &str| {
        let ran = run(dir.path(), more);
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        String::from_utf8_lossy(&ran.stderr).into_owned()
    };
    let said = out("--out serial --jobs 1");
    assert_eq!(said, "seabearing: 6 station-days processed, 0 were there, 0 failed\n");
    let serial = contents(&dir.path().join("serial"));
    let days = ["01", "02", "03", "04", "05", "07"];
    let names: Vec<String> = days
        .iter()
        .flat_map(|d| ["jsonl", "manifest.json"].map(|e| format!("east.2024-05-{d}.{e}")))
        .collect();
    assert!(serial.keys().eq(names.iter()), "{:?}", serial.keys());
    assert!(serial.iter().all(|(name, bytes)| !name.ends_with("jsonl") || bytes.len() > 1000));
    out("--out parallel --jobs 3");
    assert!(contents(&dir.path().join("parallel")) == serial);
    for share in ["2/2", "1/2"] {
        let said = out(&format!("--out shared --share {share}"));
        assert!(said.contains("3 station-days processed, 0 were there"), "{said}");
    }
    assert!(contents(&dir.path().join("shared")) == serial);
    // A day is what its span alone gives.
    let day = run(dir.path(), "--from 2024-05-02T00:00:00Z --to 2024-05-03T00:00:00Z");
    assert!(day.stdout == serial["east.2024-05-02.jsonl"]);
    // Made of something else, it is made anew, and nothing else is.
    let file = dir.path().join("data/2024-05/2/a_20240502_120000.wav");
    std::fs::write(&file, &std::fs::read(&file).unwrap()[..96_000]).unwrap();
    assert!(out("--out serial").contains("1 station-days processed, 5 were there"));
    assert!(contents(&dir.path().join("serial"))["east.2024-05-02.jsonl"] != serial["east.2024-05-02.jsonl"]);
    assert!(out("--out serial --name-offset +05:00").contains(" 0 were there"));
    let missed = run(dir.path(), "--out x --share 3/2");
    assert!(
        !missed.status.success() && String::from_utf8_lossy(&missed.stderr).contains("'3/2' for '--share")
    );
}

#[test]
fn killed_at_random_moments_and_gone_on_with_the_bytes_are_the_same() {
    let dir = tempfile::tempdir().unwrap();
    archive(dir.path(), 3);
    let begun = std::time::Instant::now();
    assert!(run(dir.path(), "--out whole").status.success());
    let whole_s = begun.elapsed().as_secs_f64();
    let whole = contents(&dir.path().join("whole"));
    let mut moments = ChaCha8Rng::seed_from_u64(20);
    let mut killed = 0;
    for round in 0..4 {
        let out = format!("--out killed{round}");
        // Five kills, earlier and earlier in what is left, and then a run to the end.
        for _ in 0..5 {
            let mut child = command(dir.path(), &out).stderr(Stdio::null()).spawn().unwrap();
            std::thread::sleep(Duration::from_secs_f64(moments.random_range(0.0..0.5 * whole_s)));
            killed += u32::from(child.try_wait().unwrap().is_none());
            child.kill().unwrap();
            child.wait().unwrap();
        }
        assert!(run(dir.path(), &out).status.success());
        assert!(contents(&dir.path().join(format!("killed{round}"))) == whole, "round {round}");
    }
    assert!(killed >= 8, "only {killed} of 20 came before the end");
}

/// Sends the signal of Ctrl-C, or, where this was started to ignore that one and so are its children (as in the background of a shell), the
/// one that ends.
fn interrupt(child: &Child) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored =
        status.lines().find_map(|l| u64::from_str_radix(l.strip_prefix("SigIgn:")?.trim(), 16).ok());
    let signal = if ignored.is_some_and(|mask| mask & 2 != 0) { "TERM" } else { "INT" };
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-s", signal, &pid]).status().unwrap().success());
}

/// Starts what `spawn` makes, interrupts it in the middle of the time that it takes undisturbed, and gives what it said. One that
/// came to its end before, or had not begun to listen, is begun anew: on a busy machine this process may be looked after late.
fn interrupted(mut spawn: impl FnMut() -> Child) -> String {
    let begun = std::time::Instant::now();
    assert!(spawn().wait_with_output().unwrap().status.success());
    let whole_s = begun.elapsed().as_secs_f64();
    let mut others = Vec::new();
    for n in 0..30 {
        let mut child = spawn();
        std::thread::sleep(Duration::from_secs_f64(whole_s * (0.3 + 0.6 * (f64::from(n) * 0.618).fract())));
        interrupt(&child);
        let mut said = String::new();
        std::io::Read::read_to_string(&mut child.stderr.take().unwrap(), &mut said).unwrap();
        if !child.wait().unwrap().success() && said.starts_with("seabearing: interrupted: ") {
            return said;
        }
        others.push(said);
    }
    panic!("none of 30 runs was interrupted: {others:?}");
}

#[test]
#[cfg(unix)]
fn an_interrupted_run_keeps_what_is_done_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    // Long enough that an interruption comes before the end.
    archive(dir.path(), 60);
    let out = dir.path().join("o");
    let said = interrupted(|| {
        let _ = std::fs::remove_dir_all(&out);
        command(dir.path(), "--out o --jobs 1").stderr(Stdio::piped()).spawn().unwrap()
    });
    assert!(said.contains("of 6 station-days are done"), "{said}");
    assert!(contents(&out).keys().all(|name| !name.starts_with('.')));

    // A single recording, long enough to be interrupted: its records and telemetry are whole.
    let frames = (0..16_000 * 120)
        .map(|i| EARLIER.map(|earlier| ((i + earlier) as i32).wrapping_mul(0x9e37_79b9_u32 as i32) >> 12));
    wav(&dir.path().join("long.wav"), 16_000, Encoding::Int24, frames).unwrap();
    let said = interrupted(|| {
        Command::new(env!("CARGO_BIN_EXE_seabearing"))
            .args(["process", "--station", "east.toml", "long.wav", "--telemetry", "t.bin"])
            .current_dir(dir.path())
            .stdout(std::fs::File::create(dir.path().join("r.jsonl")).unwrap())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    });
    assert!(
        said.starts_with("seabearing: interrupted: the records of the first ") && said.lines().count() == 1,
        "{said}"
    );
    let records = std::fs::read_to_string(dir.path().join("r.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(records.lines().last().unwrap()).unwrap();
    assert!(last["type"] == "end" && last["t_s"].as_f64().unwrap() < 120.0, "{last}");
    let again = Command::new(env!("CARGO_BIN_EXE_seabearing"))
        .args(["base", "t.bin", "--json"])
        .current_dir(dir.path())
        .output()
        .unwrap();
    assert_eq!(String::from_utf8_lossy(&again.stdout).lines().count(), records.lines().count());
}
