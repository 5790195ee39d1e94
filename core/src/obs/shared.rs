//! One memory for the stages that never work at the same time.
//!
//! A frame's transforms, the search for directions, the prediction of the range posterior, the envelope of a cepstrum
//! and the likelihood grid follow one another: each writes what it reads, and what it leaves means nothing to the next.
//! Every shape covers the whole memory, which the compiler checks.

use super::limits::{AZIMUTH_BINS, AZIMUTHS, DELAYS, FRAME, HOP, QUEFRENCIES, RANGE_CELLS, SPAN, SPEEDS};
use bytemuck::{Pod, Zeroable, must_cast_mut};

/// Words of the shared memory: those of the largest shape, the likelihood grid.
const WORDS: usize = SPEEDS * RANGE_CELLS / 2;

/// Log-likelihood ratio on the grid of radial speeds and ranges, in steps of `radial::GRID_UNIT`.
pub type Grid = [[i16; RANGE_CELLS]; SPEEDS];

/// Columns of the range posterior: three that are moved, and what is added to each.
pub type Columns = [[f32; RANGE_CELLS]; 4];

/// A frame's transforms.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct Spectra {
    /// What is transformed, and its transform.
    pub buffer: [f32; FRAME],
    /// Pressure, real and imaginary.
    pub pressure: [[f32; 2]; HOP],
    /// Velocity north (real and imaginary), then intensity (east and north) in its place.
    pub intensity: [[f32; 2]; AZIMUTH_BINS],
    /// Step of the phase between pressure and velocity.
    pub phase: [u32; AZIMUTH_BINS],
    /// ln|P| of bins 0 to 512.
    pub log_pressure: [f32; HOP + 1],
    rest: [u32; WORDS - FRAME - 2 * HOP - 3 * AZIMUTH_BINS - HOP - 1],
}

/// The search for directions.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct Tonal {
    /// Evidence of one bin, or of several, about an azimuth.
    pub profile: [f32; SPAN],
    /// Evidence of all bins.
    pub sum: [f32; AZIMUTHS],
    /// Greatest log evidence of each bin.
    pub peak: [f32; AZIMUTH_BINS],
    /// What the alternatives to a vessel took from it.
    pub adjust: [f32; AZIMUTH_BINS],
    /// Its azimuth, as a step.
    pub best: [u16; AZIMUTH_BINS],
    /// 1 where it is not yet a mode's.
    pub free: [u16; AZIMUTH_BINS],
    /// How far, in azimuth steps, a bin may lie from a vessel that it is of.
    pub reach: [u16; AZIMUTH_BINS],
    rest: [u32; WORDS - SPAN - AZIMUTHS - 3 * AZIMUTH_BINS - AZIMUTH_BINS / 2],
}

/// Envelope of one cepstrum.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct Envelope {
    /// The cepstrum over its variance, turned by the carrier, real and imaginary.
    pub weighted: [[f32; 2]; QUEFRENCIES],
    /// Its correlation with a pulse at each fine delay, real and imaginary.
    pub z: [[f32; 2]; DELAYS],
    rest: [u32; WORDS - 2 * QUEFRENCIES - 2 * DELAYS],
}

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Prediction {
    columns: Columns,
    rest: [u32; WORDS - 4 * RANGE_CELLS],
}

/// The shared memory. Taking a shape ends the life of the one before.
#[derive(Clone, Debug)]
pub struct Shared([u32; WORDS]);

impl Shared {
    /// All zeros.
    pub const fn new() -> Self {
        Self([0; WORDS])
    }

    /// For a frame's transforms.
    pub fn spectra(&mut self) -> &mut Spectra {
        must_cast_mut(&mut self.0)
    }

    /// For the search for directions.
    pub fn tonal(&mut self) -> &mut Tonal {
        must_cast_mut(&mut self.0)
    }

    /// For the prediction of the range posterior.
    pub fn columns(&mut self) -> &mut Columns {
        let shape: &mut Prediction = must_cast_mut(&mut self.0);
        &mut shape.columns
    }

    /// For the envelope of a cepstrum.
    pub fn envelope(&mut self) -> &mut Envelope {
        must_cast_mut(&mut self.0)
    }

    /// For the likelihood grid.
    pub fn grid(&mut self) -> &mut Grid {
        must_cast_mut(&mut self.0)
    }
}
