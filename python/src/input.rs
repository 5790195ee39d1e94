//! What both reading and processing are asked for: a station, and its recordings in files or in memory.

use anyhow::{Context, Result, bail};
use pyo3::prelude::*;
use seabearing_core::block::Frame;
use seabearing_host::recording::{Asked, Recording, Span, written_time};
use seabearing_host::station::Station;
use seabearing_host::station::described::Wanted;
use seabearing_host::station::import::{self, Imported};
use std::path::PathBuf;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Arguments from Python.
#[derive(FromPyObject)]
pub struct Input {
    /// Station file, or StationXML of one station.
    #[pyo3(item)]
    station: PathBuf,
    /// Propagation table of a station that StationXML describes.
    #[pyo3(item)]
    propagation: Option<PathBuf>,
    /// Files and folders; none where there are codes.
    #[pyo3(item)]
    files: Vec<PathBuf>,
    /// Codes of four channels, 32 bits, little-endian, instant after instant; and how many instants there are in a second.
    #[pyo3(item)]
    codes: Option<(Vec<u8>, f64)>,
    /// RFC 3339.
    #[pyo3(item)]
    start: Option<String>,
    #[pyo3(item)]
    from_time: Option<String>,
    #[pyo3(item)]
    to_time: Option<String>,
    /// As `+10:00`.
    #[pyo3(item)]
    name_offset: Option<String>,
}

/// A station and its recordings, looked at and not yet read.
pub struct Opened {
    /// The station.
    pub station: Station,
    /// Its recordings.
    pub recording: Recording,
    /// The part that is wanted.
    pub span: Span,
    /// Keeps the files that were made of StationXML.
    _imported: Option<Imported>,
}

impl Input {
    /// Looks at everything.
    ///
    /// # Errors
    /// One line for a person.
    pub fn open(self) -> Result<Opened> {
        let span =
            Span { from: instant("from_time", self.from_time)?, to: instant("to_time", self.to_time)? };
        if span.from.zip(span.to).is_some_and(|(from, to)| from >= to) {
            bail!("to_time must be later than from_time");
        }
        let offset = |text: String| {
            let parsed = written_time::offset(&text);
            parsed.with_context(|| format!("name_offset {text}: not an offset; one like +10:00 was expected"))
        };
        let name_offset = self.name_offset.map(offset).transpose()?;
        let asked = Asked { start: instant("start", self.start)?, span, name_offset };
        let imported = match import::is_metadata(&self.station) {
            true => {
                let wanted = Wanted { at: span.from, ..Wanted::default() };
                Some(import::import(&self.station, &wanted, self.propagation.as_deref())?)
            }
            false => None,
        };
        let file = match imported.as_ref().map(|i| &i.files[..]) {
            None => &self.station,
            Some([file]) => file,
            Some(files) => {
                bail!("{} tells of {} stations; one was expected", self.station.display(), files.len())
            }
        };
        let station = Station::of_recorder(file)?;
        let recording = match self.codes {
            Some((bytes, rate_hz)) => Recording::of_frames(frames(&bytes)?, rate_hz, &station, &asked)?,
            None => Recording::find(&self.files, &station, &asked)?,
        };
        Ok(Opened { station, recording, span, _imported: imported })
    }
}

fn instant(name: &str, text: Option<String>) -> Result<Option<OffsetDateTime>> {
    let parse = |text: String| {
        let parsed = OffsetDateTime::parse(&text, &Rfc3339);
        parsed
            .with_context(|| format!("{name} {text}: not a time; one like 2026-05-01T09:00:00Z was expected"))
    };
    text.map(parse).transpose()
}

fn frames(bytes: &[u8]) -> Result<Vec<Frame>> {
    let codes = bytes.as_chunks::<4>().0.iter().map(|code| i32::from_le_bytes(*code));
    let codes: Vec<i32> = codes.collect();
    let (frames, rest) = codes.as_chunks::<4>();
    if frames.is_empty() || !rest.is_empty() {
        bail!("samples of four channels were expected, and at least one of each");
    }
    Ok(frames.to_vec())
}
