//! Signal processing of the host alone: Fourier transforms and values between samples. Simulations spend their time here,
//! so that it is compiled with optimisation even where the rest is not.

pub mod fourier;
pub mod interpolate;

pub use fourier::{Complex, ComplexToReal, Fft, Precision, RealToComplex};
