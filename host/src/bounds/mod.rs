//! What accuracy to expect before anything is deployed: the bounds that the experiments compare estimators with, over ranges
//! and places.
//!
//! - [`bearing`]: what a bearing of one array errs by beyond noise;
//! - [`mod@line`]: a bearing of a line of sensors, and its orientation from a pass;
//! - [`passage`]: one array and a straight passage: range, heading and time of its closest point;
//! - [`network`]: several arrays: position, azimuth and range of a source against its place, and the straight passage through it;
//! - [`picture`]: both drawn.

pub mod bearing;
pub mod line;
pub mod network;
pub mod passage;
pub mod picture;
