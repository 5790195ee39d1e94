//! Errors: one line that says what, where and what to do; what Python itself has raised is raised again.

use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

create_exception!(
    _native,
    SeabearingError,
    PyValueError,
    "What cannot be done, in one line: what, where and what to do."
);

/// The error as Python gets it.
pub fn raise(error: anyhow::Error) -> PyErr {
    match error.downcast::<PyErr>() {
        Ok(raised) => raised,
        Err(error) => SeabearingError::new_err(format!("{error:#}")),
    }
}
