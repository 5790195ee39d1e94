//! SD cards of recorders: prepared before a deployment, looked at and read after it.
//!
//! What stands on a card is said in `firmware/src/card/layout.rs`, which the recorder shares. A card is a folder where it
//! is mounted, or an image of it: a file with all its sectors.

pub mod blank;
pub mod kept;
pub mod medium;
pub mod simulated;
#[cfg(test)]
mod tests;

use crate::card::kept::Kept;
use crate::card::medium::{Image, Medium, Part, Single};
use anyhow::{Context, Result, bail};
use seabearing_core::config::Clips;
use seabearing_firmware::card::layout::Extent;
use seabearing_firmware::card::search::{Search, Want};
use std::path::{Path, PathBuf};

/// What a file of a card is.
#[derive(Debug, Clone)]
pub enum Content {
    /// Nothing yet.
    Unused,
    /// Sound.
    Sound(Kept),
    /// It cannot be read; why.
    Damaged(String),
}

/// A file of a card.
#[derive(Debug, Clone)]
pub struct CardFile {
    /// Number in its name.
    pub number: u32,
    /// The file that holds it (the image, or the file itself), and where it stands in it.
    pub path: PathBuf,
    /// Its sectors there.
    pub extent: Extent,
    /// What it holds.
    pub content: Content,
}

/// Seconds of sound of a file where nobody says how long: ten minutes, or as long as a clip where clips are kept, so that one takes two
/// files in the mean.
pub fn file_s(clips: Clips) -> f64 {
    const ALL_S: f64 = 600.0;
    const LEAST_S: f64 = 20.0;
    if clips.are_kept() { clips.seconds().max(LEAST_S) } else { ALL_S }
}

/// The name of a file of a card.
pub fn name(number: u32) -> String {
    format!("SB{number:06}.WAV")
}

/// The number in such a name.
fn number_in(path: &Path) -> Option<u32> {
    let name = path.file_name()?.to_str()?.to_ascii_uppercase();
    let digits = name.strip_prefix("SB")?.strip_suffix(".WAV")?;
    (digits.len() == 6).then(|| digits.parse().ok()).flatten()
}

/// Puts files in the order in which they were recorded. A recorder that keeps clips fills files again, so that of such a start the first
/// sample counts and not the file's number.
pub fn in_order<T>(files: &mut [T], kept: impl Fn(&T) -> Option<&Kept>, number: impl Fn(&T) -> u32) {
    files.sort_by_key(&number);
    let start = |file: &T| kept(file).filter(|kept| kept.clips).map(|kept| kept.label.session);
    for files in files.chunk_by_mut(|a, b| start(a).is_some() && start(a) == start(b)) {
        files.sort_by_key(|file| kept(file).filter(|kept| kept.clips).map(|kept| kept.label.first_index));
    }
}

/// Looks at a medium's file.
fn look(medium: &mut impl Medium, extent: Extent) -> Content {
    match kept::recover(&mut Part { medium, first: extent.first }, extent.pages) {
        Ok(Some(kept)) => Content::Sound(kept),
        Ok(None) => Content::Unused,
        Err(e) => Content::Damaged(format!("{e:#}")),
    }
}

/// The files of a card in order of their numbers.
///
/// # Errors
/// It cannot be read, or was not prepared.
pub fn files(card: &Path) -> Result<Vec<CardFile>> {
    let files = if card.is_dir() { in_folder(card)? } else { in_image(card)? };
    if files.is_empty() {
        bail!("{}: no file of a prepared card (seabearing card prepare)", card.display());
    }
    Ok(files)
}

fn in_folder(folder: &Path) -> Result<Vec<CardFile>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        let Some(number) = number_in(&path) else { continue };
        files.push(single(&path, number)?);
    }
    files.sort_by_key(|file| file.number);
    Ok(files)
}

/// A file of a card by itself, where it is one.
///
/// # Errors
/// It cannot be read.
pub fn single(path: &Path, number: u32) -> Result<CardFile> {
    let mut medium = Single::open(path)?;
    let extent = Extent { first: 0, pages: medium.pages() };
    let content = look(&mut medium, extent);
    Ok(CardFile { number, path: path.to_owned(), extent, content })
}

/// The file of a card at this path: `None` where it is any other.
pub fn recorded(path: &Path) -> Option<CardFile> {
    use seabearing_firmware::card::layout::label_of;
    let mut medium = Single::open(path).ok()?;
    let label = label_of(&medium.read(0, 1).ok()?)?;
    single(path, label.file).ok()
}

fn in_image(image: &Path) -> Result<Vec<CardFile>> {
    let mut medium = Image::open(image)?;
    let found = extents(&mut medium).with_context(|| image.display().to_string())?;
    let file = |(number, extent)| {
        let content = look(&mut medium, extent);
        CardFile { number, path: image.to_owned(), extent, content }
    };
    Ok(found.into_iter().map(file).collect())
}

/// Where a medium's files are, as the recorder finds them.
///
/// # Errors
/// It cannot be read, or has no file system of ours.
pub fn extents(medium: &mut impl Medium) -> Result<Vec<(u32, Extent)>> {
    let mut search = Box::new(Search::new());
    loop {
        match search.want() {
            Want::Read(sector, count) => search.take(&medium.read(sector, count)?),
            Want::Found(_) | Want::Full => return Ok(search.files().collect()),
            Want::NotPrepared => bail!("no FAT32 file system with files of ours"),
        }
    }
}
