//! Motion of a vessel from the bearings of one array (paper M).
//!
//! In: bearings with their errors. Out: time, range and azimuth of the closest point of approach, heading, speed,
//! side and positions, with their spreads. See `docs/motion.md` for what each estimator assumes and when it fails.

pub mod chain;
pub mod hypotheses;
pub mod model;
pub mod normal;
pub mod profile;
pub mod solution;
pub mod start;

pub use model::{Limits, Line, Medium};
pub use solution::Solution;
