//! Looking for the first unused file of a card, a few sectors a turn of the loop.

use super::SECTOR;
use super::fat::{self, Entry, File, Volume};
use super::layout::{Extent, LEAST_PAGES, MOST_PAGES, Slot};
use heapless::Vec;

/// Files that are looked at; more on a card stay unused.
pub const MOST_FILES: usize = 1000;
/// Sectors read at a time.
pub const STAGE_SECTORS: u32 = 16;
/// Bytes of them.
pub const STAGE_BYTES: usize = STAGE_SECTORS as usize * SECTOR;
/// Entries of the table in so many sectors.
const STAGE_ENTRIES: u32 = (STAGE_BYTES / 4) as u32;
/// Sectors of a folder that are looked at: 64 clusters of 32 KiB, 65 536 entries.
const MOST_FOLDER: u32 = 4096;

/// An unused file in one piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// Number in its name.
    pub number: u32,
    /// Where it is.
    pub extent: Extent,
    /// The newest of its slots, where it was filled before and is to be filled again; 0 of an unused one.
    pub sequence: u32,
}

/// What the search wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Want {
    /// These sectors (first, how many).
    Read(u32, u32),
    /// Nothing: this is the file.
    Found(Found),
    /// Nothing: all files are used.
    Full,
    /// Nothing: the card is not prepared.
    NotPrepared,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Boot(u32),
    Folder {
        cluster: u32,
        sector: u32,
    },
    FolderNext(u32),
    /// Which of the files between `low` and `high` is the first unused one; `slot` is looked at.
    Half {
        low: usize,
        high: usize,
        slot: u32,
        blank: bool,
    },
    Chain {
        file: usize,
        done: u32,
    },
    Found(Found),
    Full,
    NotPrepared,
}

/// A search.
#[derive(Debug)]
pub struct Search {
    step: Step,
    volume: Option<Volume>,
    files: Vec<File, MOST_FILES>,
    folder: u32,
}

impl Search {
    /// On a card not looked at.
    pub const fn new() -> Self {
        Self { step: Step::Boot(0), volume: None, files: Vec::new(), folder: 0 }
    }

    /// Begins again, on another card.
    pub fn begin(&mut self) {
        (self.step, self.volume, self.folder) = (Step::Boot(0), None, 0);
        self.files.clear();
    }

    /// Looks for an unused file with a greater number than this, on the same card.
    pub fn after(&mut self, number: u32) {
        let next = self.files.iter().position(|file| file.number > number).unwrap_or(self.files.len());
        self.half(next, self.files.len());
    }

    /// All files of the card's kind, in order of their numbers, once the folder was read.
    pub fn files(&self) -> impl Iterator<Item = (u32, Extent)> + '_ {
        let of = |file: &File| Some((file.number, self.volume.as_ref()?.extent(file)));
        self.files.iter().filter_map(of)
    }

    fn half(&mut self, low: usize, high: usize) {
        let middle = low.midpoint(high);
        self.step = match (middle < high, self.files.get(low)) {
            (true, _) => Step::Half { low, high, slot: 0, blank: false },
            (false, Some(_)) => Step::Chain { file: low, done: 0 },
            (false, None) => Step::Full,
        };
    }

    /// What is to be done next.
    pub fn want(&self) -> Want {
        let Some(volume) = &self.volume else {
            return match self.step {
                Step::Boot(sector) => Want::Read(sector, 1),
                _ => Want::NotPrepared,
            };
        };
        match self.step {
            Step::Boot(sector) => Want::Read(sector, 1),
            Step::Folder { cluster, sector } => {
                let left = volume.cluster_sectors.saturating_sub(sector);
                Want::Read(volume.sector(cluster) + sector, left.min(STAGE_SECTORS))
            }
            Step::FolderNext(cluster) => Want::Read(volume.entry(cluster).0, 1),
            Step::Half { low, high, slot, .. } => match self.files.get(low.midpoint(high)) {
                Some(file) => Want::Read(volume.extent(file).slot(slot), STAGE_SECTORS),
                None => Want::NotPrepared,
            },
            Step::Chain { file, done } => match self.files.get(file) {
                Some(file) => {
                    let (first, _) = volume.entry(file.cluster + done);
                    let (last, _) = volume.entry(file.cluster + volume.clusters_of(file).saturating_sub(1));
                    Want::Read(first, (last.saturating_sub(first) + 1).min(STAGE_SECTORS))
                }
                None => Want::NotPrepared,
            },
            Step::Found(found) => Want::Found(found),
            Step::Full => Want::Full,
            Step::NotPrepared => Want::NotPrepared,
        }
    }

    /// Takes the sectors that were wanted.
    pub fn take(&mut self, bytes: &[u8]) {
        match (self.step, self.volume) {
            (Step::Boot(at), _) => self.boot(bytes, at),
            (Step::Folder { cluster, sector }, Some(volume)) => self.folder(bytes, cluster, sector, &volume),
            (Step::FolderNext(cluster), Some(volume)) => {
                let next = fat::next(bytes, volume.entry(cluster).1).filter(|next| volume.holds(*next));
                match next.filter(|_| self.folder < MOST_FOLDER) {
                    Some(cluster) => self.step = Step::Folder { cluster, sector: 0 },
                    None => self.listed(),
                }
            }
            (Step::Half { low, high, slot, blank }, _) => {
                // Unused: the first slot says so, and the second was never written whole.
                let decoded = Slot::decode(bytes).map(|(slot, _)| slot);
                match (slot, decoded) {
                    (0, Some(first)) if !first.used => {
                        self.step = Step::Half { low, high, slot: 1, blank: true };
                    }
                    (1, None) if blank => self.half(low, low.midpoint(high)),
                    _ => self.half(low.midpoint(high) + 1, high),
                }
            }
            (Step::Chain { file, done }, Some(volume)) => self.chain(bytes, file, done, &volume),
            _ => {}
        }
    }

    fn boot(&mut self, bytes: &[u8], at: u32) {
        self.step = Step::NotPrepared;
        if let Some(volume) = Volume::parse(bytes, at) {
            self.volume = Some(volume);
            self.step = Step::Folder { cluster: volume.root, sector: 0 };
        } else if let Some(first) = fat::partition(bytes).filter(|_| at == 0) {
            self.step = Step::Boot(first);
        }
    }

    fn folder(&mut self, bytes: &[u8], cluster: u32, sector: u32, volume: &Volume) {
        for bytes in bytes.as_chunks().0 {
            match fat::entry(bytes) {
                Entry::Last => return self.listed(),
                Entry::File(file) => self.add(file, volume),
                Entry::Other => {}
            }
        }
        let (read, at) = ((bytes.len() / SECTOR) as u32, sector + (bytes.len() / SECTOR) as u32);
        self.folder += read;
        self.step = if at < volume.cluster_sectors {
            Step::Folder { cluster, sector: at }
        } else {
            Step::FolderNext(cluster)
        };
    }

    /// Puts a file where its number belongs.
    fn add(&mut self, file: File, volume: &Volume) {
        let last = file.cluster.saturating_add(volume.clusters_of(&file).saturating_sub(1));
        let long_enough = (LEAST_PAGES..=MOST_PAGES).contains(&file.pages);
        if long_enough && volume.holds(file.cluster) && volume.holds(last) {
            let at = self.files.iter().rposition(|f| f.number < file.number).map_or(0, |before| before + 1);
            // What finds no room stays unused.
            let _ = self.files.insert(at, file);
        }
    }

    fn listed(&mut self) {
        match self.files.len() {
            0 => self.step = Step::NotPrepared,
            count => self.half(0, count),
        }
    }

    fn chain(&mut self, bytes: &[u8], index: usize, done: u32, volume: &Volume) {
        let Some(file) = self.files.get(index).copied() else { return self.step = Step::NotPrepared };
        let cluster = file.cluster + done;
        let count = volume.clusters_of(&file);
        let (_, from) = volume.entry(cluster);
        let last = file.cluster + count.saturating_sub(1);
        if !fat::runs_on(bytes.get(4 * from..).unwrap_or_default(), cluster, last) {
            // In pieces: passed over.
            return self.half(index + 1, self.files.len());
        }
        let done = done + (bytes.len() / 4).saturating_sub(from) as u32;
        self.step = if done < count && bytes.len() as u32 / 4 <= STAGE_ENTRIES {
            Step::Chain { file: index, done }
        } else {
            Step::Found(Found { number: file.number, extent: volume.extent(&file), sequence: 0 })
        };
    }
}

impl Default for Search {
    fn default() -> Self {
        Self::new()
    }
}
