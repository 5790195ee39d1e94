#![no_std]
#![no_main]
use embassy_executor as _;
use embassy_stm32 as _;
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
#[cortex_m_rt::entry]
fn main() -> ! {
    loop {}
}
