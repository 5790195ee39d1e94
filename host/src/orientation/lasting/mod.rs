//! What the positions of many instants tell of their arrays: errors of orientation and clock, which last.
//!
//! At one instant an array that is turned, or whose clock is late, looks like a vessel somewhere else: all of its error goes
//! into the position. Over many instants the arrays show it. With residuals `r` of the angles about the positions, their
//! gradients `g` by position and `j` by the lasting errors `u` (all over the angles' deviations), positions drop out of the
//! normal equations (Schur's complement): `A = Σ (jᵀj − jᵀg (gᵀg)⁻¹ gᵀj)`, `h` likewise with `r`. `u` has Gaussian priors, what
//! the network file says of orientation and clock, and is the solution of `(A/κ + P⁻¹) u = h/κ`. `κ` is the variance that the
//! residuals show over the one claimed, with what successive ones have in common.
//!
//! What nobody told a prior of is looked for with a usual one. Where any of it shows, by two of its own deviations, it is in the positions' errors as it
//! was found; it is not taken out of them, for elevations or a depth that are off look like it.
//!
//! Errors that are larger than their priors allow are a contradiction: it is said, and the priors grow until they allow them.
//! Every clock is an unknown, none is right by itself: how late all are alike stays as unknown as it was said to be, and is in the positions along the
//! vessel's way. They are told against that of the first station, or of the one against which the fewest others are off. A station that contradicts the
//! others in most of the positions is left out of all of them: instant by instant it would now and then take another with it.
//!
//! Where no position has more angles than it needs nothing tells of them, and an error looks like a vessel somewhere else: what is
//! allowed by the file, or usual, is in every position then ([`Positions::checked`]).
//!
//! Every position is made anew from bearings without `u`, and what stays unknown of `u` is in its covariance: an orientation's
//! error is in every position alike, and no number of them averages it out.

mod instant;
mod surprise;

use super::sets::SightingSet;
use super::way::Way;
use crate::progress;
use instant::{N, Sums, Velocity, distance_m, sums, velocities, without};
use seabearing_core::kit::spd::{self, Square};
use seabearing_locate::network::joint::SharedError;
use seabearing_locate::network::locate::{LARGEST_RELATIVE_SD, misfit_limit};
use seabearing_locate::network::{Fix, FixSettings, MAX_ARRAYS, NetworkError, locate};

/// Fewest positions that tell of errors that last.
const LEAST_FIXES: usize = 20;
/// Most that successive residuals are taken to have in common.
const MOST_COMMON: f64 = 0.95;
/// Most linear steps, which bearings need where they turn with the error of a clock, and the least one that is followed by
/// another, in deviations.
const STEPS: usize = 20;
const LEAST_STEP: f64 = 0.05;
/// Longest step, in deviations.
const LONGEST_STEP: f64 = 0.5;
/// Residuals' variance over the claimed one up to which lasting errors explain what arrays disagree in, so that no array is to
/// be set aside instant by instant.
const EXPLAINED: f64 = 1.5;
/// Least of it that is believed.
const LEAST_NOISE: f64 = 1e-3;
/// Share of the positions of three or more stations in which one is set aside, beyond which it is left out of all.
const MOSTLY: f64 = 0.5;
/// Own deviations from which on an error shows that nobody told of.
const SHOWN: f64 = 2.0;
/// Own deviations from which on that is worth a line.
const SURE: f64 = 3.3;
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

impl Lasting {
    const NONE: Self = Self { azimuth: (0.0, 0.0), clock_s: (0.0, 0.0), beyond: (false, false) };
}

/// Positions, and what they tell of the arrays.
pub struct Positions {
    /// What they rest on: the bearings without those of a station that is left out.
    pub sets: Vec<SightingSet>,
    /// One a set.
    pub fixes: Vec<Result<Fix, NetworkError>>,
    /// Whether any position has more angles than it needs, so that orientations and clocks can show.
    pub checked: bool,
    /// Of each station, where the stations contradict each other.
    pub contradicted: Option<[Lasting; MAX_ARRAYS]>,
    /// The station against whose clock the others' are told.
    pub clock_of: Option<usize>,
    /// Errors that nobody told of, within what is usual, that are sure to be there (the others are not `beyond`): no position agrees with the
    /// arrays as they were told. They are in the positions' errors.
    pub untold: [Lasting; MAX_ARRAYS],
    /// Errors within what was said of them that are sure to be there (the others are not `beyond`): they are taken out of the positions.
    pub within: [Lasting; MAX_ARRAYS],
    /// Variance of the residuals over the claimed one, where that is more than chance.
    pub scatter: Option<f64>,
    /// The station that is left out.
    pub left_out: Option<usize>,
    /// Of each station, in how many positions of three or more stations it is, and in how many of these it is set aside.
    pub aside: [(usize, usize); MAX_ARRAYS],
}

/// Positions of all sets. `shared`: deviations of what the bearings of each station share, `said`: those among them that
/// somebody told, 0 where nobody did. What is not told is looked for, and is in no position unless it shows. A position is
/// where the vessel was one mean way of the sound before the set's time ([`Way::mean_s`]). Where nothing checks them
/// ([`Positions::checked`]) all of `shared` is in every position.
pub fn positions(
    sets: &[SightingSet],
    settings: &FixSettings,
    shared: &[SharedError; MAX_ARRAYS],
    said: &[SharedError; MAX_ARRAYS],
    way: Way,
) -> Positions {
    let all = Heard { sets, way, bar: progress::bar(0, "fixes") };
    let mut best = Fitted::simplest(&all, settings, shared);
    let at_first = best.aside();
    let left_out = at_first.iter().position(|(of, n)| *of >= LEAST_FIXES && *n as f64 > MOSTLY * *of as f64);
    let rest = left_out.map(|station| sets.iter().map(|set| set.without(station)).collect::<Vec<_>>());
    let heard = Heard { sets: rest.as_deref().unwrap_or(sets), ..all };
    if left_out.is_some() {
        best = Fitted::simplest(&heard, settings, shared);
    }
    let mut made = best.fixes.iter().flatten().peekable();
    let checked = made.peek().is_none() || made.any(|fix| fix.freedom > 0);
    let told = best.unknowns().max(1.0);
    let excess = best.excess();
    let contradicts =
        |fitted: &Fitted| fitted.excess() > misfit_limit(fitted.unknowns().max(1.0).ceil() as u32);
    let free = Fitted::simplest(&heard, settings, &surprise::free(shared));
    let surprising = surprise::surprising(&free, shared);
    let contradict = contradicts(&best) || surprising != *shared;
    if contradict {
        // One error that is larger than was said may explain all; else all first may be.
        best = Fitted::simplest(&heard, settings, &surprising);
        if contradicts(&best) {
            let growth = (best.excess() / best.unknowns().max(1.0)).sqrt().max(1.0);
            let grown =
                surprising.map(|s| SharedError { azimuth: growth * s.azimuth, clock_s: growth * s.clock_s });
            best = Fitted::simplest(&heard, settings, &grown);
        }
    }
    let mut untold = [Lasting::NONE; MAX_ARRAYS];
    let mut clock_of = best.clock_of(shared);
    let mut within = if contradict { [Lasting::NONE; MAX_ARRAYS] } else { best.within(said) };
    if !contradict && checked && said != shared {
        let wide = wider(shared, said, (excess / told).sqrt().max(1.0));
        let found = Fitted::of(&heard, &best.settings, &wide);
        best = Fitted::of(&heard, &best.settings, said);
        (clock_of, within) = (best.clock_of(said), best.within(said));
        // One station's orientation and another's clock stand for each other: of all that nobody told of what was found counts, or of none.
        if found.shows_untold(said) {
            (untold, clock_of, within) = (found.untold(said), found.clock_of(said), found.within(said));
            best.count(&found);
        }
    }
    heard.bar.finish_and_clear();
    let contradicted = contradict.then(|| best.told(shared));
    let others = best.aside();
    let aside = core::array::from_fn(|k| if left_out == Some(k) { at_first[k] } else { others[k] });
    let scatter = best.scatter();
    let as_told = untold.iter().all(|of| of.beyond == (false, false));
    let agree = contradicted.is_none() && scatter.is_none() && as_told;
    let fixes = best.stated(scatter.unwrap_or(1.0), agree);
    let sets = heard.sets.to_vec();
    Positions { sets, fixes, checked, contradicted, clock_of, untold, within, scatter, left_out, aside }
}

/// The same deviations, those that nobody told of as many times as wide.
fn wider(
    shared: &[SharedError; MAX_ARRAYS],
    said: &[SharedError; MAX_ARRAYS],
    times: f64,
) -> [SharedError; MAX_ARRAYS] {
    let one = |shared: f64, said: f64| if said > 0.0 { shared } else { times * shared };
    core::array::from_fn(|k| SharedError {
        azimuth: one(shared[k].azimuth, said[k].azimuth),
        clock_s: one(shared[k].clock_s, said[k].clock_s),
    })
}

/// What was heard, and how far it is.
struct Heard<'a> {
    sets: &'a [SightingSet],
    way: Way,
    bar: progress::ProgressBar,
}

impl Heard<'_> {
    fn located(&self, sets: &[SightingSet], settings: &FixSettings) -> Vec<Result<Fix, NetworkError>> {
        self.bar.inc_length(sets.len() as u64);
        let fix = |set: &SightingSet| {
            self.bar.inc(1);
            locate(&set.sightings, settings)
        };
        sets.iter().map(fix).collect()
    }
}

/// Sets without the errors that last, and what is known of these.
struct Fitted {
    settings: FixSettings,
    sets: Vec<SightingSet>,
    fixes: Vec<Result<Fix, NetworkError>>,
    velocities: Vec<Velocity>,
    prior: [f64; N],
    state: [f64; N],
    covariance: Square<N>,
    /// What the bearings alone tell of the errors, in units of their priors: `A/κ`, and `A/κ` times what they say the errors are.
    information: Square<N>,
    pull: [f64; N],
    misfit: f64,
    freedom: f64,
    /// Variance of a mean of residuals over that of as many independent ones.
    common: f64,
    /// Positions that told something.
    used: usize,
}

impl Fitted {
    /// With no array set aside, where errors that last explain what they disagree in; else instant by instant.
    fn simplest(heard: &Heard<'_>, settings: &FixSettings, shared: &[SharedError; MAX_ARRAYS]) -> Self {
        let whole = Self::of(heard, &FixSettings { robust: false, ..*settings }, shared);
        if whole.explains() || !settings.robust { whole } else { Self::of(heard, settings, shared) }
    }

    fn of(heard: &Heard<'_>, settings: &FixSettings, shared: &[SharedError; MAX_ARRAYS]) -> Self {
        let mut prior = [0.0; N];
        for (k, of) in shared.iter().enumerate() {
            (prior[k], prior[MAX_ARRAYS + k]) = (of.azimuth, of.clock_s);
        }
        let mut new = Self {
            settings: *settings,
            sets: heard.sets.to_vec(),
            fixes: heard.located(heard.sets, settings),
            velocities: Vec::new(),
            prior,
            state: [0.0; N],
            covariance: identity(),
            information: [[0.0; N]; N],
            pull: [0.0; N],
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
            for (set, (given, (fix, v))) in new.sets.iter_mut().zip(heard.sets.iter().zip(places)) {
                *set = without(given, &new.prior, &new.state, v, fix.as_ref().ok(), &heard.way);
            }
            new.fixes = heard.located(&new.sets, settings);
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
            self.information = information.map(|row| row.map(|x| x / noise));
            self.pull = right;
            let change: [f64; N] = core::array::from_fn(|k| self.state[k] - before[k]);
            self.misfit =
                misfit - 2.0 * spd::dot(&change, &pull) + spd::quadratic(&change, &information, &change);
            self.freedom = freedom;
            self.common = self.shared_by_successive(&change);
            noise = (self.misfit / freedom).max(LEAST_NOISE) * self.common;
        }
        // Far from where it leads to a step is not linear.
        let longest =
            self.state.iter().zip(&before).map(|(now, before)| (now - before).abs()).fold(0.0, f64::max);
        if longest > LONGEST_STEP {
            for (now, before) in self.state.iter_mut().zip(&before) {
                *now = before + (*now - before) * LONGEST_STEP / longest;
            }
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
            sums(set, fix, v, &self.prior)
        })
    }

    /// Of each station, in how many positions of three or more it is, and in how many of these it is set aside.
    fn aside(&self) -> [(usize, usize); MAX_ARRAYS] {
        let mut out = [(0, 0); MAX_ARRAYS];
        let found = self.sets.iter().zip(&self.fixes).filter(|(set, _)| set.stations.len() >= 3);
        for (set, fix) in found.filter_map(|(set, fix)| Some((set, fix.as_ref().ok()?))) {
            for (k, station) in set.stations.iter().enumerate() {
                out[*station].0 += 1;
                out[*station].1 += usize::from(fix.rejected == Some(k));
            }
        }
        out
    }

    /// Squares of what was found of the arrays, in deviations of what was allowed.
    fn excess(&self) -> f64 {
        self.state.iter().map(|w| w * w).sum()
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

    /// Whether any error shows of those that nobody told of.
    fn shows_untold(&self, said: &[SharedError; MAX_ARRAYS]) -> bool {
        let of = self.told(said);
        of.iter().zip(said).any(|(of, said)| {
            said.azimuth <= 0.0 && stands_out(of.azimuth) > SHOWN
                || said.clock_s <= 0.0 && stands_out(of.clock_s) > SHOWN
        })
    }

    /// What was found of each station; `beyond` where nobody told of it and it is sure to be there.
    fn untold(&self, said: &[SharedError; MAX_ARRAYS]) -> [Lasting; MAX_ARRAYS] {
        self.sure(said, |said| said <= 0.0)
    }

    /// The same of what somebody told of.
    fn within(&self, said: &[SharedError; MAX_ARRAYS]) -> [Lasting; MAX_ARRAYS] {
        self.sure(said, |said| said > 0.0)
    }

    /// What was found of each station; `beyond` where it is sure to be there and `counts`, by what was said of it.
    fn sure(&self, said: &[SharedError; MAX_ARRAYS], counts: impl Fn(f64) -> bool) -> [Lasting; MAX_ARRAYS] {
        let mut all = self.told(said);
        for (of, said) in all.iter_mut().zip(said) {
            let sure = |of: (f64, f64), said: f64| counts(said) && stands_out(of) > SURE;
            of.beyond = (sure(of.azimuth, said.azimuth), sure(of.clock_s, said.clock_s));
        }
        all
    }

    /// Counts in the positions' errors by how much another fit, in which what nobody told of is looked for, finds other errors, and what it leaves
    /// unknown of all.
    fn count(&mut self, found: &Self) {
        // Of what nobody told of nothing is taken out here; of the rest the priors are the same.
        let other: [f64; N] =
            core::array::from_fn(|k| found.state[k] - if self.prior[k] > 0.0 { self.state[k] } else { 0.0 });
        self.prior = found.prior;
        self.covariance = found.covariance;
        for (row, a) in self.covariance.iter_mut().zip(other) {
            for (x, b) in row.iter_mut().zip(other) {
                *x += a * b;
            }
        }
    }

    /// What was found of each station, clocks against one of them.
    fn told(&self, said: &[SharedError; MAX_ARRAYS]) -> [Lasting; MAX_ARRAYS] {
        self.clock_of(said).map_or([Lasting::NONE; MAX_ARRAYS], |of| self.told_against(said, of))
    }

    fn told_against(&self, said: &[SharedError; MAX_ARRAYS], of: usize) -> [Lasting; MAX_ARRAYS] {
        let one = |k: usize| {
            let azimuth = (self.prior[k] * self.state[k], self.prior[k] * self.covariance[k][k].sqrt());
            let mut against = [0.0; N];
            against[MAX_ARRAYS + k] += self.prior[MAX_ARRAYS + k];
            against[MAX_ARRAYS + of] -= self.prior[MAX_ARRAYS + of];
            let variance = spd::quadratic(&against, &self.covariance, &against);
            let clock_s = (spd::dot(&against, &self.state), variance.max(0.0).sqrt());
            let both = said[k].clock_s.hypot(said[of].clock_s);
            let beyond = |x: (f64, f64), said: f64| x.0.abs() > NAMED * x.1.max(said).max(f64::MIN_POSITIVE);
            Lasting { azimuth, clock_s, beyond: (beyond(azimuth, said[k].azimuth), beyond(clock_s, both)) }
        };
        core::array::from_fn(|k| if self.is_heard(k) { one(k) } else { Lasting::NONE })
    }

    /// The station against whose clock the others' are told: the one against which the fewest are off, of as many the first.
    fn clock_of(&self, said: &[SharedError; MAX_ARRAYS]) -> Option<usize> {
        let off = |of: &usize| {
            let all = self.told_against(said, *of);
            all.iter().filter(|of| stands_out(of.clock_s) > NAMED).count()
        };
        (0..MAX_ARRAYS).filter(|k| self.is_heard(*k)).min_by_key(off)
    }

    fn is_heard(&self, station: usize) -> bool {
        self.sets.iter().any(|set| set.stations.contains(&station))
    }

    /// The positions, what lasts in their covariances. `noise`: what the residuals show more than was claimed.
    fn stated(self, noise: f64, agree: bool) -> Vec<Result<Fix, NetworkError>> {
        let state = |((set, fix), v): ((&SightingSet, Result<Fix, NetworkError>), &Velocity)| {
            let mut fix = fix?;
            let own = if fix.consistent { 1.0 } else { fix.misfit / f64::from(fix.freedom.max(1)) };
            let grown = (noise / own).max(1.0);
            fix.covariance_m2.iter_mut().flatten().for_each(|x| *x *= grown);
            if let Some(sums) = sums(set, &fix, v, &self.prior) {
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
        self.sets.iter().zip(self.fixes).zip(&self.velocities).map(state).collect()
    }
}

/// What was found in its own deviations.
fn stands_out((found, sd): (f64, f64)) -> f64 {
    found.abs() / sd.max(f64::MIN_POSITIVE)
}

fn identity() -> Square<N> {
    core::array::from_fn(|k| core::array::from_fn(|l| if k == l { 1.0 } else { 0.0 }))
}

#[cfg(test)]
mod tests;
