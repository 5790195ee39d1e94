//! A recorder that no base station has heard for so long that its store in flash is full: how long it takes to start, and that it
//! loses nothing as it gives up a sector of what was there.

use super::{COST, LEAST_IDLE, Row, Stage, costs};
use crate::board::{BoardRun, Setup};
use anyhow::{Context, Result, ensure};
use seabearing_core::wire::link::flash::{Flash, FlashStore, WORD_BYTES, Word};
use seabearing_core::wire::link::{Class, RECORD_BYTES, Store};
use seabearing_core::wire::{Fault, FaultCode, Message, bytes_of};
use seabearing_firmware::bank::SECTOR_WORDS;

/// Sectors of the store, and those before it (`firmware/src/stm32h743/kept.rs`).
const SECTORS: u8 = 6;
const BEFORE: u8 = 2;
/// Words from a sector's end at which what follows may open the next.
const END: u16 = 64;
/// Longest start, s: the watchdog resets a board that hangs for so long.
const LONGEST_START_S: f64 = 2.0;
/// The boot whose records the store has.
const EARLIER: u32 = 1;
/// Sound recorded, s: longer than a sector's erasing.
const SECONDS: f64 = 4.0;

/// A flash of the store's size that takes no time.
struct Words {
    words: Vec<Word>,
    erased: u32,
    /// Where the last was written: sector, word.
    last: (u8, u16),
}

impl Words {
    fn at(sector: u8, word: u16) -> usize {
        usize::from(sector) * usize::from(SECTOR_WORDS) + usize::from(word)
    }
}

impl Flash for Words {
    const SECTORS: u8 = SECTORS;
    const WORDS: u16 = SECTOR_WORDS;

    fn read(&self, sector: u8, word: u16) -> Option<Word> {
        self.words.get(Self::at(sector, word)).copied()
    }

    fn write(&mut self, sector: u8, word: u16, value: &Word) {
        self.words[Self::at(sector, word)] = *value;
        self.last = (sector, word);
    }

    fn erase(&mut self, sector: u8) {
        let from = Self::at(sector, 0);
        self.words[from..from + usize::from(SECTOR_WORDS)].fill([0xff; WORD_BYTES]);
        self.erased += 1;
    }

    fn busy(&self) -> bool {
        false
    }
}

/// The second bank with a store that was gone round twice, faults and bearings by turns, of which nothing was acknowledged, and of
/// which the next record gives up a sector; and the number of the bank's word that was written last.
fn full() -> Result<(Vec<u8>, usize)> {
    let blank = vec![[0xff; WORD_BYTES]; usize::from(SECTORS) * usize::from(SECTOR_WORDS)];
    let mut flash = Words { words: blank, erased: 0, last: (0, 0) };
    let mut buffer = [0; RECORD_BYTES];
    let mut n = 0u32;
    loop {
        // Opened anew each time, as by so many starts.
        let mut store: FlashStore<Words, 64> = FlashStore::open(flash);
        if n == 0 {
            store.begin(EARLIER);
        }
        let begun = n;
        let mut before: Option<(Vec<Word>, u8, u16)> = None;
        while n < begun + 1000 {
            n += 1;
            let fault = Fault { code: FaultCode::Gap, index: u64::from(n) * 64_000, value: i64::from(n) };
            let class = if n.is_multiple_of(2) { Class::Alarm } else { Class::Bearing };
            let record = bytes_of(&Message::Fault(fault), &mut buffer);
            ensure!(store.append(class, EARLIER, record), "no room for record {n}");
            (0..8).for_each(|_| store.work());
            let Words { words, erased, last: (sector, word) } = store.flash();
            match before {
                Some((words, was, word)) if was != *sector => {
                    let mut bank = vec![0xff; usize::from(BEFORE) * usize::from(SECTOR_WORDS) * WORD_BYTES];
                    bank.extend(words.as_flattened());
                    return Ok((bank, Words::at(was + BEFORE, word)));
                }
                _ if *erased > 3 * u32::from(SECTORS) && SECTOR_WORDS - word < END => {
                    before = Some((words.clone(), *sector, *word));
                }
                _ => {}
            }
        }
        flash = store.into_flash();
    }
}

impl Stage<'_> {
    /// Starts with a full store, whole and with an unreadable sector.
    pub(super) fn full_store(&self) -> Result<Vec<Row>> {
        let (bank_two, last) = full()?;
        let sector = last / usize::from(SECTOR_WORDS) * usize::from(SECTOR_WORDS);
        let empty = self.start_of(&Setup::default(), "an empty store")?;
        let whole = Setup { bank_two: bank_two.clone(), ..Setup::default() };
        // Every other word of the sector that is written, but for its head.
        let unreadable = (sector + 8..last).step_by(2).collect();
        let holes = Setup { bank_two, unreadable, ..Setup::default() };
        let cases = [("full", whole), ("full, half of the sector written cannot be read", holes)];
        cases.into_iter().map(|(name, setup)| self.start_with(name, &setup, empty.0)).collect()
    }

    /// A run with the store, and when its first conversion was read, s.
    fn start_of(&self, setup: &Setup, name: &str) -> Result<(f64, BoardRun)> {
        let setup = Setup { costs: costs(COST.0), link: true, ..setup.clone() };
        let report = self.play(SECONDS, &setup)?;
        let first_s = report.numbers.first().and_then(|n| report.moments_s.get(*n as usize));
        let first_s = *first_s.with_context(|| format!("with {name} no conversion was read"))?;
        Ok((first_s, report))
    }

    /// Nothing is lost, one sector is given up, and what was there before comes out.
    fn start_with(&self, name: &str, setup: &Setup, empty_s: f64) -> Result<Row> {
        let (first_s, report) = self.start_of(setup, name)?;
        let whole = report.lost == 0 && report.delivered == report.converted && report.resets == 0;
        let earlier = report.said.iter().filter(|said| said.boot == EARLIER).count();
        let (_, erased) = report.flash;
        Ok(Row {
            case: format!("store: {name}"),
            told: String::new(),
            outcome: format!(
                "starts {:.2} s later than an empty one; {} of {} lost; sectors erased: {erased}; asleep {:.0} %",
                first_s - empty_s,
                report.lost,
                report.converted,
                report.idle * 100.0
            ),
            right: whole
                && report.idle >= LEAST_IDLE
                && (erased, earlier > 0) == (1, true)
                && (empty_s..LONGEST_START_S).contains(&first_s),
        })
    }
}
