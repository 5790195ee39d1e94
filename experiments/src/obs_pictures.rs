//! The ocean-bottom paper's pictures (figures 2, 3, 5 to 8) of one simulated vessel with whales about.

use super::obs_world::{Case, named, quiet, station_table};
use super::{Experiment, Options};
use crate::ocean_bottom::pictures::{TruthCurve, draw, model};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight, Whale};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::station;
use crate::score::then;
use crate::station::Calibration;
use anyhow::Result;

/// The experiment.
pub const PICTURES: Experiment = Experiment {
    name: "obs-pictures",
    about: "the ocean-bottom paper's figures 2, 3 and 5 to 8 on a simulated half day",
    run,
};

fn scenario(seed: u64) -> ObsScenario {
    let radiation = Radiation { blade_hz: 5.4, tones_hz: vec![12.6, 17.9, 20.7], ..Radiation::default() };
    let vessel = ObsVessel {
        name: "truth".into(),
        straight: Straight {
            cpa_time_s: 16_000.0,
            cpa_range_m: 9_000.0,
            heading_deg: 55.0,
            speed_m_s: 8.2,
            side: Side::Port,
        },
        active_s: [-1e9, 1e9],
        radiation,
    };
    let whale = Whale {
        azimuth_deg: 140.0,
        range_m: 6_000.0,
        start_s: 28_000.0,
        duration_s: 7_000.0,
        interval_s: 13.2,
        level_db: 18.0,
    };
    ObsScenario { vessels: vec![vessel], fin_whale: vec![whale], ..quiet(seed, 36_000.0) }
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let case = Case::run(scenario(options.seed), &table, Vec::new())?;
    let truth: Vec<TruthCurve> = case
        .vessels
        .iter()
        .map(|v| {
            let times = (0..600).map(|m| 60.0 * f64::from(m));
            let heard = times.clone().filter_map(|t| {
                let h = then(&table, 5, v, t)?;
                Some((t, h.azimuth, h.range_m))
            });
            TruthCurve {
                name: v.name.clone(),
                heard: heard.collect(),
                places: times.filter_map(|t| v.course.at(t)).collect(),
            }
        })
        .collect();
    let config = station::config(&scenario(options.seed))?;
    let mut again = Simulator::new(scenario(options.seed), table.clone(), Vec::new())?;
    let dir = options.out.join("obs-pictures");
    let mut written =
        draw(&dir, &mut again, &config, &table, &Calibration::default(), &case.messages, &truth)?;
    written.push(dir.join("model.svg"));
    model(&dir.join("model.svg"), &table)?;
    named(options, &written);
    Ok(())
}
