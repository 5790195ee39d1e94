//! How far the bins of one direction point apart, beyond what the scatter of each explains: two vessels heard as one.
//!
//! Enters: each bin's mean direction with its variance. Leaves: the variance between bins, by the moments of their weighted squares
//! [DerSimonian and Laird 1986, 8], and what of it a direction is stated with. Of one vessel it is nothing; where two are less than some 20 degrees
//! apart their tones are one direction's bins, and what is told lies between the two. Cost: ten instructions a bin.

/// Share of the variance between bins that the variance of a direction has. Of two vessels D apart of which one has the share p of what
/// is heard, bins spread by τ = D √(p(1 − p)), and the mean is off the nearer one by D min(p, 1 − p), never more than τ. If all p are
/// as likely, it is more than 0.95 τ off in one of twenty: so 1.96 deviations are that much with a deviation of 0.49 τ.
const TOLD: f32 = 0.24;

/// Variance of a bin's mean over that of its directions, times their number: half-overlapped frames go together to 1/6.
const ALIKE: f32 = 1.33;

/// Sums over bins of their weights w, of w², of w x and of w x², x their directions; and how many bins.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Between {
    w: f32,
    ww: f32,
    wx: f32,
    wxx: f32,
    bins: f32,
}

impl Between {
    /// Takes a bin in: the mean of its `n` directions, rad, and the variance of one, rad².
    pub(super) fn take(&mut self, mean: f32, n: f32, var: f32) {
        let w = n / (ALIKE * var);
        self.w += w;
        self.ww += w * w;
        self.wx += w * mean;
        self.wxx += w * mean * mean;
        self.bins += 1.0;
    }

    /// Variance of the bins' directions beyond their own, rad²; 0 where that explains them, and of one bin.
    fn variance(&self) -> f32 {
        let free = self.w - self.ww / self.w.max(f32::MIN_POSITIVE);
        if self.bins < 2.0 || free <= 0.0 {
            return 0.0;
        }
        let squares = self.wxx - self.wx * self.wx / self.w;
        ((squares - (self.bins - 1.0)) / free).max(0.0)
    }

    /// What it adds to the variance of the direction told, rad².
    pub(super) fn told(&self) -> f32 {
        TOLD * self.variance()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bins of 17 directions with a deviation of 5°, the first `first` of them of one vessel, the others of one `apart` degrees off.
    fn of_two(first: usize, bins: usize, apart: f32) -> f32 {
        let (mut between, mut seed) = (Between::default(), 7u32);
        for k in 0..bins {
            let mut sum = -6.0;
            for _ in 0..12 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += (seed >> 8) as f32 / 16_777_216.0;
            }
            let var = 5f32.to_radians() * 5f32.to_radians();
            let own = if k < first { 0.0 } else { apart.to_radians() };
            between.take(own + sum * (ALIKE * var / 17.0).sqrt(), 17.0, var);
        }
        between.variance().sqrt().to_degrees()
    }

    #[test]
    fn one_vessel_s_bins_point_one_way_and_those_of_two_do_not() {
        assert!(of_two(60, 60, 0.0) < 0.6, "{}", of_two(60, 60, 0.0));
        // Half the bins and a quarter of them are the other's: 5° and 4.33°.
        for (first, want) in [(30, 5.0f32), (45, 4.33)] {
            let have = of_two(first, 60, 10.0);
            assert!((have - want).abs() < 0.4, "{have} {want}");
        }
        assert_eq!(of_two(1, 1, 0.0), 0.0);
        assert_eq!(Between::default().told(), 0.0);
    }

    #[test]
    fn what_is_told_holds_the_nearer_of_two_in_nineteen_of_twenty() {
        let held = (1..1000).filter(|k| {
            let p = *k as f32 / 1000.0;
            let off = p.min(1.0 - p);
            off <= 1.96 * (TOLD * p * (1.0 - p)).sqrt()
        });
        let share = held.count() as f32 / 999.0;
        assert!((share - 0.95).abs() < 0.01, "{share}");
    }
}
