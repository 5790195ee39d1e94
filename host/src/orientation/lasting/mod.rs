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
//! Clocks are told against that of the first station, or of the next where that takes less of all others; what is said of that clock itself
//! is in the positions along the vessel's way. A station that contradicts the
//! others in most of the positions is left out of all of them: instant by instant it would now and then take another with it.
//!
//! Where no position has more angles than it needs nothing tells of them, and an error looks like a vessel somewhere else: what is
//! allowed by the file, or usual, is in every position then ([`Positions::checked`]).
//!
//! Every position is made anew from bearings without `u`, and what stays unknown of `u` is in its covariance: an orientation's
//! error is in every position alike, and no number of them averages it out.

mod instant;

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
/// Deviations of its own and its prior's from which on what was found is no chance: with two stations one in a thousand passages has
/// one beyond it, with eight stations one in two hundred.
const SURPRISING: f64 = 3.6;
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
    let mut best = Fitted::simplest(&all, settings, shared, None);
    let at_first = best.aside();
    let left_out = at_first.iter().position(|(of, n)| *of >= LEAST_FIXES && *n as f64 > MOSTLY * *of as f64);
    let rest = left_out.map(|station| sets.iter().map(|set| set.without(station)).collect::<Vec<_>>());
    let heard = Heard { sets: rest.as_deref().unwrap_or(sets), ..all };
    if left_out.is_some() {
        best = Fitted::simplest(&heard, settings, shared, None);
    }
    let mut made = best.fixes.iter().flatten().peekable();
    let checked = made.peek().is_none() || made.any(|fix| fix.freedom > 0);
    let told = best.unknowns().max(1.0);
    let excess = best.excess();
    let surprising = best.surprising(shared);
    let contradict = excess > misfit_limit(told.ceil() as u32) || surprising != *shared;
    if contradict {
        // Errors beyond what was allowed first may explain all.
        let growth = (excess / told).sqrt().max(1.0);
        let grown =
            surprising.map(|s| SharedError { azimuth: growth * s.azimuth, clock_s: growth * s.clock_s });
        best = Fitted::simplest(&heard, settings, &grown, None);
        best = best.against_the_right_clock(&heard, &grown, |found, k| found.told(shared)[k].beyond.1);
    }
    let mut untold = [Lasting::NONE; MAX_ARRAYS];
    let mut clock_of = best.clock_of;
    if !contradict && checked && said != shared {
        let wide = wider(shared, said, (excess / told).sqrt().max(1.0));
        let shows = |found: &Fitted, k: usize| found.stands_out(MAX_ARRAYS + k) > SHOWN;
        let found = Fitted::of(&heard, &best.settings, &wide, None);
        let found = found.against_the_right_clock(&heard, &wide, shows);
        best = Fitted::of(&heard, &best.settings, said, None);
        // One station's orientation and another's clock stand for each other: of all that nobody told of what was found counts, or of none.
        if found.shows_untold(said) {
            (untold, clock_of) = (found.untold(said), found.clock_of);
            best.count(&found, said);
        }
    }
    heard.bar.finish_and_clear();
    let contradicted = contradict.then(|| best.told(shared));
    let within = if contradict { [Lasting::NONE; MAX_ARRAYS] } else { best.within(said) };
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
    /// The station against whose clock the others' are told, and the deviation of that.
    clock_of: Option<usize>,
    clock_sd_s: f64,
    state: [f64; N],
    covariance: Square<N>,
    misfit: f64,
    freedom: f64,
    /// Variance of a mean of residuals over that of as many independent ones.
    common: f64,
    /// Positions that told something.
    used: usize,
}

impl Fitted {
    /// With no array set aside, where errors that last explain what they disagree in; else instant by instant.
    /// `clock_of`: the station against whose clock the others' are told; else the first.
    fn simplest(
        heard: &Heard<'_>,
        settings: &FixSettings,
        shared: &[SharedError; MAX_ARRAYS],
        clock_of: Option<usize>,
    ) -> Self {
        let whole = Self::of(heard, &FixSettings { robust: false, ..*settings }, shared, clock_of);
        if whole.explains() || !settings.robust { whole } else { Self::of(heard, settings, shared, clock_of) }
    }

    fn of(
        heard: &Heard<'_>,
        settings: &FixSettings,
        shared: &[SharedError; MAX_ARRAYS],
        clock_of: Option<usize>,
    ) -> Self {
        let mut prior = [0.0; N];
        for (k, of) in shared.iter().enumerate() {
            (prior[k], prior[MAX_ARRAYS + k]) = (of.azimuth, of.clock_s);
        }
        let first = heard.sets.iter().flat_map(|set| &set.stations).min().copied();
        let clock_of = clock_of.or(first);
        let clock_sd_s = clock_of.map_or(0.0, |k| core::mem::take(&mut prior[MAX_ARRAYS + k]));
        let mut new = Self {
            settings: *settings,
            sets: heard.sets.to_vec(),
            fixes: heard.located(heard.sets, settings),
            velocities: Vec::new(),
            prior,
            clock_of,
            clock_sd_s,
            state: [0.0; N],
            covariance: identity(),
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

    /// Where the clocks of all but the first of three or more stations are `off`, it is mostly the clock they are told against: the fit with
    /// the second's in its place, if less is then off.
    fn against_the_right_clock(
        self,
        heard: &Heard<'_>,
        shared: &[SharedError; MAX_ARRAYS],
        off: impl Fn(&Self, usize) -> bool,
    ) -> Self {
        let is_heard = |k: &usize| self.sets.iter().any(|set| set.stations.contains(k));
        let others: Vec<usize> = (0..MAX_ARRAYS).filter(is_heard).skip(1).collect();
        let next = others.first().filter(|_| others.len() >= 2 && others.iter().all(|k| off(&self, *k)));
        let Some(next) = next.copied() else { return self };
        let other = Self::simplest(heard, &self.settings, shared, Some(next));
        if other.excess() < self.excess() { other } else { self }
    }

    /// What was said, and of what the bearings contradict as much as it would have to be. An error that the bearings tell to a deviation `σ` has, where
    /// the prior holds, a mean of `w` priors with the variance `1 − C` of them (`C`: what is left of the prior's); without the prior it is
    /// `w / (1 − C)`. So a clock that is said to be right to a millisecond shows what it is, though by its prior it moved by nothing.
    fn surprising(&self, said: &[SharedError; MAX_ARRAYS]) -> [SharedError; MAX_ARRAYS] {
        let grown = |k: usize, said: f64| {
            let told = 1.0 - self.covariance[k][k];
            let by = self.state[k].abs();
            if told > f64::EPSILON && by > SURPRISING * told.sqrt() {
                said * (by / told).max(1.0)
            } else {
                said
            }
        };
        let mut all = core::array::from_fn(|k| SharedError {
            azimuth: grown(k, said[k].azimuth),
            clock_s: grown(MAX_ARRAYS + k, said[k].clock_s),
        });
        // Where a clock is late against another, either may be the wrong one.
        let late = all.iter().zip(said).filter(|(all, said)| all.clock_s > said.clock_s);
        let late_s = late.map(|(all, _)| all.clock_s).fold(0.0, f64::max);
        if let Some(k) = self.clock_of {
            all[k].clock_s = all[k].clock_s.max(late_s);
        }
        all
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
        said.iter().enumerate().any(|(k, said)| {
            said.azimuth <= 0.0 && self.stands_out(k) > SHOWN
                || said.clock_s <= 0.0 && self.stands_out(MAX_ARRAYS + k) > SHOWN
        })
    }

    /// What was found of one error in its own deviations.
    fn stands_out(&self, k: usize) -> f64 {
        self.state[k].abs() / self.covariance[k][k].sqrt().max(f64::MIN_POSITIVE)
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
        for (k, (of, said)) in all.iter_mut().zip(said).enumerate() {
            let sure = |k: usize, said: f64| counts(said) && self.stands_out(k) > SURE;
            of.beyond = (sure(k, said.azimuth), sure(MAX_ARRAYS + k, said.clock_s));
        }
        all
    }

    /// Counts what another fit found of errors that nobody told of, and what it leaves unknown of all, in the positions' errors.
    fn count(&mut self, found: &Self, said: &[SharedError; MAX_ARRAYS]) {
        let untold: [f64; N] = core::array::from_fn(|k| {
            let said = &said[k % MAX_ARRAYS];
            let told = if k < MAX_ARRAYS { said.azimuth } else { said.clock_s };
            if told > 0.0 { 0.0 } else { found.state[k] }
        });
        (self.prior, self.clock_sd_s) = (found.prior, found.clock_sd_s);
        self.covariance = found.covariance;
        for (row, a) in self.covariance.iter_mut().zip(untold) {
            for (x, b) in row.iter_mut().zip(untold) {
                *x += a * b;
            }
        }
    }

    fn told(&self, shared: &[SharedError; MAX_ARRAYS]) -> [Lasting; MAX_ARRAYS] {
        let of = |k: usize| (self.prior[k] * self.state[k], self.prior[k] * self.covariance[k][k].sqrt());
        let one = |k: usize| {
            let (azimuth, clock_s) = (of(k), of(MAX_ARRAYS + k));
            let beyond = (
                azimuth.0.abs() > NAMED * azimuth.1.max(shared[k].azimuth).max(f64::MIN_POSITIVE),
                clock_s.0.abs() > NAMED * clock_s.1.max(shared[k].clock_s).max(f64::MIN_POSITIVE),
            );
            Lasting { azimuth, clock_s, beyond }
        };
        core::array::from_fn(one)
    }

    /// Mean square of the error of the clock that the others' are told against, seconds²: its prior, and those of the others, which are late by as
    /// much more than it as was found.
    fn clock_s2(&self) -> f64 {
        let is_heard =
            |k: &usize| self.clock_of != Some(*k) && self.sets.iter().any(|s| s.stations.contains(k));
        let others = || (0..MAX_ARRAYS).filter(is_heard).map(|k| MAX_ARRAYS + k);
        if self.clock_sd_s <= 0.0 {
            return 0.0;
        }
        let (mut weight, mut pull) = (self.clock_sd_s.powi(-2), 0.0);
        for k in others().filter(|k| self.prior[*k] > 0.0) {
            let of = 1.0 / (self.prior[k].powi(2) * (1.0 + self.covariance[k][k]));
            weight += of;
            pull -= of * self.prior[k] * self.state[k];
        }
        (pull / weight).powi(2) + 1.0 / weight
    }

    /// The positions, what lasts in their covariances. `noise`: what the residuals show more than was claimed.
    fn stated(self, noise: f64, agree: bool) -> Vec<Result<Fix, NetworkError>> {
        let clock_s2 = self.clock_s2();
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
            for (row, a) in fix.covariance_m2.iter_mut().zip(v.m_s) {
                for (x, b) in row.iter_mut().zip(v.m_s) {
                    *x += clock_s2 * a * b;
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

fn identity() -> Square<N> {
    core::array::from_fn(|k| core::array::from_fn(|l| if k == l { 1.0 } else { 0.0 }))
}

#[cfg(test)]
mod tests;
