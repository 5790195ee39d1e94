//! A recording through the recorder: what `seabearing process` prints, kept.

use crate::columns::{columns, dict};
use crate::error::raise;
use crate::input::Input;
use crate::watched::Watched;
use anyhow::Result;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use seabearing_host::levels::Meter;
use seabearing_host::ocean_bottom::table;
use seabearing_host::record::{RecordFormat, calibrate};
use seabearing_host::recording::BlockSource as _;
use seabearing_host::replay::with_levels;
use serde_json::{Map, Value};

/// The records of a run, in order.
#[pyclass(frozen)]
pub struct Run {
    records: Vec<Map<String, Value>>,
    /// The station's name.
    #[pyo3(get)]
    station: String,
    /// UTC of sample 0, RFC 3339, where the recording tells it.
    #[pyo3(get)]
    start: Option<String>,
    /// Seconds of data.
    #[pyo3(get)]
    data_s: f64,
    /// Processor time that they took, s.
    #[pyo3(get)]
    processor_s: f64,
}

impl Run {
    fn of(&self, kind: Option<&str>) -> Vec<&Map<String, Value>> {
        let wanted = |record: &&Map<String, Value>| {
            kind.is_none() || record.get("type").and_then(Value::as_str) == kind
        };
        self.records.iter().filter(wanted).collect()
    }
}

#[pymethods]
impl Run {
    /// How many records there are of each type.
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counts = PyDict::new(py);
        for kind in self.records.iter().filter_map(|record| record.get("type").and_then(Value::as_str)) {
            let before = counts.get_item(kind)?.map_or(Ok(0), |n| n.extract::<usize>())?;
            counts.set_item(kind, before + 1)?;
        }
        Ok(counts)
    }

    /// The records of a type, or all.
    #[pyo3(signature = (kind=None))]
    fn records<'py>(&self, py: Python<'py>, kind: Option<&str>) -> PyResult<Bound<'py, PyList>> {
        let records: PyResult<Vec<_>> = self.of(kind).into_iter().map(|record| dict(py, record)).collect();
        PyList::new(py, records?)
    }

    /// The records of a type as columns.
    fn columns<'py>(&self, py: Python<'py>, kind: &str) -> PyResult<Bound<'py, PyDict>> {
        columns(py, &self.of(Some(kind)))
    }

    /// All records as JSON Lines, byte for byte what the command prints.
    fn jsonl(&self) -> String {
        let lines = self.records.iter().filter_map(|record| serde_json::to_string(record).ok());
        lines.map(|line| line + "\n").collect()
    }
}

/// Runs the recorder over a station's recording.
#[pyfunction]
pub fn process(
    py: Python<'_>,
    input: Input,
    levels_s: Option<f64>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Run> {
    // The recorder's memory is made on the stack before it is put into its place, and a notebook's stack is its own.
    py.detach(|| work(input, levels_s, progress)).map_err(raise)
}

fn work(input: Input, levels_s: Option<f64>, progress: Option<Py<PyAny>>) -> Result<Run> {
    let opened = input.open()?;
    let config = &opened.station.config;
    let table = table::of_station(&opened.station)?;
    let mut meter = levels_s.map(|s| Meter::new(&opened.station, s, false)).transpose()?;
    let mut source = Watched::new(opened.recording.source(opened.span)?, progress);
    let start = source.start();
    let format = RecordFormat { rate_hz: config.rate_hz, start, times: Default::default() };
    let mut records = Vec::new();
    let summary = with_levels(config, table.as_deref(), &mut source, meter.as_mut(), |said| {
        let mut record = format.said(said);
        calibrate(&mut record, &opened.station.calibration);
        if let Value::Object(record) = record {
            records.push(record);
        }
        Ok(())
    })?;
    Ok(Run {
        records,
        station: config.name.to_string(),
        start: start.map(seabearing_host::record::utc),
        data_s: summary.instants as f64 / config.rate_hz,
        processor_s: summary.all.as_secs_f64(),
    })
}
