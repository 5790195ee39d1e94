//! Fourier transforms. The library behind them is generic: every crate that plans a transform compiles all of it again.
//! Here it is compiled once, for both precisions, and without what differs from processor to processor: a seed gives
//! the same recording everywhere.
//!
//! ```
//! use seabearing_signal::Precision;
//! let forward = f32::real_to_complex(8);
//! let (mut wave, mut spectrum) = (vec![1.0; 8], forward.make_output_vec());
//! forward.process(&mut wave, &mut spectrum).unwrap();
//! assert_eq!(spectrum[0].re, 8.0);
//! ```

use std::sync::Arc;

pub use realfft::{ComplexToReal, RealToComplex};
pub use rustfft::{Fft, FftNum, num_complex::Complex};

/// The precisions transforms are compiled for. No transform is scaled: there and back again multiplies by the length.
pub trait Precision: FftNum {
    /// From `length` real samples to `length / 2 + 1` bins.
    fn real_to_complex(length: usize) -> Arc<dyn RealToComplex<Self>>;
    /// From `length / 2 + 1` bins to `length` real samples.
    fn complex_to_real(length: usize) -> Arc<dyn ComplexToReal<Self>>;
    /// From `length` complex bins to as many complex samples.
    fn complex_inverse(length: usize) -> Arc<dyn Fft<Self>>;
}

macro_rules! precision {
    ($($float:ty)*) => {$(
        impl Precision for $float {
            fn real_to_complex(length: usize) -> Arc<dyn RealToComplex<Self>> {
                realfft::RealFftPlanner::new().plan_fft_forward(length)
            }
            fn complex_to_real(length: usize) -> Arc<dyn ComplexToReal<Self>> {
                realfft::RealFftPlanner::new().plan_fft_inverse(length)
            }
            fn complex_inverse(length: usize) -> Arc<dyn Fft<Self>> {
                rustfft::FftPlanner::new().plan_fft_inverse(length)
            }
        }
    )*};
}
precision!(f32 f64);
