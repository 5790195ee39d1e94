//! A year of an ocean-bottom recorder, accelerated: the board's logic as it stands in the image, with resets, watchdog resets, loss
//! of power, clocks that drift with the water's temperature, outages of converters and lines, commands and configurations.
//!
//! What is computed and what is not: of each day eight parts of three minutes, at full length (one part in 60). Between them
//! only time goes on, and with it the clocks, the converter's edges and what is out of order: the loop finds itself asleep for
//! nearly three hours, which it tells as a gap of the right length. All that happens begins in a part that is computed. The
//! sound is noise. Registers are missing: those are the emulator's.

mod base;
mod board;
mod world;

use super::{Experiment, Options};
use crate::ocean_bottom::table;
use crate::propagation::{bottom::Bottom, profile, trace};
use anyhow::{Context, Result, anyhow};
use base::Base;
use board::Shared;
use seabearing_core::config::StationConfig;
use seabearing_core::config_blob::{BlobError, PROPAGATION, Writer};
use seabearing_firmware::seismic::Conversion;
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::rc::Rc;
use world::{DAY_US, PART_US, PARTS, Reset, World};

/// `seabearing reproduce obs-year`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "obs-year",
    about: "a year of an ocean-bottom recorder's board logic, accelerated: resets, power, drift, outages, wear; --runs: days, 365 \
            asked for",
    run,
};

const DAYS: usize = 365;
/// What the processor's flash bears, by its data sheet (from memory).
const ERASES_BORNE: f64 = 10_000.0;
/// Most of their standard deviations that a time may be off: of some 30 000 the worst of a normal distribution is four.
const MOST_SD: f64 = 6.0;
/// Least share of times within two of their standard deviations.
const WITHIN: f64 = 0.95;

/// The station's configuration, its table traced through a subtropical profile.
fn blob() -> Result<Vec<u8>> {
    const STATION: &str = "[station]\nid = 1\nname = \"year\"\nkind = \"obs\"\n[sampling]\nrate_hz = 50.0\n[obs]\n\
                           propagation = \"year.toml\"\n";
    let station = crate::station::Station::parse(STATION, "year", std::path::Path::new("."))?;
    let profile = profile::SpeedProfile::subtropical(4340.0)?;
    let traced = trace::trace("subtropical", &profile, &Bottom::default(), 70.0, 720, || ());
    let table = table::blob(&traced, "the traced table", station.config.rate_hz)?;
    let mut into = vec![0; table.len() + 4096];
    let length = write(&mut into, &station.config, &table).map_err(|e| anyhow!("{e:?}"))?;
    into.truncate(length);
    Ok(into)
}

fn write(into: &mut [u8], config: &StationConfig, table: &[u8]) -> Result<usize, BlobError> {
    let mut writer = Writer::new(into)?;
    writer.station(config)?;
    writer.section(PROPAGATION, |body| {
        body.get_mut(..table.len())?.copy_from_slice(table);
        Some(table.len())
    })?;
    Ok(writer.finish())
}

fn run(options: &Options) -> Result<()> {
    let days = options.runs.unwrap_or(DAYS);
    let blob = blob()?;
    let conversion = Conversion::of(50.0).context("50 Hz")?;
    let world: Shared = Rc::new(RefCell::new(World::new(options.seed, days)));
    let mut base = Base::new(blob.clone());
    while !world.borrow().over() {
        let ended =
            catch_unwind(AssertUnwindSafe(|| board::boot(&world, &blob, &mut |world| base.look(world))));
        if let Err(reason) = ended
            && !reason.is::<Reset>()
        {
            // A fault of the software's own.
            resume_unwind(reason);
        }
    }
    let world = world.borrow();
    let figures = &options.figures;
    let counts = &world.counts;
    figures.state("days", days as f64);
    let computed = world.computed_us as f64 / world.now_us as f64;
    figures.state("share of the time that was computed", computed);
    figures.state("starts", world.boots.len() as f64);
    figures.state("resets of all kinds", f64::from(counts.resets));
    figures.state("of those by the watchdog", f64::from(counts.watchdog));
    figures.state("of those by hard faults and panics", f64::from(counts.faults));
    figures.state("of those by power cut in a write of the flash", f64::from(counts.cuts));
    figures.state("outages and resets of the converters", f64::from(counts.outages));
    figures.at_most(
        "parts of days with the line up in which nothing was heard (stuck)",
        f64::from(base.stuck),
        0.0,
    );
    figures.at_most(
        "parts of days undisturbed to their end in which nothing was recorded",
        f64::from(world.idle),
        0.0,
    );
    figures.state("parts of days", f64::from(base.parts));
    let desk = &base.desk;
    figures.state("records that came", desk.records.len() as f64);
    figures.at_most("records missing, twice or out of order", f64::from(base::missing(desk)), 0.0);
    figures.at_most("records that the recorder counted lost", f64::from(desk.lost), 0.0);
    figures.at_most("records that cannot be read", f64::from(desk.undecodable), 0.0);
    figures.at_least(
        "commands answered, of all but those to a line that is down",
        f64::from(desk.answered) / f64::from(counts.commands.max(1)),
        1.0,
    );
    figures.at_least(
        "configurations taken, of those sent",
        f64::from(desk.taken) / f64::from(counts.configurations.max(1)),
        if counts.configurations > 0 { 1.0 } else { 0.0 },
    );
    let (errors, worst_s, unknown) = base::times(desk, &world, conversion);
    let within = errors.iter().filter(|z| z.abs() <= 2.0).count() as f64 / errors.len().max(1) as f64;
    figures.state("records with UTC", errors.len() as f64);
    figures.state("records before UTC was known", unknown as f64);
    figures.at_least(
        "share of times within two stated standard deviations (and a microsecond)",
        within,
        WITHIN,
    );
    figures.state("largest error of a time, s", worst_s);
    let worst = errors.iter().fold(0f64, |most, z| most.max(z.abs()));
    figures.at_most("largest error of a time, in its stated standard deviations", worst, MOST_SD);
    let misuses = world.records.borrow().misuses() + world.places.borrow().misuses();
    figures.at_most("times a word was written twice, or a busy flash used", f64::from(misuses), 0.0);
    let erases = |all: &[u32]| f64::from(all.iter().max().copied().unwrap_or(0));
    let (records, places) = (erases(world.records.borrow().erases()), erases(world.places.borrow().erases()));
    figures.state("erases of the records' sector erased most", records);
    figures.state("erases of the configurations' sector erased most", places);
    // All of a day's records would have been so many more.
    let scaled = records / (PARTS as f64 * PART_US as f64 / DAY_US as f64);
    figures.at_most("erases of the records' sector erased most, of whole days", scaled, ERASES_BORNE);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::Figures;

    /// A whole recorder with its store stands on the stack, which a test's thread has too little of where nothing is
    /// optimised.
    const STACK_BYTES: usize = 16 << 20;

    #[test]
    fn two_weeks_leave_nothing_stuck_lost_or_told_at_a_wrong_time() {
        let run = std::thread::Builder::new().stack_size(STACK_BYTES).spawn(two_weeks).unwrap();
        run.join().unwrap();
    }

    fn two_weeks() {
        let options = Options {
            out: std::env::temp_dir(),
            runs: Some(14),
            seed: 7,
            json: true,
            data: std::env::temp_dir(),
            plots: None,
            figures: Figures::new(EXPERIMENT.name),
        };
        run(&options).unwrap();
        let figures = options.figures.into_reported();
        let value = |name: &str| figures.iter().find(|f| f.name.starts_with(name)).and_then(|f| f.value);
        assert!(value("resets of all kinds") > Some(15.0) && value("records that came") > Some(2000.0));
        let missed: Vec<&str> =
            figures.iter().filter(|f| f.met() == Some(false)).map(|f| f.name.as_str()).collect();
        assert!(missed.is_empty(), "{missed:?}");
    }
}
