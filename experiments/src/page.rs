//! The live page: a day of 64 stations to look back into, and the page itself in a real browser where there is one.

use super::base_process::{Process, hello};
use super::{Experiment, Options};
use anyhow::{Context, Result, bail};
use seabearing_base::store::{Entry, Event, Store};
use seabearing_base::{Base, Beginning};
use seabearing_core::wire::{
    AZIGRAM_BANDS, Azigram, Azimuth, Bearing, Encoder, Fault, FaultCode, Health, Margins, Message, Range,
    Time, Track,
};
use seabearing_host::beside::{Folder, ask};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;
use time::OffsetDateTime;

/// `seabearing reproduce page`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "page",
    about: "the live page: any moment of a day of 64 stations; first view, update, panning and accessibility in Chromium; --runs: bearings a minute",
    run,
};

const STATIONS: u16 = 64;
/// Every so many stations one is at the ocean bottom.
const BOTTOM: u16 = 8;
const HOURS: u64 = 24;
/// Samples a second of all recorders, as their index counts.
const RATE_HZ: u64 = 1000;
/// Moments that are looked at.
const MOMENTS: u64 = 40;
/// Versions that the browser is driven and judged with.
const PACKAGES: [&str; 2] = ["puppeteer-core@25.16.0", "axe-core@4.14.1"];

fn run(options: &Options) -> Result<()> {
    let folder = Folder::new()?;
    let store = folder.path().join("store");
    let now_us = (OffsetDateTime::now_utc().unix_timestamp_nanos() / 1000) as i64;
    let begin_us = now_us - HOURS as i64 * 3_600_000_000;
    let begun = Instant::now();
    let records = fill(&store, begin_us, options.runs.unwrap_or(2).clamp(1, 60) as u64)?;
    let figures = &options.figures;
    figures.state("records of the day", records as f64);
    figures.state("written, records a second", records as f64 / begun.elapsed().as_secs_f64());
    let stations = folder.path().join("stations.toml");
    std::fs::write(&stations, listed())?;
    let base = Process::start_with(
        &store,
        &["--page", "127.0.0.1:0", "--stations", "stations.toml"],
        folder.path(),
    )?;
    let page = base.page.as_deref().context("the base station names no page")?;
    let mut worst_ms = [0f64; 2];
    for n in 0..MOMENTS {
        let at = begin_us / 1000 + (n * 37 % MOMENTS * HOURS * 3_600_000 / MOMENTS) as i64;
        let series = format!("/api/series?station={}&from={}&to={at}", n % 64 + 1, at - 3_600_000);
        for (worst, path) in worst_ms.iter_mut().zip([format!("/api/moment?at={at}"), series]) {
            let begun = Instant::now();
            ask(page, &path)?;
            *worst = worst.max(begun.elapsed().as_secs_f64() * 1e3);
        }
    }
    let [moment, series] = worst_ms;
    figures.at_most(
        format!("longest of {MOMENTS} moments and their plots from the store, ms"),
        moment + series,
        300.0,
    );
    let day = format!("/api/series?station=1&from={}&to={}", begin_us / 1000, now_us / 1000);
    let begun = Instant::now();
    ask(page, &day)?;
    figures.at_most("plots of a whole day, ms", begun.elapsed().as_secs_f64() * 1e3, 300.0);
    let seen = browser(options, page, &base.address, now_us - begin_us)?;
    let of = |name: &str| seen.iter().find(|s| s["name"] == name).and_then(|s| s["value"].as_f64());
    figures.at_most("first view, s", of("first view, s"), 1.0);
    figures.at_most("update after a record arrives, s", of("update after a record arrives, s"), 1.0);
    let pan = "pan with 10 000 track points: time of a frame, 95 of 100, ms";
    figures.at_most(pan, of(pan), 1000.0 / 60.0);
    let pan = "pan with 10 000 track points: frames a second";
    if let Some(rate) = of(pan) {
        figures.state(pan, rate);
    }
    let moved = "map after a pan: share of it that is not as drawn anew, %";
    figures.at_most(moved, of(moved), 1.0);
    let replay = "replay in the browser: longest to a moment, ms";
    figures.at_most(replay, of(replay), 300.0);
    for place in ["live", "alarms", "replay"] {
        for theme in ["light", "dark"] {
            for what in ["serious findings of axe", "findings of contrast"] {
                let name = format!("{what}, {place}, {theme}");
                figures.at_most(name.clone(), of(&name), 0.0);
            }
        }
    }
    for name in [
        "places and lengths that the map puts wrong",
        "coastlines taken or refused wrongly",
        "azigrams without colours or words",
        "alarms that shift the map, hide their day or cannot be acknowledged together",
        "parts of a narrow page that overlap or do not fit",
        "complaints of the browser",
    ] {
        figures.at_most(name, of(name), 0.0);
    }
    base.kill();
    Ok(())
}

/// Stations on a grid off a coast.
fn listed() -> String {
    let place = |n: u16| (48.9 + f64::from(n / 8) * 0.06, -123.6 + f64::from(n % 8) * 0.09);
    let mut text = String::new();
    for n in 0..STATIONS {
        let (lat, lon) = place(n);
        text += &format!(
            "[[stations]]\nid = {}\nname = \"{}{}\"\nposition = {{ lat_deg = {lat:.3}, lon_deg = {lon:.3}, depth_m = 200.0 }}\n",
            n + 1,
            char::from(b'A' + (n / 8) as u8),
            n % 8 + 1
        );
    }
    text
}

/// What Chromium measures; nothing, with the reason on standard error, where it cannot be run.
fn browser(options: &Options, page: &str, line: &str, day_us: i64) -> Result<Vec<Value>> {
    let without = |why: &str| {
        eprintln!("seabearing: the page is not looked at in a browser: {why}");
        Ok(Vec::new())
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("page").join("tests/browser.mjs");
    let found = ["chromium", "chromium-browser", "google-chrome"].map(|name| (name, runs(name)));
    let Some((chromium, _)) = found.into_iter().find(|(_, runs)| *runs) else {
        return without("there is no Chromium (on Debian: apt-get install chromium)");
    };
    if !script.exists() || !runs("node") || !runs("npm") {
        return without("it takes this checkout, node and npm (on Debian: apt-get install nodejs npm)");
    }
    let beside = std::path::absolute(&options.out)?.join("page-browser");
    std::fs::create_dir_all(&beside)?;
    if PACKAGES.iter().any(|p| !beside.join("node_modules").join(p.split('@').next().unwrap_or(p)).exists()) {
        let mut npm = Command::new("npm");
        npm.args(["install", "--no-audit", "--no-fund", "--loglevel=error"]).args(PACKAGES);
        let installed = npm.current_dir(&beside).stdin(Stdio::null()).output()?;
        if !installed.status.success() {
            return without("npm could not install puppeteer-core and axe-core");
        }
    }
    // A recorder that has begun a day ago and says a bearing now and then.
    let mut encoder = Encoder::default();
    let now = (day_us / 1_000_000) as u64 * RATE_HZ;
    let mut frames = vec![encoder.frame(&hello(STATIONS + 1, RATE_HZ as f32)).to_vec()];
    frames.extend((0..8).map(|n| encoder.frame(&bearing(1, now + n * RATE_HZ)).to_vec()));
    let hex = |frame: &Vec<u8>| frame.iter().map(|b| format!("{b:02x}")).collect::<String>();
    let frames: Vec<String> = frames.iter().map(hex).collect();
    let mut node = Command::new("node");
    node.arg(script).args(["--url", page, "--line", line, "--frames", &frames.join(","), "--chromium"]);
    node.arg(which(chromium)).arg("--pictures").arg(&beside).current_dir(&beside).stdin(Stdio::null());
    let ran = node.stderr(Stdio::piped()).output()?;
    let said = String::from_utf8_lossy(&ran.stdout);
    let seen: Vec<Value> = said.lines().filter_map(|l| serde_json::from_str(l).ok()).collect();
    for finding in seen.iter().filter(|s| s["said"].as_array().is_some_and(|a| !a.is_empty())) {
        eprintln!("seabearing: {}: {}", finding["name"], finding["said"]);
    }
    if !ran.status.success() {
        let why = String::from_utf8_lossy(&ran.stderr).into_owned();
        bail!("the page's check in the browser has failed: {}", why.lines().next().unwrap_or(""));
    }
    eprintln!("seabearing: pictures of the page are in {}", beside.display());
    Ok(seen)
}

fn runs(name: &str) -> bool {
    let mut command = Command::new(name);
    command.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|s| s.success())
}

/// The path of a program.
fn which(name: &str) -> std::path::PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).map(|p| p.join(name)).find(|p| p.exists()).unwrap_or_else(|| name.into())
}

fn bearing(station: u16, index: u64) -> Message {
    let turn = index as f64 / RATE_HZ as f64 / 600.0 + f64::from(station);
    Message::Bearing(Bearing {
        index,
        azimuth: (turn.rem_euclid(std::f64::consts::TAU)) as f32,
        elevation: 0.12,
        var_azimuth: 4e-4,
        var_elevation: 9e-4,
        cov: 0.0,
        snr_db: (10.0 + 6.0 * (3.0 * turn).sin()) as f32,
        quality: 0.9,
        closure_s: 1e-6,
        statistic: 3.0,
        band: 0,
        flags: 0,
    })
}

/// A vessel on a straight course that passes a station once an hour.
fn track(station: u16, hour: u64, index: u64, last: bool) -> Message {
    let t_s = (index as f64 / RATE_HZ as f64) - (hour as f64 * 3600.0) - 900.0;
    let (heading, speed, closest) = (f64::from(station) * 0.7, 6.0, 300.0 + 20.0 * f64::from(station));
    let (s, c) = heading.sin_cos();
    let (x, y) = (speed * t_s * s + closest * c, speed * t_s * c - closest * s);
    let spread = 20.0 + 0.05 * x.hypot(y);
    Message::Track(Track {
        id: (hour + 1) as u16,
        stage: u8::from(last),
        index,
        cpa_time_s: hour as f64 * 3600.0 + 900.0,
        cpa_range_m: closest as f32,
        cpa_azimuth: (c * closest).atan2(-s * closest).rem_euclid(std::f64::consts::TAU) as f32,
        heading: heading.rem_euclid(std::f64::consts::TAU) as f32,
        speed_m_s: speed as f32,
        starboard: false,
        sd_cpa_time_s: 2.0,
        sd_cpa_range_m: 25.0,
        sd_heading: 0.02,
        sd_speed_m_s: 0.3,
        x_m: x as f32,
        y_m: y as f32,
        var_x_m2: (spread * spread) as f32,
        var_y_m2: (0.5 * spread * spread) as f32,
        cov_xy_m2: (0.2 * spread * spread) as f32,
        range_observable: true,
        n: 200,
    })
}

/// Directions by frequency: lines of a vessel every few bands where there is one, surf from one side below, and chance.
fn azigram(station: u16, index: u64, vessel: Option<f32>) -> Message {
    let chance = |band: usize| {
        let mixed = (index / RATE_HZ + 977 * band as u64 + 31 * u64::from(station))
            .wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (mixed >> 32) as u8
    };
    let of = |band: usize| match vessel {
        Some(azimuth) if band % 5 != 1 => {
            ((azimuth / std::f32::consts::TAU * 256.0) as u8, 150 + chance(band) / 3)
        }
        _ if band < 5 => (40 + chance(band) / 12, 90 + chance(band) / 8),
        _ => (chance(band), 10 + chance(band + 1) / 8),
    };
    Message::Azigram(Azigram {
        index,
        frames: 6,
        bin_hz: 50.0 / 1024.0,
        first_bin: 226,
        bins: 266,
        azimuth: std::array::from_fn::<_, AZIGRAM_BANDS, _>(|band| of(band).0),
        coherence: std::array::from_fn(|band| of(band).1),
    })
}

/// A board whose cell grows weak with its number.
fn margins(station: u16, index: u64) -> Margins {
    Margins {
        index,
        memory: 227_272,
        memory_free: 204_800,
        longest_us: 7100,
        waiting: u32::from(station),
        room: 7000,
        supply_mv: Some(3290 + station % 20),
        battery_mv: Some(3050 - 20 * station),
        temperature_c: Some(8),
    }
}

/// An hour of a station.
fn hour(station: u16, hour: u64, begin_us: i64, each_minute: u64) -> Vec<Message> {
    let from = hour * 3600 * RATE_HZ;
    let mut said: Vec<(u64, Message)> = Vec::new();
    let utc_us = begin_us + (hour * 3_600_000_000) as i64;
    said.push((
        from,
        Message::Time(Time {
            index: from,
            utc_us,
            sd_s: 0.02,
            drift: 2e-6,
            sd_drift: 1e-7,
            correlation: 0.0,
        }),
    ));
    let bottom = station.is_multiple_of(BOTTOM);
    for minute in 0..60 {
        let index = from + minute * 60 * RATE_HZ;
        if minute % 5 == 0 {
            let level = -60 - (f64::from(station) * 3.0 + minute as f64 * 0.4) as i64 % 40;
            let levels = [level, level - 2, level + 3, level - 5].map(|l| l as i8);
            let channels = u8::from(station == 13) << 2;
            let health = Health {
                index,
                processed: index,
                records: index as u32 / 7,
                level_half_db: levels,
                channels,
                ..Health::default()
            };
            said.push((index, Message::Health(health)));
            // Every third board measures what it has left.
            if station.is_multiple_of(3) {
                said.push((index, Message::Margins(margins(station, index))));
            }
        }
        if bottom {
            let there = (20..45).contains(&minute);
            let azimuth = (0.05 * minute as f32 + f32::from(station)).rem_euclid(std::f32::consts::TAU);
            let sd = if there { 0.08 } else { f32::INFINITY };
            let log_presence = if there {
                6.0 - (minute as f32 - 32.0).abs() * 0.3
            } else {
                -3.0 + (minute % 7) as f32 * 0.2
            };
            said.push((
                index,
                Message::Azimuth(Azimuth {
                    index,
                    azimuth,
                    sd,
                    log_presence,
                    weight: 1.0,
                    detected: there,
                    kind: 0,
                }),
            ));
            let range = Range {
                index,
                range_m: 4000.0 + (minute as f32 - 32.0).abs() * 300.0,
                sd_range_m: if there { 400.0 } else { f32::INFINITY },
                speed_m_s: 5.0,
                sd_speed_m_s: if there { 0.5 } else { f32::INFINITY },
                log_presence,
                weight: 1.0,
                detected: there,
            };
            said.push((index, Message::Range(range)));
            said.push((index, azigram(station, index, there.then_some(azimuth))));
            continue;
        }
        said.extend((0..each_minute).map(|n| {
            let index = index + n * 60 * RATE_HZ / each_minute;
            (index, bearing(station, index))
        }));
        if minute < 30 {
            said.extend((0..2).map(|n| {
                let index = index + n * 30 * RATE_HZ + 1;
                (index, track(station, hour, index, minute == 29 && n == 1))
            }));
        }
    }
    if (u64::from(station) + hour).is_multiple_of(17) {
        said.push((from + 7, Message::Fault(Fault { index: from + 7, code: FaultCode::Gap, value: 640 })));
    }
    said.sort_by_key(|(index, _)| *index);
    said.into_iter().map(|(_, message)| message).collect()
}

/// Writes the day through the base station's own ways; gives the number of records.
fn fill(folder: &Path, begin_us: i64, each_minute: u64) -> Result<u64> {
    let mut base = Base::new(None);
    let mut store = Store::open(folder, &mut base)?;
    let mut encoders: Vec<Encoder> = (0..STATIONS).map(|_| Encoder::default()).collect();
    let mut records = 0;
    let mut put = |entries: &[Entry]| -> Result<()> {
        store.keep(entries)?;
        let mut rows = Vec::new();
        entries.iter().for_each(|e| e.tell(&mut base, 0, None, &mut rows));
        records += rows.len() as u64;
        store.derive(&mut base, &rows)
    };
    for h in 0..=HOURS {
        let received_us = Some(begin_us + (h * 3_600_000_000) as i64);
        let mut entries = Vec::new();
        for (station, encoder) in (1..=STATIONS).zip(&mut encoders) {
            let stream = station.into();
            let event = match h {
                0 => {
                    let line = "listen:0.0.0.0:4500".to_owned();
                    let beginning = Beginning {
                        line,
                        peer: Some(format!("10.0.0.{station}:4000")),
                        lasting: true,
                        ..Beginning::default()
                    };
                    entries.push(Entry { stream, received_us, event: Event::Began(beginning) });
                    Event::Bytes(encoder.frame(&kind(station)).to_vec())
                }
                _ => Event::Bytes(
                    hour(station, h - 1, begin_us, each_minute)
                        .iter()
                        .flat_map(|m| encoder.frame(m).to_vec())
                        .collect(),
                ),
            };
            entries.push(Entry { stream, received_us, event });
        }
        put(&entries)?;
    }
    Ok(records)
}

/// Who speaks.
fn kind(station: u16) -> Message {
    match hello(station, RATE_HZ as f32) {
        Message::Hello(said) => Message::Hello(seabearing_core::wire::Hello {
            kind: u8::from(station.is_multiple_of(BOTTOM)),
            ..said
        }),
        other => other,
    }
}
