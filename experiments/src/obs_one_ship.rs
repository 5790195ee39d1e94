//! One vessel, six hours: azimuth, range, wrong branches and track of the whole chain against the bars.
//!
//! Closest point 5 to 15 km, 4 to 10 m/s, wideband noise at 0 dB and six lines at +20 dB at 20 km (what that means
//! stands in [`crate::ocean_bottom::scenario`]), five paths, no fade. One seed a vessel. Each record is heard three times, by the
//! station's own choices and by those of the paper's authors' programme and of its text (`compatibility`), whose figures stand
//! beside without a bar.

use super::obs_world::{Case, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Side, Straight};
use crate::ocean_bottom::station;
use crate::propagation::Propagation;
use crate::score::{Detections, smad, track};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::config::{Compatibility, Kind};
use seabearing_core::wire::Message;

/// The experiment.
pub const ONE_SHIP: Experiment = Experiment {
    name: "obs-one-ship",
    about: "one vessel past an ocean-bottom station, six hours: every error against its bar",
    run,
};

/// Vessels where the command line names no number.
const RUNS: usize = 4;

/// One seeded vessel of the figure.
pub fn ship(seed: u64) -> ObsVessel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    ObsVessel {
        name: format!("seed-{seed}"),
        straight: Straight {
            cpa_time_s: 10_800.0 + rng.random_range(-900.0..900.0),
            cpa_range_m: rng.random_range(5_000.0..15_000.0),
            heading_deg: rng.random_range(0.0..360.0),
            speed_m_s: rng.random_range(4.0..10.0),
            side: if rng.random() { Side::Starboard } else { Side::Port },
        },
        active_s: [-1e9, 1e9],
        radiation: Default::default(),
    }
}

/// Records heard by one set of choices, and the worst errors of their tracks (time, range, heading, speed).
fn listen(
    options: &Options,
    table: &Propagation,
    (choices, compatibility): (&str, Compatibility),
    rows: &mut CsvText,
) -> Result<(Detections, [f64; 4])> {
    let (mut all, mut worst) = (Detections::default(), [0.0f64; 4]);
    for seed in (0..options.runs.unwrap_or(RUNS) as u64).map(|i| options.seed + i) {
        let ship = ship(seed);
        let scenario = ObsScenario { vessels: vec![ship.clone()], ..super::obs_world::quiet(seed, 21_600.0) };
        let mut config = station::config(&scenario)?;
        if let Kind::Obs(obs) = &mut config.kind {
            obs.compatibility = compatibility;
        }
        let case = Case::heard_by(&config, scenario, table, Vec::new())?;
        let d = case.detections().remove(0);
        let tracks: Vec<_> = case
            .messages
            .iter()
            .filter_map(|m| if let Message::Track(t) = m { Some(*t) } else { None })
            .collect();
        let best = tracks.iter().rev().find(|t| t.stage == 1).or(tracks.last());
        let e = best.and_then(|t| track(t, &case.vessels[0].course));
        let cells =
            e.map_or([f64::NAN; 4], |e| [e.cpa_time_s, e.cpa_range_m, e.heading.to_degrees(), e.speed_m_s]);
        rows.row(&[
            &choices,
            &seed,
            &Fixed(ship.straight.cpa_range_m, 0),
            &Fixed(ship.straight.speed_m_s, 2),
            &d.azimuth.len(),
            &d.azimuth_wrong,
            &Fixed(smad(&d.azimuth).to_degrees(), 2),
            &(d.range_m.len() + d.range_wrong),
            &d.range_wrong,
            &Fixed(smad(&d.range_m), 0),
            &Fixed(smad(&d.speed_m_s), 3),
            &Fixed(cells[0], 1),
            &Fixed(cells[1], 0),
            &Fixed(cells[2], 2),
            &Fixed(cells[3], 3),
        ]);
        all.append(&d);
        worst
            .iter_mut()
            .zip(cells)
            .for_each(|(w, c)| *w = if c.is_nan() { f64::INFINITY } else { w.max(c.abs()) });
    }
    Ok((all, worst))
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut rows = CsvText::new(
        "choices,seed,cpa_range_m,speed_m_s,azimuth_n,azimuth_wrong,azimuth_smad_deg,range_n,wrong_branch,range_smad_m,\
         speed_smad_m_s,track_cpa_time_s,track_cpa_range_m,track_heading_deg,track_speed_m_s",
    );
    let (own, worst) = listen(options, &table, ("own", Compatibility::None), &mut rows)?;
    let (programme, _) = listen(options, &table, ("programme", Compatibility::Programme), &mut rows)?;
    let (paper, _) = listen(options, &table, ("paper", Compatibility::Paper), &mut rows)?;
    super::obs_world::print(options, "obs-one-ship", rows)?;
    let figures = |d: &Detections| {
        [
            ("azimuth SMAD, deg", smad(&d.azimuth).to_degrees(), 1.5),
            ("azimuths wrong", d.azimuth_wrong as f64, 0.0),
            ("range SMAD, m", smad(&d.range_m), 160.0),
            ("wrong branch, %", 100.0 * d.wrong_branch(), 4.0),
        ]
    };
    for (name, value, bar) in figures(&own) {
        options.figures.at_most(name, value, bar);
    }
    let names = ["CPA time, s", "CPA range, m", "heading, deg", "speed, m/s"];
    for ((name, value), bar) in names.iter().zip(worst).zip([10.0, 150.0, 0.5, 0.05]) {
        options.figures.at_most(format!("worst track: {name}"), value, bar);
    }
    for (whose, heard) in [("the programme's", &programme), ("the paper's", &paper)] {
        for (name, value, _) in figures(heard) {
            options.figures.state(format!("by {whose} choices: {name}"), value);
        }
    }
    Ok(())
}
