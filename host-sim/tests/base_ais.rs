//! `seabearing base --ais`: tracks with their vessels as they come, stored; a source that says nonsense and goes away;
//! an end by a signal.
#![cfg(unix)]

mod base_process;

use base_process::{Base, hello, kept, wait};
use seabearing_core::wire::{Encoder, Message, Time, Track};
use serde_json::{Value, json};
use std::io::Write;
use std::net::TcpListener;
use std::process::Command;

/// 2026-06-01, microseconds since 1970.
const BEGIN_US: i64 = 1_780_272_000_000_000;
const STATIONS: &str = "[[stations]]\nid = 7\nposition = { lat_deg = 0.0, lon_deg = 0.0, depth_m = 100.0 }\nline = \"listen:127.0.0.1:0\"\n";
/// Metres in a degree at the equator, closely.
const DEGREE_M: f64 = 111_195.0;

/// A vessel `x_m` East of the station that goes North at 5 m/s.
fn track(id: u16, x_m: f32, second: u32) -> Message {
    Message::Track(Track {
        id,
        stage: Track::RUNNING,
        index: u64::from(second) * 1000,
        cpa_time_s: 100.0,
        cpa_range_m: x_m.abs(),
        cpa_azimuth: 1.57,
        heading: 0.0,
        speed_m_s: 5.0,
        starboard: false,
        sd_cpa_time_s: 2.0,
        sd_cpa_range_m: 20.0,
        sd_heading: 0.05,
        sd_speed_m_s: 0.3,
        x_m,
        y_m: 5.0 * second as f32 - 500.0,
        var_x_m2: 400.0,
        var_y_m2: 400.0,
        cov_xy_m2: 0.0,
        range_observable: true,
        n: 20,
    })
}

/// A vessel of AIS 600 m East of the station that goes North at 5 m/s, for 200 s.
fn traffic() -> String {
    let mut traffic = String::from("mmsi,time,lat,lon\n");
    for second in (0..200u32).step_by(10) {
        let north = 5.0 * f64::from(second) - 500.0;
        let (minute, rest) = (second / 60, second % 60);
        traffic +=
            &format!("11,2026-06-01 00:{minute:02}:{rest:02},{},{}\n", north / DEGREE_M, 600.0 / DEGREE_M);
    }
    traffic
}

#[test]
fn records_of_a_vessel_that_two_stations_hear_have_one_verdict() {
    let dir = tempfile::tempdir().unwrap();
    let second = STATIONS.replace("id = 7", "id = 8").replace("lon_deg = 0.0", "lon_deg = 0.01");
    std::fs::write(dir.path().join("stations.toml"), STATIONS.to_owned() + &second).unwrap();
    std::fs::write(dir.path().join("traffic.csv"), traffic()).unwrap();
    let mut records = String::new();
    for t in (0..200u32).step_by(10) {
        let north = 5.0 * f64::from(t) - 500.0;
        let utc = format!("2026-06-01T00:{:02}:{:02}Z", t / 60, t % 60);
        for (station, x_m) in [(7, 600.0), (8, 600.0 - 0.01 * DEGREE_M)] {
            let track = json!({ "type": "track", "station": station, "session": 1, "id": 1, "stage": "running", "t_s": t,
                "utc": utc, "x_m": x_m, "y_m": north, "var_x_m2": 400.0, "var_y_m2": 400.0, "cov_xy_m2": 0.0,
                "range_observable": true, "heading_deg": 0.0, "sd_heading_deg": 3.0, "speed_m_s": 5.0, "sd_speed_m_s": 0.3 });
            records += &format!("{track}\n");
        }
        let member = |station: u16| json!({ "station": station, "session": 1, "id": 1 });
        let network = json!({ "type": "network_track", "id": 4, "state": "live", "utc": utc, "members": [member(7), member(8)],
            "lat_deg": north / DEGREE_M, "lon_deg": 600.0 / DEGREE_M, "var_x_m2": 100.0, "var_y_m2": 100.0, "cov_xy_m2": 0.0,
            "heading_deg": 0.0, "sd_heading_deg": 3.0, "speed_m_s": 5.0, "sd_speed_m_s": 0.3 });
        records += &format!("{network}\n");
    }
    std::fs::write(dir.path().join("records.jsonl"), records).unwrap();
    let mut command = Command::new(base_process::BINARY);
    command.args([
        "ais",
        "match",
        "--stations",
        "stations.toml",
        "--ais",
        "traffic.csv",
        "--json",
        "records.jsonl",
    ]);
    let out = command.current_dir(dir.path()).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let said = String::from_utf8(out.stdout).unwrap();
    let said: Vec<Value> = said.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let verdicts: Vec<&Value> = said.iter().filter(|r| r["type"] == "ais_match").collect();
    assert_eq!(verdicts.len(), 1, "{said:?}");
    assert_eq!((&verdicts[0]["network"], &verdicts[0]["mmsi"]), (&4.into(), &11.into()), "{said:?}");
}

#[test]
fn tracks_get_their_vessels_and_a_source_that_fails_stops_nothing() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("stations.toml"), STATIONS).unwrap();
    std::fs::write(dir.path().join("traffic.csv"), traffic()).unwrap();
    let receiver = TcpListener::bind("127.0.0.1:0").unwrap();
    let source = format!("tcp:{}", receiver.local_addr().unwrap());
    let args = ["--stations", "stations.toml", "--store", "store", "--ais", "traffic.csv", "--ais", &source];
    let mut base = Base::start(dir.path(), &[&args[..], &["--export", "tracks.csv"]].concat());
    let (mut line, mut encoder) = (base.call(), Encoder::default());
    let time = Time { index: 0, utc_us: BEGIN_US, sd_s: 0.01, drift: 0.0, sd_drift: 1e-7, correlation: 0.0 };
    for message in [hello(7), Message::Time(time)] {
        line.write_all(encoder.frame(&message)).unwrap();
    }
    for second in (0..200u32).step_by(10) {
        for message in [track(1, 605.0, second), track(2, -700.0, second)] {
            line.write_all(encoder.frame(&message)).unwrap();
        }
    }
    let mut peer = receiver.accept().unwrap().0;
    peer.write_all(b"no sentence\n").unwrap();
    drop(peer);
    let has = |all: &[Value], key: &str, word: &str| all.iter().any(|r| r[key] == word);
    let all = wait(dir.path(), "verdicts and warnings", |all| {
        has(all, "verdict", "vessel")
            && has(all, "verdict", "dark")
            && has(all, "code", "AisBroken")
            && has(all, "code", "AisAway")
    });
    let of = |id: u16| all.iter().rfind(|r| r["type"] == "ais_match" && r["id"] == id).unwrap();
    assert_eq!((of(1)["verdict"].as_str(), of(1)["mmsi"].as_u64()), (Some("vessel"), Some(11)), "{}", of(1));
    assert_eq!((of(2)["verdict"].as_str(), of(2)["station"].as_u64()), (Some("dark"), Some(7)), "{}", of(2));
    assert_eq!(all.iter().filter(|r| r["code"] == "AisAway").count(), 1);
    // It is called again.
    drop(receiver.accept().unwrap());
    // Before files are written as time goes by, a signal ends it in order: what all came to is stored and exported.
    let pid = base.child.0.id().to_string();
    assert!(Command::new("kill").args(["-s", "TERM", &pid]).status().unwrap().success());
    assert!(base.child.0.wait().unwrap().code().is_none());
    let said = base.kill();
    assert!(said.ends_with("seabearing: interrupted: what came is written\n"), "{said}");
    let fleet: Vec<Value> = kept(dir.path()).into_iter().filter(|r| r["type"] == "ais_fleet").collect();
    assert_eq!((fleet.len(), fleet[0]["vessels"].as_u64(), fleet[0]["dark"].as_u64()), (1, Some(1), Some(1)));
    let tracks = std::fs::read_to_string(dir.path().join("tracks.csv")).unwrap();
    assert_eq!(tracks.lines().count(), 1 + 40);
}
