//! Power cut at every write of a recorder of sound to its card: before, in the midst and after.

use super::{Experiment, Options};
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::config;
use seabearing_firmware::card::clips::Clips;
use seabearing_firmware::card::layout::Extent;
use seabearing_firmware::card::search::STAGE_BYTES;
use seabearing_firmware::card::writer::{About, Tables, Writer};
use seabearing_firmware::card::{PAGE, PAGE_SECTORS, SECTOR};
use seabearing_host::card::blank::Blank;
use seabearing_host::card::extents;
use seabearing_host::card::kept::{self, Kept};
use seabearing_host::card::medium::{Medium, Part};
use seabearing_host::card::simulated::{Holder, Sectors, Simulated};
use std::cell::RefCell;
use std::rc::Rc;

/// `seabearing reproduce card-cuts`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "card-cuts",
    about: "power is cut at every write of sound to a card, before, in the midst and after, of all sound and of clips; --runs: minutes of sound at \
            64 kHz, 120 asked for",
    run,
};

const MINUTES: usize = 10;
const RATE_HZ: u32 = 64_000;
/// Instants of a step of 1 ms.
const STEP: u64 = 64;
/// The board's ring.
const RING: usize = 25;
/// Pages of a file: a minute and a half; of one of clips 5 s.
const PAGES: u32 = 4096;
const CLIP_PAGES: u32 = 256;
/// Files for clips: enough for those of ten minutes, and few enough to be filled again and again.
const CLIP_FILES: u32 = 100;
/// Clips of two seconds, two in a minute; one detection in so many steps.
const CLIPS: config::Clips = config::Clips { before_s: 1, after_s: 1, apart_s: 30 };
const DETECTION: u64 = 5000;
/// Instants of a file that is filled again which may be gone: what was not told yet.
const UNTOLD: u64 = 2 * RATE_HZ as u64 + RING as u64 * PAGE as u64 / 12;
/// How long a write takes, µs; every so many steps, more or less, the card is slow for up to so long.
const WRITE_US: u64 = 2500;
const SLOW: (u64, u64) = (4000, 500_000);
/// One in so many steps brings a gap, or damaged instants.
const WANTING: u64 = 3000;
/// A sector is torn at whole words: within the word of a length a strict reader may refuse what it then says.
const WORD: usize = 4;
/// Instants that are read from the end on at each cut.
const LOOKED_AT: u32 = 32;

/// The codes of a sample: nothing else has them.
fn codes(index: u64) -> Frame {
    let mut x = index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    [0, 16, 32, 40].map(|shift| ((x >> shift) as i32 & 0x7f_ffff | 1) - 0x40_0000)
}

/// A card of whose newest write only so many bytes came through.
struct Torn<'a> {
    card: &'a Sectors,
    sector: u32,
    bytes: &'a [u8],
}

impl Medium for Torn<'_> {
    fn read(&mut self, sector: u32, count: u32) -> Result<Vec<u8>> {
        let mut card = self.card;
        let mut read = card.read(sector, count)?;
        let (from, to) = (sector as usize * SECTOR, self.sector as usize * SECTOR);
        for (n, byte) in self.bytes.iter().enumerate() {
            if let Some(place) = (to + n).checked_sub(from).and_then(|at| read.get_mut(at)) {
                *place = *byte;
            }
        }
        Ok(read)
    }
}

/// What came of the cuts.
#[derive(Default)]
struct Outcome {
    cuts: u64,
    unread: u64,
    unopened: u64,
    missing: u64,
    wrong: u64,
}

/// The index of an instant of a file.
fn index_of(kept: &Kept, at: u32) -> u64 {
    let before: u64 = kept.gaps.iter().filter(|gap| gap.at <= at).map(|gap| gap.count).sum();
    kept.label.first_index + u64::from(at) + before
}

/// Instants of a file that are not those of their numbers.
fn wrong(file: &mut impl Medium, kept: &Kept, from: u32, count: u32) -> Result<u64> {
    let frames = kept::frames(file, from, count as usize)?;
    Ok((from..).zip(frames).filter(|(at, frame)| *frame != codes(index_of(kept, *at))).count() as u64)
}

impl Outcome {
    /// Power comes back; so many instants the card had said to have taken into this file.
    fn look(&mut self, card: &mut Torn<'_>, extent: Extent, taken: u64, untold: u64) -> Result<()> {
        self.cuts += 1;
        let mut file = Part { medium: card, first: extent.first };
        // An ordinary reader believes the first sector, and finds as much as that says.
        let head = file.read(0, 1)?;
        let ordinary = hound::WavReader::new(&head[..]).ok().filter(|reader| reader.spec().channels == 4);
        let Some(ordinary) = ordinary else {
            self.unopened += 1;
            return Ok(());
        };
        let Ok(kept) = kept::recover(&mut file, extent.pages) else {
            self.unread += 1;
            return Ok(());
        };
        let there = kept.as_ref().map_or(0, |kept| kept.frames);
        self.unopened += u64::from(ordinary.duration() > there);
        // The last instant may be taken for one that was cut.
        self.missing += taken.saturating_sub(u64::from(there) + untold.max(1));
        if let Some(kept) = kept {
            let from = there.saturating_sub(LOOKED_AT);
            self.wrong += wrong(&mut file, &kept, from, there - from)?;
        }
        Ok(())
    }
}

/// A whole file at its end: its sound is held against the truth.
fn leave(card: &Sectors, extent: Extent) -> Result<(u64, u64)> {
    let mut medium = card;
    let mut file = Part { medium: &mut medium, first: extent.first };
    let kept = kept::recover(&mut file, extent.pages)?.context("a file that was written is unused")?;
    let mut bad = 0;
    for from in (0..kept.frames).step_by(4096) {
        bad += wrong(&mut file, &kept, from, (kept.frames - from).min(4096))?;
    }
    Ok((u64::from(kept.frames), bad))
}

/// Takes a file's sectors off the card: its sound takes much room in memory.
fn forget(card: &mut Sectors, extent: Extent) {
    let end = extent.first + extent.pages * PAGE_SECTORS;
    card.0.retain(|sector, _| !(extent.first..end).contains(sector));
}

/// Instants that a card holds.
fn on_card(card: &Sectors, extents: &[(u32, Extent)]) -> Result<u64> {
    let mut medium = card;
    let mut of = |extent: &Extent| -> Result<u64> {
        let kept = kept::recover(&mut Part { medium: &mut medium, first: extent.first }, extent.pages)?;
        Ok(kept.map_or(0, |kept| kept.frames.into()))
    };
    extents.iter().map(|file| of(&file.1)).sum()
}

fn run(options: &Options) -> Result<()> {
    play(options, config::Clips::default())?;
    play(options, CLIPS)
}

fn play(options: &Options, clips: config::Clips) -> Result<()> {
    let asked = options.runs.unwrap_or(MINUTES);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let clips = Clips::new(clips, RATE_HZ);
    // A card of clips stands in memory as a whole.
    let minutes = if clips.are_kept() { asked.min(MINUTES) } else { asked };
    let (files, file_pages, untold) = match clips.are_kept() {
        true => (CLIP_FILES, CLIP_PAGES, UNTOLD),
        false => (minutes as u32 + 2, PAGES, 1),
    };
    let sectors = (files + 2) * file_pages * PAGE_SECTORS + 2_000_000;
    let card = Sectors::of(&Blank::new(sectors, Some(files), file_pages, RATE_HZ)?)?;
    let extents = extents(&mut &card)?;
    let holder = Rc::new(RefCell::new(Holder { sectors: card, write_us: WRITE_US, ..Holder::default() }));
    let mut pages = vec![[0; PAGE]; RING];
    let mut stage = [0; STAGE_BYTES];
    let mut tables = Box::new(Tables::new());
    let about = About { session: 1, station: 1, rate_hz: RATE_HZ, config_hash: 1, clips };
    let mut writer = Writer::new(Simulated(Rc::clone(&holder)), &mut pages, &mut stage, &mut tables, about);
    let (mut outcome, mut index, mut events) = (Outcome::default(), 0, 0u64);
    let (mut now, mut before, mut writes) = (None, 0, 0);
    let (mut whole, mut bad) = (0, 0);
    let (steps, mut slow) = (minutes as u64 * 60_000, SLOW.0);
    for step in 0..steps + 3000 {
        let kind = rng.random_range(0..WANTING);
        if step == slow {
            slow += rng.random_range(SLOW.0 / 2..2 * SLOW.0);
            holder.borrow_mut().stall_us = rng.random_range(0..SLOW.1);
        }
        if step < steps && kind != 0 {
            let frame = |n| if kind == 1 && n % 9 == 0 { [MISSING; 4] } else { codes(n) };
            let frames: [Frame; STEP as usize] = core::array::from_fn(|n| frame(index + n as u64));
            writer.take(index, &frames);
        }
        if step < steps && rng.random_range(0..DETECTION) == 0 {
            writer.heard(index.saturating_sub(STEP * 500));
        }
        if step == steps {
            writer.finish();
        }
        index += STEP;
        for _ in 0..2 {
            let recorded = writer.recorded();
            writer.work();
            events += u64::from(writer.event().is_some());
            let newest = holder.borrow().writes;
            if newest == writes {
                continue;
            }
            writes = newest;
            let mut held = holder.borrow_mut();
            let Some((sector, bytes)) = held.under_way.clone() else { continue };
            let inside = |extent: &Extent| sector.wrapping_sub(extent.first) < extent.pages * PAGE_SECTORS;
            let file = extents.iter().find(|file| inside(&file.1)).context("a write out of every file")?;
            if now != Some(*file) {
                // What the file before had taken is not counted with this one.
                if let Some((_, extent)) = now.replace(*file) {
                    let (frames, wrong) = leave(&held.sectors, extent)?;
                    if !clips.are_kept() {
                        forget(&mut held.sectors, extent);
                    }
                    (whole, bad, before) = (whole + frames, bad + wrong, recorded);
                }
            }
            let taken = writer.recorded().max(recorded) - before;
            for came in [0, rng.random_range(0..bytes.len() / WORD) * WORD, bytes.len()] {
                let bytes = bytes.get(..came).unwrap_or_default();
                outcome.look(&mut Torn { card: &held.sectors, sector, bytes }, file.1, taken, untold)?;
            }
        }
        holder.borrow_mut().now_us += 1000;
    }
    if let Some((_, extent)) = now {
        let (frames, wrong) = leave(&holder.borrow().sectors, extent)?;
        (whole, bad) = (whole + frames, bad + wrong);
    }
    let figures = &options.figures;
    let of = if clips.are_kept() { "clips: " } else { "" };
    figures.state(format!("{of}writes of {minutes} minutes"), writes as f64);
    figures.state(format!("{of}times power was cut"), outcome.cuts as f64);
    figures.at_most(
        format!("{of}times an ordinary reader did not open the file, or found more than there is"),
        outcome.unopened as f64,
        0.0,
    );
    figures.at_most(format!("{of}times the file could not be read"), outcome.unread as f64, 0.0);
    figures.at_most(
        match clips.are_kept() {
            true => "clips: instants told to be on the card and gone",
            false => "instants that the card had taken and were gone, but for one a cut",
        },
        outcome.missing as f64,
        0.0,
    );
    figures.at_most(format!("{of}instants under a wrong number"), (outcome.wrong + bad) as f64, 0.0);
    let short = writer.recorded().abs_diff(whole) as f64;
    figures.at_most(format!("{of}instants taken that are not in the whole files"), short, 0.0);
    figures.at_most(
        format!("{of}times the card was named slow, at stalls of up to 500 ms"),
        events as f64,
        0.0,
    );
    let there = match clips.are_kept() {
        true => on_card(&holder.borrow().sectors, &extents)?,
        false => whole,
    };
    let share = 100.0 * there as f64 / (steps * STEP) as f64;
    figures.state(format!("{of}share of the instants that is on the card, %"), share);
    Ok(())
}
