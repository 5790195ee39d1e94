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
//! vessel has turned or is another one ([`Update::lost`]). A young track has run into a wrong arc instead, or begun with
//! a wrong bearing: its lines are searched afresh over all its bearings, those refused too, and only if no line
//! explains them does it begin again with those refused in a row. Cost on the Cortex-M7: two evaluations of a full ring a
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

use super::chain::Colour;
use super::hypotheses::{Hypotheses, chain};
use super::model::{LN_SPEED, Limits};
use super::normal::Point;
use super::ring::{Node, Ring};
pub use super::settings::{Config, MeasuredSpeed};
use super::solution::{Solution, floor, solution as solution_of};
use crate::angle::wrap_pi;
use crate::kit::spd::quadratic;
use crate::math::f64 as m;

/// Bearings before the first hypotheses.
const FIRST_SEEDING: u32 = 6;
/// Steps a new hypothesis takes when seeded, and the end-of-passage solution at most.
const SEED_STEPS: usize = 6;
const FINAL_STEPS: usize = 25;
/// Refusals in a row that mean the track no longer explains the bearings.
const LOST_AFTER: u16 = 8;
/// A track of fewer bearings than this may have begun with a wrong one, or run into a wrong arc: each refusal has it
/// searched afresh, and after so many in a row that no line explains together with the rest it begins again with them.
const YOUNG: u32 = 40;
const AFRESH_AFTER: usize = 3;
/// Squared residuals of a right line exceed their number by so many standard deviations once in 10⁴.
const CHANCE_SD: f64 = 4.0;
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
    lines: Hypotheses,
    /// What a young track has refused since its newest bearing.
    held: [Option<Node>; AFRESH_AFTER],
    speed: Option<MeasuredSpeed>,
    seen: u32,
    next_seeding: u32,
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
            lines: Hypotheses::new(),
            held: [None; AFRESH_AFTER],
            speed: None,
            seen: 0,
            next_seeding: FIRST_SEEDING,
            first_t_s: 0.0,
            last_t_s: 0.0,
            mean_nis: 1.0,
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

    fn limits(&self, config: &Config) -> Limits {
        Limits { range_m: config.range_m, ln_speed: LN_SPEED, times_s: (self.first_t_s, self.last_t_s) }
    }

    /// Adds a bearing to what is kept; the lines stay as they are.
    fn keep(&mut self, config: &Config, node: Node) {
        if self.seen == 0 {
            self.first_t_s = node.t_s;
        }
        self.seen = self.seen.saturating_add(1);
        self.last_t_s = node.t_s;
        let line = self.lines.best().map(|p| p.at);
        self.ring.push(node, line.as_ref(), config.errors().1);
        (self.held, self.refused) = ([None; AFRESH_AFTER], 0);
    }
}

/// Joins a measurement of the vessel's speed (its shaft rate's, say) to the configured prior, from now on; `None` takes
/// it back. The newest takes the place of the one before, whose errors it usually shares. A configured speed without
/// spread stays as it is.
pub fn set_speed(state: &mut State, measured: Option<MeasuredSpeed>) {
    state.speed = measured;
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
    let config = &config.with_speed(state.speed);
    let mut out = Update {
        accepted: false,
        innovation_rad: 0.0,
        nis: None,
        mean_nis: state.mean_nis,
        hypotheses: state.lines.count() as u8,
        lost: state.refused >= LOST_AFTER,
    };
    let Some(node) = node(config, measurement).filter(|n| state.seen == 0 || n.t_s >= state.last_t_s) else {
        return out;
    };
    if let Some((mean, variance)) = expected(config, state, node.t_s) {
        out.innovation_rad = wrap_pi(node.azimuth - mean);
        let nis = out.innovation_rad * out.innovation_rad / (variance + node.colour.white);
        out.nis = Some(nis);
        let gate = config.gate_sd * config.gate_sd;
        state.mean_nis += (nis.min(gate) - state.mean_nis) / INNOVATION_MEMORY;
        out.mean_nis = state.mean_nis;
        if nis > gate {
            state.refused = state.refused.saturating_add(1);
            out.lost = state.refused >= LOST_AFTER;
            if state.seen < YOUNG {
                out.accepted = reconsider(config, state, node);
                out.hypotheses = state.lines.count() as u8;
            }
            return out;
        }
    }
    out.lost = false;
    out.accepted = true;
    state.keep(config, node);
    let limits = state.limits(config);
    state.lines.step(config, &state.ring, &limits);
    if state.seen >= state.next_seeding {
        state.next_seeding = state.seen.saturating_add(state.seen / 2);
        state.lines.seed(config, &state.ring, &limits, SEED_STEPS);
    }
    state.lines.prune();
    out.hypotheses = state.lines.count() as u8;
    out
}

/// A measurement as it enters the ring; `None` if it is nonsense.
fn node(config: &Config, measurement: &Measurement) -> Option<Node> {
    let Measurement { t_s, azimuth_rad, variance_rad2, extra_scale, elevation } = *measurement;
    let sane =
        t_s.is_finite() && azimuth_rad.is_finite() && variance_rad2.is_finite() && extra_scale.is_finite();
    if !sane || variance_rad2 < 0.0 || extra_scale < 0.0 {
        return None;
    }
    let (coloured, _, white_extra) = config.errors();
    let scale2 = extra_scale * extra_scale;
    // Nothing is known better than this (a hundredth of a degree): keeps every matrix regular.
    let white = (variance_rad2 + white_extra * scale2).max(3e-8);
    let elevation = match elevation {
        Some((e, v)) if config.medium.height_m > 0.0 && e.is_finite() && v > 0.0 => (e as f32, v as f32),
        _ => (0.0, f32::INFINITY),
    };
    Some(Node {
        t_s,
        azimuth: azimuth_rad,
        colour: Colour::single(extra_scale, white),
        weight: 1.0 / (white + coloured * scale2),
        elevation,
        time_variance: 0.0,
        span_s: (0.0, 0.0),
    })
}

/// A young track has refused another bearing: its lines are searched afresh over all bearings, those refused too. If none
/// explains them, they are set aside, and after enough in a row only they remain. Answers whether the bearing is used.
fn reconsider(config: &Config, state: &mut State, node: Node) -> bool {
    if let Some(place) = state.held.iter_mut().find(|h| h.is_none()) {
        *place = Some(node);
    }
    let held = state.held;
    let mut all = state.clone();
    for node in held.into_iter().flatten() {
        all.keep(config, node);
    }
    all.lines = Hypotheses::new();
    all.lines.seed(config, &all.ring, &all.limits(config), FINAL_STEPS);
    all.lines.prune();
    all.mean_nis = 1.0;
    let freedom = f64::from(all.seen);
    let most = freedom + CHANCE_SD * m::sqrt(2.0 * freedom);
    if all.lines.best().is_some_and(|p| p.normal.cost() < most) {
        *state = all;
        return true;
    }
    if held.iter().any(Option::is_none) {
        return false;
    }
    *state = State { speed: state.speed, ..State::new() };
    for node in held.into_iter().flatten() {
        state.keep(config, node);
    }
    true
}

/// Azimuth expected at a time of reception and its variance (rad, rad²), the newest bearing's coloured error carried
/// along, the measurement's own white variance not included. `None` before there is a hypothesis.
pub fn predict(config: &Config, state: &State, t_s: f64) -> Option<(f64, f64)> {
    expected(&config.with_speed(state.speed), state, t_s)
}

fn expected(config: &Config, state: &State, t_s: f64) -> Option<(f64, f64)> {
    let best = state.lines.best()?;
    let chain = chain(config, &state.ring, &best.at);
    let limits = state.limits(config);
    let covariance = best.normal.covariance(&config.free(), &floor(&limits, best.at.speed_m_s()))?;
    let expected = best.at.expected(&config.medium, t_s);
    let (coloured, variance) = chain.predict(t_s);
    let spread = quadratic(&expected.d_azimuth, &covariance, &expected.d_azimuth);
    let (mean, variance) = (expected.azimuth + coloured, variance + spread);
    (mean.is_finite() && variance.is_finite()).then_some((crate::angle::wrap_tau(mean), variance))
}

/// The running estimate; `None` until a hypothesis stands.
pub fn solution(config: &Config, state: &State) -> Option<Solution> {
    report(&config.with_speed(state.speed), state, state.lines.best()?)
}

/// The end-of-passage solution: maximum likelihood over the ring, from all hypotheses and fresh starts, to
/// convergence. The state is left as it was.
pub fn finish(config: &Config, state: &State) -> Option<Solution> {
    let config = &config.with_speed(state.speed);
    let mut lines = state.lines.clone();
    lines.seed(config, &state.ring, &state.limits(config), FINAL_STEPS);
    report(config, state, lines.best()?)
}

fn report(config: &Config, state: &State, best: &Point) -> Option<Solution> {
    let free = config.free();
    let nodes = state.ring.nodes();
    let elevations = nodes.iter().filter(|n| n.elevation.1.is_finite()).count();
    let measurements = (nodes.len() + elevations) as f64;
    solution_of(&best.at, &best.normal, &free, &state.limits(config), state.seen, measurements)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Line;

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
        // Measured on the way: range and its spread are the measurement's.
        let mut state = pass(&truth, &prior, 0.01, 0, 400, &mut seed);
        set_speed(&mut state, MeasuredSpeed::new(7.7, 0.1));
        let c = finish(&prior, &state).unwrap();
        assert!((c.cpa_range_m / b.cpa_range_m - 1.1).abs() < 0.03 && c.sd_cpa_range_m < 12.0, "{c:?}");
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
