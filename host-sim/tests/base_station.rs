//! `seabearing base` at work as a process: recorders that call, are silent, talk rubbish or have one number; a reader that
//! does not read; a disk that is full; a kill.
#![cfg(unix)]

mod base_process;

use base_process::{BINARY, Base, hello, kept, of, wait};
use seabearing::beside::ask;
use seabearing_core::wire::guard::{Guard, Recipient};
use seabearing_core::wire::link::{Arrival, Class, Inbox, Link, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Command as Order, Encoder, End, Message, Reply, bytes_of};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn silent_and_rubbish_callers_hold_up_nobody_and_two_of_one_number_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let base = Base::start(dir.path(), &["--listen", "127.0.0.1:0", "--store", "store", "--idle", "3"]);
    let silent = base.call();
    let mut rubbish = base.call();
    let noise = [0x5au8; 1 << 14];
    let mut encoders = [Encoder::default(), Encoder::default()];
    let mut recorders = [(7u16, base.call()), (8, base.call())];
    for (n, (station, stream)) in recorders.iter_mut().enumerate() {
        stream.write_all(encoders[n].frame(&hello(*station))).unwrap();
    }
    for index in 0..50 {
        let _ = rubbish.write_all(&noise);
        for (n, (_, stream)) in recorders.iter_mut().enumerate() {
            stream.write_all(encoders[n].frame(&Message::End(End { index, frames: 0 }))).unwrap();
        }
    }
    let all = wait(dir.path(), "two recorders", |all| of(all, 7, "end") + of(all, 8, "end") == 100);
    assert!(
        all.iter()
            .filter(|r| r["type"] != "line")
            .all(|r| r["received_utc"].is_string() && r["session"] == 1)
    );
    // A newer connection of 7, while the older one still speaks.
    let mut newer = base.call();
    let mut encoder = Encoder::default();
    newer.write_all(encoder.frame(&hello(7))).unwrap();
    wait(dir.path(), "the newer", |all| of(all, 7, "hello") == 2);
    std::thread::sleep(Duration::from_millis(2200));
    recorders[0].1.write_all(encoders[0].frame(&Message::End(End { index: 999, frames: 0 }))).unwrap();
    let all = wait(dir.path(), "the warning", |all| of(all, 7, "warning") == 1);
    assert_eq!(of(&all, 7, "end"), 50);
    // Those that say nothing are found out, told and closed.
    let all =
        wait(dir.path(), "silence", |all| all.iter().any(|r| r["state"] == "silent" && r["station"] == 8));
    assert!(all.iter().any(|r| r["state"] == "up" && r["station"] == 8));
    wait(dir.path(), "the end of it", |all| all.iter().any(|r| r["state"] == "down" && r["station"] == 8));
    drop(silent);
    // A second base station is refused the port, and the store.
    let second = |args: &[&str]| {
        let out = Command::new(BINARY).arg("base").args(args).current_dir(dir.path()).output().unwrap();
        assert!(!out.status.success());
        String::from_utf8_lossy(&out.stderr).into_owned()
    };
    let said = second(&["--listen", &base.address]);
    assert!(said.contains(&base.address) && said.lines().count() == 1, "{said}");
    let said = second(&["--listen", "127.0.0.1:0", "--store", "store"]);
    assert!(said.contains("in use by process") && said.lines().count() == 1, "{said}");
    // So is a page at an address in use, before anything is stored.
    let said = second(&["--listen", "127.0.0.1:0", "--store", "other", "--page", &base.address]);
    assert!(said.contains(&base.address) && said.lines().count() == 1, "{said}");
    assert!(!dir.path().join("other").exists());
    let said = base.kill();
    assert!(said.contains("two recorders say at once that they are station 7"), "{said}");
}

#[test]
fn a_reader_that_does_not_read_does_not_stop_the_storing() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = Base::start(dir.path(), &["--listen", "127.0.0.1:0", "--store", "store"]);
    let mut stream = base.call();
    let mut encoder = Encoder::default();
    stream.write_all(encoder.frame(&hello(7))).unwrap();
    // Far more than a pipe and the queue before it hold.
    let frames: Vec<u8> = (0..30_000)
        .flat_map(|index| encoder.frame(&Message::End(End { index, frames: 0 })).to_vec())
        .collect();
    stream.write_all(&frames).unwrap();
    let begun = Instant::now();
    let check = || {
        let out = Command::new(BINARY)
            .args(["base", "check", "--json", "--store", "store"])
            .current_dir(dir.path())
            .output();
        let out = out.unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        serde_json::from_slice::<Value>(&out.stdout).unwrap()
    };
    while check()["stations"][0]["records"].as_u64().unwrap_or(0) < 30_002 {
        assert!(begun.elapsed() < Duration::from_secs(120), "{}", check());
        std::thread::sleep(Duration::from_millis(200));
    }
    // Once it reads again, it is told how much it did not see; when it has gone, storing goes on.
    let mut lines = BufReader::new(base.child.0.stdout.take().unwrap()).lines();
    // A busy machine may have lost some before the pipe was full: those are told by themselves.
    let (mut seen, mut gap) = (0, 0);
    while gap <= 1000 {
        stream.write_all(encoder.frame(&Message::End(End { index: 1, frames: 0 }))).unwrap();
        let line = lines.next().unwrap().unwrap();
        let record: Value = serde_json::from_str(&line).unwrap();
        if record["type"] == "not_shown" {
            gap += record["records"].as_u64().unwrap();
        }
        seen += 1;
        assert!(seen < 200_000, "{gap}");
    }
    drop(lines);
    for _ in 0..20 {
        stream.write_all(encoder.frame(&Message::End(End { index: 2, frames: 0 }))).unwrap();
        std::thread::sleep(Duration::from_millis(30));
    }
    assert!(base.child.0.try_wait().unwrap().is_none());
    wait(dir.path(), "after the reader has gone", |all| all.last().is_some_and(|r| r["t_s"] == 0.002));
    let said = base.kill();
    assert!(said.contains("read too slowly") && said.contains("storing goes on"), "{said}");
}

#[test]
fn an_alarm_that_stands_is_on_the_page_after_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("stations.toml", "[[stations]]\nid = 7\nline = \"listen:127.0.0.1:0\"\n");
    write("alarms.toml", "[[alarms]]\nkind = \"silent\"\nafter_s = 1\n");
    let free_address =
        || std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let page = free_address();
    let args =
        ["--stations", "stations.toml", "--alarms", "alarms.toml", "--store", "store", "--page", &page];
    let metrics = free_address();
    for _ in 0..2 {
        let base = Base::start(dir.path(), &[&args[..], &["--metrics", &metrics]].concat());
        wait(dir.path(), "the alarm", |all| of(all, 7, "alarm") == 1);
        let begun = Instant::now();
        let shown = || serde_json::from_slice::<Value>(&ask(&page, "/api/alarms").unwrap()).unwrap();
        let counted = || String::from_utf8(ask(&metrics, "/metrics").unwrap()).unwrap();
        let line = "seabearing_alarms{code=\"RecorderSilent\",acknowledged=\"false\"} 1";
        while shown()[0]["state"] != "raised" || !counted().contains(line) {
            assert!(begun.elapsed() < Duration::from_secs(10), "{} {}", shown(), counted());
            std::thread::sleep(Duration::from_millis(50));
        }
        base.kill();
    }
    let all_of_them = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
        command.current_dir(dir.path()).args(["base", "acknowledge", "--store", "store", "--all"]);
        String::from_utf8(command.output().unwrap().stdout).unwrap()
    };
    assert_eq!(all_of_them(), "1 acknowledged\n");
    assert_eq!(std::fs::read_dir(dir.path().join("store/acknowledged")).unwrap().count(), 1);
    assert_eq!(all_of_them(), "0 acknowledged\n", "it waits for the base station already");
    // Its rule is no more: whoever is told of alarms is told so, with the time at which it was cleared.
    let told = dir.path().join("told");
    let tell = format!("[[deliver]]\ncommand = [\"sh\", \"-c\", \"cat >> {}\"]\n", told.display());
    write("alarms.toml", &format!("[[alarms]]\nkind = \"channel\"\n{tell}"));
    let base = Base::start(dir.path(), &args);
    let all = wait(dir.path(), "its end", |all| of(all, 7, "alarm") == 2);
    let begun = Instant::now();
    let delivered: Value = loop {
        let text = std::fs::read_to_string(&told).unwrap_or_default();
        if let Some(line) = text.strip_suffix('\n') {
            break serde_json::from_str(line).unwrap();
        }
        assert!(begun.elapsed() < Duration::from_secs(10), "nobody is told");
        std::thread::sleep(Duration::from_millis(50));
    };
    base.kill();
    let alarms: Vec<&Value> = all.iter().filter(|r| r["type"] == "alarm").collect();
    assert_eq!((&delivered["state"], &delivered["id"]), (&"cleared".into(), &alarms[0]["id"]));
    assert_eq!((&delivered["utc"], &alarms[1]["state"]), (&alarms[1]["utc"], &"cleared".into()));
    assert_ne!(alarms[0]["utc"], alarms[1]["utc"]);
    assert_eq!(all_of_them(), "0 acknowledged\n");
    // Only what the store holds, and what stands, can be acknowledged.
    let acknowledge = |id: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
        command
            .current_dir(dir.path())
            .args(["base", "acknowledge", "--store", "store", id])
            .output()
            .unwrap()
    };
    let cleared = alarms[0]["id"].to_string();
    // What waited may not have been looked at.
    let _ = std::fs::remove_file(dir.path().join("store/acknowledged").join(&cleared));
    let cleared_words = format!("alarm {cleared} is cleared already");
    for (id, words) in [
        ("99999", "the store holds no alarm 99999"),
        ("18446744073709551615", "the store holds no alarm 18446744073709551615"),
        (&cleared, &cleared_words),
    ] {
        let refused = acknowledge(id);
        let said = String::from_utf8(refused.stderr).unwrap();
        assert_eq!(refused.status.code(), Some(1), "{said}");
        assert!(said.contains(words) && said.lines().count() == 1, "{said}");
        assert!(!dir.path().join("store/acknowledged").join(id).exists());
    }
    // Nor is there a rule for what no station can raise.
    write("alarms.toml", "[[alarms]]\nkind = \"silent\"\nstations = [7, 99]\n");
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    let refused = command.current_dir(dir.path()).arg("base").args(args).output().unwrap();
    let said = String::from_utf8(refused.stderr).unwrap();
    let words =
        "alarms.toml, line 3, column 1: rule `silent`: stations: the stations file lists no station 99";
    assert!(refused.status.code() == Some(1) && said.contains(words) && said.lines().count() == 1, "{said}");
}

struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, _: Arrival<'_>) {}
}

/// A recorder with a link and a listening base station that is killed again and again: every record is there once.
#[test]
fn killed_at_any_moment_nothing_acknowledged_is_missing_and_nothing_is_twice() {
    let dir = tempfile::tempdir().unwrap();
    let mut link = Link::new(Settings::serial(921_600), 7, 1, 0, MemoryStore::<60_000>::new());
    let begun = Instant::now();
    let mut buffer = [0; 160];
    let (mut said, mut released) = (0u32, 0);
    for round in 0..8u64 {
        let base = Base::start(dir.path(), &["--listen", "127.0.0.1:0", "--store", "store"]);
        let mut stream = base.call();
        link.reconnected();
        let (at, last) = (Instant::now(), round == 7);
        let lives = Duration::from_millis(30 + 37 * round);
        while (!last && at.elapsed() < lives) || (last && link.waiting() > 0) {
            if !last && link.waiting() < 200 {
                let message =
                    if said == 0 { hello(7) } else { Message::End(End { index: said.into(), frames: 0 }) };
                link.offer(Class::of(&message), bytes_of(&message, &mut buffer));
                said += 1;
            }
            let now = begun.elapsed().as_micros() as u64;
            while let Some(frame) = link.send(now) {
                stream.write_all(frame).unwrap();
            }
            let mut answer = [0; 512];
            if let Ok(n) = stream.read(&mut answer) {
                answer[..n].iter().for_each(|b| link.receive(now, *b, &mut Nothing));
            }
            assert!(at.elapsed() < Duration::from_secs(60), "{} records wait", link.waiting());
        }
        released = said - link.waiting();
        base.kill();
    }
    assert_eq!(released, said);
    let all = kept(dir.path());
    let mut sequences: Vec<u64> = all.iter().filter_map(|r| r["sequence"].as_u64()).collect();
    sequences.sort_unstable();
    assert!(said > 20 && sequences.into_iter().eq(0..u64::from(said)), "{said}");
    let sound = Command::new(BINARY)
        .args(["base", "check", "--store", "store"])
        .current_dir(dir.path())
        .output()
        .unwrap();
    assert!(sound.status.success(), "{}", String::from_utf8_lossy(&sound.stderr));
}

/// Stations of a file: each with its line, one of which comes up late and goes again.
#[test]
fn stations_of_a_file_are_read_at_once_and_called_until_they_answer() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut encoder = Encoder::default();
    let mut bytes = encoder.frame(&hello(9)).to_vec();
    bytes.extend(encoder.frame(&Message::End(End { index: 2000, frames: 0 })));
    std::fs::write(dir.path().join("nine.bin"), &bytes).unwrap();
    let stations = format!(
        "[[stations]]\nid = 7\nline = \"tcp:127.0.0.1:{port}\"\n[[stations]]\nid = 8\nline = \"listen:127.0.0.1:0\"\n\
         [[stations]]\nid = 9\nline = \"file:nine.bin\"\nutc_of_sample_0 = \"2024-05-01T09:00:00Z\"\n\
         position = {{ lat_deg = 49.0, lon_deg = -123.0 }}\n"
    );
    file("stations.toml", &stations);
    let base = Base::start(dir.path(), &["--stations", "stations.toml", "--store", "store"]);
    let all = wait(dir.path(), "not up yet", |all| of(all, 9, "end") == 1 && of(all, 7, "line") == 1);
    let end = all.iter().find(|r| r["type"] == "end").unwrap();
    assert_eq!((&end["utc"], &end["sd_utc_s"]), (&"2024-05-01T09:00:02Z".into(), &Value::Null));
    let late = std::net::TcpListener::bind(("127.0.0.1", port)).unwrap();
    let (mut stream, _) = late.accept().unwrap();
    stream.write_all(Encoder::default().frame(&hello(7))).unwrap();
    wait(dir.path(), "up", |all| of(all, 7, "hello") == 1);
    drop((stream, late));
    let all = wait(dir.path(), "down", |all| of(all, 7, "line") == 3);
    let states: Vec<&Value> =
        all.iter().filter(|r| r["station"] == 7).map(|r| &r["state"]).filter(|s| s.is_string()).collect();
    assert_eq!(states, ["down", "up", "down"]);
    base.kill();
    // What is wrong in the file is said with its place.
    for (from, to, words) in [
        ("file:nine.bin", "udp:nine", "stations.toml, line 9, column 1: `udp:nine`"),
        ("id = 9", "id = 8", "two stations have the number 8"),
        ("id = 9", "name = \"nine\"", "stations.toml, line 7, column 1: it has no `id`"),
        ("2024-05-01T09:00:00Z", "noon", "`noon` is no time"),
        ("utc_of_sample_0", "utc_of_sample_1", "unknown field `utc_of_sample_1`"),
        ("line = \"file", "key_file = \"absent.key\"\nline = \"file", "absent.key"),
    ] {
        file("wrong.toml", &stations.replace(from, to));
        let out = Command::new(BINARY)
            .args(["base", "--stations", "wrong.toml"])
            .current_dir(dir.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        let words = words.replace("stations.toml", "wrong.toml");
        assert!(
            !out.status.success() && said.contains(&words) && said.lines().count() == 1,
            "{words}: {said}"
        );
    }
}

/// On a disk that is full the base says so once, raises both alarms, acknowledges nothing, and goes on when there is room.
#[test]
fn a_full_disk_is_named_and_storing_goes_on_when_there_is_room() {
    let dir = tempfile::tempdir().unwrap();
    let mount = |args: &[&str]| {
        let ran = Command::new("mount").args(args).arg(dir.path()).stderr(Stdio::null()).status();
        ran.is_ok_and(|s| s.success())
    };
    if !mount(&["-t", "tmpfs", "-o", "size=1m", "tmpfs"]) {
        seabearing_testkit::skipped("base_station", "no tmpfs can be mounted here");
        return;
    }
    // Whoever is told of alarms stands elsewhere.
    let elsewhere = tempfile::tempdir().unwrap();
    let (told, alarms) = (elsewhere.path().join("told"), elsewhere.path().join("alarms.toml"));
    let tell = format!("[[deliver]]\ncommand = [\"sh\", \"-c\", \"cat >> {}\"]\n", told.display());
    std::fs::write(&alarms, format!("[[alarms]]\nkind = \"disk\"\nfree_percent = 50\n{tell}")).unwrap();
    let args = ["--listen", "127.0.0.1:0", "--store", "store", "--alarms", alarms.to_str().unwrap()];
    let base = Base::start(dir.path(), &args);
    let told_until = |last: &str| -> Vec<String> {
        let begun = Instant::now();
        loop {
            let text = std::fs::read_to_string(&told).unwrap_or_default();
            let records = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
            let alarms: Vec<String> =
                records.map(|r| format!("{} {}", r["code"], r["state"]).replace('"', "")).collect();
            if alarms.iter().any(|alarm| alarm == last) || begun.elapsed().as_secs() > 60 {
                return alarms;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    };
    // Somebody else takes the room, and gives it back.
    let taken = dir.path().join("taken");
    std::fs::write(&taken, vec![1; 500_000]).unwrap();
    assert_eq!(told_until("DiskLow raised"), ["DiskLow raised"]);
    std::fs::remove_file(&taken).unwrap();
    assert_eq!(told_until("DiskLow cleared"), ["DiskLow raised", "DiskLow cleared"]);
    let mut stream = base.call();
    stream.set_write_timeout(Some(Duration::from_secs(1))).unwrap();
    let mut encoder = Encoder::default();
    let mut frames = encoder.frame(&hello(7)).to_vec();
    (0..20_000).for_each(|index| frames.extend(encoder.frame(&Message::End(End { index, frames: 0 }))));
    stream.write_all(&frames).unwrap();
    let (said, says) = std::sync::mpsc::channel();
    let Base { child, stderr, .. } = base;
    std::thread::spawn(move || stderr.lines().map_while(Result::ok).for_each(|l| drop(said.send(l))));
    let full = says.recv_timeout(Duration::from_secs(60)).unwrap();
    let grown = mount(&["-o", "remount,size=64m"]);
    let again = says.recv_timeout(Duration::from_secs(60));
    let all = wait(dir.path(), "room again", |all| of(all, 7, "end") == 20_000);
    let all_told = told_until("StoreFails cleared");
    drop(child);
    let unmounted = Command::new("umount").arg(dir.path()).status().unwrap().success();
    assert!(grown && unmounted && all.len() > 20_000);
    assert!(full.contains("the disk is full") && full.contains("nothing is acknowledged"), "{full}");
    assert!(again.is_ok_and(|l| l.contains("takes records again")));
    // Where the disk is looked at as it fills, it is low once more before.
    let fails: Vec<_> = all_told.iter().filter(|alarm| alarm.starts_with("StoreFails")).collect();
    assert_eq!(fails, ["StoreFails raised", "StoreFails cleared"], "{all_told:?}");
}

/// A recorder's end that carries out signed commands.
struct Obeys(Guard, Option<Order>);

impl Inbox for Obeys {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        if let Arrival::Record(record) = arrival {
            self.1 = self.0.admit(record.bytes).or(self.1);
        }
    }
}

/// `base send` finds line and key of a station in the stations file, and the recorder's answer.
#[test]
fn a_command_goes_to_the_station_of_a_file_signed_with_its_key() {
    let dir = tempfile::tempdir().unwrap();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::fs::write(dir.path().join("seven.key"), "07".repeat(32)).unwrap();
    let stations = format!(
        "[[stations]]\nid = 7\nline = \"tcp:127.0.0.1:{port}\"\nkey_file = \"seven.key\"\n[[stations]]\nid = 8\n"
    );
    std::fs::write(dir.path().join("stations.toml"), stations).unwrap();
    let send = |args: &[&str]| {
        let mut command = Command::new(BINARY);
        command.args(["base", "send", "--wait", "20", "--stations", "stations.toml", "--station"]).args(args);
        command.current_dir(dir.path()).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().unwrap()
    };
    for (id, words) in [("8", "station 8 has no `line`"), ("9", "no station 9; stations there: 7, 8")] {
        let out = send(&[id, "identify"]).wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(!out.status.success() && said.contains(words) && said.lines().count() == 1, "{said}");
    }
    let sender = send(&["7", "health-every", "600"]);
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
    let mut link = Link::new(Settings::serial(115_200), 7, 3, 0, MemoryStore::<6400>::new());
    let mut obeys = Obeys(Guard::keyed([7; 32], Recipient { station: 7, boot: 3 }), None);
    let (begun, mut done, mut buffer) = (Instant::now(), None, [0; 160]);
    link.offer(Class::Alarm, bytes_of(&hello(7), &mut buffer));
    while begun.elapsed() < Duration::from_secs(20) && (done.is_none() || link.waiting() > 0) {
        let now = begun.elapsed().as_micros() as u64;
        while let Some(frame) = link.send(now) {
            let _ = stream.write_all(frame);
        }
        let mut bytes = [0; 512];
        match stream.read(&mut bytes) {
            Ok(0) => break,
            Ok(n) => bytes[..n].iter().for_each(|b| link.receive(now, *b, &mut obeys)),
            Err(_) => {}
        }
        let token = match obeys.1.take() {
            Some(Order::HealthEvery { token, seconds }) => {
                done = Some(seconds);
                token
            }
            // It is asked who it is before.
            Some(Order::Identify { token }) => token,
            _ => continue,
        };
        link.offer(Class::Health, bytes_of(&Message::Reply(Reply { token, status: 0 }), &mut buffer));
    }
    let out = sender.wait_with_output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let said = String::from_utf8_lossy(&out.stdout);
    assert!(
        done == Some(600) && said.contains("\"type\":\"reply\"") && said.contains("\"station\":7"),
        "{said}"
    );
}
