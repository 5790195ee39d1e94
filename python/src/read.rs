//! Samples of a recording, as the recorder gets them.

use crate::error::raise;
use crate::input::Input;
use crate::watched::Watched;
use anyhow::{Result, bail};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use seabearing_core::block::{Frame, MISSING};
use seabearing_host::record;
use seabearing_host::recording::BlockSource as _;

/// Frames that gaps may be filled with beside those that were recorded: 4 GB of memory.
const MOST_FILLED: u64 = 1 << 28;

/// Samples at the recorder's rate, without gaps: what is missing is said to be so.
#[pyclass(frozen)]
pub struct Samples {
    frames: Vec<Frame>,
    /// Samples a second.
    #[pyo3(get)]
    rate_hz: f64,
    /// UTC of the first one, RFC 3339, where it is known.
    #[pyo3(get)]
    start: Option<String>,
    /// Code of full scale.
    #[pyo3(get)]
    full_scale: i32,
    /// The station's name.
    #[pyo3(get)]
    station: String,
}

#[pymethods]
impl Samples {
    /// Codes of four channels, 32 bits of this machine's order, instant after instant.
    fn codes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = size_of_val(&self.frames[..]);
        PyBytes::new_with(py, bytes, |to| {
            let codes = self.frames.as_flattened().iter();
            to.as_chunks_mut::<4>().0.iter_mut().zip(codes).for_each(|(to, code)| *to = code.to_ne_bytes());
            Ok(())
        })
    }

    /// The code of a sample that is missing.
    #[classattr]
    const MISSING: i32 = MISSING;
}

/// Reads the samples of a station's recording.
#[pyfunction]
pub fn read(py: Python<'_>, input: Input, progress: Option<Py<PyAny>>) -> PyResult<Samples> {
    py.detach(|| samples(input, progress)).map_err(raise)
}

fn samples(input: Input, progress: Option<Py<PyAny>>) -> Result<Samples> {
    let opened = input.open()?;
    let mut source = Watched::new(opened.recording.source(opened.span)?, progress);
    let (mut frames, mut filled): (Vec<Frame>, u64) = (Vec::new(), 0);
    while let Some(block) = source.next_block()? {
        let have = frames.len() as u64;
        // What comes twice is taken once.
        let again = usize::try_from(have.saturating_sub(block.first_index))?;
        let gap = block.first_index.saturating_sub(have);
        filled += gap;
        if filled > MOST_FILLED {
            bail!(
                "the recording has gaps of {filled} samples: read its parts one by one (from_time, to_time)"
            );
        }
        frames.resize(frames.len() + usize::try_from(gap)?, [MISSING; 4]);
        frames.extend_from_slice(block.frames.get(again..).unwrap_or_default());
    }
    let config = &opened.station.config;
    Ok(Samples {
        frames,
        rate_hz: config.rate_hz,
        start: source.start().map(record::utc),
        full_scale: config.full_scale,
        station: config.name.to_string(),
    })
}
