//! Which vessel each bearing of one instant belongs to.
//!
//! In: what every track predicts, the bearings of one index. Out: for each bearing a [`Verdict`]. Cost of a pair is the
//! squared innovation over its variance plus that variance's logarithm (twice the negative log-likelihood). Pairs are
//! taken in order of cost, each track and each bearing once. A bearing that two free tracks explain nearly equally
//! well is *deferred*: it moves neither. So is a lone bearing while two tracks are predicted so close together that
//! the recorder gives one merged bearing for both: both tracks coast on their own bearing rates through the crossing
//! and are told apart again behind it by where those rates have taken them.

use super::{GROUP, Heard, VESSELS};
use crate::angle::wrap_pi;
use crate::math::f64 as m;
use crate::passage::Prediction;

/// What becomes of a bearing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It belongs to the track in this place.
    Track(usize),
    /// It belongs to one of several tracks (bit i for place i), nobody can say which.
    Deferred(u8),
    /// It lies near a track that has its bearing already, or in nobody's gate but too near to be another vessel.
    Spare,
    /// No track explains it.
    Free,
}

/// What assignment is told besides predictions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rules {
    /// Half-width of a track's gate, standard deviations.
    pub(super) gate_sd: f64,
    /// Vessels closer than this give one bearing, radians.
    pub(super) merge_rad: f64,
    /// Least variance of a bearing, rad².
    pub(super) least_variance: f64,
}

/// A bearing must fit one track better than every other by this much (odds of 20 to 1).
const CLEAR: f64 = 6.0;

/// One track's claim to a bearing.
#[derive(Clone, Copy)]
struct Claim {
    cost: f64,
    gated: bool,
}

/// Gives each bearing its verdict. `heard_s` holds the times of each track's first bearing and of its last. `impatient` has a bit for each
/// track that has been deferred for too long: it no longer waits.
pub(super) fn assign(
    rules: &Rules,
    predictions: &[Option<Prediction>; VESSELS],
    heard_s: &[(f64, f64); VESSELS],
    group: &[Heard],
    impatient: u8,
) -> [Verdict; GROUP] {
    let mut claims = [[None; VESSELS]; GROUP];
    for (row, heard) in claims.iter_mut().zip(group) {
        for (slot, prediction) in row.iter_mut().zip(predictions) {
            *slot = prediction.as_ref().map(|p| claim(rules, p, heard));
        }
    }
    let mut verdicts = [Verdict::Free; GROUP];
    let (mut taken, mut done) = (0u8, 0u8);
    for _ in 0..group.len().min(GROUP) {
        let Some((b, track)) = cheapest(&claims, taken, done) else { break };
        let Some(row) = claims.get(b) else { break };
        done |= 1 << b;
        let own = row.get(track).copied().flatten().map_or(0.0, |c| c.cost);
        let mut rivals = 0u8;
        for (other, claim) in row.iter().enumerate() {
            if other == track || taken >> other & 1 == 1 {
                continue;
            }
            let Some(claim) = claim else { continue };
            let close = near(rules, predictions, track, other)
                && two(heard_s, track, other)
                && !partnered(rules, group, b, &claims, track, other);
            if (claim.gated && claim.cost < own + CLEAR) || close {
                rivals |= 1 << other;
            }
        }
        let waits = rivals != 0 && impatient >> track & 1 == 0;
        if let Some(verdict) = verdicts.get_mut(b) {
            *verdict = if waits { Verdict::Deferred(rivals | 1 << track) } else { Verdict::Track(track) };
        }
        if !waits {
            taken |= 1 << track;
        }
    }
    for (verdict, heard) in verdicts.iter_mut().zip(group) {
        let near_a_track = predictions.iter().flatten().any(|p| {
            let reach = rules.merge_rad.max(2.0 * m::sqrt(p.variance() + heard.variance));
            m::abs(wrap_pi(heard.azimuth - p.azimuth)) < reach
        });
        if *verdict == Verdict::Free && near_a_track {
            *verdict = Verdict::Spare;
        }
    }
    verdicts
}

fn claim(rules: &Rules, prediction: &Prediction, heard: &Heard) -> Claim {
    let variance = prediction.variance() + heard.variance.max(rules.least_variance);
    let innovation = wrap_pi(heard.azimuth - prediction.azimuth);
    let square = innovation * innovation / variance;
    Claim { cost: square + m::ln(variance), gated: square < rules.gate_sd * rules.gate_sd }
}

/// The cheapest pair of a bearing not yet judged and a track not yet served.
fn cheapest(claims: &[[Option<Claim>; VESSELS]; GROUP], taken: u8, done: u8) -> Option<(usize, usize)> {
    let mut best: Option<(f64, usize, usize)> = None;
    for (b, row) in claims.iter().enumerate().filter(|(b, _)| done >> b & 1 == 0) {
        for (track, claim) in row.iter().enumerate().filter(|(track, _)| taken >> track & 1 == 0) {
            let Some(claim) = claim.filter(|c| c.gated) else { continue };
            if best.is_none_or(|(cost, _, _)| claim.cost < cost) {
                best = Some((claim.cost, b, track));
            }
        }
    }
    best.map(|(_, b, track)| (b, track))
}

/// Whether two tracks may be so close together that one bearing comes for both.
fn near(rules: &Rules, predictions: &[Option<Prediction>; VESSELS], a: usize, b: usize) -> bool {
    let at = |i: usize| predictions.get(i).and_then(Option::as_ref);
    let (Some(a), Some(b)) = (at(a), at(b)) else { return false };
    let doubt = 2.0 * m::sqrt(a.line_variance + b.line_variance);
    m::abs(wrap_pi(a.azimuth - b.azimuth)) < rules.merge_rad + doubt
}

/// Whether two tracks are of two vessels: one that was not heard since the other began has a line that its vessel has left.
fn two(heard_s: &[(f64, f64); VESSELS], a: usize, b: usize) -> bool {
    heard_s.get(a).zip(heard_s.get(b)).is_some_and(|(a, b)| a.1 >= b.0 && b.1 >= a.0)
}

/// Whether another bearing of this instant stands apart from bearing `b` and within the gate of either track: then the
/// two vessels are heard separately.
fn partnered(
    rules: &Rules,
    group: &[Heard],
    b: usize,
    claims: &[[Option<Claim>; VESSELS]; GROUP],
    track: usize,
    other: usize,
) -> bool {
    let Some(heard) = group.get(b) else { return false };
    group.iter().zip(claims).any(|(h, row)| {
        let gated = |i: usize| row.get(i).copied().flatten().is_some_and(|c| c.gated);
        m::abs(wrap_pi(h.azimuth - heard.azimuth)) > rules.merge_rad && (gated(track) || gated(other))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: Rules = Rules { gate_sd: 4.5, merge_rad: 0.05, least_variance: 1e-6 };

    fn at(azimuth: f64) -> Option<Prediction> {
        Some(Prediction { azimuth, line_variance: 1e-5, coloured_variance: 0.0 })
    }

    fn heard(azimuth: f64) -> Heard {
        Heard::azimuth(azimuth, 3e-4)
    }

    fn verdicts(tracks: &[f64], bearings: &[f64]) -> std::vec::Vec<Verdict> {
        let mut predictions = [None; VESSELS];
        for (slot, azimuth) in predictions.iter_mut().zip(tracks) {
            *slot = at(*azimuth);
        }
        let group: std::vec::Vec<Heard> = bearings.iter().map(|a| heard(*a)).collect();
        assign(&RULES, &predictions, &[(0.0, 9.0); VESSELS], &group, 0)[..group.len()].to_vec()
    }

    #[test]
    fn vessels_apart_get_their_own_and_a_new_one_is_free() {
        let v = verdicts(&[0.02, 2.0], &[2.01, 6.27, 4.0]);
        assert_eq!(v, [Verdict::Track(1), Verdict::Track(0), Verdict::Free]);
    }

    #[test]
    fn a_lone_bearing_in_a_crossing_moves_nobody() {
        assert_eq!(verdicts(&[1.0, 1.03], &[1.0]), [Verdict::Deferred(3)]);
        assert_eq!(verdicts(&[1.0, 1.12], &[1.06]), [Verdict::Deferred(3)]);
        assert_eq!(verdicts(&[1.0, 1.12], &[1.0]), [Verdict::Track(0)]);
    }

    #[test]
    fn a_line_that_its_vessel_has_left_takes_no_part_in_a_crossing() {
        let mut predictions = [None; VESSELS];
        (predictions[0], predictions[1]) = (at(1.0), at(1.05));
        let verdict = |heard_s: [(f64, f64); 2]| {
            let mut all = [(0.0, 0.0); VESSELS];
            all[..2].copy_from_slice(&heard_s);
            assign(&RULES, &predictions, &all, &[heard(1.0)], 0)[0]
        };
        assert_eq!(verdict([(5.0, 9.0), (0.0, 4.0)]), Verdict::Track(0));
        assert_eq!(verdict([(5.0, 9.0), (0.0, 6.0)]), Verdict::Deferred(3));
    }

    #[test]
    fn two_bearings_apart_resolve_two_close_tracks_and_a_third_is_spare() {
        assert_eq!(verdicts(&[1.0, 1.055], &[1.06, 1.0]), [Verdict::Track(1), Verdict::Track(0)]);
        assert_eq!(verdicts(&[1.0], &[1.0, 1.01]), [Verdict::Track(0), Verdict::Spare]);
    }
}
