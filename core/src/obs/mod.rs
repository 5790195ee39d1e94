//! The ocean-bottom station: azimuth, range and track of vessels from one hydrophone and seismometer \[O\].
//!
//! Four-component samples come in as blocks; once a minute a set of records leaves. [`Plan`] is immutable, [`State`]
//! persists, [`Scratch`] is work space. Modules, in the order data flows; public are those that a host also needs by themselves:

pub mod limits;
mod row;
pub mod shared;
pub mod table;
pub mod table_encode;

pub mod decimate;
pub mod plan;
mod travel;

mod first_motion;
mod hops;
pub mod mend;
mod moments;

mod averages;
mod azigram;
mod background;
mod bands;
mod evened;
mod steady;

mod ambient;
mod between;
mod bursts;
mod cauchy;
mod impulsive;
mod lines;
mod tonal;

pub mod cepstrum;
pub mod clutter;
mod interference;
pub mod lasting;
mod leaning;
mod pairs;
mod paper;
pub mod presence;
#[cfg(test)]
mod presence_tests;
pub mod radial;

mod allowance;
mod bend;
mod checks;
mod course;
mod deaf;
mod doppler;
pub mod evidence;
mod fit;
mod gains;
mod gone;
mod jump;
mod misplaced;
mod residuals;
mod search;
mod segment;
mod signs;
mod tracks;
mod unheard;

mod minute_records;
mod station;
#[cfg(test)]
pub(crate) mod station_tests;

pub use plan::{Plan, PlanError};
pub(crate) use station::{CLOSED_AFTER_S, close, take};
pub use station::{Scratch, State, finish, push};
pub use table::Table;
