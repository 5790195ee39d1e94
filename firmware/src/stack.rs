//! How much of the stack was used: start-up code paints it, use wipes the paint off.

#![allow(unsafe_code)]

/// Bytes of stack there are, and the most that was used.
pub fn used() -> (u32, u32) {
    const PAINT: u32 = 0xcccc_cccc;
    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }
    let (low, high) = (&raw const _stack_end, &raw const _stack_start);
    let mut at = low;
    // SAFETY: reads words of the stack's own memory, from its far end up to the first one used.
    unsafe {
        while at < high && at.read_volatile() == PAINT {
            at = at.add(1);
        }
    }
    ((high as u32) - (low as u32), (high as u32) - (at as u32))
}
