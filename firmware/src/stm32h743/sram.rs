//! The SRAM of the D2 domain: its clocks are off after a reset (RM0433, 8.7.40 from memory), and start-up code does not clear it.

use embassy_stm32::pac;

unsafe extern "C" {
    static mut __ssram: u64;
    static mut __esram: u64;
}

/// Switches it on and clears it, as start-up does with other statics.
///
/// # Safety
/// Nothing in the section `.sram` was used before, and all of it is valid as zeros.
pub unsafe fn open() {
    pac::RCC.ahb2enr().modify(|w| {
        w.set_sram1en(true);
        w.set_sram2en(true);
    });
    // The clock runs two of its periods after the write (8.5.11).
    cortex_m::asm::dsb();
    let (mut at, end) = (&raw mut __ssram, &raw mut __esram);
    while at < end {
        // SAFETY: the linker's limits of the section, whole words of 64 bits.
        unsafe {
            at.write_volatile(0);
            at = at.add(1);
        }
    }
}
