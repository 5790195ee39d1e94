//! Records as Python's values: one by one, or column by column.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde_json::{Map, Value};

/// A value as Python has it.
pub fn object<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(b) => b.into_pyobject(py)?.to_owned().into_any(),
        Value::Number(n) => match (n.as_u64(), n.as_i64()) {
            (Some(n), _) => n.into_pyobject(py)?.into_any(),
            (_, Some(n)) => n.into_pyobject(py)?.into_any(),
            _ => n.as_f64().into_pyobject(py)?,
        },
        Value::String(s) => s.into_pyobject(py)?.into_any(),
        Value::Array(items) => {
            let items: PyResult<Vec<_>> = items.iter().map(|item| object(py, item)).collect();
            PyList::new(py, items?)?.into_any()
        }
        Value::Object(fields) => dict(py, fields)?.into_any(),
    })
}

/// One record.
pub fn dict<'py>(py: Python<'py>, fields: &Map<String, Value>) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    fields.iter().try_for_each(|(name, value)| dict.set_item(name, object(py, value)?))?;
    Ok(dict)
}

/// The columns of some records, in the order in which their names come first; `None` where a record has no such field.
pub fn columns<'py>(py: Python<'py>, records: &[&Map<String, Value>]) -> PyResult<Bound<'py, PyDict>> {
    let mut names: Vec<&str> = Vec::new();
    for record in records {
        names.extend(
            record.keys().map(String::as_str).filter(|name| !names.contains(name)).collect::<Vec<_>>(),
        );
    }
    let dict = PyDict::new(py);
    for name in names {
        let column: PyResult<Vec<_>> =
            records.iter().map(|record| object(py, record.get(name).unwrap_or(&Value::Null))).collect();
        dict.set_item(name, PyList::new(py, column?)?)?;
    }
    Ok(dict)
}
