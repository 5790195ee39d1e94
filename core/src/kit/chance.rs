//! What a sum of squares exceeds by chance.

/// The 99.9 % point of a standard normal error, one-sided.
const QUANTILE: f64 = 3.09;

/// What chi-squared of so many degrees of freedom (at least 1) exceeds once in a thousand: Wilson and Hilferty's cube, within 4 %.
pub fn chi_squared_limit(freedom: f64) -> f64 {
    let k = freedom.max(1.0);
    let c = 2.0 / (9.0 * k);
    let root = 1.0 - c + QUANTILE * crate::math::f64::sqrt(c);
    k * root * root * root
}

/// By what a covariance grows where the squared residual a degree of freedom is `consistency`: nothing while that is chance.
#[inline(never)]
pub fn growth(consistency: f64, freedom: f64) -> f64 {
    let freedom = freedom.max(1.0);
    if consistency * freedom > chi_squared_limit(freedom) { consistency } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_chance_explains_does_not_grow() {
        for (freedom, point) in [(1.0, 10.83), (4.0, 18.47), (12.0, 32.91), (100.0, 149.4)] {
            assert!((chi_squared_limit(freedom) / point - 1.0).abs() < 0.04, "{freedom}");
            assert_eq!(growth(0.9 * point / freedom, freedom), 1.0);
            assert_eq!(growth(1.1 * point / freedom, freedom), 1.1 * point / freedom);
        }
    }
}
