//! `seabearing orient` and `bearing` of a compact array as a person runs them: sign, geometry, and bearings off the track.

mod records_of;

use records_of::{number, records, refusal, seabearing};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;

const SOUND_SPEED_M_S: f64 = 1484.0;

/// A compact array's station file, and a track past it, 300 m off at 163 m of height.
fn compact(dir: &Path) -> (String, String) {
    let path = |name: &str| dir.join(name).to_str().unwrap().to_owned();
    std::fs::write(
        path("array.toml"),
        "[station]\nid = 1\nkind = \"array\"\nposition = { local_m = [0.0, 0.0, -168.0] }\n[sampling]\nrate_hz = 64000\n\
         [array]\nhydrophones_m = [[0.0, 0.0, 0.0], [0.52, -0.12, -0.81], [-0.46, -0.36, -0.8], [-0.14, 0.61, -0.77]]\n",
    )
    .unwrap();
    let mut track = String::from("t_s,x_m,y_m\n");
    for t in (0..=200).step_by(10) {
        let _ = writeln!(track, "{t},{},{}", 250.0, -700.0 + 7.0 * f64::from(t));
    }
    std::fs::write(path("ship.csv"), track).unwrap();
    (path("array.toml"), path("ship.csv"))
}

/// The unit vector to the ship when the sound of a time left it, nearly.
fn to_the_ship(t: f64) -> [f64; 3] {
    let at = [250.0, -700.0 + 7.0 * t, 163.0];
    let distance = at.iter().map(|x| x * x).sum::<f64>().sqrt();
    at.map(|x| x / distance)
}

#[test]
fn directions_of_mirrored_sign_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (station, track) = compact(dir.path());
    let bearings = dir.path().join("bearings.csv").to_str().unwrap().to_owned();
    let delays = dir.path().join("delays.csv").to_str().unwrap().to_owned();
    const PLACES: [[f64; 3]; 4] =
        [[0.0, 0.0, 0.0], [0.52, -0.12, -0.81], [-0.46, -0.36, -0.8], [-0.14, 0.61, -0.77]];
    // What East, North and Up of the direction of a time are multiplied by.
    let write = |signs: &dyn Fn(i32) -> [f64; 3]| {
        let mut rows = String::from("t_s,azimuth_deg,elevation_deg\n");
        let mut differences = String::from("t_s,tdoa01_s,tdoa02_s,tdoa03_s,tdoa12_s,tdoa13_s,tdoa23_s\n");
        for k in 0..200 {
            let (to, signs) = (to_the_ship(f64::from(k)), signs(k));
            let u: [f64; 3] = std::array::from_fn(|x| signs[x] * to[x]);
            let azimuth = u[0].atan2(u[1]).to_degrees().rem_euclid(360.0);
            let _ = writeln!(rows, "{k},{azimuth},{}", u[2].asin().to_degrees());
            let _ = write!(differences, "{k}");
            for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
                let along: f64 = (0..3).map(|x| (PLACES[i][x] - PLACES[j][x]) * u[x]).sum();
                let _ = write!(differences, ",{}", along / SOUND_SPEED_M_S);
            }
            differences += "\n";
        }
        std::fs::write(&bearings, rows).unwrap();
        std::fs::write(&delays, differences).unwrap();
    };
    let orient = ["orient", "--station", &station, "--track", &track, &bearings, "--json"];
    let bearing = ["bearing", "--station", &station, &delays, "--json"];
    write(&|_| [1.0; 3]);
    let turned = number(&records(&orient)[0], "orientation_deg");
    assert!(turned.abs() < 0.5, "{turned}");
    assert_eq!(records(&bearing).len(), 200);
    write(&|_| [-1.0; 3]);
    let said = refusal(&orient);
    assert!(said.contains("lean") && said.contains("mirrored") && said.contains("bearings.csv"), "{said}");
    let said = refusal(&bearing);
    assert!(said.contains("below the horizon") && said.contains("delays.csv"), "{said}");
    // Azimuths that run the other way round, as with two channels exchanged.
    write(&|_| [-1.0, 1.0, 1.0]);
    let said = refusal(&orient);
    assert!(said.contains("other way round") && said.contains("channels exchanged"), "{said}");
    // A vessel that an array hears through a mirror dives on one side of that alone.
    write(&|k| if k < 60 { [-1.0; 3] } else { [1.0; 3] });
    let said = refusal(&bearing);
    assert!(said.contains("60 of ") && said.contains("below the horizon"), "{said}");
    // A few sets of the wrong sign are not accepted, and do not condemn the rest.
    write(&|k| if k % 5 == 0 { [-1.0; 3] } else { [1.0; 3] });
    let sets = records(&bearing);
    let accepted = |set: &Value| set["accepted"] == true;
    assert!(sets.iter().step_by(5).all(|s| !accepted(s)), "{sets:?}");
    assert!(sets.iter().filter(|s| accepted(s)).count() > 150, "{sets:?}");
}

#[test]
fn geometry_is_mended_as_far_as_a_pass_tells_it_and_written_as_a_station_file() {
    let dir = tempfile::tempdir().unwrap();
    let (station, track) = compact(dir.path());
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    const PLACES: [[f64; 3]; 4] =
        [[0.0, 0.0, 0.0], [0.53, -0.12, -0.81], [-0.46, -0.37, -0.8], [-0.14, 0.61, -0.76]];
    let mut rows = String::from("t_s,tdoa01_s,tdoa02_s,tdoa03_s,tdoa12_s,tdoa13_s,tdoa23_s\n");
    for k in 0..400 {
        let t_s = 0.5 * f64::from(k);
        let u = to_the_ship(t_s);
        let _ = write!(rows, "{t_s}");
        for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            let along: f64 = (0..3).map(|x| (PLACES[i][x] - PLACES[j][x]) * u[x]).sum();
            let _ = write!(
                rows,
                ",{}",
                along / SOUND_SPEED_M_S + 1e-6 * f64::from((k * (7 + i as i32 + 3 * j as i32)) % 11 - 5)
            );
        }
        rows += "\n";
    }
    std::fs::write(path("delays.csv"), rows).unwrap();
    let (delays, mended) = (path("delays.csv"), path("mended.toml"));
    let args = [
        "orient",
        "--geometry",
        "--station",
        &station,
        "--track",
        &track,
        &delays,
        "--json",
        "--write",
        &mended,
    ];
    let said = refusal(&args);
    assert!(said.contains("position_sd_m") && said.contains("array.toml"), "{said}");
    let text =
        std::fs::read_to_string(&station).unwrap().replace("[array]\n", "[array]\nposition_sd_m = 0.01\n");
    std::fs::write(&station, text).unwrap();
    let out = seabearing(&args);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(said.contains("does not tell the geometry to 2 mm") && said.lines().count() == 1, "{said}");
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!(
        number(&found, "orientation_deg").abs() < 2.0 && (number(&found, "untold") - 3.0).abs() < 0.2,
        "{found}"
    );
    // What was written is a station file, with the places found.
    let again = std::fs::read_to_string(&mended).unwrap();
    assert!(again.contains("position_sd_m = 0.0") && !again.contains("position_sd_m = 0.01\n"), "{again}");
    assert!(seabearing(&["config", "check", &mended]).status.success(), "{again}");
    for wrong in ["--track-sd-m=-1", "--clock-sd-s=nan"] {
        refusal(&[&args[..], &[wrong]].concat());
    }
}

#[test]
fn bearings_off_the_track_are_counted_and_said() {
    let dir = tempfile::tempdir().unwrap();
    let (station, track) = compact(dir.path());
    let bearings = dir.path().join("bearings.csv").to_str().unwrap().to_owned();
    let mut rows = String::from("t_s,azimuth_deg,elevation_deg\n");
    for k in 0..300 {
        let u = to_the_ship(f64::from(k));
        let azimuth = u[0].atan2(u[1]).to_degrees().rem_euclid(360.0);
        let _ = writeln!(rows, "{k},{azimuth},{}", u[2].asin().to_degrees());
    }
    std::fs::write(&bearings, rows).unwrap();
    let out = seabearing(&["orient", "--station", &station, "--track", &track, &bearings, "--json"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(said.contains("99 of 300") && said.lines().count() == 1, "{said}");
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((number(&found, "n"), number(&found, "off_track")), (201.0, 99.0), "{found}");
}
