//! `seabearing config check`: what accuracy to expect before a deployment, of an array and of a list of stations.

use serde_json::Value;
use std::process::Command;

fn records(args: &[&str]) -> Vec<Value> {
    let out = Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).output().expect("the command runs");
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

fn number(r: &Value, key: &str) -> f64 {
    r[key].as_f64().unwrap_or_else(|| panic!("{key} in {r}"))
}

#[test]
fn what_a_network_will_tell_is_printed_and_drawn_before_it_is_deployed() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    // The two arrays of paper N: 125.4 m at 1 km with the depth known, towards −5°.
    std::fs::write(
        path("two.toml"),
        "[[stations]]\nid = 1\nposition = { local_m = [4.5, -21.2, -168.0] }\norientation_sd_deg = 0.0\n\
         [[stations]]\nid = 2\nposition = { local_m = [-4.5, 21.2, -168.0] }\norientation_sd_deg = 0.0\n",
    )
    .unwrap();
    let ask = |more: &[&str]| {
        let (file, plots) = (path("two.toml"), path("plots"));
        let args = [
            "config",
            "check",
            &file,
            "--json",
            "--max-range-m",
            "1000",
            "--every-s",
            "50",
            "--plots",
            &plots,
        ];
        records(&[&args, more].concat())[0].clone()
    };
    let record = ask(&[]);
    assert_eq!((&record["type"], record["stations"].as_array().unwrap().len()), (&Value::from("network"), 2));
    let rows = record["expected_accuracy"].as_array().unwrap();
    let last = rows.last().unwrap();
    assert!((number(last, "sd_position_m") - 125.4).abs() < 3.0, "{last}");
    // 43 m of parallax tell no depth, and hardly a range without elevations, a kilometre away.
    assert!(last["sd_depth_unknown_m"].is_null() && last["sd_azimuths_alone_m"].is_null(), "{last}");
    assert!((number(last, "sd_azimuth_deg") - 1.5 / 2f64.sqrt()).abs() < 0.05, "{last}");
    let polar = number(last, "sd_range_m").hypot(1000.0 * number(last, "sd_azimuth_deg").to_radians());
    assert!((polar / number(last, "sd_position_m") - 1.0).abs() < 0.03, "{last}");
    assert!(number(last, "sd_heading_deg") > number(&rows[0], "sd_heading_deg"));
    let svg = std::fs::read_to_string(path("plots/accuracy.svg")).unwrap();
    assert!(svg.len() < 500_000, "{}", svg.len());
    for words in [
        "azimuths alone",
        "depth unknown",
        "Range from the centre",
        "Heading",
        "standard deviation (m)",
        "East (m)",
    ] {
        assert!(svg.contains(words), "{words}");
    }
    // What is known worse is told worse.
    let worse = ask(&["--sigma-elevation-deg", "3.2"]);
    let last_worse = worse["expected_accuracy"].as_array().unwrap().last().unwrap().clone();
    assert!(
        last_worse["sd_position_m"].is_null() || number(&last_worse, "sd_position_m") > 200.0,
        "{last_worse}"
    );
}

#[test]
fn what_an_array_will_tell_of_passages_is_printed_and_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let station = dir.path().join("array.toml").to_str().unwrap().to_owned();
    let plots = dir.path().join("plots").to_str().unwrap().to_owned();
    std::fs::write(
        &station,
        "[station]\nid = 1\nkind = \"array\"\nposition = { local_m = [0.0, 0.0, -168.0] }\n[sampling]\nrate_hz = 64000\n\
         [array]\nhydrophones_m = [[0.0, 0.0, 0.0], [0.52, -0.12, -0.81], [-0.46, -0.36, -0.8], [-0.14, 0.61, -0.77]]\n\
         [tracking]\nspeed_m_s = 7.0\nspeed_sd_m_s = 0.0\nbearing_sd_deg = 2.0\nbearing_tau_s = 0.0\n",
    )
    .unwrap();
    let record = &records(&[
        "config",
        "check",
        &station,
        "--json",
        "--minutes",
        "3.333333",
        "--speed",
        "7",
        "--plots",
        &plots,
    ])[0];
    let rows = record["expected_passages"].as_array().unwrap();
    // The methods page's own bounds: σ 2°, independent, 200 s, the speed known.
    for (k, range_m, sd_m, sd_deg) in [(1, 500.0, 2.1, 0.33), (3, 2000.0, 18.5, 2.89)] {
        assert_eq!(number(&rows[k], "cpa_range_m"), range_m);
        assert!((number(&rows[k], "sd_cpa_range_m") / sd_m - 1.0).abs() < 0.03, "{}", rows[k]);
        assert!((number(&rows[k], "sd_heading_deg") / sd_deg - 1.0).abs() < 0.03, "{}", rows[k]);
    }
    // By hand: across r σ, along D²σ/h with h = 166 m above to the surface's half way and 164 m to the vessel, of 1° scatter and 1°
    // that lasts; and 2 m of the height.
    let sigma = 2f64.sqrt() * 1f64.to_radians();
    let along = (500f64.powi(2) + 164f64.powi(2)) * sigma / 164.0;
    let by_hand = (500.0 * 2f64.to_radians()).hypot(along).hypot(500.0 * 2.0 / 166.0);
    assert!((number(&rows[1], "one_bearing_sd_position_m") / by_hand - 1.0).abs() < 0.01, "{}", rows[1]);
    let svg = std::fs::read_to_string(dir.path().join("plots/accuracy.svg")).unwrap();
    assert!(svg.len() < 500_000, "{}", svg.len());
    assert!(svg.contains("Heading, 200 s") && svg.contains("Position by one bearing"), "{}", svg.len());
}

#[test]
fn what_the_recorder_counts_is_in_what_is_expected_of_an_array() {
    let dir = tempfile::tempdir().unwrap();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios/tetrahedron.toml");
    let text = std::fs::read_to_string(file).unwrap();
    let check = |more: &str| {
        let file = dir.path().join("s.toml");
        assert!(text.contains("[array]\n"));
        std::fs::write(&file, text.replace("[array]\n", &format!("[array]\n{more}"))).unwrap();
        records(&["config", "check", file.to_str().unwrap(), "--json", "--minutes", "3.3"])[0].clone()
    };
    let (known, moved, slow) =
        (check(""), check("position_sd_m = 0.01\n"), check("sound_speed_sd_m_s = 10.0\n"));
    let pass = |r: &Value, key: &str| number(&r["expected_passages"][1], key);
    // A recorder states some 13 m of a pass of 200 s at 500 m: what elevations share and the doubt about the height are most of it.
    let at_500_m = pass(&known, "elevations_sd_cpa_range_m");
    assert!((9.0..18.0).contains(&at_500_m), "{at_500_m}");
    assert_eq!(number(&known["passages_assume"][0], "height_m"), 166.0);
    let bias_deg = number(&known["passages_assume"][0], "elevation_bias_sd_deg");
    assert!((bias_deg - 1.0).abs() < 1e-3, "{bias_deg}");
    // A centimetre is 0.44° of every bearing, and of the heading.
    let bearing = |r: &Value, key: &str| number(&r["expected_accuracy"][1], key);
    assert!(bearing(&known, "azimuth_sd_deg") < 0.1);
    assert!((bearing(&moved, "azimuth_sd_deg") - 0.46).abs() < 0.05, "{}", bearing(&moved, "azimuth_sd_deg"));
    assert_eq!(bearing(&known, "azimuth_limit_deg"), bearing(&moved, "azimuth_limit_deg"));
    assert!(pass(&moved, "elevations_sd_heading_deg") > pass(&known, "elevations_sd_heading_deg").hypot(0.4));
    assert!(bearing(&slow, "elevation_sd_deg") > bearing(&known, "elevation_sd_deg"));
}

#[test]
fn what_a_line_will_tell_is_printed_and_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let text = "[station]\nname = \"line\"\nkind = \"line\"\n[sampling]\nrate_hz = 2048.0\n[line]\nsensors = 23\nspacing_m = 0.75\n";
    std::fs::write(path("bare.toml"), text).unwrap();
    std::fs::write(path("line.toml"), format!("{text}frequencies_hz = [444.0, 666.0, 702.0]\n")).unwrap();
    let record =
        records(&["config", "check", &path("line.toml"), "--json", "--plots", &path("plots")])[0].clone();
    // 16 transforms a second, times the independent steps of weights that fall by a quarter a step on either side.
    assert!((number(&record, "snapshots") - 16.0 * 25.0 / 9.0 * 15.0 / 17.0).abs() < 1e-6);
    let rows = record["expected_accuracy"].as_array().unwrap();
    // Worse with the noise, and towards the axis; the sine is as good everywhere.
    let row = |snr_db: f64, from_deg: f64| {
        rows.iter().find(|r| r["snr_db"] == snr_db && r["from_broadside_deg"] == from_deg).unwrap()
    };
    let (clear, noisy) = (row(10.0, 0.0), row(-10.0, 0.0));
    assert!(number(noisy, "sd_azimuth_deg") > 8.0 * number(clear, "sd_azimuth_deg"), "{clear} {noisy}");
    assert!((number(row(10.0, 60.0), "sd_azimuth_deg") / number(clear, "sd_azimuth_deg") - 2.0).abs() < 1e-6);
    assert_eq!(number(row(10.0, 60.0), "sd_sin_bearing"), number(clear, "sd_sin_bearing"));
    let passes = record["expected_orientation"].as_array().unwrap();
    assert!(
        number(&passes[0], "sd_orientation_deg") < number(&passes[1], "sd_orientation_deg"),
        "{passes:?}"
    );
    let svg = std::fs::read_to_string(path("plots/accuracy.svg")).unwrap();
    assert!(svg.contains("angle from broadside") && svg.contains("Orientation of the line, 300 s"));
    // Without frequencies nothing is expected, and nothing drawn.
    assert!(records(&["config", "check", &path("bare.toml"), "--json"])[0]["expected_accuracy"].is_null());
    let bare = Command::new(env!("CARGO_BIN_EXE_seabearing"))
        .args(["config", "check", &path("bare.toml"), "--plots", &path("none")])
        .output()
        .unwrap();
    assert!(!bare.status.success() && String::from_utf8_lossy(&bare.stderr).contains("frequencies_hz"));
}
