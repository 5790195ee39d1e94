//! The recursive track filter: fixed memory and fixed work for every bearing.
//!
//! In: one bearing after the other. Out: the vessel's motion, whenever asked. Each bearing enters the bounded ring
//! ([`super::ring`]); then every living hypothesis takes one damped Gauss-Newton step over the ring, so the filter is
//! always linearised where it stands now and never keeps an early linearisation error, which is what an extended
//! Kalman filter over the same parameters suffers from. Hypotheses (both passing sides, several arcs) start from
//! [`super::start`] at growing intervals and die when another explains the bearings far better. Errors are
//! Gauss-Markov plus white ([`super::chain`]); speed has a prior; bearings belong to the time of emission.
//!
//! Assumes a straight track at constant speed. A bearing beyond the gate is refused; a run of refusals means that the
//! vessel has turned or is another one ([`Update::lost`]); a young track begins afresh instead. Cost on the Cortex-M7: two evaluations of a full ring a
//! hypothesis, about 10⁵ instructions; a seeding, about 10⁶, at the 6th, 9th, 13th, ... bearing.
//!
//! ```
//! use seabearing_core::motion::recursive::{Config, State, finish, update};
//! let config = Config { speed_sd_m_s: 0.0, speed_m_s: 7.0, ..Config::default() };
//! let mut state = State::default();
//! for k in 0..400 {
//!     let t = 0.5 * f64::from(k);
//!     // 500 m to the north at t = 100 s, heading east.
//!     update(&config, &mut state, t, libm::atan2(7.0 * (t - 100.0), 500.0), 1e-4);
//! }
//! let track = finish(&config, &state).unwrap();
//! assert!((track.cpa_range_m - 500.0).abs() < 15.0 && track.starboard);
//! ```

use super::chain::{Chain, Colour};
use super::model::{LN_SPEED, Limits, Line, PARAMETERS};
use super::normal::{COLUMNS, Normal, Point, Progress, descend, quadratic};
use super::ring::{Node, Ring};
pub use super::settings::Config;
use super::solution::{Solution, floor, solution as solution_of};
use super::start::{STARTS, emitted, starts};
use crate::angle::wrap_pi;

/// Hypotheses alive at once.
pub const HYPOTHESES: usize = 4;
/// A hypothesis this much worse in squared residual than the best is dropped (odds of 3 million to one).
const DEAD: f64 = 30.0;
/// Bearings before the first hypotheses.
const FIRST_SEEDING: u32 = 6;
/// Steps a new hypothesis takes when seeded, and the end-of-passage solution at most.
const SEED_STEPS: usize = 6;
const FINAL_STEPS: usize = 25;
/// Refusals in a row that mean the track no longer explains the bearings.
const LOST_AFTER: u16 = 8;
/// A track of fewer bearings than this may have begun with a wrong one, or run into a wrong arc: it begins afresh after
/// so many refusals in a row.
const YOUNG: u32 = 40;
const RESTART_AFTER: u16 = 3;
/// Memory of the running mean of normalised innovations, bearings.
const INNOVATION_MEMORY: f64 = 20.0;

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

/// What a bearing did to the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Whether the bearing was used.
    pub accepted: bool,
    /// Difference from what was predicted, radians; 0 before there is a prediction.
    pub innovation_rad: f64,
    /// Its square over its variance (expected 1), where there was a prediction.
    pub nis: Option<f64>,
    /// Running mean of the normalised squared innovations, refused bearings included (1 when the model holds).
    pub mean_nis: f64,
    /// Hypotheses alive.
    pub hypotheses: u8,
    /// The track has not explained the bearings for a while: a manoeuvre, or another vessel.
    pub lost: bool,
}

/// The filter's memory.
#[derive(Clone, Debug)]
pub struct State {
    ring: Ring,
    points: [Option<Point>; HYPOTHESES],
    seen: u32,
    next_seeding: u32,
    elevations: u32,
    first_t_s: f64,
    last_t_s: f64,
    mean_nis: f64,
    refused: u16,
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}

impl State {
    /// Nothing seen yet.
    pub const fn new() -> Self {
        Self {
            ring: Ring::new(),
            points: [None; HYPOTHESES],
            seen: 0,
            next_seeding: 0,
            elevations: 0,
            first_t_s: 0.0,
            last_t_s: 0.0,
            mean_nis: 0.0,
            refused: 0,
        }
    }

    /// Bearings used.
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// Time of the first and newest bearing used, s.
    pub fn times_s(&self) -> (f64, f64) {
        (self.first_t_s, self.last_t_s)
    }

    /// Running mean of normalised squared innovations.
    pub fn mean_nis(&self) -> f64 {
        self.mean_nis
    }

    fn best(&self) -> Option<&Point> {
        self.points.iter().flatten().min_by(|a, b| a.normal.cost().total_cmp(&b.normal.cost()))
    }

    fn limits(&self, config: &Config) -> Limits {
        Limits { range_m: config.range_m, ln_speed: LN_SPEED, times_s: (self.first_t_s, self.last_t_s) }
    }
}

/// Takes one bearing: time of reception, azimuth, variance its estimator reports.
pub fn update(config: &Config, state: &mut State, t_s: f64, azimuth_rad: f64, variance_rad2: f64) -> Update {
    measure(
        config,
        state,
        &Measurement { t_s, azimuth_rad, variance_rad2, extra_scale: 1.0, elevation: None },
    )
}

/// Takes one measurement.
pub fn measure(config: &Config, state: &mut State, measurement: &Measurement) -> Update {
    let Measurement { t_s, azimuth_rad, variance_rad2, extra_scale, elevation } = *measurement;
    let mut out = Update {
        accepted: false,
        innovation_rad: 0.0,
        nis: None,
        mean_nis: state.mean_nis,
        hypotheses: state.points.iter().flatten().count() as u8,
        lost: state.refused >= LOST_AFTER,
    };
    let sane =
        t_s.is_finite() && azimuth_rad.is_finite() && variance_rad2.is_finite() && extra_scale.is_finite();
    if !sane || variance_rad2 < 0.0 || extra_scale < 0.0 || (state.seen > 0 && t_s < state.last_t_s) {
        return out;
    }
    let white_extra = config.errors().2 * extra_scale * extra_scale;
    // Nothing is known better than this (a hundredth of a degree): keeps every matrix regular.
    let white = (variance_rad2 + white_extra).max(3e-8);
    if let Some((mean, variance)) = predict(config, state, t_s) {
        out.innovation_rad = wrap_pi(azimuth_rad - mean);
        let nis = out.innovation_rad * out.innovation_rad / (variance + white);
        out.nis = Some(nis);
        let gate = config.gate_sd * config.gate_sd;
        state.mean_nis += (nis.min(gate) - state.mean_nis) / INNOVATION_MEMORY;
        out.mean_nis = state.mean_nis;
        if nis > gate {
            state.refused = state.refused.saturating_add(1);
            out.lost = state.refused >= LOST_AFTER;
            if state.seen >= YOUNG || state.refused < RESTART_AFTER {
                return out;
            }
            // Too few bearings to say which were wrong: begin again with this one.
            *state = State::new();
        }
    }
    state.refused = 0;
    out.lost = false;
    if state.seen == 0 {
        state.first_t_s = t_s;
        state.next_seeding = FIRST_SEEDING;
        state.mean_nis = 1.0;
    }
    state.seen = state.seen.saturating_add(1);
    state.last_t_s = t_s;
    let elevation = match elevation {
        Some((e, v)) if config.medium.height_m > 0.0 && e.is_finite() && v > 0.0 => {
            state.elevations = state.elevations.saturating_add(1);
            (e as f32, v as f32)
        }
        _ => (0.0, f32::INFINITY),
    };
    let colour = Colour::single(extra_scale, white);
    let total = white + config.errors().0 * extra_scale * extra_scale;
    let node = Node {
        t_s,
        azimuth: azimuth_rad,
        colour,
        weight: 1.0 / total,
        elevation,
        time_variance: 0.0,
        span_s: (0.0, 0.0),
    };
    let line = state.best().map(|p| p.line);
    state.ring.push(node, line.as_ref(), config.errors().1);
    out.accepted = true;

    let limits = state.limits(config);
    let free = config.free();
    let State { ring, points, .. } = state;
    for point in points.iter_mut().flatten() {
        if let Some(normal) = evaluate(config, ring, &point.line) {
            point.normal = normal;
        }
        descend(point, &free, &limits, |line| evaluate(config, ring, line));
    }
    if state.seen >= state.next_seeding {
        state.next_seeding = state.seen.saturating_add(state.seen / 2);
        seed(config, state, SEED_STEPS);
    }
    prune(state);
    out.hypotheses = state.points.iter().flatten().count() as u8;
    out
}

/// Azimuth expected at a time of reception and its variance (rad, rad²), the newest bearing's coloured error carried
/// along, the measurement's own white variance not included. `None` before there is a hypothesis.
pub fn predict(config: &Config, state: &State, t_s: f64) -> Option<(f64, f64)> {
    let best = state.best()?;
    let chain = chain(config, &state.ring, &best.line);
    let limits = state.limits(config);
    let covariance = best.normal.covariance(&config.free(), &floor(&limits, best.line.speed_m_s()))?;
    let expected = best.line.expected(&config.medium, t_s);
    let (coloured, variance) = chain.predict(t_s);
    let spread = quadratic(&expected.d_azimuth, &covariance, &expected.d_azimuth);
    let (mean, variance) = (expected.azimuth + coloured, variance + spread);
    (mean.is_finite() && variance.is_finite()).then_some((crate::angle::wrap_tau(mean), variance))
}

/// The running estimate; `None` until a hypothesis stands.
pub fn solution(config: &Config, state: &State) -> Option<Solution> {
    let best = state.best()?;
    report(config, state, best)
}

/// The end-of-passage solution: maximum likelihood over the ring, from all hypotheses and fresh starts, to
/// convergence. The state is left as it was.
pub fn finish(config: &Config, state: &State) -> Option<Solution> {
    let mut last = state.clone();
    seed(config, &mut last, FINAL_STEPS);
    let best = *last.best()?;
    report(config, state, &best)
}

fn report(config: &Config, state: &State, best: &Point) -> Option<Solution> {
    let free = config.free();
    let nodes = state.ring.nodes();
    let elevations = nodes.iter().filter(|n| n.elevation.1.is_finite()).count();
    let measurements = (nodes.len() + elevations) as f64;
    solution_of(&best.line, &best.normal, &free, &state.limits(config), state.seen, measurements)
}

/// Puts fresh starting hypotheses beside the living ones and lets all take `steps` steps.
fn seed(config: &Config, state: &mut State, steps: usize) {
    let limits = state.limits(config);
    let free = config.free();
    let State { ring, points, .. } = state;
    let nodes = ring.nodes();
    let fresh = starts(nodes.iter().map(|n| (n.t_s, n.azimuth)), nodes.len(), config.speed_m_s, &limits);
    let mut pool: [Option<Point>; HYPOTHESES + STARTS] = [None; HYPOTHESES + STARTS];
    let lines = points
        .iter()
        .map(|p| p.map(|p| p.line))
        .chain(fresh.iter().map(|s| s.map(|s| emitted(&s.line, &config.medium))));
    for (slot, line) in pool.iter_mut().zip(lines) {
        let Some(line) = line else { continue };
        let Some(normal) = evaluate(config, ring, &line) else { continue };
        let mut point = Point { line, normal, damping: 1e-3 };
        for _ in 0..steps {
            if descend(&mut point, &free, &limits, |line| evaluate(config, ring, line)) == Progress::Converged
            {
                break;
            }
        }
        *slot = Some(point);
    }
    // The best few that differ.
    *points = [None; HYPOTHESES];
    for slot in points.iter_mut() {
        let mut best: Option<usize> = None;
        for (i, p) in pool.iter().enumerate() {
            let Some(p) = p else { continue };
            let held = best.and_then(|b| pool.get(b)).and_then(Option::as_ref);
            if held.is_none_or(|h| p.normal.cost() < h.normal.cost()) {
                best = Some(i);
            }
        }
        let Some(chosen) = best.and_then(|b| pool.get(b)).copied().flatten() else { break };
        *slot = Some(chosen);
        for p in &mut pool {
            if p.is_some_and(|p| same(&p.line, &chosen.line)) {
                *p = None;
            }
        }
    }
}

/// Whether two hypotheses have run into the same minimum.
fn same(a: &Line, b: &Line) -> bool {
    let d = |k: usize| (a.p[k] - b.p[k]).abs();
    a.sense == b.sense && wrap_pi(a.p[0] - b.p[0]).abs() < 1e-3 && d(2) < 1e-2 && d(1) < 0.5
}

fn prune(state: &mut State) {
    let Some(best) = state.best().map(|p| p.normal.cost()) else { return };
    for slot in &mut state.points {
        if slot.is_some_and(|p| p.normal.cost() > best + DEAD) {
            *slot = None;
        }
    }
}

/// The factorisation of the ring's errors with residuals about `line`.
fn chain(config: &Config, ring: &Ring, line: &Line) -> Chain {
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
pub(crate) fn add_priors(
    normal: &mut Normal,
    line: &Line,
    speed_m_s: f64,
    speed_sd_m_s: f64,
    bias_sd_rad: f64,
) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::f64 as m;

    fn noise(seed: &mut u64) -> f64 {
        // Sum of twelve uniforms: Gaussian enough for a filter's test.
        (0..12)
            .map(|_| {
                *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (*seed >> 11) as f64 / (1u64 << 53) as f64
            })
            .sum::<f64>()
            - 6.0
    }

    fn pass(truth: &Line, config: &Config, sd: f64, from: i32, to: i32, seed: &mut u64) -> State {
        let mut state = State::default();
        for k in from..to {
            let t = 0.5 * f64::from(k);
            let a = truth.azimuth(&config.medium, t) + sd * noise(seed);
            update(config, &mut state, t, a, sd * sd);
        }
        state
    }

    #[test]
    fn demo_pass_is_found_on_both_sides() {
        let config = Config { speed_m_s: 7.0, speed_sd_m_s: 0.0, extra_sd_rad: 0.0, ..Config::default() };
        let mut seed = 7;
        for sense in [1.0, -1.0] {
            for sd_deg in [0.1, 0.5, 2.0] {
                let truth = Line { p: [0.05, 100.0, m::ln(7.0 / 500.0), m::ln(7.0), 0.0], sense };
                let state = pass(&truth, &config, f64::to_radians(sd_deg), 0, 400, &mut seed);
                for s in [solution(&config, &state).unwrap(), finish(&config, &state).unwrap()] {
                    assert!((s.cpa_time_s - 100.0).abs() < 2.0, "{s:?}");
                    assert!(wrap_pi(s.heading_rad - truth.heading_rad()).abs() < 1f64.to_radians(), "{s:?}");
                    assert!((s.cpa_range_m / 500.0 - 1.0).abs() < 0.03, "{s:?}");
                    assert_eq!(s.starboard, sense > 0.0);
                    assert!(s.range_observable && (0.6..1.5).contains(&s.consistency), "{s:?}");
                }
            }
        }
    }

    #[test]
    fn speed_prior_widens_range_only() {
        let mut seed = 3;
        let known = Config { speed_m_s: 7.0, speed_sd_m_s: 0.0, ..Config::default() };
        let prior = Config { speed_sd_m_s: 2.0, ..known };
        let truth = Line { p: [2.0, 100.0, m::ln(7.0 / 500.0), m::ln(7.0), 0.0], sense: 1.0 };
        let a = finish(&known, &pass(&truth, &known, 0.01, 0, 400, &mut seed.clone())).unwrap();
        let b = finish(&prior, &pass(&truth, &prior, 0.01, 0, 400, &mut seed)).unwrap();
        assert!((b.sd_cpa_range_m / 500.0 - 2.0 / 7.0).abs() < 0.03, "{b:?}");
        assert!((a.sd_heading_rad / b.sd_heading_rad - 1.0).abs() < 0.05);
        assert!((b.sd_speed_m_s - 2.0).abs() < 0.1 && a.sd_speed_m_s == 0.0);
    }

    #[test]
    fn a_bearing_that_does_not_move_has_no_range() {
        let config = Config::default();
        let mut state = State::default();
        let mut seed = 5;
        for k in 0..200 {
            update(&config, &mut state, f64::from(k), 0.01 * noise(&mut seed), 1e-4);
        }
        let s = finish(&config, &state).unwrap();
        assert!(!s.range_observable && s.sd_cpa_range_m.is_infinite(), "{s:?}");
        assert!(s.sd_heading_rad.is_infinite(), "{s:?}");
    }

    #[test]
    fn no_passage_is_shut_out_by_its_first_bearings() {
        let config = Config { speed_m_s: 7.0, speed_sd_m_s: 0.0, extra_sd_rad: 0.0, ..Config::default() };
        let truth = Line { p: [5.5, 100.0, m::ln(7.0 / 500.0), m::ln(7.0), 0.0], sense: 1.0 };
        let mut seed = 21;
        for run in 0..60 {
            let mut state = State::new();
            for k in 0..120 {
                let t = 0.5 * f64::from(k);
                // In every third passage one of the first bearings is a wrong peak.
                let wrong = if run % 3 == 0 && k == run / 10 { 1.0 } else { 0.0 };
                let a = truth.azimuth(&config.medium, t) + 0.0017 * noise(&mut seed) + wrong;
                update(&config, &mut state, t, a, 3e-6);
            }
            assert!(state.seen() > 90, "{run}: {}", state.seen());
        }
    }

    #[test]
    fn nonsense_is_refused_and_a_turn_is_noticed() {
        let config = Config::default();
        let truth = Line { p: [2.0, 60.0, m::ln(7.0 / 400.0), m::ln(7.0), 0.0], sense: 1.0 };
        let mut seed = 11;
        let mut state = pass(&truth, &config, 0.01, 0, 240, &mut seed);
        for (t, a, v) in
            [(f64::NAN, 1.0, 1e-4), (130.0, f64::INFINITY, 1e-4), (130.0, 1.0, -1.0), (3.0, 1.0, 1e-4)]
        {
            assert!(!update(&config, &mut state, t, a, v).accepted);
        }
        let mut lost = false;
        for k in 0..10 {
            lost |= update(&config, &mut state, 120.0 + f64::from(k), 0.2, 1e-4).lost;
        }
        assert!(lost);
        assert!(finish(&config, &State::default()).is_none());
    }
}
