//! What a store knows of its recorder besides the bytes: said once, on the command line, and needed by whoever reads the
//! store later.

use crate::atomic;
use anyhow::{Context, Result};
use seabearing_host::record::utc;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// The file beside the bytes.
const FILE: &str = "about.json";

/// Facts about a recorder.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Sample rate until the recorder tells it, Hz.
    pub rate_hz: Option<f64>,
    /// UTC of sample 0, by session.
    pub starts: BTreeMap<u32, OffsetDateTime>,
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
        let starts = said["utc_of_sample_0"].as_object().into_iter().flatten();
        let start = |(session, utc): (&String, &Value)| -> Result<(u32, OffsetDateTime)> {
            Ok((session.parse()?, OffsetDateTime::parse(utc.as_str().unwrap_or_default(), &Rfc3339)?))
        };
        Ok(Self {
            rate_hz: said["rate_hz"].as_f64(),
            starts: starts.map(start).collect::<Result<_>>().with_context(name)?,
            place: said["lat_deg"].as_f64().zip(said["lon_deg"].as_f64()),
        })
    }

    /// Writes it into a store.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let said = json!({
            "rate_hz": self.rate_hz,
            "utc_of_sample_0": self.starts.iter().map(|(s, at)| (s.to_string(), utc(*at).into())).collect::<Map<_, _>>(),
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
    fn what_is_written_is_read() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(About::read(dir.path()).unwrap(), About::default());
        let about = About {
            starts: [(1, datetime!(2024-05-01 09:00:00.25 UTC)), (3, datetime!(2024-05-02 09:00 UTC))].into(),
            place: Some((49.04, -123.32)),
            ..About::default()
        };
        about.write(dir.path()).unwrap();
        assert_eq!(About::read(dir.path()).unwrap(), about);
        std::fs::write(dir.path().join(FILE), "{\"utc_of_sample_0\": {\"1\": \"noon\"}}").unwrap();
        assert!(format!("{:#}", About::read(dir.path()).unwrap_err()).contains(FILE));
    }
}
