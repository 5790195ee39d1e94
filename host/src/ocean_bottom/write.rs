//! Writing a simulated recording: miniSEED (one file a component), the truth, the station file and its table.

use super::scenario::{Channel, ObsFault};
use super::simulate::{MovingVessel, Simulator};
use super::station;
use super::truth::then;
use crate::angle::wrap_deg;
use crate::atomic::{self, Unfinished};
use crate::csv::{CsvText, Fixed};
use crate::progress;
use crate::propagation::{Propagation, file};
use crate::recording::mseed_record::nano_time;
use crate::scenario::Written;
use anyhow::{Context, Result, anyhow};
use miniseed_rs::{EncodingFormat, MseedRecord, Samples, encode};
use seabearing_core::block::Frame;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Bytes of a record.
const RECORD_BYTES: u32 = 4096;

/// Samples of a record: 32-bit integers behind the 56 bytes of its header.
const RECORD_SAMPLES: usize = (RECORD_BYTES as usize - 64) / 4;

/// One component's file while it grows.
struct Component {
    file: Unfinished,
    path: PathBuf,
    channel: usize,
    code: String,
    first: u64,
    samples: Vec<i32>,
    number: u32,
}

impl Component {
    fn flush(&mut self, start: time::OffsetDateTime, rate_hz: f64, name: &str) -> Result<()> {
        for chunk in std::mem::take(&mut self.samples).chunks(RECORD_SAMPLES) {
            let at = start + time::Duration::seconds_f64(self.first as f64 / rate_hz);
            self.number = self.number % 999_999 + 1;
            let mut record = MseedRecord::new()
                .with_nslc("XX", name, "", &self.code)
                .with_start_time(nano_time(at))
                .with_sample_rate(rate_hz)
                .with_encoding(EncodingFormat::Int32)
                .with_record_length(RECORD_BYTES)
                .with_samples(Samples::Int(chunk.to_vec()));
            record.sequence_number = format!("{:06}", self.number);
            let bytes = encode(&record).map_err(|e| anyhow!("{e}"))?;
            self.file
                .as_file()
                .write_all(&bytes)
                .with_context(|| format!("cannot write {}", self.path.display()))?;
            self.first += chunk.len() as u64;
        }
        Ok(())
    }

    fn add(
        &mut self,
        first: u64,
        frames: &[Frame],
        start: time::OffsetDateTime,
        rate_hz: f64,
        name: &str,
    ) -> Result<()> {
        if self.first + self.samples.len() as u64 != first {
            self.flush(start, rate_hz, name)?;
            self.first = first;
        }
        self.samples.extend(frames.iter().map(|f| f[self.channel]));
        if self.samples.len() >= 32 * RECORD_SAMPLES {
            let rest = self.samples.split_off(32 * RECORD_SAMPLES);
            self.flush(start, rate_hz, name)?;
            self.samples = rest;
        }
        Ok(())
    }
}

/// Runs a simulator to its end and writes everything into a folder (made if missing).
///
/// # Errors
/// A file cannot be written; nothing is left half written.
pub fn write(simulator: &mut Simulator, folder: &Path) -> Result<Written> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make folder {}", folder.display()))?;
    let scenario = simulator.scenario().clone();
    for vessel in unheard(simulator) {
        log::warn!(
            "{vessel}: nothing is heard of it, as it is never within the {:.0} km that the propagation table reaches while it sounds",
            simulator.table().max_range_m() / 1000.0
        );
    }
    let (start, rate, name) = (scenario.start, scenario.rate_hz, scenario.name.to_uppercase());
    let mut components = Vec::new();
    for (channel, code) in scenario.codes().into_iter().enumerate() {
        if scenario.faults.contains(&ObsFault::Missing(Channel { channel })) {
            continue;
        }
        let path = folder.join(format!("{name}.{code}.mseed"));
        let file = Unfinished::beside(&path)?;
        components.push(Component { file, path, channel, code, first: 0, samples: Vec::new(), number: 0 });
    }
    let bar = progress::bar(simulator.len(), "samples");
    while let Some((first, frames)) = simulator.next_run() {
        for c in &mut components {
            c.add(first, &frames, start, rate, &name)?;
        }
        bar.inc(frames.len() as u64);
    }
    bar.finish_and_clear();
    let mut recordings = Vec::new();
    for mut c in components {
        c.flush(start, rate, &name)?;
        c.file.finish()?;
        recordings.push(c.path);
    }
    let [truth_csv, tracks_csv, station_file, table_file] =
        ["truth.csv", "tracks.csv", "station.toml", "table.toml"].map(|name| folder.join(name));
    file::write(simulator.table(), &table_file)?;
    atomic::write(&station_file, station::text(&scenario, "table.toml").as_bytes())?;
    atomic::write(&truth_csv, truth(simulator).as_bytes())?;
    atomic::write(&tracks_csv, tracks(&simulator.vessels).as_bytes())?;
    Ok(Written {
        recordings,
        truth: truth_csv,
        tracks: Some(tracks_csv),
        station: station_file,
        table: Some(table_file),
    })
}

/// Names of vessels that are beyond the table whenever they sound.
fn unheard(simulator: &Simulator) -> Vec<String> {
    const EVERY_S: f64 = 60.0;
    let farthest_m = simulator.table().max_range_m();
    let within = |v: &MovingVessel| {
        // What is heard at the beginning left a little before.
        let from_s = v.active_s.0.max(-EVERY_S);
        let length_s = v.active_s.1.min(simulator.scenario().duration_s) - from_s;
        let looks = (length_s / EVERY_S).ceil().max(1.0);
        let mut places = (0..=looks as u64).filter_map(|n| v.course.at(from_s + n as f64 / looks * length_s));
        places.any(|place| crate::course::polar(place).0 <= farthest_m)
    };
    simulator.vessels.iter().filter(|v| !within(v)).map(|v| v.name.clone()).collect()
}

/// Minute by minute: where each vessel is and where it was when the sound now heard left it; other sounds by span.
fn truth(simulator: &Simulator) -> String {
    let mut out = CsvText::new(
        "t_s,source,kind,x_m,y_m,range_m,azimuth_deg,heard_range_m,heard_azimuth_deg,heard_radial_speed_m_s",
    );
    let (scenario, table): (_, &Propagation) = (simulator.scenario(), simulator.table());
    let minutes = (scenario.duration_s / 60.0) as u64;
    for v in &simulator.vessels {
        for t in (0..=minutes).map(|m| 60.0 * m as f64) {
            let Some((x, y)) = v.course.at(t) else { continue };
            let (range, azimuth) = crate::course::polar((x, y));
            let Some(h) = then(table, scenario.paths, v, t) else { continue };
            out.row(&[
                &Fixed(t, 0),
                &v.name,
                &"ship",
                &Fixed(x, 1),
                &Fixed(y, 1),
                &Fixed(range, 1),
                &Fixed(azimuth.to_degrees(), 3),
                &Fixed(h.range_m, 1),
                &Fixed(h.azimuth.to_degrees(), 3),
                &Fixed(h.radial_m_s, 3),
            ]);
        }
    }
    for (i, h) in simulator.heard().iter().enumerate() {
        for t in [h.from_s, h.to_s] {
            let range = if h.range_m.is_finite() { format!("{:.1}", h.range_m) } else { String::new() };
            let (azimuth, name) = (Fixed(h.azimuth.to_degrees(), 3), format!("{}-{}", h.kind, i + 1));
            out.row(&[&Fixed(t, 1), &name, &h.kind, &"", &"", &range, &azimuth, &range, &azimuth, &""]);
        }
    }
    out.finish()
}

/// Closest point, heading and speed of each vessel (of the line that fits it best).
fn tracks(vessels: &[MovingVessel]) -> String {
    let mut out = CsvText::new("source,cpa_time_s,cpa_range_m,heading_deg,speed_m_s");
    for v in vessels {
        if let Some((t, r, h, s)) = super::truth::closest(&v.course) {
            let heading = wrap_deg(h.to_degrees());
            out.row(&[&v.name, &Fixed(t, 2), &Fixed(r, 2), &Fixed(heading, 4), &Fixed(s, 4)]);
        }
    }
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ocean_bottom::scenario::ObsScenario;
    use crate::propagation::bottom::Bottom;
    use crate::propagation::profile::SpeedProfile;
    use crate::propagation::trace;

    #[test]
    fn a_vessel_that_the_table_never_reaches_is_named() {
        let profile = SpeedProfile::subtropical(4340.0).unwrap();
        let table = trace::trace("t", &profile, &Bottom::default(), 70.0, 500, || ());
        let reach_m = table.max_range_m();
        // The third comes as near as the table reaches in its last minutes alone, the fourth when it is silent.
        let vessel = |name: &str, range_m: f64, cpa_time_s: f64| {
            format!(
                "[[vessels]]\nname = \"{name}\"\nstraight = {{ cpa_time_s = {cpa_time_s}, cpa_range_m = {range_m}, heading_deg = 0.0, \
                 speed_m_s = 7.0, side = \"port\" }}\n"
            )
        };
        let between = |from_s: f64, to_s: f64| format!("active_s = [{from_s}, {to_s}]\n");
        let text = String::from("kind = \"obs\"\nseed = 1\nduration_s = 3600.0\npropagation = \"t\"\n")
            + &vessel("near", 9_000.0, 1800.0)
            + &vessel("beyond", reach_m + 500.0, 1800.0)
            + &vessel("late", reach_m - 100.0, 3500.0)
            + &vessel("gone", reach_m - 100.0, 3500.0)
            + &between(0.0, 1800.0)
            + &vessel("brief", 9_000.0, 1800.0)
            + &between(1805.0, 1806.0);
        let scenario: ObsScenario = toml::from_str(&text).unwrap();
        let simulator = Simulator::new(scenario, table, Vec::new()).unwrap();
        assert_eq!(unheard(&simulator), ["beyond", "gone"]);
    }
}
