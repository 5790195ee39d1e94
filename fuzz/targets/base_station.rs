//! Bytes of a line, for the base station.
#![no_main]

use seabearing_experiments::fuzz_targets::BASE_STATION;

libfuzzer_sys::fuzz_target!(init: seabearing_fuzz::begin(&BASE_STATION), |input: &[u8]| seabearing_fuzz::take(&BASE_STATION, input));
