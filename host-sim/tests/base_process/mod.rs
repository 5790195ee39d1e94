//! A base station as a process, and what its store holds: for the tests that disturb one.
// Not every test needs all of it.
#![allow(dead_code)]

use seabearing_core::wire::{Hello, Message, SCHEMA_HASH, WIRE_VERSION};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::time::{Duration, Instant};

pub const BINARY: &str = env!("CARGO_BIN_EXE_seabearing");

/// A process, killed when this is dropped: also where a test fails.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Nothing to do where it has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A base station that listens, killed at the end.
pub struct Base {
    pub child: Running,
    pub address: String,
    pub stderr: BufReader<ChildStderr>,
}

impl Base {
    pub fn start(folder: &Path, args: &[&str]) -> Self {
        let mut command = Command::new(BINARY);
        command.args(["base", "--json"]).args(args).current_dir(folder);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = Running(command.spawn().unwrap());
        let mut stderr = BufReader::new(child.0.stderr.take().unwrap());
        let mut address = String::new();
        while !address.contains("listening at ") {
            address.clear();
            assert!(stderr.read_line(&mut address).unwrap() > 0, "it does not listen");
        }
        let address = address.trim().rsplit(' ').next().unwrap().to_owned();
        Self { child, address, stderr }
    }

    pub fn call(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_nodelay(true).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        stream
    }

    /// What it has said on standard error, once it is dead.
    pub fn kill(self) -> String {
        let Self { child, mut stderr, .. } = self;
        drop(child);
        let mut said = String::new();
        stderr.read_to_string(&mut said).unwrap();
        said
    }
}

pub fn hello(station: u16) -> Message {
    Message::Hello(Hello {
        wire_version: WIRE_VERSION,
        schema_hash: SCHEMA_HASH,
        config_hash: 1,
        version: (0, 1, 0),
        station,
        kind: 0,
        rate_hz: 1000.0,
        reset_cause: 1,
    })
}

/// Records in a store, as an export gives them.
pub fn kept(folder: &Path) -> Vec<Value> {
    let out = folder.join("kept.jsonl");
    let ran = Command::new(BINARY)
        .args(["export", "--store", "store", "--out", "kept.jsonl"])
        .current_dir(folder)
        .output();
    let ran = ran.unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    std::fs::read_to_string(out).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

/// Waits until the store holds what is wanted.
pub fn wait(folder: &Path, what: &str, enough: impl Fn(&[Value]) -> bool) -> Vec<Value> {
    let begun = Instant::now();
    loop {
        let all = if folder.join("store/store.sqlite").exists() { kept(folder) } else { Vec::new() };
        if enough(&all) {
            return all;
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "{what}: {} records", all.len());
        std::thread::sleep(Duration::from_millis(50));
    }
}

pub fn of(all: &[Value], station: u16, kind: &str) -> usize {
    all.iter().filter(|r| r["station"] == station && r["type"] == kind).count()
}
