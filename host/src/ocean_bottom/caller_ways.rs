//! Ways of callers: calls with a direction and a range, joined as one animal's slow swimming would have them.

use super::calls::WhaleCall;

/// A caller's way: calls with a direction and a range that one animal's slow swimming joins.
#[derive(Clone, Debug, PartialEq)]
pub struct CallerWay {
    /// First and last call, s.
    pub span_s: (f64, f64),
    /// Calls joined.
    pub calls: usize,
    /// East and North at the middle of the span, m, and the standard deviation of each along its worst direction.
    pub place_m: (f64, f64),
    /// Standard deviation of the place, m.
    pub sd_place_m: f64,
    /// East and North velocity, m/s.
    pub velocity_m_s: (f64, f64),
    /// Standard deviation of each velocity, m/s.
    pub sd_velocity_m_s: f64,
}

/// Fastest that a whale swims for long, m/s.
const SWIMS_M_S: f64 = 8.0;
/// Longest silence within a way, s.
const SILENCE_S: f64 = 1800.0;
/// Fewest calls of a way.
const LEAST_CALLS: usize = 5;

/// Joins calls with azimuth and range to the ways of callers, in order of their first call.
pub fn ways(calls: &[WhaleCall]) -> Vec<CallerWay> {
    let mut groups: Vec<Vec<(f64, [f64; 2], f64)>> = Vec::new();
    for c in calls {
        let (Some((azimuth, sd_azimuth)), Some(r)) = (c.azimuth, c.range) else { continue };
        let (s, cos) = azimuth.sin_cos();
        let place = [r.range_m * s, r.range_m * cos];
        let sd = r.sd_m.hypot(r.range_m * sd_azimuth);
        let fits = |g: &Vec<(f64, [f64; 2], f64)>| {
            g.last().is_some_and(|(t, p, before)| {
                let way = (place[0] - p[0]).hypot(place[1] - p[1]);
                c.t_s - t <= SILENCE_S && way <= SWIMS_M_S * (c.t_s - t) + 3.0 * sd.hypot(*before)
            })
        };
        match groups.iter_mut().rev().find(|g| fits(g)) {
            Some(g) => g.push((c.t_s, place, sd)),
            None => groups.push(vec![(c.t_s, place, sd)]),
        }
    }
    groups.iter().filter(|g| g.len() >= LEAST_CALLS).map(|g| way(g)).collect()
}

/// The straight line through places of one group, each weighed by its deviation; East and North alike.
fn way(group: &[(f64, [f64; 2], f64)]) -> CallerWay {
    let span_s = (group[0].0, group[group.len() - 1].0);
    let middle = 0.5 * (span_s.0 + span_s.1);
    let (mut w0, mut w1, mut w2) = (0.0, 0.0, 0.0);
    let mut sums = [[0.0; 2]; 2];
    for (t, place, sd) in group {
        let (w, t) = (1.0 / (sd * sd), t - middle);
        (w0, w1, w2) = (w0 + w, w1 + w * t, w2 + w * t * t);
        for (sum, x) in sums.iter_mut().zip(place) {
            *sum = [sum[0] + w * x, sum[1] + w * t * x];
        }
    }
    // A whale that hardly moves: its velocity has a prior of a swimming whale's.
    let w2 = w2 + 1.0 / (0.5 * SWIMS_M_S).powi(2);
    let det = w0 * w2 - w1 * w1;
    let [x, y] = sums.map(|[a, b]| ((w2 * a - w1 * b) / det, (w0 * b - w1 * a) / det));
    // Windows of three minutes overlap, a minute apart: three calls are worth one.
    let overlap = 3f64;
    CallerWay {
        span_s,
        calls: group.len(),
        place_m: (x.0, y.0),
        sd_place_m: (overlap * w2 / det).sqrt(),
        velocity_m_s: (x.1, y.1),
        sd_velocity_m_s: (overlap * w0 / det).sqrt().min(0.5 * SWIMS_M_S),
    }
}
