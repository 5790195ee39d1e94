//! Memories: regions of bytes by address.

/// What kind of memory a region is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Tightly coupled to the core; out of reach of most DMA controllers.
    TightlyCoupled,
    /// On the AXI bus.
    Axi,
    /// On a slower bus.
    Sram,
    /// Flash: not written by stores.
    Flash,
}

/// Granule of the map from addresses to regions.
const GRANULE_BITS: u32 = 23;
/// Most regions, the empty one included.
const REGIONS: usize = 16;

/// A stretch of memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Region {
    base: u32,
    size: u32,
    start: usize,
    kind: Kind,
    /// Ticks of an access.
    pub(crate) cost: u64,
    /// Stores need a closer look: code is cached there, or it is flash.
    guarded: bool,
    /// Its last write may be lost at a reset.
    holds: bool,
}

const NONE: Region =
    Region { base: 0, size: 0, start: 0, kind: Kind::Sram, cost: 0, guarded: true, holds: false };

/// A write that an error-correcting memory has not carried out yet.
#[derive(Clone, Copy, Debug)]
struct Held {
    at: usize,
    before: [u8; 8],
}

/// All memories of a board.
#[derive(Debug)]
pub struct Memory {
    bytes: Vec<u8>,
    map: Vec<u8>,
    regions: [Region; REGIONS],
    count: usize,
    held: Option<Held>,
    /// While the data cache is on: what memory protection keeps out of it (start and length).
    uncached: Option<Vec<(u32, u64)>>,
}

impl Default for Memory {
    fn default() -> Self {
        Self {
            bytes: Vec::new(),
            map: vec![0; 1 << (32 - GRANULE_BITS)],
            regions: [NONE; REGIONS],
            count: 1,
            held: None,
            uncached: None,
        }
    }
}

impl Memory {
    /// Adds a region full of `fill`. Regions lie in granules of 8 MB of their own.
    pub fn add(&mut self, base: u32, size: u32, kind: Kind, fill: u8) {
        let (start, guarded) = (self.bytes.len(), kind == Kind::Flash);
        let region = Region { base, size, start, kind, cost: 0, guarded, holds: false };
        self.regions[self.count] = region;
        for granule in (base >> GRANULE_BITS)..=(base + (size - 1)) >> GRANULE_BITS {
            self.map[granule as usize] = self.count as u8;
        }
        self.count += 1;
        self.bytes.resize(self.bytes.len() + size as usize, fill);
    }

    /// The last write of less than 64 bits to AXI SRAM is lost at a reset, as the manual warns of its error correction.
    pub fn hold_writes(&mut self) {
        for region in &mut self.regions {
            region.holds |= region.kind == Kind::Axi;
        }
    }

    /// What a reset does to memories: nothing, but for a write held back.
    pub fn reset(&mut self) {
        if let Some(Held { at, before }) = self.held.take() {
            self.bytes[at..at + 8].copy_from_slice(&before);
        }
    }

    /// What a loss of power does to them: everything but flash holds `fill`.
    pub fn lose_power(&mut self, fill: u8) {
        self.held = None;
        for region in self.regions.iter().take(self.count).filter(|r| r.size > 0 && r.kind != Kind::Flash) {
            self.bytes[region.start..region.start + region.size as usize].fill(fill);
        }
    }

    /// What is kept out of the data cache; `None` while it is off.
    pub(crate) fn set_uncached(&mut self, uncached: Option<Vec<(u32, u64)>>) {
        self.uncached = uncached;
    }

    /// Whether the core may hold a byte in its data cache, so that DMA and the core disagree about it.
    pub fn may_be_cached(&self, address: u32) -> bool {
        let inside = |&(base, length): &(u32, u64)| u64::from(address.wrapping_sub(base)) < length;
        let tight = matches!(self.extent(address), Some((_, _, Kind::TightlyCoupled)));
        !tight && self.uncached.as_ref().is_some_and(|plain| !plain.iter().any(inside))
    }

    /// Sets the cost of accesses by kind.
    pub(crate) fn set_costs(&mut self, cost: impl Fn(Kind) -> u64) {
        for region in &mut self.regions {
            region.cost = cost(region.kind);
        }
    }

    /// Marks the region of an address as one whose stores change cached code.
    pub(crate) fn guard(&mut self, address: u32) {
        let index = usize::from(self.map[(address >> GRANULE_BITS) as usize]);
        self.regions[index].guarded = true;
    }

    #[inline(always)]
    pub(crate) fn region(&self, address: u32) -> &Region {
        &self.regions[usize::from(self.map[(address >> GRANULE_BITS) as usize]) & (REGIONS - 1)]
    }

    #[inline(always)]
    fn place(&self, region: &Region, address: u32, size: u32) -> Option<usize> {
        let offset = address.wrapping_sub(region.base);
        (offset < region.size && region.size - offset >= size).then_some(region.start + offset as usize)
    }

    /// Start, length and kind of the memory at an address.
    pub fn extent(&self, address: u32) -> Option<(u32, u32, Kind)> {
        let region = self.region(address);
        self.place(region, address, 1).map(|_| (region.base, region.size, region.kind))
    }

    /// A value of `N` bytes and the cost of its load.
    #[inline(always)]
    pub(crate) fn load<const N: usize>(&self, address: u32) -> Option<([u8; N], u64)> {
        let region = self.region(address);
        let at = self.place(region, address, N as u32)?;
        Some((self.bytes.get(at..at + N)?.try_into().ok()?, region.cost))
    }

    /// Stores a value of `N` bytes where that is plain; the cost. `None` wants a closer look.
    #[inline(always)]
    pub(crate) fn store<const N: usize>(&mut self, address: u32, value: [u8; N]) -> Option<u64> {
        let region = self.region(address);
        if region.guarded {
            return None;
        }
        let (at, cost, holds) = (self.place(region, address, N as u32)?, region.cost, region.holds);
        if holds {
            self.hold(at);
        }
        self.bytes.get_mut(at..at + N)?.copy_from_slice(&value);
        Some(cost)
    }

    /// Remembers what stood where the next write goes.
    #[inline(always)]
    fn hold(&mut self, at: usize) {
        let word = at & !7;
        if self.held.is_none_or(|held| held.at != word)
            && let Some(before) = self.bytes.get(word..word + 8).and_then(|b| b.try_into().ok())
        {
            self.held = Some(Held { at: word, before });
        }
    }

    /// A store that wants a closer look; the cost, or `None` where there is no memory to write.
    pub(crate) fn store_guarded(&mut self, address: u32, value: &[u8]) -> Option<u64> {
        let region = *self.region(address);
        let at = self.place(&region, address, value.len() as u32)?;
        if region.kind == Kind::Flash {
            return None;
        }
        if region.holds {
            self.hold(at);
        }
        self.bytes[at..at + value.len()].copy_from_slice(value);
        Some(region.cost)
    }

    /// Bytes from an address on, as many as are wanted, all in one region.
    pub fn bytes(&self, address: u32, length: u32) -> Option<&[u8]> {
        let at = self.place(self.region(address), address, length)?;
        self.bytes.get(at..at + length as usize)
    }

    /// Bytes to be changed, flash included: what loaders, DMA and flash programming do.
    pub fn bytes_mut(&mut self, address: u32, length: u32) -> Option<&mut [u8]> {
        let at = self.place(self.region(address), address, length)?;
        self.bytes.get_mut(at..at + length as usize)
    }
}
