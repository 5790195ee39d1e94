//! Several vessels at once: are tracks kept apart through crossings, and are manoeuvres (and only they) noticed?
//!
//! Four vessels pass one array within 300 s on random straight tracks (closest points 200 to 1500 m, 5 to 10 m/s), drawn
//! until exactly two pairs of bearings cross between 60 and 240 s and all are more than 6° apart at both ends, heard as
//! [`super::heard_vessels`] says; one instant in twenty has a false bearing anywhere. Then single vessels, half of which
//! turn by 40° at 1 degree a second; of those that go straight, how often the heading is where the running records state it.

use super::figure::Bar;
use super::heard_vessels::{Bearings, HeardVessel, RATE_HZ, listen, track};
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::plot::{Plot, cut_at_wraps, write_panels};
use crate::progress;
use anyhow::Result;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::kit::quantile;
use seabearing_core::wire::Track;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// `seabearing reproduce several-vessels`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "several-vessels",
    about: "four vessels with two crossings: swaps and lost tracks; manoeuvres noticed",
    run,
};

const DURATION_S: f64 = 300.0;
const VESSELS: usize = 4;
const FALSE_BEARING: f64 = 0.05;
/// These vessels go exactly straight until they turn.
const COURSE_SD_DEG: f64 = 0.0;
const TURN_DEG: f64 = 40.0;
const TURN_RATE_DEG_S: f64 = 1.0;
/// Until then a vessel has hardly turned, seconds.
const FIRST_S: f64 = 60.0;

/// A vessel: straight, or with one turn.
#[derive(Clone, Copy, Debug)]
struct TurningVessel {
    cpa_m: f64,
    cpa_s: f64,
    cpa_azimuth: f64,
    /// +1 clockwise, −1 anticlockwise.
    sense: f64,
    speed_m_s: f64,
    /// Start of the turn and its sign.
    turn: Option<(f64, f64)>,
}

impl TurningVessel {
    fn random(rng: &mut impl Rng, cpa_m: (f64, f64)) -> Self {
        Self {
            cpa_m: rng.random_range(cpa_m.0..cpa_m.1),
            cpa_s: rng.random_range(0.2 * DURATION_S..0.8 * DURATION_S),
            cpa_azimuth: rng.random_range(0.0..TAU),
            sense: if rng.random::<bool>() { 1.0 } else { -1.0 },
            speed_m_s: rng.random_range(5.0..10.0),
            turn: None,
        }
    }
}

impl HeardVessel for TurningVessel {
    fn position(&self, t_s: f64) -> (f64, f64) {
        let (s, c) = self.cpa_azimuth.sin_cos();
        let straight = |t: f64| {
            let along = self.sense * self.speed_m_s * (t - self.cpa_s);
            (self.cpa_m * s + along * c, self.cpa_m * c - along * s)
        };
        let Some((start_s, sign)) = self.turn.filter(|turn| t_s > turn.0) else { return straight(t_s) };
        // An arc of constant rate, then straight on.
        let rate = sign * TURN_RATE_DEG_S * RAD_PER_DEG;
        let turning_s = (t_s - start_s).min(TURN_DEG / TURN_RATE_DEG_S);
        let heading = self.cpa_azimuth + self.sense * std::f64::consts::FRAC_PI_2;
        let (x, y) = straight(start_s);
        let new = heading + rate * turning_s;
        let radius = self.speed_m_s / rate;
        let on = self.speed_m_s * (t_s - start_s - turning_s);
        (
            x + radius * (heading.cos() - new.cos()) + on * new.sin(),
            y + radius * (new.sin() - heading.sin()) + on * new.cos(),
        )
    }
}

fn apart(a: &TurningVessel, b: &TurningVessel, t_s: f64) -> f64 {
    wrap_pi(a.azimuth(t_s) - b.azimuth(t_s))
}

/// Times at which bearings of any two vessels cross.
fn crossings(vessels: &[TurningVessel]) -> Vec<f64> {
    let mut out = Vec::new();
    for (i, a) in vessels.iter().enumerate() {
        for b in &vessels[..i] {
            let mut last = apart(a, b, 0.0);
            for k in 1..=DURATION_S as u32 {
                let now = apart(a, b, f64::from(k));
                if last * now < 0.0 && (last - now).abs() < 1.0 {
                    out.push(f64::from(k));
                }
                last = now;
            }
        }
    }
    out
}

/// Four vessels as the module's header says.
fn traffic_of_four(rng: &mut impl Rng) -> [TurningVessel; VESSELS] {
    loop {
        let vessels = [(); VESSELS].map(|()| TurningVessel::random(rng, (200.0, 1500.0)));
        let times = crossings(&vessels);
        let clear = |t: f64| {
            vessels
                .iter()
                .enumerate()
                .all(|(i, a)| vessels[..i].iter().all(|b| apart(a, b, t).abs() > 6.0 * RAD_PER_DEG))
        };
        let inside = times.iter().all(|t| (60.0..240.0).contains(t));
        if times.len() == 2 && inside && clear(0.0) && clear(DURATION_S) {
            return vessels;
        }
    }
}

/// What happened to the tracks of one run.
#[derive(Clone, Debug, Default)]
struct Verdict {
    swapped: bool,
    lost: bool,
    extra: bool,
}

fn verdict(vessels: &[TurningVessel], records: &[Track]) -> Verdict {
    let mut of_vessel = vec![BTreeSet::new(); vessels.len()];
    let mut of_track = std::collections::BTreeMap::<u16, BTreeSet<usize>>::new();
    let mut newest = vec![0.0f64; vessels.len()];
    for record in records.iter().filter(|r| r.stage == 0) {
        let t_s = record.index as f64 / RATE_HZ;
        let azimuth = f64::from(record.x_m).atan2(f64::from(record.y_m));
        let mut distances: Vec<(f64, usize)> =
            vessels.iter().enumerate().map(|(i, v)| (wrap_pi(azimuth - v.azimuth(t_s)).abs(), i)).collect();
        distances.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (nearest, vessel) = distances[0];
        let clear = vessels
            .iter()
            .enumerate()
            .all(|(i, v)| i == vessel || apart(v, &vessels[vessel], t_s).abs() > 5.0 * RAD_PER_DEG);
        if clear && nearest < 3.0 * RAD_PER_DEG {
            of_vessel[vessel].insert(record.id);
            of_track.entry(record.id).or_default().insert(vessel);
            newest[vessel] = newest[vessel].max(t_s);
        }
    }
    let finals = records.iter().filter(|r| r.stage == 1).count();
    Verdict {
        swapped: of_track.values().any(|v| v.len() > 1),
        lost: of_vessel.iter().any(|ids| ids.len() != 1) || newest.iter().any(|t| *t < DURATION_S - 25.0),
        extra: finals != vessels.len(),
    }
}

fn seeds(options: &Options, runs: usize, what: u64) -> Vec<u64> {
    (0..runs as u64)
        .map(|run| options.seed.wrapping_mul(1_000_003).wrapping_add(what * 100_000 + run))
        .collect()
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(100);
    let bar = progress::bar(2 * runs as u64, "several vessels");
    let verdicts: Vec<(u64, Verdict)> = seeds(options, runs, 1)
        .into_par_iter()
        .map(|seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let vessels = traffic_of_four(&mut rng);
            let (records, _) = track(&listen(&vessels, DURATION_S, &mut rng, FALSE_BEARING), COURSE_SD_DEG);
            bar.inc(1);
            (seed, verdict(&vessels, &records))
        })
        .collect();
    let turns: Vec<Turn> = seeds(options, runs, 2)
        .into_par_iter()
        .map(|seed| {
            bar.inc(1);
            Turn::of(seed)
        })
        .collect();
    bar.finish_and_clear();
    let count = |f: fn(&Verdict) -> bool| verdicts.iter().filter(|(_, v)| f(v)).count();
    let good = count(|v| !(v.swapped || v.lost || v.extra));
    let (swapped, lost, extra) = (count(|v| v.swapped), count(|v| v.lost), count(|v| v.extra));
    let mut delays: Vec<f64> = turns.iter().filter_map(|t| t.delay_s).collect();
    let noticed = delays.len();
    let mut at = |share: f64| quantile(&mut delays, share).unwrap_or(f64::NAN);
    let false_splits = turns.iter().filter(|t| t.straight_split).count();
    let early = turns.iter().filter(|t| t.early).count();

    let mut csv = CsvText::new("seed,swapped,lost,extra");
    for (seed, v) in &verdicts {
        csv.row(&[seed, &v.swapped, &v.lost, &v.extra]);
    }
    crate::atomic::write(&options.out.join("several_vessels_runs.csv"), csv.finish().as_bytes())?;
    picture(options)?;
    let figures = &options.figures;
    let share = |n: usize| 100.0 * n as f64 / runs as f64;
    figures.at_least("four vessels, two crossings: no swap, none lost, none too many, %", share(good), 95.0);
    figures.state("a swap, %", share(swapped));
    figures.state("a lost or broken track, %", share(lost));
    figures.state("another number of solutions, %", share(extra));
    figures.state(format!("a turn by {TURN_DEG}° at {TURN_RATE_DEG_S} °/s: noticed, %"), share(noticed));
    figures.state("split before the turn, %", share(early));
    figures.state("noticed after, median, s", at(0.5));
    figures.state("noticed after, 90 %, s", at(0.9));
    figures.at_most("one vessel going straight: split, %", share(false_splits), 0.0);
    let all = |f: fn(&Turn) -> [usize; 2]| turns.iter().map(f).fold([0; 2], |[a, b], [c, d]| [a + c, b + d]);
    let (told, right) = (all(|t| t.told), all(|t| t.right));
    let percent = |right: usize, told: usize| 100.0 * right as f64 / told as f64;
    let within = |what: &str, value: f64| figures.report(what, value, Bar::Within(92.0, 97.0));
    within("its headings told in their 95 %, %", percent(right[0] + right[1], told[0] + told[1]));
    within("those of the first minute, %", percent(right[0], told[0]));
    figures.state("of all told those of the first minute, %", percent(told[0], told[0] + told[1]));
    Ok(())
}

/// One vessel that turns, and the same one going straight on.
struct Turn {
    /// From the start of the turn to the end-of-passage record of the track before it.
    delay_s: Option<f64>,
    early: bool,
    straight_split: bool,
    /// Running records of the straight one that tell its heading, in the first minute and after it; of these with the true one in their 95 %.
    told: [usize; 2],
    right: [usize; 2],
}

impl Turn {
    fn of(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (vessel, bearings) = turning(&mut rng);
        let start_s = vessel.turn.map_or(0.0, |t| t.0);
        let (records, _) = track(&bearings, COURSE_SD_DEG);
        // The old track's final record comes when the new one starts: the time of the first other number.
        let first = records.first().map_or(0, |r| r.id);
        let switched = records.iter().find(|r| r.id != first).map(|r| r.index as f64 / RATE_HZ);
        let straight = TurningVessel { turn: None, ..vessel };
        let (records, _) = track(&listen(&[straight], DURATION_S, &mut rng, 0.0), COURSE_SD_DEG);
        let ids: BTreeSet<u16> = records.iter().map(|r| r.id).collect();
        let (mut told, mut right) = ([0; 2], [0; 2]);
        let heading = straight.cpa_azimuth + straight.sense * std::f64::consts::FRAC_PI_2;
        for record in records.iter().filter(|r| r.stage == Track::RUNNING && r.sd_heading.is_finite()) {
            let late = usize::from(record.index as f64 / RATE_HZ >= FIRST_S);
            told[late] += 1;
            let off = wrap_pi(f64::from(record.heading) - heading).abs();
            right[late] += usize::from(off < 1.96 * f64::from(record.sd_heading));
        }
        Self {
            told,
            right,
            delay_s: switched.filter(|t| *t >= start_s).map(|t| t - start_s),
            early: switched.is_some_and(|t| t < start_s),
            straight_split: ids.len() != 1,
        }
    }
}

/// A vessel that turns between 100 and 160 s, near its closest point, and its bearings.
fn turning(rng: &mut ChaCha8Rng) -> (TurningVessel, Bearings) {
    let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
    let turn = Some((rng.random_range(100.0..160.0), sign));
    let vessel = TurningVessel { turn, cpa_s: 150.0, ..TurningVessel::random(rng, (300.0, 800.0)) };
    let bearings = listen(&[vessel], DURATION_S, rng, 0.0);
    (vessel, bearings)
}

/// Bearings of the first run and of a turning vessel, coloured by track, over the truth.
fn picture(options: &Options) -> Result<()> {
    let mut rng = ChaCha8Rng::seed_from_u64(seeds(options, 1, 1)[0]);
    let four = traffic_of_four(&mut rng);
    let bearings = listen(&four, DURATION_S, &mut rng, FALSE_BEARING);
    let (_, on) = track(&bearings, COURSE_SD_DEG);
    let mut csv = CsvText::new("t_s,azimuth_deg,track,truth0_deg,truth1_deg,truth2_deg,truth3_deg");
    for ((t_s, azimuth), id) in bearings.iter().zip(&on) {
        let id = id.map_or(String::new(), |i| i.to_string());
        let [a, b, c, d] = four.each_ref().map(|vessel| Fixed(vessel.azimuth(*t_s).to_degrees(), 3));
        csv.row(&[&Fixed(*t_s, 1), &Fixed(azimuth.to_degrees(), 3), &id, &a, &b, &c, &d]);
    }
    crate::atomic::write(&options.out.join("several_vessels.csv"), csv.finish().as_bytes())?;
    let mut rng = ChaCha8Rng::seed_from_u64(seeds(options, 1, 2)[0]);
    let (turning, turned) = turning(&mut rng);
    let (_, turned_on) = track(&turned, COURSE_SD_DEG);
    let first = figure("Four vessels, two crossings", &four, &bearings, &on);
    let second = figure("One vessel turning by 40°", &[turning], &turned, &turned_on);
    write_panels(&options.out.join("several_vessels.svg"), &[&first, &second], 1)
}

fn figure(title: &str, vessels: &[TurningVessel], bearings: &Bearings, on: &[Option<u16>]) -> Plot {
    let mut figure = Plot::new(title, "time (s)", "azimuth (°)");
    figure.size(900, 480).x_range(0.0, DURATION_S).y_scale(crate::plot::Scale::Degrees).y_range(0.0, 360.0);
    let ids: BTreeSet<u16> = on.iter().flatten().copied().collect();
    for id in ids {
        let mine = bearings.iter().zip(on).filter(|(_, o)| **o == Some(id));
        let points: Vec<(f64, f64)> = mine.map(|((t, a), _)| (*t, a.to_degrees())).collect();
        figure.points(&format!("track {id}"), &points);
    }
    let none = bearings.iter().zip(on).filter(|(_, o)| o.is_none());
    let points: Vec<(f64, f64)> = none.map(|((t, a), _)| (*t, a.to_degrees())).collect();
    figure.points("no track", &points).coloured(crate::plot::RGBColor(150, 150, 150));
    for (i, vessel) in vessels.iter().enumerate() {
        let curve: Vec<(f64, f64)> = (0..=600)
            .map(|k| f64::from(k) * DURATION_S / 600.0)
            .map(|t| (t, vessel.azimuth(t).to_degrees()))
            .collect();
        figure.truth(if i == 0 { "truth" } else { "" }, &cut_at_wraps(&curve));
    }
    figure
}
