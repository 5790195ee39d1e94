//! What the host says of a recording (parts left out, oddities) goes to Python's logger `seabearing`.

use log::{Level, LevelFilter, Log, Metadata, Record};
use pyo3::prelude::*;

struct Logger;

impl Log for Logger {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target().starts_with("seabearing")
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let method = match record.level() {
            Level::Error => "error",
            Level::Warn => "warning",
            Level::Info => "info",
            Level::Debug | Level::Trace => "debug",
        };
        // There is nobody to tell where Python's own logging fails.
        let _: PyResult<()> = Python::attach(|py| {
            let logger = py.import("logging")?.call_method1("getLogger", ("seabearing",))?;
            logger.call_method1(method, ("%s", record.args().to_string()))?;
            Ok(())
        });
    }

    fn flush(&self) {}
}

/// Begins; a second time does nothing.
pub fn begin() {
    if log::set_logger(&Logger).is_ok() {
        log::set_max_level(LevelFilter::Debug);
    }
}
