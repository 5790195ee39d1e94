//! Bearings of several frequencies of one line, joined: what a vessel radiates at 444, 666 and 702 Hz comes from one direction.
//!
//! In: arrivals of each frequency. Out: arrivals with the mean of the sines, weighted by their variances. Arrivals of two
//! frequencies are one where they differ by less than four standard deviations. What one frequency alone shows within a beam of
//! something stronger is no source: a vessel that turned, or its echo. Cost: some hundred comparisons.

use super::{LineArrival, MAX_SOURCES};
use crate::math::f64 as m;

/// Most frequencies joined.
pub const MAX_FREQUENCIES: usize = 8;
/// Standard deviations of a difference below which two arrivals are one.
const SAME: f64 = 4.0;

/// One source of several frequencies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JoinedArrival {
    /// Sine, deviation and signal-to-noise ratio: the ratio is the sum over frequencies.
    pub arrival: LineArrival,
    /// How many frequencies heard it.
    pub frequencies: u8,
}

/// Joins the arrivals of frequencies: strongest source first; returns how many there are. Where those of a source scatter by
/// more than they say, its deviation grows by as much. `beam`: the widest beam of the frequencies, as a difference of sines.
pub fn join(
    arrivals: &[([LineArrival; MAX_SOURCES], usize)],
    beam: f64,
    out: &mut [JoinedArrival; MAX_SOURCES],
) -> usize {
    let mut left = [[true; MAX_SOURCES]; MAX_FREQUENCIES];
    let mut count = 0;
    for slot in out.iter_mut() {
        let heard = || {
            let frequencies = arrivals.iter().take(MAX_FREQUENCIES).enumerate();
            frequencies.flat_map(|(f, (a, n))| a.iter().take(*n).enumerate().map(move |(k, a)| (f, k, a)))
        };
        // The clearest that is left, and of each other frequency the nearest to it.
        let free = |f: usize, k: usize| left.get(f).and_then(|l| l.get(k)).copied().unwrap_or(false);
        let first =
            heard().filter(|(f, k, a)| free(*f, *k) && a.sd > 0.0).min_by(|a, b| a.2.sd.total_cmp(&b.2.sd));
        let Some((_, _, first)) = first else { break };
        let mut members = [None; MAX_FREQUENCIES];
        for (f, k, a) in heard().filter(|(f, k, a)| free(*f, *k) && a.sd > 0.0) {
            let distance = m::abs(a.sine - first.sine) / m::sqrt(a.sd * a.sd + first.sd * first.sd);
            if let Some(member) = members.get_mut(f)
                && distance < SAME
                && member.is_none_or(|(_, d, _)| distance < d)
            {
                *member = Some((k, distance, *a));
            }
        }
        let (mut n, mut weight, mut sum, mut squares, mut snr) = (0u8, 0.0, 0.0, 0.0, 0.0);
        for (f, (k, _, a)) in members.iter().enumerate().filter_map(|(f, m)| Some((f, (*m)?))) {
            let w = 1.0 / (a.sd * a.sd);
            n += 1;
            weight += w;
            sum += w * (a.sine - first.sine);
            squares += w * (a.sine - first.sine) * (a.sine - first.sine);
            snr += a.snr;
            if let Some(flag) = left.get_mut(f).and_then(|l| l.get_mut(k)) {
                *flag = false;
            }
        }
        let mean = sum / weight;
        let scatter = (squares - weight * mean * mean) / f64::from(n.saturating_sub(1).max(1));
        let sd = m::sqrt(scatter.max(1.0) / weight);
        *slot = JoinedArrival { arrival: LineArrival { sine: first.sine + mean, sd, snr }, frequencies: n };
        count += 1;
    }
    if let Some(found) = out.get_mut(..count) {
        found.sort_unstable_by(|a, b| b.arrival.snr.total_cmp(&a.arrival.snr));
        if arrivals.len() > 1 {
            count = agreed(found, beam);
        }
    }
    count
}

/// Leaves out what one frequency alone shows within a beam of what more frequencies or a stronger one show; returns how many are left.
/// Where neither of two has another frequency for it, nothing tells which is right: the deviation grows by their distance.
fn agreed(found: &mut [JoinedArrival], beam: f64) -> usize {
    // Those of several frequencies first, each kind as it is: strongest first.
    let mut kept = [JoinedArrival::default(); MAX_SOURCES];
    let mut count = 0;
    for several in [true, false] {
        for one in found.iter().filter(|one| (one.frequencies > 1) == several) {
            let distance = |k: &JoinedArrival| m::abs(k.arrival.sine - one.arrival.sine);
            let near = kept.iter_mut().take(count).find(|k| !several && distance(k) < beam);
            if let Some(near) = near {
                if near.frequencies == 1 {
                    near.arrival.sd = m::hypot(near.arrival.sd, distance(near));
                }
            } else if let Some(slot) = kept.get_mut(count) {
                *slot = *one;
                count += 1;
            }
        }
    }
    if let Some(kept) = kept.get_mut(..count) {
        kept.sort_unstable_by(|a, b| b.arrival.snr.total_cmp(&a.arrival.snr));
    }
    found.iter_mut().zip(&kept).take(count).for_each(|(to, from)| *to = *from);
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(list: &[(f64, f64, f64)]) -> ([LineArrival; MAX_SOURCES], usize) {
        let mut out = [LineArrival::default(); MAX_SOURCES];
        for (slot, (sine, sd, snr)) in out.iter_mut().zip(list) {
            *slot = LineArrival { sine: *sine, sd: *sd, snr: *snr };
        }
        (out, list.len())
    }

    #[test]
    fn frequencies_of_one_vessel_are_one_and_two_vessels_stay_two() {
        let mut out = [JoinedArrival::default(); MAX_SOURCES];
        let heard = [
            of(&[(0.30, 0.01, 5.0), (-0.5, 0.02, 2.0)]),
            of(&[(0.31, 0.01, 6.0)]),
            of(&[(-0.52, 0.02, 3.0)]),
        ];
        assert_eq!(join(&heard, 0.2, &mut out), 2);
        assert!((out[0].arrival.sine - 0.305).abs() < 1e-12 && out[0].frequencies == 2, "{out:?}");
        assert!((out[0].arrival.sd - 0.01 / 2f64.sqrt()).abs() < 1e-12 && out[0].arrival.snr == 11.0);
        assert!((out[1].arrival.sine + 0.51).abs() < 1e-12 && out[1].frequencies == 2);
        // What scatters more than it says is less certain than it says.
        assert_eq!(join(&[of(&[(0.30, 0.01, 1.0)]), of(&[(0.34, 0.01, 1.0)])], 0.2, &mut out), 1);
        assert!((out[0].arrival.sd - 0.02).abs() < 1e-12, "{out:?}");
        assert_eq!(join(&[], 0.2, &mut out), 0);
    }

    #[test]
    fn what_one_frequency_shows_beside_another_is_no_source() {
        let mut out = [JoinedArrival::default(); MAX_SOURCES];
        // A ghost beside the vessel, the strongest at its frequency, and a second vessel far off which one frequency hears.
        let heard = [
            of(&[(0.30, 0.001, 5.0)]),
            of(&[(0.30, 0.001, 5.0)]),
            of(&[(0.35, 0.001, 20.0), (-0.4, 0.002, 3.0)]),
        ];
        assert_eq!(join(&heard, 0.2, &mut out), 2);
        assert!((out[0].arrival.sine - 0.30).abs() < 1e-12 && out[0].arrival.snr == 10.0, "{out:?}");
        assert!((out[1].arrival.sine + 0.4).abs() < 1e-12);
        // Two frequencies that contradict each other are one source, and it is anywhere between.
        assert_eq!(join(&[of(&[(0.30, 0.001, 5.0)]), of(&[(0.36, 0.001, 4.0)])], 0.2, &mut out), 1);
        assert!((out[0].arrival.sine - 0.30).abs() < 1e-12 && out[0].arrival.sd > 0.06, "{out:?}");
        // Of a single frequency all arrivals are sources.
        assert_eq!(join(&[of(&[(0.30, 0.001, 5.0), (0.42, 0.001, 4.0)])], 0.2, &mut out), 2);
    }
}
