//! Power cut at every write and every erase of a recorder's store in flash.

use super::{Experiment, Options};
use anyhow::{Result, ensure};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::wire::link::flash::{Cut, FlashStore, ModelFlash};
use seabearing_core::wire::link::{Class, Kept, Store};

/// `seabearing reproduce flash-cuts`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "flash-cuts",
    about: "power is cut at every write and every erase of a recorder's store in flash, before, in the midst and after; \
            --runs: minutes of records, 120 asked for",
    run,
};

const MINUTES: usize = 120;
/// Sectors and words of a flash word each: a sixteenth of the processor's second bank, so that it goes round often.
type Model = ModelFlash<4, 512>;
type Flash = FlashStore<Model, 64>;

/// What is written in a second, and up to where each class is acknowledged then.
struct Second {
    records: Vec<(Class, Vec<u8>)>,
    acknowledges: bool,
}

/// A record that can be read: its class and number, and what stands there.
type Readable = (Class, u32, Kept, [u8; 140]);

fn readable(store: &Flash) -> Vec<Readable> {
    let mut all = Vec::new();
    for class in Class::ALL {
        for n in 0..store.ledger().kept(class) {
            let number = store.ledger().oldest[class as usize].wrapping_add(n);
            let mut bytes = [0; 140];
            if let Some(kept) = store.read(class, number, &mut bytes) {
                all.push((class, number, kept, bytes));
            }
        }
    }
    all
}

/// A second of the run; a base station has what could be read two seconds ago.
fn play(store: &mut Flash, second: &Second) {
    for (class, record) in &second.records {
        store.append(*class, store.starts(), record);
        store.work();
    }
    for class in Class::ALL.into_iter().filter(|_| second.acknowledges) {
        let (kept, oldest) = (store.ledger().kept(class), store.ledger().oldest[class as usize]);
        let there = (0..kept).take_while(|n| store.read(class, oldest + n, &mut []).is_some()).count() as u32;
        if there > 2 {
            store.drop_oldest(class, there - 2, 0);
        }
    }
}

/// What came of the cuts.
#[derive(Default)]
struct Outcome {
    cuts: u64,
    missing: u64,
    twice: u64,
    starts_twice: u64,
    counted_lost: u64,
    stuck: u64,
    misuses: u64,
}

impl Outcome {
    /// Power comes back: what could be read before must be there, and the store must take more.
    fn look(&mut self, cut: Flash, before: &[Readable], second: &Second) {
        let starts = cut.starts();
        let mut flash = cut.into_flash();
        flash.switch_on();
        let mut store = Flash::open(flash);
        (0..20).for_each(|_| store.work());
        self.cuts += 1;
        // Before the first sector is erased nothing leaves, and the number of the first start is nobody's.
        self.starts_twice += u64::from(store.starts() <= starts && !before.is_empty());
        for (class, number, kept, bytes) in before {
            let mut now = [0; 140];
            let gone = *number < store.ledger().oldest[*class as usize];
            let same = store.read(*class, *number, &mut now) == Some(*kept) && now == *bytes;
            self.missing += u64::from(!gone && !same);
            self.twice += u64::from(store.ledger().next[*class as usize] <= *number);
        }
        self.counted_lost += u64::from(store.ledger().lost.iter().any(|n| *n > 0));
        let next = store.ledger().ordinal;
        play(&mut store, second);
        (0..20).for_each(|_| store.work());
        self.stuck += u64::from(store.waiting() > 0 || store.ledger().ordinal == next);
        self.misuses += u64::from(store.flash().misuses() > 0);
    }
}

fn run(options: &Options) -> Result<()> {
    let minutes = options.runs.unwrap_or(MINUTES);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut store = Flash::open(Model::new());
    store.begin(1);
    let mut outcome = Outcome::default();
    for s in 0..60 * minutes {
        let mut records = Vec::new();
        // About as an array that hears a vessel: bearings, a track and a fault now and then, its health.
        for (class, every) in
            [(Class::Bearing, 1), (Class::Health, 10), (Class::Alarm, 45), (Class::Final, 120)]
        {
            if s % every == 0 {
                let length = rng.random_range(12..=140);
                records.push((class, (0..length).map(|_| rng.random()).collect()));
            }
        }
        let second = Second { records, acknowledges: s % 3 == 0 };
        let before = readable(&store);
        let from = store.clone();
        play(&mut store, &second);
        for at in from.flash().operations()..store.flash().operations() {
            for cut in [Cut::Before, Cut::During, Cut::After] {
                let mut other = from.clone();
                other.flash_mut().cut_at(at, cut);
                play(&mut other, &second);
                ensure!(other.flash().is_off(), "no power was cut at operation {at}");
                outcome.look(other, &before, &second);
            }
        }
    }
    let (erases, figures) = (store.flash().erases(), &options.figures);
    let (most, least) = (erases.iter().max().copied(), erases.iter().min().copied());
    figures.state(format!("writes and erases of {minutes} minutes"), f64::from(store.flash().operations()));
    figures.state("erases of the sector erased most", f64::from(most.unwrap_or(0)));
    figures.at_most("more than of that erased least", f64::from(most.unwrap_or(0) - least.unwrap_or(0)), 1.0);
    figures.state("times power was cut", outcome.cuts as f64);
    figures.at_most("records that could be read and were gone, unacknowledged", outcome.missing as f64, 0.0);
    figures.at_most("numbers given twice", outcome.twice as f64, 0.0);
    figures.at_most("starts with the number of one before", outcome.starts_twice as f64, 0.0);
    figures.at_most("times the store counted a record lost", outcome.counted_lost as f64, 0.0);
    figures.at_most("times it took no more", outcome.stuck as f64, 0.0);
    figures.at_most("times a word was written twice, or a busy flash used", outcome.misuses as f64, 0.0);
    Ok(())
}
