//! The file of a base station's store.
#![no_main]

use seabearing_experiments::fuzz_targets::STORE;

libfuzzer_sys::fuzz_target!(init: seabearing_fuzz::begin(&STORE), |input: &[u8]| seabearing_fuzz::take(&STORE, input));
