//! Ways of callers: calls with a direction and a range, joined as one animal's slow swimming would have them.

use super::calls::WhaleCall;

/// A caller's way: calls with a direction and a range that one animal's slow swimming joins.
#[derive(Clone, Debug, PartialEq)]
pub struct CallerWay {
    /// Of which kind.
    pub kind: &'static str,
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
/// Least standard deviation of a call's place, m.
const LEAST_SD_M: f64 = 1.0;
/// Fewest calls of a way.
const LEAST_CALLS: usize = 5;

/// A call with its place.
#[derive(Clone, Copy, Debug)]
struct Placed {
    t_s: f64,
    /// East and North, m.
    place: [f64; 2],
    /// Standard deviation, m.
    sd: f64,
    /// What of it calls from that place share, m.
    shared: f64,
}

/// Joins calls with azimuth and range to the ways of callers, those of one kind together, in order of their first call.
pub fn ways(calls: &[WhaleCall]) -> Vec<CallerWay> {
    let mut groups: Vec<(&'static str, Vec<Placed>)> = Vec::new();
    for c in calls {
        let (Some((azimuth, sd_azimuth)), Some(r)) = (c.azimuth, c.range) else { continue };
        let (s, cos) = azimuth.sin_cos();
        let place = [r.range_m * s, r.range_m * cos];
        let sd = r.sd_m.hypot(r.range_m * sd_azimuth);
        let call = Placed { t_s: c.t_s, place, sd, shared: r.shared_m.hypot(r.range_m * c.shared_azimuth) };
        let fits = |(kind, g): &(&'static str, Vec<Placed>)| {
            *kind == c.kind
                && g.last().is_some_and(|last| {
                    let way = (place[0] - last.place[0]).hypot(place[1] - last.place[1]);
                    let since_s = c.t_s - last.t_s;
                    since_s <= SILENCE_S && way <= SWIMS_M_S * since_s + 3.0 * sd.hypot(last.sd)
                })
        };
        match groups.iter_mut().rev().find(|g| fits(g)) {
            Some((_, g)) => g.push(call),
            None => groups.push((c.kind, vec![call])),
        }
    }
    groups.iter().filter(|(_, g)| g.len() >= LEAST_CALLS).map(|(kind, g)| way(kind, g)).collect()
}

/// The straight line through places of one group, each weighed by its own deviation; East and North alike. What they share is not made less
/// by their number.
fn way(kind: &'static str, group: &[Placed]) -> CallerWay {
    let span_s = (group[0].t_s, group[group.len() - 1].t_s);
    let middle = 0.5 * (span_s.0 + span_s.1);
    let (mut w0, mut w1, mut w2, mut shared) = (0.0, 0.0, 0.0, 0.0);
    let mut sums = [[0.0; 2]; 2];
    for call in group {
        let own = (call.sd * call.sd - call.shared * call.shared).max(LEAST_SD_M * LEAST_SD_M);
        let (w, t) = (1.0 / own, call.t_s - middle);
        (w0, w1, w2) = (w0 + w, w1 + w * t, w2 + w * t * t);
        shared += call.shared * call.shared / group.len() as f64;
        for (sum, x) in sums.iter_mut().zip(call.place) {
            *sum = [sum[0] + w * x, sum[1] + w * t * x];
        }
    }
    // A whale that hardly moves: its velocity has a prior of a swimming whale's.
    let w2 = w2 + 1.0 / (0.5 * SWIMS_M_S).powi(2);
    let det = w0 * w2 - w1 * w1;
    let [x, y] = sums.map(|[a, b]| ((w2 * a - w1 * b) / det, (w0 * b - w1 * a) / det));
    // Windows of three minutes overlap, a minute apart: three calls are worth one.
    let overlap = 3f64;
    let turned = shared / x.0.hypot(y.0).max(1.0).powi(2);
    CallerWay {
        kind,
        span_s,
        calls: group.len(),
        place_m: (x.0, y.0),
        sd_place_m: (overlap * w2 / det + shared).sqrt(),
        velocity_m_s: (x.1, y.1),
        sd_velocity_m_s: (overlap * w0 / det + turned * (x.1 * x.1 + y.1 * y.1)).sqrt().min(0.5 * SWIMS_M_S),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ocean_bottom::call_ranges::CallRange;

    #[test]
    fn what_calls_share_is_not_made_less_by_their_number() {
        let way = |shared_m: f64, shared_azimuth: f64| {
            let call = |k: u32| WhaleCall {
                kind: "fin",
                t_s: 60.0 * f64::from(k),
                notes: 10,
                interval_s: None,
                azimuth: Some((1.0, f64::hypot(0.02, shared_azimuth))),
                shared_azimuth,
                range: Some(CallRange {
                    range_m: 10_000.0,
                    sd_m: f64::hypot(20.0, shared_m),
                    shared_m,
                    log_ratio: 100.0,
                }),
            };
            let calls: Vec<WhaleCall> = (0..100).map(call).collect();
            let ways = ways(&calls);
            assert_eq!(ways.len(), 1);
            ways[0].sd_place_m
        };
        let own = way(0.0, 0.0);
        assert!((own / (200.0 * (3f64 / 100.0).sqrt()) - 1.0).abs() < 0.05, "{own}");
        let both = way(300.0, 0.05);
        assert!((both / own.hypot(300.0).hypot(500.0) - 1.0).abs() < 0.01, "{both}");
    }
}
