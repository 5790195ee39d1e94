//! Motion of a vessel from all bearings of one array at once (paper M), and what no estimator beats.
//!
//! In: bearings with a model of their errors. Out: the maximum-likelihood track with its spread. The line, its
//! measurement model and what a fit says are the recorder's own ([`seabearing_core::motion`]), so that batch and
//! recursive estimates are compared like with like. See `docs/motion.md` for what each estimator assumes.

pub mod bound;
pub mod change;
pub mod covariance;
pub mod errors;
mod factor;
pub mod lasting;
pub mod lone;
pub mod ml;
pub mod robust;
mod slow;
#[cfg(test)]
mod test_pass;
pub mod whiten;

use seabearing_core::motion::{chain, hypotheses, model, normal, profile, solution, start};
