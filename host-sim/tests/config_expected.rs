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
         [tracking]\nspeed_m_s = 7.0\nspeed_sd_m_s = 0.0\nbearing_sd_deg = 2.0\nbearing_tau_s = 50.0\n",
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
    // The methods page's own bounds: σ 2°, τ 50 s, 200 s, the speed known.
    for (k, range_m, sd_m, sd_deg) in
        [(1, 500.0, 18.1, 2.23), (2, 1000.0, 43.6, 5.26), (3, 2000.0, 139.0, 17.1)]
    {
        assert_eq!(number(&rows[k], "cpa_range_m"), range_m);
        assert!((number(&rows[k], "sd_cpa_range_m") / sd_m - 1.0).abs() < 0.03, "{}", rows[k]);
        assert!((number(&rows[k], "sd_heading_deg") / sd_deg - 1.0).abs() < 0.03, "{}", rows[k]);
    }
    // By hand: across r σ, along D²σ/h with h = 163 m.
    let (sigma, slant2) = (2f64.to_radians(), 500f64.powi(2) + 163f64.powi(2));
    let by_hand = (500.0 * sigma).hypot(slant2 * sigma / 163.0);
    assert!((number(&rows[1], "one_bearing_sd_position_m") / by_hand - 1.0).abs() < 0.01, "{}", rows[1]);
    let svg = std::fs::read_to_string(dir.path().join("plots/accuracy.svg")).unwrap();
    assert!(svg.len() < 500_000, "{}", svg.len());
    assert!(svg.contains("Heading, 200 s") && svg.contains("Position by one bearing"), "{}", svg.len());
}
