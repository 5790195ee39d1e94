//! The simulated sea against calculations made another way: delays, levels, files, faults.

use seabearing::recording;
use seabearing::station::Station;
use seabearing::world::{self, ArrayScenario, SimulatedArray};
use seabearing_core::angle::wrap_pi;
use seabearing_core::array::{Plan, Scratch, State, finish, push};
use seabearing_core::block::{Block, Frame, MISSING};
use seabearing_core::wire::Message;
use std::path::{Path, PathBuf};

const STATION: &str = r#"
[station]
id = 4
name = "test array"
kind = "array"
position = { lat_deg = 49.0, lon_deg = -123.0, depth_m = 60.0 }
[sampling]
rate_hz = 16000
[array]
hydrophones_m = [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]]
channels = [2, 0, 1, 3]
sensitivity_db_re_1v_upa = [-165.0, -165.0, -165.0, -165.0]
"#;
const RATE: f64 = 16_000.0;
const CHANNELS: [usize; 4] = [2, 0, 1, 3];
/// Codes per µPa with no gain and 1 V full scale.
const CODES: f64 = 5.623_413_251_903_491e-9 * 8_388_608.0;

/// A scenario from its text, beside its station file.
fn scenario(folder: &Path, text: &str) -> ArrayScenario {
    std::fs::write(folder.join("station.toml"), STATION).unwrap();
    let path = folder.join("scenario.toml");
    std::fs::write(&path, format!("kind = \"array\"\nstation = \"station.toml\"\n{text}")).unwrap();
    ArrayScenario::read(&path).unwrap()
}

fn frames(text: &str) -> Vec<Frame> {
    let dir = tempfile::tempdir().unwrap();
    SimulatedArray::new(&scenario(dir.path(), text)).unwrap().collect()
}

/// Emission time for a source on a straight line, by the quadratic equation of the retarded time.
fn emission(t: f64, p0: [f64; 3], v: [f64; 3], h: [f64; 3], c: f64) -> (f64, f64) {
    let d: [f64; 3] = std::array::from_fn(|k| p0[k] + v[k] * t - h[k]);
    // |d − v s|² = c² s² for the travel time s = t − t_e.
    let dot = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let (a, b, g) = (c * c - dot(&v, &v), dot(&d, &v), dot(&d, &d));
    let s = (-b + (b * b + a * g).sqrt()) / a;
    (t - s, c * s)
}

#[test]
fn a_moving_tone_arrives_with_exact_delays_on_both_paths() {
    let got = frames(
        r#"
        duration_s = 6.0
        recorder = { full_scale_v = 1.0, gain_db = 10.0, clock_drift_ppm = 40.0 }
        ambient = { level_db_1khz = -100.0 }
        [[vessels]]
        name = "tone"
        straight = { cpa_time_s = 3.0, cpa_range_m = 100.0, heading_deg = 70.0, speed_m_s = 15.0, side = "port" }
        depth_m = 3.0
        source_level_db = -100.0
        tones = [{ frequency_hz = 5900.0, level_db = 180.0 }]
        "#,
    );
    assert_eq!(got.len(), 96_000);
    let c = 1484.0;
    let (east, north) = 70f64.to_radians().sin_cos();
    // With the array to port the vessel passes 90° to the right of its heading: heading + 90° from the array.
    let cpa = [100.0 * north, -100.0 * east];
    let velocity = [15.0 * east, 15.0 * north, 0.0];
    let at0 = |z: f64| [cpa[0] - 3.0 * velocity[0], cpa[1] - 3.0 * velocity[1], z];
    let station = Station::parse(STATION, "s", Path::new(".")).unwrap();
    let positions = station.config.geometry().unwrap().position_m;
    // The tone's phase is the simulator's own: fit it, once for all hydrophones.
    let mut model = Vec::new();
    for (n, frame) in got.iter().enumerate() {
        let t = n as f64 / (RATE * (1.0 + 40e-6));
        for (h, channel) in positions.iter().zip(CHANNELS) {
            let h = h.map(f64::from);
            let (mut i, mut q) = (0.0, 0.0);
            for (z, sign) in [(57.0, 1.0), (63.0, -1.0)] {
                let (te, distance) = emission(t, at0(z), velocity, h, c);
                let (s, o) = (std::f64::consts::TAU * 5900.0 * te).sin_cos();
                (i, q) = (i + sign * o / distance, q + sign * s / distance);
            }
            model.push((f64::from(frame[channel]), i, q));
        }
    }
    let sum = |f: &dyn Fn(&(f64, f64, f64)) -> f64| model.iter().map(f).sum::<f64>();
    let (ii, qq, iq) = (sum(&|m| m.1 * m.1), sum(&|m| m.2 * m.2), sum(&|m| m.1 * m.2));
    let (yi, yq) = (sum(&|m| m.0 * m.1), sum(&|m| m.0 * m.2));
    let det = ii * qq - iq * iq;
    let (a, b) = ((yi * qq - yq * iq) / det, (yq * ii - yi * iq) / det);
    let (error, power) = (sum(&|m| (m.0 - a * m.1 - b * m.2).powi(2)), sum(&|m| m.0 * m.0));
    let db = 10.0 * (error / power).log10();
    // At 5.9 kHz, -95 dB is a delay wrong by half a nanosecond.
    assert!(db < -95.0, "{db:.1} dB");
    let amplitude = a.hypot(b) / (CODES * 10f64.powf(0.5) * 10f64.powf(180.0 / 20.0) * 2f64.sqrt());
    assert!((amplitude - 1.0).abs() < 1e-4, "{amplitude}");
}

fn power_db(frames: &[Frame], channel: usize) -> f64 {
    let sum: f64 = frames.iter().map(|f| (f64::from(f[channel]) / CODES).powi(2)).sum();
    10.0 * (sum / frames.len() as f64).log10()
}

#[test]
fn levels_are_physical() {
    let quiet = "duration_s = 20.0\nrecorder = { full_scale_v = 1.0 }\nwater = { surface_reflection = 0.0 }";
    let still = "straight = { cpa_time_s = 0.0, cpa_range_m = 80.0, heading_deg = 0.0, speed_m_s = 0.0, side = \"port\" }";
    let alone = frames(&format!(
        "{quiet}\nambient = {{ level_db_1khz = -100.0 }}\n[[vessels]]\nname = \"a\"\n{still}\nsource_level_db = 170.0\ndepth_m = 0.0"
    ));
    // 80 m across and 60 m up: 100 m, 40 dB.
    for channel in 0..4 {
        let db = power_db(&alone, channel);
        assert!((db - 130.0).abs() < 0.3, "channel {channel}: {db} dB");
    }
    // Flat ambient noise of 80 dB re 1 µPa²/Hz over 8 kHz: 119.03 dB.
    let ambient = "ambient = { level_db_1khz = 80.0, slope_db_per_decade = 0.0 }";
    let noise = frames(&format!("{quiet}\n{ambient}"));
    let db = power_db(&noise, 1);
    assert!((db - 119.03).abs() < 0.1, "{db} dB");
    // A stated signal-to-noise ratio: the noise follows from the vessel, both in the whole band here.
    let stated = "ambient = { snr_at_cpa_db = 7.0, slope_db_per_decade = -20.0, knee_hz = 100.0 }";
    let both = frames(&format!(
        "{quiet}\n{stated}\n[[vessels]]\nname = \"a\"\n{still}\nsource_level_db = 170.0\ndepth_m = 0.0"
    ));
    // Signal of 130 dB (all but what lies below 50 Hz) and noise 7 dB below it: 0.8 dB more than the signal alone.
    let db = power_db(&both, 0) - power_db(&alone, 0);
    let want = 10.0 * (1.0 + 10f64.powf(-0.7)).log10();
    assert!((db - want).abs() < 0.15, "{db} dB, {want} dB");
}

const GAPPY: &str = r#"
    duration_s = 3.0
    seed = 9
    start_utc = "2024-05-01T09:00:00.25Z"
    recorder = { file_s = 1.0, full_scale_v = 1.0 }
    gaps = [{ start_s = 1.5, duration_s = 0.3 }]
"#;

#[test]
fn files_read_back_are_the_frames_at_their_places() {
    let dir = tempfile::tempdir().unwrap();
    let scenario = scenario(dir.path(), GAPPY);
    let all: Vec<Frame> = SimulatedArray::new(&scenario).unwrap().collect();
    let written = world::write(&scenario, &dir.path().join("out")).unwrap();
    assert_eq!(written.recordings.len(), 4);
    let station = Station::read(&written.station).unwrap();
    // In any order: their names say when they began.
    let shuffled: Vec<PathBuf> = [2, 0, 3, 1].iter().map(|i| written.recordings[*i].clone()).collect();
    let mut source = recording::open(&shuffled, &station, None).unwrap();
    assert_eq!(source.start(), Some(scenario.start));
    assert_eq!(source.expected_end(), Some(48_000));
    let mut seen = 0;
    let mut next = 0;
    let mut jumps = Vec::new();
    while let Some(block) = source.next_block().unwrap() {
        if block.first_index != next {
            jumps.push((next, block.first_index));
        }
        let from = block.first_index as usize;
        assert_eq!(block.frames, &all[from..from + block.frames.len()]);
        seen += block.frames.len();
        next = block.first_index + block.frames.len() as u64;
    }
    assert_eq!((jumps, seen, next), (vec![(24_000, 28_800)], 43_200, 48_000));
}

#[test]
fn the_same_seed_gives_the_same_sea_and_another_another() {
    let sea = |seed: u32| {
        frames(&format!(
            "duration_s = 1.2\nseed = {seed}\nambient = {{ diffuse_share = 0.5 }}\n[[vessels]]\nname = \"a\"\nsource_level_db = 170.0\n\
             straight = {{ cpa_time_s = 0.0, cpa_range_m = 80.0, heading_deg = 0.0, speed_m_s = 5.0, side = \"port\" }}"
        ))
    };
    assert_eq!(sea(1), sea(1));
    assert_ne!(sea(1), sea(2));
}

#[test]
fn faults_do_what_they_say_and_nothing_else() {
    let clean = frames("duration_s = 0.5\nrecorder = { encoding = \"float\", gain_db = 30.0 }");
    let with = |fault: &str| {
        frames(&format!(
            "duration_s = 0.5\nrecorder = {{ encoding = \"float\", gain_db = 30.0 }}\n[[faults]]\n{fault}\nfrom_s = 0.25"
        ))
    };
    let n = 4000;
    let dead = with("kind = \"dead\"\nchannel = 2");
    assert_eq!(dead[..n], clean[..n]);
    assert!(dead[n..].iter().zip(&clean[n..]).all(|(d, c)| d[2] == 0 && d[0] == c[0] && d[3] == c[3]));
    let stuck = with("kind = \"stuck\"\nchannel = 1");
    assert!(stuck[n..].iter().all(|f| f[1] == clean[n - 1][1]));
    let nan = with("kind = \"nan\"\nchannel = 0\nto_s = 0.3");
    assert!(nan[n..4800].iter().all(|f| f[0] == MISSING) && nan[4800..] == clean[4800..]);
    let swap = with("kind = \"swap\"\nchannels = [0, 3]");
    assert!(swap[n..].iter().zip(&clean[n..]).all(|(s, c)| s == &[c[3], c[1], c[2], c[0]]));
    let loud = with("kind = \"loud\"\nchannel = 3\ngain_db = 120.0");
    let clipped = loud[n..].iter().filter(|f| f[3] == 8_388_607 || f[3] == -8_388_608).count();
    assert!(clipped > 3500, "{clipped}");
}

#[test]
fn a_coarser_converter_has_coarser_codes() {
    let coarse = frames("duration_s = 0.1\nrecorder = { bits = 16, gain_db = 60.0 }");
    assert!(coarse.iter().flatten().all(|x| x % 256 == 0 || *x == 8_388_607));
    assert!(coarse.iter().flatten().any(|x| *x != 0));
}

#[test]
fn truth_has_a_row_a_step_and_vessel_with_the_stated_pass() {
    let dir = tempfile::tempdir().unwrap();
    let scenario = scenario(
        dir.path(),
        "duration_s = 20.0\n[[vessels]]\nname = \"a\"\nsource_level_db = 170.0\n\
         straight = { cpa_time_s = 10.0, cpa_range_m = 300.0, heading_deg = 0.0, speed_m_s = 8.0, side = \"starboard\" }",
    );
    let text = world::truth::csv(&scenario).unwrap();
    let table = seabearing::csv::CsvTable::parse(&text, "truth.csv").unwrap();
    assert_eq!(table.len(), 41);
    let rows: Vec<[f64; 7]> = table
        .numbers(["t_s", "x_m", "y_m", "azimuth_deg", "arrival_azimuth_deg", "emission_t_s", "cpa_range_m"])
        .unwrap()
        .into_iter()
        .map(|(_, r)| r.unwrap())
        .collect();
    // Heading North with the array to starboard: the vessel passes West.
    let [t, x, y, azimuth, arrival, emission, cpa] = rows[20];
    assert_eq!((t, x, y, azimuth, cpa), (10.0, -300.0, 0.0, 270.0, 300.0));
    // Sound of 0.205 s ago, from 1.64 m further South: 0.31° behind.
    let travel = (300f64.powi(2) + 56f64.powi(2)).sqrt() / 1484.0;
    assert!(
        (t - emission - travel).abs() < 1e-4
            && (azimuth - arrival - (8.0 * travel / 300.0).to_degrees()).abs() < 1e-3
    );
}

#[test]
fn a_bearing_is_of_the_moment_its_vessel_was_loud() {
    // A beat slower and faster than the segments, of a vessel that turns by 1.1° a second at its closest.
    for beat_hz in [0.9, 2.1] {
        let got = frames(&format!(
            r#"
            duration_s = 40.0
            ambient = {{ level_db_1khz = 65.0 }}
            [[vessels]]
            name = "near"
            straight = {{ cpa_time_s = 20.0, cpa_range_m = 400.0, heading_deg = 70.0, speed_m_s = 8.0, side = "port" }}
            depth_m = 3.0
            source_level_db = 165.0
            modulation = {{ shaft_rate_hz = {beat_hz}, blades = 4, shaft_depth = 0.5, blade_depth = 0.1, harmonics = 1 }}
            "#,
        ));
        let station = Station::parse(STATION, "s", Path::new(".")).unwrap();
        let plan = Plan::new(&station.config).unwrap();
        let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
        let (east, north) = 70f64.to_radians().sin_cos();
        let velocity = [8.0 * east, 8.0 * north, 0.0];
        let at0 = [400.0 * north - 20.0 * velocity[0], -400.0 * east - 20.0 * velocity[1], 57.0];
        let mut errors = Vec::new();
        let mut sink = |message: Message| {
            if let Message::Bearing(b) = message
                && b.band == 0
            {
                let (te, _) = emission(b.index as f64 / RATE, at0, velocity, [0.0; 3], 1484.0);
                let azimuth = (at0[0] + velocity[0] * te).atan2(at0[1] + velocity[1] * te);
                errors.push(wrap_pi(f64::from(b.azimuth) - azimuth) / f64::from(b.var_azimuth).sqrt());
            }
        };
        push(&plan, &mut state, &mut scratch, Block { first_index: 0, frames: &got }, &mut sink);
        finish(&plan, &mut state, &mut scratch, &mut sink);
        let within = errors.iter().filter(|z| z.abs() < 1.96).count();
        let rms = (errors.iter().map(|z| z * z).sum::<f64>() / errors.len() as f64).sqrt();
        // Taken as of the middle of their frames they are 9.7 and 3.6 deviations off.
        assert!(
            errors.len() > 75 && within * 10 >= errors.len() * 9 && rms < 1.2,
            "{beat_hz} Hz: {within} of {}, rms {rms:.2}",
            errors.len()
        );
    }
}
