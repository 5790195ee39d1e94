//! Recordings at another rate than the recorder's, through the whole chain.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};

fn run(folder: &Path, line: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    let ran =
        command.args(line.split_whitespace()).current_dir(folder).stdin(Stdio::null()).output().unwrap();
    assert!(ran.status.success(), "{line}: {}", String::from_utf8_lossy(&ran.stderr));
    String::from_utf8(ran.stdout).unwrap()
}

/// Time, azimuth and elevation with their standard deviations, of bearings of the whole band.
fn bearings(records: &str) -> Vec<[f64; 5]> {
    let records = records.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
    records
        .filter(|r| r["type"] == "bearing" && r["band"] == 0)
        .map(|r| {
            ["t_s", "azimuth_deg", "sd_azimuth_deg", "elevation_deg", "sd_elevation_deg"]
                .map(|k| r[k].as_f64().unwrap())
        })
        .collect()
}

#[test]
fn a_recording_of_192_khz_gives_the_bearings_of_one_of_64_khz() {
    let dir = tempfile::tempdir().unwrap();
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    let read = |name: &str| std::fs::read_to_string(scenarios.join(name)).unwrap();
    let scenario = read("demo.toml").replace("duration_s = 200.0", "duration_s = 6.0");
    let mut stations = Vec::new();
    for rate in ["64000", "192000"] {
        let station = read("demo-station.toml").replace("rate_hz = 64000", &format!("rate_hz = {rate}"));
        std::fs::write(dir.path().join("demo-station.toml"), station).unwrap();
        std::fs::write(dir.path().join("demo.toml"), &scenario).unwrap();
        run(dir.path(), &format!("simulate demo.toml --out {rate}"));
        stations.push(format!("{rate}/station.toml"));
    }
    // The same sea, sampled otherwise: the recorder runs at 64 kHz on both.
    let [own, high] = ["64000", "192000"]
        .map(|f| bearings(&run(dir.path(), &format!("process --station 64000/station.toml {f}"))));
    assert!(own.len() >= 8 && high.len() >= 8, "{} {}", own.len(), high.len());
    let (mut compared, mut within) = (0, 0);
    for a in &own {
        let Some(b) = high.iter().find(|b| (b[0] - a[0]).abs() < 0.01) else { continue };
        for (value, sd) in [(1, 2), (3, 4)] {
            compared += 1;
            within += u32::from((a[value] - b[value]).abs() <= 1.96 * a[sd].hypot(b[sd]));
        }
    }
    // Noise is another realisation: 95 % of the differences within their own 95 %, less what so few may miss.
    assert!(compared >= 16 && within * 10 >= compared * 9, "{within} of {compared}");
}
