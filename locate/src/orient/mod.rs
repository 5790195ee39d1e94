//! Which way a station looks, from a vessel whose track is known (paper L, and the same idea for the other stations).
//!
//! In: what the station measured (sines of bearings, azimuths, elevations, arrival-time differences) and where the
//! vessel was. Out: the orientation with its uncertainty, or a named reason why the data do not give it.
//!
//! - [`mod@line`]: a linear array; orientation, clock shift and mean elevation by robust least squares in ξ;
//! - [`closed_form`]: the same by the paper's closed form and grids [L 9-19];
//! - [`rotation`]: the three angles of a compact array from its bearings;
//! - [`hydrophones`]: positions of a compact array's hydrophones from arrival-time differences;
//! - [`offset`]: one constant azimuth offset (ocean-bottom station, DIFAR buoy) over several passes.

pub mod closed_form;
pub mod hydrophones;
pub mod line;
pub mod offset;
pub mod rotation;

/// Why there is no orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OrientError {
    /// Fewer measurements on the known track than the unknowns need.
    TooFew,
    /// A value is not a finite number, or a setting not positive.
    NotFinite,
    /// The vessel's bearing changes too little (or the directions span too little) to tell the unknowns apart.
    NotObservable,
    /// The measurements agree with no orientation much better than with any other.
    Inconsistent,
}

impl core::fmt::Display for OrientError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooFew => "too few bearings fall on the known track",
            Self::NotFinite => "a bearing, position or setting is not a usable number",
            Self::NotObservable => {
                "not observable: the vessel's bearing changes too little to tell the orientation"
            }
            Self::Inconsistent => "the bearings agree with no single orientation",
        })
    }
}

impl core::error::Error for OrientError {}

/// Huber's constant: 95 % efficiency for Gaussian errors.
const HUBER: f64 = 1.345;
/// Standard deviation of a Gaussian over its median absolute deviation.
const MAD_TO_SD: f64 = 1.4826;

/// Huber's weight of a residual given in standard deviations.
fn huber_weight(r: f64) -> f64 {
    let r = crate::math::f64::abs(r);
    if r <= HUBER { 1.0 } else { HUBER / r }
}

/// Tukey's constant: 95 % efficiency for Gaussian errors; what lies beyond it counts for nothing.
const TUKEY: f64 = 4.685;

/// Tukey's weight of a residual given in standard deviations.
fn tukey_weight(r: f64) -> f64 {
    let u = 1.0 - (r / TUKEY) * (r / TUKEY);
    if u > 0.0 { u * u } else { 0.0 }
}

/// Tukey's loss of a residual given in standard deviations, at most a sixth of the constant's square.
fn tukey_loss(r: f64) -> f64 {
    let u = (1.0 - (r / TUKEY) * (r / TUKEY)).max(0.0);
    TUKEY * TUKEY / 6.0 * (1.0 - u * u * u)
}

/// Blocks in time of the jackknife: successive bearings of an averaged covariance have common errors, blocks hardly.
const BLOCKS: usize = 20;

/// The block of bearing `i` of `n`.
fn block_of(i: usize, n: usize) -> usize {
    i * BLOCKS / n.max(1)
}

/// Standard deviations by leaving out one block at a time: `(B − 1)/B · Σ (θ_b − θ̄)²`. `left_out` gives what changes
/// without a block, or nothing where it cannot be told; `None` if that is so for half of them.
fn jackknife<const N: usize>(left_out: impl Fn(usize) -> Option<[f64; N]>) -> Option<[f64; N]> {
    let (mut count, mut sum, mut squares) = (0.0, [0.0; N], [0.0; N]);
    for change in (0..BLOCKS).filter_map(left_out) {
        count += 1.0;
        for ((s, q), d) in sum.iter_mut().zip(&mut squares).zip(&change) {
            *s += d;
            *q += d * d;
        }
    }
    if count < 0.5 * BLOCKS as f64 {
        return None;
    }
    let mut sd = [0.0; N];
    for ((x, s), q) in sd.iter_mut().zip(&sum).zip(&squares) {
        *x = crate::math::f64::sqrt(((count - 1.0) / count * (q - s * s / count)).max(0.0));
    }
    Some(sd)
}

/// The value below which a share of the values lies, without sorting: bisection over the values' range, counting at
/// each of 40 steps (no memory beside the caller's). Zero for no value.
fn quantile(values: impl Iterator<Item = f64> + Clone, share: f64) -> f64 {
    let (mut lo, mut hi, mut n) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
    for x in values.clone() {
        lo = lo.min(x);
        hi = hi.max(x);
        n += 1.0;
    }
    if n == 0.0 || !lo.is_finite() || !hi.is_finite() {
        return 0.0;
    }
    for _ in 0..40 {
        let middle = 0.5 * (lo + hi);
        let below = values.clone().filter(|x| *x <= middle).count() as f64;
        if below >= share * n {
            hi = middle;
        } else {
            lo = middle;
        }
    }
    hi
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_without_sorting() {
        let v = [5.0, 1.0, 4.0, 2.0, 3.0];
        assert!((quantile(v.iter().copied(), 0.5) - 3.0).abs() < 1e-9);
        assert!((quantile(v.iter().copied(), 1.0) - 5.0).abs() < 1e-9);
        assert_eq!(quantile(core::iter::empty(), 0.5), 0.0);
    }
}
