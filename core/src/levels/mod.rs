//! Levels of sound and motion: spectra, decidecade and decade bands, broadband, each over an interval of time.
//!
//! Enters: blocks of codes. Leaves, for each interval (60 s, say) and channel: the mean square in cells of a fortieth of a
//! decade ([`bands`]), of which every band is a sum; percentiles of their levels over snapshots of a second; and what share
//! of the interval that is of. All in units of full scale squared; sensitivities are the caller's.
//!
//! In the order a sample meets them: `intervals` (index, missing and clipped codes), `decimate` (by eight, from stage to
//! stage), `transform` (spectra of 1024 points of each stage), `cells` (what of which stage
//! belongs into which cell), `percentiles`.
//!
//! Every transform is of whole data: one with a missing or clipped code of a channel is not taken for that channel.
//! Cost on a host with four lanes: 13 ns a sample instant of four channels.

pub mod bands;
mod cells;
mod decimate;
mod intervals;
mod lanes;
mod percentiles;
mod transform;

#[cfg(test)]
mod class_tests;
#[cfg(test)]
mod tests;

pub use cells::{CELLS, Plan, PlanError, STAGES};
pub use intervals::{Report, Scratch, State, finish, push};
pub use percentiles::{EMPTY_ROW, PERCENT, ROWS, Row, percentiles_db, row_of_decidecade};
