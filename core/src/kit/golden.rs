//! Minimum of a function of one number between two limits, by golden sections.

/// Place between `low` and `high` where `cost` is least, if it has one minimum there. Each section calls it once and
/// leaves 0.618 of the interval: 40 leave 4·10⁻⁹ of it. A cost that is not a number counts as great.
pub fn golden(mut low: f64, mut high: f64, sections: u32, mut cost: impl FnMut(f64) -> f64) -> f64 {
    const SHARE: f64 = 0.618_033_988_749_894_8;
    let mut a = high - SHARE * (high - low);
    let mut b = low + SHARE * (high - low);
    let (mut at_a, mut at_b) = (cost(a), cost(b));
    for _ in 0..sections {
        if at_a <= at_b || at_b.is_nan() {
            (high, b, at_b) = (b, a, at_a);
            a = high - SHARE * (high - low);
            at_a = cost(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + SHARE * (high - low);
            at_b = cost(b);
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(seabearing_testkit::property(128))]

        #[test]
        fn the_minimum_is_found(low in -10.0f64..0.0, width in 0.1f64..20.0, place in 0.0f64..1.0) {
            let least = low + place * width;
            let found = golden(low, low + width, 40, |x| (x - least).abs());
            prop_assert!((found - least).abs() < 1e-7 * width, "{found} {least}");
        }
    }

    #[test]
    fn what_cannot_be_evaluated_is_avoided_and_one_call_is_made_a_section() {
        let mut calls = 0;
        let found = golden(0.0, 4.0, 40, |x| {
            calls += 1;
            if x > 2.0 { f64::NAN } else { (x - 1.0) * (x - 1.0) }
        });
        assert!((found - 1.0).abs() < 1e-6 && calls == 42, "{found} {calls}");
    }
}
