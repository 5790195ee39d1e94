//! Standard input in place of files, and how much is said on standard error.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// Runs the command in a folder with a file at its standard input.
fn seabearing(folder: &Path, input: &[u8], arguments: &[&str]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_seabearing"))
        .args(arguments)
        .current_dir(folder)
        .env("TMPDIR", temporary(folder))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let bytes = input.to_vec();
    // A command that fails early does not read it all.
    let feeder = std::thread::spawn(move || stdin.write_all(&bytes).is_ok());
    let out = child.wait_with_output().unwrap();
    feeder.join().unwrap();
    out
}

fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

/// A folder with two seconds of a simulated pass: `pass/station.toml` and its recording.
fn pass() -> (tempfile::TempDir, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    let scenario = std::fs::read_to_string(scenarios.join("short-pass.toml")).unwrap();
    std::fs::write(folder.path().join("pass.toml"), scenario.replace("duration_s = 5.0", "duration_s = 2.0"))
        .unwrap();
    std::fs::copy(scenarios.join("demo-station.toml"), folder.path().join("demo-station.toml")).unwrap();
    let out = seabearing(folder.path(), b"", &["simulate", "pass.toml", "--out", "pass"]);
    assert!(out.status.success(), "{}", said(&out));
    let wav = std::fs::read_dir(folder.path().join("pass")).unwrap().flatten().map(|e| e.path());
    let wav = wav.into_iter().find(|p| p.extension().is_some_and(|e| e == "wav")).unwrap();
    (folder, std::fs::read(wav).unwrap())
}

/// Where the command keeps what is temporary.
fn temporary(folder: &Path) -> PathBuf {
    let temporary = folder.join("tmp");
    std::fs::create_dir_all(&temporary).unwrap();
    temporary
}

#[test]
fn a_recording_its_records_and_tables_come_from_standard_input() {
    let (folder, wav) = pass();
    let run = |input: &[u8], arguments: &[&str]| {
        let out = seabearing(folder.path(), input, arguments);
        assert!(out.status.success(), "{arguments:?}: {}", said(&out));
        out
    };
    let start = ["--start", "2024-05-01T09:00:00Z"];
    let process = ["process", "--station", "pass/station.toml", "-"];
    let records = run(&wav, &[&process[..], &start].concat()).stdout;
    let names: Vec<_> = std::fs::read_dir(folder.path().join("pass")).unwrap().flatten().collect();
    let wav_name =
        names.iter().map(|e| e.path()).find(|p| p.extension().is_some_and(|e| e == "wav")).unwrap();
    let file = wav_name.to_string_lossy();
    assert_eq!(records, run(b"", &["process", "--station", "pass/station.toml", &file]).stdout);
    run(&records, &["export", "-", "--format", "csv", "--out", "all.csv"]);
    assert!(std::fs::read_to_string(folder.path().join("all.csv")).unwrap().contains("azimuth_deg"));
    let station = std::fs::read(folder.path().join("pass/station.toml")).unwrap();
    run(&station, &["config", "check", "-"]);
    let left = std::fs::read_dir(temporary(folder.path())).unwrap().count();
    assert_eq!(left, 0, "the copy of standard input is gone");
}

/// Mistakes in the arguments are known from what cannot be done: by their status, on one line, before anything is begun.
#[test]
fn mistakes_in_arguments_have_a_status_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let lines = [
        "base --page foo telemetry.bin",
        "base --metrics :1 telemetry.bin",
        "base --nmea 0.0.0.0:99999 telemetry.bin",
        "base --listen here --store kept",
        "base --mqtt http://localhost telemetry.bin",
        "base --start yesterday telemetry.bin",
        "base telemetry.bin --export tracks.xls",
        "process --station s.toml --levels 0 r.wav",
        "process --station s.toml --from noon r.wav",
        "process --station s.toml --from 2024-05-02T00:00:00Z --to 2024-05-01T00:00:00Z r.wav",
        "process --station s.toml --out d --share 3/2 r.wav",
        "process --station s.toml --name-offset UTC r.wav",
        "export records.jsonl --out tracks.xls",
        "export records.jsonl --out picks.xml --seed-id garbage",
        "track bearings.csv --sigma-deg 0",
        "ais speeds fixes.csv --lat-deg 91 --lon-deg 0",
        "station import network.xml --out -",
        "station import network.xml --at yesterday --out s.toml",
    ];
    for line in lines {
        let arguments: Vec<&str> = line.split(' ').collect();
        let out = seabearing(folder.path(), b"", &arguments);
        assert!(out.status.code() == Some(2) && said(&out).lines().count() == 1, "{line}: {}", said(&out));
    }
    let left = std::fs::read_dir(folder.path()).unwrap().flatten().map(|e| e.file_name());
    assert!(left.into_iter().all(|name| name == "tmp"), "something was begun");
}

#[test]
fn a_station_file_comes_from_standard_input_and_goes_to_standard_output() {
    let (folder, _) = pass();
    let station = std::fs::read(folder.path().join("pass/station.toml")).unwrap();
    let named = seabearing(folder.path(), b"", &["process", "--station", "pass/station.toml", "pass"]);
    let piped = seabearing(folder.path(), &station, &["process", "--station", "-", "pass"]);
    assert!(
        named.status.success() && !named.stdout.is_empty() && named.stdout == piped.stdout,
        "{}",
        said(&piped)
    );
    let blob = seabearing(folder.path(), &station, &["blob", "--station", "-", "--out", "-"]);
    let kept = seabearing(folder.path(), &station, &["blob", "--station", "pass/station.toml", "--out", "b"]);
    assert!(blob.status.success() && kept.status.success(), "{}", said(&blob));
    assert_eq!(blob.stdout, std::fs::read(folder.path().join("b")).unwrap());
}

#[test]
fn pictures_are_what_is_asked_for() {
    let (folder, wav) = pass();
    let process = ["process", "--station", "pass/station.toml", "-", "--plots", "drawn"];
    let names = |more: &[&str]| {
        let out = seabearing(folder.path(), &wav, &[&process[..], more].concat());
        assert!(out.status.success(), "{}", said(&out));
        let entries = std::fs::read_dir(folder.path().join("drawn")).unwrap().flatten();
        let mut names: Vec<_> = entries.map(|e| e.file_name().into_string().unwrap()).collect();
        names.sort();
        std::fs::remove_dir_all(folder.path().join("drawn")).unwrap();
        names
    };
    assert_eq!(names(&[]), ["bearings.svg", "correlations.svg", "tracks.svg"]);
    let both =
        ["bearings.pdf", "bearings.png", "correlations.pdf", "correlations.png", "tracks.pdf", "tracks.png"];
    assert_eq!(names(&["--pictures", "png,pdf"]), both);
    let out = seabearing(folder.path(), b"", &["--pictures", "gif", "process", "--station", "x", "-"]);
    assert!(out.status.code() == Some(2) && said(&out).contains("svg, png, pdf"), "{}", said(&out));
}

#[test]
fn what_is_wrong_with_standard_input_is_said_by_its_name() {
    let (folder, _) = pass();
    for (input, arguments, words) in [
        (
            &b"no recording"[..],
            &["process", "--station", "pass/station.toml", "-"][..],
            "standard input: not a recording",
        ),
        (b"", &["process", "--station", "pass/station.toml", "-"], "standard input: empty file"),
        (b"t_s,azimuth_deg\n1,x\n", &["track", "-"], "standard input"),
        (b"[station\n", &["config", "check", "-"], "standard input"),
        (b"{}\nno record\n", &["export", "-", "--format", "csv", "--out", "x.csv"], "standard input, line 2"),
    ] {
        let out = seabearing(folder.path(), input, arguments);
        let said = said(&out);
        assert!(!out.status.success() && said.contains(words), "{arguments:?}: {said}");
    }
}

#[test]
fn as_much_is_said_as_is_asked_for() {
    let (folder, wav) = pass();
    std::fs::write(folder.path().join("notes.txt"), "no recording").unwrap();
    let run = |more: &[&str]| {
        let process = [
            "process",
            "--station",
            "pass/station.toml",
            "-",
            "notes.txt",
            "--start",
            "2024-05-01T09:00:00Z",
        ];
        let out = seabearing(folder.path(), &wav, &[&process[..], more].concat());
        assert!(out.status.success(), "{}", said(&out));
        said(&out)
    };
    assert!(run(&[]).contains("seabearing: left out notes.txt") && !run(&[]).contains("Wav"));
    assert!(run(&["-v"]).contains("seabearing: standard input: Wav"));
    assert!(run(&["-q"]).contains("left out notes.txt"));
    assert_eq!(run(&["-qq"]), "");
    // What ends the command is always said.
    let out = seabearing(folder.path(), b"", &["-qqq", "process", "--station", "nothing.toml", "-"]);
    assert!(said(&out).contains("nothing.toml"));
    // Information is not a warning.
    let records = b"{\"type\":\"end\",\"t_s\":1.0}\n";
    let export = ["export", "-", "--format", "jsonl", "--out", "x.jsonl"];
    assert!(said(&seabearing(folder.path(), records, &export)).contains("1 records to x.jsonl"));
    assert_eq!(said(&seabearing(folder.path(), records, &[&["--quiet"], &export[..]].concat())), "");
}
