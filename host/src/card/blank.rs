//! A card prepared for a recorder: a partition of FAT32 with files of one length, each in one piece, with nothing in them.
//!
//! Only what is not zeros is written here; that all else is zeros is up to whoever writes it. FAT32 after Microsoft's
//! specification 1.03.

use super::name;
use anyhow::{Result, bail};
use seabearing_firmware::card::layout::{self, LEAST_PAGES, Label, MOST_PAGES, SLOT_BYTES, Slot};
use seabearing_firmware::card::search::MOST_FILES;
use seabearing_firmware::card::{PAGE_SECTORS, SECTOR};

/// First sector of the partition: 4 MiB, as cards come.
const PARTITION: u32 = 8192;
/// Clusters of a FAT32 are more than this.
const LEAST_CLUSTERS: u32 = 65_600;
/// Entries of the table in a sector.
const ENTRIES: u32 = (SECTOR / 4) as u32;
const END: u32 = 0x0fff_ffff;
/// Clusters 0 and 1 are none.
const FIRST: u32 = 2;

/// A sector.
type Sector = [u8; SECTOR];

/// How a card is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Blank {
    /// Sectors of the card.
    pub sectors: u32,
    /// Files.
    pub files: u32,
    /// Pages of each.
    pub pages: u32,
    /// Samples a second for which they are meant.
    pub rate_hz: u32,
    cluster_sectors: u32,
    reserved: u32,
    table_sectors: u32,
    clusters: u32,
}

impl Blank {
    /// A card of so many sectors with files of so many pages: as many as are given, or as fit.
    ///
    /// # Errors
    /// They do not fit, or no recorder could use them.
    pub fn new(sectors: u32, files: Option<u32>, pages: u32, rate_hz: u32) -> Result<Self> {
        if !(LEAST_PAGES..=MOST_PAGES).contains(&pages) {
            bail!("a file of {pages} pages of 16 KiB: {LEAST_PAGES} to {MOST_PAGES} are possible");
        }
        let inside = sectors.saturating_sub(PARTITION);
        let Some(cluster_sectors) = [64, 32, 16, 8].into_iter().find(|n| inside / n > LEAST_CLUSTERS + 2000)
        else {
            bail!("a card of {} MB is too small for FAT32", u64::from(sectors) * SECTOR as u64 / 1_000_000);
        };
        let table_sectors = (inside / cluster_sectors + FIRST).div_ceil(ENTRIES);
        // Clusters begin where the card's own pages do.
        let reserved =
            32 + (2 * PAGE_SECTORS - (32 + 2 * table_sectors) % (2 * PAGE_SECTORS)) % (2 * PAGE_SECTORS);
        let clusters = (inside - reserved - 2 * table_sectors) / cluster_sectors;
        let mut blank =
            Self { sectors, files: 0, pages, rate_hz, cluster_sectors, reserved, table_sectors, clusters };
        let most = MOST_FILES as u32;
        let fits = (clusters - blank.folder_clusters(most)) / blank.file_clusters();
        blank.files = files.unwrap_or_else(|| fits.min(most));
        if blank.files == 0 || blank.files > fits.min(most) {
            bail!("{} files do not fit: {} of this length do, {most} at most", blank.files, fits.min(most));
        }
        Ok(blank)
    }

    fn folder_clusters(&self, files: u32) -> u32 {
        ((files + 1) * 32).div_ceil(self.cluster_sectors * SECTOR as u32)
    }

    fn file_clusters(&self) -> u32 {
        (self.pages * PAGE_SECTORS).div_ceil(self.cluster_sectors)
    }

    fn first_cluster(&self, file: u32) -> u32 {
        FIRST + self.folder_clusters(self.files) + file * self.file_clusters()
    }

    fn sector_of(&self, cluster: u32) -> u32 {
        PARTITION + self.reserved + 2 * self.table_sectors + (cluster - FIRST) * self.cluster_sectors
    }

    /// The entry of a cluster in the table.
    fn entry(&self, cluster: u32) -> u32 {
        let chain = |first: u32, count: u32| {
            let at = cluster - first;
            if at % count == count - 1 { END } else { cluster + 1 }
        };
        let (files, end) = (self.first_cluster(0), self.first_cluster(self.files));
        match cluster {
            0 => 0x0fff_fff8,
            1 => END,
            _ if cluster < files => chain(FIRST, files - FIRST),
            _ if cluster < end => chain(files, self.file_clusters()),
            _ => 0,
        }
    }

    fn boot(&self) -> Sector {
        let mut boot = [0; SECTOR];
        put(&mut boot, 0, &[0xeb, 0x58, 0x90]);
        put(&mut boot, 3, b"SEABEAR ");
        put(&mut boot, 11, &(SECTOR as u16).to_le_bytes());
        put(&mut boot, 13, &[self.cluster_sectors as u8]);
        put(&mut boot, 14, &(self.reserved as u16).to_le_bytes());
        put(&mut boot, 16, &[2]);
        put(&mut boot, 21, &[0xf8]);
        put(&mut boot, 24, &63u16.to_le_bytes());
        put(&mut boot, 26, &255u16.to_le_bytes());
        put(&mut boot, 28, &PARTITION.to_le_bytes());
        put(&mut boot, 32, &(self.sectors - PARTITION).to_le_bytes());
        put(&mut boot, 36, &self.table_sectors.to_le_bytes());
        put(&mut boot, 44, &FIRST.to_le_bytes());
        put(&mut boot, 48, &1u16.to_le_bytes());
        put(&mut boot, 50, &6u16.to_le_bytes());
        put(&mut boot, 64, &[0x80, 0, 0x29]);
        put(&mut boot, 67, &self.sectors.to_le_bytes());
        put(&mut boot, 71, b"SEABEARING FAT32   ");
        put(&mut boot, 510, &[0x55, 0xaa]);
        boot
    }

    fn information(&self) -> Sector {
        let used = self.first_cluster(self.files);
        let mut information = [0; SECTOR];
        put(&mut information, 0, b"RRaA");
        put(&mut information, 484, b"rrAa");
        put(&mut information, 488, &(self.clusters + FIRST - used).to_le_bytes());
        put(&mut information, 492, &used.to_le_bytes());
        put(&mut information, 510, &[0x55, 0xaa]);
        information
    }

    fn partitions(&self) -> Sector {
        let mut table = [0; SECTOR];
        put(&mut table, 446, &[0, 0xfe, 0xff, 0xff, 0x0c, 0xfe, 0xff, 0xff]);
        put(&mut table, 454, &PARTITION.to_le_bytes());
        put(&mut table, 458, &(self.sectors - PARTITION).to_le_bytes());
        put(&mut table, 510, &[0x55, 0xaa]);
        table
    }

    fn folder_entry(&self, n: u32) -> [u8; 32] {
        let mut entry = [0; 32];
        // 1 January 2026.
        const DATE: u16 = 46 << 9 | 1 << 5 | 1;
        for at in [16, 18, 24] {
            put(&mut entry, at, &DATE.to_le_bytes());
        }
        if n == 0 {
            put(&mut entry, 0, b"SEABEARING ");
            put(&mut entry, 11, &[8]);
        } else {
            let [low, high] = [self.first_cluster(n - 1) as u16, (self.first_cluster(n - 1) >> 16) as u16];
            put(&mut entry, 0, name(n).replace('.', "").as_bytes());
            put(&mut entry, 11, &[0x20]);
            put(&mut entry, 20, &high.to_le_bytes());
            put(&mut entry, 26, &low.to_le_bytes());
            put(&mut entry, 28, &(self.pages * PAGE_SECTORS * SECTOR as u32).to_le_bytes());
        }
        entry
    }

    /// Every sector that is not zeros, in no order.
    ///
    /// # Errors
    /// Those of `write`.
    pub fn write(&self, mut write: impl FnMut(u32, &Sector) -> Result<()>) -> Result<()> {
        write(0, &self.partitions())?;
        let mut end = [0; SECTOR];
        put(&mut end, 510, &[0x55, 0xaa]);
        for copy in [PARTITION, PARTITION + 6] {
            write(copy, &self.boot())?;
            write(copy + 1, &self.information())?;
            write(copy + 2, &end)?;
        }
        for n in 0..self.first_cluster(self.files).div_ceil(ENTRIES) {
            let mut sector = [0; SECTOR];
            for (entry, cluster) in sector.as_chunks_mut::<4>().0.iter_mut().zip(n * ENTRIES..) {
                *entry = self.entry(cluster).to_le_bytes();
            }
            for table in [0, self.table_sectors] {
                write(PARTITION + self.reserved + table + n, &sector)?;
            }
        }
        for n in 0..((self.files + 1) * 32).div_ceil(SECTOR as u32) {
            let mut sector = [0; SECTOR];
            for (entry, of) in sector.as_chunks_mut::<32>().0.iter_mut().zip(16 * n..=self.files) {
                *entry = self.folder_entry(of);
            }
            write(self.sector_of(FIRST) + n, &sector)?;
        }
        for file in 0..self.files {
            let first = self.sector_of(self.first_cluster(file));
            let [(head_at, head), (slot_at, slot)] = unused(file + 1, self.pages, self.rate_hz);
            write(first + head_at, &head)?;
            write(first + slot_at, &slot)?;
        }
        Ok(())
    }
}

/// The two sectors of an unused file that are not zeros, with their places in it.
pub fn unused(number: u32, pages: u32, rate_hz: u32) -> [(u32, Sector); 2] {
    let label = Label { file: number, rate_hz, ..Label::default() };
    let (mut head, mut slot) = ([0; SECTOR], [0; SLOT_BYTES]);
    layout::head(&label, 0, &mut head);
    Slot { label, ..Slot::default() }.encode(&[], &mut slot);
    let mut first = [0; SECTOR];
    put(&mut first, 0, slot.get(..SECTOR).unwrap_or_default());
    [(0, head), (layout::Extent { first: 0, pages }.slot(0), first)]
}

fn put(to: &mut [u8], at: usize, bytes: &[u8]) {
    for (to, from) in to.iter_mut().skip(at).zip(bytes) {
        *to = *from;
    }
}
