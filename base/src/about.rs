//! What a store knows of its recorder besides the bytes: said once, on the command line, and needed by whoever reads the
//! store later.

use crate::atomic;
use anyhow::{Context, Result};
use seabearing_host::record::utc;
use serde_json::{Value, json};
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// The file beside the bytes.
const FILE: &str = "about.json";

/// Facts about a recorder.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct About {
    /// Sample rate until the recorder tells it, Hz.
    pub rate_hz: Option<f64>,
    /// UTC of sample 0.
    pub start: Option<OffsetDateTime>,
    /// Latitude and longitude, degrees.
    pub place: Option<(f64, f64)>,
}

impl About {
    /// What a store says; nothing where it has no such file.
    ///
    /// # Errors
    /// The file cannot be read, or is not what this program writes.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let name = || path.display().to_string();
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(e) => return Err(e).with_context(name),
        };
        let said: Value = serde_json::from_str(&text).with_context(name)?;
        let start = said["utc_of_sample_0"].as_str().map(|s| OffsetDateTime::parse(s, &Rfc3339));
        Ok(Self {
            rate_hz: said["rate_hz"].as_f64(),
            start: start.transpose().with_context(name)?,
            place: said["lat_deg"].as_f64().zip(said["lon_deg"].as_f64()),
        })
    }

    /// What this one does not say, another does.
    pub fn or(self, other: Self) -> Self {
        Self {
            rate_hz: self.rate_hz.or(other.rate_hz),
            start: self.start.or(other.start),
            place: self.place.or(other.place),
        }
    }

    /// Writes it into a store.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let said = json!({
            "rate_hz": self.rate_hz,
            "utc_of_sample_0": self.start.map(utc),
            "lat_deg": self.place.map(|p| p.0),
            "lon_deg": self.place.map(|p| p.1),
        });
        atomic::write(&folder.join(FILE), format!("{said:#}\n").as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::macros::datetime;

    #[test]
    fn what_is_written_is_read_and_what_is_said_now_comes_first() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(About::read(dir.path()).unwrap(), About::default());
        let first = About {
            start: Some(datetime!(2024-05-01 09:00:00.25 UTC)),
            place: Some((49.04, -123.32)),
            ..About::default()
        };
        first.write(dir.path()).unwrap();
        assert_eq!(About::read(dir.path()).unwrap(), first);
        let later = About { rate_hz: Some(50.0), start: Some(datetime!(2025-01-01 0:00 UTC)), place: None };
        let both = later.or(first);
        assert_eq!((both.rate_hz, both.start, both.place), (later.rate_hz, later.start, first.place));
        std::fs::write(dir.path().join(FILE), "{\"utc_of_sample_0\": \"noon\"}").unwrap();
        assert!(format!("{:#}", About::read(dir.path()).unwrap_err()).contains(FILE));
    }
}
