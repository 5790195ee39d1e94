//! What the positions of many instants tell of their arrays: errors of orientation and clock, which last.
//!
//! At one instant an array that is turned, or whose clock is late, looks like a vessel somewhere else: all of its error goes
//! into the position. Over many instants the arrays show it. With residuals `r` of the angles about the positions, their
//! gradients `g` by position and `j` by the lasting errors `u` (all over the angles' deviations), positions drop out of the
//! normal equations (Schur's complement): `A = Σ (jᵀj − jᵀg (gᵀg)⁻¹ gᵀj)`, `h` likewise with `r`. `u` has Gaussian priors, what
//! the network file says of orientation and clock, and is the solution of `(A/κ + P⁻¹) u = h/κ`. `κ` is the variance that the
//! residuals show over the one claimed, with what successive ones have in common.
//!
//! Errors that are larger than their priors allow are a contradiction: it is said, and the priors grow until they allow them.
//! Every position is made anew from bearings without `u`, and what stays unknown of `u` is in its covariance: an orientation's
//! error is in every position alike, and no number of them averages it out.

use super::sets::SightingSet;
use seabearing_core::angle::wrap_pi;
use seabearing_core::kit::spd::{self, Square};
use seabearing_core::kit::straight_line::through;
use seabearing_locate::network::joint::SharedError;
use seabearing_locate::network::locate::{LARGEST_RELATIVE_SD, misfit_limit};
use seabearing_locate::network::model::{Sighting, bearing, gradients};
use seabearing_locate::network::{Fix, FixSettings, MAX_ARRAYS, NetworkError, locate};

/// Unknowns: errors of the arrays' azimuths, then of their clocks, in units of their priors' deviations.
const N: usize = 2 * MAX_ARRAYS;
/// Fewest positions that tell of errors that last.
const LEAST_FIXES: usize = 20;
/// Most that successive residuals are taken to have in common.
const MOST_COMMON: f64 = 0.95;
/// Positions either side from which a vessel's velocity is taken, and how far in time they may be.
const NEIGHBOURS: usize = 4;
const NEAR_S: f64 = 60.0;
/// Most linear steps, which bearings need where they turn with the error of a clock, and the least one that is followed by
/// another, in deviations.
const STEPS: usize = 8;
const LEAST_STEP: f64 = 0.05;
/// Residuals' variance over the claimed one up to which lasting errors explain what arrays disagree in, so that no array is to
/// be set aside instant by instant.
const EXPLAINED: f64 = 1.5;
/// Least of it that is believed.
const LEAST_NOISE: f64 = 1e-3;
/// Deviations of its prior beyond which an error is named where there is a contradiction.
const NAMED: f64 = 2.0;

/// An error that was found, each with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lasting {
    /// By how much all azimuths are too large, radians.
    pub azimuth: (f64, f64),
    /// How late the clock is, seconds.
    pub clock_s: (f64, f64),
    /// Whether each is more than was said of it.
    pub beyond: (bool, bool),
}

/// Positions, and what they tell of the arrays.
pub struct Positions {
    /// One a set.
    pub fixes: Vec<Result<Fix, NetworkError>>,
    /// Of each station, where the stations contradict each other.
    pub contradicted: Option<[Lasting; MAX_ARRAYS]>,
    /// Variance of the residuals over the claimed one, where that is more than chance.
    pub scatter: Option<f64>,
}

/// Positions of all sets. `shared`: deviations of what the bearings of each station share, `said`: those among them that
/// somebody told, 0 where nobody did. What is not told is looked for, and is in no position unless it is found. A position is
/// where the vessel was one mean way of the sound (`sound_m_s`) before the set's time.
pub fn positions(
    sets: &[SightingSet],
    settings: &FixSettings,
    shared: &[SharedError; MAX_ARRAYS],
    said: &[SharedError; MAX_ARRAYS],
    sound_m_s: f64,
) -> Positions {
    let whole = FixSettings { robust: false, ..*settings };
    let mut settings = settings;
    let mut best = Fitted::of(sets, &whole, shared, sound_m_s);
    if best.explains() {
        settings = &whole;
    } else if settings.robust {
        best = Fitted::of(sets, settings, shared, sound_m_s);
    }
    let told = best.unknowns().max(1.0);
    let excess = best.state.iter().map(|w| w * w).sum::<f64>();
    let contradict = excess > misfit_limit(told.ceil() as u32);
    if contradict {
        let growth = (excess / told).sqrt();
        let grown = shared.map(|s| SharedError { azimuth: growth * s.azimuth, clock_s: growth * s.clock_s });
        // Errors beyond what was allowed first may explain all.
        best = Fitted::of(sets, &whole, &grown, sound_m_s);
        if best.explains() {
            settings = &whole;
        } else if settings.robust {
            best = Fitted::of(sets, settings, &grown, sound_m_s);
        }
    } else if said != shared {
        best = Fitted::of(sets, settings, said, sound_m_s);
    }
    let contradicted = contradict.then(|| best.told(shared));
    let scatter = best.scatter();
    let agree = contradicted.is_none() && scatter.is_none();
    Positions { fixes: best.stated(settings, scatter.unwrap_or(1.0), agree), contradicted, scatter }
}

/// Sets without the errors that last, and what is known of these.
struct Fitted {
    sets: Vec<SightingSet>,
    fixes: Vec<Result<Fix, NetworkError>>,
    velocities: Vec<[f64; 2]>,
    prior: [f64; N],
    state: [f64; N],
    covariance: Square<N>,
    information: Square<N>,
    misfit: f64,
    freedom: f64,
    /// Variance of a mean of residuals over that of as many independent ones.
    common: f64,
    /// Positions that told something.
    used: usize,
}

/// Sums over angles, positions eliminated.
struct Sums {
    information: Square<N>,
    pull: [f64; N],
    misfit: f64,
    freedom: f64,
    /// What an error of each unknown does to the position.
    moves: [[f64; N]; 3],
}

impl Fitted {
    fn of(
        given: &[SightingSet],
        settings: &FixSettings,
        shared: &[SharedError; MAX_ARRAYS],
        sound_m_s: f64,
    ) -> Self {
        let mut prior = [0.0; N];
        for (k, of) in shared.iter().enumerate() {
            (prior[k], prior[MAX_ARRAYS + k]) = (of.azimuth, of.clock_s);
        }
        // Clocks are told against that of the first array.
        if let Some(first) = given.iter().flat_map(|set| &set.stations).min() {
            prior[MAX_ARRAYS + first] = 0.0;
        }
        let mut new = Self {
            sets: given.to_vec(),
            fixes: given.iter().map(|set| locate(&set.sightings, settings)).collect(),
            velocities: Vec::new(),
            prior,
            state: [0.0; N],
            covariance: identity(),
            information: [[0.0; N]; N],
            misfit: 0.0,
            freedom: 0.0,
            common: 1.0,
            used: 0,
        };
        for _ in 0..STEPS {
            new.velocities = velocities(&new.sets, &new.fixes);
            let before = new.state;
            new.step();
            let places = new.fixes.iter().zip(&new.velocities);
            for (set, (given, (fix, v))) in new.sets.iter_mut().zip(given.iter().zip(places)) {
                *set = without(given, &new.prior, &new.state, v, fix.as_ref().ok(), sound_m_s);
            }
            new.fixes = new.sets.iter().map(|set| locate(&set.sightings, settings)).collect();
            if new.state.iter().zip(&before).all(|(now, before)| (now - before).abs() < LEAST_STEP) {
                break;
            }
        }
        new
    }

    /// One linear step from the present state.
    fn step(&mut self) {
        let mut information = [[0.0; N]; N];
        let mut pull = [0.0; N];
        let (mut misfit, mut freedom, mut used) = (0.0, 0.0, 0);
        for sums in self.sums().flatten() {
            used += 1;
            misfit += sums.misfit;
            freedom += sums.freedom;
            for (to, from) in information.iter_mut().flatten().zip(sums.information.as_flattened()) {
                *to += from;
            }
            for (to, from) in pull.iter_mut().zip(&sums.pull) {
                *to += from;
            }
        }
        self.used = used;
        if used < LEAST_FIXES {
            return;
        }
        let before = self.state;
        let mut noise = 1.0;
        // Once as claimed, then as the residuals show.
        for _ in 0..2 {
            let mut normal = information;
            normal.iter_mut().flatten().for_each(|x| *x /= noise);
            for (k, row) in normal.iter_mut().enumerate() {
                row[k] += 1.0;
            }
            let Some(covariance) = spd::inverse(&normal) else { return };
            let moved = spd::times(&information, &before);
            let right: [f64; N] = core::array::from_fn(|k| (pull[k] + moved[k]) / noise);
            self.state = spd::times(&covariance, &right);
            self.covariance = covariance;
            let change: [f64; N] = core::array::from_fn(|k| self.state[k] - before[k]);
            self.misfit =
                misfit - 2.0 * spd::dot(&change, &pull) + spd::quadratic(&change, &information, &change);
            self.freedom = freedom;
            self.common = self.shared_by_successive(&change);
            noise = (self.misfit / freedom).max(LEAST_NOISE) * self.common;
            self.information = information;
            self.information.iter_mut().flatten().for_each(|x| *x /= noise);
        }
    }

    /// Variance of a mean of residuals over that of as many independent ones, from what successive ones have in common.
    fn shared_by_successive(&self, change: &[f64; N]) -> f64 {
        let mut last = [0.0; MAX_ARRAYS];
        let (mut squares, mut products, mut n) = (0.0, 0.0, 0.0f64);
        for sums in self.sums().flatten() {
            let explained = spd::times(&sums.information, change);
            for k in (0..MAX_ARRAYS).filter(|k| sums.information[*k][*k] > 0.0) {
                let off = (sums.pull[k] - explained[k]) / sums.information[k][k].sqrt();
                squares += off * off;
                products += off * last[k];
                last[k] = off;
                n += 1.0;
            }
        }
        let common = if squares > 0.0 { (products / squares + 1.0 / n).clamp(0.0, MOST_COMMON) } else { 0.0 };
        (1.0 + common) / (1.0 - common)
    }

    fn sums(&self) -> impl Iterator<Item = Option<Sums>> + '_ {
        let all = self.sets.iter().zip(&self.fixes).zip(&self.velocities);
        all.map(|((set, fix), v)| {
            let fix = fix.as_ref().ok().filter(|fix| fix.freedom > 0 && !fix.height_at_limit)?;
            sums(set, fix, v, &self.prior, &self.state)
        })
    }

    /// Whether the residuals are about as large as claimed.
    fn explains(&self) -> bool {
        self.used >= LEAST_FIXES && self.misfit <= EXPLAINED * self.freedom
    }

    /// The residuals' variance over the claimed one, where that is more than chance: as many residuals count as are independent.
    fn scatter(&self) -> Option<f64> {
        let independent = (self.freedom / self.common).max(1.0);
        let most = misfit_limit(independent as u32) / independent;
        let found = self.misfit / self.freedom;
        (self.used >= LEAST_FIXES && found > most).then_some(found)
    }

    /// How many unknowns the bearings tell, each as a share of what the prior left: `tr A (A + 1)⁻¹`.
    fn unknowns(&self) -> f64 {
        (0..N).map(|k| (1.0 - self.covariance[k][k]).max(0.0)).sum()
    }

    fn told(&self, shared: &[SharedError; MAX_ARRAYS]) -> [Lasting; MAX_ARRAYS] {
        let of = |k: usize| (self.prior[k] * self.state[k], self.prior[k] * self.covariance[k][k].sqrt());
        let one = |k: usize| {
            let (azimuth, clock_s) = (of(k), of(MAX_ARRAYS + k));
            let beyond = (
                azimuth.0.abs() > NAMED * shared[k].azimuth.max(f64::MIN_POSITIVE),
                clock_s.0.abs() > NAMED * shared[k].clock_s.max(f64::MIN_POSITIVE),
            );
            Lasting { azimuth, clock_s, beyond }
        };
        core::array::from_fn(one)
    }

    /// The positions, what lasts in their covariances. `noise`: what the residuals show more than was claimed.
    fn stated(self, settings: &FixSettings, noise: f64, agree: bool) -> Vec<Result<Fix, NetworkError>> {
        let state = |((set, _), v): ((&SightingSet, &Result<Fix, NetworkError>), &[f64; 2])| {
            let mut fix = locate(&set.sightings, settings)?;
            let own = if fix.consistent { 1.0 } else { fix.misfit / f64::from(fix.freedom.max(1)) };
            let grown = (noise / own).max(1.0);
            fix.covariance_m2.iter_mut().flatten().for_each(|x| *x *= grown);
            if let Some(sums) = sums(set, &fix, v, &self.prior, &self.state) {
                let lasting = spd::propagated(&sums.moves, &self.covariance);
                for (x, add) in fix.covariance_m2.iter_mut().flatten().zip(lasting.as_flattened()) {
                    *x += add;
                }
            }
            fix.consistent &= agree;
            let far = set.sightings.iter().map(|s| distance_m(s, &fix.position_m)).fold(0.0, f64::max);
            let sd = spd::largest_eigenvalue(&fix.covariance_m2).sqrt();
            if sd <= LARGEST_RELATIVE_SD * far { Ok(fix) } else { Err(NetworkError::NotObservable) }
        };
        self.sets.iter().zip(&self.fixes).zip(&self.velocities).map(state).collect()
    }
}

fn identity() -> Square<N> {
    core::array::from_fn(|k| core::array::from_fn(|l| if k == l { 1.0 } else { 0.0 }))
}

fn distance_m(seen: &Sighting, position_m: &[f64; 3]) -> f64 {
    let off = |k: usize| (position_m[k] - seen.array_m[k]).powi(2);
    (off(0) + off(1) + off(2)).sqrt()
}

/// Where a vessel was so long before.
fn before(position_m: &[f64; 3], v: &[f64; 2], seconds: f64) -> [f64; 3] {
    let [x, y, z] = *position_m;
    [x - v[0] * seconds, y - v[1] * seconds, z]
}

/// Rates of azimuth and elevation of a vessel at a place, radians a second.
fn rates(seen: &Sighting, position_m: &[f64; 3], v: &[f64; 2]) -> (f64, f64) {
    let (a, b) = gradients(&seen.array_m, position_m);
    (a[0] * v[0] + a[1] * v[1], b[0] * v[0] + b[1] * v[1])
}

/// A set's sums, positions eliminated; `None` where they are none.
fn sums(set: &SightingSet, fix: &Fix, v: &[f64; 2], prior: &[f64; N], state: &[f64; N]) -> Option<Sums> {
    let known = fix.covariance_m2[2][2] == 0.0;
    let mut normal = [[0.0; 3]; 3];
    if known {
        normal[2][2] = 1.0;
    }
    let mut by = [[0.0; N]; 3];
    let mut out = Sums {
        information: [[0.0; N]; N],
        pull: [0.0; N],
        misfit: 0.0,
        freedom: f64::from(fix.freedom),
        moves: [[0.0; N]; 3],
    };
    let mut toward = [0.0; 3];
    let used = set.sightings.iter().zip(&set.stations).enumerate();
    for (_, (seen, station)) in used.filter(|(k, _)| fix.rejected != Some(*k)) {
        let (azimuth, elevation) = bearing(&seen.array_m, &fix.position_m);
        let (ga, gb) = gradients(&seen.array_m, &fix.position_m);
        let (turned, late) = (*station, MAX_ARRAYS + *station);
        let heard_at = before(&fix.position_m, v, prior[late] * state[late]);
        let (turning, rising) = rates(seen, &heard_at, v);
        let mut angle = |r: f64, g: [f64; 3], sd: f64, turns: f64, rate: f64| {
            let mut g = g.map(|x| x / sd);
            if known {
                g[2] = 0.0;
            }
            let mut j = [0.0; N];
            j[turned] = turns * prior[turned] / sd;
            j[late] = -rate * prior[late] / sd;
            let r = r / sd;
            out.misfit += r * r;
            for (k, g) in g.iter().enumerate() {
                toward[k] += g * r;
                for l in [turned, late] {
                    by[k][l] += g * j[l];
                }
            }
            spd::add_outer(&mut normal, &g, 1.0);
            for k in [turned, late] {
                out.pull[k] += j[k] * r;
                for l in [turned, late] {
                    out.information[k][l] += j[k] * j[l];
                }
            }
        };
        angle(wrap_pi(seen.azimuth - azimuth), ga, seen.sd_azimuth, 1.0, turning);
        if let Some(measured) = seen.elevation {
            angle(measured - elevation, gb, seen.sd_elevation, 0.0, rising);
        }
    }
    let inverse = spd::inverse(&normal)?;
    for k in 0..3 {
        for l in 0..N {
            out.moves[k][l] = (0..3).map(|m| inverse[k][m] * by[m][l]).sum();
        }
    }
    for k in 0..N {
        out.pull[k] -= (0..3).map(|m| out.moves[m][k] * toward[m]).sum::<f64>();
        for l in 0..N {
            out.information[k][l] -= (0..3).map(|m| by[m][k] * out.moves[m][l]).sum::<f64>();
        }
    }
    out.misfit -= spd::quadratic(&toward, &inverse, &toward);
    Some(out)
}

/// The vessel's velocity at each position, m/s; none where it has no neighbours in time.
fn velocities(sets: &[SightingSet], fixes: &[Result<Fix, NetworkError>]) -> Vec<[f64; 2]> {
    let known: Vec<(f64, [f64; 3])> = sets
        .iter()
        .zip(fixes)
        .filter_map(|(set, fix)| Some((set.t_s, fix.as_ref().ok()?.position_m)))
        .collect();
    let at = |t_s: f64| {
        let here = known.partition_point(|(t, _)| *t < t_s);
        let near = &known[here.saturating_sub(NEIGHBOURS)..(here + NEIGHBOURS + 1).min(known.len())];
        let near = near.iter().filter(|(t, _)| (t - t_s).abs() <= NEAR_S);
        let along =
            |k: usize| through(near.clone().map(|(t, p)| (t - t_s, p[k]))).map_or(0.0, |line| line.slope);
        if near.clone().count() > NEIGHBOURS { [along(0), along(1)] } else { [0.0; 2] }
    };
    sets.iter().map(|set| at(set.t_s)).collect()
}

/// The bearings of a set without the errors that last, and of what was heard at one instant of the vessel: the sound of the
/// nearer array is younger. `fix`: where the vessel was, `v` how fast, as far as is known.
fn without(
    given: &SightingSet,
    prior: &[f64; N],
    state: &[f64; N],
    v: &[f64; 2],
    fix: Option<&Fix>,
    sound_m_s: f64,
) -> SightingSet {
    let mut out = given.clone();
    let way_m = |seen: &Sighting| fix.map_or(0.0, |fix| distance_m(seen, &fix.position_m));
    let mean_m = given.sightings.iter().map(way_m).sum::<f64>() / given.sightings.len() as f64;
    for (seen, station) in out.sightings.iter_mut().zip(&given.stations) {
        let (turned, late) = (*station, MAX_ARRAYS + *station);
        let Some(fix) = fix else { continue };
        let late_s = prior[late] * state[late] + (way_m(seen) - mean_m) / sound_m_s;
        let (now, then) = (fix.position_m, before(&fix.position_m, v, late_s));
        let ((azimuth, elevation), (azimuth_then, elevation_then)) =
            (bearing(&seen.array_m, &now), bearing(&seen.array_m, &then));
        seen.azimuth += wrap_pi(azimuth - azimuth_then) - prior[turned] * state[turned];
        seen.elevation = seen.elevation.map(|e| e + elevation - elevation_then);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::orientation::sets::{BearingRow, gather};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use seabearing_core::angle::RAD_PER_DEG;
    use seabearing_locate::network::Region;

    const ARRAYS: [[f64; 3]; 3] = [[0.0, 0.0, -100.0], [700.0, 100.0, -120.0], [200.0, 600.0, -90.0]];
    const SD: (f64, f64) = (0.3 * RAD_PER_DEG, 0.4 * RAD_PER_DEG);
    const REGION: Region =
        Region::Box { least_m: [-1700.0, -1800.0, -5.0], greatest_m: [2300.0, 2200.0, -5.0] };
    const SETTINGS: FixSettings = FixSettings { region: REGION, robust: true };

    const SOUND_M_S: f64 = 1484.0;

    fn way_m(a: &[f64; 3], b: &[f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    fn place(t_s: f64) -> [f64; 3] {
        [6.0f64.mul_add(t_s, -600.0), 250.0 + t_s, -5.0]
    }

    /// Bearings of a passage by the first `arrays`, the second of them turned and late by so much.
    fn heard(arrays: usize, turned: f64, late_s: f64, seed: u64) -> Vec<SightingSet> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut rows = Vec::new();
        for k in 0..100 {
            for (station, array) in ARRAYS.iter().enumerate().take(arrays) {
                let t_s = 2.0 * f64::from(k);
                let (wrong, late) = if station == 1 { (turned, late_s) } else { (0.0, 0.0) };
                let mut emitted = t_s - late;
                for _ in 0..4 {
                    emitted = t_s - late - way_m(array, &place(emitted)) / SOUND_M_S;
                }
                let (azimuth, elevation) = bearing(array, &place(emitted));
                rows.push(BearingRow {
                    t_s,
                    station,
                    azimuth: azimuth + wrong + SD.0 * noise(),
                    elevation: Some(elevation + SD.1 * noise()),
                    sd: SD,
                });
            }
        }
        gather(&mut rows, &ARRAYS)
    }

    const TOLD: [SharedError; MAX_ARRAYS] =
        [SharedError { azimuth: 0.5 * RAD_PER_DEG, clock_s: 1.0 }; MAX_ARRAYS];
    const NONE: [SharedError; MAX_ARRAYS] = [SharedError { azimuth: 0.0, clock_s: 0.0 }; MAX_ARRAYS];

    /// Positions, the share of them whose 95 % hold the truth, and of those that are consistent.
    fn judged(sets: &[SightingSet], said: &[SharedError; MAX_ARRAYS]) -> (Positions, f64, f64) {
        let found = positions(sets, &SETTINGS, &TOLD, said, SOUND_M_S);
        let (mut held, mut agree, mut n) = (0.0, 0.0, 0.0);
        for (set, fix) in sets.iter().zip(&found.fixes) {
            let Ok(fix) = fix else { continue };
            let seen = set.sightings.iter().map(|seen| way_m(&seen.array_m, &fix.position_m)).sum::<f64>();
            let truth = place(set.t_s - seen / set.sightings.len() as f64 / SOUND_M_S);
            let off = [fix.position_m[0] - truth[0], fix.position_m[1] - truth[1]];
            let [[xx, xy, _], [_, yy, _], _] = fix.covariance_m2;
            let squares = spd::quadratic(&off, &spd::inverse(&[[xx, xy], [xy, yy]]).unwrap(), &off);
            held += f64::from(u8::from(squares < 5.991));
            agree += f64::from(u8::from(fix.consistent));
            n += 1.0;
        }
        assert!(n > 90.0, "{n} positions");
        (found, held / n, agree / n)
    }

    #[test]
    fn arrays_as_said_are_left_alone() {
        for seed in 0..6 {
            for arrays in [2, 3] {
                let (found, held, agree) = judged(&heard(arrays, 0.0, 0.0, seed), &NONE);
                assert_eq!((found.contradicted, found.scatter), (None, None), "seed {seed}, {arrays} arrays");
                assert!(held > 0.85 && agree > 0.97, "seed {seed}, {arrays} arrays: {held} {agree}");
            }
        }
    }

    #[test]
    fn a_turned_array_is_found_or_said() {
        for seed in 0..4 {
            for arrays in [2, 3] {
                for turned in [3.0, 5.0, -8.0] {
                    let (found, held, agree) = judged(&heard(arrays, turned * RAD_PER_DEG, 0.0, seed), &NONE);
                    let what = format!("seed {seed}, {arrays} arrays, {turned}°: {held}");
                    assert!(agree == 0.0 && held > 0.85, "{what}");
                    let (off, sd) = found.contradicted.expect(&what)[1].azimuth;
                    assert!((off - turned * RAD_PER_DEG).abs() < 3.0 * sd, "{what}: {off} {sd}");
                }
            }
        }
    }

    #[test]
    fn a_late_clock_is_found_or_said() {
        // What stays unknown of it is in all positions of a passage alike.
        let mut held_of_all = 0.0;
        for seed in 0..8 {
            for late_s in [5.0, -8.0] {
                let (found, held, agree) = judged(&heard(3, 0.0, late_s, seed), &NONE);
                assert!(agree == 0.0, "seed {seed}, {late_s} s: {:?}", found.scatter);
                held_of_all += held / 16.0;
            }
        }
        assert!(held_of_all > 0.88, "{held_of_all}");
    }

    #[test]
    fn an_error_within_what_is_said_is_in_every_position() {
        let mut held_of_all = 0.0;
        for seed in 0..10 {
            // Two deviations, where the errors are said; and nothing is contradicted.
            let turned = if seed % 2 == 0 { 0.7 } else { -0.7 };
            let (found, held, _) = judged(&heard(2, turned * RAD_PER_DEG, 0.0, seed), &TOLD);
            assert_eq!(found.contradicted, None);
            held_of_all += 0.1 * held;
        }
        assert!(held_of_all > 0.9, "{held_of_all}");
    }
}
