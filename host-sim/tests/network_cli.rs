//! `seabearing locate` and `seabearing orient` as a person runs them.

mod records_of;

use records_of::{number, records, refusal, seabearing};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const ARRAYS_M: [(u16, [f64; 3]); 3] =
    [(1, [0.0, 100.0, -168.0]), (2, [86.6, -50.0, -168.0]), (3, [-86.6, -50.0, -168.0])];
const SOUND_SPEED_M_S: f64 = 1484.0;

/// A vessel at 5 m depth: 300 m East at time 200 s, heading 20°, 6 m/s.
fn vessel_m(t_s: f64) -> [f64; 3] {
    let (s, c) = 20f64.to_radians().sin_cos();
    [300.0 + 6.0 * s * (t_s - 200.0), 6.0 * c * (t_s - 200.0), -5.0]
}

/// East, North, Up from an array to the source `behind_s` of the vessel's way behind its antenna, when the sound that
/// arrives at `t_s` left it.
fn seen(array_m: [f64; 3], t_s: f64, behind_s: f64) -> [f64; 3] {
    let mut left_s = t_s;
    let mut way = [0.0; 3];
    for _ in 0..20 {
        let p = vessel_m(left_s - behind_s);
        way = [0, 1, 2].map(|k| p[k] - array_m[k]);
        left_s = t_s - way.iter().map(|x| x * x).sum::<f64>().sqrt() / SOUND_SPEED_M_S;
    }
    way
}

/// Network file and bearings of every array, each at its own instants; errors of ±0.5° that alternate.
fn write(dir: &Path, behind_s: f64, turned: impl Fn(u16) -> f64) -> (PathBuf, PathBuf) {
    let (stations, bearings) = (dir.join("network.toml"), dir.join("bearings.csv"));
    let mut network = String::new();
    let mut rows = String::from("t_s,station,azimuth_deg,elevation_deg\n");
    for (id, [x, y, z]) in ARRAYS_M {
        let _ = writeln!(
            network,
            "[[stations]]\nid = {id}\nname = \"s{id}\"\nkind = \"array\"\nposition = {{ local_m = [{x:.1}, {y:.1}, {z:.1}] }}"
        );
        for k in 0..200 {
            let t = 2.0 * f64::from(k) + 0.3 * f64::from(id);
            let [e, n, u] = seen([x, y, z], t, behind_s);
            let error = if k % 2 == 0 { 0.5 } else { -0.5 };
            let azimuth = e.atan2(n).to_degrees() + error + turned(id);
            let _ = writeln!(rows, "{t},s{id},{azimuth},{}", u.atan2(e.hypot(n)).to_degrees() - error);
        }
    }
    std::fs::write(&stations, network).unwrap();
    std::fs::write(&bearings, rows).unwrap();
    (stations, bearings)
}

#[test]
fn positions_follow_the_vessel() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 0.0, |_| 0.0);
    let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
    let fixes = records(&["locate", "--stations", s, "--depth-m", "5", b, "--json"]);
    assert!(fixes.len() > 150);
    for fix in fixes.iter().filter(|f| (150.0..250.0).contains(&number(f, "t_s"))) {
        assert_eq!(fix["type"], "fix");
        // The place belongs to the moment the sound left the vessel.
        let (t_s, source_s) = (number(fix, "t_s"), number(fix, "t_source_s"));
        let p = vessel_m(source_s);
        let way_m = |[x, y, z]: [f64; 3]| (p[0] - x).hypot(p[1] - y).hypot(p[2] - z);
        let mean_m = ARRAYS_M.iter().map(|(_, array)| way_m(*array)).sum::<f64>() / ARRAYS_M.len() as f64;
        assert!((t_s - source_s - mean_m / SOUND_SPEED_M_S).abs() < 0.02, "{fix}");
        let off = (number(fix, "x_m") - p[0]).hypot(number(fix, "y_m") - p[1]);
        assert!(off < 3.0 * number(fix, "sd_x_m").hypot(number(fix, "sd_y_m")), "{fix}");
    }
}

#[test]
fn one_motion_from_all_arrays_needs_no_speed_and_finds_a_turned_array() {
    let dir = tempfile::tempdir().unwrap();
    for turn in [0.0, 25.0] {
        let (stations, bearings) = write(dir.path(), 0.0, |id| if id == 3 { turn } else { 0.0 });
        let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
        let tracks = records(&["locate", "--stations", s, "--depth-m", "5", "--motion", b, "--json"]);
        assert_eq!(tracks.len(), 3);
        for (track, (id, [x, y, _])) in tracks.iter().zip(ARRAYS_M) {
            assert_eq!((&track["type"], number(track, "station")), (&Value::from("track"), f64::from(id)));
            let bad = turn != 0.0 && id == 3;
            assert_eq!(track["wrong"].as_str(), bad.then_some("orientation"), "{track}");
            assert_eq!((&track["rejected"], &track["consistent"]), (&Value::Null, &Value::from(true)));
            let turned = number(track, "turned_deg") - if bad { turn } else { 0.0 };
            assert!(turned.abs() < 2.0 * number(track, "sd_turned_deg") && turned.abs() < 1.0, "{track}");
            assert!(number(track, "late_s").abs() <= 2.0 * number(track, "sd_late_s"), "{track}");
            // By hand: the course is x = 300 + s τ, y = c τ; the array's distance from that line, and when.
            let (sine, cosine) = 20f64.to_radians().sin_cos();
            let (dx, dy) = (300.0 - x, -y);
            let time = 200.0 - (dx * sine + dy * cosine) / 6.0;
            let across = dx * cosine - dy * sine;
            for (key, truth, sd) in [
                ("cpa_range_m", across.abs(), number(track, "sd_cpa_range_m")),
                ("cpa_time_s", time, number(track, "sd_cpa_time_s")),
                ("heading_deg", 20.0, number(track, "sd_heading_deg")),
                ("speed_m_s", 6.0, number(track, "sd_speed_m_s")),
            ] {
                let error = number(track, key) - truth;
                assert!(sd > 0.0 && error.abs() < 2.0 * sd, "{key}: off by {error}, sd {sd}: {track}");
            }
            assert_eq!(track["side"], if across > 0.0 { "port" } else { "starboard" });
        }
    }
}

#[test]
fn a_second_vessel_in_one_array_is_set_aside_and_of_two_arrays_the_contradiction_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 0.0, |_| 0.0);
    let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
    let text = std::fs::read_to_string(&bearings).unwrap();
    // The third array hears another vessel, 400 m West of it and southbound.
    let other = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let t: f64 = cells[0].parse().unwrap();
        let (east, north) = (-400.0 + 0.5 * t, 900.0 - 5.0 * t);
        format!("{t},{},{},", cells[1], east.atan2(north).to_degrees().rem_euclid(360.0))
    };
    let rows: Vec<String> =
        text.lines().map(|l| if l.contains(",s3,") { other(l) } else { l.to_owned() }).collect();
    std::fs::write(&bearings, rows.join("\n")).unwrap();
    let tracks = records(&["locate", "--stations", s, "--depth-m", "5", "--motion", b, "--json"]);
    for track in &tracks {
        assert_eq!(track["rejected"], 3, "{track}");
        assert!((number(track, "speed_m_s") - 6.0).abs() < 2.0 * number(track, "sd_speed_m_s"), "{track}");
    }
    assert!(tracks[0].get("turned_deg").is_some() && tracks[2].get("turned_deg").is_none());
    // Of two arrays nobody knows which.
    let rows = rows.iter().filter(|l| !l.contains(",s2,")).cloned().collect::<Vec<_>>();
    std::fs::write(&bearings, rows.join("\n")).unwrap();
    let said = refusal(&["locate", "--stations", s, "--depth-m", "5", "--motion", b]);
    assert!(said.contains("contradict each other"), "{said}");
    // One vessel, and one of the two turned: that is found, and said.
    let (_, bearings) = write(dir.path(), 0.0, |id| if id == 2 { 6.0 } else { 0.0 });
    let text = std::fs::read_to_string(&bearings).unwrap();
    let rows: Vec<&str> = text.lines().filter(|l| !l.contains(",s3,")).collect();
    std::fs::write(&bearings, rows.join("\n")).unwrap();
    let out = seabearing(&["locate", "--stations", s, "--depth-m", "5", "--motion", b, "--json"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(said.contains("`s2`") && said.contains("too large") && said.lines().count() == 1, "{said}");
    let text = String::from_utf8(out.stdout).unwrap();
    let track: Value = serde_json::from_str(text.lines().nth(1).unwrap()).unwrap();
    assert!(track["wrong"] == "orientation" && (number(&track, "turned_deg") - 6.0).abs() < 1.0, "{track}");
}

#[test]
fn a_late_clock_is_said_with_the_station_against_whose_it_is_late() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 0.0, |_| 0.0);
    let text = std::fs::read_to_string(&bearings).unwrap();
    let late = |line: &str| {
        let (t_s, rest) = line.split_once(',').unwrap();
        format!("{},{rest}", t_s.parse::<f64>().unwrap() + 8.0)
    };
    let rows: Vec<String> =
        text.lines().map(|l| if l.contains(",s2,") { late(l) } else { l.to_owned() }).collect();
    std::fs::write(&bearings, rows.join("\n")).unwrap();
    let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
    let out = seabearing(&["locate", "--stations", s, "--depth-m", "5", b, "--json"]);
    let said = String::from_utf8(out.stderr).unwrap();
    let late = said.split("the clock of `s2` is ").nth(1).expect(&said);
    let late_s: f64 = late.split(' ').next().unwrap().parse().unwrap();
    assert!((late_s - 8.0).abs() < 1.0 && late.contains("late against that of `s1`"), "{said}");
}

#[test]
fn priors_of_orientation_and_clock_stand_in_the_network_file() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 0.0, |id| if id == 2 { 4.0 } else { 0.0 });
    let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
    let network = std::fs::read_to_string(&stations).unwrap();
    let ask = |keys: &str| {
        std::fs::write(&stations, network.replace("kind = \"array\"", &format!("kind = \"array\"\n{keys}")))
            .unwrap();
        seabearing(&["locate", "--stations", s, "--depth-m", "5", "--motion", b, "--json"])
    };
    let second = |keys: &str| {
        let out = ask(keys);
        let text = String::from_utf8(out.stdout).unwrap();
        serde_json::from_str::<Value>(text.lines().nth(1).unwrap()).unwrap()
    };
    // Known to be hardly known, it is found; said to be known, it is found to be wrong.
    let open = second("orientation_sd_deg = 5.0\nclock_sd_s = 0.01");
    assert!(open.get("wrong").is_none() && (number(&open, "turned_deg") - 4.0).abs() < 1.0, "{open}");
    assert!(number(&open, "sd_late_s") < 0.02);
    let known = second("orientation_sd_deg = 0.1\nclock_sd_s = 0.01");
    assert!(known["wrong"] == "orientation" && (number(&known, "turned_deg") - 4.0).abs() < 1.0, "{known}");
    for keys in [
        "orientation_deg = 777.0",
        "orientation_sd_deg = -1.0",
        "orientation_sd_deg = 181.0",
        "clock_sd_s = -1.0",
        "clock_sd_s = nan",
    ] {
        let out = ask(keys);
        let said = String::from_utf8(out.stderr).unwrap();
        let key = keys.split(' ').next().unwrap();
        assert!(!out.status.success() && said.lines().count() == 1 && said.contains(key), "{keys}: {said}");
    }
}

#[test]
fn the_sound_source_is_found_behind_the_antenna() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 9.0, |_| 0.0);
    let gps = dir.path().join("gps.csv");
    let mut text = String::from("t_s,x_m,y_m\n");
    for t in (-50..=450).step_by(10) {
        let [x, y, _] = vessel_m(f64::from(t));
        let _ = writeln!(text, "{t},{x},{y}");
    }
    std::fs::write(&gps, text).unwrap();
    let (s, b, g) = (stations.to_str().unwrap(), bearings.to_str().unwrap(), gps.to_str().unwrap());
    for r in records(&["locate", "--stations", s, "--known-track", g, b, "--json"]) {
        assert_eq!(r["type"], "alignment");
        let (shift, sd) = (number(&r, "shift_s"), number(&r, "sd_s"));
        assert!((shift - 9.0).abs() < 2.0 * sd && sd < 2.0, "{r}");
    }
}

#[test]
fn what_cannot_be_located_is_said_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 0.0, |_| 0.0);
    let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
    let one = dir.path().join("one.csv");
    let text = std::fs::read_to_string(&bearings).unwrap();
    let alone = |l: &&str| l.starts_with("t_s") || l.contains(",s1,");
    let without_elevation = |l: &str| format!("{},\n", l.rsplit_once(',').unwrap().0);
    let rows: String = text.lines().filter(alone).map(without_elevation).collect();
    std::fs::write(&one, rows.replacen("azimuth_deg,\n", "azimuth_deg,elevation_deg\n", 1)).unwrap();
    let said = refusal(&["locate", "--stations", s, "--motion", one.to_str().unwrap()]);
    assert!(said.contains("one.csv") && said.contains("not observable"), "{said}");
    assert!(refusal(&["locate", "--stations", s, "--tau-s", "-1", b]).contains("--tau-s"));
    assert!(refusal(&["locate", "--stations", s, "--dept-m", "5", b]).contains("--depth-m"));
    assert!(refusal(&["locate"]).contains("--stations"));
    assert!(refusal(&["locate", "--stations", s, "missing.csv"]).contains("missing.csv"));
    std::fs::write(&one, "t_s,station,azimuth_deg,elevation_deg\n1,s9,10,\n").unwrap();
    let out = seabearing(&["locate", "--stations", s, one.to_str().unwrap()]);
    assert!(!out.status.success());
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(said.contains("line 2") && said.contains("s9"), "{said}");
}

#[test]
fn a_buoy_is_oriented_by_a_ship_of_known_track() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(
        path("buoy.toml"),
        "[station]\nid = 1\nname = \"buoy\"\nkind = \"obs\"\nposition = { local_m = [0.0, 0.0, -20.0] }\n\
         [sampling]\nrate_hz = 50\n[obs]\norientation_of_north_deg = 30.0\n",
    )
    .unwrap();
    let (mut track, mut bearings) = (String::from("t_s,x_m,y_m\n"), String::from("t_s,azimuth_deg\n"));
    for k in 0..30 {
        let t = 10.0 * f64::from(k);
        let (x, y) = (-900.0 + 6.0 * t, 400.0);
        let _ = writeln!(track, "{t},{x},{y}");
        // Its north points to 17.2°, not 30°; whole degrees; one in ten is the opposite direction.
        let wrong = if k % 10 == 4 { 180.0 } else { 0.0 };
        let _ =
            writeln!(bearings, "{t},{}", (x.atan2(y).to_degrees() + 12.8 + wrong).rem_euclid(360.0).round());
    }
    std::fs::write(path("ship.csv"), track).unwrap();
    std::fs::write(path("azimuths.csv"), bearings).unwrap();
    let found = records(&[
        "orient",
        "--station",
        &path("buoy.toml"),
        "--track",
        &path("ship.csv"),
        &path("azimuths.csv"),
        "--json",
    ]);
    let (turn, sd) = (number(&found[0], "orientation_deg"), number(&found[0], "sd_deg"));
    assert!(found[0]["type"] == "orientation" && (turn - 17.2).abs() < 3.0 * sd && sd < 1.0, "{found:?}");
}

#[test]
fn records_of_recorders_with_clocks_of_their_own_start_are_brought_together() {
    let dir = tempfile::tempdir().unwrap();
    let (stations, bearings) = write(dir.path(), 0.0, |_| 0.0);
    let text = std::fs::read_to_string(&bearings).unwrap();
    let mut files = Vec::new();
    for (id, _) in ARRAYS_M {
        // Each recorder counts from its own start, a minute after the one before.
        let late_s = 60.0 * f64::from(id);
        let mut lines = format!("{{\"type\":\"hello\",\"station\":{id}}}\n");
        for row in text.lines().filter(|l| l.contains(&format!(",s{id},"))) {
            let cells: Vec<&str> = row.split(',').collect();
            let t: f64 = cells[0].parse().unwrap();
            let (minute, second) = (t as u32 / 60, t % 60.0);
            let _ = writeln!(
                lines,
                "{{\"type\":\"bearing\",\"t_s\":{},\"utc\":\"2026-03-01T10:{minute:02}:{second:06.3}Z\",\
                 \"azimuth_deg\":{},\"elevation_deg\":{},\"sd_azimuth_deg\":0.5,\"band\":0}}",
                t - late_s,
                cells[2],
                cells[3]
            );
            let _ = writeln!(lines, "{{\"type\":\"bearing\",\"t_s\":0,\"azimuth_deg\":1,\"band\":3}}");
        }
        let file = dir.path().join(format!("{id}.jsonl"));
        std::fs::write(&file, lines).unwrap();
        files.push(file.to_str().unwrap().to_owned());
    }
    let s = stations.to_str().unwrap();
    let f: Vec<&str> = files.iter().map(String::as_str).collect();
    let fixes = records(&[&["locate", "--stations", s, "--depth-m", "5", "--json"], &f[..]].concat());
    assert!(fixes.len() > 150);
    // Time zero is sample 0 of the recording that began first, though no bearing is of that time.
    let fix = fixes.iter().find(|f| number(f, "t_s") > 140.0).unwrap();
    assert_eq!(fix["stations"], serde_json::json!([1, 2, 3]));
    let p = vessel_m(number(fix, "t_s") + 60.0 - 0.2);
    assert!((number(fix, "x_m") - p[0]).hypot(number(fix, "y_m") - p[1]) < 10.0, "{fix} {p:?}");
    assert!(fix["utc"].as_str().unwrap().starts_with("2026-03-01T10:03:2"), "{fix}");
    let motion = |files: &[&str]| {
        records(&[&["locate", "--stations", s, "--depth-m", "5", "--motion", "--json"], files].concat())
    };
    let track = motion(&f);
    assert!((number(&track[0], "speed_m_s") - 6.0).abs() < 0.1, "{track:?}");
    // A minute earlier than in the time of the bearings; in the table it is the table's.
    let of_table = motion(&[bearings.to_str().unwrap()]);
    for key in ["cpa_time_s", "t_s"] {
        let off = number(&track[0], key) + 60.0 - number(&of_table[0], key);
        assert!(off.abs() < 0.01, "{key}: {off}");
    }
    assert!(track[0]["utc"].as_str().unwrap().starts_with("2026-03-01T10:00:0"), "{track:?}");
    assert!(track[0]["utc_cpa"].is_string() && of_table[0].get("utc").is_none(), "{track:?}");
}

#[test]
fn an_error_that_lasts_is_told_over_many_positions_though_none_of_them_shows_it() {
    let dir = tempfile::tempdir().unwrap();
    for turn in [0.0, 3.0] {
        let (stations, bearings) = write(dir.path(), 0.0, |id| if id == 3 { turn } else { 0.0 });
        let (s, b) = (stations.to_str().unwrap(), bearings.to_str().unwrap());
        // Each bearing is said to err by 3°.
        let args = ["--depth-m", "5", "--sigma-azimuth-deg", "3", "--sigma-elevation-deg", "3", "--json"];
        let out = seabearing(&[&["locate", "--stations", s, b], &args[..]].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        let text = String::from_utf8(out.stdout).unwrap();
        let fixes: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let fixes: Vec<&Value> = fixes.iter().filter(|f| f["type"] == "fix").collect();
        assert!(fixes.len() > 150 && fixes.iter().all(|f| number(f, "misfit") < 16.0), "{}", fixes.len());
        let told = said.contains("azimuths of `s3`") && said.contains("more than the network file allows");
        assert_eq!((told, said.lines().count()), (turn != 0.0, usize::from(turn != 0.0)), "{said}");
        assert!(fixes.iter().all(|f| f["consistent"] == (turn == 0.0)), "{turn}");
    }
}
