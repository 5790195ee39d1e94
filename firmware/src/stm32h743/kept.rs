//! The second bank of flash: two places for the configuration, and the link whose records wait there until the base station has
//! them.

use super::flash::BankTwo;
use crate::bank::{Bank, Part, Ring};
use core::mem::MaybeUninit;
use embassy_stm32::Peri;
use embassy_stm32::peripherals::FLASH;
use seabearing_core::outlet::{Outlet as _, Reliable};
use seabearing_core::port::{self, Clock, Supervisor};
use seabearing_core::slots::{self, Slots};
use seabearing_core::snippet::MOST_CODES;
use seabearing_core::wire::guard::{Guard, Recipient};
use seabearing_core::wire::link::flash::FlashStore;
use seabearing_core::wire::link::{Link, Settings};

/// Sectors of the bank before the records': the configurations'.
pub const RECORDS_FIRST: u8 = 2;
/// Sectors of records.
pub const RECORDS_SECTORS: u8 = 6;
/// Records that wait while a sector is erased: two seconds of 20 bearings and their tracks.
const WAITING: usize = 64;
/// Longest wait at the end of the software for what is not in flash yet, s: the erasure of a sector, and more.
const SETTLE_S: u32 = 5;

/// Where the records are.
pub type Records = FlashStore<Part<'static, BankTwo, RECORDS_FIRST, RECORDS_SECTORS>, WAITING>;

/// Longest configuration that can be replaced, bytes.
pub const BLOB_BYTES: usize = slots::LONGEST[if cfg!(feature = "seismic") { 1 } else { 0 }];
#[cfg(feature = "seismic")]
const _: () = {
    use seabearing_core::obs::table::{MAX_BRANCHES, blob_bytes};
    /// The station's own section, its levels, and heads of sections: a few hundred bytes.
    const WITHOUT_TABLE: usize = 2048;
    assert!(blob_bytes(MAX_BRANCHES) + WITHOUT_TABLE <= BLOB_BYTES, "the largest table fits");
};

/// Where the configurations are.
pub type Configurations = Slots<Part<'static, BankTwo, 0, RECORDS_FIRST>, fn(&[u8]) -> bool>;
/// The way out of the recorder's loop.
pub type Outlet<L> = Reliable<'static, L, &'static mut Records, Configurations>;

/// Memory of all this: all zeros before [`Memory::open`].
pub struct Memory {
    ring: Ring,
    bank: MaybeUninit<Bank<BankTwo>>,
    store: MaybeUninit<Records>,
    link: MaybeUninit<Link<&'static mut Records>>,
    blob: [u8; BLOB_BYTES],
    scratch: [u8; BLOB_BYTES],
    snippet: [i32; MOST_CODES],
}

/// The bank, and the configuration that was found in it.
pub struct Opened {
    bank: &'static Bank<BankTwo>,
    store: &'static mut MaybeUninit<Records>,
    link: &'static mut MaybeUninit<Link<&'static mut Records>>,
    slots: Configurations,
    snippet: &'static mut [i32],
    blob: Option<&'static [u8]>,
}

impl Memory {
    /// Nothing yet.
    pub const fn new() -> Self {
        Self {
            ring: Ring::new(),
            bank: MaybeUninit::uninit(),
            store: MaybeUninit::uninit(),
            link: MaybeUninit::uninit(),
            blob: [0; BLOB_BYTES],
            scratch: [0; BLOB_BYTES],
            snippet: [0; MOST_CODES],
        }
    }

    /// Looks what configuration to run with; `usable` says of a new one whether it could be run here.
    pub fn open(
        &'static mut self,
        flash: Peri<'static, FLASH>,
        mpu: &mut cortex_m::peripheral::MPU,
        usable: fn(&[u8]) -> bool,
    ) -> Opened {
        let bank: &'static _ = self.bank.write(Bank::new(BankTwo::new(flash, mpu), &mut self.ring));
        let mut slots = Slots::new(Part::of(bank), &mut self.scratch, usable);
        let found = slots.choose(&mut self.blob);
        let blob: &'static [u8] = &self.blob;
        let blob = found.and_then(|found| blob.get(..found.length));
        Opened { bank, store: &mut self.store, link: &mut self.link, slots, snippet: &mut self.snippet, blob }
    }
}

impl Opened {
    /// The configuration, where there is another than what was built in.
    pub fn blob(&self) -> Option<&'static [u8]> {
        self.blob
    }

    /// Opens the store and, over a serial line of `baud` bits a second, the link of a station with this configuration. Commands
    /// must be signed with the key, where there is one. The supervisor is fed meanwhile: a full store takes long to look through.
    pub fn over<L: port::Link>(
        self,
        line: &'static mut L,
        baud: u32,
        (station, config_hash): (u16, u64),
        key: &[u8],
        supervisor: &mut impl Supervisor,
    ) -> Outlet<L> {
        let store = open_store(self.store, Part::of(self.bank), || supervisor.feed());
        let boot = store.starts();
        let link = self.link.write(Link::new(Settings::serial(baud), station, boot, config_hash, store));
        let keyed = |key: &[u8; 32]| Guard::keyed(*key, Recipient { station, boot });
        let guard = key.first_chunk().map_or(Guard::open(), keyed);
        Reliable::with(line, link, guard, self.slots).with_snippets(self.snippet)
    }
}

/// Opens the store where it is to stay.
// Apart: it passes over the stack, which must not stay taken while samples are worked on.
#[inline(never)]
fn open_store(
    place: &'static mut MaybeUninit<Records>,
    flash: Part<'static, BankTwo, RECORDS_FIRST, RECORDS_SECTORS>,
    alive: impl FnMut(),
) -> &'static mut Records {
    FlashStore::open_in(place, flash, alive)
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

/// Waits until everything said is in flash.
pub fn settle<L: port::Link>(
    outlet: &mut Outlet<L>,
    clock: &mut impl Clock,
    supervisor: &mut impl Supervisor,
) {
    let begun_s = clock.seconds();
    while !outlet.link().store().rests() && clock.seconds().wrapping_sub(begun_s) < SETTLE_S {
        supervisor.feed();
        outlet.work(clock);
    }
}
