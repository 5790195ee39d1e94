//! One vessel's motion from a file of bearings of one array, and the error model of bearings from a vessel of known track.
//!
//! [`bearings`] reads the file, [`estimate`] fits the track (all bearings at once, or one after the other as the recorder
//! does), [`errors`] fits the error model, [`picture`] draws. The estimators are `seabearing_locate::motion` and
//! `seabearing_core::passage`; here is the memory they need and what their refusals mean to a person.

pub mod bearings;
pub mod errors;
pub mod estimate;
pub mod picture;
pub mod radians;

use seabearing_locate::motion::whiten::{WhitenError, Workspace};

/// Positions on a regular grid a batch fit takes: over half an hour at two bearings a second.
const POSITIONS: usize = 4001;
/// Largest lent memory for irregular times, numbers: 4000 bearings, 64 MB.
const DENSE: usize = 4000 * 4001 / 2;

/// What batch estimators work in; grows for irregular times.
struct BatchRoom {
    work: Box<Workspace<POSITIONS>>,
    dense: Vec<f64>,
}

impl BatchRoom {
    fn new() -> Self {
        Self { work: Box::new(Workspace::new()), dense: Vec::new() }
    }

    /// Runs an estimator, once more with as much memory as it asks for, up to [`DENSE`].
    fn with<T, E>(
        &mut self,
        whitening: impl Fn(&E) -> Option<WhitenError>,
        mut estimate: impl FnMut(&mut Workspace<POSITIONS>, &mut [f64]) -> Result<T, E>,
    ) -> Result<T, E> {
        let found = estimate(&mut self.work, &mut self.dense);
        match found.as_ref().err().and_then(whitening) {
            Some(WhitenError::Memory(needed)) if needed <= DENSE => {
                self.dense.resize(needed, 0.0);
                estimate(&mut self.work, &mut self.dense)
            }
            _ => found,
        }
    }
}
