//! Bearings from measured arrival-time differences: least squares over the six pairs, wrong peaks left out.
//!
//! Enters: six delays `τ_ij = t_j − t_i` in seconds, with their time. Leaves: a direction with covariance, closure,
//! residual and quality, and whether it is accepted.
//!
//! `(α, β) = argmin Σ (τ_ij − τ_ij(α, β))²` [M 31, N 21] by Gauss-Newton from the linear solution of the unconstrained
//! slowness vector; its length (in units of 1/c) should be one and is tested. One or two pairs whose correlation peak was
//! a wrong one are found by leaving them out; the recent accepted bearings say which of the consistent solutions is the
//! vessel's ([`Continuity`]). Before continuity is established only solutions from five or six pairs count, and a set is
//! accepted at once if all six agree within half of the tolerances.
//!
//! Assumptions: one source; errors of the pairs alike and independent apart from wrong peaks. Fails when most pairs are
//! wrong in the same way (a multipath that hits all hydrophones alike) for longer than continuity remembers.
//! Cost: about 40 000 instructions a set.

use super::continuity::{Continuity, ExpectedDirection};
use super::report::closure;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::{Geometry, PAIRS};
use crate::kit::{Factor, Normal, reweighted};
use crate::math::f32 as m;

/// Root-mean-square residual of a consistent set, as a share of the time across the array: about 1.3° of direction.
/// With 10 µs steps on a 1 m array this is 15 µs (docs/references.md).
const RESIDUAL_SHARE: f32 = 0.0225;
/// How far the length of the unconstrained solution may be from one.
const LENGTH_TOLERANCE: f32 = 0.05;
/// Share of both tolerances within which a set of all six pairs is believed without bearings before it.
const ALONE_SHARE: f32 = 0.5;
/// Gauss-Newton steps: the problem is nearly linear.
const STEPS: usize = 4;
/// What leaving out one more pair must gain, in units of the squared residual tolerance: the residual of six honest
/// pairs falls by about a sixth with every pair left out.
const DROP_COST: f32 = 0.35;

/// What is needed to turn delays into directions.
#[derive(Clone, Debug)]
pub struct Solver {
    geometry: Geometry,
    /// Of wavefronts whose source no surface tells the distance of, 1/m.
    curvature: f32,
    /// Of the depth below a surface that sources are at, 1/m; 0: none.
    per_depth: f32,
    /// Greatest root-mean-square residual of a consistent set, s.
    tolerance_s: f32,
    /// Range of sines of elevation admitted.
    elevation: (f32, f32),
    /// Standard deviation of the hydrophones' coordinates, as time, s, and relative one of the speed of sound.
    position_sd_s: f32,
    speed_sd: f32,
    /// Standard deviation of what each hydrophone's arrivals are off by in all sets, s.
    late_s: [f32; CHANNELS],
}

/// One set's direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DelaySolution {
    /// Unit vector towards the source.
    pub direction: Direction,
    /// Azimuth, radians clockwise from North.
    pub azimuth: f32,
    /// Elevation, radians.
    pub elevation: f32,
    /// Variance of azimuth, rad².
    pub var_azimuth: f32,
    /// Variance of elevation, rad².
    pub var_elevation: f32,
    /// Covariance, rad².
    pub cov: f32,
    /// Root-mean-square residual of the pairs used, s.
    pub residual_s: f32,
    /// Root-mean-square closure of the four triangles of all pairs, s.
    pub closure_s: f32,
    /// Length of the unconstrained solution (one for a perfect set).
    pub length: f32,
    /// Pairs left out, bit p for pair p.
    pub dropped: u8,
    /// 0 (useless) to 1 (all pairs agree exactly).
    pub quality: f32,
    /// Passed residual, length and continuity tests.
    pub accepted: bool,
}

/// A fit to a subset of the pairs.
#[derive(Clone, Copy, Debug)]
struct Fit {
    used: u8,
    direction: Direction,
    residual_s: f32,
    /// Of all six pairs: the part of the squared residuals that closes around every triangle, s².
    shared_s2: Option<f32>,
    length: f32,
    /// Inverse of JᵀJ in the tangent plane.
    inverse: [[f32; 2]; 2],
}

impl Solver {
    /// A solver for an array; `range_m` infinite means plane waves. `tolerance_s` replaces the default residual limit
    /// (a share of the time across the array) where given.
    pub fn new(
        geometry: &Geometry,
        range_m: f64,
        tolerance_s: Option<f64>,
        elevation_deg: (f64, f64),
    ) -> Self {
        let mut longest = 0.0f32;
        for p in 0..PAIR_COUNT {
            longest = longest.max(geometry.separation_m(p) / geometry.sound_speed_m_s);
        }
        let sine = |deg: f64| crate::math::f64::sin(deg * crate::angle::RAD_PER_DEG) as f32;
        Self {
            geometry: *geometry,
            curvature: (1.0 / range_m) as f32,
            per_depth: 0.0,
            tolerance_s: tolerance_s.map_or(RESIDUAL_SHARE * longest, |t| t as f32),
            elevation: (sine(elevation_deg.0), sine(elevation_deg.1)),
            position_sd_s: 0.0,
            speed_sd: 0.0,
            late_s: [0.0; CHANNELS],
        }
    }

    /// The same for sources at a surface this far above the array (m): how far away what comes from above is, its elevation tells, and `range_m` nothing.
    #[must_use]
    pub fn under_surface(self, depth_m: f64) -> Self {
        Self { per_depth: (1.0 / depth_m) as f32, ..self }
    }

    /// Curvature of the wavefront from a direction, 1/m.
    fn curvature(&self, u: &Direction) -> f32 {
        if self.per_depth > 0.0 && u[2] > 0.0 { u[2] * self.per_depth } else { self.curvature }
    }

    /// The same for hydrophones whose coordinates, and a speed of sound which, are known to such standard deviations (m, m/s):
    /// errors that last, and are in every direction's covariance.
    #[must_use]
    pub fn uncertain(self, position_sd_m: f64, sound_speed_sd_m_s: f64) -> Self {
        let c = self.geometry.sound_speed_m_s;
        Self { position_sd_s: position_sd_m as f32 / c, speed_sd: sound_speed_sd_m_s as f32 / c, ..self }
    }

    /// The same for hydrophones whose arrivals may be off in all sets, by such standard deviations each (s): in every direction's covariance
    /// too.
    #[must_use]
    pub fn late(self, late_s: [f64; CHANNELS]) -> Self {
        Self { late_s: late_s.map(|x| x as f32), ..self }
    }

    /// The residual limit in use, s.
    pub fn tolerance_s(&self) -> f32 {
        self.tolerance_s
    }

    /// Solves one set of delays at time `t_s` (seconds, rising). `None` where the delays are not finite or no subset of
    /// the pairs gives a direction at all.
    pub fn solve(
        &self,
        continuity: &mut Continuity,
        t_s: f64,
        delays_s: &[f32; PAIR_COUNT],
    ) -> Option<DelaySolution> {
        if delays_s.iter().any(|d| !d.is_finite()) {
            return None;
        }
        let predicted = continuity.predict(t_s);
        let mut best: Option<(f32, Fit)> = None;
        let mut whole: Option<Fit> = None;
        for used in 1u8..64 {
            let count = used.count_ones();
            // Three pairs of four hydrophones agree with some direction whatever they measured: nothing is left to contradict it.
            if count < 4 {
                continue;
            }
            let Some(fit) = self.fit(used, delays_s) else { continue };
            if count == 6 {
                whole = Some(fit);
            }
            if !self.consistent(&fit) {
                continue;
            }
            let misfit = fit.residual_s / self.tolerance_s;
            let mut cost = misfit * misfit + DROP_COST * (6 - count) as f32;
            match predicted {
                Some(p) => {
                    let off = wavefront::dot(&p.direction, &fit.direction).clamp(-1.0, 1.0);
                    let off = m::acos(off) / p.gate;
                    if off > 1.0 && count < 5 {
                        continue;
                    }
                    cost += (off * off).min(4.0);
                }
                None if count < 5 => continue,
                None => {}
            }
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, fit));
            }
        }
        let closure_s = closure(delays_s);
        match best {
            Some((_, fit)) => {
                let continues = continuity.judge(t_s, &fit.direction);
                let accepted = continues || (predicted.is_none() && self.stands_alone(&fit));
                if accepted {
                    let spread = fit.inverse[0][0] + fit.inverse[1][1];
                    let about = |p: ExpectedDirection| {
                        let off = m::acos(wavefront::dot(&p.direction, &fit.direction).clamp(-1.0, 1.0));
                        // The prediction's own errors are independent of the set's, and add to them.
                        off * off / (spread * (1.0 + p.variance))
                    };
                    continuity.learn_scatter(fit.residual_s, fit.used.count_ones(), predicted.map(about));
                    if let Some(shared_s2) = fit.shared_s2 {
                        continuity.learn_shared(shared_s2);
                    }
                }
                Some(self.solution(&fit, closure_s, accepted, continuity))
            }
            None => whole.map(|fit| self.solution(&fit, closure_s, false, continuity)),
        }
    }

    /// Whether a set is good enough to be believed without bearings before it: every pair agrees, closely.
    fn stands_alone(&self, fit: &Fit) -> bool {
        fit.used.count_ones() == PAIR_COUNT as u32
            && fit.residual_s <= ALONE_SHARE * self.tolerance_s
            && m::abs(fit.length - 1.0) <= ALONE_SHARE * LENGTH_TOLERANCE
    }

    fn consistent(&self, fit: &Fit) -> bool {
        fit.residual_s <= self.tolerance_s
            && m::abs(fit.length - 1.0) <= LENGTH_TOLERANCE
            && fit.direction[2] >= self.elevation.0
            && fit.direction[2] <= self.elevation.1
    }

    /// Least squares over the pairs in `used`.
    fn fit(&self, used: u8, delays: &[f32; PAIR_COUNT]) -> Option<Fit> {
        let linear = self.linear(used, delays)?;
        let length = m::sqrt(wavefront::dot(&linear, &linear));
        if length < 1e-3 {
            return None;
        }
        let start = linear.map(|x| x / length);
        let equations = |_, direction: &Direction| {
            let normal = self.linearised(used, delays, direction);
            let [[aa, ab], [_, bb]] = normal.upper;
            // A ratio of eigenvalues beyond a thousand: the pairs leave one tangent undetermined here.
            (aa * bb - ab * ab > 1e-3 * aa * bb).then_some(normal)
        };
        let advance = |_, direction: &mut Direction, step: &[f64; 2]| {
            let [a, b] = step.map(|x| (x as f32).clamp(-0.5, 0.5));
            *direction = wavefront::stepped(direction, &wavefront::tangents(direction), a, b);
            true
        };
        let (direction, inverse) = reweighted(start, STEPS, equations, advance)?;
        let inverse = inverse.map(|row| row.map(|x| x as f32));
        let tau = wavefront::pair_delays(&wavefront::arrivals(
            &self.geometry,
            &direction,
            self.curvature(&direction),
        ));
        let mut square = 0.0;
        let mut of_hydrophone = [0.0f32; CHANNELS];
        for (p, ((i, j), (d, t))) in PAIRS.into_iter().zip(delays.iter().zip(&tau)).enumerate() {
            if used >> p & 1 == 1 {
                square += (d - t) * (d - t);
                for (h, sign) in [(i, -1.0), (j, 1.0)] {
                    if let Some(sum) = of_hydrophone.get_mut(h) {
                        *sum += sign * (d - t);
                    }
                }
            }
        }
        // Arrival times that explain most of the residuals are a quarter of these sums.
        let shared_s2 = (used.count_ones() == PAIR_COUNT as u32)
            .then(|| of_hydrophone.iter().map(|t| t * t).sum::<f32>() / CHANNELS as f32);
        let residual_s = m::sqrt(square / used.count_ones().max(1) as f32);
        direction.iter().chain([&residual_s]).all(|x| x.is_finite()).then_some(Fit {
            used,
            direction,
            residual_s,
            shared_s2,
            length,
            inverse,
        })
    }

    /// Normal equations of the tangent-plane step.
    fn linearised(&self, used: u8, delays: &[f32; PAIR_COUNT], u: &Direction) -> Normal<2> {
        let (e, curvature) = (wavefront::tangents(u), self.curvature(u));
        let g1 = wavefront::pair_delays(&wavefront::gradient(&self.geometry, u, &e.0, curvature));
        let g2 = wavefront::pair_delays(&wavefront::gradient(&self.geometry, u, &e.1, curvature));
        let tau = wavefront::pair_delays(&wavefront::arrivals(&self.geometry, u, curvature));
        let mut normal = Normal::default();
        for (p, ((a1, a2), (d, t))) in g1.iter().zip(&g2).zip(delays.iter().zip(&tau)).enumerate() {
            if used >> p & 1 == 1 {
                normal.observe(&[f64::from(*a1), f64::from(*a2)], f64::from(d - t), 1.0);
            }
        }
        normal
    }

    /// The unconstrained plane-wave solution `c·slowness` with `τ_ij = (h_i − h_j)·s/c`; `None` where the pairs do not
    /// span space.
    fn linear(&self, used: u8, delays: &[f32; PAIR_COUNT]) -> Option<[f32; 3]> {
        let c = self.geometry.sound_speed_m_s;
        let mut normal = Normal::default();
        for (p, ((i, j), tau)) in PAIRS.into_iter().zip(delays).enumerate() {
            if used >> p & 1 == 0 {
                continue;
            }
            let (hi, hj) = (self.geometry.position_m.get(i)?, self.geometry.position_m.get(j)?);
            let d = [hi[0] - hj[0], hi[1] - hj[1], hi[2] - hj[2]];
            normal.observe(&d.map(f64::from), f64::from(tau * c), 1.0);
        }
        let information = normal.information(&[true; 3]);
        let factor = Factor::new(&information)?;
        let scale = information[0][0] + information[1][1] + information[2][2];
        if factor.determinant() <= 1e-4 * scale * scale * scale {
            return None;
        }
        Some(factor.solve(&normal.gradient).map(|x| x as f32))
    }

    fn solution(&self, fit: &Fit, closure_s: f32, accepted: bool, continuity: &Continuity) -> DelaySolution {
        let (azimuth, elevation) = wavefront::angles(&fit.direction);
        let own = fit.residual_s * fit.residual_s * fit.used.count_ones() as f32
            / (fit.used.count_ones() as f32 - 2.0).max(1.0);
        // A single set's few residuals say little about its variance: the mean over accepted sets does.
        let told_s2 = CHANNELS as f32 * self.position_sd_s * self.position_sd_s;
        let variance = own.max(continuity.scatter_s2(told_s2));
        let lasting = self.lasting(fit);
        let horizontal = m::sqrt(fit.direction[0] * fit.direction[0] + fit.direction[1] * fit.direction[1]);
        let widen = 1.0 / horizontal.max(1e-3);
        let most = m::PI * m::PI / 3.0;
        let misfit = fit.residual_s / self.tolerance_s;
        let length_misfit = (fit.length - 1.0) / LENGTH_TOLERANCE;
        DelaySolution {
            direction: fit.direction,
            azimuth,
            elevation,
            var_azimuth: ((variance * fit.inverse[0][0] + lasting[0][0]) * widen * widen).min(most),
            var_elevation: (variance * fit.inverse[1][1] + lasting[1][1]).min(most),
            cov: ((variance * fit.inverse[0][1] + lasting[0][1]) * widen).clamp(-most, most),
            residual_s: fit.residual_s,
            closure_s,
            length: fit.length,
            dropped: !fit.used & 0x3f,
            quality: fit.used.count_ones() as f32
                / 6.0
                / (1.0 + misfit * misfit + 0.25 * length_misfit * length_misfit),
            accepted,
        }
    }
}

impl Solver {
    /// Covariance of the two tangents from what is not known of the hydrophones' coordinates and clocks, and of the speed of sound: each
    /// coordinate along the direction moves one hydrophone's arrival, the speed stretches all delays.
    fn lasting(&self, fit: &Fit) -> [[f32; 2]; 2] {
        let mut out = [[0.0; 2]; 2];
        if self.position_sd_s == 0.0 && self.speed_sd == 0.0 && self.late_s == [0.0; CHANNELS] {
            return out;
        }
        let (e, curvature) = (wavefront::tangents(&fit.direction), self.curvature(&fit.direction));
        let of = |t: &Direction| {
            wavefront::pair_delays(&wavefront::gradient(&self.geometry, &fit.direction, t, curvature))
        };
        let (g1, g2) = (of(&e.0), of(&e.1));
        let tau = wavefront::pair_delays(&wavefront::arrivals(&self.geometry, &fit.direction, curvature));
        // What a second of error of a hydrophone's arrival, and of all delays in proportion, does to the tangents.
        let mut moved = [[0.0f32; 2]; CHANNELS];
        let mut stretched = [0.0f32; 2];
        for (p, (((i, j), (a, b)), tau)) in PAIRS.into_iter().zip(g1.iter().zip(&g2)).zip(&tau).enumerate() {
            if fit.used >> p & 1 == 0 {
                continue;
            }
            for (k, row) in fit.inverse.iter().enumerate() {
                let gain = row[0] * a + row[1] * b;
                for (h, sign) in [(i, -1.0), (j, 1.0)] {
                    if let Some(x) = moved.get_mut(h).and_then(|m| m.get_mut(k)) {
                        *x += sign * gain;
                    }
                }
                if let Some(x) = stretched.get_mut(k) {
                    *x += gain * tau;
                }
            }
        }
        let square = |late: &f32| self.position_sd_s * self.position_sd_s + late * late;
        let arrivals = moved.iter().zip(self.late_s.iter().map(square));
        for (m, variance) in arrivals.chain([(&stretched, self.speed_sd * self.speed_sd)]) {
            for (row, a) in out.iter_mut().zip(m) {
                for (x, b) in row.iter_mut().zip(m) {
                    *x += variance * a * b;
                }
            }
        }
        out
    }
}

#[cfg(test)]
#[path = "tdoa_tests.rs"]
mod tests;
