//! `seabearing track` and `seabearing ais speeds` as a person runs them.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn seabearing(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).output().unwrap()
}

/// 500 m to the north-west of a vessel on 45° at 7 m/s, without noise, travel time included.
fn write(path: &Path, keep: impl Fn(i32) -> bool, extra: &str) {
    let mut text = String::from("t_s,azimuth_deg\n");
    for k in (0..=400).filter(|k| keep(*k)) {
        let t = 0.5 * f64::from(k);
        let (s, c) = 45f64.to_radians().sin_cos();
        let mut te = t;
        let mut at = (0.0f64, 0.0f64);
        for _ in 0..20 {
            let along = 7.0 * (te - 100.0);
            at = (-500.0 * c + s * along, 500.0 * s + c * along);
            te = t - at.0.hypot(at.1) / 1484.0;
        }
        let _ = writeln!(text, "{t},{}", at.0.atan2(at.1).to_degrees().rem_euclid(360.0));
    }
    text.push_str(extra);
    std::fs::write(path, text).unwrap();
}

#[test]
fn track_gives_the_record_of_the_interface_with_every_estimator_and_model() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("b.csv");
    let name = file.to_str().unwrap();
    write(&file, |k| k % 13 != 5, "");
    for options in [
        &["--speed", "7"][..],
        &["--speed", "7", "--tau-s", "50", "--sigma-deg", "2"],
        &["--speed", "7", "--tau-s", "5", "--model", "sinc"],
        &["--speed", "7", "--tau-s", "5", "--model", "gaussian"],
        &["--speed", "7", "--tau-s", "5", "--model", "markov"],
        &["--speed", "7", "--tau-s", "5", "--estimator", "recursive"],
        &["--speed", "7", "--estimator", "recursive"],
    ] {
        let out = seabearing(&[&["track", name, "--json"], options].concat());
        assert!(out.status.success(), "{options:?}: {}", String::from_utf8_lossy(&out.stderr));
        let r: Value = serde_json::from_slice(&out.stdout).unwrap();
        let near = |key: &str, x: f64, off: f64| {
            let got = r[key].as_f64().unwrap_or_else(|| panic!("{key} in {r}"));
            assert!((got - x).abs() < off, "{options:?}: {key} {got}");
        };
        near("cpa_time_s", 100.0, 0.05);
        near("cpa_range_m", 500.0, 0.5);
        near("heading_deg", 45.0, 0.05);
        near("speed_m_s", 7.0, 1e-9);
        near("x0_m", -353.553 - 494.975, 1.0);
        near("y0_m", 353.553 - 494.975, 1.0);
        near("n", 370.0, 1.0);
        for key in ["sd_cpa_time_s", "sd_cpa_range_m", "sd_heading_deg"] {
            assert!(r[key].as_f64().unwrap() > 0.0);
        }
        assert_eq!(
            (&r["type"], &r["side"], &r["range_observable"]),
            (&"track".into(), &"starboard".into(), &true.into())
        );
    }
    // No speed given: the fleet's.
    let out = seabearing(&["track", name, "--json"]);
    let r: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!((r["cpa_range_m"].as_f64().unwrap() - 500.0 * 7.3 / 7.0).abs() < 3.0, "{r}");
    assert!((r["sd_cpa_range_m"].as_f64().unwrap() - 500.0 * 2.3 / 7.0).abs() < 10.0, "{r}");
}

/// Records of the same pass 160 m above the array, with errors of 0.004° of which half the variance lasts 10 s.
fn write_records(path: &Path) {
    const SD_DEG: f64 = 0.004;
    let mut state = 11u64;
    let mut normal = || {
        let draws = (0..12).map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        });
        draws.sum::<f64>() - 6.0
    };
    let kept = (-0.05f64).exp();
    let (mut text, mut lasting) = (String::new(), normal());
    for k in 0..=400 {
        let t = 0.5 * f64::from(k);
        let (s, c) = 45f64.to_radians().sin_cos();
        let (mut te, mut at) = (t, (0.0f64, 0.0f64));
        for _ in 0..20 {
            let along = 7.0 * (te - 100.0);
            at = (-500.0 * c + s * along, 500.0 * s + c * along);
            te = t - at.0.hypot(at.1).hypot(160.0) / 1484.0;
        }
        lasting = kept * lasting + (1.0 - kept * kept).sqrt() * normal();
        let azimuth = at.0.atan2(at.1).to_degrees() + SD_DEG * 0.5f64.sqrt() * (lasting + normal());
        let elevation = 160f64.atan2(at.0.hypot(at.1)).to_degrees() + 0.1 * normal();
        let (azimuth, sd) = (azimuth.rem_euclid(360.0), SD_DEG);
        let _ = writeln!(
            text,
            r#"{{"type":"bearing","t_s":{t},"azimuth_deg":{azimuth},"elevation_deg":{elevation},"sd_azimuth_deg":{sd},"sd_elevation_deg":0.1,"band":0}}"#
        );
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn of_records_what_lasts_of_the_errors_and_the_height_heard_are_told_from_themselves() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("records.jsonl");
    write_records(&file);
    let name = file.to_str().unwrap();
    let track = |options: &[&str]| {
        let out = seabearing(&[&["track", name, "--json", "--speed", "7"], options].concat());
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        (serde_json::from_slice::<Value>(&out.stdout).unwrap(), said)
    };
    for options in [&[][..], &["--estimator", "recursive"]] {
        let (r, said) = track(options);
        assert!(r["consistent"] == true && said.is_empty(), "{options:?}: {r} {said}");
        let number = |key: &str| r[key].as_f64().unwrap();
        assert!((0.2..=0.9).contains(&number("lasting_share")) && number("lasting_s") > 2.0, "{r}");
        for (key, truth) in [("cpa_time_s", 100.0), ("cpa_range_m", 500.0), ("heading_deg", 45.0)] {
            let sd = number(&format!("sd_{key}"));
            assert!((number(key) - truth).abs() < 3.0 * sd, "{options:?}: {key} {r}");
        }
        // The sound comes from above: 0.018 s later than from the array's depth.
        assert!(number("sd_cpa_time_s") < 0.008 && number("sd_heading_deg") < 0.006, "{r}");
    }
    // Who says how the errors last is believed.
    let (independent, said) = track(&["--tau-s", "0"]);
    assert!(
        independent.get("lasting_share").is_none() && independent["consistent"] == false,
        "{independent}"
    );
    assert!(said.contains("contradict"), "{said}");
}

#[test]
fn a_speed_that_the_elevations_contradict_is_said_to_be_contradicted() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("records.jsonl");
    write_records(&file);
    let said = |options: &[&str]| {
        let out = seabearing(&[&["track", file.to_str().unwrap(), "--height-m", "160"], options].concat());
        String::from_utf8_lossy(&out.stderr).into_owned()
    };
    for speed in ["4", "10"] {
        let said = said(&["--speed", speed]);
        assert!(
            said.contains(&format!("contradict a speed of {speed} m/s")) && said.contains("± "),
            "{said}"
        );
    }
    // Known with a deviation, and elevations that may all be off: the fit lies between the two speeds, and neither is contradicted by misfit.
    for (speed, sd) in [("9", "0.2"), ("8", "0.1")] {
        let options = ["--speed", speed, "--speed-sd", sd, "--elevation-bias-deg", "0.5", "--json"];
        let out =
            seabearing(&[&["track", file.to_str().unwrap(), "--height-m", "160"], &options[..]].concat());
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(said.contains(&format!("contradict a speed of {speed} m/s")), "{said}");
        assert!(String::from_utf8_lossy(&out.stdout).contains("\"consistent\":false"), "{speed}");
    }
    // As told, or not told.
    for options in [
        &["--speed", "7"][..],
        &["--speed", "4", "--speed-sd", "inf"],
        &["--speed", "7.2", "--speed-sd", "0.2", "--elevation-bias-deg", "0.5"],
        &[],
    ] {
        let said = said(options);
        assert!(!said.contains("contradict a speed"), "{options:?}: {said}");
    }
}

#[test]
fn bad_input_is_one_line_and_good_rows_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("b.csv");
    let name = file.to_str().unwrap();
    write(&file, |_| true, "200.5,nonsense\n201,\n");
    let out = seabearing(&["track", name, "--speed", "7", "--json"]);
    assert!(out.status.success());
    let complaint = String::from_utf8_lossy(&out.stderr).to_string();
    assert!(complaint.contains("line 403") && complaint.contains("line 404"), "{complaint}");
    let out = seabearing(&["track", name, "--speed-sd", "inf"]);
    let text = String::from_utf8_lossy(&out.stderr).to_string();
    assert!(!out.status.success() && text.contains("needs elevations"), "{text}");
    write(&file, |k| k < 3, "");
    for (args, word) in [
        (vec!["track", name], "at least 5"),
        (vec!["track", name, "--sigma-deg=-1"], "sigma-deg"),
        (vec!["track", "no-such-file.csv"], "no-such-file.csv"),
        (vec!["ais", "speeds", name, "--lat-deg", "50", "--lon-deg", "0"], "AIS layout"),
    ] {
        let out = seabearing(&args);
        let text = String::from_utf8_lossy(&out.stderr).to_string();
        assert!(
            !out.status.success() && text.contains(word) && text.trim_end().lines().count() == 1,
            "{args:?}: {text}"
        );
    }
}

#[test]
fn wrong_bearings_are_survived_with_robust_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("b.csv");
    let name = file.to_str().unwrap();
    // A second vessel's bearings: ten rows at other azimuths.
    let wrong: String = (0..10).map(|k| format!("{},{}\n", 3.25 + 20.0 * f64::from(k), 10 * k)).collect();
    write(&file, |_| true, &wrong);
    let run = |options: &[&str]| seabearing(&[&["track", name, "--speed", "7", "--json"], options].concat());
    for estimator in ["ml", "recursive"] {
        let out = run(&["--robust", "--estimator", estimator]);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let r: Value = serde_json::from_slice(&out.stdout).unwrap();
        let range = r["cpa_range_m"].as_f64().unwrap();
        assert!((range - 500.0).abs() < 1.0, "{estimator}: {range}");
        assert_eq!(r["wrong"], 10, "{estimator}: {r}");
    }
    let plain: Value = serde_json::from_slice(&run(&[]).stdout).unwrap();
    assert!((plain["cpa_range_m"].as_f64().unwrap() - 500.0).abs() > 5.0, "{plain}");
}

#[test]
fn a_source_behind_the_antenna_is_a_shift_and_no_scatter() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    write(Path::new(&at("b.csv")), |_| true, "");
    // The antenna is 7 s, 49 m, ahead of what is heard.
    let mut track = String::from("t_s,x_m,y_m\n");
    for t_s in (-40..=240).step_by(10) {
        let (s, c) = 45f64.to_radians().sin_cos();
        let along = 7.0 * (f64::from(t_s) + 7.0 - 100.0);
        let _ = writeln!(track, "{t_s},{},{}", -500.0 * c + s * along, 500.0 * s + c * along);
    }
    std::fs::write(at("gps.csv"), track).unwrap();
    let out =
        seabearing(&["track", &at("b.csv"), "--known-track", &at("gps.csv"), "--model", "white", "--json"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let r: Value = serde_json::from_slice(&out.stdout).unwrap();
    let of = |key: &str| r[key].as_f64().unwrap_or_else(|| panic!("{key} in {r}"));
    assert!((of("shift_s") - 7.0).abs() < 0.05 && of("sigma_deg") < 0.05, "{r}");
    assert!(of("offset_deg").abs() < 0.05 && of("sd_shift_s") > 0.0, "{r}");
}
