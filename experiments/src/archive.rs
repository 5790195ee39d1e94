//! An archive of two ocean-bottom stations with their StationXML, processed as somebody would who has nothing else: time a
//! station-day, two at once against one after the other, the same records as with station files, and the same bytes after kills.

use super::obs_world::{quiet, station_table};
use super::{Experiment, Options};

use crate::ocean_bottom::scenario::{ObsVessel, Radiation};
use crate::ocean_bottom::{simulate::Simulator, write};
use crate::scenario::{Side, Straight};
use anyhow::{Context, Result, bail};
use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use seabearing_host::beside::Folder;
use seabearing_host::propagation::{Propagation, file};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "archive",
    about: "an SDS archive of two ocean-bottom stations (--runs days) with StationXML alone: pace, two at once, kills",
    run,
};

/// Codes of the stations.
const STATIONS: [&str; 2] = ["A01", "A02"];
/// Their components.
const CHANNELS: [&str; 4] = ["BDH", "BH1", "BH2", "BHZ"];
const DAY_S: f64 = 86_400.0;
/// Days where no number is asked for, and kills then; and of a week.
const DAYS: usize = 1;
const KILLS: usize = 3;
const KILLS_OF_A_WEEK: usize = 20;

fn run(o: &Options) -> Result<()> {
    let days = o.runs.unwrap_or(DAYS).max(1);
    let kept = Folder::new()?;
    let folder = kept.path();
    let table = station_table(o)?;
    file::write(&table, &folder.join("table.toml"))?;
    for (station, name) in STATIONS.into_iter().enumerate() {
        for day in 0..days {
            eprintln!("seabearing: simulating {name}, day {} of {days}", day + 1);
            record(folder, &table, station, day, o.seed)?;
        }
    }
    std::fs::write(folder.join("network.xml"), network())?;
    let by_xml = ["--station", "network.xml", "--propagation", "table.toml"];
    // The first run finds the files in memory or not; it is not timed.
    ended(&mut process(folder, &by_xml, "warm", 2)?)?;
    let (one_s, one) = timed(folder, &by_xml, "one", 1)?;
    let (two_s, two) = timed(folder, &by_xml, "two", 2)?;
    for (id, name) in (1..).zip(STATIONS) {
        let mut import = command(folder)?;
        import.args(["-q", "station", "import", "network.xml", "--station", name]);
        import
            .args(["--id", &format!("{id}"), "--propagation", "table.toml", "--out"])
            .arg(format!("{name}.toml"));
        ended(&mut import.spawn()?)?;
    }
    let (_, by_file) = timed(folder, &["--station", "A01.toml", "--station", "A02.toml"], "files", 2)?;
    let kills = if days >= 7 { KILLS_OF_A_WEEK } else { KILLS };
    let mut moments = ChaCha8Rng::seed_from_u64(o.seed);
    let (mut early, mut unlike) = (0, 0);
    for kill in 0..kills {
        let out = format!("killed-{kill}");
        let mut child = process(folder, &by_xml, &out, 2)?;
        std::thread::sleep(Duration::from_secs_f64(moments.random_range(0.02..0.95) * two_s));
        early += usize::from(child.try_wait()?.is_none());
        child.kill()?;
        child.wait()?;
        unlike += usize::from(timed(folder, &by_xml, &out, 2)?.1 != two);
        std::fs::remove_dir_all(folder.join(&out))?;
    }
    let station_days = (days * STATIONS.len()) as f64;
    let vessels =
        one.values().filter(|text| String::from_utf8_lossy(text).contains("\"stage\":\"final\"")).count();
    let differ = |a: &Records, b: &Records| {
        let names: std::collections::BTreeSet<_> = a.keys().chain(b.keys()).collect();
        names.into_iter().filter(|name| a.get(*name) != b.get(*name)).count() as f64
    };
    o.figures.state("station-days", station_days);
    o.figures.at_least("of these with a vessel's final track", vessels as f64, station_days);
    let (pace, gain) = ("seconds a station-day, one after the other", "two at once: times as fast");
    // Times of a clock are held against their bars where this is asked for by itself, on processors that do nothing else.
    if o.runs.is_some() && std::thread::available_parallelism().is_ok_and(|n| n.get() >= 2) {
        o.figures.at_most(pace, one_s / station_days, 4.0);
        o.figures.at_least(gain, one_s / two_s, 1.8);
    } else {
        o.figures.state(pace, one_s / station_days);
        o.figures.state(gain, one_s / two_s);
    }
    o.figures.at_most("station-days whose records two at once make otherwise", differ(&one, &two), 0.0);
    o.figures.at_most("station-days whose records station files make otherwise", differ(&one, &by_file), 0.0);
    o.figures.state("runs killed at random moments before their end", early as f64);
    o.figures.at_most("of these that went on to other bytes", unlike as f64, 0.0);
    Ok(())
}

/// One day of one station, in the folders of the archive.
fn record(folder: &Path, table: &Propagation, station: usize, day: usize, seed: u64) -> Result<()> {
    let mut scenario = quiet(seed + (1000 * station + day) as u64, DAY_S);
    let start = scenario.start.replace_time(time::Time::MIDNIGHT) + time::Duration::days(day as i64);
    (scenario.start, scenario.name) = (start, STATIONS[station].to_owned());
    let turn = (station * 7 + day) as f64;
    scenario.vessels = [(0.2, 9000.0), (0.65, 14_000.0)]
        .map(|(share, cpa_range_m)| ObsVessel {
            name: String::new(),
            straight: Straight {
                cpa_time_s: share * DAY_S + 600.0 * turn,
                cpa_range_m,
                heading_deg: (60.0 + 37.0 * turn) % 360.0,
                speed_m_s: 7.0,
                side: Side::Port,
            },
            active_s: [0.0, DAY_S],
            radiation: Radiation::default(),
        })
        .to_vec();
    let made = folder.join("made");
    write::write(&mut Simulator::new(scenario, table.clone(), Vec::new())?, &made)?;
    let name = STATIONS[station];
    for channel in CHANNELS {
        let to = folder.join(format!("sds/{}/XX/{name}/{channel}.D", start.year()));
        std::fs::create_dir_all(&to)?;
        let file = format!("XX.{name}..{channel}.D.{}.{:03}", start.year(), start.ordinal());
        std::fs::rename(made.join(format!("{name}.{channel}.mseed")), to.join(file))?;
    }
    Ok(())
}

/// StationXML of both.
fn network() -> String {
    let mut out = String::from(
        "<?xml version=\"1.0\"?>\n<FDSNStationXML xmlns=\"http://www.fdsn.org/xml/station/1\" schemaVersion=\"1.1\">\n\
         <Network code=\"XX\">\n",
    );
    for (n, station) in STATIONS.into_iter().enumerate() {
        let lon = 62.5 + 0.5 * n as f64;
        let _ = writeln!(
            out,
            "<Station code=\"{station}\"><Latitude>-24.9</Latitude><Longitude>{lon}</Longitude><Elevation>-4340</Elevation>"
        );
        for (channel, azimuth, dip, unit) in
            [("BDH", 0, -90, "PA"), ("BH1", 77, 0, "M/S"), ("BH2", 167, 0, "M/S"), ("BHZ", 0, -90, "M/S")]
        {
            let sensitivity = if unit == "PA" { 1600.0 } else { 5e8 };
            let _ = writeln!(
                out,
                "<Channel code=\"{channel}\" locationCode=\"\"><Latitude>-24.9</Latitude><Longitude>{lon}</Longitude>\
                 <Elevation>-4340</Elevation><Depth>0</Depth><Azimuth>{azimuth}</Azimuth><Dip>{dip}</Dip>\
                 <SampleRate>50</SampleRate><Response><InstrumentSensitivity><Value>{sensitivity:e}</Value>\
                 <Frequency>5</Frequency><InputUnits><Name>{unit}</Name></InputUnits></InstrumentSensitivity></Response>\
                 </Channel>"
            );
        }
        out += "</Station>\n";
    }
    out + "</Network>\n</FDSNStationXML>\n"
}

/// What a run left: records by their file's name.
type Records = BTreeMap<PathBuf, Vec<u8>>;

/// This command, which says nothing but warnings.
fn command(folder: &Path) -> Result<Command> {
    let mut command = Command::new(std::env::current_exe().context("the command's own file")?);
    command.current_dir(folder).stdin(Stdio::null()).stdout(Stdio::null());
    Ok(command)
}

fn process(folder: &Path, stations: &[&str], out: &str, jobs: usize) -> Result<Child> {
    let mut command = command(folder)?;
    command
        .args(["-q", "process"])
        .args(stations)
        .args(["sds", "--out", out, "--jobs"])
        .arg(jobs.to_string());
    command.spawn().context("cannot start")
}

fn ended(child: &mut Child) -> Result<()> {
    let status = child.wait()?;
    if !status.success() {
        bail!("a run ended with {status}");
    }
    Ok(())
}

/// Seconds of a run to its end, and its records.
fn timed(folder: &Path, stations: &[&str], out: &str, jobs: usize) -> Result<(f64, Records)> {
    let begun = Instant::now();
    ended(&mut process(folder, stations, out, jobs)?)?;
    let seconds = begun.elapsed().as_secs_f64();
    let mut records = Records::new();
    for entry in std::fs::read_dir(folder.join(out))? {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == "jsonl") {
            records.insert(path.file_name().unwrap_or_default().into(), std::fs::read(&path)?);
        }
    }
    Ok((seconds, records))
}
