//! `docs/wire.md` says what the code does: its schema is the code's, and its example frames, computed by an independent
//! implementation of the page, are what the encoder makes and the decoder reads.

use seabearing_core::wire::*;

const PAGE: &str = include_str!("../../docs/wire.md");

/// The example frame of a name, from the page.
fn example(name: &str) -> Vec<u8> {
    let line = PAGE
        .lines()
        .find(|l| l.split_whitespace().next() == Some(name) && l.trim_end().ends_with(" 00"))
        .unwrap_or_else(|| panic!("docs/wire.md has no example of {name}"));
    line.split_whitespace().skip(1).map(|h| u8::from_str_radix(h, 16).expect("hexadecimal bytes")).collect()
}

/// Pairs of codes in two bytes each.
fn samples(codes: &[i16]) -> Samples {
    let mut bytes = [[0; 30]; 2];
    let to = bytes.as_flattened_mut().chunks_exact_mut(2);
    to.zip(codes).for_each(|(to, code)| to.copy_from_slice(&code.to_le_bytes()));
    let instants = (codes.len() / 2) as u8;
    Samples { token: 6, index: 640_000, instants, channels: 0b1010, width: 2, bytes }
}

fn spectrum() -> Spectrum {
    let level = |n: usize| if n < 21 { -1000 - 5 * n as i16 } else { Spectrum::NOTHING };
    Spectrum {
        token: 7,
        index: 704_000,
        channel: 2,
        of: 0b1111,
        frames: 71,
        bin_hz: 125.0,
        tenth_db: std::array::from_fn(level),
    }
}

fn azigram() -> Azigram {
    let azimuth = std::array::from_fn(|n| (10 * n + 5) as u8);
    let coherence = std::array::from_fn(|n| 255 - 11 * n as u8);
    Azigram { index: 3000, frames: 6, bin_hz: 0.0625, first_bin: 225, bins: 266, azimuth, coherence }
}

fn messages() -> Vec<(&'static str, Message)> {
    let pow = |e: i32| 2f32.powi(e);
    vec![
        (
            "Hello",
            Message::Hello(Hello {
                wire_version: 1,
                schema_hash: 0x1122_3344_5566_7788,
                config_hash: 0x0102_0304_0506_0708,
                version: (0, 1, 0),
                station: 300,
                kind: 0,
                rate_hz: 64_000.0,
                reset_cause: 1,
            }),
        ),
        (
            "Bearing",
            Message::Bearing(Bearing {
                index: 96_000,
                azimuth: 1.5,
                elevation: 0.25,
                var_azimuth: pow(-13),
                var_elevation: pow(-12),
                cov: -pow(-15),
                snr_db: 12.5,
                quality: 0.875,
                closure_s: pow(-20),
                statistic: 3.5,
                band: 0,
                flags: 1,
            }),
        ),
        (
            "Track",
            Message::Track(Track {
                id: 1,
                stage: 1,
                index: 6_400_000,
                cpa_time_s: 100.25,
                cpa_range_m: 500.0,
                cpa_azimuth: 5.25,
                heading: 0.5,
                speed_m_s: 7.0,
                starboard: true,
                sd_cpa_time_s: 0.5,
                sd_cpa_range_m: f32::INFINITY,
                sd_heading: pow(-7),
                sd_speed_m_s: 0.25,
                x_m: -250.0,
                y_m: 430.5,
                var_x_m2: 100.0,
                var_y_m2: 64.0,
                cov_xy_m2: -12.0,
                range_observable: false,
                n: 200,
            }),
        ),
        (
            "Health",
            Message::Health(Health {
                index: 640_000,
                processed: 639_000,
                lost: [500, 0, 0, 448, 0, 52],
                channels: 0x24,
                level_half_db: [-90, -91, -127, -1],
                records: 19,
                frames_dropped: 0,
            }),
        ),
        (
            "Azimuth",
            Message::Azimuth(Azimuth {
                index: 3000,
                azimuth: 3.0,
                sd: 0.125,
                log_presence: 4.5,
                weight: 0.75,
                detected: true,
                kind: 0,
            }),
        ),
        (
            "Range",
            Message::Range(Range {
                index: 3000,
                range_m: 4300.0,
                sd_range_m: 150.0,
                speed_m_s: -5.5,
                sd_speed_m_s: 0.5,
                log_presence: 2.25,
                weight: 0.5,
                detected: true,
            }),
        ),
        (
            "Segment",
            Message::Segment(Segment {
                id: 2,
                start: 1000,
                end: 90_000,
                turn: Some(45_000),
                kind: 0,
                log_evidence: 1.25,
            }),
        ),
        ("Fault", Message::Fault(Fault { code: FaultCode::DeadChannel, index: 128_000, value: 2 })),
        ("Reply", Message::Reply(Reply { token: 9, status: 1 })),
        ("End", Message::End(End { index: 12_800_000, frames: 421 })),
        (
            "ShaftRate",
            Message::ShaftRate(ShaftRate {
                index: 1_920_000,
                rate_hz: 2.125,
                sd_hz: pow(-10),
                confidence: 1.0,
                ln_false_alarm: -24.0,
                harmonics: 3,
                blades: 4,
                speed_m_s: 7.5,
                sd_speed_m_s: 0.625,
                track: 2,
            }),
        ),
        (
            "FaultsHeld",
            Message::FaultsHeld(FaultsHeld {
                code: FaultCode::Invalid,
                index: 3_840_000,
                count: 128,
                value: 640,
            }),
        ),
        (
            "Time",
            Message::Time(Time {
                index: 6_400_000,
                utc_us: 1_790_000_000_250_000,
                sd_s: pow(-10),
                drift: -pow(-15),
                sd_drift: pow(-20),
                correlation: -0.5,
            }),
        ),
        ("Snippet", Message::Snippet(Snippet { token: 6, index: 640_000, instants: 2048, channels: 0b1010 })),
        ("Samples", Message::Samples(samples(&[1, -1, 300, -32_768, 32_767, 0]))),
        ("Spectrum", Message::Spectrum(spectrum())),
        ("Azigram", Message::Azigram(azigram())),
        (
            "Margins",
            Message::Margins(Margins {
                index: 640_000,
                memory: 90_000,
                memory_free: 66_144,
                longest_us: 7150,
                waiting: 12,
                room: 7000,
                supply_mv: Some(3295),
                battery_mv: None,
                temperature_c: Some(-2),
            }),
        ),
        (
            "Transient",
            Message::Transient(Transient {
                index: 650_000,
                duration: 130,
                count: 3,
                peak_tenth_db: -215,
                azimuth: 4.5,
                elevation: -0.125,
                var_azimuth: pow(-19),
                var_elevation: pow(-18),
                cov: -pow(-21),
                channel: 2,
                channels: 0x2f,
                kind: 1,
            }),
        ),
    ]
}

#[test]
fn the_page_holds_the_schema_word_for_word() {
    assert!(PAGE.contains(&format!("```text\n{SCHEMA}```")), "copy wire/src/schema.txt into docs/wire.md");
    assert!(PAGE.contains(&format!("it is {WIRE_VERSION}.")));
}

#[test]
fn every_message_of_the_schema_has_an_example_and_a_meaning() {
    let variants = SCHEMA.lines().filter(|l| !l.starts_with("command"));
    let names: Vec<&str> = variants.filter_map(|l| l.split_whitespace().nth(1)).collect();
    assert_eq!(names, messages().iter().map(|(n, _)| *n).collect::<Vec<_>>());
    for name in names {
        assert!(PAGE.contains(&format!("**{name}**")), "docs/wire.md does not explain {name}");
    }
}

#[test]
fn the_examples_are_what_the_encoder_makes_and_the_decoder_reads() {
    let mut encoder = Encoder::default();
    let mut decoder = Decoder::default();
    for (name, message) in messages() {
        let bytes = example(name);
        assert_eq!(encoder.frame(&message), bytes, "{name}");
        let got = bytes.iter().find_map(|b| decoder.push::<Message>(*b)).unwrap_or_else(|| panic!("{name}"));
        assert_eq!(got.message, message);
    }
    assert_eq!(decoder.counters().lost, 0);
}

#[test]
fn the_examples_of_commands_too() {
    let commands = [
        ("Identify", Command::Identify { token: 1 }),
        ("HealthEvery", Command::HealthEvery { token: 2, seconds: 600 }),
        ("Stop", Command::Stop { token: 3 }),
        ("Start", Command::Start { token: 4 }),
        ("Utc", Command::Utc { token: 5, utc_us: 1_790_000_000_250_000, sd_us: 250_000 }),
        ("SendSnippet", Command::SendSnippet { token: 6, channels: 0b1010, instants: 2048 }),
        ("SendSpectrum", Command::SendSpectrum { token: 7, channels: 0b1111 }),
    ];
    let mut encoder = Encoder::default();
    let mut decoder = Decoder::default();
    for (name, command) in commands {
        let bytes = example(name);
        assert_eq!(encoder.frame(&command), bytes, "{name}");
        assert_eq!(bytes.iter().find_map(|b| decoder.push::<Command>(*b)).map(|r| r.message), Some(command));
    }
}
