//! The ocean-bottom station: azimuth, range and track of vessels from one hydrophone and seismometer \[O\].
//!
//! Four-component samples come in as blocks; once a minute a set of records leaves. [`Plan`] is immutable, [`State`]
//! persists, [`Scratch`] is work space. Modules, in the order data flows:

pub mod limits;
pub mod row;
pub mod shared;
pub mod table;
pub mod table_encode;

pub mod decimate;
pub mod plan;
pub mod travel;

pub mod hops;

pub mod azigram;
pub mod background;

pub mod ambient;
pub mod cauchy;
pub mod impulsive;
pub mod tonal;

pub mod cepstrum;
pub mod clutter;
pub mod interference;
mod paper;
pub mod presence;
#[cfg(test)]
mod presence_tests;
pub mod radial;

pub mod course;
pub mod evidence;
pub mod fit;
pub mod search;
pub mod segment;
pub mod tracks;

pub mod station;
#[cfg(test)]
pub(crate) mod station_tests;

pub use plan::{Plan, PlanError};
pub(crate) use station::take;
pub use station::{Scratch, State, finish, push};
pub use table::Table;
