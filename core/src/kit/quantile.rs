//! Medians and other quantiles.

/// Numbers whose order their bits can give.
pub trait Ranked: Copy {
    /// A whole number that rises with the number; greatest for what is not a number.
    fn rank(self) -> u64;
    /// The number of a rank.
    fn of_rank(rank: u64) -> Self;
}

impl Ranked for f32 {
    fn rank(self) -> u64 {
        let bits = self.to_bits();
        u64::from(if bits >> 31 == 0 { bits | 1 << 31 } else { !bits })
    }

    fn of_rank(rank: u64) -> Self {
        let bits = rank as u32;
        Self::from_bits(if bits >> 31 == 1 { bits & !(1 << 31) } else { !bits })
    }
}

impl Ranked for f64 {
    fn rank(self) -> u64 {
        let bits = self.to_bits();
        if bits >> 63 == 0 { bits | 1 << 63 } else { !bits }
    }

    fn of_rank(rank: u64) -> Self {
        Self::from_bits(if rank >> 63 == 1 { rank & !(1 << 63) } else { !rank })
    }
}

/// The least of the values that at least a share of them (0 to 1) do not exceed, without memory and without sorting:
/// the bits of the answer are found one after the other, each by counting. Exact; at most 32 (64) passes over the values.
/// `None` of nothing.
pub fn order_statistic<T: Ranked>(values: impl Iterator<Item = T> + Clone, share: f64) -> Option<T> {
    let (mut low, mut high, mut n) = (u64::MAX, 0, 0u32);
    for rank in values.clone().map(T::rank) {
        low = low.min(rank);
        high = high.max(rank);
        n += 1;
    }
    let needed = (share * f64::from(n)).max(1.0);
    while low < high {
        let middle = low + (high - low) / 2;
        let count = values.clone().filter(|x| x.rank() <= middle).count();
        if count as f64 >= needed { high = middle } else { low = middle + 1 }
    }
    (n > 0).then(|| T::of_rank(low))
}

/// Quantile at a share (0 to 1) of values, which are sorted in place, linear between neighbours; `None` of nothing.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let place = share.clamp(0.0, 1.0) * values.len().checked_sub(1)? as f64;
    let below = *values.get(place as usize)?;
    let above = values.get(place as usize + 1).copied().unwrap_or(below);
    let part = place - (place as usize) as f64;
    // Not `below + part · (above − below)`: that of two infinities is not a number.
    Some(if part > 0.0 { (1.0 - part) * below + part * above } else { below })
}

/// Median of values, which are sorted in place: the middle one, or the mean of the middle two; `None` of nothing.
pub fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        #![proptest_config(seabearing_testkit::property(256))]

        #[test]
        fn order_statistics_are_those_of_the_sorted_values(
            values in prop::collection::vec(-1e6f64..1e6, 1..60), share in 0.0f64..=1.0
        ) {
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let index = ((share * values.len() as f64).ceil() as usize).clamp(1, values.len()) - 1;
            prop_assert_eq!(order_statistic(values.iter().copied(), share), Some(sorted[index]));
            let single: Vec<f32> = values.iter().map(|x| *x as f32).collect();
            prop_assert_eq!(order_statistic(single.iter().copied(), share), Some(sorted[index] as f32));
        }

        #[test]
        fn half_of_the_values_lie_on_either_side_of_the_median(values in prop::collection::vec(-1e6f64..1e6, 1..60)) {
            let middle = median(&mut values.clone()).unwrap();
            let below = values.iter().filter(|x| **x <= middle).count();
            let above = values.iter().filter(|x| **x >= middle).count();
            prop_assert!(2 * below >= values.len() && 2 * above >= values.len());
        }
    }

    #[test]
    fn small_cases() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median(&mut []), None);
        assert_eq!(quantile(&mut [0.0, 10.0], 0.25), Some(2.5));
        assert_eq!(quantile(&mut [7.0], 1.0), Some(7.0));
        assert_eq!(order_statistic(core::iter::empty::<f32>(), 0.5), None);
        let v = [-0.0f32, -1.0, f32::INFINITY, f32::NEG_INFINITY];
        assert_eq!(order_statistic(v.into_iter(), 0.0), Some(f32::NEG_INFINITY));
        assert_eq!(order_statistic(v.into_iter(), 0.5), Some(-1.0));
        assert_eq!(median(&mut [f64::INFINITY; 3]), Some(f64::INFINITY));
    }
}
