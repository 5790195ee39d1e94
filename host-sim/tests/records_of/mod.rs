//! The command as a person runs it: its records, or its one line of refusal.

use serde_json::Value;
use std::process::{Command, Output};

pub fn seabearing(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).output().expect("the command runs")
}

pub fn records(args: &[&str]) -> Vec<Value> {
    let out = seabearing(args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

/// One line on standard error, exit code not zero, nothing on standard output.
pub fn refusal(args: &[&str]) -> String {
    let out = seabearing(args);
    let text = String::from_utf8(out.stderr).unwrap();
    assert!(!out.status.success() && out.stdout.is_empty(), "{args:?}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    text
}

pub fn number(r: &Value, key: &str) -> f64 {
    r[key].as_f64().unwrap_or_else(|| panic!("{key} in {r}"))
}
