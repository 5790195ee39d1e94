//! Whether measured delays do not close around the same triangles in all sets of a file: a pair that is wrong all the time.
//!
//! In: sets of six delays. Out: by how much the delays around each three hydrophones do not close in the median, where that is no chance. The outlier
//! test leaves such a pair out set by set, or divides its error among all where it is small; and two pairs of one hydrophone that are wrong alike
//! look the same as the third of it wrong by itself.
//!
//! Not seen: a hydrophone that is late, around which everything closes (`late`, `contradiction`).

use seabearing_core::geometry::PAIRS;
use seabearing_core::kit::median;

/// Fewest sets.
const FEWEST: usize = 20;
/// Standard deviations of the median from which on it is no chance, and the least that is worth a line, as a share of the outlier test's tolerance.
const NO_CHANCE: f64 = 5.0;
const LEAST: f64 = 0.5;
/// Standard deviation of normal numbers over their median distance from the median, and that of a median over that of a mean.
const NORMAL: f64 = 1.4826;
const MEDIAN: f64 = 1.2533;

/// The hydrophones of each triangle, in rising order.
const TRIANGLES: [[usize; 3]; 4] = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];

/// What does not close.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unclosed {
    /// Sets looked at.
    pub sets: usize,
    /// By how much each triangle does not close, seconds; `None` where it does.
    pub by_s: [Option<f64>; 4],
}

impl Unclosed {
    /// The pair that is in all triangles that do not close and in none that does.
    pub fn pair(&self) -> Option<(usize, usize)> {
        let is_in = |(i, j): &(usize, usize), t: &[usize; 3]| t.contains(i) && t.contains(j);
        PAIRS
            .into_iter()
            .find(|pair| TRIANGLES.iter().zip(self.by_s).all(|(t, by_s)| is_in(pair, t) == by_s.is_some()))
    }

    /// What to say of it.
    pub fn said(&self) -> String {
        let open = TRIANGLES
            .iter()
            .zip(self.by_s)
            .filter_map(|([i, j, k], by_s)| Some(format!("{i}, {j}, {k} by {:+.0} µs", 1e6 * by_s?)));
        let end = match self.pair() {
            Some((i, j)) => format!(
                "pair {i}{j} is wrong in all of them, or two other pairs of {i} or {j} are wrong alike, which looks the same and turns directions"
            ),
            None => "several pairs are wrong in all of them".to_owned(),
        };
        format!(
            "in the median of {} sets delays do not close around hydrophones {}: {end}",
            self.sets,
            open.collect::<Vec<_>>().join(" and ")
        )
    }
}

/// Whether delays do not close all the time. `tolerance_s`: that of the outlier test.
pub(super) fn of(sets: &[[f64; 6]], tolerance_s: f64) -> Option<Unclosed> {
    let of_pair = |delays: &[f64; 6], pair: (usize, usize)| {
        PAIRS.iter().position(|p| *p == pair).map_or(f64::NAN, |p| delays[p])
    };
    let by_s = TRIANGLES.map(|[i, j, k]| {
        let around = |d: &[f64; 6]| of_pair(d, (i, j)) + of_pair(d, (j, k)) - of_pair(d, (i, k));
        let mut all: Vec<f64> = sets.iter().map(around).filter(|x| x.is_finite()).collect();
        let n = all.len();
        let middle = median(&mut all).filter(|_| n >= FEWEST)?;
        let mut off: Vec<f64> = all.iter().map(|x| (x - middle).abs()).collect();
        let sd = MEDIAN * NORMAL * median(&mut off)? / (n as f64).sqrt();
        (middle.abs() > (NO_CHANCE * sd).max(LEAST * tolerance_s)).then_some(middle)
    });
    by_s.iter().any(Option::is_some).then_some(Unclosed { sets: sets.len(), by_s })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Sets whose arrivals err by up to 9 µs, pairs by so much more in all, and `wild` of six sets by anything in three pairs.
    fn sets(off_s: [f64; 6], wild: usize) -> Vec<[f64; 6]> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let set = |k: usize| {
            let arrivals: [f64; 4] = core::array::from_fn(|_| rng.random_range(-1e-3..1e-3));
            let mut delays = PAIRS.map(|(i, j)| arrivals[j] - arrivals[i]);
            for (p, (delay, off)) in delays.iter_mut().zip(off_s).enumerate() {
                *delay += off + rng.random_range(-9e-6..9e-6);
                if k % 6 < wild && p % 2 == 0 {
                    *delay = rng.random_range(-1e-3..1e-3);
                }
            }
            delays
        };
        (0..300).map(set).collect()
    }

    #[test]
    fn a_pair_that_is_wrong_all_the_time_is_named_and_so_are_two_that_look_like_it() {
        for (off_s, pair) in [
            ([2e-4, 0.0, 0.0, 0.0, 0.0, 0.0], (0, 1)),
            ([0.0, 0.0, 6e-5, 0.0, 6e-5, 0.0], (2, 3)),
            ([0.0, 0.0, 0.0, 0.0, -3e-5, 0.0], (1, 3)),
        ] {
            let found = of(&sets(off_s, 1), 28e-6).unwrap();
            assert_eq!(found.pair(), Some(pair), "{found:?}");
            let said = found.said();
            assert!(
                said.contains(&format!("pair {}{} is", pair.0, pair.1)) && said.lines().count() == 1,
                "{said}"
            );
        }
        let several = of(&sets([2e-4, 0.0, 0.0, 0.0, 0.0, 1e-4], 1), 28e-6).unwrap();
        assert!(several.pair().is_none() && several.said().contains("several"), "{}", several.said());
    }

    #[test]
    fn delays_that_close_and_a_few_that_do_not_are_left_alone() {
        assert_eq!(of(&sets([0.0; 6], 0), 28e-6), None);
        assert_eq!(of(&sets([0.0; 6], 2), 28e-6), None);
        assert_eq!(of(&sets([0.0; 6], 6), 28e-6), None);
        assert_eq!(of(&sets([2e-4; 6], 1)[..10], 28e-6), None);
    }
}
