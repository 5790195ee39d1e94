//! Whether a vessel changed its speed or its course while it was heard, and what that does to a straight fit.
//!
//! In: the bearings, what is assumed of their errors, and the fitted line with its normal equations. Out: constant acceleration along the
//! course and constant turning, each about the closest point or the end of the record next to it, as two more parameters of the fit to
//! first order: what the residuals hold along their patterns once the line's own parameters are taken out (a score test), and by how much
//! every parameter of the line is off for them.
//!
//! A turn shows in the bearings. An acceleration hardly does: about the closest point `∂α/∂a = s·½q u²g/v` with `u² q² g = 1 − g`, a constant
//! and the pattern of `t_c` (`∂α/∂t_c = −s q g`), so that to first order bearings alone cannot tell it from another heading and another time.
//! It is in the deviations only as far as the caller assumes one.
//! Assumes both small: the second order is left out. Cost: two whitenings.

use super::ml::{Config, Sample};
use super::model::{Limits, Line, PARAMETERS};
use super::normal::{COLUMNS, Matrix, Normal};
use super::slow;
use super::solution::floor;
use super::whiten::{Factorisation, Workspace};
use crate::angle::wrap_pi;
use crate::kit::spd;
use crate::math::f64 as m;
use crate::network::locate::misfit_limit;

/// What is tested for: acceleration, then turning.
const PATTERNS: usize = 2;
/// Chance at which bearings of a straight course count as contradicting it.
const CHANCE: f64 = 1e-3;
/// Greatest acceleration and turning that are looked for, standard deviations, m/s² and radians a second (0.6° a second): a way to keep what
/// bearings do not tell finite, far beyond what a ship does.
const WIDEST: [f64; PATTERNS] = [0.05, 0.01];
/// Acceleration of a vessel that does not hold its course, standard deviation, m/s²: the largest of 53 straight legs of 200 s of 13 vessels
/// under way in the Solent (AIS, 12 January 2016), of which half changed speed by less than 0.0007 and 90 % by less than 0.005.
const MANOEUVRING: f64 = 0.015;

/// What a vessel did other than going straight at constant speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// It changed speed.
    Acceleration,
    /// It turned.
    Turn,
}

impl Pattern {
    /// Its name in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Acceleration => "acceleration",
            Self::Turn => "turn",
        }
    }
}

/// Acceleration and turning as the residuals tell them, and what they do to the line.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    /// What the residuals show beyond chance, the clearer of the two.
    pub seen: Option<Pattern>,
    /// Turning to starboard, radians a second, and its standard deviation.
    pub turn_rad_s: (f64, f64),
    /// By what 1 m/s² along the course moves each parameter of the fitted line.
    pub by_acceleration: [f64; PARAMETERS],
    /// What the parameters' covariance has to count besides the errors of the bearings.
    pub added: Matrix,
    /// Squared residual a degree of freedom once acceleration and turning are taken out: the scatter of the residuals themselves.
    pub scatter: f64,
}

/// Derivatives of one bearing by acceleration (m/s²) and turning (rad/s): azimuth, then elevation.
struct Rows {
    line: Line,
    q: f64,
    /// Time from the closest point about which both are meant, s.
    about_s: f64,
    height_m: f64,
}

impl Rows {
    fn of(line: &Line, limits: &Limits, height_m: f64) -> Self {
        let about_s = line.p[1].max(limits.times_s.0).min(limits.times_s.1) - line.p[1];
        Self { line: *line, q: m::exp(line.p[2]), about_s, height_m }
    }

    fn at(&self, azimuth: f64) -> [[f64; PATTERNS]; 2] {
        let Self { line, q, about_s, height_m } = self;
        // The angle from the closest point's bearing gives the time of emission.
        let turned = line.sense * (azimuth - line.p[0]);
        let (sine, cosine) = m::sin_cos(turned);
        let x = sine / cosine.max(1e-9);
        let g = cosine * cosine;
        let since = x / q - about_s;
        // Displacement along and, over the speed, across the course, for a unit of each.
        let along = 0.5 * since * since;
        let speed = line.speed_m_s();
        let of_azimuth = [line.sense * q * g * along / speed, q * x * g * along];
        let range = line.cpa_range_m() * m::sqrt(1.0 + x * x);
        let by_ln_range = -height_m * range / (range * range + height_m * height_m);
        let of_elevation =
            [by_ln_range * q * x * g * along / speed, -line.sense * by_ln_range * q * g * along];
        [of_azimuth, of_elevation]
    }
}

/// The fit extended by both patterns.
struct Extended {
    /// Information of the patterns once the line's parameters are taken out, and the score.
    schur: [[f64; PATTERNS]; PATTERNS],
    score: [f64; PATTERNS],
    /// Parameters' answer to each pattern: `F⁻¹ B`.
    answer: [[f64; PARAMETERS]; PATTERNS],
}

/// Tests a fitted line. `free`: parameters of the line that were fitted; `acceleration_sd`: standard deviation of the acceleration a
/// vessel is assumed to have without its being seen, m/s² (0: none). `None` where the line stands at a limit, or too few bearings are left.
pub(super) fn change<const N: usize>(
    config: &Config,
    samples: &[Sample],
    (line, normal): (&Line, &Normal),
    free: &[bool; PARAMETERS],
    limits: &Limits,
    freedom: f64,
    factorisation: &Factorisation,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Change> {
    let left = freedom - PATTERNS as f64;
    if left < 1.0 || line.at_limit(limits) != 0 {
        return None;
    }
    let covariance = normal.covariance(free, &floor(limits, line.speed_m_s()))?;
    let mut found = extended(config, samples, line, &covariance, limits, free, factorisation, work, dense)?;
    // Another estimator's line is not quite at the minimum.
    for (score, answer) in found.score.iter_mut().zip(&found.answer) {
        *score -= spd::dot(answer, &normal.gradient);
    }
    let mut tested = found.schur;
    for (k, sd) in WIDEST.iter().enumerate() {
        tested[k][k] += 1.0 / (sd * sd);
    }
    let of_both = spd::solve(&tested, &found.score)?;
    let both = spd::dot(&found.score, &of_both);
    let alone = |k: usize| found.score[k] * found.score[k] / tested[k][k];
    // Elevations with deviations that count what lasts scatter by less than these say.
    let least = if config.white_share > 0.0 { 1.0 } else { 1e-12 };
    let each = ((normal.cost() - both) / left).max(least);
    let slowly = averages(config, samples, line, &found, &of_both, limits);
    let scatter = slowly.map_or(each, |(x, freedom)| {
        if x * freedom > misfit_limit(freedom as u32) * each { x.max(each) } else { each }
    });
    // F of two and so many degrees of freedom exceeds x with the chance (1 + 2x/d)^(−d/2).
    let beyond = both / (scatter * left) > m::exp(-2.0 / left * m::ln(CHANCE)) - 1.0;
    let clearer = usize::from(alone(1) > alone(0));
    let seen = beyond.then_some(if clearer == 1 { Pattern::Turn } else { Pattern::Acceleration });
    let one = misfit_limit(1) * scatter;
    let counted = |k: usize| beyond && (k == clearer || both - alone(1 - k) > one);
    // What is not seen is as large as it is assumed to be.
    let assumed =
        if beyond { config.acceleration_sd_m_s2.max(MANOEUVRING) } else { config.acceleration_sd_m_s2 };
    let mut information = [[0.0; PATTERNS]; PATTERNS];
    let mut score = [0.0; PATTERNS];
    let used = [counted(0) || assumed > 0.0, counted(1)];
    for i in 0..PATTERNS {
        for j in 0..PATTERNS {
            if used[i] && used[j] {
                information[i][j] = found.schur[i][j] / scatter;
            }
        }
        if used[i] {
            let sd = if i == 0 && !counted(0) { assumed } else { WIDEST[i] };
            information[i][i] += 1.0 / (sd * sd);
            score[i] = found.score[i] / scatter;
        } else {
            information[i][i] = 1.0;
        }
    }
    let spread = spd::inverse(&information)?;
    let told = spd::times(&spread, &score);
    let mut added = [[0.0; PARAMETERS]; PARAMETERS];
    for i in (0..PATTERNS).filter(|i| used[*i]) {
        for j in (0..PATTERNS).filter(|j| used[*j]) {
            let weight = spread[i][j] + told[i] * told[j];
            for (row, a) in added.iter_mut().zip(&found.answer[i]) {
                for (x, b) in row.iter_mut().zip(&found.answer[j]) {
                    *x += weight * a * b;
                }
            }
        }
    }
    let sd_turn = m::sqrt(scatter / tested[1][1]);
    Some(Change {
        seen,
        turn_rad_s: (found.score[1] / tested[1][1], sd_turn),
        by_acceleration: found.answer[0],
        added,
        scatter,
    })
}

/// The same averages as of [`slow`] of what is left once both are taken out.
fn averages(
    config: &Config,
    samples: &[Sample],
    line: &Line,
    found: &Extended,
    told: &[f64; PATTERNS],
    limits: &Limits,
) -> Option<(f64, f64)> {
    let view = line.view(&config.medium);
    let rows = Rows::of(line, limits, 0.0);
    slow::averaged(config, samples, |s| {
        let e = view.expected(s.t_s);
        let [pattern, _] = rows.at(e.azimuth);
        let mut residual = wrap_pi(s.azimuth_rad - e.azimuth);
        for ((pattern, answer), told) in pattern.iter().zip(&found.answer).zip(told) {
            // The line gives way by −F⁻¹B for each unit: `answer` is what it was off.
            residual -= told * (pattern - spd::dot(answer, &e.d_azimuth));
        }
        residual
    })
}

#[allow(clippy::too_many_arguments, reason = "one step of `change`, cut out for length")]
fn extended<const N: usize>(
    config: &Config,
    samples: &[Sample],
    line: &Line,
    covariance: &Matrix,
    limits: &Limits,
    free: &[bool; PARAMETERS],
    factorisation: &Factorisation,
    work: &mut Workspace<N>,
    dense: &[f64],
) -> Option<Extended> {
    let view = line.view(&config.medium);
    let rows = Rows::of(line, limits, config.medium.height_m);
    // The whitening takes five columns and a sixth: the patterns stand where speed and the elevations' bias are, which azimuths hardly tell and
    // not at all; what they have in common with speed is that of a second pass, its derivative in the residual's place.
    let mut pass = |by_speed: bool| {
        let mut next = samples.iter();
        factorisation.normal(samples.iter().map(|s| s.t_s), work, dense, |_, t| {
            let mut row = [0.0; COLUMNS];
            let Some(sample) = next.next() else { return row };
            let e = view.expected(t);
            let [pattern, _] = rows.at(e.azimuth);
            let scale = 1.0 / f64::from(sample.sd_rad);
            let [a, b, c, speed, _] = e.d_azimuth;
            let last = if by_speed { speed } else { wrap_pi(sample.azimuth_rad - e.azimuth) };
            for (x, value) in row.iter_mut().zip([a, b, c, pattern[0], pattern[1], last]) {
                *x = value * scale;
            }
            row
        })
    };
    let azimuths = pass(false)?;
    let speed = pass(true)?;
    let gram = azimuths.gram();
    let with_speed = speed.gram();
    let mut border = [[0.0; PARAMETERS]; PATTERNS];
    let mut schur = [[0.0; PATTERNS]; PATTERNS];
    let mut score = [0.0; PATTERNS];
    for k in 0..PATTERNS {
        for i in 0..3 {
            border[k][i] = gram[i][3 + k];
        }
        border[k][3] = with_speed[3 + k][COLUMNS - 1];
        score[k] = gram[3 + k][COLUMNS - 1];
    }
    schur[0] = [gram[3][3], gram[3][4]];
    schur[1] = [gram[3][4], gram[4][4]];
    if config.medium.height_m > 0.0 {
        for s in samples.iter().filter(|s| s.elevation_rad.1.is_finite()) {
            let e = view.expected(s.t_s);
            let [_, pattern] = rows.at(e.azimuth);
            let weight = 1.0 / (f64::from(s.elevation_rad.1) * f64::from(s.elevation_rad.1));
            let residual = f64::from(s.elevation_rad.0) - e.elevation;
            for k in 0..PATTERNS {
                for (b, d) in border[k].iter_mut().zip(&e.d_elevation) {
                    *b += weight * pattern[k] * d;
                }
                for l in 0..PATTERNS {
                    schur[k][l] += weight * pattern[k] * pattern[l];
                }
                score[k] += weight * pattern[k] * residual;
            }
        }
    }
    for border in &mut border {
        for (b, free) in border.iter_mut().zip(free) {
            if !free {
                *b = 0.0;
            }
        }
    }
    let answer = border.map(|b| spd::times(covariance, &b));
    for k in 0..PATTERNS {
        for l in 0..PATTERNS {
            schur[k][l] -= spd::dot(&border[k], &answer[l]);
        }
        // Rounding leaves nothing below zero.
        schur[k][k] = schur[k][k].max(0.0);
    }
    let finite = schur.iter().flatten().chain(&score).chain(answer.iter().flatten()).all(|x| x.is_finite());
    finite.then_some(Extended { schur, score, answer })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ml::fit;
    use crate::motion::test_pass::{self, normal};
    use std::boxed::Box;
    use std::vec::Vec;

    const SD_RAD: f64 = 0.5 * core::f64::consts::PI / 180.0;
    const HEADING_RAD: f64 = 0.7;

    fn config(acceleration_sd_m_s2: f64) -> Config {
        Config { acceleration_sd_m_s2, ..test_pass::config() }
    }

    /// 300 s of a vessel that passes 500 m away in their middle, at 7 m/s there.
    fn passing(acceleration_m_s2: f64, turn_rad_s: f64, seed: u64) -> Vec<Sample> {
        let mut normal = normal(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let position = |t: f64| {
            // Steps of a tenth of a second from the middle.
            let (n, mut at) =
                ((10.0 * t.abs()).round() as i32, [500.0 * HEADING_RAD.cos(), -500.0 * HEADING_RAD.sin()]);
            for k in 0..n {
                let s = t.signum() * 0.1 * (f64::from(k) + 0.5);
                let (heading, speed) = (HEADING_RAD + turn_rad_s * s, 7.0 + acceleration_m_s2 * s);
                at[0] += t.signum() * 0.1 * speed * heading.sin();
                at[1] += t.signum() * 0.1 * speed * heading.cos();
            }
            at
        };
        let of = |k: i32| {
            let t_s = f64::from(k) - 150.0;
            let [x, y] = position(t_s);
            Sample::azimuth(t_s, x.atan2(y) + SD_RAD * normal(), SD_RAD)
        };
        (0..301).map(of).collect()
    }

    /// Passes of 40 in which a change was seen, and in which heading, time and range were within 1.96 deviations.
    fn counts(acceleration_sd: f64, acceleration: f64, turn_rad_s: f64) -> (usize, [usize; 3]) {
        let mut work = Box::new(Workspace::<512>::new());
        let (mut seen, mut inside) = (0, [0; 3]);
        for seed in 0..40 {
            let samples = passing(acceleration, turn_rad_s, 11 + seed);
            let found = fit(&config(acceleration_sd), &samples, &mut work, &mut []).unwrap();
            seen += usize::from(found.change.unwrap().seen.is_some());
            let s = &found.solution;
            let off = [
                (wrap_pi(s.heading_rad - HEADING_RAD), s.sd_heading_rad),
                (s.cpa_time_s, s.sd_cpa_time_s),
                (s.cpa_range_m - 500.0, s.sd_cpa_range_m),
            ];
            for (n, (off, sd)) in inside.iter_mut().zip(off) {
                *n += usize::from(off.abs() < 1.96 * sd);
            }
        }
        (seen, inside)
    }

    #[test]
    fn a_straight_pass_shows_no_change_and_keeps_its_deviations() {
        let (seen, inside) = counts(0.0, 0.0, 0.0);
        assert!(seen <= 1 && inside.iter().all(|n| *n >= 34), "{seen} {inside:?}");
    }

    #[test]
    fn a_slow_turn_is_seen_and_counted() {
        for turn_deg_s in [0.03, -0.05, 0.1] {
            let (seen, inside) = counts(0.0, 0.0, turn_deg_s * core::f64::consts::PI / 180.0);
            assert!(seen >= 39 && inside.iter().all(|n| *n >= 36), "{turn_deg_s}: {seen} {inside:?}");
        }
    }

    #[test]
    fn an_acceleration_that_is_assumed_is_counted() {
        let (_, without) = counts(0.0, 0.003, 0.0);
        let (_, with) = counts(0.003, 0.003, 0.0);
        assert!(without[0] < 5 && with.iter().all(|n| *n >= 38), "{without:?} {with:?}");
    }
}
