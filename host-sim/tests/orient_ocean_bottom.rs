//! `seabearing orient` for an ocean-bottom station: orientation and position from records and from a recording.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn seabearing(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).output().unwrap()
}

/// Where the station is against its nominal position, m; its first horizontal's azimuth, and what is configured.
const MOVED_M: (f64, f64) = (350.0, -120.0);
const TRUE_DEG: f64 = 77.0;
const CONFIGURED_DEG: f64 = 60.0;

/// A vessel's place about the station: closest at a time and range, on a heading, at 7 m/s.
fn vessel(t_s: f64, cpa_time_s: f64, cpa_range_m: f64, heading_deg: f64) -> (f64, f64) {
    let (s, c) = heading_deg.to_radians().sin_cos();
    let along = 7.0 * (t_s - cpa_time_s);
    (cpa_range_m * c + along * s, -cpa_range_m * s + along * c)
}

/// The vessel's track in the frame of the nominal position.
fn write_track(path: &Path, from_s: f64, to_s: f64, at: impl Fn(f64) -> (f64, f64)) {
    let mut text = String::from("t_s,x_m,y_m\n");
    let mut t = from_s;
    while t <= to_s {
        let (x, y) = at(t);
        let _ = writeln!(text, "{t},{},{}", x + MOVED_M.0, y + MOVED_M.1);
        t += 60.0;
    }
    std::fs::write(path, text).unwrap();
}

/// A folder with a station (its table is made by the command) as it is thought to be.
fn station(dir: &Path) -> String {
    let profile = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/ocean-profile.csv");
    let table = dir.join("table.toml");
    let made = seabearing(&[
        "propagation",
        "--profile",
        profile.to_str().unwrap(),
        "--depth-m",
        "4340",
        "--rows",
        "360",
        "--step-m",
        "140",
        "--out",
        table.to_str().unwrap(),
    ]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let path = dir.join("station.toml");
    let text = format!(
        "[station]\nid = 1\nkind = \"obs\"\nsound_speed_m_s = 1500.0\nposition = {{ lat_deg = -30.0, lon_deg = 54.0 }}\n\
         [sampling]\nrate_hz = 50.0\n[obs]\ncomponents = {{ pressure = \"BDH\", north = \"BH1\", east = \"BH2\", \
         vertical = \"BHZ\" }}\norientation_of_north_deg = {CONFIGURED_DEG}\npropagation = \"table.toml\"\n"
    );
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn records(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

fn number(record: &Value, key: &str) -> f64 {
    record[key].as_f64().unwrap_or_else(|| panic!("no {key} in {record}"))
}

/// Both records say the truth within their uncertainty and the given bounds.
fn judge(records: &[Value], most_deg: f64, most_m: f64) {
    let [turn, place] = records else { panic!("{records:?}") };
    assert_eq!((&turn["type"], &place["type"]), (&"orientation".into(), &"position".into()));
    let error = number(turn, "orientation_deg") - TRUE_DEG;
    assert!(error.abs() < most_deg && error.abs() < 4.0 * number(turn, "sd_deg"), "{turn}");
    for (key, sd, truth) in [("x_m", "sd_x_m", MOVED_M.0), ("y_m", "sd_y_m", MOVED_M.1)] {
        let error = number(place, key) - truth;
        assert!(error.abs() < most_m && error.abs() < 4.0 * number(place, sd), "{place}");
    }
    // A degree of latitude is 110.85 km at 30°.
    assert!((number(place, "lat_deg") + 30.0 - number(place, "y_m") / 110_850.0).abs() < 1e-4, "{place}");
}

/// Records as `process` gives them once a minute: every fifth range on a wrong branch, azimuths with 2° of error.
fn write_records(path: &Path, passes: &[(f64, f64, f64)]) {
    let mut text = String::from("{\"type\":\"hello\",\"wire_version\":1}\n");
    for (k, &(cpa_time_s, cpa_range_m, heading_deg)) in passes.iter().enumerate() {
        for m in 0..240 {
            let t = cpa_time_s - 7200.0 + 60.0 * f64::from(m);
            // The vessel is heard where it was; 1/1500 s/m is near what the table says at these ranges.
            let mut at = vessel(t, cpa_time_s, cpa_range_m, heading_deg);
            for _ in 0..4 {
                let slant = at.0.hypot(at.1).hypot(4340.0);
                at = vessel(t - slant / 1500.0, cpa_time_s, cpa_range_m, heading_deg);
            }
            let noise = |a: f64| (a * f64::from(m + 11 * k as i32)).sin();
            let wrong = if m % 5 == 2 { 1.6 } else { 1.0 };
            let range = at.0.hypot(at.1) * wrong + 60.0 * noise(2.3);
            let azimuth = at.0.atan2(at.1).to_degrees() - (TRUE_DEG - CONFIGURED_DEG) + 2.0 * noise(1.7);
            let _ = writeln!(
                text,
                "{{\"type\":\"azimuth\",\"t_s\":{t},\"azimuth_deg\":{},\"sd_deg\":1.0,\"weight\":1.0,\"detected\":true,\
                 \"source\":\"tonal\"}}\n{{\"type\":\"range\",\"t_s\":{t},\"range_m\":{range},\"sd_range_m\":60.0,\
                 \"weight\":0.9,\"detected\":true}}",
                azimuth.rem_euclid(360.0)
            );
        }
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn records_of_two_passages_give_orientation_and_position() {
    let dir = tempfile::tempdir().unwrap();
    let station = station(dir.path());
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let passes = [(8000.0, 9000.0, 60.0), (40_000.0, 6000.0, 170.0)];
    write_records(Path::new(&path("r.jsonl")), &passes);
    for (k, &(cpa_time_s, range, heading)) in passes.iter().enumerate() {
        write_track(Path::new(&path(&format!("{k}.csv"))), cpa_time_s - 7800.0, cpa_time_s + 7800.0, |t| {
            vessel(t, cpa_time_s, range, heading)
        });
    }
    let tracks = [path("0.csv"), path("1.csv")];
    let input = path("r.jsonl");
    let args =
        ["orient", "--station", &station, "--track", &tracks[0], "--track", &tracks[1], "--json", &input];
    let output = seabearing(&args);
    let got = records(&output);
    judge(&got, 0.5, 60.0);
    assert!(got[1]["consistent"] == true && number(&got[1], "time_shift_s").abs() < 10.0, "{got:?}");

    // Tracks whose clock is a minute late are said to be.
    for (k, &(cpa_time_s, range, heading)) in passes.iter().enumerate() {
        write_track(Path::new(&tracks[k]), cpa_time_s - 7800.0, cpa_time_s + 7800.0, |t| {
            vessel(t - 60.0, cpa_time_s, range, heading)
        });
    }
    let output = seabearing(&args);
    let (got, said) = (records(&output), String::from_utf8_lossy(&output.stderr));
    // No one place explains them; where one does nearly it is told as inconsistent.
    assert!(got.iter().all(|r| r["type"] != "position" || r["consistent"] == false), "{got:?}");
    assert!(said.contains(") later than those of the recording"), "{said}");

    // One passage over the station: either side of it is as good, and that is said; the orientation stays.
    let over = [(8000.0, 0.0, 60.0)];
    write_records(Path::new(&input), &over);
    write_track(Path::new(&tracks[0]), 200.0, 15_800.0, |t| {
        let (x, y) = vessel(t, 8000.0, 0.0, 60.0);
        // A station 500 m beside the course, and its mirror image.
        (x + 250.0, y - 433.0)
    });
    let output = seabearing(&["orient", "--station", &station, "--track", &tracks[0], "--json", &input]);
    let got = records(&output);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(got.len(), 1, "{got:?}");
    assert!(said.contains("the position is not observed") && said.lines().count() == 1, "{said}");

    // Nothing to go by: one line, no record.
    std::fs::write(&input, "{\"type\":\"hello\"}\n").unwrap();
    let output = seabearing(&["orient", "--station", &station, "--track", &tracks[0], "--json", &input]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && output.stdout.is_empty());
    assert!(said.contains("no detected azimuth or range") && said.lines().count() == 1, "{said}");
}

#[test]
fn a_recording_of_one_passage_gives_both_too() {
    let dir = tempfile::tempdir().unwrap();
    let assumed = station(dir.path());
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let scenario = format!(
        "kind = \"obs\"\nseed = 4\nduration_s = 9000.0\npropagation = \"table.toml\"\norientation_of_north_deg = {TRUE_DEG}\n\
         [[vessels]]\nstraight = {{ cpa_time_s = 4500.0, cpa_range_m = 7000.0, heading_deg = 150.0, speed_m_s = 7.0, side = \"port\" }}\n"
    );
    std::fs::write(path("s.toml"), scenario).unwrap();
    let simulated = seabearing(&["simulate", &path("s.toml"), "--out", &path("rec")]);
    assert!(simulated.status.success(), "{}", String::from_utf8_lossy(&simulated.stderr));
    write_track(Path::new(&path("t.csv")), -60.0, 9060.0, |t| vessel(t, 4500.0, 7000.0, 150.0));
    let files = ["BDH", "BH1", "BH2", "BHZ"].map(|c| path(&format!("rec/RR03.{c}.mseed")));
    let track = path("t.csv");
    let mut args = vec!["orient", "--station", &assumed, "--track", &track, "--json"];
    args.extend(files.iter().map(String::as_str));
    let output = seabearing(&args);
    judge(&records(&output), 1.5, 60.0);
}
