//! The link whose records wait in the second bank of flash until the base station has them.

use super::flash::BankTwo;
use crate::bank::{Bank, Part, Ring};
use core::mem::MaybeUninit;
use embassy_stm32::Peri;
use embassy_stm32::peripherals::FLASH;
use seabearing_core::outlet::{Outlet, Reliable};
use seabearing_core::port::{self, Clock, Supervisor};
use seabearing_core::wire::guard::{Guard, Recipient};
use seabearing_core::wire::link::flash::FlashStore;
use seabearing_core::wire::link::{Link, Settings};

/// Sectors of the bank before the records'.
pub const RECORDS_FIRST: u8 = 2;
/// Sectors of records.
pub const RECORDS_SECTORS: u8 = 6;
/// Records that wait while a sector is erased: two seconds of 20 bearings and their tracks.
const WAITING: usize = 64;
/// Longest wait at the end of the software for what is not in flash yet, s: the erasure of a sector, and more.
const SETTLE_S: u32 = 5;

/// Where the records are.
pub type Records = FlashStore<Part<'static, BankTwo, RECORDS_FIRST, RECORDS_SECTORS>, WAITING>;

/// Memory of all this: all zeros before [`Memory::open`].
pub struct Memory {
    ring: Ring,
    bank: MaybeUninit<Bank<BankTwo>>,
    link: MaybeUninit<Link<Records>>,
}

impl Memory {
    /// Nothing yet.
    pub const fn new() -> Self {
        Self { ring: Ring::new(), bank: MaybeUninit::uninit(), link: MaybeUninit::uninit() }
    }

    /// Opens the store and, over a serial line of `baud` bits a second, the link of a station with this configuration. Commands
    /// must be signed with the key, where there is one.
    pub fn open<L: port::Link>(
        &'static mut self,
        flash: Peri<'static, FLASH>,
        mpu: &mut cortex_m::peripheral::MPU,
        line: &'static mut L,
        baud: u32,
        (station, config_hash): (u16, u64),
        key: &[u8],
    ) -> Reliable<'static, L, Records> {
        let bank: &'static _ = self.bank.write(Bank::new(BankTwo::new(flash, mpu), &mut self.ring));
        let store = FlashStore::open(Part::of(bank));
        let boot = store.starts();
        let link = self.link.write(Link::new(Settings::serial(baud), station, boot, config_hash, store));
        let keyed = |key: &[u8; 32]| Guard::keyed(*key, Recipient { station, boot });
        Reliable::new(line, link, key.first_chunk().map_or(Guard::open(), keyed))
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

/// Waits until everything said is in flash.
pub fn settle<L: port::Link>(
    outlet: &mut Reliable<'static, L, Records>,
    clock: &mut impl Clock,
    supervisor: &mut impl Supervisor,
) {
    let begun_s = clock.seconds();
    while !outlet.link().store().rests() && clock.seconds().wrapping_sub(begun_s) < SETTLE_S {
        supervisor.feed();
        outlet.work(clock);
    }
}
