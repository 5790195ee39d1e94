//! StationXML instead of a station file: an SDS archive and its metadata, nothing written by hand.

mod sds;

use sds::{archive, metadata};
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn seabearing(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.args(line.split_whitespace()).current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

/// Records without those that say whose they are.
fn records(ran: &Output) -> Vec<String> {
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let text = String::from_utf8(ran.stdout.clone()).unwrap();
    text.lines().filter(|l| !l.contains("\"type\":\"hello\"")).map(str::to_owned).collect()
}

#[test]
fn an_archive_with_stationxml_gives_the_records_of_one_with_a_station_file() {
    let dir = tempfile::tempdir().unwrap();
    archive(dir.path(), "S01");
    metadata(dir.path(), "S01");
    let by_hand = records(&seabearing(dir.path(), "process --station out/hand.toml sds"));
    assert!(by_hand.iter().filter(|r| r.contains("\"type\":\"azimuth\"")).count() > 5, "{by_hand:#?}");
    let direct = records(&seabearing(dir.path(), "process --station network.xml --propagation t.toml sds"));
    assert!(direct == by_hand);
    let made = seabearing(
        dir.path(),
        "station import network.xml --station S01 --network XX --location -- --propagation t.toml --out made/s.toml",
    );
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    assert!(records(&seabearing(dir.path(), "process --station made/s.toml sds")) == by_hand);
    let checked = seabearing(dir.path(), "config check made/s.toml --json");
    assert!(String::from_utf8_lossy(&checked.stdout).contains("\"name\":\"XX.S01\""));
    // By days, and a station that the archive does not hold is no error.
    let out = seabearing(dir.path(), "process --station network.xml --propagation t.toml sds --out days");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let mut names: Vec<String> = std::fs::read_dir(dir.path().join("days"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|n| n.ends_with("jsonl"))
        .collect();
    names.sort();
    assert_eq!(names, ["XX.S01.2024-05-01.jsonl", "XX.S01.2024-05-02.jsonl"]);
}

#[test]
fn what_cannot_be_imported_is_said_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    metadata(dir.path(), "S01");
    std::fs::write(dir.path().join("page.xml"), "<html><body/></html>").unwrap();
    for (line, what) in [
        ("network.xml --station LAND", "XX.LAND: BHZ has no two horizontal components"),
        ("network.xml --station S02", "no such station"),
        ("page.xml", "no StationXML: the outermost element is <html>"),
        ("absent.xml", "cannot read absent.xml"),
        ("network.xml --at yesterday", "'yesterday' for '--at"),
    ] {
        let ran = seabearing(dir.path(), &format!("station import {line} --out s.toml"));
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert!(!ran.status.success() && said.contains(what) && said.lines().count() == 1, "{line}: {said}");
    }
    assert!(!dir.path().join("s.toml").exists());
    // Without a table one of a typical sea is traced.
    let made = seabearing(dir.path(), "station import network.xml --station S01 --out s.toml");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    assert!(seabearing(dir.path(), "config check s.toml").status.success());
}
