//! What the examples of help and documents stand on: a folder with the files that they name.

use std::fmt::Write as _;
use std::io::BufRead;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

pub fn seabearing(words: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.args(words).current_dir(folder).env("COLUMNS", "400").stdin(Stdio::null());
    command.output().unwrap()
}

/// A command line as a shell would split it, `*` made the files that are there.
pub fn words(line: &str, folder: &Path) -> Vec<String> {
    let mut out = Vec::new();
    for word in line.split_whitespace().skip(1) {
        let Some((before, after)) = word.split_once('*') else {
            out.push(word.to_owned());
            continue;
        };
        let mut found: Vec<String> = std::fs::read_dir(folder.join(before))
            .into_iter()
            .flatten()
            .flatten()
            .map(|e| format!("{before}{}", e.file_name().to_string_lossy()))
            .filter(|name| name.ends_with(after))
            .collect();
        found.sort();
        out.extend(if found.is_empty() { vec![word.to_owned()] } else { found });
    }
    out
}

/// The files that the examples name.
pub fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    std::fs::create_dir(dir.path().join("scenarios")).unwrap();
    std::fs::copy(scenarios.join("ocean-profile.csv"), dir.path().join("profile.csv")).unwrap();
    // The scenario of the example as it is, but for its length and rate.
    let scenario = std::fs::read_to_string(scenarios.join("demo.toml")).unwrap();
    write("scenarios/demo.toml", &scenario.replace("duration_s = 200.0", "duration_s = 40.0"));
    let station = std::fs::read_to_string(scenarios.join("demo-station.toml")).unwrap();
    write(
        "scenarios/demo-station.toml",
        &(station.replace("rate_hz = 64000", "rate_hz = 16000").replace("25000", "7500")
            + "\n[levels]\nevery_s = 10\n"),
    );
    let out = seabearing(&["simulate", "scenarios/demo.toml", "--out", "east"], dir.path());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let wav = words("x east/*.wav", dir.path()).remove(0);
    for (from, to) in [("east/station.toml", "east.toml"), (&wav, "recording.wav"), (&wav, "pass.wav")] {
        std::fs::copy(dir.path().join(from), dir.path().join(to)).unwrap();
    }
    std::fs::copy(dir.path().join("east.toml"), dir.path().join("station.toml")).unwrap();
    let made = ["process", "--station", "east.toml", "recording.wav", "--telemetry", "telemetry.bin"];
    let made = seabearing(&made, dir.path());
    assert!(made.status.success());
    std::fs::write(dir.path().join("records.jsonl"), &made.stdout).unwrap();
    let kept = [
        "base",
        "telemetry.bin",
        "--store",
        "out/base",
        "--station",
        "east.toml",
        "--start",
        "2024-05-01T09:00:00Z",
    ];
    assert!(seabearing(&kept, dir.path()).status.success());
    write(
        "tdoa.csv",
        "t_s,tdoa01_s,tdoa02_s,tdoa03_s,tdoa12_s,tdoa13_s,tdoa23_s\n\
         0,-0.00048515,-0.00122482,-0.00067107,-0.00073967,-0.00018592,0.00055375\n",
    );
    let mut bearings = String::from("t_s,azimuth_deg\n");
    for k in 0..=200 {
        let x = 7.0 * f64::from(k) - 700.0;
        let _ = writeln!(bearings, "{k},{}", x.atan2(400.0).to_degrees().rem_euclid(360.0));
    }
    write("bearings.csv", &bearings);
    // An ocean-bottom station's azimuths of a vessel that passes far away.
    let mut azimuths = String::new();
    for k in 0..=200 {
        let t_s = 60.0 * f64::from(k);
        let azimuth = ((t_s - 6000.0) / 8000.0).atan().to_degrees() + 90.0;
        let _ = writeln!(
            azimuths,
            "{{\"type\":\"azimuth\",\"t_s\":{t_s},\"azimuth_deg\":{azimuth},\"sd_deg\":1.0,\"detected\":true,\"source\":\"tonal\"}}"
        );
    }
    write("obs.jsonl", &azimuths);
    write("gps.csv", "t_s,x_m,y_m\n0,-700,400\n200,700,400\n");
    let mut ais = String::from("Time,MMSI,Latitude_degrees,Longitude_degrees,COG_degrees,SOG_knots\n");
    for (vessel, speed) in [(7, 10), (8, 14)] {
        for (minute, lon) in [(30, -1.260), (32, -1.253), (34, -1.246), (36, -1.240)] {
            let _ = writeln!(ais, "2012-12-05 19:{minute}:00,{vessel},50.751,{lon},90,{speed}");
        }
    }
    write("traffic.csv", &ais);
    dir
}

/// A base station that waits for recorders: it is there until it is stopped, and says for what it waits.
pub fn waits(words: &[String], folder: &Path, what: &str) {
    let mut base = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    base.args(words).current_dir(folder).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut base = base.spawn().unwrap();
    let errors = std::io::BufReader::new(base.stderr.take().unwrap());
    let (tell, told) = mpsc::channel();
    std::thread::spawn(move || errors.lines().map_while(Result::ok).try_for_each(|line| tell.send(line)));
    let (mut said, until) = (String::new(), Instant::now() + Duration::from_secs(30));
    while !said.contains(what) {
        let Ok(line) = told.recv_timeout(until.saturating_duration_since(Instant::now())) else { break };
        said += &line;
    }
    let waits = base.try_wait().unwrap().is_none();
    base.kill().unwrap();
    base.wait().unwrap();
    assert!(waits && said.contains(what), "{words:?}: {said}");
}
