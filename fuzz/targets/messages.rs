//! Messages whose frames have the right checksum, for everything that reads frames.
#![no_main]

use seabearing_experiments::fuzz_targets::MESSAGES;

libfuzzer_sys::fuzz_target!(init: seabearing_fuzz::begin(&MESSAGES), |input: &[u8]| seabearing_fuzz::take(&MESSAGES, input));
