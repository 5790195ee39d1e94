//! The recorder's firmware: boards under the core's main loop.
//!
//! * `mps2_an500`: the emulated board (QEMU); samples by semihosting, telemetry and commands on UART0.
//! * `stm32h743`: the hardware board; samples from the converter over SPI. It has run in an
//!   emulator with its real drivers, not on silicon.
//!
//! Everything a board offers the loop implements a trait of [`seabearing_core::port`].
#![no_std]

#[cfg(test)]
extern crate std;

pub mod acquisition;
pub mod bank;
pub mod battery;
pub mod card;
pub mod converter;
pub mod fault;
pub mod gauges;
pub mod nmea;
pub mod pace;
pub mod phase;
pub mod receiver;
pub mod seismic;
pub mod starts;
pub mod supply;

#[cfg(any(feature = "mps2-an500", feature = "stm32h743"))]
pub mod stack;

#[cfg(feature = "mps2-an500")]
pub mod mps2_an500;

#[cfg(feature = "stm32h743")]
pub mod stm32h743;
