//! `seabearing base` while what is around it fails: a device is unplugged, an export cannot be written, an alarm finds
//! nobody, a recorder is of another version. Each is named and tried again where that helps, and storing goes on.
#![cfg(unix)]

mod base_process;

use base_process::{Base, hello, kept, of, wait};
use seabearing_core::wire::{Encoder, End, Fault, FaultCode, Hello, Message, Time};
use serde_json::Value;
#[cfg(target_os = "linux")]
use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::time::{Duration, Instant};

fn end(index: u64) -> Message {
    Message::End(End { index, frames: 0 })
}

/// A pseudo-terminal whose other end appears under a name, as a device that is plugged in; no other process has this one.
#[cfg(target_os = "linux")]
fn plugged(name: &Path) -> File {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&ours).unwrap();
    unlockpt(&ours).unwrap();
    let device = ptsname(&ours, Vec::new()).unwrap();
    let _ = std::fs::remove_file(name);
    std::os::unix::fs::symlink(OsStr::from_bytes(device.to_bytes()), name).unwrap();
    File::from(ours)
}

/// Says something again and again until enough of it is stored.
#[cfg(target_os = "linux")]
fn say(folder: &Path, to: &mut File, frame: &[u8], kind: &str, count: usize) {
    let begun = Instant::now();
    let mut all = kept(folder);
    while of(&all, 7, kind) < count {
        assert!(begun.elapsed() < Duration::from_secs(60), "{kind}: {all:?}");
        to.write_all(frame).unwrap();
        std::thread::sleep(Duration::from_millis(100));
        all = kept(folder);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn an_unplugged_device_is_named_opened_again_and_holds_up_nobody() {
    let dir = tempfile::tempdir().unwrap();
    let device = dir.path().join("tty");
    let mut port = plugged(&device);
    let stations = format!("[[stations]]\nid = 7\nline = \"serial:{}:115200\"\n", device.display());
    std::fs::write(dir.path().join("stations.toml"), stations).unwrap();
    let args = ["--stations", "stations.toml", "--listen", "127.0.0.1:0", "--store", "store"];
    let base = Base::start(dir.path(), &args);
    say(dir.path(), &mut port, Encoder::default().frame(&hello(7)), "hello", 1);
    std::fs::remove_file(&device).unwrap();
    drop(port);
    wait(dir.path(), "unplugged", |all| all.iter().any(|r| r["station"] == 7 && r["state"] == "down"));
    // Meanwhile another recorder is heard.
    let mut other = base.call();
    let mut encoder = Encoder::default();
    other.write_all(encoder.frame(&hello(8))).unwrap();
    other.write_all(encoder.frame(&end(5))).unwrap();
    wait(dir.path(), "the other", |all| of(all, 8, "end") == 1);
    // Opening it has failed once by then.
    std::thread::sleep(Duration::from_millis(2500));
    let mut port = plugged(&device);
    say(dir.path(), &mut port, Encoder::default().frame(&end(9)), "end", 1);
    let all = kept(dir.path());
    let states: Vec<&str> =
        all.iter().filter(|r| r["station"] == 7).filter_map(|r| r["state"].as_str()).collect();
    assert_eq!(states, ["up", "down", "up"]);
    let said = base.kill();
    let words = format!("cannot open serial device {}", device.display());
    assert_eq!(said.matches(&words).count(), 1, "{said}");
    assert!(said.contains("it is tried again") && said.contains("open again"), "{said}");
}

/// An alarm has the fields that the published schema tells, and all of them.
fn of_the_schema(alarm: &Value) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/records.schema.json");
    let schema: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let kind = schema["oneOf"].as_array().unwrap().iter().find(|k| k["title"] == "alarm").unwrap();
    let required = kind["required"].as_array().unwrap();
    assert!(required.iter().all(|key| alarm.get(key.as_str().unwrap()).is_some()), "{alarm}");
    assert!(alarm.as_object().unwrap().keys().all(|key| kind["properties"][key].is_object()), "{alarm}");
}

#[test]
fn a_dead_export_and_a_dead_webhook_are_named_tried_again_and_hold_up_nobody() {
    let dir = tempfile::tempdir().unwrap();
    // Nobody answers there; and the folder of the export is none.
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let alarms =
        format!("[[alarms]]\nkind = \"channel\"\n[[deliver]]\nwebhook = \"http://{nobody}/alarm\"\n");
    std::fs::write(dir.path().join("alarms.toml"), alarms).unwrap();
    std::fs::create_dir(dir.path().join("maps")).unwrap();
    let args = ["--listen", "127.0.0.1:0", "--store", "store", "--alarms", "alarms.toml"];
    let args = [&args[..], &["--export", "maps/tracks.jsonl"]].concat();
    let base = Base::start(dir.path(), &args);
    std::fs::remove_dir(dir.path().join("maps")).unwrap();
    std::fs::write(dir.path().join("maps"), "no folder").unwrap();
    let begun = Instant::now();
    let mut recorder = base.call();
    let mut encoder = Encoder::default();
    recorder.write_all(encoder.frame(&hello(7))).unwrap();
    let dead = Fault { index: 1, code: FaultCode::DeadChannel, value: 2 };
    recorder.write_all(encoder.frame(&Message::Fault(dead))).unwrap();
    // Longer than the export waits, and longer than the webhook is called.
    let mut said = 0;
    while begun.elapsed() < Duration::from_secs(16) {
        recorder.write_all(encoder.frame(&end(said))).unwrap();
        said += 1;
        std::thread::sleep(Duration::from_millis(100));
    }
    let all =
        wait(dir.path(), "all of it", |all| of(all, 7, "end") as u64 == said && of(all, 7, "alarm") == 1);
    of_the_schema(all.iter().find(|r| r["type"] == "alarm").unwrap());
    std::fs::remove_file(dir.path().join("maps")).unwrap();
    std::fs::create_dir(dir.path().join("maps")).unwrap();
    while !dir.path().join("maps/tracks.jsonl").exists() {
        assert!(begun.elapsed() < Duration::from_secs(90), "the export is not written again");
        std::thread::sleep(Duration::from_millis(50));
    }
    let said = base.kill();
    assert!(said.contains("maps/tracks.jsonl") && said.contains("it is tried again"), "{said}");
    assert!(said.contains("was not delivered in 4 attempts") && said.contains(&nobody.to_string()), "{said}");
}

#[test]
fn a_recorder_of_another_schema_is_named_and_what_is_known_of_it_is_stored() {
    let dir = tempfile::tempdir().unwrap();
    let base = Base::start(dir.path(), &["--listen", "127.0.0.1:0", "--store", "store"]);
    let mut recorder = base.call();
    let mut encoder = Encoder::default();
    let Message::Hello(hello) = hello(7) else { unreachable!() };
    let other = Message::Hello(Hello { schema_hash: 5, ..hello });
    recorder.write_all(encoder.frame(&other)).unwrap();
    recorder.write_all(encoder.frame(&end(1))).unwrap();
    // A message that this version does not know.
    recorder.write_all(encoder.frame_of(&[99, 1, 2])).unwrap();
    recorder.write_all(encoder.frame(&end(2))).unwrap();
    let all = wait(dir.path(), "what is known", |all| of(all, 7, "end") == 2);
    assert_eq!((of(&all, 7, "hello"), of(&all, 7, "lost")), (1, 0), "{all:?}");
    let said = base.kill();
    assert!(said.contains("station 7: the recorder's message schema is 0000000000000005"), "{said}");
}

#[test]
fn an_alarm_that_nobody_took_before_a_stop_is_named_and_told_after_the_next_start() {
    let dir = tempfile::tempdir().unwrap();
    let at = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let alarms = format!("[[alarms]]\nkind = \"channel\"\n[[deliver]]\nwebhook = \"http://{at}/alarm\"\n");
    std::fs::write(dir.path().join("alarms.toml"), alarms).unwrap();
    let args = ["--listen", "127.0.0.1:0", "--store", "store", "--alarms", "alarms.toml"];
    let mut base = Base::start(dir.path(), &args);
    let mut recorder = base.call();
    let mut encoder = Encoder::default();
    recorder.write_all(encoder.frame(&hello(7))).unwrap();
    let dead = Fault { index: 1, code: FaultCode::DeadChannel, value: 2 };
    recorder.write_all(encoder.frame(&Message::Fault(dead))).unwrap();
    let all = wait(dir.path(), "the alarm", |all| of(all, 7, "alarm") == 1);
    let id = all.iter().find(|r| r["type"] == "alarm").unwrap()["id"].clone();
    let pid = base.child.0.id().to_string();
    assert!(std::process::Command::new("kill").args(["-s", "TERM", &pid]).status().unwrap().success());
    base.child.0.wait().unwrap();
    let said = base.kill();
    let words = format!("is not delivered to http://{at}/alarm: it waits in the store");
    assert!(said.contains(&format!("alarm {id} (")) && said.contains(&words), "{said}");
    // Without a file of alarms it still waits, which is said.
    let base = Base::start(dir.path(), &args[..4]);
    let mut recorder = base.call();
    recorder.write_all(Encoder::default().frame(&hello(7))).unwrap();
    wait(dir.path(), "hello", |all| of(all, 7, "hello") == 2);
    let said = base.kill();
    assert!(
        said.contains("1 alarms wait in the store to be delivered: they are told with --alarms"),
        "{said}"
    );
    // Now somebody answers.
    let webhook = TcpListener::bind(at).unwrap();
    let _base = Base::start(dir.path(), &args);
    let (mut call, _) = webhook.accept().unwrap();
    call.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut told = Vec::new();
    let mut some = [0; 4096];
    while !String::from_utf8_lossy(&told).contains(&format!("\"id\":{id}")) {
        let n = call.read(&mut some).unwrap();
        assert!(n > 0, "{}", String::from_utf8_lossy(&told));
        told.extend_from_slice(&some[..n]);
    }
    call.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n").unwrap();
    let begun = Instant::now();
    let waits = || {
        let ways = std::fs::read_dir(dir.path().join("store/undelivered")).unwrap();
        ways.flatten().flat_map(|way| std::fs::read_dir(way.path()).unwrap()).count()
    };
    while waits() > 0 {
        assert!(begun.elapsed() < Duration::from_secs(10), "what was told waits for ever");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_recorder_without_utc_and_one_of_another_year_are_alarms_until_the_clock_is_right() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("alarms.toml"), "[[alarms]]\nkind = \"clock\"\nwithout_s = 1\n").unwrap();
    let args = ["--listen", "127.0.0.1:0", "--store", "store", "--alarms", "alarms.toml"];
    let base = Base::start(dir.path(), &args);
    let mut encoder = Encoder::default();
    let mut streams: Vec<_> = [7, 8].map(|station| (station, base.call())).into();
    for (station, stream) in &mut streams {
        stream.write_all(encoder.frame(&hello(*station))).unwrap();
    }
    let now_us = (time::OffsetDateTime::now_utc().unix_timestamp_nanos() / 1000) as i64;
    let mut told = |stream: &mut std::net::TcpStream, index: u64, off_us: i64| {
        let time =
            Time { index, utc_us: now_us + off_us, sd_s: 0.01, drift: 0.0, sd_drift: 1e-7, correlation: 0.0 };
        stream.write_all(encoder.frame(&Message::Time(time))).unwrap();
    };
    // The second has a clock, of two years ago.
    told(&mut streams[1].1, 0, -63_000_000_000_000);
    let codes = |all: &[Value]| {
        let alarms = all.iter().filter(|r| r["type"] == "alarm");
        let said =
            |r: &Value| ["code", "state"].map(|key| r[key].as_str().unwrap_or("").to_owned()).join(" ");
        alarms.map(|r| (r["station"].as_u64(), said(r))).collect::<std::collections::BTreeSet<_>>()
    };
    let mut plain = Encoder::default();
    let begun = Instant::now();
    while codes(&kept(dir.path())).len() < 2 {
        assert!(begun.elapsed() < Duration::from_secs(30), "{:?}", codes(&kept(dir.path())));
        streams[0].1.write_all(plain.frame(&end(1))).unwrap();
        std::thread::sleep(Duration::from_millis(100));
    }
    told(&mut streams[0].1, 2, 0);
    told(&mut streams[1].1, 2, 0);
    let all = wait(dir.path(), "both are right", |all| codes(all).len() == 4);
    let wanted = [
        (7, "ClockMissing cleared"),
        (7, "ClockMissing raised"),
        (8, "ClockWrong cleared"),
        (8, "ClockWrong raised"),
    ];
    assert_eq!(codes(&all), wanted.map(|(station, said)| (Some(station), said.to_owned())).into());
}
