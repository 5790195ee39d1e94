//! Speed from the fall of a passing vessel's tones.
//!
//! A line of rest frequency f₀ is heard at `f₀ (1 − p ṙ)`, p the horizontal slowness of the sound where it arrives and ṙ the radial speed,
//! which on the straight course of a curve is `v s(t)`, `s = q u / √(1 + q²u²)` known from azimuths (`u` time from the closest point, q speed over
//! range there). So `ln f = a − v p s(t)` and v is a slope; f₀ need not be known, and for that very reason the shift itself tells nothing, only
//! its change. Engines do not turn evenly: `a` walks at random and comes back, how much and how soon is told by the line itself (filters of `a`, v
//! and the walk, each by its likelihood). All lines of a vessel may wander together: their mean has the deviation of the best, not less.

use super::course::Course;
use super::tones::Chain;
use super::{Known, Place};
use crate::propagation::Propagation;

/// Slowness where no table tells it, and its relative deviation, s/m: sound that goes 15° to 30° off the level.
const SLOWNESS: (f64, f64) = (1.0 / 1_680.0, 0.06);
/// Length over which a table's slowness is a mean, m, and how often it is read there.
const NODE_M: f64 = 10_000.0;
const STEPS: usize = 20;
/// Speed from which the range is taken at first, m/s, and how often it is taken anew.
const FIRST_M_S: f64 = 7.3;
const ROUNDS: usize = 3;
/// Most lines that are used, the longest.
const LINES: usize = 8;
/// By how much it may be wrong, m/s.
const UNKNOWN_M_S: f64 = 5.0;
/// Deviations of a line's frequency from one minute to the next of which the likeliest is taken, relative.
const ERRORS: [f64; 3] = [1e-5, 3e-5, 1e-4];
/// Walks of the engine within the square root of a minute, relative.
const WALKS: [f64; 4] = [1e-6, 1e-5, 3e-5, 1e-4];
/// Times after which it has come back, s; the longest are longer than any passage.
const BACK_S: [f64; 3] = [300.0, 1_800.0, 1e6];
/// Windows of three minutes begin each minute: so many say as much as one.
const OVERLAP: f64 = 3.0;
/// Greatest relative deviation of a speed that is told.
const KNOWN: f64 = 0.35;
/// Speeds of vessels, m/s.
const SPEEDS_M_S: (f64, f64) = (0.5, 20.0);

/// How a line's frequency errs, relative.
#[derive(Clone, Copy)]
struct Wander {
    /// Error of one minute.
    error: f64,
    /// Walk of the engine within the square root of a minute.
    walk: f64,
    /// Time after which it has come back, s.
    back_s: f64,
}

/// Slope and its variance, with the log-likelihood, of rows (time, logarithm of the frequency, regressor).
fn slope(rows: &[(f64, f64, f64)], w: Wander) -> Option<(f64, f64, f64)> {
    let (mut before, first, _) = *rows.first()?;
    // State: level, slope, and where the engine has walked to; wide priors of the first two.
    let mut x = [first, 0.0, 0.0];
    let far = w.walk * w.walk * w.back_s / 120.0;
    let mut p = [[1e-4, 0.0, 0.0], [0.0, 400.0, 0.0], [0.0, 0.0, far]];
    let mut log = 0.0;
    for (t_s, y, s) in rows {
        let kept = (-(t_s - before) / w.back_s).exp();
        before = *t_s;
        x[2] *= kept;
        for k in 0..3 {
            p[2][k] *= kept;
            p[k][2] *= kept;
        }
        p[2][2] += far * (1.0 - kept * kept);
        // y = level + s · slope + walked.
        let gain = [0, 1, 2].map(|k| p[k][0] + s * p[k][1] + p[k][2]);
        let all = gain[0] + s * gain[1] + gain[2] + OVERLAP * w.error * w.error;
        let e = y - x[0] - s * x[1] - x[2];
        log -= 0.5 * (e * e / all + all.ln());
        for i in 0..3 {
            x[i] += gain[i] / all * e;
            for k in 0..3 {
                p[i][k] -= gain[i] * gain[k] / all;
            }
        }
    }
    Some((x[1], p[1][1], log))
}

/// By how much a line of a vessel on that course moves between two times, relative, and how much that is not known by.
pub fn moves(course: &Course, from_s: f64, to_s: f64) -> (f64, f64) {
    let s = &course.solution;
    let passing = Passing { cpa_s: s.cpa_time_s, q: s.line.p[2].exp() };
    let change = (passing.shape(to_s) - passing.shape(from_s)) * SLOWNESS.0;
    (-FIRST_M_S * change, (UNKNOWN_M_S * change).abs())
}

/// Where the closest point is, by azimuths: its time, s, and the speed over the range there, 1/s.
#[derive(Clone, Copy)]
struct Passing {
    cpa_s: f64,
    q: f64,
}

impl Passing {
    /// The shape of the radial speed at a time: −1 long before the closest point, 1 long after.
    fn shape(self, t_s: f64) -> f64 {
        let x = self.q * (t_s - self.cpa_s);
        x / x.hypot(1.0)
    }

    /// Range at a time of a vessel of so many m/s.
    fn range_m(self, t_s: f64, speed_m_s: f64) -> f64 {
        speed_m_s / self.q * (self.q * (t_s - self.cpa_s)).hypot(1.0)
    }
}

/// Speed of one chain's vessel and its variance: mixture over errors and walks by their likelihoods. `speed_m_s` is where it is taken to be.
fn of_chain(chain: &Chain, passing: Passing, speed_m_s: f64, sound: &Sound) -> Option<(f64, f64)> {
    let row = |(t_s, hz): &(f64, f64)| {
        let slowness = sound.slowness_s_m(passing.range_m(*t_s, speed_m_s));
        (*t_s, hz.ln(), -slowness * passing.shape(*t_s))
    };
    let points: Vec<(f64, f64, f64)> = chain.points.iter().map(row).collect();
    let wanders = ERRORS.iter().flat_map(|error| {
        let back = |walk| BACK_S.map(|back_s| Wander { error: *error, walk, back_s });
        WALKS.into_iter().flat_map(back)
    });
    let all: Vec<(f64, f64, f64)> = wanders.filter_map(|w| slope(&points, w)).collect();
    let most = all.iter().map(|a| a.2).fold(f64::NEG_INFINITY, f64::max);
    // Overlapping windows tell a third each.
    let weight = |log: f64| ((log - most) / OVERLAP).exp();
    let sum: f64 = all.iter().map(|a| weight(a.2)).sum();
    let mean = all.iter().map(|a| weight(a.2) * a.0).sum::<f64>() / sum;
    let square = |a: &(f64, f64, f64)| a.1 + (a.0 - mean) * (a.0 - mean);
    let variance = all.iter().map(|a| weight(a.2) * square(a)).sum::<f64>() / sum;
    variance.is_finite().then_some((mean, variance))
}

/// Speed from all chains, m/s, and its variance.
fn of_all(
    chains: &[Chain],
    passing: Passing,
    sound: &Sound,
    first_m_s: f64,
    rounds: usize,
) -> Option<(f64, f64)> {
    let mut found = (first_m_s, f64::INFINITY);
    for _ in 0..rounds {
        let at = found.0.clamp(SPEEDS_M_S.0, SPEEDS_M_S.1);
        let each: Vec<(f64, f64)> =
            chains.iter().take(LINES).filter_map(|c| of_chain(c, passing, at, sound)).collect();
        let sum: f64 = each.iter().map(|e| 1.0 / e.1).sum();
        let mean = each.iter().map(|e| e.0 / e.1).sum::<f64>() / sum;
        let best = each.iter().map(|e| e.1).fold(f64::INFINITY, f64::min);
        // Lines that contradict each other are not one engine's.
        let square = each.iter().map(|e| (e.0 - mean).powi(2) / e.1).sum::<f64>();
        let apart = square / (each.len() as f64 - 1.0).max(1.0);
        found = (mean, best * apart.max(1.0));
        if !mean.is_finite() {
            return None;
        }
    }
    Some(found)
}

/// Speed, and range of the closest point, from a course's lines; `None` where they do not tell it.
pub fn speed(course: &Course, chains: &[Chain], place: &Place<'_>) -> Option<(Known, Known)> {
    let s = &course.solution;
    if !s.sd_heading_rad.is_finite() {
        return None;
    }
    let sound = Sound::new(place.table);
    let (cpa_s, ln_q) = (s.cpa_time_s, s.line.p[2]);
    let (v, variance) = of_all(chains, Passing { cpa_s, q: ln_q.exp() }, &sound, FIRST_M_S, ROUNDS)?;
    // What the course's own uncertainty makes of it: changes with the time of the closest point and ln q.
    let sds = [s.covariance[1][1].max(0.0).sqrt(), s.covariance[2][2].max(0.0).sqrt()];
    let moved =
        |cpa_s: f64, ln_q: f64| Some(of_all(chains, Passing { cpa_s, q: ln_q.exp() }, &sound, v, 1)?.0);
    let by_time = (moved(cpa_s + sds[0], ln_q)? - moved(cpa_s - sds[0], ln_q)?) / 2.0;
    let by_q = (moved(cpa_s, ln_q + sds[1])? - moved(cpa_s, ln_q - sds[1])?) / 2.0;
    let common = if sds[0] * sds[1] > 0.0 { s.covariance[1][2] / (sds[0] * sds[1]) } else { 0.0 };
    let joint = |a: f64, b: f64| (a * a + b * b + 2.0 * common * a * b).max(0.0);
    let own = variance + (v * sound.relative_sd(v / ln_q.exp())).powi(2);
    let sd_v = (own + joint(by_time, by_q)).sqrt();
    if !(SPEEDS_M_S.0..SPEEDS_M_S.1).contains(&v) || sd_v > KNOWN * v {
        return None;
    }
    // ln r = ln v − ln q.
    let range_m = v / ln_q.exp();
    let relative = (own / (v * v) + joint(by_time / v, by_q / v - sds[1])).sqrt();
    Some((Known { value: v, sd: sd_v }, Known { value: range_m, sd: range_m * relative }))
}

/// How the sound goes: horizontal slowness against range.
struct Sound {
    /// At the middles of [`NODE_M`], s/m, with what paths differ by; nothing of no table.
    nodes: Vec<Known>,
}

impl Sound {
    /// The mean by power of the paths whose interference the table has, and over each node's ranges: jumps from path to path would pass for a
    /// vessel's motion.
    fn new(table: Option<&Propagation>) -> Self {
        let node = |table: &Propagation, k: usize| {
            let (mut power, mut sum, mut square) = (0.0, 0.0, 0.0);
            for step in 0..STEPS {
                let at_m = NODE_M * (k as f64 + (step as f64 + 0.5) / STEPS as f64);
                for path in 0..table.paths.len().min(table.strengths.len() + 1) {
                    let Some(a) = table.arrival(path, at_m) else { continue };
                    let Some(slowness) = table.slowness_s_m(path, at_m) else { continue };
                    power += a.amplitude.norm_sqr();
                    sum += a.amplitude.norm_sqr() * slowness;
                    square += a.amplitude.norm_sqr() * slowness * slowness;
                }
            }
            let value = sum / power;
            let sd = (square / power - value * value).max(0.0).sqrt();
            (power > 0.0).then_some(Known { value, sd })
        };
        let whole = |table: &Propagation| (table.max_range_m() / NODE_M) as usize;
        let nodes = table.map(|t| (0..whole(t)).map_while(|k| node(t, k)).collect());
        Self { nodes: nodes.unwrap_or_default() }
    }

    fn slowness_s_m(&self, range_m: f64) -> f64 {
        let at = (range_m / NODE_M - 0.5).clamp(0.0, self.nodes.len().saturating_sub(1) as f64);
        let (k, part) = (at as usize, at.fract());
        let Some(here) = self.nodes.get(k) else { return SLOWNESS.0 };
        here.value + part * (self.nodes.get(k + 1).unwrap_or(here).value - here.value)
    }

    /// What of the slowness is not known, relative, of a vessel that passes at a range: which of the paths is loudest.
    fn relative_sd(&self, range_m: f64) -> f64 {
        let k = ((range_m / NODE_M) as usize).min(self.nodes.len().saturating_sub(1));
        self.nodes.get(k).map_or(SLOWNESS.1, |n| n.sd / n.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wandering_line_tells_the_speed_within_what_is_stated() {
        let (v, passing) = (8.0, Passing { cpa_s: 9_000.0, q: 1.3e-4 });
        for seed in 1..6u64 {
            let mut state = seed;
            let mut normal = || {
                (0..12).fold(-6.0, |sum, _| {
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    sum + (state >> 11) as f64 / (1u64 << 53) as f64
                })
            };
            let mut wander = 0.0;
            let points = (0..300).map(|m| {
                let t = 60.0 * f64::from(m);
                wander += 1e-5 * normal();
                (t, 15.0 * (1.0 - v * SLOWNESS.0 * passing.shape(t) + wander + 3e-5 * normal()))
            });
            let chain = Chain { points: points.collect() };
            let (found, variance) = of_chain(&chain, passing, v, &Sound::new(None)).unwrap();
            let sd = variance.sqrt();
            assert!((found - v).abs() < 3.0 * sd && sd < 1.2, "{found} ± {sd}");
        }
    }
}
