//! Fin whales and Antarctic blue whales at 3 to 20 km, half an hour of calls each: azimuth and range of every three or six minutes with notes, by the delays of their
//! arrivals; and half an hour of sea, earthquakes and a passing ship, in which nothing may be ranged as a whale.
//!
//! Levels are 6 to 24 dB (peak of the strongest arrival over the sea's root mean square), as in `obs-noise-week`. `--runs` is the number of
//! whales.

use super::figure::Bar;
use super::obs_world::{print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::caller_ways::ways;
use crate::ocean_bottom::calls::{WhaleCall, calls};
use crate::ocean_bottom::notes::{BLUE, FIN, Kind};
use crate::ocean_bottom::scenario::{Burst, ObsScenario, Whale};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::station;
use crate::propagation::Propagation;
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::angle::wrap_pi;

/// The experiment.
pub const WHALES: Experiment = Experiment {
    name: "obs-whales",
    about: "fin and blue whales at 3 to 20 km: azimuth and range of their calls by the delays of their arrivals",
    run,
};

/// Whales of each kind where the command line names no number.
const RUNS: usize = 12;

/// Length of a record, s.
const RECORD_S: f64 = 1_800.0;

fn heard(scenario: ObsScenario, table: &Propagation) -> Result<Vec<WhaleCall>> {
    let config = station::config(&scenario)?;
    let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
    Ok(calls(&mut simulator, &config, table)?.calls)
}

/// What became of the calls of one kind.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    windows: usize,
    ranged: usize,
    right: usize,
    wrong: usize,
    inside: usize,
    azimuths: usize,
    azimuths_inside: usize,
}

/// A kind of whale: least and greatest interval of its calls, s, and where it stands in a scenario.
struct Species {
    kind: Kind,
    interval_s: (f64, f64),
    scenario: fn(Whale, ObsScenario) -> ObsScenario,
}

const SPECIES: [Species; 2] = [
    Species {
        kind: FIN,
        interval_s: (11.0, 28.0),
        scenario: |whale, sea| ObsScenario { fin_whale: vec![whale], ..sea },
    },
    Species {
        kind: BLUE,
        interval_s: (55.0, 75.0),
        scenario: |whale, sea| ObsScenario { blue_whale: vec![whale], ..sea },
    },
];

impl Tally {
    fn state(&self, species: &Species, options: &Options) {
        let name = species.kind.name;
        let percent = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
        let figures = &options.figures;
        figures.at_least(
            format!("{name}: calls ranged within 10 %, of all calls heard, %"),
            percent(self.right, self.windows),
            50.0,
        );
        figures.at_most(
            format!("{name}: ranges wrong by more than 50 %, of 20"),
            20.0 * self.wrong as f64 / self.ranged.max(1) as f64,
            0.0,
        );
        let right = Bar::Within(92.0, 97.0);
        figures.report(format!("{name}: ranges in their 95 %, %"), percent(self.inside, self.ranged), right);
        figures.report(
            format!("{name}: azimuths in their 95 %, %"),
            percent(self.azimuths_inside, self.azimuths),
            right,
        );
        figures.state(
            format!("{name}: calls ranged, of all calls heard, %"),
            percent(self.ranged, self.windows),
        );
    }
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let mut csv = CsvText::new(
        "kind,whale,range_m,level_db,interval_s,windows,other_kinds,ranged,right,wrong,median_error_pct,in_95,azimuth_rms_deg,ways,way_error_m",
    );
    let mut tallies = [Tally::default(); SPECIES.len()];
    let mut others = 0;
    for (species, tally) in SPECIES.iter().zip(&mut tallies) {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        for k in 0..options.runs.unwrap_or(RUNS) {
            let whale = Whale {
                azimuth_deg: rng.random_range(0.0..360.0),
                range_m: rng.random_range(3_000.0..20_000.0),
                start_s: -120.0,
                duration_s: RECORD_S + 240.0,
                interval_s: rng.random_range(species.interval_s.0..species.interval_s.1),
                level_db: rng.random_range(6.0..24.0),
            };
            let seed = options.seed.wrapping_mul(1009) + k as u64;
            let all = heard((species.scenario)(whale.clone(), quiet(seed, RECORD_S)), &table)?;
            let (found, other): (Vec<WhaleCall>, Vec<WhaleCall>) =
                all.into_iter().partition(|c| c.kind == species.kind.name);
            others += other.len();
            let ranges: Vec<_> = found.iter().filter_map(|c| c.range).collect();
            let off = |r: f64| (r / whale.range_m - 1.0).abs();
            let good = ranges.iter().filter(|r| off(r.range_m) <= 0.1).count();
            let bad = ranges.iter().filter(|r| off(r.range_m) > 0.5).count();
            let held = ranges.iter().filter(|r| (r.range_m - whale.range_m).abs() <= 1.96 * r.sd_m).count();
            let errors: Vec<(f64, f64)> = found
                .iter()
                .filter_map(|c| c.azimuth)
                .map(|(a, sd)| (wrap_pi(a - whale.azimuth_deg.to_radians()), sd))
                .collect();
            tally.azimuths += errors.len();
            tally.azimuths_inside += errors.iter().filter(|(e, sd)| e.abs() <= 1.96 * sd).count();
            let ways = ways(&found);
            let (sin, cos) = whale.azimuth_deg.to_radians().sin_cos();
            let way_error = ways.first().map_or(f64::NAN, |w| {
                (w.place_m.0 - whale.range_m * sin).hypot(w.place_m.1 - whale.range_m * cos)
            });
            csv.row(&[
                &species.kind.name,
                &k,
                &Fixed(whale.range_m, 0),
                &Fixed(whale.level_db, 1),
                &Fixed(whale.interval_s, 1),
                &found.len(),
                &other.len(),
                &ranges.len(),
                &good,
                &bad,
                &Fixed(100.0 * super::score::median(ranges.iter().map(|r| off(r.range_m)).collect()), 2),
                &held,
                &Fixed(super::score::rms(errors.iter().map(|e| e.0)).to_degrees(), 2),
                &ways.len(),
                &Fixed(way_error, 0),
            ]);
            tally.windows += found.len();
            tally.ranged += ranges.len();
            tally.right += good;
            tally.wrong += bad;
            tally.inside += held;
        }
    }
    print(options, "obs-whales", csv)?;
    // What is no whale's.
    let burst =
        |azimuth_deg, start_s, duration_s, level_db| Burst { azimuth_deg, start_s, duration_s, level_db };
    let sounds = ObsScenario {
        vessels: vec![super::obs_one_ship::ship(options.seed)],
        earthquake: vec![burst(40.0, 300.0, 60.0, 25.0), burst(130.0, 900.0, 200.0, 35.0)],
        t_phase: vec![burst(250.0, 1_200.0, 300.0, 12.0)],
        ..quiet(options.seed, 10_800.0)
    };
    let nobody = heard(sounds, &table)?.iter().filter(|c| c.range.is_some()).count();
    for (species, tally) in SPECIES.iter().zip(&tallies) {
        tally.state(species, options);
    }
    let figures = &options.figures;
    figures.at_most("calls taken for the other kind's", others as f64, 0.0);
    figures.at_most(
        "ranges of no whale in three hours with a ship, earthquakes and a T phase",
        nobody as f64,
        0.0,
    );
    Ok(())
}
