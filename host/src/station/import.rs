//! A station file and its propagation table from what data centres keep: StationXML or dataless SEED.

use super::described::{Described, Epoch, Wanted, choose};
use super::{dataless, xml};
use crate::interrupt::{self, Guard};
use crate::ocean_bottom::table;
use crate::propagation::bottom::Bottom;
use crate::propagation::profile::SpeedProfile;
use crate::propagation::{file, trace};
use crate::{atomic, recording};
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use time::{Date, OffsetDateTime};

/// Rows of a table traced here and their distance, m: the range that the detectors look at, and a bit.
const ROWS: usize = 730;
const STEP_M: f64 = 70.0;

/// Whether a file is metadata and no station file, by its first bytes.
pub fn is_metadata(path: &Path) -> bool {
    use std::io::Read;
    let mut head = [0u8; 64];
    let read = std::fs::File::open(path).and_then(|mut f| f.read(&mut head)).unwrap_or(0);
    xml::begins(&head[..read]) || dataless::begins(&head[..read])
}

/// Reads the ocean-bottom stations of a StationXML file or a dataless SEED volume.
///
/// # Errors
/// One line: neither of both, or no station with a hydrophone and three components of motion, and why.
pub fn read(path: &Path, wanted: &Wanted) -> Result<Vec<Described>> {
    use std::io::Read;
    let mut head = [0u8; 64];
    let file = std::fs::File::open(path);
    let n = file
        .and_then(|mut f| f.read(&mut head))
        .with_context(|| format!("cannot read {}", path.display()))?;
    let told = if dataless::begins(&head[..n]) { dataless::read(path)? } else { xml::read(path)? };
    choose(told, wanted).with_context(|| path.display().to_string())
}

/// Writes a station file, and beside it a propagation table where none is given. That is traced through the profile of
/// [`SpeedProfile::subtropical`]: ranges want the sea's own.
///
/// # Errors
/// Something cannot be written, or the depth is none of a station at the bottom of an ocean.
pub fn write(described: &Described, id: u16, propagation: Option<&Path>, out: &Path) -> Result<()> {
    let beside = out.with_extension("propagation.toml");
    let silent = described.without_sensitivity();
    if !silent.is_empty() {
        recording::complain(&format!(
            "{}: no sensitivity of {}; levels are re full scale, of all channels",
            described.code,
            silent.join(", ")
        ));
    }
    for c in described.channels.iter().filter(|c| c.response.as_ref().is_some_and(|r| !r.is_sound())) {
        recording::complain(&format!(
            "{}: the poles and zeros of {} cannot be used (a pole that is not in the left half plane, or no known response at the sensitivity's \
             frequency): its response is taken as flat",
            described.code, c.code
        ));
    }
    let departing: Vec<String> = described
        .departing()
        .into_iter()
        .flatten()
        .map(|(code, _, db, deg)| format!("{code} by up to {db:.1} dB and {deg:.0}°"))
        .collect();
    if !departing.is_empty() {
        recording::complain(&format!(
            "{}: responses depart from flat between 2 and 24 Hz, {}: taken out where recordings are read, and not by a recorder itself",
            described.code,
            departing.join(", ")
        ));
    }
    let name = match propagation {
        Some(path) => {
            // The station file may lie elsewhere: its table is named by its whole path.
            let whole =
                std::fs::canonicalize(path).with_context(|| format!("cannot read {}", path.display()))?;
            whole.display().to_string()
        }
        None => {
            let profile = SpeedProfile::subtropical(described.depth_m)
                .with_context(|| format!("{} at {} m of depth", described.code, described.depth_m))?;
            let traced = trace::trace(&described.code, &profile, &Bottom::default(), STEP_M, ROWS, || ());
            table::blob(&traced, &described.code, described.recorder_hz())?;
            file::write(&traced, &beside)?;
            recording::complain(&format!(
                "{}: ranges by a typical subtropical sea {:.0} m deep; --propagation gives the sea's own",
                described.code, described.depth_m
            ));
            beside.file_name().unwrap_or_default().to_string_lossy().into_owned()
        }
    };
    atomic::write(out, described.station_file(id, &name).as_bytes())
}

/// Station files made of StationXML for as long as this lives.
#[derive(Debug)]
pub struct Imported {
    /// The station files.
    pub files: Vec<PathBuf>,
    /// Names of the stations, and from when to when what is told of each holds.
    epochs: Vec<(String, Epoch)>,
    _folder: tempfile::TempDir,
    _listed: Guard,
}

impl Imported {
    /// Says so where a station recorded on days of which its metadata tell something else, or nothing.
    pub fn hold(&self, station: &str, days: Option<&BTreeSet<Date>>) {
        // A station file's name is cut.
        let told = self.epochs.iter().find(|(code, _)| code.starts_with(station) && !station.is_empty());
        let (Some((code, (from, to))), Some(days)) = (told, days) else { return };
        let outside =
            |day: &&Date| from.is_some_and(|t| **day < t.date()) || to.is_some_and(|t| **day > t.date());
        let Some(day) = days.iter().find(outside) else { return };
        let date = |t: &Option<OffsetDateTime>| t.map_or("…".to_owned(), |t| t.date().to_string());
        recording::complain(&format!(
            "{code}: recorded on {day}, but what is told of it here holds from {} to {}: --from chooses another epoch",
            date(from),
            date(to)
        ));
    }
}

/// Makes station files of all that are wanted of a StationXML file, in a temporary folder.
///
/// # Errors
/// As [`read`] and [`write()`].
pub fn import(path: &Path, wanted: &Wanted, propagation: Option<&Path>) -> Result<Imported> {
    let (folder, listed) = interrupt::listing(|| {
        let folder = tempfile::tempdir()?;
        let path = folder.path().to_owned();
        Ok::<_, std::io::Error>((folder, Box::new(move || drop(std::fs::remove_dir_all(&path))) as _))
    })?;
    let (mut files, mut epochs) = (Vec::new(), Vec::new());
    for (id, described) in (1..).zip(read(path, wanted)?) {
        let out = folder.path().join(format!("{}.toml", described.code));
        write(&described, id, propagation, &out)?;
        files.push(out);
        epochs.push((described.code.clone(), described.epoch));
    }
    Ok(Imported { files, epochs, _folder: folder, _listed: listed })
}
