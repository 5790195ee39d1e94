//! One vessel's straight-track fit in 2.3 KiB: averaged bearings in single precision, with elevations where they tell
//! range, lines, the best line's covariance.
//!
//! The model, the whitening and the descent are those of [`crate::motion`]; what differs from its own recursive filter
//! is what is kept: the normal equations live only within a call, and a bearing's errors are worked out from the span
//! it averages instead of being stored. The lines take one damped Gauss-Newton step every [`REFRESH_S`], not with every
//! bearing: between steps the vessel is predicted by the line as it stands.

use super::Heard;
use super::known::{Known, Prediction};
use crate::angle::{wrap_pi, wrap_tau};
use crate::kit::Progress;
use crate::math::f64 as m;
use crate::motion::chain::{Chain, Colour};
use crate::motion::hypotheses::{add_priors, same};
use crate::motion::model::{LN_SPEED, Limits, Line, PARAMETERS};
use crate::motion::normal::{COLUMNS, Normal, Point, descend};
use crate::motion::recursive::Config;
use crate::motion::solution::{Solution, floor, solution};
use crate::motion::start::{STARTS, emitted, starts};

/// Averaged bearings kept: a 200 s passage at two bearings a second is held in spans of about 3 s.
pub(super) const NODES: usize = 64;
/// Lines kept at once (both passing sides and one more arc).
const LINES: usize = 3;
/// A line this much worse in squared residual than the best is dropped (odds of 3 million to one).
const DEAD: f64 = 30.0;
/// Bearings before the first lines.
const FIRST_SEEDING: u32 = 6;
/// Steps of a fresh line when seeded, and of the end-of-passage solution at most.
const SEED_STEPS: usize = 6;
const FINAL_STEPS: usize = 25;
/// Time between steps of the lines, seconds; every bearing takes one while there are fewer than [`EAGER`].
const REFRESH_S: f64 = 2.0;
const EAGER: u32 = 24;
/// A track of fewer bearings may have run into a wrong arc. What it refuses within this of its newest bearing, and of
/// what a vessel's bearing usually turns in the time between, has it searched afresh.
const YOUNG: u32 = 40;
const NEAR_RAD: f64 = 0.05;
const DRIFT_RAD_S: f64 = 0.03;
/// Squared residuals of a right line exceed their number by so many standard deviations once in 10⁴.
const CHANCE_SD: f64 = 4.0;
/// An average over more correlation times than this counts as independent of its neighbours.
const MEMORY_SPANS: f64 = 16.0;
/// Nothing is known better than this (a hundredth of a degree).
const LEAST_VARIANCE: f64 = 3e-8;

/// An averaged bearing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Weighted mean time, seconds after the fit's origin.
    pub(super) t_s: f32,
    /// Weighted mean azimuth, radians.
    pub(super) azimuth: f32,
    /// White variance of the mean, rad².
    pub(super) white: f32,
    /// From the first to the last bearing averaged, seconds.
    span_s: f32,
    /// Bearings averaged.
    count: u32,
    /// Mean elevation, radians, and its variance, rad²; infinite where there is none.
    elevation: (f32, f32),
}

impl Node {
    /// Error of the mean: the coloured part of an average over `span_s` of a Gauss-Markov process.
    fn colour(&self, tau_s: f64) -> Colour {
        let white = f64::from(self.white);
        let y = if tau_s > 0.0 { f64::from(self.span_s) / tau_s } else { 0.0 };
        if y < 1e-3 {
            return Colour::single(1.0, white);
        }
        let own = 2.0 * (y - 1.0 + m::exp(-y)) / (y * y);
        if y > MEMORY_SPANS {
            return Colour { later: 0.0, earlier: 0.0, own, white };
        }
        let factor = (m::exp(0.5 * y) - m::exp(-0.5 * y)) / y;
        Colour { later: factor, earlier: factor, own, white }
    }
}

/// The memory of one vessel's fit.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    origin_s: f64,
    last_s: f64,
    refreshed_s: f64,
    nodes: [Node; NODES],
    len: usize,
    seen: u32,
    next_seeding: u32,
    lines: [Option<Line>; LINES],
    best: Option<Known>,
}

impl Fit {
    pub(super) const fn new() -> Self {
        const EMPTY: Node =
            Node { t_s: 0.0, azimuth: 0.0, white: 0.0, span_s: 0.0, count: 0, elevation: (0.0, 0.0) };
        Self {
            origin_s: 0.0,
            last_s: 0.0,
            refreshed_s: 0.0,
            nodes: [EMPTY; NODES],
            len: 0,
            seen: 0,
            next_seeding: 0,
            lines: [None; LINES],
            best: None,
        }
    }

    /// Bearings used.
    pub(super) fn seen(&self) -> u32 {
        self.seen
    }

    /// Time of the first bearing, seconds.
    pub(super) fn origin_s(&self) -> f64 {
        self.origin_s
    }

    pub(super) fn nodes(&self) -> &[Node] {
        self.nodes.get(..self.len).unwrap_or(&[])
    }

    /// The best line, if there is one.
    pub(super) fn best(&self) -> Option<&Known> {
        self.best.as_ref()
    }

    /// Takes a bearing that belongs to this vessel (times in order).
    pub(super) fn push(&mut self, config: &Config, t_s: f64, heard: &Heard) {
        self.keep(config, t_s, heard);
        if self.seen >= self.next_seeding {
            self.next_seeding = self.seen.saturating_add(self.seen / 2);
            self.refreshed_s = t_s;
            self.improve(config, true, SEED_STEPS);
        } else if self.seen < EAGER || t_s - self.refreshed_s >= REFRESH_S {
            self.refreshed_s = t_s;
            self.improve(config, false, 1);
        }
    }

    /// A bearing that a young track's lines do not explain, though it lies where the vessel was: they may have run into a
    /// wrong arc. They are searched afresh over all bearings, this one too, which is taken (true) if one explains them.
    pub(super) fn reconsider(&mut self, config: &Config, t_s: f64, heard: &Heard) -> bool {
        let Some(last) = self.nodes().last().filter(|_| self.seen < YOUNG) else { return false };
        let step = m::abs(wrap_pi(heard.azimuth - f64::from(last.azimuth)));
        if self.best.is_none() || step > NEAR_RAD + DRIFT_RAD_S * (t_s - self.last_s).max(0.0) {
            return false;
        }
        let mut all = self.clone();
        all.lines = [None; LINES];
        all.keep(config, t_s, heard);
        let freedom = all.measurements();
        let most = freedom + CHANCE_SD * m::sqrt(2.0 * freedom);
        let explained = all.improve(config, true, FINAL_STEPS).is_some_and(|cost| cost < most);
        if explained {
            *self = all;
        }
        explained
    }

    /// Adds a bearing to what is kept; the lines stay as they are.
    fn keep(&mut self, config: &Config, t_s: f64, heard: &Heard) {
        if self.seen == 0 {
            self.origin_s = t_s;
            self.refreshed_s = t_s;
            self.next_seeding = FIRST_SEEDING;
        }
        self.last_s = t_s;
        self.seen = self.seen.saturating_add(1);
        if self.len >= NODES {
            self.merge();
        }
        if let Some(slot) = self.nodes.get_mut(self.len) {
            let white = (heard.variance + config.errors().2).max(LEAST_VARIANCE) as f32;
            let (t_s, azimuth) = ((t_s - self.origin_s) as f32, wrap_tau(heard.azimuth) as f32);
            *slot = Node { t_s, azimuth, white, span_s: 0.0, count: 1, elevation: heard.elevation };
            self.len += 1;
        }
    }

    /// Azimuth expected at a time of reception. Before there is a line: the newest bearing, turning by no more than a
    /// few degrees a second.
    pub(super) fn predict(&self, config: &Config, t_s: f64) -> Option<Prediction> {
        let coloured_variance = config.errors().0;
        if let Some(best) = &self.best {
            let (azimuth, line_variance) = best.azimuth(config, t_s);
            let known = azimuth.is_finite() && line_variance.is_finite();
            return known.then_some(Prediction { azimuth, line_variance, coloured_variance });
        }
        let last = self.nodes().last()?;
        let drift = DRIFT_RAD_S * (t_s - self.last_s).max(0.0);
        let line_variance = f64::from(last.white) + drift * drift;
        Some(Prediction { azimuth: f64::from(last.azimuth), line_variance, coloured_variance })
    }

    /// The running estimate.
    pub(super) fn solution(&self, config: &Config) -> Option<Solution> {
        let line = self.best.as_ref()?.line;
        let normal = self.evaluate(config, &line)?;
        let limits = self.limits(config);
        solution(&line, &normal, &config.free(), &limits, self.seen, self.measurements())
    }

    /// Averaged azimuths and elevations.
    fn measurements(&self) -> f64 {
        let elevations = self.nodes().iter().filter(|n| n.elevation.1.is_finite()).count();
        (self.len + elevations) as f64
    }

    /// The end-of-passage solution: from all lines and fresh starts, to convergence.
    pub(super) fn finish(&mut self, config: &Config) -> Option<Solution> {
        self.improve(config, true, FINAL_STEPS);
        self.solution(config)
    }

    /// How much better two lines, one until `t_s` and one from then on, explain the bearings than a single one: the fall
    /// of the weighted squared residual. Both sides are fitted from all lines and fresh starts.
    pub(super) fn gain_of_split(&self, config: &Config, t_s: f64) -> f64 {
        let mut older = self.clone();
        let whole = older.improve(config, true, FINAL_STEPS);
        let mut newer = older.split(config, t_s);
        let parts = [older.improve(config, true, SEED_STEPS), newer.improve(config, true, FINAL_STEPS)];
        match (whole, parts) {
            (Some(whole), [Some(older), Some(newer)]) => whole - older - newer,
            _ => 0.0,
        }
    }

    /// Cuts at a time: what is older stays here, what is newer is returned as a fit of its own.
    pub(super) fn split(&mut self, config: &Config, t_s: f64) -> Self {
        let cut = (t_s - self.origin_s) as f32;
        let keep = self.nodes().iter().filter(|n| n.t_s < cut).count();
        let mut newer = Self::new();
        for node in self.nodes.iter().take(self.len).skip(keep) {
            let t_s = self.origin_s + f64::from(node.t_s);
            if newer.len == 0 {
                newer.origin_s = t_s;
            }
            if let Some(slot) = newer.nodes.get_mut(newer.len) {
                *slot = Node { t_s: (t_s - newer.origin_s) as f32, ..*node };
                newer.len += 1;
                newer.seen += node.count;
                newer.last_s = t_s;
            }
        }
        newer.refreshed_s = newer.last_s;
        newer.next_seeding = newer.seen.max(FIRST_SEEDING);
        newer.improve(config, true, SEED_STEPS);
        self.len = keep;
        self.seen = self.nodes().iter().map(|n| n.count).sum();
        self.last_s = self.nodes().last().map_or(self.origin_s, |n| self.origin_s + f64::from(n.t_s));
        newer
    }

    fn limits(&self, config: &Config) -> Limits {
        Limits { range_m: config.range_m, ln_speed: LN_SPEED, times_s: (self.origin_s, self.last_s) }
    }

    /// Normal equations of a line over all nodes, the speed's prior included.
    fn evaluate(&self, config: &Config, line: &Line) -> Option<Normal> {
        let (variance, tau_s, _) = config.errors();
        let mut chain = Chain::new(variance, tau_s);
        for node in self.nodes() {
            let t_s = self.origin_s + f64::from(node.t_s);
            let e = line.expected(&config.medium, t_s);
            let mut row = [0.0; COLUMNS];
            let (derivatives, residual) = row.split_at_mut(PARAMETERS);
            derivatives.copy_from_slice(&e.d_azimuth);
            if let [r] = residual {
                *r = wrap_pi(f64::from(node.azimuth) - e.azimuth);
            }
            chain.push(t_s, &node.colour(tau_s), &row);
            if node.elevation.1.is_finite() {
                let mut row = [0.0; COLUMNS];
                let (derivatives, residual) = row.split_at_mut(PARAMETERS);
                derivatives.copy_from_slice(&e.d_elevation);
                if let [r] = residual {
                    *r = f64::from(node.elevation.0) - e.elevation;
                }
                chain.normal.add(&row, 1.0 / f64::from(node.elevation.1));
            }
        }
        let bias_sd_rad = config.elevation_bias_sd_rad;
        add_priors(&mut chain.normal, line, config.speed_m_s, config.speed_sd_m_s, bias_sd_rad);
        chain.normal.is_finite().then_some(chain.normal)
    }

    /// Lets the lines (and fresh ones, if asked) take up to `steps` steps and keeps the best few that differ. Returns
    /// the least weighted squared residual.
    fn improve(&mut self, config: &Config, fresh: bool, steps: usize) -> Option<f64> {
        let limits = self.limits(config);
        let free = config.free();
        let bearings = self.nodes().iter().map(|n| (self.origin_s + f64::from(n.t_s), f64::from(n.azimuth)));
        let new = if fresh { starts(bearings, self.len, config.speed_m_s, &limits) } else { [None; STARTS] };
        let mut pool: [Option<Point>; LINES + STARTS] = [None; LINES + STARTS];
        let old = self.lines.iter().copied();
        let all = old.chain(new.iter().map(|s| s.map(|s| emitted(&s.line, &config.medium))));
        for (slot, line) in pool.iter_mut().zip(all) {
            let Some(line) = line else { continue };
            let Some(normal) = self.evaluate(config, &line) else { continue };
            let mut point = Point { at: line, normal, damping: 1e-3 };
            for _ in 0..steps {
                let progress = descend(&mut point, &free, &limits, |line| self.evaluate(config, line));
                if progress == Progress::Converged {
                    break;
                }
            }
            *slot = Some(point);
        }
        self.lines = [None; LINES];
        let mut least = None;
        for (rank, slot) in self.lines.iter_mut().enumerate() {
            let chosen = pool.iter().flatten().min_by(|a, b| a.normal.cost().total_cmp(&b.normal.cost()));
            let Some(chosen) = chosen.copied() else { break };
            if rank == 0 {
                least = Some(chosen.normal.cost());
                let floor = floor(&limits, chosen.at.speed_m_s());
                let covariance = chosen.normal.covariance(&free, &floor);
                self.best = covariance.map(|covariance| Known::new(chosen.at, &covariance));
            }
            if least.is_some_and(|least| chosen.normal.cost() > least + DEAD) {
                break;
            }
            *slot = Some(chosen.at);
            for p in &mut pool {
                if p.is_some_and(|p| same(&p.at, &chosen.at)) {
                    *p = None;
                }
            }
        }
        least
    }

    /// Merges the pair of neighbours whose average loses least: an average over a span `D` errs by `α̈ D²/24`.
    fn merge(&mut self) {
        let line = self.best.as_ref().map(|b| b.line);
        let q = line.map_or(0.0, |l| m::exp(l.p[2]));
        let t_c = line.map_or(0.0, |l| l.p[1]) - self.origin_s;
        let mut best = (f64::INFINITY, 0usize);
        for (i, pair) in self.nodes().windows(2).enumerate() {
            let [a, b] = pair else { continue };
            let span = f64::from(b.t_s - a.t_s + 0.5 * (a.span_s + b.span_s));
            let x = q * (0.5 * f64::from(a.t_s + b.t_s) - t_c);
            let g = q / (1.0 + x * x);
            let loss = span * span * (g * g * (1.0 + 2.0 * m::abs(x)) + 1e-9);
            if loss < best.0 {
                best = (loss, i);
            }
        }
        let i = best.1;
        let (Some(a), Some(b)) = (self.nodes.get(i).copied(), self.nodes.get(i + 1).copied()) else { return };
        if let Some(slot) = self.nodes.get_mut(i) {
            let w = a.white / (a.white + b.white);
            *slot = Node {
                t_s: a.t_s + w * (b.t_s - a.t_s),
                azimuth: wrap_tau(f64::from(a.azimuth + w * crate::angle::wrap_pi_f32(b.azimuth - a.azimuth)))
                    as f32,
                white: w * b.white,
                span_s: b.t_s - a.t_s + 0.5 * (a.span_s + b.span_s),
                count: a.count.saturating_add(b.count),
                elevation: average(a.elevation, b.elevation),
            };
        }
        for k in i + 1..NODES - 1 {
            if let Some(next) = self.nodes.get(k + 1).copied()
                && let Some(slot) = self.nodes.get_mut(k)
            {
                *slot = next;
            }
        }
        self.len = self.len.saturating_sub(1);
    }
}

/// Two elevations with their variances as one, by their weights.
fn average(a: (f32, f32), b: (f32, f32)) -> (f32, f32) {
    let (wa, wb) = (1.0 / a.1, 1.0 / b.1);
    if wa + wb > 0.0 { ((wa * a.0 + wb * b.0) / (wa + wb), 1.0 / (wa + wb)) } else { Heard::NO_ELEVATION }
}
