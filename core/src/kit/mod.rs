//! The estimators everything else is made of, one of each.
//!
//! - [`spd`]: symmetric positive definite matrices: factor, solution, inverse, quadratic forms;
//! - [`normal`]: normal equations of a weighted least-squares problem, their step and covariance;
//! - [`descent`]: Levenberg-Marquardt over them;
//! - [`mod@reweighted`]: Gauss-Newton rounds whose weights change with the estimate;
//! - [`mod@golden`]: the minimum of a function of one number;
//! - [`robust`]: losses and weights under which wrong measurements hardly pull (Huber, Tukey, Student and Cauchy);
//! - [`mod@quantile`]: medians and other quantiles, with and without sorting;
//! - [`straight_line`]: weighted least squares of a straight line;
//! - [`approach`]: closest point of approach of a straight motion, with its derivatives.
//!
//! All of it is double precision in fixed memory, without a panic, and gives the same bits on host and target.

pub mod approach;
pub mod descent;
pub mod golden;
pub mod normal;
pub mod quantile;
pub mod reweighted;
pub mod robust;
pub mod spd;
pub mod straight_line;

pub use approach::{Approach, closest};
pub use descent::{Point, Progress, minimise};
pub use golden::golden;
pub use normal::Normal;
pub use quantile::{median, order_statistic, quantile};
pub use reweighted::reweighted;
pub use robust::{Huber, MAD_TO_SD, Student, Tukey};
pub use spd::{Factor, Square};
pub use straight_line::StraightLine;
