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
/// The least that is worth a line, as a share of the outlier test's tolerance, and in steps of delays that are whole numbers of one.
const LEAST: f64 = 1.0;
const STEPS: f64 = 2.5;
/// Parts of a file, one after the other, and of how many of them the median must be at least half of that of all: what lasts for some sets only, or
/// drifts, is not in all of them.
const PARTS: usize = 10;
const ALIKE: usize = 9;

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
                "pair {i}{j} is wrong, or two other pairs of {i} or {j} are wrong alike, which looks the same and turns directions"
            ),
            None => "several pairs are wrong".to_owned(),
        };
        format!(
            "in most of {} sets delays do not close around hydrophones {}: {end}",
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
        let all: Vec<f64> = sets.iter().map(around).filter(|x| x.is_finite()).collect();
        let middle = median(&mut all.clone()).filter(|_| all.len() >= FEWEST)?;
        let alike = |part: &[f64]| median(&mut part.to_vec()).is_some_and(|x| x / middle > 0.5);
        let alike = all.chunks(all.len().div_ceil(PARTS)).filter(|part| alike(part)).count();
        let step_s = |p: (usize, usize)| step(sets.iter().map(|d| of_pair(d, p)).collect());
        let step_s = [(i, j), (j, k), (i, k)].map(step_s).into_iter().fold(0.0, f64::max);
        let least = (STEPS * step_s).max(LEAST * tolerance_s);
        (middle.abs() > least && alike >= ALIKE).then_some(middle)
    });
    // Closures of four triangles are three numbers: one alone is not open.
    (by_s.iter().flatten().count() > 1).then_some(Unclosed { sets: sets.len(), by_s })
}

/// The step of numbers that are multiples of one; none of others, and of those that are all the same nobody knows it.
fn step(mut all: Vec<f64>) -> f64 {
    const SAME_S: f64 = 1e-8;
    all.sort_by(f64::total_cmp);
    let apart = all.windows(2).map(|pair| pair[1] - pair[0]).filter(|d| *d > SAME_S);
    let (count, least) = apart.fold((0, f64::INFINITY), |(n, least), d| (n + 1, least.min(d)));
    // Numbers that are not of a step hardly ever meet.
    if 2 * count < all.len() { least } else { 0.0 }
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
            ([0.0, 0.0, 0.0, 0.0, -4e-5, 0.0], (1, 3)),
        ] {
            let found = of(&sets(off_s, 1), 28e-6).unwrap();
            assert_eq!(found.pair(), Some(pair), "{found:?}");
            let said = found.said();
            assert!(
                said.contains(&format!("pair {}{} is wrong", pair.0, pair.1)) && said.lines().count() == 1,
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
        assert_eq!(of(&sets([2e-4, 0.0, 0.0, 0.0, 0.0, 0.0], 0)[..10], 28e-6), None);
        // Half of a file, and a drift through nothing.
        let (well, wrong) = (sets([0.0; 6], 0), sets([2e-4, 0.0, 0.0, 0.0, 0.0, 0.0], 0));
        assert_eq!(of(&[&well[..120], &wrong[120..]].concat(), 28e-6), None);
        let drift =
            well.iter().enumerate().map(|(k, d)| [d[0] + 1e-6 * k as f64, d[1], d[2], d[3], d[4], d[5]]);
        assert_eq!(of(&drift.collect::<Vec<_>>(), 28e-6), None);
        // Whole samples, which stay the same for long.
        let whole = |d: &[f64; 6]| d.map(|x| (x / 62.5e-6).round() * 62.5e-6);
        let steady: Vec<[f64; 6]> = (0..300).map(|_| whole(&well[0])).collect();
        assert_eq!(of(&steady, 28e-6), None);
    }
}
