//! `seabearing ships`: what is known of each ship, its pages and tables, and one clear line on bad input.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn seabearing(args: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).current_dir(folder).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs and gives standard output.
fn said(args: &[&str], folder: &Path) -> String {
    let out = seabearing(args, folder);
    assert!(out.status.success(), "{args:?}: {}", text(&out.stderr));
    text(&out.stdout)
}

/// A failure with one line on standard error that holds these words.
fn fails(args: &[&str], folder: &Path, words: &[&str]) {
    let out = seabearing(args, folder);
    let said = text(&out.stderr);
    assert!(!out.status.success(), "{args:?} succeeded");
    let lines = said.lines().filter(|l| l.starts_with("seabearing: ") || l.starts_with("error: ")).count();
    assert!(lines == 1 && words.iter().all(|w| said.contains(w)), "{args:?}: {said}");
}

/// A folder with a simulated passage in `obs`: closest at two hours, 9 km off.
fn simulated() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    let station = std::fs::read_to_string(scenarios.join("ocean-bottom-station.toml")).unwrap();
    let station = station.replace("../out/ocean-table.toml", "table.toml");
    assert!(station.contains("\"table.toml\""), "{station}");
    std::fs::write(dir.path().join("station.toml"), station).unwrap();
    let profile = scenarios.join("ocean-profile.csv");
    let made = ["propagation", "--profile", profile.to_str().unwrap(), "--depth-m", "4340", "--rows", "360"];
    said(&[&made[..], &["--step-m", "140", "--out", "table.toml"]].concat(), dir.path());
    let scenario = r#"kind = "obs"
station = "station.toml"
seed = 1
duration_s = 14400.0
start_utc = "2013-05-21T22:00:00Z"
[[vessels]]
name = "cargo"
straight = { cpa_time_s = 7200.0, cpa_range_m = 9000.0, heading_deg = 60.0, speed_m_s = 7.0, side = "port" }
radiation = { tones_hz = [12.6, 17.9], blade_hz = 5.4 }
"#;
    std::fs::write(dir.path().join("pass.toml"), scenario).unwrap();
    said(&["simulate", "pass.toml", "--out", "obs"], dir.path());
    dir
}

#[test]
fn a_ship_is_told_and_drawn_with_its_numbers_and_bad_input_in_one_line() {
    let dir = simulated();
    let folder = dir.path();
    let asked = ["ships", "--station", "obs/station.toml", "obs"];
    let records = said(&[&asked[..], &["--json"]].concat(), folder);
    let records: Vec<Value> = records.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(records.len(), 1, "{records:#?}");
    let ship = &records[0];
    let number = |key: &str| ship[key].as_f64().unwrap_or(f64::NAN);
    for (key, truth, off) in [
        ("cpa_time_s", 7200.0, 30.0),
        ("cpa_range_m", 9000.0, 200.0),
        ("heading_deg", 60.0, 1.5),
        ("speed_m_s", 7.0, 0.1),
        ("comb_hz", 5.4, 0.01),
    ] {
        assert!((number(key) - truth).abs() < off, "{key}: {}", ship[key]);
    }
    assert!(ship["utc_cpa"].as_str().unwrap().starts_with("2013-05-2"), "{ship}");
    let tones: Vec<f64> = ship["tones_hz"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
    for hz in [12.6, 17.9, 10.8, 16.2, 21.6] {
        assert!(tones.iter().any(|t| (t - hz).abs() < 0.02), "{hz}: {tones:?}");
    }
    let drawn = [&asked[..], &["--plots", "pages", "--truth", "obs/truth.csv"]].concat();
    let table = said(&drawn, folder);
    assert_eq!(table, std::fs::read_to_string(folder.join("pages/ships.txt")).unwrap());
    assert!(table.contains("5.40") && table.contains("recorded from 2013-05-21 22:00:00 UTC"), "{table}");
    let csv = std::fs::read_to_string(folder.join("pages/ships.csv")).unwrap();
    assert_eq!(csv.lines().count(), 2, "{csv}");
    let page = std::fs::read_to_string(folder.join("pages/ships.svg")).unwrap();
    for words in ["azimuth (°)", "range (km)", "ln likelihood ratio", "truth", "What is known of each ship"]
    {
        assert!(page.contains(&format!("\n{words}\n")), "{words}");
    }
    assert!(page.contains("time (UTC, 2013-05-21 to 2013-05-22)") && page.len() < 500_000);
    // Four hours are one page.
    assert_eq!(std::fs::read_dir(folder.join("pages")).unwrap().count(), 3);
    // The same beside the other pictures of `process`.
    said(&["process", "--station", "obs/station.toml", "obs", "--plots", "all"], folder);
    for file in
        ["ships.svg", "ships.txt", "ships.csv", "azigram.svg", "cepstrogram.svg", "range.svg", "map.svg"]
    {
        assert!(folder.join("all").join(file).is_file(), "{file}");
    }
    // A quiet half hour holds nobody.
    let none = said(&[&asked[..], &["--to", "2013-05-21T22:01:00Z"]].concat(), folder);
    assert!(none.starts_with("No ship was tracked."), "{none}");

    fails(&["ships", "--station", "none.toml", "obs"], folder, &["none.toml"]);
    fails(&["ships", "--station", "obs/station.toml", "nowhere"], folder, &["nowhere"]);
    fails(&[&asked[..], &["--plots", "pass.toml/pages"]].concat(), folder, &["pass.toml is a file"]);
    fails(&[&asked[..], &["--truth", "obs/truth.csv"]].concat(), folder, &["--plots"]);
    let turned = ["--from", "2013-05-22T00:00:00Z", "--to", "2013-05-21T23:00:00Z"];
    fails(&[&asked[..], &turned].concat(), folder, &["--to must be later than --from"]);
    fails(&[&asked[..], &["--plots", "p", "--truth", "pass.toml"]].concat(), folder, &["pass.toml"]);
    let array = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/demo-station.toml");
    fails(
        &["ships", "--station", array.to_str().unwrap(), "obs"],
        folder,
        &["ocean-bottom station is needed"],
    );
    if cfg!(feature = "experiments") {
        fails(
            &["reproduce", "difar", "--plots", "p"],
            folder,
            &["`difar` has no recording to draw", "obs-week"],
        );
    }
}
