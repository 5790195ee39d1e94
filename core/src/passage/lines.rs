//! The lines a passage keeps: both passing sides, several arcs.
//!
//! In: averaged bearings. Out: up to [`LINES`] straight tracks and the covariance of the best. All take damped
//! Gauss-Newton steps over the averages; fresh ones come from [`crate::motion::start`]; one far worse than the best is
//! dropped. What does not depend on a line (decay from one average to the next, memory of its error) is worked out once
//! for all lines and steps. Cost: one or two evaluations of all averages a line and step.

use super::known::Known;
use super::node::Node;
use super::settings::Config;
use crate::angle::wrap_pi;
use crate::math::f64 as m;
use crate::motion::chain::{Chain, Colour};
use crate::motion::hypotheses::{add_priors, same};
use crate::motion::model::{Limits, Line, PARAMETERS};
use crate::motion::normal::{COLUMNS, Normal, Point, minimise};
use crate::motion::solution::covariance;
use crate::motion::start::{STARTS, emitted, starts};

/// Lines kept at once: both passing sides and one more arc.
const LINES: usize = 3;
/// A line this much worse in squared residual than the best is dropped (odds of 3 million to one).
const DEAD: f64 = 30.0;

/// Steps of a line that has to be brought within the limits.
const LIMITED_STEPS: usize = 6;
/// Steps to where another speed brings a line that fits.
const FREED_STEPS: usize = 6;

/// What an average has to do with the one before it and with itself, in units of the coloured variance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// `e^{−Δt/τ}` since the average before.
    decay: f32,
    factor: f32,
    own: f32,
    /// Half the variance of the times averaged, s².
    half_variance: f32,
}

impl Link {
    pub(super) const NONE: Self = Self { decay: 0.0, factor: 1.0, own: 1.0, half_variance: 0.0 };

    /// Of `node`, whose predecessor lies `step_s` before it.
    pub(super) fn new(node: &Node, step_s: f64, tau_s: f64) -> Self {
        let mean = node.mean();
        let colour = mean.colour(tau_s);
        let decay = if tau_s > 0.0 { m::exp(-step_s / tau_s) } else { 0.0 };
        Self {
            decay: decay as f32,
            factor: colour.factor as f32,
            own: colour.own as f32,
            half_variance: (0.5 * mean.time_variance()) as f32,
        }
    }
}

/// Averages in order of time and what is assumed of them.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) config: &'a Config,
    pub(super) origin_s: f64,
    pub(super) nodes: &'a [Node],
    /// One for each node.
    pub(super) links: &'a [Link],
    pub(super) limits: Limits,
}

impl Problem<'_> {
    /// Averaged azimuths and elevations.
    pub(super) fn measurements(&self) -> f64 {
        let elevations = self.nodes.iter().filter(|n| n.elevation().is_some()).count();
        (self.nodes.len() + elevations) as f64
    }

    /// Normal equations of a line over all averages, priors included; `None` if they are not finite.
    pub(super) fn evaluate(&self, line: &Line) -> Option<Normal> {
        let config = self.config;
        let (variance, tau_s, _) = config.errors();
        let mut chain = Chain::new(variance, tau_s);
        // What heavy-tailed errors cost beyond their weighted squares.
        let mut cost = 0.0;
        let view = line.view(&config.medium);
        for (node, link) in self.nodes.iter().zip(self.links) {
            let e = view.expected(self.origin_s + node.t_s());
            let mut row = [0.0; COLUMNS];
            let (derivatives, residual) = row.split_at_mut(PARAMETERS);
            derivatives.copy_from_slice(&e.d_azimuth);
            if let [r] = residual {
                *r = wrap_pi(node.azimuth() - e.azimuth - e.curvature * f64::from(link.half_variance));
            }
            let factor = f64::from(link.factor);
            let own = f64::from(link.own);
            let residual = row.last().copied().unwrap_or(0.0);
            let (white, unweighted) = config.doubt(residual, node.white(), variance * own);
            let colour = Colour { later: factor, earlier: factor, own, white };
            cost += unweighted;
            chain.push_after(f64::from(link.decay), &colour, &row);
            if let Some((elevation, variance)) = node.elevation() {
                let mut row = [0.0; COLUMNS];
                let (derivatives, residual) = row.split_at_mut(PARAMETERS);
                derivatives.copy_from_slice(&e.d_elevation);
                if let [r] = residual {
                    *r = elevation - e.elevation;
                }
                let residual = row.last().copied().unwrap_or(0.0);
                let (variance, unweighted) = config.doubt(residual, variance, 0.0);
                chain.normal.add(&row, 1.0 / variance);
                cost += unweighted;
            }
        }
        chain.normal.observe_at_cost(&[0.0; PARAMETERS], 0.0, 0.0, cost);
        let bias_sd_rad = config.elevation_bias_sd_rad;
        add_priors(&mut chain.normal, line, config.speed_m_s, config.speed_sd_m_s, bias_sd_rad);
        chain.normal.is_finite().then_some(chain.normal)
    }

    /// The line where it lies within the limits; the best one there where it does not.
    pub(super) fn within_limits(&self, line: &Line) -> Option<(Line, Normal)> {
        let moved = line.moved(&[0.0; PARAMETERS], &self.limits);
        let steps = if moved.p == line.p { 0 } else { LIMITED_STEPS };
        self.descended(moved, steps).map(|p| (p.at, p.normal))
    }

    /// A line near this one that the measurements want where the speed is left to them, with its normal equations.
    pub(super) fn freed(&self, line: &Line) -> Option<(Line, Normal)> {
        self.descended(*line, FREED_STEPS).map(|p| (p.at, p.normal))
    }

    /// Up to `steps` damped steps from a line.
    #[inline(never)]
    fn descended(&self, line: Line, steps: usize) -> Option<Point> {
        minimise(&line, &self.config.free(), &self.limits, steps, |line| self.evaluate(line))
    }
}

/// The lines kept.
#[derive(Clone, Debug)]
pub(super) struct Lines {
    lines: [Option<Line>; LINES],
    best: Option<Known>,
}

impl Lines {
    /// None yet.
    pub(super) const fn new() -> Self {
        Self { lines: [None; LINES], best: None }
    }

    /// The best, with its covariance.
    pub(super) fn best(&self) -> Option<&Known> {
        self.best.as_ref()
    }

    /// Lets the lines (and fresh ones, if asked) take up to `steps` steps and keeps the best few that differ. Returns
    /// the least weighted squared residual.
    pub(super) fn improve(&mut self, problem: &Problem<'_>, fresh: bool, steps: usize) -> Option<f64> {
        let Problem { config, limits, .. } = *problem;
        let new = if fresh {
            let bearings = problem.nodes.iter().map(|n| (problem.origin_s + n.t_s(), n.azimuth()));
            starts(bearings, problem.nodes.len(), config.speed_m_s, &limits)
        } else {
            [None; STARTS]
        };
        let mut pool: [Option<(Line, f64)>; LINES + STARTS] = [None; LINES + STARTS];
        let old = self.lines.iter().copied();
        let all = old.chain(new.iter().map(|s| s.map(|s| emitted(&s.line, &config.medium))));
        for (slot, line) in pool.iter_mut().zip(all) {
            let Some(line) = line else { continue };
            *slot = problem.descended(line, steps).map(|p| (p.at, p.normal.cost()));
        }
        *self = Self::new();
        let mut least = None;
        for slot in &mut self.lines {
            let Some(chosen) = pool.iter().flatten().min_by(|a, b| a.1.total_cmp(&b.1)).copied() else {
                break;
            };
            if chosen.1 > least.unwrap_or(chosen.1) + DEAD {
                break;
            }
            least = least.or(Some(chosen.1));
            *slot = Some(chosen.0);
            for p in &mut pool {
                if p.is_some_and(|p| same(&p.0, &chosen.0)) {
                    *p = None;
                }
            }
        }
        self.best = self.lines.first().copied().flatten().and_then(|line| known(problem, line));
        least
    }
}

/// A line with the covariance its averages give it.
#[inline(never)]
fn known(problem: &Problem<'_>, line: Line) -> Option<Known> {
    let normal = problem.evaluate(&line)?;
    let covariance = covariance(&line, &normal, &problem.config.free(), &problem.limits)?;
    Some(Known::new(line, &covariance))
}
