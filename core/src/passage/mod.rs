//! One vessel's passage, bearing by bearing: fixed memory, and work that is asked for in pieces.
//!
//! In: bearings (and elevations) of one vessel in order of time. Out: its straight track with uncertainty, whenever asked.
//! [`Passage`] keeps at most `N` averages (`node`); once they are full, the neighbours over which the bearing turns
//! least are averaged. A few straight lines are kept beside them (`lines`), which take Gauss-Newton steps over all
//! averages and so never keep an early linearisation; fresh ones are started at growing intervals. Taking a bearing only
//! stores it: [`Passage::work`] does what has come due, one piece a call, so that whoever follows several vessels decides
//! when. A speed measured of the vessel enters through [`Config::with_speed`].
//!
//! Assumes a straight track at constant speed and errors that are white plus Gauss-Markov. With [`Config::tails`] single
//! wrong bearings hardly pull: every evaluation of a line weighs each average by its residual, and so does averaging. Cost on the Cortex-M7 with 64
//! averages: `docs/budget.txt`.
//!
//! ```
//! use seabearing_core::passage::{Config, Measurement, Passage};
//! let config = Config { speed_sd_m_s: 0.0, speed_m_s: 7.0, ..Config::default() };
//! let mut passage = Passage::<64>::new();
//! for k in 0..400 {
//!     let t_s = 0.5 * f64::from(k);
//!     // 500 m to the north at t = 100 s, heading east.
//!     let azimuth_rad = libm::atan2(7.0 * (t_s - 100.0), 500.0);
//!     passage.push(&config, &Measurement::azimuth(t_s, azimuth_rad, 1e-4));
//!     passage.work(&config);
//! }
//! let track = passage.finish(&config).unwrap();
//! assert!((track.cpa_range_m - 500.0).abs() < 15.0 && track.starboard);
//! ```

pub(crate) mod declared;
mod known;
mod lines;
mod node;
mod profile;
pub mod report;
mod settings;
mod told;
mod two_lines;

use crate::angle::wrap_pi;
use crate::math::f64 as m;
use crate::motion::model::Limits;
use crate::motion::solution::Solution;
pub(crate) use known::{Known, Prediction};
use lines::{Lines, Link, Problem};
pub use node::Mean;
use node::{Node, TICKS_HZ};
pub(crate) use settings::vessel_depth_m;
pub use settings::{Config, MeasuredSpeed, height_m};

/// Averages the recorder keeps of each vessel: a 200 s passage at two bearings a second is held in spans of about 3 s.
pub const RECORDED: usize = 64;
/// Bearings before the first lines.
const FIRST_SEARCH: u32 = 6;
/// Steps of a fresh line when searched for, and at most of a line polished at the end.
const SEARCH_STEPS: usize = 6;
const POLISH_STEPS: usize = 25;
/// Time between steps of the lines, seconds; every bearing takes one while there are fewer than [`EAGER`].
const REFRESH_S: f64 = 2.0;
const EAGER: u32 = 24;
/// A passage of fewer bearings may have run into a wrong arc. What it refuses within this of its newest bearing, and of
/// what a vessel's bearing usually turns in the time between, has it searched afresh.
const YOUNG: u32 = 40;
const NEAR_RAD: f64 = 0.05;
const DRIFT_RAD_S: f64 = 0.03;
/// Squared residuals of a right line exceed their number by so many standard deviations once in 10⁴.
const CHANCE_SD: f64 = 4.0;
/// Nothing is known better than this, rad² (a hundredth of a degree): keeps every matrix regular.
const LEAST_VARIANCE: f64 = 3e-8;
/// A passage is remembered for a day and a half, seconds; a little less than its ticks can count.
const MEMORY_S: f64 = 131_000.0;

/// One measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Time of reception, s.
    pub t_s: f64,
    /// Azimuth, radians.
    pub azimuth_rad: f64,
    /// Variance its estimator reports, rad².
    pub variance_rad2: f64,
    /// Its extra error in units of the configured one (1 unless known better).
    pub extra_scale: f64,
    /// Elevation and its variance, radians and rad²; used when the height of the vessel above the array is known.
    pub elevation: Option<(f64, f64)>,
}

impl Measurement {
    /// An azimuth alone: time of reception (s), azimuth (radians), variance (rad²).
    pub const fn azimuth(t_s: f64, azimuth_rad: f64, variance_rad2: f64) -> Self {
        Self { t_s, azimuth_rad, variance_rad2, extra_scale: 1.0, elevation: None }
    }

    fn is_sane(&self) -> bool {
        let numbers = [self.t_s, self.azimuth_rad, self.variance_rad2, self.extra_scale];
        numbers.iter().all(|x| x.is_finite()) && self.variance_rad2 >= 0.0 && self.extra_scale >= 0.0
    }
}

/// Work that has come due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    Nothing,
    /// A step of the lines there are.
    Step,
    /// Fresh lines beside them.
    Search,
    /// What other headings cost.
    Profile,
}

/// The memory of one vessel's passage, in `N` averages.
#[derive(Clone, Debug)]
pub struct Passage<const N: usize> {
    origin_s: f64,
    last_s: f64,
    refreshed_s: f64,
    nodes: [Node; N],
    len: usize,
    seen: u32,
    next_search: u32,
    due: Due,
    lines: Lines,
    /// By how many times themselves a solution's variances are too small at least. Nothing in an empty passage is other than zero: an image in flash
    /// needs no place for it.
    misfit: f32,
    /// Standard deviation of the heading by what other headings cost, radians; 0 where that was not asked, or the line's own is right.
    heading_sd: f32,
    /// When that was found, seconds since the first bearing.
    profiled_s: f32,
}

impl<const N: usize> Passage<N> {
    /// Nothing seen yet.
    pub const fn new() -> Self {
        const { assert!(N >= 2, "an average takes two places") };
        Self {
            origin_s: 0.0,
            last_s: 0.0,
            refreshed_s: 0.0,
            nodes: [Node::EMPTY; N],
            len: 0,
            seen: 0,
            next_search: 0,
            due: Due::Nothing,
            lines: Lines::new(),
            misfit: 0.0,
            heading_sd: 0.0,
            profiled_s: 0.0,
        }
    }

    /// Bearings used.
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// Whether so few bearings were used that they may have run into a wrong arc ([`Passage::reconsider`]).
    pub fn is_young(&self) -> bool {
        self.seen < YOUNG
    }

    /// Time of the first bearing remembered and of the newest, s.
    pub fn times_s(&self) -> (f64, f64) {
        (self.origin_s, self.last_s)
    }

    fn nodes(&self) -> &[Node] {
        self.nodes.get(..self.len).unwrap_or(&[])
    }

    /// The averages, oldest first; times count from the first of [`Passage::times_s`].
    pub fn averages(&self) -> impl DoubleEndedIterator<Item = Mean> + '_ {
        self.nodes().iter().map(Node::mean)
    }

    /// What a solution's variances are multiplied by from now on, at least 1: other lines explain the bearings better.
    pub(crate) fn set_misfit(&mut self, times: f64) {
        self.misfit = (times - 1.0).max(0.0) as f32;
    }

    /// The best line, if there is one.
    pub(crate) fn best(&self) -> Option<&Known> {
        self.lines.best()
    }

    /// Takes a measurement of this vessel; the lines stay as they are until [`Passage::work`]. False if it is nonsense or
    /// older than the newest.
    pub fn push(&mut self, config: &Config, measurement: &Measurement) -> bool {
        if !self.keep(config, measurement) {
            return false;
        }
        if self.seen >= self.next_search {
            self.next_search = self.seen.saturating_add(self.seen / 2);
            self.due = Due::Search;
        } else if self.due == Due::Nothing
            && (self.seen < EAGER || self.last_s - self.refreshed_s >= REFRESH_S)
        {
            self.due = Due::Step;
        }
        true
    }

    /// Does what has come due; false if that was nothing.
    pub fn work(&mut self, config: &Config) -> bool {
        let due = core::mem::replace(&mut self.due, Due::Nothing);
        self.refreshed_s = if due == Due::Nothing { self.refreshed_s } else { self.last_s };
        match due {
            Due::Nothing => return false,
            Due::Step => _ = self.improve(config, false, 1),
            Due::Search => _ = self.search(config),
            Due::Profile => self.profile(config),
        }
        if due != Due::Profile && self.is_profile_due() {
            self.due = Due::Profile;
        }
        true
    }

    /// The first half of the end-of-passage solution: fresh lines beside those there are.
    pub fn search(&mut self, config: &Config) -> Option<f64> {
        self.improve(config, true, SEARCH_STEPS)
    }

    /// All lines to convergence. Returns the least weighted squared residual.
    pub fn polish(&mut self, config: &Config) -> Option<f64> {
        self.improve(config, false, POLISH_STEPS)
    }

    /// The end-of-passage solution.
    pub fn finish(&mut self, config: &Config) -> Option<Solution> {
        self.search(config);
        self.conclude(config);
        self.solution(config)
    }

    /// The second half: all lines to convergence, and how far the heading may be from the best one's.
    pub(crate) fn conclude(&mut self, config: &Config) {
        self.polish(config);
        if self.is_profile_due() {
            self.profile(config);
        }
    }

    /// Azimuth expected at a time of reception. Before there is a line: the newest bearing, turning by no more than a
    /// few degrees a second.
    pub(crate) fn predict(&self, config: &Config, t_s: f64) -> Option<Prediction> {
        let coloured_variance = config.errors().0;
        if let Some(best) = self.best() {
            let (azimuth, line_variance) = best.azimuth(config, t_s);
            let known = azimuth.is_finite() && line_variance.is_finite();
            return known.then_some(Prediction { azimuth, line_variance, coloured_variance });
        }
        let last = self.nodes().last()?;
        let drift = DRIFT_RAD_S * (t_s - self.last_s).max(0.0);
        let line_variance = last.white() + drift * drift;
        Some(Prediction { azimuth: last.azimuth(), line_variance, coloured_variance })
    }

    /// The expected azimuth (radians) at a time of reception and its variance (rad²), the measurement's own aside.
    pub fn expected(&self, config: &Config, t_s: f64) -> Option<(f64, f64)> {
        self.predict(config, t_s).map(|p| (p.azimuth, p.variance()))
    }

    /// A measurement that a young passage's lines do not explain, though it lies where the vessel was: they may have run
    /// into a wrong arc. They are searched afresh over all bearings, this one too, which is taken (true) if one explains
    /// them. `None` where this is no case for it, and nothing was searched.
    pub fn reconsider(&mut self, config: &Config, measurement: &Measurement) -> Option<bool> {
        let last = self.nodes().last().filter(|_| self.is_young())?;
        let step = m::abs(wrap_pi(measurement.azimuth_rad - last.azimuth()));
        self.best()?;
        if step > NEAR_RAD + DRIFT_RAD_S * (measurement.t_s - self.last_s).max(0.0) {
            return None;
        }
        let mut all = self.clone();
        all.lines = Lines::new();
        if !all.keep(config, measurement) {
            return Some(false);
        }
        all.search(config);
        let freedom = all.measurements();
        let most = freedom + CHANCE_SD * m::sqrt(2.0 * freedom);
        let explained = all.polish(config).is_some_and(|cost| cost < most);
        if explained {
            *self = all;
        }
        Some(explained)
    }

    /// Cuts at a time if two lines, one before it and one after, explain the bearings better than the best single one
    /// by `gain` in weighted squared residual: what is older stays here, what is newer is returned as a passage of its
    /// own. The single line is taken as it stands ([`Passage::search`] and [`Passage::polish`] come before).
    pub(crate) fn split(&mut self, config: &Config, t_s: f64, gain: f64) -> Option<Self> {
        let cut = self.nodes().iter().filter(|n| self.origin_s + n.t_s() < t_s).count();
        let links = self.links(config);
        let whole = self.problem(config, &links).evaluate(&self.best()?.line)?.cost();
        let part = |mut lines: Lines, from: usize, to: usize| -> Option<(Lines, f64)> {
            let nodes = self.nodes.get(from..to)?;
            let times_s = (self.origin_s + nodes.first()?.t_s(), self.origin_s + nodes.last()?.t_s());
            let limits = Limits { times_s, ..self.limits(config) };
            let links = links.get(from..to)?;
            let problem = Problem { config, origin_s: self.origin_s, nodes, links, limits };
            lines.improve(&problem, true, SEARCH_STEPS)?;
            let cost = lines.improve(&problem, false, POLISH_STEPS)?;
            Some((lines, cost))
        };
        let (older, cost_older) = part(self.lines.clone(), 0, cut)?;
        let (newer, cost_newer) = part(Lines::new(), cut, self.len)?;
        (whole - cost_older - cost_newer > gain).then(|| {
            let newer = self.taken(cut, newer);
            (self.lines, self.misfit) = (older, 0.0);
            newer
        })
    }

    /// Moves the averages from place `cut` on into a passage of their own with these lines.
    #[inline(never)]
    fn taken(&mut self, cut: usize, lines: Lines) -> Self {
        let mut newer = Self { lines, last_s: self.last_s, refreshed_s: self.last_s, ..Self::new() };
        let from = self.nodes().get(cut).map_or(0, Node::ticks);
        newer.origin_s = self.origin_s + f64::from(from) / TICKS_HZ;
        for (slot, node) in newer.nodes.iter_mut().zip(self.nodes.iter().take(self.len).skip(cut)) {
            *slot = node.shifted(from);
            newer.len += 1;
            newer.seen = newer.seen.saturating_add(u32::from(node.count()));
        }
        newer.next_search = newer.seen.max(FIRST_SEARCH);
        self.len = cut;
        self.seen = self.nodes().iter().map(|n| u32::from(n.count())).sum();
        let end = |n: &Node| self.origin_s + n.t_s() + 0.5 * n.span_s();
        self.last_s = self.nodes().last().map_or(self.origin_s, end);
        newer
    }

    /// Adds a measurement to what is kept.
    fn keep(&mut self, config: &Config, measurement: &Measurement) -> bool {
        let Measurement { t_s, azimuth_rad, variance_rad2, extra_scale, elevation } = *measurement;
        if !measurement.is_sane() || (self.seen > 0 && t_s < self.last_s) {
            return false;
        }
        if self.seen == 0 {
            (self.origin_s, self.refreshed_s, self.next_search) = (t_s, t_s, FIRST_SEARCH);
        }
        if t_s - self.origin_s > MEMORY_S {
            self.forget(t_s);
        }
        if self.len >= N {
            self.merge(config);
        }
        let white = (variance_rad2 + config.errors().2 * extra_scale * extra_scale).max(LEAST_VARIANCE);
        let elevation = elevation
            .filter(|(e, v)| config.medium.height_m > 0.0 && e.is_finite() && *v > 0.0)
            .unwrap_or((0.0, f64::INFINITY));
        let mean = Mean {
            t_s: t_s - self.origin_s,
            azimuth: azimuth_rad,
            white,
            scale: extra_scale,
            elevation,
            count: 1,
            span_s: 0.0,
        };
        if let Some(slot) = self.nodes.get_mut(self.len) {
            *slot = Node::new(&mean);
            self.len += 1;
        }
        (self.last_s, self.seen) = (t_s, self.seen.saturating_add(1));
        true
    }

    /// Forgets what is older than half the memory.
    fn forget(&mut self, t_s: f64) {
        let oldest = t_s - 0.5 * MEMORY_S - self.origin_s;
        let gone = self.nodes().iter().filter(|n| n.t_s() < oldest).count();
        let from = self.nodes().get(gone).map(Node::ticks);
        let kept = self.len.saturating_sub(gone);
        to_front(&mut self.nodes, gone);
        self.len = kept;
        for node in self.nodes.iter_mut().take(kept) {
            *node = node.shifted(from.unwrap_or(0));
        }
        self.origin_s = from.map_or(t_s, |ticks| self.origin_s + f64::from(ticks) / TICKS_HZ);
    }

    /// Merges the pair of neighbours whose average loses least: an average over a span `D` errs by `α̈ D²/24`.
    fn merge(&mut self, config: &Config) {
        let line = self.best().map(|b| b.line);
        let q = line.map_or(0.0, |l| m::exp(l.p[2]));
        let t_c = line.map_or(0.0, |l| l.p[1]) - self.origin_s;
        let mut best = (f64::INFINITY, 0usize);
        for (i, pair) in self.nodes().windows(2).enumerate() {
            let [a, b] = pair else { continue };
            let span = b.t_s() - a.t_s() + 0.5 * (a.span_s() + b.span_s());
            let x = q * (0.5 * (a.t_s() + b.t_s()) - t_c);
            let g = q / (1.0 + x * x);
            let loss = span * span * (g * g * (1.0 + 2.0 * m::abs(x)) + 1e-9);
            if loss < best.0 {
                best = (loss, i);
            }
        }
        let i = best.1;
        let (Some(a), Some(b)) = (self.nodes.get(i), self.nodes.get(i + 1)) else { return };
        let doubted = |node: &Node| line.map_or(*node, |line| node.doubted(config, self.origin_s, &line));
        let joined = doubted(a).joined(&doubted(b), config.errors().0);
        if let Some(slot) = self.nodes.get_mut(i) {
            *slot = joined;
        }
        if let Some(rest) = self.nodes.get_mut(i + 1..self.len) {
            to_front(rest, 1);
        }
        self.len = self.len.saturating_sub(1);
    }

    fn limits(&self, config: &Config) -> Limits {
        config.search_limits(self.times_s(), (self.seen as usize) < N)
    }

    fn links(&self, config: &Config) -> [Link; N] {
        let tau_s = config.errors().1;
        let mut links = [Link::NONE; N];
        let mut before_s = 0.0;
        for (link, node) in links.iter_mut().zip(self.nodes()) {
            *link = Link::new(node, node.t_s() - before_s, tau_s);
            before_s = node.t_s();
        }
        links
    }

    fn problem<'a>(&'a self, config: &'a Config, links: &'a [Link; N]) -> Problem<'a> {
        let limits = self.limits(config);
        Problem { config, origin_s: self.origin_s, nodes: self.nodes(), links, limits }
    }

    /// Averaged azimuths and elevations.
    fn measurements(&self) -> f64 {
        let elevations = self.nodes().iter().filter(|n| n.elevation().is_some()).count();
        (self.len + elevations) as f64
    }

    fn improve(&mut self, config: &Config, fresh: bool, steps: usize) -> Option<f64> {
        let links = self.links(config);
        let mut lines = core::mem::replace(&mut self.lines, Lines::new());
        let least = lines.improve(&self.problem(config, &links), fresh, steps);
        self.lines = lines;
        least
    }
}

/// Moves the items from place `from` on to the front, in order. `rotate_left` keeps a panic path wherever the compiler does
/// not write it out in place.
pub(crate) fn to_front<T: Copy>(items: &mut [T], from: usize) {
    for k in 0..items.len() {
        let Some(item) = items.get(k.saturating_add(from)).copied() else { break };
        if let Some(place) = items.get_mut(k) {
            *place = item;
        }
    }
}

#[cfg(test)]
mod tests;
