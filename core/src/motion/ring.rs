//! The bounded memory of a passage: bearings, averaged where the bearing turns least once the memory is full.
//!
//! In: bearings in order of time. Out: at most [`CAPACITY`] nodes, each an average with the exact covariance
//! structure of its error ([`Colour`]). An average differs from the bearing at its mean
//! time by half the curvature times the variance of its times, which the fit allows for; the pair merged is the one for
//! which that is least.

use super::chain::Colour;
use super::model::Line;
use crate::angle::{wrap_pi, wrap_tau};
use crate::math::f64 as m;

/// Nodes kept: a 200 s passage at two bearings a second is held in spans of 2 s, and eight vessels take 48 KiB.
pub const CAPACITY: usize = 96;

/// An averaged bearing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Weighted mean time, seconds.
    pub t_s: f64,
    /// Weighted mean azimuth, radians.
    pub azimuth: f64,
    /// Its error.
    pub colour: Colour,
    /// Its weight in averages: sum of the inverse variances (white and coloured) of what was averaged, rad⁻².
    pub weight: f64,
    /// Mean elevation, radians, and the variance of its error, rad²; infinite where there is none.
    pub elevation: (f32, f32),
    /// Variance of the averaged times about `t_s`, s²: the average of a curved bearing lies off by half the curvature
    /// times this.
    pub time_variance: f64,
    /// First and last time averaged, as offsets from `t_s`.
    pub span_s: (f32, f32),
}

/// The nodes, oldest first.
#[derive(Clone, Debug)]
pub struct Ring {
    nodes: [Node; CAPACITY],
    len: usize,
}

/// What fills unused places: zeros, so that a recorder in a `static` costs no flash. Never read.
const EMPTY: Node = Node {
    t_s: 0.0,
    azimuth: 0.0,
    colour: Colour { later: 0.0, earlier: 0.0, own: 0.0, white: 0.0 },
    weight: 0.0,
    elevation: (0.0, 0.0),
    time_variance: 0.0,
    span_s: (0.0, 0.0),
};

impl Default for Ring {
    fn default() -> Self {
        Self::new()
    }
}

impl Ring {
    /// An empty ring.
    pub const fn new() -> Self {
        Self { nodes: [EMPTY; CAPACITY], len: 0 }
    }

    /// The nodes in order of time.
    pub fn nodes(&self) -> &[Node] {
        self.nodes.get(..self.len).unwrap_or(&[])
    }

    /// Adds a bearing, making room first if need be. `line` tells where the bearing turns, `tau_s` the errors' memory.
    pub fn push(&mut self, node: Node, line: Option<&Line>, tau_s: f64) {
        if self.len >= CAPACITY {
            self.merge(line, tau_s);
        }
        if let Some(slot) = self.nodes.get_mut(self.len) {
            *slot = node;
            self.len += 1;
        }
    }

    /// Merges the pair of neighbours whose average loses least.
    fn merge(&mut self, line: Option<&Line>, tau_s: f64) {
        let mut best = (f64::INFINITY, 0usize);
        for (i, pair) in self.nodes().windows(2).enumerate() {
            let [a, b] = pair else { continue };
            let span = b.t_s + f64::from(b.span_s.1) - a.t_s - f64::from(a.span_s.0);
            let turning = line.map_or(0.0, |l| {
                let q = m::exp(l.p[2]);
                let x = q * (0.5 * (a.t_s + b.t_s) - l.p[1]);
                let g = q / (1.0 + x * x);
                g * g * (1.0 + 2.0 * x.abs())
            });
            let loss = span * span * (turning + 1e-9);
            if loss < best.0 {
                best = (loss, i);
            }
        }
        let i = best.1;
        let (Some(a), Some(b)) = (self.nodes.get(i).copied(), self.nodes.get(i + 1).copied()) else { return };
        if let Some(slot) = self.nodes.get_mut(i) {
            *slot = average(&a, &b, tau_s);
        }
        for k in i + 1..CAPACITY - 1 {
            if let Some(next) = self.nodes.get(k + 1).copied()
                && let Some(slot) = self.nodes.get_mut(k)
            {
                *slot = next;
            }
        }
        self.len = self.len.saturating_sub(1);
    }
}

/// Beyond this many correlation times an average's neighbours count as independent (their correlation is under 3 %).
const MEMORY_SPANS: f64 = 16.0;

/// The weighted average of two neighbours, with the exact covariance of its error.
fn average(a: &Node, b: &Node, tau_s: f64) -> Node {
    let weight = a.weight + b.weight;
    let (wa, wb) = (a.weight / weight, b.weight / weight);
    let t_s = wa * a.t_s + wb * b.t_s;
    let azimuth = wrap_tau(a.azimuth + wb * wrap_pi(b.azimuth - a.azimuth));
    let step = b.t_s - a.t_s;
    let time_variance = wa * a.time_variance + wb * b.time_variance + wa * wb * step * step;
    let span_s = ((a.t_s + f64::from(a.span_s.0) - t_s) as f32, (b.t_s + f64::from(b.span_s.1) - t_s) as f32);
    let rate = if tau_s > 0.0 { 1.0 / tau_s } else { 0.0 };
    let memory = m::exp(-(b.t_s - a.t_s) * rate);
    let (ca, cb) = (&a.colour, &b.colour);
    let own = wa * wa * ca.own + wb * wb * cb.own + 2.0 * wa * wb * memory * ca.later * cb.earlier;
    let white = wa * wa * ca.white + wb * wb * cb.white;
    let forgotten = f64::from(span_s.1 - span_s.0) * rate > MEMORY_SPANS;
    let (later, earlier) = if forgotten {
        (0.0, 0.0)
    } else {
        (
            wa * ca.later * m::exp((a.t_s - t_s) * rate) + wb * cb.later * m::exp((b.t_s - t_s) * rate),
            wa * ca.earlier * m::exp((t_s - a.t_s) * rate) + wb * cb.earlier * m::exp((t_s - b.t_s) * rate),
        )
    };
    Node {
        t_s,
        azimuth,
        colour: Colour { later, earlier, own, white },
        weight,
        elevation: elevation(a, b),
        time_variance,
        span_s,
    }
}

fn elevation(a: &Node, b: &Node) -> (f32, f32) {
    let (ia, ib) = (1.0 / a.elevation.1, 1.0 / b.elevation.1);
    if ia + ib > 0.0 {
        ((ia * a.elevation.0 + ib * b.elevation.0) / (ia + ib), 1.0 / (ia + ib))
    } else {
        (0.0, f32::INFINITY)
    }
}

#[cfg(test)]
mod tests {
    use super::super::chain::Chain;
    use super::super::normal::COLUMNS;
    use super::*;

    #[test]
    fn averages_keep_the_information_about_a_constant() {
        let (tau, var, white) = (5.0, 0.02, 0.01);
        let mut ring = Ring::default();
        let mut full = Chain::new(var, tau);
        let mut row = [0.0; COLUMNS];
        row[0] = 1.0;
        for k in 0..4 * CAPACITY {
            let t = 0.5 * k as f64;
            let colour = Colour::single(1.0, white);
            full.push(t, &colour, &row);
            let node = Node {
                t_s: t,
                azimuth: 1.0,
                colour,
                weight: 1.0,
                elevation: (0.1, 0.04),
                time_variance: 0.0,
                span_s: (0.0, 0.0),
            };
            ring.push(node, None, tau);
        }
        let mut merged = Chain::new(var, tau);
        for n in ring.nodes() {
            merged.push(n.t_s, &n.colour, &row);
        }
        let (a, b) = (full.normal.upper[0][0], merged.normal.upper[0][0]);
        assert!(b <= a * (1.0 + 1e-9) && b > 0.98 * a, "{b} of {a}");
        let information: f64 = ring.nodes().iter().map(|n| 1.0 / f64::from(n.elevation.1)).sum();
        assert!((information / (4.0 * CAPACITY as f64 / 0.04) - 1.0).abs() < 1e-3);
    }
}
