//! Bytes of the line over which samples come.
#![no_main]

use seabearing_experiments::fuzz_targets::SAMPLE_LINE;

libfuzzer_sys::fuzz_target!(init: seabearing_fuzz::begin(&SAMPLE_LINE), |input: &[u8]| seabearing_fuzz::take(&SAMPLE_LINE, input));
