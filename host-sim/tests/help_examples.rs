//! Every example that `--help` shows, run as it stands.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// What an example must come to.
#[derive(Debug, PartialEq)]
enum Expected {
    /// It runs to its end.
    Runs,
    /// Its arguments are taken; what it needs is not here (a device, an emulator, or files that other tests make).
    Lacks(&'static str),
    /// It waits for recorders until it is stopped, and says for what.
    Waits(&'static str),
}

use Expected::{Lacks, Runs, Waits};

/// Subcommands, and what becomes of each example, in the order of the help.
const EXAMPLES: [(&str, &[Expected]); 25] = [
    ("simulate", &[Runs, Runs]),
    ("process", &[Runs, Runs, Runs, Runs]),
    ("bearing", &[Runs]),
    ("track", &[Runs, Runs, Runs, Runs]),
    ("shaft-rate", &[Runs]),
    // What these give from whole networks and passages is in `network_cli` and `orient_ocean_bottom`.
    ("locate", &[Lacks("network.toml"), Lacks("network.toml"), Lacks("network.toml"), Lacks("network.toml")]),
    (
        "orient",
        &[
            Lacks("line.toml"),
            Lacks("array.toml"),
            Lacks("array.toml"),
            Lacks("obs.toml"),
            Lacks("obs.toml"),
            Lacks("obs.toml"),
        ],
    ),
    ("twin", &[Lacks("out/station.toml"), Lacks("out/station.toml"), Lacks("out/station.toml")]),
    (
        "base",
        &[
            Runs,
            Waits("/dev/ttyACM0"),
            Waits("127.0.0.1:"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Runs,
        ],
    ),
    (
        "base send",
        &[
            Lacks("east.key"),
            Lacks("east.key"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
        ],
    ),
    ("export", &[Runs, Runs, Runs, Runs]),
    ("demo", &[]),
    ("blob", &[Runs]),
    ("reproduce", &[Runs]),
    ("propagation", &[Lacks("rays.csv"), Runs]),
    ("propagation fit", &[Lacks("station.toml")]),
    ("schema", &[Runs, Runs]),
    ("station", &[]),
    ("station import", &[Lacks("network.xml"), Lacks("network.xml")]),
    ("completions", &[Runs]),
    ("man", &[Runs]),
    ("config", &[]),
    ("config check", &[Runs, Runs]),
    ("plan", &[Runs, Runs]),
    ("ais speeds", &[Runs]),
];

fn seabearing(words: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.args(words).current_dir(folder).env("COLUMNS", "400").stdin(Stdio::null());
    command.output().unwrap()
}

/// The command lines that a help text shows, without remarks and what a shell would do.
fn examples(help: &str) -> Vec<String> {
    let lines = help.lines().map(str::trim).filter(|l| l.starts_with("seabearing ") && !l.contains('<'));
    lines
        .map(|l| l.split([' ', '\t']).take_while(|w| !["#", "|", ">"].contains(w)))
        .map(|w| w.collect::<Vec<_>>().join(" "))
        .collect()
}

/// A command line as a shell would split it, `*` made the files that are there.
fn words(line: &str, folder: &Path) -> Vec<String> {
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
fn folder() -> tempfile::TempDir {
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
        &station.replace("rate_hz = 64000", "rate_hz = 16000").replace("25000", "7500"),
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
         0,0.00048515,0.00122482,0.00067107,0.00073967,0.00018592,-0.00055375\n",
    );
    let mut bearings = String::from("t_s,azimuth_deg\n");
    for k in 0..=200 {
        let x = 7.0 * f64::from(k) - 700.0;
        let _ = writeln!(bearings, "{k},{}", x.atan2(400.0).to_degrees().rem_euclid(360.0));
    }
    write("bearings.csv", &bearings);
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

#[test]
fn every_example_of_the_help_does_what_it_says() {
    let dir = folder();
    for (subcommand, expected) in EXAMPLES {
        let asked: Vec<&str> = subcommand.split(' ').chain(["--help"]).collect();
        let help = seabearing(&asked, dir.path());
        assert!(help.status.success(), "{subcommand}: {}", String::from_utf8_lossy(&help.stderr));
        let shown = examples(&String::from_utf8_lossy(&help.stdout));
        assert_eq!(shown.len(), expected.len(), "{subcommand}: {shown:#?}");
        for (line, expected) in shown.iter().zip(expected) {
            if let Waits(what) = expected {
                waits(line, what);
                continue;
            }
            let words = words(line, dir.path());
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            let out = match expected {
                Runs => seabearing(&words, dir.path()),
                Lacks(_) | Waits(_) => seabearing(&words, tempfile::tempdir().unwrap().path()),
            };
            let said = String::from_utf8_lossy(&out.stderr);
            match expected {
                Runs => assert!(out.status.success(), "{line}: {said}"),
                // 2 would be a mistake in the arguments.
                Lacks(what) | Waits(what) => {
                    assert!(
                        out.status.code() == Some(1) && said.contains(what),
                        "{line}: {:?} {said}",
                        out.status
                    );
                }
            }
        }
    }
    // None is left out.
    let help = seabearing(&["--help"], dir.path());
    let listed = String::from_utf8_lossy(&help.stdout).into_owned();
    let commands = listed.split("Commands:").nth(1).unwrap().split("Options:").next().unwrap();
    for command in
        commands.lines().filter_map(|l| l.split_whitespace().next()).filter(|c| *c != "help" && *c != "ais")
    {
        assert!(EXAMPLES.iter().any(|(name, _)| *name == command), "{command}");
    }
}

/// A base station that waits for recorders: it is there until it is stopped. The port is any free one.
fn waits(line: &str, what: &str) {
    let folder = tempfile::tempdir().unwrap();
    let words = words(&line.replace(":4500", ":0"), folder.path());
    let mut base = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    base.args(&words)
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut base = base.spawn().unwrap();
    let mut said = String::new();
    let mut errors = std::io::BufReader::new(base.stderr.take().unwrap());
    std::io::BufRead::read_line(&mut errors, &mut said).unwrap();
    let waits = base.try_wait().unwrap().is_none();
    base.kill().unwrap();
    base.wait().unwrap();
    assert!(waits && said.contains(what), "{line}: {said}");
}
