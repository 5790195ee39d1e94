//! Bytes of a line, for the decoder and both ends of a link.
#![no_main]

use seabearing_experiments::fuzz_targets::LINK;

libfuzzer_sys::fuzz_target!(init: seabearing_fuzz::begin(&LINK), |input: &[u8]| seabearing_fuzz::take(&LINK, input));
