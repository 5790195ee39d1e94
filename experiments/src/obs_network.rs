//! Two ocean-bottom stations fused: one vessel's motion from the azimuth and range records of both, as `locate --motion` finds it.
//!
//! The stations lie 25 km apart; the seeded vessels of `obs-one-ship` pass the first, and the second hears the same vessel. Records are
//! written as files of each station and read back. Beside the fused motion stands what each station's own final track says of the same
//! vessel. The deviation of the place is judged at the vessel's closest time to the first station.

use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, Side, Straight, default_start};
use crate::orientation::network_file::Network;
use crate::orientation::over_time::motion;
use crate::orientation::record_file;
use anyhow::{Context, Result};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::utc::Times;
use seabearing_host::record::RecordFormat;
use std::fmt::Write as _;

/// The experiment.
pub const NETWORK: Experiment = Experiment {
    name: "obs-network",
    about: "two ocean-bottom stations: one vessel's motion fused from both stations' azimuths and ranges",
    run,
};

/// Vessels where the command line names no number.
const RUNS: usize = 4;

/// The second station from the first, East and North, m.
const SECOND_M: (f64, f64) = (20_000.0, 15_000.0);

/// Standard deviation joined to azimuths, degrees: the orientation told is right here.
const SIGMA_DEG: f64 = 0.3;

/// The same vessel as it passes a station elsewhere.
fn seen_from(s: &Straight, (x, y): (f64, f64)) -> Straight {
    let course = VesselCourse::straight(s);
    let at = |t: f64| course.at(t).map_or((0.0, 0.0), |p| (p.0 - x, p.1 - y));
    let (a, b) = (at(s.cpa_time_s), at(s.cpa_time_s + 1.0));
    let v = (b.0 - a.0, b.1 - a.1);
    let later = -(a.0 * v.0 + a.1 * v.1) / (v.0 * v.0 + v.1 * v.1);
    let closest = (a.0 + later * v.0, a.1 + later * v.1);
    let of = |side| Straight {
        cpa_time_s: s.cpa_time_s + later,
        cpa_range_m: closest.0.hypot(closest.1),
        side,
        ..*s
    };
    let misses = |side: &Side| {
        let there = VesselCourse::straight(&of(*side)).at(s.cpa_time_s).unwrap_or_default();
        (there.0 - a.0).hypot(there.1 - a.1)
    };
    let sides = [Side::Port, Side::Starboard];
    let side = if misses(&sides[0]) < misses(&sides[1]) { sides[0] } else { sides[1] };
    of(side)
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let folder = options.out.join("obs-network");
    std::fs::create_dir_all(&folder)?;
    let mut stations = String::new();
    for (i, (x, y)) in [(0.0, 0.0), SECOND_M].into_iter().enumerate() {
        write!(
            stations,
            "[[stations]]\nid = {}\nname = \"obs{i}\"\nsound_speed_m_s = 1500.0\norientation_sd_deg = 0.1\n\
             clock_sd_s = 0.1\n[stations.position]\nlocal_m = [{x:.1}, {y:.1}, {:.1}]\n\n",
            i + 1,
            -table.depth_m
        )?;
    }
    let path = folder.join("network.toml");
    std::fs::write(&path, stations)?;
    let network = Network::read(&path)?;
    let format = RecordFormat { rate_hz: 50.0, start: Some(default_start()), times: Times::default() };
    let mut csv = CsvText::new(
        "seed,rows,place_error_m,sd_place_m,heading_deg,speed_m_s,own_cpa_range_m,own_heading_deg,own_speed_m_s",
    );
    let (mut worst, mut inside, mut vessels) = ([0.0f64; 3], 0u32, 0u32);
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let ship = super::obs_one_ship::ship(seed);
        let mut files = Vec::new();
        let mut own = None;
        for (i, place) in [(0.0, 0.0), SECOND_M].into_iter().enumerate() {
            let mut heard = ship.clone();
            heard.straight = seen_from(&ship.straight, place);
            let scenario =
                ObsScenario { vessels: vec![heard], ..quiet(seed.wrapping_mul(7) + i as u64, 21_600.0) };
            let case = Case::run(scenario, &table, Vec::new())?;
            own = own.or_else(|| case.final_track(0));
            let mut text = String::new();
            for m in &case.messages {
                let mut record = format.json(m);
                record["station"] = (i + 1).into();
                writeln!(text, "{record}")?;
            }
            let file = folder.join(format!("{seed}-{i}.jsonl"));
            std::fs::write(&file, text)?;
            files.push(file);
        }
        let sd = (SIGMA_DEG * RAD_PER_DEG, SIGMA_DEG * RAD_PER_DEG);
        let mut heard = record_file::read(&files, &network, sd, false)?;
        let rows = heard.rows.len();
        let found = motion(&network, &mut heard, 180.0, 5.0, true).context("the two stations' records")?;
        let course = VesselCourse::straight(&ship.straight);
        let t = ship.straight.cpa_time_s;
        let truth = course.at(t).unwrap_or_default();
        // Times are from sample 0 of the recording that began first.
        let begins_s = heard.start.map_or(0.0, |s| (s - default_start()).as_seconds_f64());
        let place = found.position_m(t - begins_s);
        let off = [place[0] - truth.0, place[1] - truth.1];
        let error = off[0].hypot(off[1]);
        let dt = t - begins_s - found.t_ref_s;
        let c = &found.covariance;
        let of = |i: usize, k: usize| c[i][k] + dt * (c[i + 2][k] + c[i][k + 2]) + dt * dt * c[i + 2][k + 2];
        let (a, b, d) = (of(0, 0), of(0, 1), of(1, 1));
        let square =
            (d * off[0] * off[0] - 2.0 * b * off[0] * off[1] + a * off[1] * off[1]) / (a * d - b * b);
        let heading = wrap_pi(found.heading().0 - ship.straight.heading_deg.to_radians()).to_degrees();
        let speed = found.speed_m_s().0 - ship.straight.speed_m_s;
        let cells = own.map_or([f64::NAN; 3], |e| [e.cpa_range_m, e.heading.to_degrees(), e.speed_m_s]);
        csv.row(&[
            &seed,
            &rows,
            &Fixed(error, 0),
            &Fixed((a + d).sqrt(), 0),
            &Fixed(heading, 2),
            &Fixed(speed, 3),
            &Fixed(cells[0], 0),
            &Fixed(cells[1], 2),
            &Fixed(cells[2], 3),
        ]);
        vessels += 1;
        // 95 % of two degrees of freedom.
        inside += u32::from(square < 5.991);
        for (w, x) in worst.iter_mut().zip([error, heading.abs(), speed.abs()]) {
            *w = w.max(x);
        }
    }
    print(options, "obs-network", csv)?;
    let figures = &options.figures;
    figures.at_most("fused place at the closest time, worst error, m", worst[0], 150.0);
    figures.at_most("heading, worst error, deg", worst[1], 0.5);
    figures.at_most("speed, worst error, m/s", worst[2], 0.05);
    figures.state(
        "places in their 95 %, of all vessels, %",
        100.0 * f64::from(inside) / f64::from(vessels.max(1)),
    );
    Ok(())
}
