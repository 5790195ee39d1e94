//! `reproduce network-offsets`: two arrays hear a straight passage; one of them is turned, or its clock late, by more than is
//! told. Is that found, or said? And do the stated errors hold where it is told? Of one fit to all bearings (`locate --motion`), and
//! of a position every second (`locate`).
//!
//! Bearings are drawn, one a second from each array, with errors of 0.2° and 0.3° (a recorder at −10 dB); what is stated of them are the command's
//! defaults, 1.5° and 1.6°, and 0.5° and 2 s of orientations and clocks. Coverage is judged with the errors told as they
//! are. Ways cross the middle of the network at random; three geometries: two arrays 900 m apart, with elevations; the same by
//! azimuths alone; the two arrays of paper N, 43 m apart, with elevations.

use super::figure::Bar;
use super::network::TWO;
use super::report::CsvReport;
use super::sea::Held;
use super::{Experiment, Options};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::kit::spd;
use seabearing_host::orientation::lasting::positions;
use seabearing_host::orientation::sets::{BearingRow, gather};
use seabearing_host::orientation::way::Way;
use seabearing_host::station::{CLOCK_SD_S, ORIENTATION_SD_DEG};
use seabearing_locate::network::joint::{
    DatedSighting, JointSettings, JointTrack, Scatter, SharedError, bound, fit,
};
use seabearing_locate::network::model::bearing;
use seabearing_locate::network::{FixSettings, MAX_ARRAYS, NetworkError, Region, Sighting};
use std::f64::consts::TAU;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "network-offsets",
    about: "two arrays, one turned by 3° or 5 s late: found, said, or silently wrong; stated errors and bounds with such errors told",
    run,
};

/// Passages of each case.
const RUNS: usize = 60;
/// Length of a passage, seconds.
const DURATION_S: i32 = 200;
const SOURCE_M: f64 = -5.0;
const SOUND_M_S: f64 = 1484.0;
/// Two arrays that see a vessel from different sides.
const WIDE: [[f64; 3]; 2] = [[-450.0, 0.0, -100.0], [450.0, 60.0, -100.0]];
/// Errors of azimuths and elevations, and what the command states of them by default, radians.
const SIGMA: [f64; 2] = [0.2 * RAD_PER_DEG, 0.3 * RAD_PER_DEG];
const STATED: [f64; 2] = [1.5 * RAD_PER_DEG, 1.6 * RAD_PER_DEG];
/// What is assumed of orientations and clocks by default.
const USUAL: SharedError = SharedError { azimuth: ORIENTATION_SD_DEG * RAD_PER_DEG, clock_s: CLOCK_SD_S };
/// What is wrong in one of the arrays.
const TURNED: f64 = 3.0 * RAD_PER_DEG;
const LATE_S: f64 = 5.0;
/// What counts as found.
const FOUND: (f64, f64) = (0.3 * RAD_PER_DEG, 0.5);
/// 95 % of chi-squared, two and four degrees of freedom.
const ELLIPSE_95: f64 = 5.991_464_547_107_98;
const STATE_95: f64 = 9.487_729_036_781_15;
const NORMAL_95: f64 = 1.959_963_984_540_05;

/// A geometry.
#[derive(Clone, Copy)]
struct Geometry {
    name: &'static str,
    arrays: &'static [[f64; 3]; 2],
    elevations: bool,
    /// How far off its middle vessels pass at most, metres.
    off_m: f64,
}

const GEOMETRIES: [Geometry; 3] = [
    Geometry { name: "900 m apart", arrays: &WIDE, elevations: true, off_m: 600.0 },
    Geometry { name: "900 m apart, azimuths alone", arrays: &WIDE, elevations: false, off_m: 600.0 },
    Geometry { name: "43 m apart", arrays: &TWO, elevations: true, off_m: 400.0 },
];

/// What is wrong, and what is assumed.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    /// Of one array; of both what is assumed is drawn where nothing is wrong.
    turned: f64,
    late_s: f64,
    assumed: SharedError,
    /// Standard deviations stated of azimuths and elevations, radians.
    stated: [f64; 2],
    /// What an error has in common with the one a second before.
    common: f64,
    /// Whether the network file says what is assumed.
    told: bool,
}

const CASES: [Case; 7] = [
    Case {
        name: "none wrong, told",
        turned: 0.0,
        late_s: 0.0,
        assumed: USUAL,
        stated: SIGMA,
        common: 0.0,
        told: true,
    },
    Case {
        name: "wrong by 3° and 5 s, told",
        turned: 0.0,
        late_s: 0.0,
        assumed: WIDER,
        stated: SIGMA,
        common: 0.0,
        told: true,
    },
    Case {
        name: "one turned by 3°",
        turned: TURNED,
        late_s: 0.0,
        assumed: USUAL,
        stated: STATED,
        common: 0.0,
        told: false,
    },
    Case {
        name: "one late by 5 s",
        turned: 0.0,
        late_s: LATE_S,
        assumed: USUAL,
        stated: STATED,
        common: 0.0,
        told: false,
    },
    Case {
        name: "one turned and late",
        turned: TURNED,
        late_s: LATE_S,
        assumed: USUAL,
        stated: STATED,
        common: 0.0,
        told: false,
    },
    Case {
        name: "errors that last, not told",
        turned: 0.0,
        late_s: 0.0,
        assumed: EXACT,
        stated: SIGMA,
        common: 0.8,
        told: true,
    },
    Case {
        name: "none wrong, not told",
        turned: 0.0,
        late_s: 0.0,
        assumed: USUAL,
        stated: STATED,
        common: 0.0,
        told: false,
    },
];
const EXACT: SharedError = SharedError { azimuth: 0.0, clock_s: 0.0 };
const WIDER: SharedError = SharedError { azimuth: TURNED, clock_s: LATE_S };

impl Case {
    /// Errors are drawn of what is assumed where nothing is wrong.
    fn drawn(&self) -> bool {
        self.turned == 0.0 && self.late_s == 0.0
    }
}

/// A passage: state at time 0, and what the arrays measured.
struct Passage {
    state: [f64; 4],
    heard: Vec<DatedSighting>,
    /// The array that is wrong.
    wrong: usize,
    /// By how much azimuths are too large.
    turned: [f64; 2],
    /// How late the second clock is against the first.
    late_s: f64,
}

impl Passage {
    fn hear(of: &Geometry, case: &Case, seed: u64, run: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(run as u64);
        let speed: f64 = rng.random_range(4.0..11.0);
        let (s, c) = rng.random_range(0.0..TAU).sin_cos();
        let off = rng.random_range(-of.off_m..of.off_m);
        let state = [off * c, -off * s, speed * s, speed * c];
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut shared = [[0.0; 2]; 2];
        if case.drawn() {
            shared = shared.map(|_| [case.assumed.azimuth * normal(), case.assumed.clock_s * normal()]);
        }
        // Either of them.
        let wrong = run % 2;
        shared[wrong][0] += case.turned;
        shared[wrong][1] += case.late_s;
        let mut heard = Vec::new();
        let mut errors = [[0.0; 2]; 2].map(|e| e.map(|_: f64| normal()));
        for t in -DURATION_S / 2..DURATION_S / 2 {
            for (array, array_m) in of.arrays.iter().enumerate() {
                let emitted = f64::from(t) + 0.3 * array as f64;
                let [x, y, vx, vy] = state;
                let place = [x + vx * emitted, y + vy * emitted, SOURCE_M];
                let (azimuth, elevation) = bearing(array_m, &place);
                let way_m = distance_m(array_m, &place);
                for e in &mut errors[array] {
                    *e = case.common * *e + (1.0 - case.common * case.common).sqrt() * normal();
                }
                let [of_azimuth, of_elevation] = errors[array];
                let sighting = Sighting {
                    array_m: *array_m,
                    azimuth: azimuth + shared[array][0] + SIGMA[0] * of_azimuth,
                    elevation: of.elevations.then(|| elevation + SIGMA[1] * of_elevation),
                    sd_azimuth: case.stated[0],
                    sd_elevation: case.stated[1],
                };
                heard.push(DatedSighting {
                    t_s: emitted + way_m / SOUND_M_S + shared[array][1],
                    array,
                    sighting,
                });
            }
        }
        heard.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let [clock_s, other_s] = shared.map(|s| s[1]);
        Self { state, heard, wrong, turned: shared.map(|s| s[0]), late_s: other_s - clock_s }
    }
}

fn settings(case: &Case) -> JointSettings {
    JointSettings {
        z_m: SOURCE_M,
        sound_speed_m_s: SOUND_M_S,
        robust: true,
        scatter: Scatter::Measured,
        shared: [case.assumed; MAX_ARRAYS],
        alike: [1.0; MAX_ARRAYS],
    }
}

/// What became of the passages of a case.
#[derive(Clone, Copy, Default)]
struct Score {
    passes: usize,
    places: Held,
    states: Held,
    found: usize,
    inconsistent: usize,
    /// No number was given.
    refused: usize,
    /// Neither found nor said to be contradictory, but an offset is stated to be no better known than what it errs by.
    unknown: usize,
    /// None of it.
    silent: usize,
    /// Sums of squares of errors of place, of its bound (m²), and of standardised offsets.
    error_m2: f64,
    bound_m2: f64,
    turned2: f64,
    late2: f64,
    sd_turned: f64,
    /// Positions every second: in their 95 %; passages of which something was said, of which most are wrong and nothing was, and of
    /// which most are wrong.
    fixes: Held,
    said: usize,
    silent_fixes: usize,
    wrong_fixes: usize,
}

impl Score {
    fn join(mut self, other: Self) -> Self {
        self.passes += other.passes;
        self.places.join(other.places);
        self.states.join(other.states);
        self.found += other.found;
        self.inconsistent += other.inconsistent;
        self.refused += other.refused;
        self.unknown += other.unknown;
        self.silent += other.silent;
        self.error_m2 += other.error_m2;
        self.bound_m2 += other.bound_m2;
        self.turned2 += other.turned2;
        self.late2 += other.late2;
        self.sd_turned += other.sd_turned;
        self.fixes.join(other.fixes);
        self.said += other.said;
        self.silent_fixes += other.silent_fixes;
        self.wrong_fixes += other.wrong_fixes;
        self
    }

    fn of(passage: &Passage, case: &Case) -> Self {
        let mut score = Self::of_instants(passage, case);
        let settings = settings(case);
        let track = match fit(&passage.heard, &settings) {
            Ok(track) => track,
            Err(NetworkError::NotObservable) => return Self { refused: 1, ..score },
            Err(NetworkError::Contradictory) => return Self { inconsistent: 1, ..score },
            Err(_) => return Self { silent: 1, ..score },
        };
        let (place, state) = off(&track, &passage.state);
        score.places.take(place <= ELLIPSE_95);
        score.states.take(state <= STATE_95);
        let turned = [0, 1].map(|k| track.offsets[k].azimuth.0 - passage.turned[k]);
        let late_s = track.offsets[1].clock_s.0 - passage.late_s;
        let looked_for = |of: f64| case.drawn() || of != 0.0;
        let found = (!looked_for(case.turned) || turned[passage.wrong].abs() <= FOUND.0)
            && (!looked_for(case.late_s) || late_s.abs() <= FOUND.1);
        score.found += usize::from(found && track.consistent);
        score.inconsistent += usize::from(!track.consistent);
        let held = |(error, sd): (f64, f64)| error.abs() <= NORMAL_95 * sd;
        let held = [0, 1].iter().all(|k| held((turned[*k], track.offsets[*k].azimuth.1)))
            && held((late_s, track.offsets[1].clock_s.1));
        score.unknown += usize::from(!found && held && track.consistent);
        score.silent += usize::from(!found && !held && track.consistent);
        score.turned2 = [0, 1].map(|k| (turned[k] / track.offsets[k].azimuth.1).powi(2) / 2.0).iter().sum();
        score.late2 = (late_s / track.offsets[1].clock_s.1).powi(2);
        score.sd_turned = (track.offsets[0].azimuth.1 + track.offsets[1].azimuth.1) / 2.0;
        let at = truth_at(&passage.state, track.t_ref_s);
        score.error_m2 = (track.state[0] - at[0]).powi(2) + (track.state[1] - at[1]).powi(2);
        if let Some(least) = bound(&passage.heard, &settings, track.t_ref_s, &at) {
            score.bound_m2 = least[0][0] + least[1][1];
        }
        score
    }

    /// What becomes of the positions every second. What is drawn is what the network file says; what is wrong it does not know.
    fn of_instants(passage: &Passage, case: &Case) -> Self {
        let mut score = Self { passes: 1, ..Self::default() };
        let row = |heard: &DatedSighting| BearingRow {
            t_s: heard.t_s,
            station: heard.array,
            azimuth: heard.sighting.azimuth,
            elevation: heard.sighting.elevation,
            sd: (heard.sighting.sd_azimuth, heard.sighting.sd_elevation),
        };
        let mut rows: Vec<_> = passage.heard.iter().map(row).collect();
        let arrays_m = [0, 1].map(|k| {
            passage
                .heard
                .iter()
                .find(|heard| heard.array == k)
                .map_or([0.0; 3], |heard| heard.sighting.array_m)
        });
        let sets = gather(&mut rows, &arrays_m);
        let settings = FixSettings { region: Region::at_depth([0.0; 2], 2000.0, SOURCE_M), robust: true };
        let shared = [case.assumed; MAX_ARRAYS];
        let said = if case.told { shared } else { [EXACT; MAX_ARRAYS] };
        let way = Way::straight(SOUND_M_S);
        let found = positions(&sets, &settings, &shared, &said, way);
        for (set, fix) in sets.iter().zip(&found.fixes).filter(|(set, _)| set.stations.len() == 2) {
            let Ok(fix) = fix else { continue };
            // The true time, whichever clock is late, less the way of the sound.
            let emitted_s = set.t_s - way.mean_s(set, &fix.position_m);
            let [x, y, ..] = truth_at(&passage.state, emitted_s);
            let [[xx, xy, _], [_, yy, _], _] = fix.covariance_m2;
            let d = [fix.position_m[0] - x, fix.position_m[1] - y];
            let squares = spd::solve(&[[xx, xy], [xy, yy]], &d).map_or(f64::INFINITY, |s| spd::dot(&d, &s));
            score.fixes.take(squares <= ELLIPSE_95);
        }
        let told = !found.checked || found.contradicted.is_some() || found.scatter.is_some();
        score.said = usize::from(told);
        score.wrong_fixes = usize::from(2 * score.fixes.held < score.fixes.of);
        score.silent_fixes = if told { 0 } else { score.wrong_fixes };
        score
    }

    fn percent(&self, n: usize) -> f64 {
        100.0 * n as f64 / self.passes as f64
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.places.of as f64
    }
}

fn distance_m(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn truth_at([x, y, vx, vy]: &[f64; 4], t_s: f64) -> [f64; 4] {
    [x + vx * t_s, y + vy * t_s, *vx, *vy]
}

/// Squared errors of place and of the whole state in units of what is stated.
fn off(track: &JointTrack, truth: &[f64; 4]) -> (f64, f64) {
    let at = truth_at(truth, track.t_ref_s);
    let mut d = track.state;
    d.iter_mut().zip(at).for_each(|(x, t)| *x -= t);
    let [[xx, xy, ..], [_, yy, ..], ..] = track.covariance;
    let place = spd::solve(&[[xx, xy], [xy, yy]], &[d[0], d[1]]);
    let place = place.map_or(f64::INFINITY, |x| spd::dot(&[d[0], d[1]], &x));
    let whole = spd::solve(&track.covariance, &d).map_or(f64::INFINITY, |x| spd::dot(&d, &x));
    (place, whole)
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(RUNS);
    let bar = crate::progress::bar((GEOMETRIES.len() * CASES.len()) as u64, "network-offsets");
    let mut report = CsvReport::new(
        "network-offsets",
        "geometry,case,passes,place_%,state_%,found_%,inconsistent_%,refused_%,unknown_%,silent_%,rmse_m,bound_m,\
         turned_sd_units,late_sd_units,sd_turned_deg,positions_%,positions_said_%,positions_silent_%,positions_wrong_%",
    );
    let figures = &options.figures;
    for (g, geometry) in GEOMETRIES.iter().enumerate() {
        for (c, case) in CASES.iter().enumerate() {
            let seed = options.seed.wrapping_mul(1_000_003) + (10 * g + c) as u64;
            let score = (0..runs)
                .into_par_iter()
                .map(|run| Score::of(&Passage::hear(geometry, case, seed, run), case))
                .reduce(Score::default, Score::join);
            bar.inc(1);
            report.row(&[
                g as f64,
                c as f64,
                runs as f64,
                score.places.percent(),
                score.states.percent(),
                score.percent(score.found),
                score.percent(score.inconsistent),
                score.percent(score.refused),
                score.percent(score.unknown),
                score.percent(score.silent),
                score.mean(score.error_m2).sqrt(),
                score.mean(score.bound_m2).sqrt(),
                score.mean(score.turned2).sqrt(),
                score.mean(score.late2).sqrt(),
                score.mean(score.sd_turned) / RAD_PER_DEG,
                score.fixes.percent(),
                score.percent(score.said),
                score.percent(score.silent_fixes),
                score.percent(score.wrong_fixes),
            ]);
            let name = format!("{}, {}", geometry.name, case.name);
            if case.drawn() && !case.told {
                figures.at_least(format!("{name}: positions in the 95 %, %"), score.fixes.percent(), 92.0);
            } else if case.drawn() {
                score.places.report(figures, &format!("{name}: vessels in the 95 %"));
                score.fixes.report(figures, &format!("{name}: positions in the 95 %"));
                if case.common == 0.0 {
                    let ratio = (score.error_m2 / score.bound_m2).sqrt();
                    figures.at_most(format!("{name}: RMSE of place over its bound"), ratio, 1.15);
                }
                figures.at_most(
                    format!("{name}: said to be inconsistent, %"),
                    score.percent(score.inconsistent),
                    3.0,
                );
            } else {
                let told = score.percent(score.found + score.inconsistent + score.refused);
                let one = (case.turned == 0.0) != (case.late_s == 0.0);
                let bar = if g == 0 && one { Bar::AtLeast(95.0) } else { Bar::None };
                figures.report(format!("{name}: found within 0.3° and 0.5 s, or said, %"), told, bar);
                figures.at_most(format!("{name}: silently wrong, %"), score.percent(score.silent), 5.0);
                figures.at_most(
                    format!("{name}: most positions silently wrong, % of passages"),
                    score.percent(score.silent_fixes),
                    5.0,
                );
            }
        }
    }
    bar.finish_and_clear();
    report.finish(options)
}
