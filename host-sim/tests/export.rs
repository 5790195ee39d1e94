//! `seabearing export` as a person runs it: a store that `seabearing base` wrote, as every format, by time and station.

use seabearing_core::wire::{Encoder, Hello, Message, SCHEMA_HASH, Track, WIRE_VERSION};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const STATION: &str = "[station]\nid = 7\nname = \"west\"\nkind = \"array\"\n\
    position = { lat_deg = 49.0, lon_deg = -123.0, depth_m = 150.0 }\n[sampling]\nrate_hz = 64000\n[array]\n\
    hydrophones_m = [[0.925, 0, 0], [-0.925, 0, 0], [0, 1.6, 0], [0, 0.5, 1.5]]\n";

fn run(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).current_dir(folder).output().unwrap()
}

fn succeeds(folder: &Path, args: &[&str]) {
    let out = run(folder, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
}

/// What a recorder sends of one vessel in ten seconds, a report a second.
fn telemetry() -> Vec<u8> {
    let mut encoder = Encoder::default();
    let hello = Hello {
        wire_version: WIRE_VERSION,
        schema_hash: SCHEMA_HASH,
        config_hash: 1,
        version: (0, 1, 0),
        station: 7,
        kind: 0,
        rate_hz: 64_000.0,
        reset_cause: 1,
    };
    let mut bytes = encoder.frame(&Message::Hello(hello)).to_vec();
    for i in 0..10u16 {
        let track = Track {
            id: 1,
            stage: u8::from(i == 9),
            index: 64_000 * u64::from(i),
            cpa_time_s: 5.0,
            cpa_range_m: 500.0,
            cpa_azimuth: 0.0,
            heading: 1.57,
            speed_m_s: 7.0,
            starboard: false,
            sd_cpa_time_s: 0.1,
            sd_cpa_range_m: 9.0,
            sd_heading: 0.01,
            sd_speed_m_s: 0.2,
            x_m: 7.0 * f32::from(i),
            y_m: 500.0,
            var_x_m2: 100.0,
            var_y_m2: 400.0,
            cov_xy_m2: 50.0,
            range_observable: true,
            n: i,
        };
        bytes.extend_from_slice(encoder.frame(&Message::Track(track)));
    }
    bytes
}

/// A folder with a store of that.
fn store(start: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("west.toml"), STATION).unwrap();
    std::fs::write(dir.path().join("telemetry.bin"), telemetry()).unwrap();
    let args = ["base", "telemetry.bin", "--station", "west.toml", "--store", "kept"];
    succeeds(dir.path(), &[&args[..], start].concat());
    dir
}

#[test]
fn pictures_of_a_base_station_are_in_utc_where_the_clock_is_known() {
    let dir = store(&[]);
    for (start, words) in
        [(&["--start", "2024-05-01T09:00:00Z"][..], "2024-05-01 09:00:00 UTC"), (&[], "no clock is known")]
    {
        let args = ["base", "telemetry.bin", "--station", "west.toml", "--plots", "drawn"];
        succeeds(dir.path(), &[&args[..], start].concat());
        for name in ["bearings.svg", "tracks.svg"] {
            let drawn = std::fs::read_to_string(dir.path().join("drawn").join(name)).unwrap();
            let text = drawn.replace("</tspan><tspan>", " ");
            assert!(text.contains(words) && text.contains("station 7"), "{name}: {words}");
        }
    }
}

#[test]
fn every_format_by_name_and_by_ending() {
    let dir = store(&["--start", "2024-05-01T09:00:00Z"]);
    let export = |format: &str, out: &str| {
        succeeds(dir.path(), &["export", "--store", "kept", "--format", format, "--out", out])
    };
    let read = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    export("jsonl", "a.txt");
    let lines = String::from_utf8(read("a.txt")).unwrap();
    assert_eq!(lines.lines().count(), 11);
    export("csv", "a.csv");
    let bytes = read("a.csv");
    let mut csv = csv::Reader::from_reader(&bytes[..]);
    let utc = csv.headers().unwrap().iter().position(|h| h == "utc").unwrap();
    let rows: Vec<_> = csv.records().map(Result::unwrap).collect();
    assert_eq!((rows.len(), &rows[10][utc]), (11, "2024-05-01T09:00:09Z"));
    // The store knows where its station is.
    succeeds(dir.path(), &["export", "--store", "kept", "--out", "a.geojson"]);
    let map: Value = serde_json::from_slice(&read("a.geojson")).unwrap();
    assert_eq!(map["features"][0]["geometry"]["coordinates"], serde_json::json!([-123.0, 49.0]));
    assert_eq!(map["features"][1]["properties"]["times"].as_array().unwrap().len(), 10);
    export("kml", "a.kml");
    assert!(String::from_utf8(read("a.kml")).unwrap().contains("<when>2024-05-01T09:00:09Z</when>"));
    if cfg!(feature = "parquet") {
        export("parquet", "a.parquet");
        assert!(read("a.parquet").starts_with(b"PAR1"));
    }
}

#[test]
fn an_interval_and_a_station() {
    let dir = store(&["--start", "2024-05-01T09:00:00Z"]);
    let span = [
        "--from",
        "2024-05-01T09:00:02Z",
        "--to",
        "2024-05-01T09:00:05Z",
        "--station",
        "7",
        "--out",
        "b.jsonl",
    ];
    succeeds(dir.path(), &[&["export", "--store", "kept"][..], &span].concat());
    let text = std::fs::read_to_string(dir.path().join("b.jsonl")).unwrap();
    let times: Vec<Value> =
        text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap()["t_s"].clone()).collect();
    assert_eq!(times, [2.0, 3.0, 4.0]);
}

#[test]
fn records_that_tell_their_station_once_are_of_it() {
    let dir = store(&["--start", "2024-05-01T09:00:00Z"]);
    succeeds(dir.path(), &["export", "--store", "kept", "--out", "all.jsonl"]);
    // As `process` prints them.
    let text = std::fs::read_to_string(dir.path().join("all.jsonl")).unwrap();
    let records = text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap()).map(|mut r| {
        if r["type"] != "hello" {
            r.as_object_mut().unwrap().remove("station");
        }
        r.to_string() + "\n"
    });
    std::fs::write(dir.path().join("p.jsonl"), records.collect::<String>()).unwrap();
    std::fs::write(dir.path().join("stations.toml"), "[[stations]]\nid = 7\nname = \"west\"\nkind = \"array\"\nposition = { lat_deg = 49.0, lon_deg = -123.0, depth_m = 150.0 }\n").unwrap();
    let export = |more: &[&str]| {
        let args = [&["export", "p.jsonl"][..], more].concat();
        let out = run(dir.path(), &args);
        (out.status.success(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let (ok, said) = export(&["--station", "8", "--out", "8.jsonl"]);
    assert!(ok && said.contains("0 records"), "{said}");
    let (ok, said) = export(&["--station", "7", "--stations", "stations.toml", "--out", "7.kml"]);
    assert!(ok, "{said}");
    let kml = std::fs::read_to_string(dir.path().join("7.kml")).unwrap();
    assert!(kml.contains("<Placemark>"), "{kml}");
    let (ok, said) = export(&["--seed-id", "YV.RR03", "--out", "7.quakeml"]);
    assert!(ok && said.contains("0 of") && said.contains("calls and T phases"), "{said}");
}

#[test]
fn a_base_station_started_again_still_knows_time_and_place() {
    let dir = store(&["--start", "2024-05-01T09:00:00Z"]);
    let last = || -> Value {
        succeeds(dir.path(), &["export", "--store", "kept", "--out", "last.jsonl"]);
        let text = std::fs::read_to_string(dir.path().join("last.jsonl")).unwrap();
        serde_json::from_str(text.lines().last().unwrap()).unwrap()
    };
    // The recorder has started again, and nobody said when.
    succeeds(dir.path(), &["base", "telemetry.bin", "--store", "kept", "--export", "c.geojson"]);
    assert_eq!((&last()["utc"], &last()["session"]), (&Value::Null, &2.into()));
    let map = std::fs::read_to_string(dir.path().join("c.geojson")).unwrap();
    assert!(map.contains("2024-05-01T09:00:09Z"), "the first session's times");
    // From here on nobody need say anything of the third.
    succeeds(dir.path(), &["base", "telemetry.bin", "--store", "kept", "--start", "2024-06-01T00:00:00Z"]);
    assert_eq!((&last()["utc"], &last()["session"]), (&"2024-06-01T00:00:09Z".into(), &3.into()));
    succeeds(dir.path(), &["base", "telemetry.bin", "--store", "kept", "--export", "d.geojson"]);
    let map = std::fs::read_to_string(dir.path().join("d.geojson")).unwrap();
    assert!(map.contains("2024-05-01T09:00:09Z") && map.contains("2024-06-01T00:00:09Z"));
}

#[test]
fn what_is_wrong_is_told_and_nothing_is_left() {
    let dir = store(&[]);
    // Nobody said where the station is.
    succeeds(dir.path(), &["base", "telemetry.bin", "--store", "bare"]);
    let kept = || std::fs::read(dir.path().join("kept/store.sqlite")).unwrap();
    let before = kept();
    for (args, words) in [
        (&["--store", "kept", "--out", "kept/records.jsonl"][..], "the store itself"),
        (&["--store", "bare", "--out", "x.kml"], "--stations"),
        (
            &[
                "--store",
                "kept",
                "--from",
                "2024-05-02T00:00:00Z",
                "--to",
                "2024-05-01T00:00:00Z",
                "--out",
                "x.csv",
            ],
            "--to",
        ),
        (&["--store", "absent", "--out", "x.csv"][..], "absent"),
        (&["--store", "kept", "--station", "9", "--out", "x.csv"], "stations there: 7"),
        (&["--store", "kept", "--from", "noon", "--out", "x.csv"], "'noon' for '--from"),
        (&["--store", "kept", "--out", "x.xls"], ".parquet"),
    ] {
        let out = run(dir.path(), &[&["export"][..], args].concat());
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(
            !out.status.success() && said.contains(words) && said.lines().count() == 1,
            "{args:?}: {said}"
        );
    }
    let out =
        run(dir.path(), &["export", "--store", "kept", "--from", "2024-05-01T09:00:02Z", "--out", "y.csv"]);
    assert!(String::from_utf8_lossy(&out.stderr).contains("no UTC"));
    assert!(!dir.path().join("x.csv").exists() && !dir.path().join("x.kml").exists());
    assert_eq!(kept(), before);
}

#[test]
fn process_prints_the_tables_that_export_writes() {
    let dir = tempfile::tempdir().unwrap();
    let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios/short-pass.toml");
    succeeds(dir.path(), &["simulate", scenario, "--out", "pass"]);
    // Nowhere on the Earth: a station with a position has columns for its tracks' latitudes and longitudes, too.
    let station = dir.path().join("pass/station.toml");
    let text = std::fs::read_to_string(&station).unwrap();
    let nowhere = text.lines().filter(|line| !line.starts_with("position")).collect::<Vec<_>>().join("\n");
    std::fs::write(&station, nowhere).unwrap();
    let process = |format: &str| {
        let args = ["process", "--station", "pass/station.toml", "pass", "--levels", "2", "--format", format];
        let out = run(dir.path(), &args);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        out.stdout
    };
    let lines = process("jsonl");
    assert!(lines.starts_with(b"{\"type\":\"hello\""));
    std::fs::write(dir.path().join("records.jsonl"), &lines).unwrap();
    for format in ["csv", "parquet"] {
        let args = ["export", "records.jsonl", "--format", format, "--out", "table"];
        succeeds(dir.path(), &args);
        let (table, own) = (std::fs::read(dir.path().join("table")).unwrap(), process(format));
        if format == "parquet" {
            assert!(own.starts_with(b"PAR1") && own.len().abs_diff(table.len()) < 100);
            continue;
        }
        // Numbers that were read from lines again may differ in their last digit.
        let cells = |text: &[u8]| -> Vec<Vec<String>> {
            let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(text);
            let rows = reader.records().map(|row| row.unwrap().iter().map(str::to_owned).collect());
            rows.collect()
        };
        let (own, table) = (cells(&own), cells(&table));
        assert_eq!(own.len(), table.len());
        assert_eq!(own.len(), lines.iter().filter(|b| **b == b'\n').count() + 1);
        for (a, b) in own.iter().flatten().zip(table.iter().flatten()) {
            let near = || {
                Some(
                    (a.parse::<f64>().ok()? - b.parse::<f64>().ok()?).abs()
                        <= 1e-12 * a.parse::<f64>().ok()?.abs(),
                )
            };
            assert!(a == b || near() == Some(true) || a.starts_with('['), "{a} {b}");
        }
    }
    let refused = run(
        dir.path(),
        &["process", "--station", "pass/station.toml", "pass", "--format", "csv", "--out", "x"],
    );
    assert_eq!(refused.status.code(), Some(2), "a folder of days has JSON Lines");
}
