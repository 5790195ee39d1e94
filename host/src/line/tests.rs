//! A line's recording, made here, through the whole chain.

use super::*;
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::line::{self, LineSettings, orient};
use std::path::Path;

const RATE_HZ: u32 = 2048;
const SENSORS: u16 = 23;
const SPACING_M: f64 = 0.75;
const ORIENTATION_DEG: f64 = -35.1;
const FREQUENCIES_HZ: [f64; 3] = [444.0, 666.0, 702.0];

fn station(more: &str) -> Station {
    let text = format!(
        "[station]\nname = \"line\"\nkind = \"line\"\nsound_speed_m_s = 1484.0\norientation_deg = {ORIENTATION_DEG}\n\
         [sampling]\nrate_hz = {RATE_HZ}.0\n[line]\nsensors = {SENSORS}\nspacing_m = {SPACING_M}\n{more}"
    );
    Station::parse(&text, "line.toml", Path::new(".")).unwrap()
}

fn three() -> Station {
    station("frequencies_hz = [444.0, 666.0, 702.0]\n")
}

/// The vessel at a time: East and North, metres.
fn vessel(t_s: f64) -> [f64; 2] {
    let (s, c) = (125.0 * RAD_PER_DEG).sin_cos();
    [120.0 + 6.0 * s * t_s, 520.0 + 6.0 * c * t_s]
}

fn sine(t_s: f64) -> f64 {
    let [x, y] = vessel(t_s);
    (x.atan2(y) - ORIENTATION_DEG * RAD_PER_DEG).cos()
}

/// Random numbers about zero of variance one: twelve uniform ones.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (self.0 >> 11) as f64 / (1u64 << 53) as f64;
        }
        sum
    }
}

/// So many seconds of tones from `sines`, whose phases wander, in noise; one value a sensor and instant.
fn recording(seconds: u32, seed: u64, sines: &dyn Fn(f64) -> Vec<f64>, noise: f64) -> Vec<Vec<f64>> {
    tones(seconds, seed, sines, noise, FREQUENCIES_HZ)
}

/// The same, of tones at these frequencies.
fn tones(
    seconds: u32,
    seed: u64,
    sines: &dyn Fn(f64) -> Vec<f64>,
    noise: f64,
    tones_hz: [f64; 3],
) -> Vec<Vec<f64>> {
    let mut rng = Noise(seed);
    let rate_hz = f64::from(RATE_HZ);
    // A radian in a transform; of each source and tone from half a second before on.
    let before = RATE_HZ / 2;
    let n = (seconds + 1) * RATE_HZ;
    let mut wander = || {
        let mut phase = 0.0;
        let mut next = |_| {
            phase += (16.0 / rate_hz).sqrt() * rng.next();
            phase
        };
        (0..n).map(&mut next).collect::<Vec<f64>>()
    };
    let phases: Vec<[Vec<f64>; 3]> = sines(0.0).iter().map(|_| std::array::from_fn(|_| wander())).collect();
    (0..seconds * RATE_HZ)
        .map(|n| {
            let t_s = f64::from(n) / rate_hz;
            let mut out: Vec<f64> = (0..SENSORS).map(|_| noise * rng.next()).collect();
            for (phases, sine) in phases.iter().zip(sines(t_s)) {
                for (phase, f) in phases.iter().zip(tones_hz) {
                    for (m, x) in out.iter_mut().enumerate() {
                        // What wanders travels with the sound.
                        let then_s = t_s + SPACING_M * m as f64 * sine / 1484.0;
                        let at = then_s * rate_hz + f64::from(before);
                        let (k, part) = (at as usize, at.fract());
                        let phase = phase[k] + part * (phase[k + 1] - phase[k]);
                        *x += (std::f64::consts::TAU * f * then_s + phase).cos();
                    }
                }
            }
            out
        })
        .collect()
}

/// Writes channels of a recording, in the order asked for.
fn write(path: &Path, recording: &[Vec<f64>], channels: &[usize]) {
    let spec = hound::WavSpec {
        channels: channels.len() as u16,
        sample_rate: RATE_HZ,
        bits_per_sample: 24,
        sample_format: hound::SampleFormat::Int,
    };
    let mut out = hound::WavWriter::create(path, spec).unwrap();
    for instant in recording {
        for c in channels {
            out.write_sample((4e5 * instant[*c]) as i32).unwrap();
        }
    }
    out.finalize().unwrap();
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("seabearing-line-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn heard(station: &Station, files: &[PathBuf]) -> (Vec<LineBearing>, Summary) {
    let mut bearings = Vec::new();
    let line = Line::find(files, station, &Asked::default()).unwrap();
    let summary = line
        .run(|b| {
            bearings.push(b);
            Ok(())
        })
        .unwrap();
    (bearings, summary)
}

const IN_ORDER: [usize; SENSORS as usize] =
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22];

#[test]
fn bearings_of_a_recording_orient_the_line() {
    let folder = folder("orient");
    let file = folder.join("pass.wav");
    write(&file, &recording(60, 7, &|t| vec![sine(t)], 1.0), &IN_ORDER);
    let (bearings, summary) = heard(&three(), &[file]);
    let strongest: Vec<_> = bearings.iter().filter(|b| b.source == 0).collect();
    assert_eq!((strongest.len(), summary.steps, summary.lost), (60, 60, 0));
    let standardised: Vec<f64> = strongest.iter().map(|b| (b.sine - sine(b.t_s)) / b.sd).collect();
    let rms = (standardised.iter().map(|z| z * z).sum::<f64>() / 60.0).sqrt();
    assert!((0.7..1.5).contains(&rms), "{rms}: {standardised:?}");
    assert!(strongest.iter().filter(|b| b.frequencies == 3).count() > 50);
    let ghosts = bearings.len() - strongest.len();
    assert!(ghosts <= 2, "{ghosts} ghosts");

    let measured: Vec<_> = strongest.iter().map(|b| line::LineBearing { t_s: b.t_s, sine: b.sine }).collect();
    let track: Vec<_> = (-1..8)
        .map(|k| {
            let t_s = 10.0 * f64::from(k);
            let [x, y] = vessel(t_s);
            TrackPoint { t_s, position_m: [x, y, 0.0] }
        })
        .collect();
    let settings = LineSettings { shift_s: (-5.0, 5.0), eta: (0.9, 1.02), gap_s: 60.0, whole_s: 0.0 };
    let found = orient(&measured, &track, &settings).unwrap();
    let error = seabearing_core::angle::wrap_pi(found.orientation - ORIENTATION_DEG * RAD_PER_DEG);
    assert!(error.abs() < 3.0 * found.sd && found.sd < 1.5 * RAD_PER_DEG, "{error} {found:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn two_vessels_are_two_sources_and_noise_is_none() {
    let folder = folder("two");
    let file = folder.join("two.wav");
    write(&file, &recording(12, 3, &|_| vec![0.5, -0.3], 0.7), &IN_ORDER);
    let (bearings, _) = heard(&three(), std::slice::from_ref(&file));
    for (true_sine, least) in [(0.5, 11), (-0.3, 11)] {
        let near = bearings.iter().filter(|b| (b.sine - true_sine).abs() < 0.02).count();
        assert!(near >= least, "{near} at {true_sine}: {bearings:?}");
    }
    write(&file, &recording(40, 4, &|_| Vec::new(), 1.0), &IN_ORDER);
    let (bearings, summary) = heard(&three(), &[file]);
    assert!(summary.steps == 40 && bearings.len() <= 2, "{bearings:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn sensors_on_other_channels_and_in_several_files_give_the_same() {
    let folder = folder("channels");
    let whole = recording(6, 5, &|t| vec![sine(t)], 1.0);
    let one = folder.join("one.wav");
    write(&one, &whole, &IN_ORDER);
    let (expected, _) = heard(&three(), &[one]);
    assert!(expected.len() >= 6);
    // Backwards in one file.
    let backwards: Vec<usize> = IN_ORDER.iter().rev().copied().collect();
    let other = folder.join("other.wav");
    write(&other, &whole, &backwards);
    let named = station(&format!("frequencies_hz = [444.0, 666.0, 702.0]\nchannels = {backwards:?}\n"));
    assert_eq!(heard(&named, &[other]).0, expected);
    // In two files that begin together, twelve channels and eleven.
    let parts = ["part-1.wav", "part-2.wav"].map(|name| folder.join(name));
    write(&parts[0], &whole, &IN_ORDER[..12]);
    write(&parts[1], &whole, &IN_ORDER[12..]);
    assert_eq!(heard(&three(), &parts).0, expected);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_is_missing_or_impossible_is_said_in_one_line() {
    let folder = folder("wrong");
    let file = folder.join("few.wav");
    let few = recording(2, 1, &|_| vec![0.1], 1.0);
    write(&file, &few, &IN_ORDER[..20]);
    let said = |station: &Station| {
        let found = Line::find(std::slice::from_ref(&file), station, &Asked::default());
        format!("{:#}", found.err().expect("refused"))
    };
    assert!(said(&three()).contains("20 channels"), "{}", said(&three()));
    assert!(said(&station("")).contains("frequencies_hz"));
    let high = said(&station("frequencies_hz = [1020.0]\n"));
    assert!(high.contains("1020") && high.contains("possible"), "{high}");
    let short = said(&station("frequencies_hz = [702.0]\nframe_s = 0.001\n"));
    assert!(short.contains("frame_s") && short.contains("too short"), "{short}");
    let alias = said(&station("frequencies_hz = [990.1]\n"));
    assert!(alias.contains("half a wavelength"), "{alias}");
    let wrong = |more: &str| {
        let text = format!("[station]\nkind = \"line\"\n[line]\nsensors = 4\nspacing_m = 1.0\n{more}");
        format!("{:#}", Station::parse(&text, "line.toml", Path::new(".")).expect_err("refused"))
    };
    for (more, key) in [
        ("channels = [0, 1, 1, 2]\n", "channels"),
        ("channels = [0, 1]\n", "channels"),
        ("method = \"esprit\"\n", "method"),
        ("forgetting = 1.0\n", "forgetting"),
        ("frequencies_hz = [-3.0]\n", "frequencies_hz"),
        ("frequencies_hz = [444.0, 444.0]\n", "444 and 444"),
        ("frequencies_hz = [444.0, 666.0, 470.0]\n", "444 and 470"),
    ] {
        let text = wrong(more);
        assert!(text.contains(key) && text.lines().count() == 1, "{text}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_gap_begins_anew_and_is_counted() {
    let folder = folder("gap");
    let whole = recording(9, 6, &|t| vec![sine(t)], 0.5);
    let rate = RATE_HZ as usize;
    let parts = [("x-20240501T000000Z.wav", 0..4 * rate), ("x-20240501T000006Z.wav", 6 * rate..9 * rate)];
    let files = parts.map(|(name, span)| {
        let file = folder.join(name);
        write(&file, &whole[span], &IN_ORDER);
        file
    });
    let (bearings, summary) = heard(&three(), &files);
    assert_eq!(summary.steps, 7);
    let strongest: Vec<_> = bearings.iter().filter(|b| b.source == 0).collect();
    // The first after the gap rests on its own step alone.
    assert!(strongest.iter().any(|b| b.t_s == 6.5), "{strongest:?}");
    assert!(strongest.iter().all(|b| (b.sine - sine(b.t_s)).abs() < 5.0 * b.sd), "{strongest:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// What a vessel that passes near is off by, its recording in a folder of this name: mean over its sine's rate (seconds), and root mean square over what is stated.
fn passing(name: &str, more: &str, tones_hz: [f64; 3]) -> (f64, f64) {
    // 8 m/s, 100 m away at 30 s.
    let sine = |t_s: f64| {
        let (along, across) = (8.0 * (t_s - 30.0), 100.0f64);
        (0.5 * along + 0.75f64.sqrt() * across) / along.hypot(across)
    };
    let folder = folder(name);
    let file = folder.join("pass.wav");
    write(&file, &tones(60, 11, &|t| vec![sine(t)], 0.7, tones_hz), &IN_ORDER);
    let station = station(&format!("frequencies_hz = [444.0, 666.0, 702.0]\n{more}"));
    let (bearings, _) = heard(&station, &[file]);
    std::fs::remove_dir_all(folder).unwrap();
    let near = |b: &&LineBearing| b.source == 0 && (10.0..50.0).contains(&b.t_s);
    let (mut time, mut rates, mut squares, mut n) = (0.0, 0.0, 0.0, 0.0);
    for b in bearings.iter().filter(near) {
        let (error, rate) = (b.sine - sine(b.t_s), (sine(b.t_s + 0.05) - sine(b.t_s - 0.05)) / 0.1);
        time += error * rate;
        rates += rate * rate;
        squares += (error / b.sd).powi(2);
        n += 1.0;
    }
    assert!(n > 35.0, "{n}");
    (time / rates, (squares / n).sqrt())
}

#[test]
fn a_bearing_is_of_the_moment_it_says_while_its_source_turns() {
    for more in ["", "forgetting = 0.0\n", "forgetting = 0.6\n", "step_s = 0.5\n"] {
        let (late_s, standardised) = passing("turning", more, FREQUENCIES_HZ);
        assert!(late_s.abs() < 0.04 && standardised < 1.5, "{more}: {late_s} s, {standardised}");
    }
}

#[test]
fn tones_beside_the_named_frequencies_are_read_at_their_own() {
    for beside in [-6.0, 5.0, 9.0] {
        let (late_s, standardised) = passing("beside", "", FREQUENCIES_HZ.map(|f| f + beside));
        assert!(late_s.abs() < 0.04 && standardised < 1.5, "{beside} Hz: {late_s} s, {standardised}");
    }
}

#[test]
fn dead_sensors_are_left_out_and_silence_has_no_bearing() {
    let folder = folder("dead");
    let file = folder.join("dead.wav");
    let rate = RATE_HZ as usize;
    let whole = recording(24, 9, &|t| vec![sine(t)], 0.5);
    // Three sensors record nothing, from the sixth second on.
    let mut dead = whole.clone();
    for instant in &mut dead[6 * rate..] {
        instant[5..8].fill(0.0);
    }
    write(&file, &dead, &IN_ORDER);
    let (bearings, summary) = heard(&three(), std::slice::from_ref(&file));
    assert_eq!(summary.steps, 24);
    let ghosts = bearings.iter().filter(|b| (b.sine - sine(b.t_s)).abs() > 5.0 * b.sd).count();
    assert!(ghosts == 0 && bearings.len() == 24, "{ghosts} of {}: {bearings:?}", bearings.len());
    // Nothing at all for eight seconds.
    let mut silent = whole;
    for instant in &mut silent[8 * rate..16 * rate] {
        instant.fill(0.0);
    }
    write(&file, &silent, &IN_ORDER);
    let (bearings, summary) = heard(&three(), &[file]);
    assert_eq!((summary.steps, summary.lost), (16, 8 * u64::from(RATE_HZ)));
    assert!(bearings.iter().all(|b| !(8.0..16.0).contains(&b.t_s)), "{bearings:?}");
    assert!(bearings.iter().all(|b| (b.sine - sine(b.t_s)).abs() < 5.0 * b.sd), "{bearings:?}");
    std::fs::remove_dir_all(folder).unwrap();
}
