//! Where nothing checks the orientations and clocks of stations, `seabearing locate` and `seabearing config check` say so.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

const ARRAYS_M: [[f64; 2]; 3] = [[-450.0, 0.0], [450.0, 60.0], [0.0, 600.0]];

/// Records and lines on standard error.
fn run(args: &[&str]) -> (Vec<Value>, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).output().expect("the command runs");
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{args:?}: {said}");
    let text = String::from_utf8(out.stdout).unwrap();
    (text.lines().map(|l| serde_json::from_str(l).unwrap()).collect(), said)
}

/// List of the first stations, with `keys` of each, and their bearings of a vessel that passes.
fn write(dir: &Path, stations: usize, elevations: bool, keys: &str) -> [String; 2] {
    let (mut list, mut rows) = (String::new(), String::from("t_s,station,azimuth_deg,elevation_deg\n"));
    for (k, [x, y]) in ARRAYS_M.iter().enumerate().take(stations) {
        let _ = writeln!(
            list,
            "[[stations]]\nid = {}\nkind = \"array\"\nposition = {{ local_m = [{x:.1}, {y:.1}, -100.0] }}\n{keys}",
            k + 1
        );
        for t in 0..60 {
            let (east, north) = (-200.0 + 6.0 * f64::from(t) - x, 300.0 - y);
            let elevation = if elevations {
                95f64.atan2(east.hypot(north)).to_degrees().to_string()
            } else {
                String::new()
            };
            let _ = writeln!(rows, "{t},{},{},{elevation}", k + 1, east.atan2(north).to_degrees());
        }
    }
    ["list.toml", "bearings.csv"].map(|name| {
        let path = dir.join(name);
        std::fs::write(&path, if name.ends_with("toml") { &list } else { &rows }).unwrap();
        path.to_str().unwrap().to_owned()
    })
}

#[test]
fn positions_by_two_azimuths_are_said_to_be_checked_by_nothing_and_hold_what_is_usual() {
    let dir = tempfile::tempdir().unwrap();
    let sd_of = |keys: &str, sigma: &str| {
        let [list, bearings] = write(dir.path(), 2, false, keys);
        let args = [
            "locate",
            "--stations",
            &list,
            "--depth-m",
            "5",
            "--sigma-azimuth-deg",
            sigma,
            &bearings,
            "--json",
        ];
        let (fixes, said) = run(&args);
        assert!(
            said.lines().count() == 1 && said.contains("nothing checks the orientations and clocks"),
            "{said}"
        );
        assert!(
            ["a third array", "elevations", "orient --track"].iter().all(|remedy| said.contains(remedy)),
            "{said}"
        );
        assert!(fixes.len() > 50 && fixes.iter().all(|f| f["checked"] == false), "{fixes:?}");
        let middle = fixes.iter().find(|f| f["t_s"].as_f64() == Some(30.0)).unwrap();
        middle["sd_x_m"].as_f64().unwrap().hypot(middle["sd_y_m"].as_f64().unwrap())
    };
    // Not said, what is usual counts; and what is said counts as it is.
    let [unsaid, usual] = ["", "orientation_sd_deg = 0.5\nclock_sd_s = 2.0"].map(|keys| sd_of(keys, "0.2"));
    let [exact, far_off] =
        ["orientation_sd_deg = 0.0\nclock_sd_s = 0.0", "orientation_sd_deg = 5.0\nclock_sd_s = 0.0"]
            .map(|keys| sd_of(keys, "0.2"));
    assert!((unsaid / usual - 1.0).abs() < 1e-9 && unsaid > 2.0 * exact, "{unsaid} {usual} {exact}");
    // 5° beside 0.2°, of every azimuth alike.
    assert!((20.0..30.0).contains(&(far_off / exact)), "{far_off} {exact}");
}

#[test]
fn more_bearings_than_that_are_a_check() {
    let dir = tempfile::tempdir().unwrap();
    for (stations, elevations) in [(2, true), (3, false)] {
        let [list, bearings] = write(dir.path(), stations, elevations, "");
        let (fixes, said) = run(&["locate", "--stations", &list, "--depth-m", "5", &bearings, "--json"]);
        assert!(said.is_empty() && fixes.iter().all(|f| f["checked"] == true), "{said}");
    }
}

#[test]
fn a_list_of_two_stations_is_said_to_need_more() {
    let dir = tempfile::tempdir().unwrap();
    for stations in [2, 3] {
        let [list, _] = write(dir.path(), stations, false, "");
        let (network, said) = run(&["config", "check", &list, "--json"]);
        assert_eq!(network[0]["azimuths_alone_checked"], stations == 3);
        assert_eq!(said.contains("two azimuths always meet somewhere"), stations == 2, "{said}");
        assert_eq!(said.lines().count(), usize::from(stations == 2), "{said}");
    }
}
