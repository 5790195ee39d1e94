//! Commands to a recorder that holds records, on lines that are not good.

#[allow(dead_code, reason = "other tests use the rest of it")]
mod recorder;

use recorder::{Noise, Since};
use seabearing::station::Station;
use seabearing_core::config::StationConfig;
use seabearing_core::outlet::{Plain, Reliable};
use seabearing_core::port::{self, NoBoard};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run_over};
use seabearing_core::wire::guard::Guard;
use seabearing_core::wire::link::{Class, Link, MemoryStore, Settings};
use seabearing_core::wire::{AZIGRAM_BANDS, Azigram, End, Message, Range, bytes_of};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

const STATION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios/demo-station.toml");

/// A line that is called again and again. What comes over it in its first time is lost.
struct Line {
    listener: TcpListener,
    call: Option<TcpStream>,
    deaf_until: Instant,
}

impl Line {
    fn call(&mut self) -> Option<&mut TcpStream> {
        if self.call.is_none() {
            self.call = self.listener.accept().ok().map(|(call, _)| {
                call.set_nonblocking(false).unwrap();
                call.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
                call
            });
        }
        self.call.as_mut()
    }
}

impl port::Link for Line {
    fn send(&mut self, frame: &[u8]) -> bool {
        let sent = self.call().is_some_and(|call| call.write_all(frame).is_ok());
        if !sent {
            self.call = None;
        }
        sent
    }

    fn receive(&mut self) -> Option<u8> {
        let mut byte = [0];
        match self.call()?.read(&mut byte) {
            Ok(1) => Some(byte[0]).filter(|_| Instant::now() > self.deaf_until),
            Ok(_) => {
                self.call = None;
                None
            }
            Err(_) => None,
        }
    }
}

/// The demo's station at an eighth of its rate.
fn station(dir: &Path) -> StationConfig {
    let text = std::fs::read_to_string(STATION).unwrap().replace("rate_hz = 64000", "rate_hz = 8000");
    std::fs::write(dir.join("east.toml"), text).unwrap();
    Station::read(&dir.join("east.toml")).unwrap().config
}

/// A recorder with what it has written while nobody was there; its address, and UTC of its beginning, seconds since 1970.
fn recorder(dir: &Path, baud: u32, held: Vec<(Class, Message)>, deaf: Duration) -> (String, f64) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let config = station(dir);
    let (tell, begun) = std::sync::mpsc::channel();
    let run = move || {
        let mut link =
            Link::new(Settings::serial(baud), config.id, 3, config.hash(), MemoryStore::<60_000>::new());
        for (class, message) in held {
            link.offer(class, bytes_of(&message, &mut [0; 128]));
        }
        let mut recorder = Box::<Memory<'static>>::default();
        let mut recorder = recorder.configure(&config, None).unwrap();
        let mut samples = Noise::new(config.rate_hz, false);
        tell.send(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()).unwrap();
        let mut frames = [[0; 4]; BLOCK_FRAMES];
        let mut line = Line { listener, call: None, deaf_until: Instant::now() + deaf };
        let mut codes = vec![0; 16_384];
        let mut outlet = Reliable::new(&mut line, &mut link, Guard::open()).with_snippets(&mut codes);
        run_over(&mut recorder, &mut samples, &mut outlet, &mut Since::now(), &mut NoBoard, &mut frames);
    };
    std::thread::Builder::new().stack_size(16 << 20).spawn(run).unwrap();
    (address, begun.recv().unwrap())
}

/// A recorder that speaks in plain frames; its address.
fn plain_recorder(dir: &Path) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let config = station(dir);
    let run = move || {
        let mut recorder = Box::<Memory<'static>>::default();
        let mut recorder = recorder.configure(&config, None).unwrap();
        let mut frames = [[0; 4]; BLOCK_FRAMES];
        let mut samples = Noise::new(config.rate_hz, false);
        let mut line = Line { listener, call: None, deaf_until: Instant::now() };
        let mut outlet = Plain::new(&mut line);
        run_over(&mut recorder, &mut samples, &mut outlet, &mut Since::now(), &mut NoBoard, &mut frames);
    };
    std::thread::Builder::new().stack_size(16 << 20).spawn(run).unwrap();
    address
}

fn seabearing(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing"))
        .args(arguments)
        .current_dir(dir)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn json(text: &[u8]) -> Vec<Value> {
    String::from_utf8_lossy(text).lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// What a store has of a type.
fn stored(dir: &Path, kind: &str) -> usize {
    let out = seabearing(dir, &["export", "--store", "store", "--format", "jsonl", "--out", "all.jsonl"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    json(&std::fs::read(dir.join("all.jsonl")).unwrap()).iter().filter(|r| r["type"] == kind).count()
}

#[test]
fn a_recorder_without_a_link_takes_what_is_not_signed() {
    let dir = tempfile::tempdir().unwrap();
    let (to, key) = (plain_recorder(dir.path()), dir.path().join("key"));
    std::fs::write(&key, "5a".repeat(32)).unwrap();
    let send = |how: &[&str], order: &[&str]| {
        let to = ["base", "send", "--tcp", &to];
        seabearing(dir.path(), &[&to[..], how, order].concat())
    };
    let told = |order: &[&str], answer: &str| {
        let out = send(&["--unsigned"], order);
        assert!(out.status.success(), "{order:?}: {}", String::from_utf8_lossy(&out.stderr));
        assert!(json(&out.stdout).iter().any(|r| r["type"] == answer), "{order:?}");
    };
    told(&["identify"], "hello");
    told(&["health-every", "1"], "reply");
    // What is signed goes over a link alone.
    let signed = send(&["--key", "key", "--wait", "3"], &["identify"]);
    let said = String::from_utf8_lossy(&signed.stderr).into_owned();
    assert!(!signed.status.success() && said.contains("without a link"), "{said}");
    told(&["stop"], "reply");
}

#[test]
fn a_command_takes_no_records_away_from_the_base_station() {
    let dir = tempfile::tempdir().unwrap();
    let azigram = |index| {
        let (azimuth, coherence) = ([1; AZIGRAM_BANDS], [1; AZIGRAM_BANDS]);
        Message::Azigram(Azigram {
            index,
            frames: 6,
            bin_hz: 0.05,
            first_bin: 220,
            bins: 266,
            azimuth,
            coherence,
        })
    };
    let ends = (0..400).map(|index| (Class::Final, Message::End(End { index, frames: 7777 })));
    let held = ends.chain((0..100).map(|index| (Class::Spectrum, azigram(index)))).collect();
    let (address, _) = recorder(dir.path(), 921_600, held, Duration::ZERO);
    let to = format!("tcp:{address}");
    std::fs::write(dir.path().join("stations.toml"), format!("[[stations]]\nid = 1\nline = \"{to}\"\n"))
        .unwrap();
    let send = ["base", "send", "--stations", "stations.toml", "--station", "1", "--unsigned"];
    let out = seabearing(dir.path(), &[&send[..], &["identify"]].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(json(&out.stdout).iter().any(|r| r["type"] == "hello"));
    let mut base = Command::new(env!("CARGO_BIN_EXE_seabearing"))
        .args(["base", "--stations", "stations.toml", "--store", "store", "--json"])
        .current_dir(dir.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    let mut came = 0;
    while came < 500 && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(500));
        came = if dir.path().join("store/store.sqlite").exists() {
            stored(dir.path(), "end") + stored(dir.path(), "azigram")
        } else {
            0
        };
    }
    base.kill().unwrap();
    base.wait().unwrap();
    assert_eq!((came, stored(dir.path(), "lost")), (500, 0));
}

#[test]
fn a_time_that_comes_late_is_not_told() {
    let dir = tempfile::tempdir().unwrap();
    let (address, begun) = recorder(dir.path(), 921_600, Vec::new(), Duration::from_secs(8));
    let out = seabearing(dir.path(), &["base", "send", "--tcp", &address, "--unsigned", "utc", "now"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let mut times = 0;
    for record in json(&out.stdout).iter().filter(|r| r["type"] == "time") {
        use time::format_description::well_known::Rfc3339;
        let utc = time::OffsetDateTime::parse(record["utc"].as_str().unwrap(), &Rfc3339).unwrap();
        let error_s = utc.unix_timestamp_nanos() as f64 * 1e-9 - (begun + record["t_s"].as_f64().unwrap());
        let sd_s = record["sd_utc_s"].as_f64().unwrap();
        assert!(error_s.abs() < 4.0 * sd_s, "{error_s} s wrong, and {sd_s} s stated");
        times += 1;
    }
    assert!(times > 0);
}

#[test]
fn samples_come_behind_what_a_store_takes_on_the_way() {
    let dir = tempfile::tempdir().unwrap();
    let range = |index| Range {
        index,
        range_m: 4000.0,
        sd_range_m: 1.0,
        speed_m_s: 1.0,
        sd_speed_m_s: 1.0,
        log_presence: 1.0,
        weight: 1.0,
        detected: true,
    };
    let held = (0..3000).map(|n| (Class::Bearing, Message::Range(range(n)))).collect();
    let (address, _) = recorder(dir.path(), 115_200, held, Duration::ZERO);
    let send = ["base", "send", "--tcp", &address, "--unsigned", "--wait", "12"];
    let snippet = ["snippet", "--samples", "100", "--out", "sea.wav"];
    let out = seabearing(dir.path(), &[&send[..], &snippet].concat());
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success() && said.contains("--store"), "{said}");
    std::fs::create_dir(dir.path().join("store")).unwrap();
    let out = seabearing(dir.path(), &[&send[..], &["--store", "store"], &snippet].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(dir.path().join("sea.wav").exists());
    assert!(stored(dir.path(), "range") > 500);
}

#[test]
fn what_cannot_be_is_refused_before_the_line_is_opened() {
    let dir = tempfile::tempdir().unwrap();
    for (wrong, word) in [
        (&["--samples", "0"][..], "--samples 0"),
        (&["--seconds", "nan"], "--seconds"),
        (&["--seconds=-1"], "--seconds"),
        (&["--out", "nowhere/sea.wav"], "no folder nowhere"),
        (&["--out", "."], "it is a folder"),
    ] {
        let send = ["base", "send", "--tcp", "127.0.0.1:1", "--unsigned", "snippet"];
        let begun = Instant::now();
        let out = seabearing(dir.path(), &[&send[..], wrong].concat());
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(!out.status.success() && said.contains(word), "{said}");
        assert!(begun.elapsed() < Duration::from_secs(20), "{wrong:?}");
    }
}

/// What a recorder still holds of its answers to one command is none to the next.
#[test]
fn an_answer_to_the_command_before_is_none() {
    let dir = tempfile::tempdir().unwrap();
    let (address, _) = recorder(dir.path(), 921_600, Vec::new(), Duration::ZERO);
    let mut newest = -1.0;
    for _ in 0..4 {
        let out = seabearing(dir.path(), &["base", "send", "--tcp", &address, "--unsigned", "identify"]);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let said = json(&out.stdout);
        let times = said.iter().filter(|r| r["type"] == "health").filter_map(|r| r["t_s"].as_f64());
        let last = times.fold(-1.0, f64::max);
        assert!(last > newest, "health of {last} s after that of {newest} s");
        newest = last;
        std::thread::sleep(Duration::from_millis(300));
    }
}
