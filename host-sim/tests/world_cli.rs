//! `simulate`, `process` and `base` at the command line: what they print, what they leave, and one clear line on bad
//! input.

use seabearing_core::wire::{Encoder, End, Hello, Message, SCHEMA_HASH, WIRE_VERSION};
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Output, Stdio};

const STATION: &str = r#"
[station]
id = 3
name = "reef"
kind = "array"
position = { lat_deg = 49.0, lon_deg = -123.0, depth_m = 60.0 }
[sampling]
rate_hz = 16000
[array]
hydrophones_m = [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]]
band_hz = [50.0, 7000.0]
"#;

const SCENARIO: &str = r#"
kind = "array"
station = "station.toml"
duration_s = 4.0
start_utc = "2024-05-01T09:00:00Z"
recorder = { file_s = 2.0 }
[[vessels]]
name = "ferry"
straight = { cpa_time_s = 2.0, cpa_range_m = 200.0, heading_deg = 30.0, speed_m_s = 7.0, side = "starboard" }
source_level_db = 170.0
"#;

fn seabearing() -> Command {
    Command::new(env!("CARGO_BIN_EXE_seabearing"))
}

fn run(args: &[&str], folder: &Path) -> Output {
    seabearing().args(args).current_dir(folder).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A failure with exactly one line on stderr, which holds all these words.
fn fails(args: &[&str], folder: &Path, words: &[&str]) {
    let out = run(args, folder);
    let said = text(&out.stderr);
    assert!(!out.status.success(), "{args:?} succeeded");
    assert_eq!(said.lines().count(), 1, "{args:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{args:?}: `{word}` is not in: {said}");
    }
}

/// A folder with a station, a scenario and its simulation in `out`.
fn simulated() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("station.toml"), STATION).unwrap();
    std::fs::write(dir.path().join("pass.toml"), SCENARIO).unwrap();
    let out = run(&["simulate", "pass.toml", "--out", "out", "--json"], dir.path());
    assert!(out.status.success(), "{}", text(&out.stderr));
    dir
}

const FIRST: &str = "out/reef_20240501T090000.000000Z.wav";
const SECOND: &str = "out/reef_20240501T090002.000000Z.wav";

#[test]
fn a_simulated_pass_is_processed_and_drawn() {
    let dir = simulated();
    for file in [FIRST, SECOND, "out/truth.csv", "out/station.toml"] {
        assert!(dir.path().join(file).is_file(), "{file}");
    }
    let args =
        ["process", "--station", "out/station.toml", "out", "--plots", "plots", "--truth", "out/truth.csv"];
    let out = run(&args, dir.path());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let bearings = text(&out.stdout).lines().filter(|l| l.contains(r#""type":"bearing""#)).count();
    assert!(bearings >= 5, "{bearings} bearings in 4 s");
    assert!(text(&out.stdout).contains("2024-05-01T09:00:0"));
    for picture in ["bearings", "tracks", "errors", "correlations"] {
        let svg = std::fs::read_to_string(dir.path().join(format!("plots/{picture}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"), "{picture}");
    }
}

#[test]
fn bad_scenarios_are_named_by_key_and_line() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("station.toml"), STATION).unwrap();
    let fails_with = |change: (&str, &str), words: &[&str]| {
        assert!(SCENARIO.contains(change.0));
        std::fs::write(dir.path().join("s.toml"), SCENARIO.replacen(change.0, change.1, 1)).unwrap();
        fails(&["simulate", "s.toml", "--out", "out"], dir.path(), words);
        assert!(!dir.path().join("out").exists(), "{change:?} left something behind");
    };
    fails_with(("kind = \"array\"\n", ""), &["s.toml", "kind"]);
    fails_with(("\"array\"", "\"sonar\""), &["s.toml, line 2", "sonar", "array or obs"]);
    fails_with(("duration_s", "duration"), &["s.toml", "line 4", "duration"]);
    fails_with(("4.0", "-4.0"), &["s.toml, line 4", "duration_s"]);
    fails_with(("4.0", "four"), &["s.toml, line 4"]);
    fails_with(("station.toml", "elsewhere.toml"), &["s.toml, line 3", "elsewhere.toml"]);
    fails_with(("2024-05-01T09:00:00Z", "yesterday"), &["s.toml, line 5", "yesterday"]);
    fails_with(("file_s", "files"), &["s.toml, line 6", "files"]);
    fails_with(("straight = {", "track = \"t.csv\"\nstraight = {"), &["s.toml", "either"]);
    fails_with(("side = \"starboard\"", "side = \"left\""), &["s.toml, line 9", "left"]);
    fails(&["simulate", "none.toml", "--out", "out"], dir.path(), &["none.toml"]);
}

#[test]
fn an_array_too_long_for_its_rate_is_simulated_with_a_line() {
    let dir = simulated();
    // Forty times as long: 81 m.
    let places =
        "[[0.0, 42.492, -15.024], [36.8, -21.248, -15.024], [-36.8, -21.248, -15.024], [0.0, 0.0, 45.068]]";
    let (before, rest) = STATION.split_once("hydrophones_m = ").unwrap();
    let (_, after) = rest.split_once('\n').unwrap();
    let long = format!("{before}hydrophones_m = {places}\n{after}");
    std::fs::write(dir.path().join("station.toml"), &long).unwrap();
    let mut said = Vec::new();
    for (line, done) in
        [("simulate pass.toml --out long", true), ("process --station station.toml out", false)]
    {
        let out = run(&line.split(' ').collect::<Vec<_>>(), dir.path());
        let told = text(&out.stderr);
        assert_eq!(out.status.success(), done, "{line}: {told}");
        let told: Vec<&str> = told.lines().filter(|l| l.contains("samples across the array")).collect();
        assert!(
            told.len() == 1 && told[0].contains("a lower rate, or hydrophones nearer together"),
            "{told:?}"
        );
        said.push(told[0].rsplit_once("station.toml, ").unwrap().1.to_owned());
    }
    assert!(said[0].starts_with(&*said[1]) && said[0].contains("process what is written"), "{said:?}");
    assert!(dir.path().join("long/truth.csv").exists());
}

#[test]
fn a_track_file_with_a_bad_row_is_used_without_it() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("station.toml"), STATION).unwrap();
    std::fs::write(dir.path().join("t.csv"), "t_s,x_m,y_m\n0,100,0\n1,oops,0\n2,100,20\n").unwrap();
    let scenario = SCENARIO
        .lines()
        .map(|l| if l.starts_with("straight") { "track = \"t.csv\"" } else { l })
        .collect::<Vec<_>>()
        .join("\n");
    std::fs::write(dir.path().join("s.toml"), scenario).unwrap();
    let out = run(&["simulate", "s.toml", "--out", "out"], dir.path());
    assert!(out.status.success(), "{}", text(&out.stderr));
    assert!(text(&out.stderr).contains("t.csv, line 3") && text(&out.stderr).contains("oops"));
    std::fs::write(dir.path().join("t.csv"), "t_s,x_m,y_m\n0,100,0\n").unwrap();
    fails(&["simulate", "s.toml", "--out", "out2"], dir.path(), &["t.csv", "two points"]);
}

#[test]
fn bad_recordings_and_stations_are_one_clear_line() {
    let dir = simulated();
    let write = |name: &str, bytes: &[u8]| std::fs::write(dir.path().join(name), bytes).unwrap();
    write("notes.wav", b"no sound in here at all");
    write("empty.wav", b"");
    write("wrong.toml", STATION.replace("16000", "32000").as_bytes());
    write("unknown.toml", STATION.replace("rate_hz", "rate_khz").as_bytes());
    write("flat.toml", STATION.replace("1.1267", "-0.3756").as_bytes());
    write("twin.toml", STATION.replace("[0.92, -0.5312", "[0.0, 1.0623").as_bytes());
    for (station, input, words) in [
        ("station.toml", "notes.wav", &["notes.wav", "not a recording"][..]),
        ("station.toml", "empty.wav", &["empty.wav", "empty file"]),
        ("station.toml", "absent.wav", &["absent.wav"]),
        ("wrong.toml", FIRST, &["16000", "32000", "rate_hz"]),
        ("unknown.toml", FIRST, &["unknown.toml, line 8", "rate_khz"]),
        ("flat.toml", FIRST, &["flat.toml, line 10", "plane"]),
        ("twin.toml", FIRST, &["twin.toml, line 10", "same place"]),
        ("nowhere.toml", FIRST, &["nowhere.toml"]),
    ] {
        fails(&["process", "--station", station, input], dir.path(), words);
    }
}

#[test]
fn a_truncated_file_and_a_foreign_one_do_not_stop_the_rest() {
    let dir = simulated();
    let bytes = std::fs::read(dir.path().join(FIRST)).unwrap();
    std::fs::write(dir.path().join(FIRST), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(dir.path().join("notes.wav"), b"no sound in here at all").unwrap();
    let out = run(&["process", "--station", "station.toml", FIRST, "notes.wav", SECOND], dir.path());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let said = text(&out.stderr);
    assert!(said.contains("notes.wav") && said.contains(FIRST) && said.contains("cut short"), "{said}");
    let records = text(&out.stdout);
    let bearings = |from: f64, to: f64| {
        let values = records.lines().map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap());
        values.filter(|r| r["type"] == "bearing" && (from..to).contains(&r["t_s"].as_f64().unwrap())).count()
    };
    assert!(bearings(0.0, 1.0) >= 1 && bearings(2.0, 4.0) >= 2, "{records}");
    assert!(records.contains(r#""code":"Gap""#), "{records}");
}

#[test]
fn a_bad_channel_is_reported_and_the_time_before_it_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("station.toml"), STATION).unwrap();
    for (name, fault, code) in [
        ("dead", "kind = \"dead\"\nchannel = 1", "DeadChannel"),
        ("stuck", "kind = \"stuck\"\nchannel = 3", "DeadChannel"),
        ("nan", "kind = \"nan\"\nchannel = 0", "Invalid"),
        ("loud", "kind = \"loud\"\nchannel = 2\ngain_db = 90.0", "Clipping"),
    ] {
        let longer = SCENARIO.replace("4.0", "16.0").replace("file_s = 2.0", "encoding = \"float\"");
        std::fs::write(dir.path().join("s.toml"), format!("{longer}[[faults]]\n{fault}\nfrom_s = 6.0\n"))
            .unwrap();
        assert!(run(&["simulate", "s.toml", "--out", name], dir.path()).status.success());
        let out = run(&["process", "--station", "station.toml", name], dir.path());
        assert!(out.status.success(), "{name}: {}", text(&out.stderr));
        let records: Vec<serde_json::Value> =
            text(&out.stdout).lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let of = |kind: &str| records.iter().filter(move |r| r["type"] == kind).cloned().collect::<Vec<_>>();
        let early = of("bearing").iter().filter(|b| b["t_s"].as_f64().unwrap() < 5.5).count();
        assert!(early >= 8, "{name}: {early} bearings before the fault");
        let faults = of("fault");
        assert!(
            faults.iter().any(|f| f["code"] == code && f["t_s"].as_f64().unwrap() > 5.5),
            "{name}: {faults:?}"
        );
        // Every instant is accounted for: processed, or in exactly one loss bucket.
        let health = of("health").pop().unwrap();
        let sum: u64 = [
            "processed",
            "lost_gap",
            "lost_overlap",
            "lost_invalid",
            "lost_clipped",
            "lost_dead_channel",
            "lost_remainder",
        ]
        .iter()
        .map(|k| health[*k].as_u64().unwrap())
        .sum();
        assert_eq!(sum, 16 * 16_000, "{name}: {health}");
    }
}

#[test]
fn a_recording_without_a_usable_sample_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("station.toml"), STATION).unwrap();
    std::fs::write(
        dir.path().join("s.toml"),
        // Three hydrophones go on, two cannot.
        format!(
            "{SCENARIO}[[faults]]\nkind = \"dead\"\nchannel = 1\n[[faults]]\nkind = \"dead\"\nchannel = 2\n"
        ),
    )
    .unwrap();
    assert!(run(&["simulate", "s.toml", "--out", "out"], dir.path()).status.success());
    fails(&["process", "--station", "station.toml", "out"], dir.path(), &["no sample", "dead channel"]);
}

/// A session of a recorder: Hello, then frames a second of samples apart.
fn session(frames: u64) -> Vec<u8> {
    let mut encoder = Encoder::default();
    let hello = Hello {
        wire_version: WIRE_VERSION,
        schema_hash: SCHEMA_HASH,
        config_hash: 1,
        version: (0, 1, 0),
        station: 3,
        kind: 0,
        rate_hz: 1000.0,
        reset_cause: 0,
    };
    let mut bytes = encoder.frame(&Message::Hello(hello)).to_vec();
    for i in 1..=frames {
        bytes.extend_from_slice(encoder.frame(&Message::End(End { index: i * 1000, frames: 0 })));
    }
    bytes
}

/// The records that a recorder sent, without what the base station notes of its lines.
fn of_recorder(lines: &str) -> Vec<serde_json::Value> {
    let records = lines.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    records.filter(|r| r["type"] != "line" && r["type"] != "lost").collect()
}

fn base(args: &[&str], folder: &Path, input: &[u8]) -> Output {
    let mut child = seabearing()
        .arg("base")
        .args(args)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(input).unwrap();
    child.wait_with_output().unwrap()
}

#[test]
fn a_damaged_stream_keeps_what_is_whole_and_counts_the_rest() {
    let dir = tempfile::tempdir().unwrap();
    let mut bytes = session(30);
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    let out = base(&["-", "--json"], dir.path(), &bytes);
    assert!(out.status.success(), "{}", text(&out.stderr));
    // One flipped bit costs one frame, or two where it hits the delimiter between them.
    let records = of_recorder(&text(&out.stdout)).len();
    assert!((29..=30).contains(&records), "{records}");
    let said = text(&out.stderr);
    assert!(said.contains(&format!("{records} frames, {} lost, 1 damaged", 31 - records)), "{said}");
}

#[test]
fn no_telemetry_is_an_error_that_says_so() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("notes.txt"), "nothing a recorder would say").unwrap();
    for (args, words) in [
        (&["base", "notes.txt", "--json"][..], &["no telemetry frame in 28 bytes"][..]),
        (&["base", "absent.bin"], &["absent.bin"]),
        // Without `--once` it waits for the device.
        (&["base", "--serial", "/dev/no-such-port", "--once"], &["/dev/no-such-port"]),
        (&["base", "notes.txt", "--export", "x.kml"], &["x.kml", "--station"]),
        (&["base", "notes.txt", "--export", "x.doc"], &["x.doc", ".csv"]),
        (&["base", "notes.txt", "--start", "noon"], &["noon"]),
    ] {
        let out = run(args, dir.path());
        let said = text(&out.stderr);
        assert!(!out.status.success() && words.iter().all(|w| said.contains(w)), "{args:?}: {said}");
    }
}

#[test]
fn a_base_station_started_again_goes_on_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let stream = session(40);
    // Cut within a frame: the rest of it is lost with the connection, everything else is kept.
    let cut = stream.len() / 2 + 3;
    let before = base(&["-", "--store", "store", "--json"], dir.path(), &stream[..cut]);
    let after = base(&["-", "--store", "store", "--json"], dir.path(), &stream[cut..]);
    assert!(before.status.success() && after.status.success());
    assert!(text(&after.stderr).contains("going on after"));
    assert!(run(&["export", "--store", "store", "--out", "kept.jsonl"], dir.path()).status.success());
    let kept = of_recorder(&std::fs::read_to_string(dir.path().join("kept.jsonl")).unwrap());
    let sequences: Vec<u64> = kept.iter().map(|r| r["sequence"].as_u64().unwrap()).collect();
    assert_eq!(sequences.len(), 40, "one frame of 41 was cut");
    assert!(sequences.windows(2).all(|w| w[1] > w[0]));
    assert_eq!(of_recorder(&(text(&before.stdout) + &text(&after.stdout))), kept);
    // A file cannot be asked whose it is, and nothing is counted lost between two that do not say it.
    assert!(text(&after.stderr).contains("20 frames, 0 lost, 1 damaged"), "{}", text(&after.stderr));
    assert!(
        kept[..20].iter().all(|r| r["station"] == 3) && kept[20..].iter().all(|r| r["station"].is_null())
    );
}

#[test]
fn telemetry_comes_over_tcp_from_either_side() {
    let dir = tempfile::tempdir().unwrap();
    // We listen, the base station calls and asks who we are.
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let child = seabearing()
        .args(["base", "--tcp", &address, "--once", "--identify", "--json"])
        .current_dir(dir.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut peer, _) = listener.accept().unwrap();
    peer.set_read_timeout(Some(std::time::Duration::from_secs(30))).unwrap();
    let mut asked = [0u8; 10];
    peer.read_exact(&mut asked).unwrap();
    assert_eq!(asked[9], 0, "a whole frame");
    peer.write_all(&session(2)).unwrap();
    drop(peer);
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success());
    assert_eq!(of_recorder(&text(&out.stdout)).len(), 3);
}
