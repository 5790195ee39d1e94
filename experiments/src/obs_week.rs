//! Real ship tracks past an ocean-bottom station over days, at the paper's level and 5 and 10 dB below it.
//!
//! The days with the most closest points are taken from the AIS positions, eleven vessels at most as in Table I of \[O\];
//! where the positions are absent, as many seeded passages with slow bends stand in. Sound is simulated, so the truth is
//! known: vessels found, errors of their final tracks against the way itself at its closest point, finals of nobody, faults
//! named of a station that has none, and how often the truth lies inside what was stated. Ways are smooth through the positions, whose
//! times are whole minutes.
//! `--runs` is the number of days, where not the whole week; `--plots DIR` draws them, tracks over likelihoods and the truth beside them.

use super::figure::Bar;
use super::obs_table1::{RR03_DEG, passes, window};
use super::obs_world::{Case, named, print, quiet, station_table, truth};
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::ais::{passages, read};
use crate::ocean_bottom::scenario::{DirectionalTable, ObsScenario, Radiation};
use crate::ocean_bottom::simulate::{Extra, MovingVessel, Simulator};
use crate::ocean_bottom::{pages, station};
use crate::propagation::Propagation;
use crate::score::{TrackMiss, closest, median, then, track, track_passed};
use anyhow::{Result, bail};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::angle::wrap_pi;
use seabearing_core::wire::{Message, Track};
use std::path::Path;

/// At the level of the paper's Table I.
pub const WEEK: Experiment = Experiment {
    name: "obs-week",
    about: "real ship tracks past an ocean-bottom station (--runs DAYS of the week): found, missed, ghosts, stated errors",
    run: |options| run(options, &LEVELS[0]),
};

/// 5 dB below it.
pub const WEEK_5_DB: Experiment = Experiment {
    name: "obs-week-5db",
    about: "the same ships 5 dB weaker",
    run: |options| run(options, &LEVELS[1]),
};

/// 10 dB below it.
pub const WEEK_10_DB: Experiment = Experiment {
    name: "obs-week-10db",
    about: "the same ships 10 dB weaker",
    run: |options| run(options, &LEVELS[2]),
};

/// A level and its bars.
struct Level {
    /// Name of its files.
    name: &'static str,
    /// Wideband noise and lines against the vessels of the project's own figures, dB.
    db: f64,
    /// Least share of the vessels found.
    found: f64,
    /// Most final tracks of nobody.
    ghosts: f64,
    /// Greatest medians of the finals: time of the closest point s, its range m, heading deg, speed m/s.
    medians: [f64; 4],
}

/// No bar.
pub(super) const NO_BAR: f64 = f64::INFINITY;

const LEVELS: [Level; 3] = [
    Level { name: "obs-week", db: 0.0, found: 1.0, ghosts: 0.0, medians: [8.0, 50.0, 0.5, 0.03] },
    Level { name: "obs-week-5db", db: -5.0, found: 0.9, ghosts: 1.0, medians: [30.0, 100.0, 1.2, NO_BAR] },
    Level { name: "obs-week-10db", db: -10.0, found: 0.5, ghosts: 1.0, medians: [NO_BAR; 4] },
];

/// Days where the command line names no number.
const DAYS: usize = 7;
pub(super) const DAY_S: f64 = 86_400.0;

/// A final track is a vessel's if it errs by no more in time, s, range, m, heading, deg, and speed, m/s: real ways bend by
/// kilometres within 50 km, so this asks for the right vessel on the right branch and no more.
const OWN: [f64; 4] = [900.0, 3_000.0, 20.0, 2.0];

/// Farther off than this an azimuth is no good, deg.
const WRONG_AZIMUTH_DEG: f64 = 10.0;

/// Farther off than this a range is on a wrong branch, m.
const WRONG_RANGE_M: f64 = 1_500.0;

/// Half width of the stated 95 % of one number, standard deviations.
const NORMAL_95: f64 = 1.96;

/// Squared distance in a place's own covariance within which the truth lies in 95 % of cases: quantile of chi-square with two degrees of freedom.
const PLACE_95: f64 = 5.99;

/// A way that departs from a straight line by so much while its vessel is heard bends, m.
const BENDS_M: f64 = 500.0;

/// What was said against what was so: how many, how many wrong, how many within the stated 95 %.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stated {
    pub(super) said: usize,
    pub(super) wrong: usize,
    pub(super) within: usize,
    /// Of errors over their stated deviations the sum of squares.
    squares: f64,
}

impl Stated {
    /// Takes an error beside its stated deviation; more than `most` is wrong.
    pub(super) fn take(&mut self, error: f64, sd: f32, most: f64) {
        self.said += 1;
        self.wrong += usize::from(error.abs() > most);
        self.within += usize::from(error.abs() <= NORMAL_95 * f64::from(sd));
        self.squares += (error / f64::from(sd)).powi(2);
    }

    /// All of several.
    pub(super) fn sum(all: &[Self]) -> Self {
        all.iter().fold(Self::default(), |a, b| Self {
            said: a.said + b.said,
            wrong: a.wrong + b.wrong,
            within: a.within + b.within,
            squares: a.squares + b.squares,
        })
    }

    /// Errors over their stated deviations, root of the mean square.
    fn rms(&self) -> f64 {
        (self.squares / self.said as f64).sqrt()
    }

    /// Percent; not a number of nothing.
    pub(super) fn percent(&self, n: usize) -> f64 {
        100.0 * n as f64 / self.said as f64
    }
}

/// Days of ship tracks and the sea they are heard in.
pub(super) struct Traffic {
    /// The sea.
    pub(super) scenario: ObsScenario,
    /// The ships.
    pub(super) extra: Vec<Extra>,
}

/// The days with the most closest points, at `db` against the vessels of the project's own figures.
pub(super) fn traffic(options: &Options, days: usize, db: f64) -> Result<Traffic> {
    let plain = Radiation::default();
    let radiation = Radiation { wideband_db: plain.wideband_db + db, tone_db: plain.tone_db + db, ..plain };
    let mut scenario = quiet(options.seed, days as f64 * DAY_S);
    scenario.ambient.directional.push(DirectionalTable { azimuth_deg: 90.0, level_db: -6.0 });
    let extra = match options.real("ais_marine_traffic.csv") {
        Some(file) => {
            let all: Vec<_> = passages(&read(&file)?, RR03_DEG).into_iter().filter(passes).collect();
            let Some((start, chosen)) = window(&all, days as f64) else {
                bail!("{} holds no passage", file.display());
            };
            scenario.start = time::OffsetDateTime::from_unix_timestamp(start as i64)?;
            chosen.iter().map(|p| p.extra(start, &radiation)).collect()
        }
        None => made_up(options.seed, days, &radiation),
    };
    Ok(Traffic { scenario, extra })
}

/// What final tracks state, number by number: time, range, heading, speed of the closest point.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Numbers([Stated; 4]);

impl Numbers {
    /// Takes a final track and its errors.
    pub(super) fn take(&mut self, t: &Track, e: &TrackMiss) {
        let errors = [e.cpa_time_s, e.cpa_range_m, e.heading, e.speed_m_s];
        let stated = [t.sd_cpa_time_s, t.sd_cpa_range_m, t.sd_heading, t.sd_speed_m_s];
        for (out, (error, sd)) in self.0.iter_mut().zip(errors.into_iter().zip(stated)) {
            out.take(error, sd, NO_BAR);
        }
    }

    /// All four together.
    pub(super) fn all(&self) -> Stated {
        Stated::sum(&self.0)
    }

    /// Reports how often the truth is in the stated 95 %.
    pub(super) fn report(&self, options: &Options) {
        let (figures, all) = (&options.figures, self.all());
        let name = "truth in the stated 95 %: final track";
        figures.report(name, all.percent(all.within), Bar::Within(92.0, 97.0));
        for (what, s) in ["CPA time", "CPA range", "heading", "speed"].iter().zip(&self.0) {
            figures.state(format!("{name}, {what}"), s.percent(s.within));
        }
        figures.state("final track: errors over the stated deviations, rms", all.rms());
    }
}

fn run(options: &Options, level: &Level) -> Result<()> {
    let Traffic { scenario, extra } = traffic(options, options.runs.unwrap_or(DAYS), level.db)?;
    let table = station_table(options)?;
    let case = Case::run(scenario.clone(), &table, extra.clone())?;
    if let Some(folder) = &options.plots {
        draw(options, folder, &case, scenario, &table, extra)?;
    }
    let (azimuth, range) = minutes(&case);
    let finals: Vec<Track> = tracks(&case).filter(|t| t.stage == Track::FINAL).collect();
    let mut csv = CsvText::new(
        "ship,closest_km,bend_m,azimuth_n,range_n,finals,cpa_time_s,cpa_range_m,heading_deg,speed_m_s",
    );
    let (mut found, mut split) = (0usize, 0usize);
    let (mut errors, mut stated): (Vec<TrackMiss>, Numbers) = (Vec::new(), Numbers::default());
    for (i, vessel) in case.vessels.iter().enumerate() {
        let own: Vec<&Track> = finals.iter().filter(|t| whose(t, &case.vessels) == Some(i)).collect();
        let miss = own.last().and_then(|t| track_passed(t, &vessel.course));
        found += usize::from(miss.is_some());
        split += own.len().saturating_sub(1);
        if let (Some(t), Some(e)) = (own.last(), miss) {
            stated.take(t, &e);
            errors.push(e);
        }
        let cells = miss.map_or([f64::NAN; 4], |e| cells(&e));
        csv.row(&[
            &(i + 1),
            &Fixed(closest(&vessel.course).map_or(f64::NAN, |c| c.1 / 1e3), 1),
            &Fixed(vessel.course.bend_m().unwrap_or(f64::NAN), 0),
            &azimuth[i].said,
            &range[i].said,
            &own.len(),
            &Fixed(cells[0], 0),
            &Fixed(cells[1], 0),
            &Fixed(cells[2], 1),
            &Fixed(cells[3], 2),
        ]);
    }
    print(options, level.name, csv)?;
    let ghosts: Vec<&Track> = finals.iter().filter(|t| whose(t, &case.vessels).is_none()).collect();
    print(options, &format!("{}-ghosts", level.name), told(&ghosts))?;
    figures(
        options,
        level,
        &case,
        Outcome { found, split, ghosts: ghosts.len(), errors, stated, azimuth, range },
    );
    Ok(())
}

/// Pages of what was recorded, which is simulated once more: a recording of a week is not kept.
fn draw(
    options: &Options,
    folder: &Path,
    case: &Case,
    scenario: ObsScenario,
    table: &Propagation,
    extra: Vec<Extra>,
) -> Result<()> {
    let config = station::config(&scenario)?;
    let truth = truth(case, scenario.duration_s);
    let mut again = Simulator::new(scenario, table.clone(), extra)?;
    let (_, written) = pages::draw(folder, &mut again, &config, table, &case.messages, &truth)?;
    named(options, &written);
    Ok(())
}

/// What came of it.
struct Outcome {
    found: usize,
    split: usize,
    ghosts: usize,
    errors: Vec<TrackMiss>,
    stated: Numbers,
    azimuth: Vec<Stated>,
    range: Vec<Stated>,
}

fn figures(options: &Options, level: &Level, case: &Case, out: Outcome) {
    let figures = &options.figures;
    let ships = case.vessels.len() as f64;
    figures.at_least("vessels found, share", out.found as f64 / ships, level.found);
    figures.at_most("final tracks of nobody", out.ghosts as f64, level.ghosts);
    figures.state("further final tracks of a vessel already found", out.split as f64);
    let names = ["CPA time, s", "CPA range, m", "heading, deg", "speed, m/s"];
    for (k, (name, bar)) in names.iter().zip(level.medians).enumerate() {
        let middle = median(out.errors.iter().map(|e| cells(e)[k].abs()).collect());
        let name = format!("median of the final tracks: {name}");
        if bar.is_finite() { figures.at_most(name, middle, bar) } else { figures.state(name, middle) }
    }
    let (azimuth, range) = (Stated::sum(&out.azimuth), Stated::sum(&out.range));
    figures.state("azimuths", azimuth.said as f64);
    figures.state("ranges", range.said as f64);
    figures.at_most("azimuths more than 10° off, %", azimuth.percent(azimuth.wrong), 1.0);
    figures.at_most("ranges more than 1500 m off, %", range.percent(range.wrong), 4.0);
    for (name, s) in [("azimuth", azimuth), ("range", range)] {
        figures.report(
            format!("truth in the stated 95 %: {name}"),
            s.percent(s.within),
            Bar::Within(92.0, 97.0),
        );
    }
    out.stated.report(options);
    let [all, bent] = places(case).map(|(n, within)| 100.0 * within as f64 / n as f64);
    figures.report("running tracks: places in their 95 %", all, Bar::Within(92.0, 97.0));
    figures.state("running tracks of ways that bend by 500 m and more: places in their 95 %", bent);
    figures.at_most("faults named of a set-up that is as told", case.set_up_faults().len() as f64, 0.0);
    let withdrawn = tracks(case).filter(|t| t.stage == Track::WITHDRAWN).count();
    figures.state("running tracks withdrawn", withdrawn as f64);
}

/// Errors in a person's units.
pub(super) fn cells(e: &TrackMiss) -> [f64; 4] {
    [e.cpa_time_s, e.cpa_range_m, e.heading.to_degrees(), e.speed_m_s]
}

/// Places of running tracks against the vessel nearest to each in its own covariance: how many, and how many in the stated 95 %. Of all, and of
/// vessels whose ways bend.
pub(super) fn places(case: &Case) -> [(usize, usize); 2] {
    let bent: Vec<bool> =
        case.vessels.iter().map(|v| v.course.bend_m().is_some_and(|m| m >= BENDS_M)).collect();
    let mut out = [(0, 0); 2];
    for t in tracks(case).filter(|t| t.stage == Track::RUNNING) {
        let t_s = t.index as f64 / case.rate_hz;
        let [xx, yy, xy] = [t.var_x_m2, t.var_y_m2, t.cov_xy_m2].map(f64::from);
        let off = |v: &MovingVessel| {
            let (x, y) = v.course.at(t_s)?;
            let (dx, dy) = (x - f64::from(t.x_m), y - f64::from(t.y_m));
            Some((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy))
        };
        let all = case.vessels.iter().zip(&bent).filter_map(|(v, bent)| Some((off(v)?, *bent)));
        let Some((off, bent)) = all.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        let (all, ways) = out.split_at_mut(1);
        for (n, within) in all.iter_mut().chain(ways.iter_mut().filter(|_| bent)) {
            *n += 1;
            *within += usize::from(off <= PLACE_95);
        }
    }
    out
}

/// All tracks.
pub(super) fn tracks(case: &Case) -> impl Iterator<Item = Track> + '_ {
    case.messages.iter().filter_map(|m| if let Message::Track(t) = m { Some(*t) } else { None })
}

/// The vessel a final track is of: that whose course it misses least, if by no more than [`OWN`].
pub(super) fn whose(t: &Track, vessels: &[MovingVessel]) -> Option<usize> {
    let cost = |v: &MovingVessel| {
        let parts = cells(&track(t, &v.course)?);
        let worst = parts.iter().zip(OWN).map(|(e, most)| e.abs() / most).fold(0.0, f64::max);
        (worst <= 1.0).then_some(worst)
    };
    let costs = vessels.iter().enumerate().filter_map(|(i, v)| Some((i, cost(v)?)));
    costs.min_by(|a, b| a.1.total_cmp(&b.1)).map(|x| x.0)
}

/// Final tracks as they were sent.
pub(super) fn told(finals: &[&Track]) -> CsvText {
    let mut csv = CsvText::new(
        "ghost_cpa_hour,cpa_range_m,heading_deg,speed_m_s,sd_time_s,sd_range_m,sd_heading_deg,sd_speed_m_s,n",
    );
    for t in finals {
        csv.row(&[
            &Fixed(t.cpa_time_s / 3600.0, 2),
            &Fixed(f64::from(t.cpa_range_m), 0),
            &Fixed(f64::from(t.heading).to_degrees(), 1),
            &Fixed(f64::from(t.speed_m_s), 2),
            &Fixed(f64::from(t.sd_cpa_time_s), 0),
            &Fixed(f64::from(t.sd_cpa_range_m), 0),
            &Fixed(f64::from(t.sd_heading).to_degrees(), 2),
            &Fixed(f64::from(t.sd_speed_m_s), 3),
            &t.n,
        ]);
    }
    csv
}

/// Azimuths and ranges (the first of a minute) against the vessel nearest to each, an entry a vessel.
pub(super) fn minutes(case: &Case) -> (Vec<Stated>, Vec<Stated>) {
    let mut azimuth = vec![Stated::default(); case.vessels.len()];
    let mut range = azimuth.clone();
    let mut last = None;
    for m in &case.messages {
        let (index, error): (u64, &dyn Fn(&crate::score::Then) -> f64) = match m {
            Message::Azimuth(a) if a.detected && a.kind == 0 => {
                (a.index, &|t| wrap_pi(f64::from(a.azimuth) - t.azimuth))
            }
            Message::Range(r) if r.detected && last != Some(r.index) => {
                last = Some(r.index);
                (r.index, &|t| f64::from(r.range_m) - t.range_m)
            }
            _ => continue,
        };
        let t_s = index as f64 / case.rate_hz;
        let there = case
            .vessels
            .iter()
            .enumerate()
            .filter_map(|(i, v)| Some((i, then(&case.table, case.paths, v, t_s)?)));
        let nearest = there.map(|(i, t)| (i, error(&t))).min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        let Some((i, e)) = nearest else { continue };
        match m {
            Message::Azimuth(a) => azimuth[i].take(e, a.sd, WRONG_AZIMUTH_DEG.to_radians()),
            Message::Range(r) => range[i].take(e, r.sd_range_m, WRONG_RANGE_M),
            _ => {}
        }
    }
    (azimuth, range)
}

/// Seeded passages: three vessels in two days, closest within 22 km, each with a slow bend of up to 4°.
fn made_up(seed: u64, days: usize, radiation: &Radiation) -> Vec<Extra> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let hours = 24.0 * days as f64;
    let count = (3 * days).div_ceil(2).min(11);
    (0..count)
        .map(|k| {
            let cpa_s = 3600.0 * (hours * (k as f64 + rng.random_range(0.3..0.7)) / count as f64);
            let speed = rng.random_range(5.0..10.0);
            let straight = VesselCourse::by_cpa(
                cpa_s,
                rng.random_range(2_000.0..22_000.0),
                rng.random_range(0.0..std::f64::consts::TAU),
                speed,
                rng.random(),
            );
            // The way bows sideways: farthest off the line at the closest point, back on it 60 km away.
            let bow_m = rng.random_range(-1_000.0..1_000.0);
            let across = straight
                .at(cpa_s + 1.0)
                .zip(straight.at(cpa_s))
                .map_or((0.0, 0.0), |(b, a)| ((b.1 - a.1) / speed, -(b.0 - a.0) / speed));
            let fixes = (-120..=120).map(|n| {
                let t = cpa_s + 100_000.0 / speed * f64::from(n) / 120.0;
                let bow = bow_m * (1.0 - ((t - cpa_s) * speed / 60_000.0).powi(2)).max(-1.0);
                let (x, y) = straight.at(t).unwrap_or_default();
                (t, (x + bow * across.0, y + bow * across.1))
            });
            let factor = rng.random_range(0.93..1.07);
            let mut radiation = radiation.clone();
            radiation.tones_hz.iter_mut().for_each(|f| *f *= factor);
            let vessel = MovingVessel {
                name: format!("made-up-{}", k + 1),
                course: VesselCourse::Fixes(fixes.collect()),
                active_s: (f64::NEG_INFINITY, f64::INFINITY),
            };
            Extra { vessel, radiation }
        })
        .collect()
}
