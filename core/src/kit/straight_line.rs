//! Weighted least squares of a straight line.
//!
//! In: times (from an origin near the middle: rounding grows with the distance), values, weights. Out: value and slope at
//! the origin, and what their variances are in units of a measurement of weight one.

/// Sums over the measurements.
#[derive(Clone, Copy, Debug, Default)]
pub struct StraightLine {
    weight: f64,
    t: f64,
    tt: f64,
    y: f64,
    ty: f64,
}

/// The line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// Value at the origin of times.
    pub value: f64,
    /// Change with time.
    pub slope: f64,
    /// Variance of the value at the origin.
    pub var_value: f64,
    /// Variance of the slope.
    pub var_slope: f64,
    /// Covariance of both.
    pub cov: f64,
}

impl StraightLine {
    /// Adds a measurement.
    pub fn add(&mut self, t: f64, value: f64, weight: f64) {
        self.weight += weight;
        self.t += weight * t;
        self.tt += weight * t * t;
        self.y += weight * value;
        self.ty += weight * t * value;
    }

    /// Adds the knowledge that the slope is zero, with a weight (one over its variance).
    pub fn add_level(&mut self, weight: f64) {
        self.tt += weight;
    }

    /// Weighted mean of the values; `None` of nothing.
    pub fn mean(&self) -> Option<f64> {
        (self.weight > 0.0).then(|| self.y / self.weight)
    }

    /// The line; `None` where the measurements give no slope.
    pub fn fit(&self) -> Option<Fitted> {
        let Self { weight: n, t, tt, y, ty } = *self;
        let determinant = n * tt - t * t;
        // Rounding leaves this share of the products behind where all times are the same.
        let fitted = Fitted {
            value: (tt * y - t * ty) / determinant,
            slope: (n * ty - t * y) / determinant,
            var_value: tt / determinant,
            var_slope: n / determinant,
            cov: -t / determinant,
        };
        (determinant > 1e-14 * n * tt && fitted.value.is_finite() && fitted.slope.is_finite())
            .then_some(fitted)
    }
}

impl Fitted {
    /// Value at a time.
    pub fn at(&self, t: f64) -> f64 {
        self.value + self.slope * t
    }
}

/// Least squares of equally weighted points; `None` where they give no slope.
pub fn through(points: impl Iterator<Item = (f64, f64)>) -> Option<Fitted> {
    let mut sums = StraightLine::default();
    points.for_each(|(t, value)| sums.add(t, value, 1.0));
    sums.fit()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(seabearing_testkit::property(128))]

        #[test]
        fn a_straight_line_is_found_wherever_it_lies(
            value in -10.0f64..10.0, slope in -3.0f64..3.0, times in prop::collection::vec(-20.0f64..20.0, 3..30)
        ) {
            let mut sums = StraightLine::default();
            for (k, t) in times.iter().enumerate() {
                sums.add(*t, value + slope * t, 1.0 + k as f64);
            }
            let found = sums.fit().unwrap();
            prop_assert!((found.value - value).abs() < 1e-6 && (found.slope - slope).abs() < 1e-6);
            // Nowhere is the line better known than at the weighted mean time, with the weight of all.
            let mean_t = -found.cov / found.var_slope;
            let total: f64 = (0..times.len()).map(|k| 1.0 + k as f64).sum();
            let variance_at = |t: f64| found.var_value + 2.0 * t * found.cov + t * t * found.var_slope;
            prop_assert!((variance_at(mean_t) * total - 1.0).abs() < 1e-6);
            prop_assert!(variance_at(mean_t + 1.0) > variance_at(mean_t));
        }
    }

    #[test]
    fn one_time_gives_no_slope_and_a_level_does() {
        let mut sums = StraightLine::default();
        assert_eq!(sums.mean(), None);
        for _ in 0..5 {
            sums.add(0.1, 2.0, 0.3);
        }
        assert_eq!(sums.fit(), None);
        assert_eq!(through([(1.0, f64::NAN), (2.0, 0.0)].into_iter()), None);
        sums.add_level(1.0);
        let found = sums.fit().unwrap();
        assert!((found.value - 2.0).abs() < 1e-12 && found.slope.abs() < 1e-12 && sums.mean() == Some(2.0));
    }
}
