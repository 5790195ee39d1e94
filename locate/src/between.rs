//! Values between the rows of a table in order of time.

/// The rows about a time and the share of the way from the first to the second, 0 to 1: exactly 0 at a row's own time, 1 at
/// the last's. `None` outside the table and where it has fewer than two rows.
pub fn between<T>(rows: &[T], time_s: impl Fn(&T) -> f64, t_s: f64) -> Option<(&T, &T, f64)> {
    let after = rows.partition_point(|row| time_s(row) <= t_s).min(rows.len().saturating_sub(1));
    let (a, b) = (rows.get(after.checked_sub(1)?)?, rows.get(after)?);
    let share = (t_s - time_s(a)) / (time_s(b) - time_s(a));
    (0.0..=1.0).contains(&share).then_some((a, b, share))
}

/// Coordinates at such a share of the way, on a straight line.
pub fn mixed<const N: usize>(a: &[f64; N], b: &[f64; N], share: f64) -> [f64; N] {
    let mut out = *a;
    for (x, end) in out.iter_mut().zip(b) {
        *x += share * (end - *x);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_about_a_time() {
        let rows = [(0.0, 5.0), (10.0, 7.0), (30.0, 3.0)];
        let at =
            |t: f64| between(&rows, |r| r.0, t).map(|((_, a), (_, b), share)| mixed(&[*a], &[*b], share)[0]);
        let found = [-0.1, 0.0, 5.0, 10.0, 20.0, 30.0, 30.1, f64::NAN].map(at);
        assert_eq!(found, [None, Some(5.0), Some(6.0), Some(7.0), Some(5.0), Some(3.0), None, None]);
        assert!(between(&rows[..1], |r| r.0, 0.0).is_none());
    }
}
