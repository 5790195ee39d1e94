//! Levels that a recorder sends of itself, from samples to the base station's records: a tone and white noise of known level.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

const RATE_HZ: f64 = 8000.0;
const SECONDS: usize = 90;
/// Of the noise, uniform, and of the tone, full scales.
const NOISE: f64 = 0.01;
const TONE: f64 = 0.1;
/// Bin of the transforms of 512 samples.
const BIN: f64 = 70.0;
/// 2.5 V at full scale, 20 dB of gain, −165 dB re 1 V/µPa: dB re 1 µPa of a root mean square of full scale.
const FULL_SCALE_DB: f64 = 7.958_800_173_440_752 - 20.0 + 165.0;

const STATION: &str = "[station]\nid = 7\nname = \"east\"\nkind = \"array\"\nposition = { lat_deg = 49.0, lon_deg = -123.0 }\n\
    [sampling]\nrate_hz = 8000\n[array]\n\
    hydrophones_m = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]]\n\
    sensitivity_db_re_1v_upa = [-165.0, -165.0, -165.0, -165.0]\n[calibration]\nfull_scale_v = 2.5\ngain_db = 20.0\n\
    [levels]\nevery_s = 30\nchannel = 2\n";

fn output(folder: &Path, args: &[&str]) -> String {
    let out = Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).current_dir(folder).output().unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn spectra(text: &str) -> Vec<Value> {
    let all = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    all.filter(|record| record["type"] == "spectrum").collect()
}

/// Four channels of 24 bits: noise, and on channel 2 the tone as well.
fn wav(tone: f64) -> Vec<u8> {
    let frames = RATE_HZ as usize * SECONDS;
    let (rate, bytes) = (RATE_HZ as u32, 12 * frames as u32);
    let mut out = b"RIFF".to_vec();
    out.extend((36 + bytes).to_le_bytes());
    out.extend(b"WAVEfmt \x10\0\0\0\x01\0\x04\0");
    out.extend(rate.to_le_bytes());
    out.extend((12 * rate).to_le_bytes());
    out.extend(b"\x0c\0\x18\0data");
    out.extend(bytes.to_le_bytes());
    let mut seed = 0x1234_5678_9abc_def1_u64;
    for n in 0..frames {
        for channel in 0..4 {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            let noise = NOISE * (2.0 * (seed >> 11) as f64 / (1u64 << 53) as f64 - 1.0);
            let turn = std::f64::consts::TAU * BIN / 512.0 * n as f64;
            let x = noise + if channel == 2 { tone * turn.sin() } else { 0.0 };
            out.extend(&((x * 8_388_608.0).round() as i32).to_le_bytes()[..3]);
        }
    }
    out
}

fn numbers(record: &Value, key: &str) -> Vec<Option<f64>> {
    record[key].as_array().unwrap().iter().map(Value::as_f64).collect()
}

#[test]
fn a_tone_and_noise_of_known_level_come_out_with_it_at_the_base_station() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    std::fs::write(at.join("east.toml"), STATION).unwrap();
    std::fs::write(at.join("stations.toml"), "[[stations]]\nid = 7\nstation_file = \"east.toml\"\n").unwrap();
    std::fs::write(at.join("bare.toml"), "[[stations]]\nid = 7\n").unwrap();
    let noise_db = 10.0 * (NOISE * NOISE / 3.0 / (RATE_HZ / 2.0)).log10() + FULL_SCALE_DB;
    let tone_db = 20.0 * (TONE / 2f64.sqrt()).log10() + FULL_SCALE_DB;
    for tone in [0.0, TONE] {
        std::fs::write(at.join("sea.wav"), wav(tone)).unwrap();
        let process = ["process", "--station", "east.toml", "sea.wav", "--telemetry", "telemetry.bin"];
        let processed = spectra(&output(at, &process));
        let told = spectra(&output(at, &["base", "telemetry.bin", "--station", "east.toml", "--json"]));
        assert_eq!((processed.len(), told.len()), (3, 3));
        for (record, processed) in told.iter().zip(&processed) {
            assert_eq!((&record["token"], &record["channel"]), (&0.into(), &2.into()));
            assert_eq!((&record["channels"], &record["reference"]), (&Value::Array(vec![]), &"1 µPa".into()));
            assert!(record["frames"].as_u64().unwrap() > 530, "{record}");
            for key in ["density_db", "band_db", "edges_hz"] {
                assert_eq!(record[key], processed[key]);
            }
            let (density, band, edges) =
                (numbers(record, "density_db"), numbers(record, "band_db"), numbers(record, "edges_hz"));
            let hz = |n: usize| edges[n].unwrap();
            let mut measured = 0;
            for (n, (density, band)) in density.iter().zip(&band).enumerate() {
                let (Some(density), Some(band)) = (density, band) else { continue };
                measured += 1;
                let width_db = 10.0 * (hz(n + 1) - hz(n)).log10();
                assert!((density + width_db - band).abs() < 0.02, "{density} {width_db} {band}");
                let middle = BIN * RATE_HZ / 512.0;
                if tone > 0.0 && hz(n) < middle && middle < hz(n + 1) {
                    assert!((band - tone_db).abs() < 0.1, "{band} {tone_db}");
                } else if tone == 0.0 && hz(n + 1) - hz(n) > 15.0 * RATE_HZ / 512.0 {
                    // Of 16 bins and 500 frames: 0.05 dB are one standard deviation.
                    assert!((density - noise_db).abs() < 0.2, "{density} {noise_db}");
                } else if tone == 0.0 {
                    assert!((density - noise_db).abs() < 1.0, "{density} {noise_db}");
                }
            }
            assert!(measured > 18, "{record}");
        }
        // Their percentiles, printed and drawn.
        std::fs::write(at.join("told.jsonl"), told.iter().map(|r| format!("{r}\n")).collect::<String>())
            .unwrap();
        let percentiles = output(at, &["levels", "told.jsonl", "--json", "--plot", "levels.svg"]);
        let whole: Value = percentiles
            .lines()
            .map(|l| serde_json::from_str(l).unwrap())
            .find(|r: &Value| r["n"] == 3)
            .unwrap();
        let width = |key: &str| whole[key].as_f64().unwrap();
        let expected = noise_db + 10.0 * (width("to_hz") - width("from_hz")).log10();
        let expected = if tone > 0.0 {
            10.0 * (10f64.powf(expected / 10.0) + 10f64.powf(tone_db / 10.0)).log10()
        } else {
            expected
        };
        for key in ["l5_db", "l50_db", "l95_db", "mean_db"] {
            assert!((whole[key].as_f64().unwrap() - expected).abs() < 0.2, "{whole} {expected}");
        }
        let printed = output(at, &["levels", "told.jsonl"]);
        assert!(printed.contains("L5     L50     L95") && printed.contains("the whole time"), "{printed}");
        assert!(std::fs::read_to_string(at.join("levels.svg")).unwrap().contains("L95 to L5"));
        // The same by a list of stations that name their files, out of a store, and without a sensitivity re full scale.
        let from_store = |stations: &str, folder: &str| {
            let start = "2024-05-01T09:00:00Z";
            output(
                at,
                &[
                    "base",
                    "telemetry.bin",
                    "--stations",
                    stations,
                    "--store",
                    folder,
                    "--start",
                    start,
                    "--json",
                ],
            );
            let out = format!("{folder}.jsonl");
            output(at, &["export", "--store", folder, "--stations", stations, "--out", &out]);
            spectra(&std::fs::read_to_string(at.join(out)).unwrap())
        };
        let stored = from_store("stations.toml", &format!("store-{tone}"));
        let bands = |all: &[Value]| all.iter().map(|r| r["band_db"].clone()).collect::<Vec<_>>();
        assert_eq!(bands(&stored), bands(&told));
        let bare = from_store("bare.toml", &format!("bare-{tone}"));
        assert!(bare.iter().all(|r| r["reference"] == "full scale"));
        for (bare, told) in bare.iter().zip(&told) {
            for (bare, told) in numbers(bare, "band_db").into_iter().zip(numbers(told, "band_db")) {
                let more = told.zip(bare).map_or(FULL_SCALE_DB, |(told, bare)| told - bare);
                assert!((more - FULL_SCALE_DB).abs() < 0.02, "{more}");
            }
        }
    }
}
