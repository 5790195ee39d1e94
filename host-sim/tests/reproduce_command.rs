//! `seabearing reproduce`: figures as records, what a missed bar and absent data come to, and an interruption.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn reproduce(args: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.arg("reproduce").args(args).current_dir(folder).stdin(Stdio::null());
    command.output().unwrap()
}

fn figures(out: &Output) -> Vec<Value> {
    let text = String::from_utf8(out.stdout.clone()).unwrap();
    let records = text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
    records.filter(|r| r["type"] == "figure").collect()
}

#[test]
fn a_missed_bar_is_a_record_a_line_and_exit_status_3() {
    let dir = tempfile::tempdir().unwrap();
    // Three runs a point are too few to keep within a tenth of the bound.
    let out = reproduce(&["motion-fig3", "--runs", "3", "--json"], dir.path());
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(3), "{said}");
    assert!(said.starts_with("seabearing: missed: motion-fig3: ") && said.lines().count() == 1, "{said}");
    let figures = figures(&out);
    let missed = figures.iter().find(|f| f["met"] == false).unwrap();
    let keys: Vec<&String> = missed.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["type", "experiment", "name", "value", "bar", "relation", "met"]);
    assert!(missed["value"].as_f64().unwrap() > missed["bar"].as_f64().unwrap(), "{missed}");
    assert_eq!((&missed["experiment"], &missed["relation"]), (&"motion-fig3".into(), &"<=".into()));
}

#[test]
fn absent_data_are_a_line_and_figures_without_a_value() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["real-ship-ee", "real-ship-track", "difar", "ais-kinematics", "obs-table1"] {
        let out = reproduce(&[name, "--json", "--data", "nowhere"], dir.path());
        let said = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(0), "{name}: {said}");
        assert!(said.contains("no data at nowhere/") && said.lines().count() == 1, "{name}: {said}");
        let figures = figures(&out);
        assert!(!figures.is_empty(), "{name}");
        assert!(figures.iter().all(|f| f["value"].is_null() && f["met"].is_null()), "{name}: {figures:?}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn an_interruption_ends_the_programs_it_began_and_leaves_no_folder() {
    for name in ["all", "base-load"] {
        let dir = tempfile::tempdir().unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
        command.args(["reproduce", name, "--runs", "1"]).current_dir(dir.path()).env("TMPDIR", dir.path());
        let mut run =
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let path = format!("/proc/{0}/task", run.id());
        // Children of any of its threads.
        let children = || -> Vec<String> {
            let threads = std::fs::read_dir(&path).into_iter().flatten().flatten();
            let lists = threads.filter_map(|t| std::fs::read_to_string(t.path().join("children")).ok());
            lists.flat_map(|l| l.split_whitespace().map(str::to_owned).collect::<Vec<_>>()).collect()
        };
        let begun = std::time::Instant::now();
        let wait = |done: &dyn Fn() -> bool| {
            while !done() {
                assert!(begun.elapsed().as_secs() < 60, "{name}: nothing happened for a minute");
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
        };
        wait(&|| !children().is_empty());
        let began = children();
        assert!(Command::new("kill").args(["-s", "TERM", &run.id().to_string()]).status().unwrap().success());
        run.wait().unwrap();
        // A process that has ended has no command line, even while nobody has asked for its status.
        let cmdline = |p: &String| std::fs::read(format!("/proc/{p}/cmdline")).unwrap_or_default();
        wait(&|| began.iter().all(|p| cmdline(p).is_empty()));
        let left = std::fs::read_dir(dir.path()).unwrap().flatten().map(|f| f.file_name());
        let left: Vec<_> = left.filter(|n| n.to_string_lossy().starts_with("seabearing-")).collect();
        assert!(left.is_empty(), "{name}: {left:?}");
    }
}
