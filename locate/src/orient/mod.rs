//! Which way a station looks, from a vessel whose track is known (paper L, and the same idea for the other stations).
//!
//! In: what the station measured (sines of bearings, azimuths, elevations, arrival-time differences) and where the
//! vessel was. Out: the orientation with its uncertainty, or a named reason why the data do not give it.
//!
//! - [`mod@line`]: a linear array; orientation, clock shift and mean elevation by robust least squares in ξ;
//! - [`closed_form`]: the same by the paper's closed form and grids [L 9-19];
//! - [`rotation`]: the three angles of a compact array from its bearings;
//! - [`hydrophones`]: positions of a compact array's hydrophones from arrival-time differences;
//! - [`mod@geometry`]: positions and orientation together, with what was known before;
//! - [`offset`]: one constant azimuth offset (ocean-bottom station, DIFAR buoy) over several passes.

pub mod closed_form;
pub mod geometry;
pub mod hydrophones;
pub mod line;
pub mod offset;
pub mod rotation;
mod shift;

/// Why there is no orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OrientError {
    /// Fewer measurements on the known track than the unknowns need.
    #[error("too few bearings fall on the known track")]
    TooFew,
    /// A value is not a finite number, or a setting not positive.
    #[error("a bearing, position or setting is not a usable number")]
    NotFinite,
    /// The vessel's bearing changes too little (or the directions span too little) to tell the unknowns apart.
    #[error("not observable: the vessel's bearing changes too little to tell the orientation")]
    NotObservable,
    /// The unknowns are told apart, but stay too uncertain to be an answer.
    #[error(
        "the orientation stays uncertain by more than 6°: a pass that turns more, or is heard longer, tells it"
    )]
    Uncertain,
    /// No place was found from which the fit moves no more.
    #[error(
        "the fit of positions and orientation does not settle: are the track, its times and the positions as far off as is told?"
    )]
    Unsettled,
    /// The measurements agree with no orientation much better than with any other.
    #[error("the bearings agree with no single orientation")]
    Inconsistent,
}

/// Blocks in time of the jackknife: successive bearings of an averaged covariance have common errors, blocks hardly.
const BLOCKS: usize = 20;

/// The block of bearing `i` of `n`.
fn block_of(i: usize, n: usize) -> usize {
    i * BLOCKS / n.max(1)
}

/// Standard deviations by leaving out one block at a time: `(B − 1)/B · Σ (θ_b − θ̄)²`. `left_out` gives what changes
/// without a block, or nothing where it cannot be told; `None` if that is so for half of them.
fn jackknife<const N: usize>(
    blocks: usize,
    left_out: impl Fn(usize) -> Option<[f64; N]>,
) -> Option<[f64; N]> {
    let (mut count, mut sum, mut squares) = (0.0, [0.0; N], [0.0; N]);
    for change in (0..blocks).filter_map(left_out) {
        count += 1.0;
        for ((s, q), d) in sum.iter_mut().zip(&mut squares).zip(&change) {
            *s += d;
            *q += d * d;
        }
    }
    if count < 0.5 * blocks as f64 {
        return None;
    }
    let mut sd = [0.0; N];
    for ((x, s), q) in sd.iter_mut().zip(&sum).zip(&squares) {
        *x = crate::math::f64::sqrt(((count - 1.0) / count * (q - s * s / count)).max(0.0));
    }
    Some(sd)
}

/// A quantile without memory; zero of nothing.
fn quantile(values: impl Iterator<Item = f64> + Clone, share: f64) -> f64 {
    crate::kit::order_statistic(values, share).unwrap_or(0.0)
}
