//! The Python package's native half. `seabearing/__init__.py` is what users see; `seabearing/_native.pyi` says what is here.
//!
//! In: paths, or codes in memory, and a station file. Out: records as Python's own values, samples as bytes. The work is the
//! host crate's, the same that `seabearing process` does; here is only what turns it into Python.

mod columns;
mod error;
mod input;
mod logging;
mod read;
mod run;
mod simulation;
mod watched;

#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use super::error::SeabearingError;
    #[pymodule_export]
    use super::read::{Samples, read};
    #[pymodule_export]
    use super::run::{Run, process};
    #[pymodule_init]
    fn init(_module: &pyo3::Bound<'_, pyo3::types::PyModule>) -> pyo3::PyResult<()> {
        super::logging::begin();
        Ok(())
    }

    #[pymodule_export]
    use super::simulation::{propagation_table, simulate};
}
