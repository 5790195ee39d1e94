//! Positions from a network of compact arrays that share no clock (paper N).
//!
//! In: per array its position and one azimuth and (where it has one) elevation with their standard deviations.
//! Out: the maximum-likelihood position inside a bounded search region, its covariance, and which arrays it rests
//! on; or a named reason why there is none.
//!
//! Model [N 3, 4]: `α_n = atan2(x − x_n, y − y_n)`, `β_n = atan2(z − z_n, d_n)`, independent Gaussian errors.
//!
//! - [`model`]: bearings, their derivatives, rectangular and polar coordinates [N 1, 3, 15, 16];
//! - [`region`]: the admissible set, which is part of the problem;
//! - [`bound`]: Cramér-Rao bounds with and without a known depth [N 11-18];
//! - [`search`]: the estimators [N 8, 9, 10];
//! - [`fn@locate`]: a fix or a refusal, robust to one bad array, less the second-order bias of the likelihood;
//! - [`common_time`]: bearings of different instants brought to one instant by their own rates;
//! - [`known_track`], [`align`]: a vessel with a known track and the antenna-to-propeller shift [N 22];
//! - [`joint`]: straight motion from bearings of several arrays over time, without any speed prior; orientation and clock
//!   of each array are unknowns with priors.
//!
//! Assumes straight horizontal sound paths (constant sound speed) and arrays whose positions are right. At one instant
//! their orientations and clocks are taken to be right, too.

pub mod align;
pub mod bound;
pub mod common_time;
mod curvature;
pub mod joint;
pub mod known_track;
pub mod locate;
pub mod model;
pub mod region;
pub mod search;

pub use bound::{PolarBound, RectangularBound, known_depth_bound, polar_bound, rectangular_bound};
pub use locate::{Fix, FixSettings, locate};
pub use model::Sighting;
pub use region::Region;

/// Most arrays in one network: with sixteen, the all-pairs starting points (120) still fit a few kilobytes.
pub const MAX_ARRAYS: usize = 16;

/// Why there is no position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// No bearing was given.
    #[error("no bearing")]
    NoBearings,
    /// More than [`MAX_ARRAYS`] arrays.
    #[error("more than 16 arrays")]
    TooManyArrays,
    /// A coordinate, angle or standard deviation is not a finite number, or a standard deviation is not positive.
    #[error("a bearing, position or standard deviation is not a usable number")]
    NotFinite,
    /// The search region is empty.
    #[error("the search region is empty")]
    EmptyRegion,
    /// The bearings do not determine the position: a single array without known depth, a source on the line through
    /// the arrays, or a source so far that its range is not resolved.
    #[error("not observable: the bearings do not determine the position")]
    NotObservable,
    /// The arrays contradict each other, and with what would explain it they determine nothing.
    #[error("the arrays contradict each other: are all bearings of one vessel on one course?")]
    Contradictory,
    /// The likelihood is greatest at the edge of the search region: the source is probably outside it.
    #[error("the most likely position is at the edge of the search region")]
    OutsideRegion,
}
