//! The text of a station file.
#![no_main]

use seabearing_experiments::fuzz_targets::STATION_FILE;

libfuzzer_sys::fuzz_target!(init: seabearing_fuzz::begin(&STATION_FILE), |input: &[u8]| seabearing_fuzz::take(&STATION_FILE, input));
