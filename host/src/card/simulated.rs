//! A card in memory as the recorder's driver shows it: for tests and experiments.

use super::blank::Blank;
use super::medium::Medium;
use anyhow::Result;
use seabearing_firmware::card::{Drive, Progress, SECTOR, Trouble};
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

/// A card's sectors; those that are not there hold zeros.
#[derive(Debug, Clone, Default)]
pub struct Sectors(pub HashMap<u32, [u8; SECTOR]>);

impl Sectors {
    /// A prepared card.
    ///
    /// # Errors
    /// None that a blank card that could be laid out has.
    pub fn of(blank: &Blank) -> Result<Self> {
        let mut sectors = HashMap::new();
        blank.write(|sector, bytes| {
            sectors.insert(sector, *bytes);
            Ok(())
        })?;
        Ok(Self(sectors))
    }

    /// Writes bytes from the beginning of a sector on; what they do not fill of the last one stays.
    pub fn write(&mut self, sector: u32, bytes: &[u8]) {
        for (sector, bytes) in (sector..).zip(bytes.chunks(SECTOR)) {
            let to = self.0.entry(sector).or_insert([0; SECTOR]);
            to.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        }
    }
}

impl Medium for Sectors {
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>> {
        Ok(self.get(sector, count))
    }
}

impl Medium for &Sectors {
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>> {
        Ok(self.get(sector, count))
    }
}

impl Sectors {
    fn get(&self, sector: u32, count: u32) -> Vec<u8> {
        let one = |sector| self.0.get(&sector).copied().unwrap_or([0; SECTOR]);
        (sector..sector.saturating_add(count)).flat_map(one).collect()
    }
}

/// What both ends of a simulated card see.
#[derive(Debug, Default)]
pub struct Holder {
    /// The card.
    pub sectors: Sectors,
    /// Time, µs.
    pub now_us: u64,
    /// When what is under way is done.
    pub done_us: u64,
    /// How long a write takes, µs.
    pub write_us: u64,
    /// The next write takes so much longer.
    pub stall_us: u64,
    /// What there is to be wrong with it.
    pub trouble: Option<Trouble>,
    /// Writes begun: the newest with its sectors.
    pub writes: u64,
    /// The write under way: done at [`Self::done_us`].
    pub under_way: Option<(u32, Vec<u8>)>,
    /// It has failed since it was last started.
    pub failed: bool,
}

impl Holder {
    /// What is due by now is done.
    fn settle(&mut self) {
        if self.now_us >= self.done_us
            && let Some((sector, bytes)) = self.under_way.take()
        {
            self.sectors.write(sector, &bytes);
        }
    }
}

/// The driver of a card in a [`Holder`].
#[derive(Debug, Clone)]
pub struct Simulated(pub Rc<RefCell<Holder>>);

impl Drive for Simulated {
    fn poll(&mut self) -> Progress {
        let mut holder = self.0.borrow_mut();
        if let Some(trouble) = holder.trouble {
            holder.under_way = None;
            holder.failed = true;
            return Progress::Failed(trouble);
        }
        if holder.failed {
            return Progress::Failed(Trouble::Errors);
        }
        holder.settle();
        if holder.now_us < holder.done_us { Progress::Working } else { Progress::Rests }
    }

    fn begin_write(&mut self, sector: u32, bytes: &[u8]) {
        let mut holder = self.0.borrow_mut();
        holder.writes += 1;
        holder.done_us = holder.now_us + holder.write_us + std::mem::take(&mut holder.stall_us);
        holder.under_way = Some((sector, bytes.to_vec()));
    }

    fn begin_read(&mut self, sector: u32, into: &mut [u8]) {
        let mut holder = self.0.borrow_mut();
        holder.done_us = holder.now_us + holder.write_us;
        let bytes = holder.sectors.get(sector, (into.len() / SECTOR) as u32);
        into.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
    }

    fn restart(&mut self) {
        let mut holder = self.0.borrow_mut();
        holder.under_way = None;
        holder.failed = false;
        holder.done_us = holder.now_us + holder.write_us;
    }

    fn now_us(&mut self) -> u64 {
        self.0.borrow().now_us
    }
}
