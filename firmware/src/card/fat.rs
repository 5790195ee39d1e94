//! What must be known of a FAT32 file system to find files, and nothing that would change it.
//!
//! The maintained readers wait for every sector; here sectors are asked for one turn of the loop after the other
//! ([`super::search`]), so this is only what the bytes mean (Microsoft, FAT32 File System Specification 1.03).

use super::layout::{Extent, u16_at, u32_at};
use super::{PAGE, PAGE_SECTORS, SECTOR};

/// First cluster number of a file.
const FIRST_CLUSTER: u32 = 2;
/// Bits of an entry of the table that count.
const ENTRY: u32 = 0x0fff_ffff;
/// Entries from here on end a chain.
const END: u32 = 0x0fff_fff8;
/// Bytes of an entry of a folder.
pub const ENTRY_BYTES: usize = 32;

/// Where a partition of FAT32 begins, if this is a table of partitions.
pub fn partition(sector: &[u8]) -> Option<u32> {
    const TABLE: usize = 446;
    const FAT32: [u8; 2] = [0x0b, 0x0c];
    if u16_at(sector, SECTOR - 2) != Some(0xaa55) {
        return None;
    }
    let kind = sector.get(TABLE + 4)?;
    FAT32.contains(kind).then(|| u32_at(sector, TABLE + 8)).flatten().filter(|first| *first > 0)
}

/// A FAT32 file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Volume {
    /// Sector of the first table.
    pub table: u32,
    /// Sector of the first cluster.
    data: u32,
    /// Sectors of a cluster, and how many clusters there are.
    pub cluster_sectors: u32,
    clusters: u32,
    /// First cluster of the root folder.
    pub root: u32,
}

impl Volume {
    /// Reads a boot sector that stands at sector `first`; `None` where it is no FAT32's.
    pub fn parse(sector: &[u8], first: u32) -> Option<Self> {
        let byte = |at: usize| sector.get(at).copied();
        let [reserved, entries, old_size] = [u16_at(sector, 14)?, u16_at(sector, 17)?, u16_at(sector, 22)?];
        let (tables, cluster_sectors) = (u32::from(byte(16)?), u32::from(byte(13)?));
        let (all, size, root) = (u32_at(sector, 32)?, u32_at(sector, 36)?, u32_at(sector, 44)?);
        let fat32 = u16_at(sector, SECTOR - 2)? == 0xaa55
            && usize::from(u16_at(sector, 11)?) == SECTOR
            && cluster_sectors.is_power_of_two()
            && (1..=2).contains(&tables)
            && (entries, old_size) == (0, 0)
            && reserved > 0;
        let before = u32::from(reserved).checked_add(tables.checked_mul(size)?)?;
        let clusters = all.checked_sub(before)?.checked_div(cluster_sectors)?;
        let named = u64::from(size) * (SECTOR as u64 / 4) >= u64::from(clusters) + 2;
        first.checked_add(all)?;
        let (table, data) = (first + u32::from(reserved), first + before);
        let volume = Self { table, data, cluster_sectors, clusters, root };
        (fat32 && named && clusters > 65_524 && volume.holds(root)).then_some(volume)
    }

    /// Whether there is such a cluster.
    pub fn holds(&self, cluster: u32) -> bool {
        cluster.wrapping_sub(FIRST_CLUSTER) < self.clusters
    }

    /// First sector of a cluster that there is.
    pub fn sector(&self, cluster: u32) -> u32 {
        self.data + cluster.saturating_sub(FIRST_CLUSTER) * self.cluster_sectors
    }

    /// The sector of the table in which a cluster's entry stands, and the entry's place in it.
    pub fn entry(&self, cluster: u32) -> (u32, usize) {
        const IN_SECTOR: u32 = (SECTOR / 4) as u32;
        (self.table + cluster / IN_SECTOR, (cluster % IN_SECTOR) as usize)
    }

    /// A file's extent, if it is in one piece.
    pub fn extent(&self, file: &File) -> Extent {
        Extent { first: self.sector(file.cluster), pages: file.pages }
    }

    /// Clusters of a file.
    pub fn clusters_of(&self, file: &File) -> u32 {
        (file.pages * PAGE_SECTORS).div_ceil(self.cluster_sectors)
    }
}

/// Whether entries of the table, the first of them that of `cluster`, go on without a break; `last`: the file's last cluster.
pub fn runs_on(entries: &[u8], cluster: u32, last: u32) -> bool {
    let entries = entries.as_chunks::<4>().0.iter().map(|entry| u32::from_le_bytes(*entry) & ENTRY);
    (cluster..=last).zip(entries).all(|(n, entry)| if n == last { entry >= END } else { entry == n + 1 })
}

/// The cluster after this one of a chain, from its entry.
pub fn next(sector: &[u8], entry: usize) -> Option<u32> {
    u32_at(sector, 4 * entry).map(|entry| entry & ENTRY).filter(|entry| *entry < END)
}

/// A file of the card by its name: `SB000001.WAV`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct File {
    /// Number in the name, from 1.
    pub number: u32,
    /// First cluster.
    pub cluster: u32,
    /// Whole pages.
    pub pages: u32,
}

/// What an entry of a folder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// No more follow.
    Last,
    /// Nothing of ours.
    Other,
    /// A file of the card's.
    File(File),
}

/// Reads an entry of a folder.
pub fn entry(bytes: &[u8; ENTRY_BYTES]) -> Entry {
    /// A folder, or the volume's name.
    const NO_FILE: u8 = 0x18;
    let [first, ..] = bytes;
    if *first == 0 {
        return Entry::Last;
    }
    ours(bytes)
        .filter(|_| bytes.get(11).is_some_and(|kind| kind & NO_FILE == 0))
        .map_or(Entry::Other, Entry::File)
}

fn ours(bytes: &[u8]) -> Option<File> {
    let (name, extension) = (bytes.get(..8)?, bytes.get(8..11)?);
    let digits = name.strip_prefix(b"SB").filter(|_| extension == b"WAV")?;
    let number = digits
        .iter()
        .try_fold(0u32, |n, digit| digit.is_ascii_digit().then(|| 10 * n + u32::from(digit - b'0')))?;
    let cluster = u32::from(u16_at(bytes, 20)?) << 16 | u32::from(u16_at(bytes, 26)?);
    Some(File { number, cluster, pages: u32_at(bytes, 28)? / PAGE as u32 }).filter(|_| number > 0)
}
