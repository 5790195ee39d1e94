//! `seabearing base` with three stations that hear one vessel, killed in the middle: one network track, before and after.
#![cfg(unix)]

mod base_process;

use base_process::{BINARY, Running};
use seabearing_core::wire::link::{Arrival, Class, Inbox, Link, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Bearing, End, Hello, Message, SCHEMA_HASH, Time, Track, WIRE_VERSION, bytes_of};
use serde_json::Value;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const RATE_HZ: u64 = 1000;
const LASTS_S: u32 = 400;
/// 2026-06-01.
const BEGIN_US: i64 = 1_780_272_000_000_000;
/// Places East and North of the first station, metres, on both sides of the date line, and the vessel: place at the
/// beginning, velocity.
const PLACES: [[f64; 2]; 3] = [[0.0, 0.0], [2226.4, 0.0], [1113.2, 2000.0]];
const STATIONS: &str = "[[stations]]\nid = 1\nposition = { lat_deg = 0.0, lon_deg = 179.99, depth_m = 100.0 }\n\
    [[stations]]\nid = 2\nposition = { lat_deg = 0.0, lon_deg = -179.99, depth_m = 100.0 }\n\
    orientation_sd_deg = 0.3\n\
    [[stations]]\nid = 3\nposition = { lat_deg = 0.018087, lon_deg = 180.0, depth_m = 100.0 }\n\
    [[stations]]\nid = 4\n";
/// An area that holds the vessel all the time.
const ALARMS: &str = "[[alarms]]\nkind = \"inside\"\nname = \"here\"\nclear_after_s = 0.5\n\
    polygon = [[-0.1, 179.9], [-0.1, -179.9], [0.1, -179.9], [0.1, 179.9]]\n";
const WAY: [f64; 4] = [600.0, -900.0, 1.5, 6.0];

fn at(t_s: f64) -> [f64; 2] {
    [WAY[0] + WAY[2] * t_s, WAY[1] + WAY[3] * t_s]
}

/// What a station says of the vessel: who it is, when it is, a bearing a second, a report every five, its last word.
fn says(n: usize) -> VecDeque<Message> {
    let mut out = VecDeque::from([
        Message::Hello(Hello {
            wire_version: WIRE_VERSION,
            schema_hash: SCHEMA_HASH,
            config_hash: 1,
            version: (0, 1, 0),
            station: n as u16 + 1,
            kind: 0,
            rate_hz: RATE_HZ as f32,
            reset_cause: 0,
        }),
        Message::Time(Time {
            index: 0,
            utc_us: BEGIN_US,
            sd_s: 0.01,
            drift: 0.0,
            sd_drift: 1e-7,
            correlation: 0.0,
        }),
    ]);
    for second in 0..=LASTS_S {
        let seen = |t_s: f64| {
            let [x, y] = at(t_s);
            let (x, y) = (x - PLACES[n][0], y - PLACES[n][1]);
            ((x as f32, y as f32), x.atan2(y), x.hypot(y))
        };
        let (t_s, index) = (f64::from(second), u64::from(second) * RATE_HZ);
        let (_, azimuth, _) = seen(t_s - seen(t_s).2 / 1484.0);
        let error = 0.004 * (1.7 * t_s + n as f64).sin();
        out.push_back(Message::Bearing(Bearing {
            index,
            azimuth: (azimuth + error).rem_euclid(std::f64::consts::TAU) as f32,
            elevation: 0.1,
            var_azimuth: 1.6e-5,
            var_elevation: 1e-4,
            cov: 0.0,
            snr_db: 12.0,
            quality: 0.9,
            closure_s: 1e-6,
            statistic: 4.0,
            band: 0,
            flags: 0,
        }));
        if second >= 20 && second % 5 == 0 {
            let ((x_m, y_m), ..) = seen(t_s);
            out.push_back(Message::Track(Track {
                id: 1,
                stage: u8::from(second == LASTS_S),
                index,
                cpa_time_s: 150.0,
                cpa_range_m: 500.0,
                cpa_azimuth: 1.0,
                heading: WAY[2].atan2(WAY[3]) as f32,
                speed_m_s: WAY[2].hypot(WAY[3]) as f32,
                starboard: true,
                sd_cpa_time_s: 1.0,
                sd_cpa_range_m: 50.0,
                sd_heading: 0.02,
                sd_speed_m_s: 1.0,
                x_m,
                y_m,
                var_x_m2: 400.0,
                var_y_m2: 400.0,
                cov_xy_m2: 0.0,
                range_observable: true,
                n: 100,
            }));
        }
    }
    out.push_back(Message::End(End { index: u64::from(LASTS_S) * RATE_HZ, frames: 0 }));
    out
}

struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, _: Arrival<'_>) {}
}

/// A recorder with its link, and what it has yet to say.
struct Recorder {
    link: Link<MemoryStore<60_000>>,
    left: VecDeque<Message>,
}

impl Recorder {
    /// Says so many messages of what is left, until they are acknowledged.
    fn say(&mut self, stream: &mut TcpStream, now_us: u64, most: usize) {
        let mut buffer = [0; 160];
        for _ in 0..most.min(40usize.saturating_sub(self.link.waiting() as usize)) {
            let Some(message) = self.left.pop_front() else { break };
            self.link.offer(Class::of(&message), bytes_of(&message, &mut buffer));
        }
        while let Some(frame) = self.link.send(now_us) {
            stream.write_all(frame).unwrap();
        }
        let mut answer = [0; 512];
        if let Ok(n) = stream.read(&mut answer) {
            answer[..n].iter().for_each(|b| self.link.receive(now_us, *b, &mut Nothing));
        }
    }
}

/// A base station that listens.
fn base(folder: &Path) -> (Running, String, BufReader<std::process::ChildStderr>) {
    let child = Command::new(BINARY)
        .args([
            "base",
            "--json",
            "--stations",
            "stations.toml",
            "--listen",
            "127.0.0.1:0",
            "--store",
            "store",
            "--alarms",
            "alarms.toml",
        ])
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = Running(child.unwrap());
    let mut stderr = BufReader::new(child.0.stderr.take().unwrap());
    let (mut address, mut line) = (String::new(), String::new());
    // Who takes no part is named after the address.
    while address.is_empty() || !line.contains("fused") {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "it does not listen: {address}");
        if line.contains("listening at ") {
            address = line.trim().rsplit(' ').next().unwrap().to_owned();
        }
    }
    assert!(line.contains("station 4 has no position"), "{line}");
    (child, address, stderr)
}

fn run(folder: &Path, args: &[&str]) {
    let out = Command::new(BINARY).args(args).current_dir(folder).output().unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
}

/// Network tracks in the store, oldest first.
fn network(folder: &Path) -> Vec<Value> {
    stored(folder, "network_track")
}

/// Records of a type in the store, oldest first.
fn stored(folder: &Path, kind: &str) -> Vec<Value> {
    run(folder, &["export", "--store", "store", "--out", "kept.jsonl"]);
    let all = std::fs::read_to_string(folder.join("kept.jsonl")).unwrap();
    let all = all.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
    all.filter(|r| r["type"] == kind).collect()
}

#[test]
fn a_vessel_past_three_stations_is_one_network_track_through_a_restart_of_the_base() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    std::fs::write(folder.join("stations.toml"), STATIONS).unwrap();
    std::fs::write(folder.join("alarms.toml"), ALARMS).unwrap();
    let begun = Instant::now();
    let mut recorders: Vec<Recorder> = (0..3)
        .map(|n| Recorder {
            link: Link::new(Settings::serial(921_600), n as u16 + 1, 1, 0, MemoryStore::new()),
            left: says(n),
        })
        .collect();
    let half = recorders[0].left.len() / 2;
    let mut before = Vec::new();
    for round in 0..2 {
        let (child, address, _stderr) = base(folder);
        let mut streams: Vec<TcpStream> = (0..3)
            .map(|_| {
                let stream = TcpStream::connect(&address).unwrap();
                stream.set_nodelay(true).unwrap();
                stream.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
                stream
            })
            .collect();
        recorders.iter_mut().for_each(|r| r.link.reconnected());
        let until = if round == 0 { half } else { 0 };
        while recorders.iter().any(|r| r.left.len() > until || r.link.waiting() > 0) {
            for (recorder, stream) in recorders.iter_mut().zip(&mut streams) {
                let most = recorder.left.len().saturating_sub(until).min(10);
                recorder.say(stream, begun.elapsed().as_micros() as u64, most);
            }
            assert!(begun.elapsed() < Duration::from_secs(100));
        }
        // What was fused of it comes a moment later.
        let wanted = if round == 0 { "live" } else { "final" };
        loop {
            before = network(folder);
            if before
                .last()
                .is_some_and(|t| t["state"] == wanted && (round == 0 || t["n"].as_u64() > Some(1100)))
            {
                break;
            }
            assert!(begun.elapsed() < Duration::from_secs(100), "{round}: {before:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
        while round == 1 && stored(folder, "alarm").len() < 2 {
            assert!(begun.elapsed() < Duration::from_secs(100), "no alarm is cleared");
            std::thread::sleep(Duration::from_millis(50));
        }
        drop(child);
    }
    // One vessel, one number, whoever heard of it first.
    assert!(before.iter().all(|t| t["id"] == 1 && t["state"] != "withdrawn"), "{before:?}");
    let alarms = stored(folder, "alarm");
    // One alarm, raised by a station before the restart, and cleared as that of the network track after it.
    let [raised, cleared] = &alarms[..] else { panic!("one vessel, one alarm: {alarms:?}") };
    assert_eq!(
        (&raised["state"], &cleared["state"], &raised["id"]),
        (&"raised".into(), &"cleared".into(), &cleared["id"])
    );
    assert_eq!((&cleared["network"], &cleared["track"]), (&1.into(), &Value::Null), "{cleared}");
    let track = before.last().unwrap();
    assert_eq!(track["members"].as_array().unwrap().len(), 3);
    let n = |key: &str| track[key].as_f64().unwrap();
    // Minutes and seconds of its time.
    let utc = track["utc"].as_str().unwrap();
    let t_s = 60.0 * utc[14..16].parse::<f64>().unwrap() + utc[17..19].parse::<f64>().unwrap();
    let [x, y] = at(t_s);
    let sd_m = (n("var_x_m2") + n("var_y_m2")).sqrt();
    let off_m = (n("x_m") - x).hypot(n("y_m") - y);
    assert!(t_s > f64::from(LASTS_S) - 15.0 && off_m < 10.0 && sd_m < 30.0, "{t_s} {off_m} {sd_m}");
    assert!(
        (n("speed_m_s") - WAY[2].hypot(WAY[3])).abs() < 0.2 && (n("lon_deg") + 179.999).abs() < 0.02,
        "{track}"
    );
    run(folder, &["base", "check", "--store", "store"]);
    run(folder, &["export", "--store", "store", "--stations", "stations.toml", "--out", "map.geojson"]);
    let map: Value = serde_json::from_slice(&std::fs::read(folder.join("map.geojson")).unwrap()).unwrap();
    let features = map["features"].as_array().unwrap();
    let of = |kind: &str| features.iter().filter(|f| f["properties"]["kind"] == kind).count();
    assert_eq!((of("network_track"), of("station")), (1, 3), "{map}");
    // Made anew from the bytes it is the same.
    run(folder, &["base", "rebuild", "--store", "store"]);
    assert_eq!(network(folder).last(), Some(track));
}
