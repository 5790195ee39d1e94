//! Sectors, wherever they are.

use anyhow::{Context, Result};
use seabearing_firmware::card::{PAGE, SECTOR};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Something with sectors.
pub trait Medium {
    /// Reads so many sectors.
    ///
    /// # Errors
    /// They cannot be read, or are not there.
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>>;
}

/// A card's image.
#[derive(Debug)]
pub struct Image(File);

impl Image {
    /// Opens it.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self(File::open(path).with_context(|| format!("cannot read {}", path.display()))?))
    }
}

fn read(file: &mut File, sector: u32, count: u32) -> Result<Vec<u8>> {
    let mut bytes = vec![0; count as usize * SECTOR];
    file.seek(SeekFrom::Start(u64::from(sector) * SECTOR as u64))?;
    file.read_exact(&mut bytes).with_context(|| {
        format!("sector {sector} cannot be read: no card, or a copy of one that was cut short")
    })?;
    Ok(bytes)
}

impl Medium for Image {
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>> {
        read(&mut self.0, sector, count)
    }
}

/// A file of a card.
#[derive(Debug)]
pub struct Single(File, u64);

impl Single {
    /// Opens it.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        let length = file.metadata()?.len();
        Ok(Self(file, length))
    }

    /// Its whole pages.
    pub fn pages(&self) -> u32 {
        u32::try_from(self.1 / PAGE as u64).unwrap_or(u32::MAX)
    }
}

impl Medium for Single {
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>> {
        read(&mut self.0, sector, count)
    }
}

/// The sectors of a medium from one on.
#[derive(Debug)]
pub struct Part<'a, M> {
    /// The medium.
    pub medium: &'a mut M,
    /// Its first sector.
    pub first: u32,
}

impl<M: Medium> Medium for Part<'_, M> {
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>> {
        self.medium.read(self.first.saturating_add(sector), count)
    }
}
