//! `process --levels`: records beside the others, the same however the recording is processed, and what is refused.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn run(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).current_dir(folder).output().unwrap()
}

fn output(folder: &Path, args: &[&str]) -> String {
    let out = run(folder, args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn lines<'a>(text: &'a str, kind: &str) -> Vec<&'a str> {
    let kind = format!("{{\"type\":\"{kind}\"");
    text.lines().filter(|line| line.starts_with(&kind)).collect()
}

/// The noise of the scenario, and a station that says what its codes mean.
fn simulated(folder: &Path) -> String {
    let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios/short-pass.toml");
    output(folder, &["simulate", scenario, "--out", "pass"]);
    let station = std::fs::read_to_string(folder.join("pass/station.toml")).unwrap();
    std::fs::write(folder.join("bare.toml"), &station).unwrap();
    let known = "sensitivity_db_re_1v_upa = [-165.0, -165.0, -165.0, -165.0]";
    let station = if station.contains("sensitivity_db_re_1v_upa") {
        station
    } else {
        station.replacen("[array]", &format!("[array]\n{known}"), 1)
    };
    let station = format!("{station}\n[calibration]\nfull_scale_v = 2.5\ngain_db = 0.0\n");
    std::fs::write(folder.join("east.toml"), station).unwrap();
    output(folder, &["process", "--station", "east.toml", "pass", "--levels", "2", "--plots", "plots"])
}

#[test]
fn levels_stand_beside_the_other_records_and_in_days() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = simulated(at);
    let levels = lines(&text, "level");
    assert!(levels.len() >= 8 && levels.len().is_multiple_of(4), "{}", levels.len());
    for line in &levels {
        let level: Value = serde_json::from_str(line).unwrap();
        assert_eq!((&level["quantity"], &level["reference"]), (&"pressure".into(), &"1 µPa".into()));
        let whole = level["duration_s"] == 2.0;
        assert!(!whole || level["used"].as_f64().unwrap() > 0.9, "{level}");
        let (bands, middles) = (&level["decidecade_db"], level["decidecade_hz"].as_array().unwrap());
        assert_eq!(bands.as_array().unwrap().len(), middles.len());
        let kilohertz = middles.iter().position(|f| *f == 1000.0).unwrap();
        // A ferry of 172 dB at 500 m, about 54 dB away, and its image.
        assert!(!whole || (90.0..115.0).contains(&bands[kilohertz].as_f64().unwrap()), "{level}");
    }
    let svg = std::fs::read_to_string(at.join("plots/levels.svg")).unwrap();
    assert!(svg.contains("dB re 1 µPa²/Hz") && svg.contains("Long-term spectral average"), "{}", svg.len());
    // Every picture says what is drawn, and of what.
    for name in ["levels", "bearings", "tracks", "correlations"] {
        let svg = std::fs::read_to_string(at.join(format!("plots/{name}.svg"))).unwrap();
        // Wherever its caption's lines end.
        let words: Vec<&str> = svg.split_whitespace().collect();
        assert!(words.windows(2).any(|w| w[1] == "station" && w[0].ends_with("Data:")), "{name}");
        assert!(svg.len() < 500_000, "{name}");
    }
    let correlations = std::fs::read_to_string(at.join("plots/correlations.svg")).unwrap();
    assert_eq!(correlations.matches(" UTC\n").count(), 6);
    // In UTC, for the recording's name tells its beginning.
    assert!(
        svg.contains("time (UTC, 2024-05-01)") && svg.contains("recorded from 2024-05-01"),
        "{}",
        svg.len()
    );
    // Nothing else changes by it, and a day's file has the same.
    let without = output(at, &["process", "--station", "east.toml", "pass"]);
    assert!(lines(&without, "level").is_empty());
    let others: Vec<&str> = text.lines().filter(|line| !line.starts_with("{\"type\":\"level\"")).collect();
    assert_eq!(others, without.lines().collect::<Vec<_>>());
    output(at, &["process", "--station", "east.toml", "pass", "--levels", "2", "--out", "days"]);
    let days: String = std::fs::read_dir(at.join("days"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "jsonl"))
        .map(|path| std::fs::read_to_string(path).unwrap())
        .collect();
    assert_eq!(lines(&days, "level"), levels);
    // Without volts at full scale there are no pascals.
    let bare = output(at, &["process", "--station", "bare.toml", "pass", "--levels", "2"]);
    assert!(lines(&bare, "level").iter().all(|line| line.contains(r#""reference":"full scale""#)));
    let refused = run(at, &["process", "--station", "east.toml", "pass", "--levels", "0.01"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        !refused.status.success() && said.lines().count() == 1 && said.contains("--levels 0.01"),
        "{said}"
    );
}
