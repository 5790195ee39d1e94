//! The ocean-bottom station: azimuth, range and track of vessels from one hydrophone and seismometer [O].
//!
//! Modules, in the order data flows:

pub mod table;
