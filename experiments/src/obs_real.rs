//! What an ocean-bottom station makes of a real record: nothing that is false.
//!
//! The one real record at hand is a minute of one hydrophone (network 1T, off Mayotte, 125 Hz), without a vessel: no azimuth, no range, no
//! track and no call may be told of it, and what is missing must be said. It stands beside the project, not in it; without it the experiment
//! says so and ends. Earthquakes and T phases are simulated in `obs-noise-week`.

use super::obs_world::station_table;
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::ocean_bottom::run;
use crate::recording;
use crate::station::Station;
use anyhow::Result;
use seabearing_core::wire::Message;
use std::path::Path;

/// The experiment.
pub const REAL: Experiment = Experiment {
    name: "obs-real",
    about: "a minute of a real ocean-bottom hydrophone: nothing is told of it but what is missing",
    run,
};

/// Where the record is.
const RECORD: &str = "real/hydrophone_mseed_1T_MONN/1T_MONN_00_EDH.mseed";

/// The station: motion is not among what was recorded.
const STATION: &str = "[station]\nkind = \"obs\"\n[sampling]\nrate_hz = 125\n[obs]\n\
                       components = { pressure = \"EDH\", north = \"EH1\", east = \"EH2\", vertical = \"EHZ\" }\n";

fn run(options: &Options) -> Result<()> {
    let Some(record) = options.real(RECORD) else { return Ok(()) };
    let station = Station::parse(STATION, "obs-real", Path::new("."))?;
    let mut source = recording::open(&[record], &station, None)?;
    let (mut azimuths, mut ranges, mut tracks, mut faults) = (0u32, 0u32, 0u32, 0u32);
    run::run(&station.config, &station_table(options)?, source.as_mut(), &mut |message| match message {
        Message::Azimuth(a) => azimuths += u32::from(a.detected),
        Message::Range(r) => ranges += u32::from(r.detected),
        Message::Track(_) => tracks += 1,
        Message::Fault(_) => faults += 1,
        _ => {}
    })?;
    let mut report = CsvReport::new("obs_real", "azimuths,ranges,tracks,faults");
    report.row(&[azimuths, ranges, tracks, faults].map(f64::from));
    report.finish(options)?;
    options.figures.at_most("azimuths told of a record without motion", f64::from(azimuths), 0.0);
    options.figures.at_most("ranges told as detected", f64::from(ranges), 0.0);
    options.figures.at_most("tracks", f64::from(tracks), 0.0);
    options.figures.at_least("faults that say what is missing", f64::from(faults), 1.0);
    Ok(())
}
