//! The compact array: from four hydrophones' samples to bearings with their covariance.
//!
//! Enters: [`crate::block::Block`]s of converter codes. Leaves: [`crate::wire::Message::Bearing`], [`crate::wire::Message::Transient`] and
//! [`crate::wire::Message::Fault`]. In the order data flows: [`crate::intake`] (continuity), `framing` (frames and accounting), `impulses` (snaps and bursts kept out of them), `transients` and `arrival` (the same told with their direction), `transform` and
//! `spectra` (windowed transforms, Welch cross-spectra), `search` (joint search over all six pairs), `refine` (Gauss-Newton on the
//! cross-spectra, covariance), `sick` and `leak` (which hydrophone to leave out), `detect` (is there a source at all), `three` (what three hydrophones can tell), `estimate` (one segment, all of these), `others` and `followed` (quieter sources), `paths` (what the image leaves to a long array), `exchange` (all vessels known, through exchanged channels), `surface`, `fringes` and `apart` (how deep the vessel lies, and where it is without its image), `beside` (what a vessel does that it passes by), `width` (two side by side) and `echo` (one off the bottom), `agreement`, `strain`, `change`, `course`, `jump`, `order` and `aside` (do the pairs contradict it), `report` (the record with its uncertainty), `chain` (the
//! calls a recorder makes). Beside them: `limit` (what no estimator beats).
//!
//! Assumptions: one dominant source, noise of similar level at all hydrophones used, known positions and speed of sound.
//! Relative sensitivities matter for levels and unweighted correlation only: whitening divides them out.

mod agreement;
mod apart;
mod arrival;
mod aside;
mod beside;
mod chain;
mod change;
mod course;
mod curved;
mod detect;
mod echo;
mod estimate;
mod exchange;
mod followed;
mod framed;
mod framing;
mod fringes;
mod impulses;
mod jump;
mod leak;
pub mod limit;
mod memory;
mod order;
mod others;
mod paths;
mod patterns;
mod places;
mod plan;
mod refine;
pub mod report;
mod search;
mod sick;
mod spectra;
mod steady;
mod strain;
mod surface;
#[cfg(test)]
mod test_sea;
mod three;
mod transform;
mod transients;
pub mod wavefront;
mod width;

pub use chain::{Scratch, State, finish, push};
pub(crate) use chain::{event, pause, samples};
pub use others::BEARINGS_A_STEP;
pub use plan::{FRAME, HOP, MAX_DELAY, Plan, PlanError, SHAFT_RATE_EVERY_S};
pub use transients::{AT_ONCE as TRANSIENTS_AT_ONCE, ONE_IN_S as ONE_TRANSIENT_IN_S};
