//! The demonstration: a simulated pass streamed into the firmware under QEMU, its track shown beside the truth.

use crate::angle::turn_deg;
use crate::blob;
use crate::csv::CsvTable;
use crate::emulator::{Emulator, SamplePath};
use crate::plot::{Plot, Scale, cut_at_wraps, write_panels};
use crate::twin;
use crate::world::ArrayScenario;
use crate::world::array::SimulatedArray;
use crate::world::truth::{self, Truth};
use anyhow::{Context, Result, bail};
use seabearing_core::block::{Block, Frame};
use seabearing_core::sbraw;
use seabearing_core::wire::{Bearing, Decoder, Message, Track};
use std::io::Write;
use std::path::Path;

/// Samples simulated at a time: a quarter of a second.
const CHUNK: usize = 16_000;
/// Seconds between lines.
const LINE_S: f64 = 10.0;
/// What the demonstration's pass must reach: seconds, degrees, share of the range.
const BAR: (f64, f64, f64) = (2.0, 1.0, 0.03);

/// What was received so far.
struct Received {
    decoder: Decoder,
    rate_hz: f64,
    truth: Vec<Truth>,
    bearings: Vec<Bearing>,
    tracks: Vec<Track>,
    shown_s: f64,
}

/// Runs the demonstration; with no emulator the host's twin takes the firmware's place.
///
/// # Errors
/// Something cannot run, or the pass was not tracked as well as it must be.
pub fn run(scenario_path: &Path, out: &Path, emulator: Option<&Emulator>) -> Result<()> {
    let scenario = ArrayScenario::read(scenario_path)?;
    let rate_hz = scenario.station.config.rate_hz;
    let truths = Truth::of(&CsvTable::parse(&truth::csv(&scenario)?, "truth.csv")?)?;
    let (_, truth) = truths.into_iter().next().context("the scenario has no vessel to follow")?;
    let blob = blob::of(&scenario.station)?;
    let mut received = Received {
        decoder: Decoder::default(),
        rate_hz,
        truth,
        bearings: Vec::new(),
        tracks: Vec::new(),
        shown_s: -LINE_S,
    };
    println!("   time  azimuth  (truth)   | closest approach: time (truth)  range (truth)  heading (truth)");
    let feed = |out: &mut dyn Write| simulate(&scenario, out);
    match emulator {
        Some(emulator) => {
            emulator.run(&blob, feed, |bytes, _| received.hear(bytes))?;
        }
        None => {
            twin::host(&blob, SamplePath::File, feed, |bytes| received.hear(bytes))?;
        }
    }
    received.draw(out)?;
    received.conclude()
}

/// The scenario's samples as an `.sbraw` stream.
fn simulate(scenario: &ArrayScenario, out: &mut dyn Write) -> Result<()> {
    let mut array = SimulatedArray::new(scenario)?;
    out.write_all(&sbraw::MAGIC)?;
    let mut first_index = 0;
    loop {
        let frames: Vec<Frame> = array.by_ref().take(CHUNK).collect();
        if frames.is_empty() {
            return Ok(());
        }
        twin::write_block(out, Block { first_index, frames: &frames })?;
        first_index += frames.len() as u64;
    }
}

impl Received {
    fn hear(&mut self, bytes: &[u8]) -> Result<()> {
        for byte in bytes {
            match self.decoder.push(*byte).map(|r| r.message) {
                Some(Message::Bearing(bearing)) => {
                    self.bearings.push(bearing);
                    self.show(&bearing);
                }
                Some(Message::Track(track)) => self.tracks.push(track),
                Some(Message::Hello(hello)) => {
                    println!(
                        "hello from station {}, configuration {:016x}",
                        hello.station, hello.config_hash
                    );
                }
                Some(Message::Fault(fault)) => println!("fault {:?}: {}", fault.code, fault.value),
                _ => {}
            }
        }
        Ok(())
    }

    /// One line for every [`LINE_S`]: the bearing and the track as known then, with the truth.
    fn show(&mut self, bearing: &Bearing) {
        let t_s = bearing.index as f64 / self.rate_hz;
        if t_s < self.shown_s + LINE_S {
            return;
        }
        self.shown_s = (t_s / LINE_S).floor() * LINE_S;
        let truth = self.truth[0];
        let arrives_deg = Truth::azimuth_at(&self.truth, t_s).unwrap_or(f64::NAN);
        let azimuth = f64::from(bearing.azimuth).to_degrees();
        print!("{t_s:6.1} s  {azimuth:6.2}°  ({arrives_deg:6.2}°)");
        match self.tracks.last() {
            Some(track) => println!(
                "  | {:6.1} ± {:4.1} s ({:5.1})  {} ({:3.0})  {} ({:4.1})",
                track.cpa_time_s,
                track.sd_cpa_time_s,
                truth.cpa_time_s,
                if track.range_observable {
                    format!("{:5.0} ± {:3.0} m", track.cpa_range_m, track.sd_cpa_range_m)
                } else {
                    "range unknown".to_owned()
                },
                truth.cpa_range_m,
                if track.sd_heading.is_finite() {
                    format!("{:5.1} ± {:4.1}°", track.heading.to_degrees(), track.sd_heading.to_degrees())
                } else {
                    "heading unknown".to_owned()
                },
                truth.heading_deg,
            ),
            None => println!("  | no track yet"),
        }
    }

    fn draw(&self, out: &Path) -> Result<()> {
        let truth: Vec<_> = self.truth.iter().map(|t| (t.t_s, t.arrival_azimuth_deg)).collect();
        let time = |b: &Bearing| b.index as f64 / self.rate_hz;
        let measured: Vec<_> =
            self.bearings.iter().map(|b| (time(b), f64::from(b.azimuth).to_degrees())).collect();
        let mut bearing = Plot::new("Bearing of the passing vessel", "time (s)", "azimuth (°)");
        bearing.y_scale(Scale::Degrees);
        bearing.points("firmware", &measured);
        bearing.truth("truth (at the hydrophones)", &cut_at_wraps(&truth));
        let mut error = Plot::new("Its error", "time (s)", "error (°)");
        let spread = |b: &Bearing| 1.96 * f64::from(b.var_azimuth).sqrt().to_degrees();
        let band: Vec<_> = self.bearings.iter().map(|b| (time(b), -spread(b), spread(b))).collect();
        let errors: Vec<_> = self
            .bearings
            .iter()
            .filter_map(|b| Some((b, Truth::azimuth_at(&self.truth, time(b))?)))
            .map(|(b, truth_deg)| (time(b), turn_deg(truth_deg, f64::from(b.azimuth).to_degrees())))
            .collect();
        error.band("95 % as reported", &band).points("firmware", &errors);
        error.same_colour();
        bearing.caption("Azimuth of each bearing that the firmware sent, degrees clockwise from true North, and the truth of the simulation.");
        error.caption("Azimuth sent less the truth. Shaded: the 95 % interval that the firmware states.");
        write_panels(&out.join("bearing.svg"), &[&bearing, &error], 1)?;

        let mut map = Plot::map("Track as the firmware followed it");
        let path: Vec<_> = self.truth.iter().map(|t| (t.x_m, t.y_m)).collect();
        map.truth("truth", &path);
        let place = |t: &Track| (f64::from(t.x_m), f64::from(t.y_m));
        let mut seen = self.tracks.iter().filter(|t| t.range_observable && t.stage == 0);
        let running: Vec<_> = seen.clone().map(place).collect();
        map.points("running estimate", &running);
        if let Some(track) = seen.next_back().or(self.tracks.last()) {
            let variances =
                (f64::from(track.var_x_m2), f64::from(track.var_y_m2), f64::from(track.cov_xy_m2));
            map.ellipse("95 % of the last", place(track), variances, 0.95);
        }
        map.caption(
            "Points: places of the vessel as the firmware sent them during the pass; the ellipse holds the last with 95 %. Line: the truth. Black triangle: the array.",
        );
        map.write(&out.join("track.svg"))?;
        println!("plots: {} and {}", out.join("bearing.svg").display(), out.join("track.svg").display());
        Ok(())
    }

    /// The summary: errors against truth and whether they are within the bar.
    fn conclude(&self) -> Result<()> {
        let Some(track) = self.tracks.iter().rfind(|t| t.stage == 1).or(self.tracks.last()) else {
            bail!("the vessel was not tracked: {} bearings and no track", self.bearings.len());
        };
        let truth = self.truth[0];
        let time_s = track.cpa_time_s - truth.cpa_time_s;
        let heading_deg = turn_deg(truth.heading_deg, f64::from(track.heading).to_degrees());
        let range = f64::from(track.cpa_range_m) / truth.cpa_range_m - 1.0;
        let verdict = |ok: bool| if ok { "within" } else { "MISSED" };
        let good = [time_s.abs() <= BAR.0, heading_deg.abs() <= BAR.1, range.abs() <= BAR.2];
        println!("{} bearings; errors of the track at the end of the passage:", self.bearings.len());
        println!("  closest approach  {time_s:+.2} s (bar {} s: {})", BAR.0, verdict(good[0]));
        println!("  heading           {heading_deg:+.2}° (bar {}°: {})", BAR.1, verdict(good[1]));
        println!(
            "  range there       {:+.2} % (bar {} %: {})",
            range * 100.0,
            BAR.2 * 100.0,
            verdict(good[2])
        );
        if good.iter().all(|g| *g) { Ok(()) } else { bail!("the pass was not tracked within the bars above") }
    }
}
