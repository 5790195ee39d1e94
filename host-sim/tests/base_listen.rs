//! `seabearing base send … snippet` and `… spectrum` to a recorder's own code over a line of this computer.

mod recorder;

use recorder::{Line, Noise, Since, codes};
use seabearing::station::Station;
use seabearing_core::block::Block;
use seabearing_core::outlet::Reliable;
use seabearing_core::port::{Chunk, NoBoard, SampleSource};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{Application, BLOCK_FRAMES, run_over};
use seabearing_core::snippet::MOST_CODES;
use seabearing_core::wire::guard::{Guard, Recipient};
use seabearing_core::wire::link::{Link, MemoryStore, Settings};
use serde_json::Value;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output, Stdio};

const STATION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios/demo-station.toml");

/// Gives a recorder at 8 kHz a command, signed with a key of these digits twice; `memory`: whether it has some for snippets.
fn send(folder: &Path, key: &str, memory: bool, command: &[&str]) -> Output {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let line = format!("tcp:{}", listener.local_addr().unwrap());
    std::fs::write(folder.join("one.key"), key.repeat(32)).unwrap();
    let stations = format!("[[stations]]\nid = 1\nline = \"{line}\"\nkey_file = \"one.key\"\n");
    std::fs::write(folder.join("stations.toml"), stations).unwrap();
    let text = std::fs::read_to_string(STATION).unwrap().replace("rate_hz = 64000", "rate_hz = 8000");
    let calibration = "\n[calibration]\nfull_scale_v = 2.5\n";
    std::fs::write(folder.join("east.toml"), text + calibration).unwrap();
    let config = Station::read(&folder.join("east.toml")).unwrap().config;
    let recorder = move || {
        let store = MemoryStore::<20_000>::new();
        let mut link = Link::new(Settings::serial(921_600), config.id, 3, config.hash(), store);
        let mut recorder = Box::<Memory<'static>>::default();
        let mut recorder = recorder.configure(&config, None).unwrap();
        let mut samples = Noise::new(config.rate_hz, false);
        let mut frames = [[0; 4]; BLOCK_FRAMES];
        // Something is analysed before anybody asks.
        let mut heard = 0;
        while heard < 8000 {
            if let Chunk::Frames { first_index, count } = samples.read(&mut frames) {
                recorder.push(Block { first_index, frames: &frames[..count] }, &mut |_| ());
                heard += count;
            }
        }
        let mut line = Line::over(listener.accept().unwrap().0);
        let guard = Guard::keyed([7; 32], Recipient { station: config.id, boot: 3 });
        let mut codes = vec![0; if memory { MOST_CODES } else { 0 }];
        let mut outlet = Reliable::new(&mut line, &mut link, guard).with_snippets(&mut codes);
        run_over(&mut recorder, &mut samples, &mut outlet, &mut Since::now(), &mut NoBoard, &mut frames);
    };
    // It ends with the test.
    std::thread::Builder::new().stack_size(16 << 20).spawn(recorder).unwrap();
    let mut send = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    send.args(["base", "send", "--stations", "stations.toml", "--station", "1"]).args(command);
    send.current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

fn records(out: &Output) -> Vec<Value> {
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8_lossy(&out.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_snippet_is_the_samples_that_the_recorder_had_in_a_file_and_in_records() {
    let dir = tempfile::tempdir().unwrap();
    let order = ["snippet", "--channels", "1,3", "--seconds", "0.25", "--out", "sea.wav"];
    let all = records(&send(dir.path(), "07", true, &order));
    let head = all.iter().find(|r| r["type"] == "snippet").unwrap();
    assert_eq!((&head["instants"], head["channels"].to_string()), (&2000.into(), "[1,3]".to_owned()));
    assert!(all.iter().all(|r| r["type"] != "samples"));
    let first = head["index"].as_u64().unwrap();
    let wanted: Vec<i32> = (first..first + 2000).flat_map(|n| [codes(n)[1], codes(n)[3]]).collect();
    let wav = std::fs::read(dir.path().join("sea.wav")).unwrap();
    let bytes = wav[wav.len() - 3 * wanted.len()..].chunks_exact(3);
    let found: Vec<i32> = bytes.map(|c| i32::from_le_bytes([0, c[0], c[1], c[2]]) >> 8).collect();
    assert_eq!(found, wanted);

    let all = records(&send(dir.path(), "07", true, &["snippet"]));
    let head = all.iter().find(|r| r["type"] == "snippet").unwrap();
    let first = head["index"].as_u64().unwrap();
    let pieces = all.iter().filter(|r| r["type"] == "samples");
    let found: Vec<i64> =
        pieces.flat_map(|r| r["codes"].as_array().unwrap()).map(|code| code.as_i64().unwrap()).collect();
    let most = (MOST_CODES / 4) as u64;
    assert!(found.into_iter().eq((first..first + most).flat_map(codes).map(i64::from)));
}

#[test]
fn a_spectrum_of_every_channel_comes_in_the_unit_of_the_calibration() {
    let dir = tempfile::tempdir().unwrap();
    let order = ["spectrum", "--calibration", "east.toml"];
    let all = records(&send(dir.path(), "07", true, &order));
    let spectra: Vec<&Value> = all.iter().filter(|r| r["type"] == "spectrum").collect();
    assert_eq!(spectra.len(), 4, "{all:?}");
    // Uniform over 2^18 of 2^24 codes, over 4 kHz; 2.5 V at full scale, -165 dB re 1 V/uPa.
    let full_scale = 10.0 * (4f64.powi(18) / 12.0 / 4f64.powi(23) / 4000.0).log10();
    let expected = full_scale + 20.0 * 2.5f64.log10() + 165.0;
    for spectrum in spectra {
        assert_eq!(spectrum["reference"], "1 µPa");
        let edges = spectrum["edges_hz"].as_array().unwrap();
        assert_eq!(edges.len(), spectrum["density_db"].as_array().unwrap().len() + 1);
        // From 1 to 3 kHz: many bins.
        let levels = spectrum["density_db"].as_array().unwrap().iter().zip(edges);
        for level in levels.filter(|(_, hz)| (1000.0..2500.0).contains(&hz.as_f64().unwrap())).map(|(l, _)| l)
        {
            assert!((level.as_f64().unwrap() - expected).abs() < 2.0, "{level} {expected} {spectrum}");
        }
    }
}

#[test]
fn a_recorder_refuses_what_it_cannot_take_and_what_is_not_signed() {
    let dir = tempfile::tempdir().unwrap();
    for (key, memory, order, words) in [
        ("07", true, &["snippet", "--samples", "4097"][..], "too many"),
        ("07", false, &["snippet"], "no memory for snippets"),
        ("08", true, &["--wait", "3", "snippet", "--out", "sea.wav"], "is this its key?"),
        ("08", true, &["--wait", "3", "spectrum"], "is this its key?"),
    ] {
        let out = send(dir.path(), key, memory, order);
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(
            !out.status.success() && said.contains(words) && said.lines().count() == 1,
            "{order:?} {said}"
        );
        let answered = String::from_utf8_lossy(&out.stdout).contains(r#""token""#);
        assert_eq!(answered, key == "07", "{order:?}");
        assert!(!dir.path().join("sea.wav").exists());
    }
}
