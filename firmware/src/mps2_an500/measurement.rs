//! What the images that measure one thing share: noise, and how they end.

use super::host;

/// Random numbers of mean 0 and variance 1, the same in every run.
pub struct Impulses(pub u32);

impl Impulses {
    /// The next one: the sum of twelve uniform numbers.
    pub fn draw(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..12 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += f64::from(self.0 >> 8) / f64::from(1 << 24);
        }
        sum - 6.0
    }
}

/// Ends a measurement: its words stand in `summary.bin`, or the run has failed.
pub fn end(words: &[u64]) -> ! {
    if !host::leave(words) {
        host::fail(c"cannot write summary.bin\n");
    }
    host::exit(0)
}

/// Ends the image as failed on a hard fault or a panic.
#[macro_export]
macro_rules! fail_on_faults {
    () => {
        #[cortex_m_rt::exception]
        unsafe fn HardFault(_frame: &cortex_m_rt::ExceptionFrame) -> ! {
            $crate::mps2_an500::host::fail(c"hard fault\n")
        }

        #[panic_handler]
        fn panic(_info: &core::panic::PanicInfo<'_>) -> ! {
            $crate::mps2_an500::host::fail(c"panicked\n")
        }
    };
}
