//! The lines a recursive fit keeps alive: both passing sides, several arcs.
//!
//! In: the ring of bearings. Out: up to [`HYPOTHESES`] lines, each with its normal equations. All take damped Gauss-Newton
//! steps over the ring; fresh ones come from [`super::start`]; one far worse than the best is dropped. Cost: two
//! evaluations of the ring a line and step.

use super::chain::Chain;
use super::model::{Limits, Line, PARAMETERS};
use super::normal::{COLUMNS, Normal, Point, descend};
use super::ring::Ring;
use super::settings::Config;
use super::start::{STARTS, emitted, starts};
use crate::angle::wrap_pi;
use crate::kit::Progress;
use crate::math::f64 as m;

/// Hypotheses alive at once.
pub const HYPOTHESES: usize = 4;
/// A hypothesis this much worse in squared residual than the best is dropped (odds of 3 million to one).
const DEAD: f64 = 30.0;

/// The living lines.
#[derive(Clone, Debug)]
pub(super) struct Hypotheses {
    points: [Option<Point>; HYPOTHESES],
}

impl Hypotheses {
    /// None yet.
    pub(super) const fn new() -> Self {
        Self { points: [None; HYPOTHESES] }
    }

    /// The likeliest.
    pub(super) fn best(&self) -> Option<&Point> {
        self.points.iter().flatten().min_by(|a, b| a.normal.cost().total_cmp(&b.normal.cost()))
    }

    /// How many are alive.
    pub(super) fn count(&self) -> usize {
        self.points.iter().flatten().count()
    }

    /// One step of each over a ring that has grown.
    pub(super) fn step(&mut self, config: &Config, ring: &Ring, limits: &Limits) {
        let free = config.free();
        for point in self.points.iter_mut().flatten() {
            if let Some(normal) = evaluate(config, ring, &point.at) {
                point.normal = normal;
            }
            descend(point, &free, limits, |line| evaluate(config, ring, line));
        }
    }

    /// Puts fresh starting hypotheses beside the living ones, lets all take `steps` steps and keeps the best few that
    /// differ.
    pub(super) fn seed(&mut self, config: &Config, ring: &Ring, limits: &Limits, steps: usize) {
        let free = config.free();
        let nodes = ring.nodes();
        let fresh = starts(nodes.iter().map(|n| (n.t_s, n.azimuth)), nodes.len(), config.speed_m_s, limits);
        let mut pool: [Option<Point>; HYPOTHESES + STARTS] = [None; HYPOTHESES + STARTS];
        let lines = self
            .points
            .iter()
            .map(|p| p.map(|p| p.at))
            .chain(fresh.iter().map(|s| s.map(|s| emitted(&s.line, &config.medium))));
        for (slot, line) in pool.iter_mut().zip(lines) {
            let Some(line) = line else { continue };
            let Some(normal) = evaluate(config, ring, &line) else { continue };
            let mut point = Point { at: line, normal, damping: 1e-3 };
            for _ in 0..steps {
                let progress = descend(&mut point, &free, limits, |line| evaluate(config, ring, line));
                if progress == Progress::Converged {
                    break;
                }
            }
            *slot = Some(point);
        }
        self.points = [None; HYPOTHESES];
        for slot in &mut self.points {
            let best = pool.iter().flatten().min_by(|a, b| a.normal.cost().total_cmp(&b.normal.cost()));
            let Some(chosen) = best.copied() else { break };
            *slot = Some(chosen);
            for p in &mut pool {
                if p.is_some_and(|p| same(&p.at, &chosen.at)) {
                    *p = None;
                }
            }
        }
    }

    /// Drops those far worse than the best.
    pub(super) fn prune(&mut self) {
        let Some(best) = self.best().map(|p| p.normal.cost()) else { return };
        for slot in &mut self.points {
            if slot.is_some_and(|p| p.normal.cost() > best + DEAD) {
                *slot = None;
            }
        }
    }
}

/// Whether two hypotheses have run into the same minimum.
pub fn same(a: &Line, b: &Line) -> bool {
    let d = |k: usize| m::abs(a.p[k] - b.p[k]);
    a.sense == b.sense && m::abs(wrap_pi(a.p[0] - b.p[0])) < 1e-3 && d(2) < 1e-2 && d(1) < 0.5
}

/// The factorisation of the ring's errors with residuals about `line`.
pub(super) fn chain(config: &Config, ring: &Ring, line: &Line) -> Chain {
    let (variance, tau_s, _) = config.errors();
    let mut chain = Chain::new(variance, tau_s);
    let view = line.view(&config.medium);
    for node in ring.nodes() {
        let e = view.expected(node.t_s);
        let mut row = [0.0; COLUMNS];
        let (derivatives, residual) = row.split_at_mut(PARAMETERS);
        derivatives.copy_from_slice(&e.d_azimuth);
        if let [r] = residual {
            *r = wrap_pi(node.azimuth - e.azimuth - 0.5 * e.curvature * node.time_variance);
        }
        chain.push(node.t_s, &node.colour, &row);
        if node.elevation.1.is_finite() {
            let mut row = [0.0; COLUMNS];
            row[..PARAMETERS].copy_from_slice(&e.d_elevation);
            row[PARAMETERS] = f64::from(node.elevation.0) - e.elevation;
            chain.normal.add(&row, 1.0 / f64::from(node.elevation.1));
        }
    }
    chain
}

/// Normal equations over the ring, priors included.
fn evaluate(config: &Config, ring: &Ring, line: &Line) -> Option<Normal> {
    let mut normal = chain(config, ring, line).normal;
    add_priors(&mut normal, line, config.speed_m_s, config.speed_sd_m_s, config.elevation_bias_sd_rad);
    normal.is_finite().then_some(normal)
}

/// Adds the priors of speed (Gaussian in v) and elevation bias; a standard deviation of 0 or infinity adds nothing.
pub fn add_priors(normal: &mut Normal, line: &Line, speed_m_s: f64, speed_sd_m_s: f64, bias_sd_rad: f64) {
    if speed_sd_m_s > 0.0 && speed_sd_m_s.is_finite() {
        let mut row = [0.0; COLUMNS];
        row[3] = line.speed_m_s();
        row[PARAMETERS] = speed_m_s - line.speed_m_s();
        normal.add(&row, 1.0 / (speed_sd_m_s * speed_sd_m_s));
    }
    if bias_sd_rad > 0.0 && bias_sd_rad.is_finite() {
        let mut row = [0.0; COLUMNS];
        row[4] = 1.0;
        row[PARAMETERS] = -line.p[4];
        normal.add(&row, 1.0 / (bias_sd_rad * bias_sd_rad));
    }
}
