//! The array chain's speed: four channels at 64 kHz. The items counted are sample instants; real time is 64 000 a second,
//! so 400 times real time is 25.6 million a second.

use divan::Bencher;
use divan::counter::ItemsCount;
use seabearing_core::array::Plan;
use seabearing_experiments::bearing_limit::{bearings, station};
use seabearing_experiments::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};

fn main() {
    divan::main();
}

/// Four seconds of a source at an SNR, block by block as the recorder gets them.
#[divan::bench(args = [-20.0, 0.0, 10.0], sample_count = 10)]
fn four_channels_at_64_khz(bencher: Bencher<'_, '_>, snr_db: f64) {
    let Ok(plan) = Plan::new(&station()) else { return };
    let samples = 1 << 18;
    let sounder = Sounder::new(plan.geometry(), 64_000.0, samples, AmbientField::Independent);
    let arrivals = exact_arrivals(plan.geometry(), 1.0, 0.3, 500.0);
    let frames = sounder.record(1, 2e4, Some((snr_db, arrivals)));
    bencher.counter(ItemsCount::new(samples)).bench(|| bearings(&plan, &frames));
}
