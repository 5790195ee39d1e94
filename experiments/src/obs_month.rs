//! `reproduce obs-month`: what tracks state is for the ways of all ships, and a week has eleven, of which none or two turn where they are
//! closest. So every straight enough passage of the AIS positions is taken, in pieces of four days (`--runs`: how many of them), with no
//! limit to their number.

use super::figure::Bar;
use super::obs_table1::{RR03_DEG, passes};
use super::obs_week::{DAY_S, Numbers, Stated, minutes, told, tracks, whose};
use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::CsvText;
use crate::ocean_bottom::ais::{passages, read};
use crate::ocean_bottom::scenario::{DirectionalTable, Radiation};
use crate::score::{TrackMiss, track_passed};
use anyhow::{Result, bail};
use rayon::prelude::*;
use seabearing_core::wire::Track;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "obs-month",
    about: "every real ship track of a month past an ocean-bottom station: found, ghosts, truth in what final tracks state",
    run,
};

/// Days simulated at once, and before and after them, in which passages are heard and not counted.
const PIECE_DAYS: f64 = 4.0;
const MARGIN_DAYS: f64 = 0.25;

/// A piece of the month: the ships whose closest point is inside, those found, final tracks of nobody, errors of azimuths and ranges.
#[derive(Default)]
struct Piece {
    ships: usize,
    found: usize,
    ghosts: Vec<Track>,
    numbers: Vec<(Track, TrackMiss)>,
    azimuth: Stated,
    range: Stated,
}

fn run(options: &Options) -> Result<()> {
    let Some(file) = options.real("ais_marine_traffic.csv") else {
        options.figures.state("vessels found, share", None);
        return Ok(());
    };
    let all: Vec<_> = passages(&read(&file)?, RR03_DEG).into_iter().filter(passes).collect();
    let Some((first, last)) = all.first().zip(all.last()) else {
        bail!("{} holds no passage", file.display());
    };
    let begins = (first.cpa_unix_s / DAY_S).floor() * DAY_S;
    let pieces = ((last.cpa_unix_s - begins) / (PIECE_DAYS * DAY_S)) as usize + 1;
    let table = station_table(options)?;
    let heard: Vec<Piece> = (0..options.runs.unwrap_or(pieces).min(pieces))
        .into_par_iter()
        .map(|n| {
            let start = begins + (n as f64 * PIECE_DAYS - MARGIN_DAYS) * DAY_S;
            let days = PIECE_DAYS + 2.0 * MARGIN_DAYS;
            let inside = |t: f64, margin: f64| (margin * DAY_S..(days - margin) * DAY_S).contains(&t);
            let mut scenario = quiet(options.seed + n as u64, days * DAY_S);
            scenario.ambient.directional.push(DirectionalTable { azimuth_deg: 90.0, level_db: -6.0 });
            scenario.start = time::OffsetDateTime::from_unix_timestamp(start as i64)?;
            let there: Vec<_> = all.iter().filter(|p| inside(p.cpa_unix_s - start, 0.0)).collect();
            let extra = there.iter().map(|p| p.extra(start, &Radiation::default())).collect();
            let case = Case::run(scenario, &table, extra)?;
            let counted: Vec<bool> =
                there.iter().map(|p| inside(p.cpa_unix_s - start, MARGIN_DAYS)).collect();
            let finals: Vec<Track> = tracks(&case).filter(|t| t.stage == Track::FINAL).collect();
            let (azimuth, range) = minutes(&case);
            let mut out = Piece {
                azimuth: Stated::sum(&azimuth),
                range: Stated::sum(&range),
                ghosts: finals.iter().filter(|t| whose(t, &case.vessels).is_none()).copied().collect(),
                ..Piece::default()
            };
            for (i, vessel) in case.vessels.iter().enumerate().filter(|(i, _)| counted[*i]) {
                out.ships += 1;
                let own = finals.iter().rfind(|t| whose(t, &case.vessels) == Some(i));
                out.numbers.extend(own.and_then(|t| Some((*t, track_passed(t, &vessel.course)?))));
            }
            out.found = out.numbers.len();
            Ok(out)
        })
        .collect::<Result<_>>()?;
    let mut csv = CsvText::new("piece,ships,found,ghosts,ranges,wrong,azimuths,wrong");
    let mut numbers = Numbers::default();
    for (n, piece) in heard.iter().enumerate() {
        let (azimuth, range) = (piece.azimuth, piece.range);
        piece.numbers.iter().for_each(|(t, e)| numbers.take(t, e));
        csv.row(&[
            &(n + 1),
            &piece.ships,
            &piece.found,
            &piece.ghosts.len(),
            &range.said,
            &range.wrong,
            &azimuth.said,
            &azimuth.wrong,
        ]);
    }
    print(options, "obs-month", csv)?;
    // Their hours are of their piece, in order.
    let ghosts: Vec<&Track> = heard.iter().flat_map(|p| &p.ghosts).collect();
    print(options, "obs-month-ghosts", told(&ghosts))?;
    let sum = |of: fn(&Piece) -> usize| heard.iter().map(of).sum::<usize>() as f64;
    let figures = &options.figures;
    figures.state("vessels", sum(|p| p.ships));
    figures.at_least("vessels found, share", sum(|p| p.found) / sum(|p| p.ships), 1.0);
    figures.at_most("final tracks of nobody", sum(|p| p.ghosts.len()), 0.0);
    let all = |of: fn(&Piece) -> Stated| Stated::sum(&heard.iter().map(of).collect::<Vec<_>>());
    for (name, s) in [("azimuth", all(|p| p.azimuth)), ("range", all(|p| p.range))] {
        let name = format!("truth in the stated 95 %: {name}");
        figures.report(name, s.percent(s.within), Bar::Within(92.0, 97.0));
    }
    numbers.report(options);
    Ok(())
}
