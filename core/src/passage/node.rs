//! An averaged bearing in 20 bytes.
//!
//! In: bearings, averages of neighbours. Out: time, azimuth and elevation of an average and what its error is. Times are
//! whole ticks after the passage's origin and azimuths whole parts of a circle, so neither loses digits however long a
//! passage lasts; variances and spans are kept to a two-thousandth of themselves. The error of an average follows from
//! the number of bearings in it and the time they cover, as if they came at equal steps.

use super::Config;
use crate::angle::wrap_pi;
use crate::math::f64 as m;
use crate::motion::model::Line;

/// Ticks a second: 31 µs, in which no vessel's bearing turns by a thousandth of a degree.
pub(super) const TICKS_HZ: f64 = 32_768.0;
/// Parts of a circle in a radian.
const PARTS_RAD: f64 = 4_294_967_296.0 / m::TAU;
/// Steps of an elevation in a radian: a half circle is all there is.
const STEPS_RAD: f64 = 65_536.0 / m::PI;

/// A number from 2⁻⁴⁰ (below: 0) to 2²⁴ (above: infinite) with ten binary digits after the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Short(u16);

impl Short {
    /// Binary digits of a single-precision fraction that are left out.
    const DROPPED: u32 = 13;
    /// Exponent, as single precision writes it, of the least number.
    const LEAST: u32 = (127 - 40) << 10;

    fn new(x: f32) -> Self {
        if x.is_nan() || x <= 0.0 {
            return Self(0);
        }
        let rounded = x.to_bits().saturating_add(1 << (Self::DROPPED - 1)) >> Self::DROPPED;
        Self(rounded.saturating_sub(Self::LEAST).min(u32::from(u16::MAX)) as u16)
    }

    fn get(self) -> f32 {
        match self.0 {
            0 => 0.0,
            u16::MAX => f32::INFINITY,
            x => f32::from_bits((u32::from(x) + Self::LEAST) << Self::DROPPED),
        }
    }
}

/// What one bearing or an average of several says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Seconds after the passage's origin.
    pub t_s: f64,
    /// Azimuth, radians.
    pub azimuth: f64,
    /// White variance, rad².
    pub white: f64,
    /// Standard deviation of its coloured error in units of the common one.
    pub scale: f64,
    /// Elevation and its variance, radians and rad²; infinite where there is none.
    pub elevation: (f64, f64),
    /// Bearings averaged, and the time from the first to the last, seconds.
    pub count: u16,
    /// See `count`.
    pub span_s: f64,
}

/// Factor of the coloured error towards neighbours, and its variance, both for a coloured variance of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Colour {
    pub(super) factor: f64,
    pub(super) own: f64,
}

impl Mean {
    /// Variance of the averaged times, s²: an average over a bend is off by half the curvature times this.
    pub(super) fn time_variance(&self) -> f64 {
        let n = f64::from(self.count.max(2));
        self.span_s * self.span_s / 12.0 * (n + 1.0) / (n - 1.0)
    }

    /// The coloured error of the average: `n` samples of a Gauss-Markov process at equal steps,
    /// `Σ w e^{(t_k − t)/τ}` and `ΣΣ w_i w_k e^{−|t_i − t_k|/τ}` in closed form.
    pub(super) fn colour(&self, tau_s: f64) -> Colour {
        let n = f64::from(self.count);
        let x = if tau_s > 0.0 && self.count > 1 { self.span_s / ((n - 1.0) * tau_s) } else { 0.0 };
        let (factor, own) = if n * x < 1e-3 {
            (1.0, 1.0)
        } else {
            let (step, all) = (m::exp(-x), m::exp(-n * x));
            let rest = 1.0 - step;
            let own = (1.0 + step) / (n * rest) - 2.0 * step * (1.0 - all) / (n * n * rest * rest);
            // Over so many correlation times neighbours count as independent.
            let half = m::exp(0.5 * (n - 1.0) * x);
            (if n * x > MEMORY_SPANS { 0.0 } else { half * (1.0 - all) / (n * rest) }, own)
        };
        Colour { factor: self.scale * factor, own: self.scale * self.scale * own }
    }

    /// The average of two neighbours by their information; `coloured` is the common coloured variance, rad².
    fn joined(&self, b: &Self, coloured: f64) -> Self {
        let weight = |a: &Self| 1.0 / (a.white + coloured * a.scale * a.scale / f64::from(a.count.max(1)));
        let (wa, wb) = (weight(self), weight(b));
        let (wa, wb) = (wa / (wa + wb), wb / (wa + wb));
        let ends = |a: &Self, side: f64| a.t_s + side * 0.5 * a.span_s;
        let (ia, ib) = (1.0 / self.elevation.1, 1.0 / b.elevation.1);
        let elevation = if ia + ib > 0.0 {
            ((ia * self.elevation.0 + ib * b.elevation.0) / (ia + ib), 1.0 / (ia + ib))
        } else {
            self.elevation
        };
        Self {
            t_s: self.t_s + wb * (b.t_s - self.t_s),
            azimuth: self.azimuth + wb * wrap_pi(b.azimuth - self.azimuth),
            white: wa * wa * self.white + wb * wb * b.white,
            scale: wa * self.scale + wb * b.scale,
            elevation,
            count: self.count.saturating_add(b.count),
            span_s: ends(b, 1.0) - ends(self, -1.0),
        }
    }
}

/// An average over more correlation times than this is independent of its neighbours to within 3 %.
const MEMORY_SPANS: f64 = 16.0;

/// A [`Mean`] as it is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    time: u32,
    azimuth: u32,
    white: Short,
    span: Short,
    scale: Short,
    count: u16,
    elevation: i16,
    elevation_variance: Short,
}

impl Node {
    /// What fills unused places: zeros, so that a recorder in a `static` costs no flash.
    pub(super) const EMPTY: Self = Self {
        time: 0,
        azimuth: 0,
        white: Short(0),
        span: Short(0),
        scale: Short(0),
        count: 0,
        elevation: 0,
        elevation_variance: Short(0),
    };

    pub(super) fn new(mean: &Mean) -> Self {
        let turns = mean.azimuth * PARTS_RAD;
        Self {
            time: m::round(mean.t_s * TICKS_HZ) as u32,
            azimuth: m::round(turns) as i64 as u32,
            white: Short::new(mean.white as f32),
            span: Short::new(mean.span_s as f32),
            scale: Short::new(mean.scale as f32),
            count: mean.count,
            elevation: m::round(mean.elevation.0 * STEPS_RAD) as i16,
            elevation_variance: Short::new(mean.elevation.1 as f32),
        }
    }

    /// Seconds after the passage's origin.
    pub(super) fn t_s(&self) -> f64 {
        f64::from(self.time) / TICKS_HZ
    }

    /// Azimuth, radians in [0, 2π).
    pub(super) fn azimuth(&self) -> f64 {
        f64::from(self.azimuth) / PARTS_RAD
    }

    /// White variance, rad².
    pub(super) fn white(&self) -> f64 {
        f64::from(self.white.get())
    }

    /// Elevation and its variance, where there is one.
    pub(super) fn elevation(&self) -> Option<(f64, f64)> {
        let variance = f64::from(self.elevation_variance.get());
        variance.is_finite().then_some((f64::from(self.elevation) / STEPS_RAD, variance))
    }

    /// Bearings averaged.
    pub(super) fn count(&self) -> u16 {
        self.count
    }

    /// From the first to the last bearing averaged, seconds.
    pub(super) fn span_s(&self) -> f64 {
        f64::from(self.span.get())
    }

    /// All of it.
    pub(super) fn mean(&self) -> Mean {
        Mean {
            t_s: self.t_s(),
            azimuth: self.azimuth(),
            white: self.white(),
            scale: f64::from(self.scale.get()),
            elevation: self.elevation().unwrap_or((0.0, f64::INFINITY)),
            count: self.count,
            span_s: self.span_s(),
        }
    }

    /// The average of two neighbours; `coloured` is the common coloured variance, rad².
    pub(super) fn joined(&self, later: &Self, coloured: f64) -> Self {
        Self::new(&self.mean().joined(&later.mean(), coloured))
    }

    /// A single bearing with the variance under which it pulls at a line as under heavy-tailed errors. An average stays as
    /// it is: its bearings were doubted when they joined it, and doubt upon doubt would grow with their number.
    pub(super) fn doubted(&self, config: &Config, origin_s: f64, line: &Line) -> Self {
        if config.tails.is_none() || self.count > 1 {
            return *self;
        }
        let mut mean = self.mean();
        let residual = wrap_pi(mean.azimuth - line.azimuth(&config.medium, origin_s + mean.t_s));
        let doubted = config.doubt(residual, mean.white, config.errors().0 * mean.scale * mean.scale).0;
        mean.white = mean.white.max(doubted);
        Self::new(&mean)
    }

    /// The same, counted from another origin `ticks` later.
    pub(super) fn shifted(&self, ticks: u32) -> Self {
        Self { time: self.time.saturating_sub(ticks), ..*self }
    }

    /// Whole ticks after the origin.
    pub(super) fn ticks(&self) -> u32 {
        self.time
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn packing_keeps_what_a_fit_can_use() {
        for x in [3e-8f32, 1.0, 0.999, 12.5, 1e5] {
            assert!((Short::new(x).get() / x - 1.0).abs() < 5e-4, "{x}");
        }
        assert_eq!((Short::new(0.0).get(), Short::new(1e-15).get()), (0.0, 0.0));
        assert_eq!((Short::new(f32::INFINITY).get(), Short::new(1e9).get()), (f32::INFINITY, f32::INFINITY));
        for t_s in [0.0, 0.5, 100_000.5] {
            for azimuth in [-0.3, 0.0, 6.2, 9.0] {
                let mean = Mean {
                    t_s,
                    azimuth,
                    white: 1e-4,
                    scale: 1.0,
                    elevation: (-0.4, 1e-3),
                    count: 1,
                    span_s: 0.0,
                };
                let kept = Node::new(&mean).mean();
                assert!((kept.t_s - t_s).abs() < 2e-5 && wrap_pi(kept.azimuth - azimuth).abs() < 1e-9);
                assert!((kept.elevation.0 + 0.4).abs() < 3e-5 && kept.scale == 1.0);
            }
        }
        assert_eq!(size_of::<Node>(), 20);
    }

    #[test]
    fn error_of_an_average_is_that_of_its_bearings() {
        let tau_s = 5.0;
        for n in [2u16, 3, 8, 40] {
            let times: Vec<f64> = (0..n).map(|k| 0.7 * f64::from(k)).collect();
            let centre = 0.35 * f64::from(n - 1);
            let weight = 1.0 / f64::from(n);
            let factor: f64 = times.iter().map(|t| weight * m::exp((t - centre) / tau_s)).sum();
            let mut own = 0.0;
            for a in &times {
                own += times.iter().map(|b| weight * weight * m::exp(-(a - b).abs() / tau_s)).sum::<f64>();
            }
            let mean = Mean {
                t_s: centre,
                azimuth: 0.0,
                white: 1.0,
                scale: 2.0,
                elevation: (0.0, f64::INFINITY),
                count: n,
                span_s: 0.7 * f64::from(n - 1),
            };
            let kept = mean.colour(tau_s);
            assert!((kept.factor - 2.0 * factor).abs() < 1e-9 && (kept.own - 4.0 * own).abs() < 1e-9, "{n}");
            let variance: f64 = times.iter().map(|t| weight * (t - centre) * (t - centre)).sum();
            assert!((mean.time_variance() - variance).abs() < 1e-9);
        }
    }
}
