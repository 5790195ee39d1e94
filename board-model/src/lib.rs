//! The boards in software: firmware images run unchanged, instruction by instruction, without a C library.
//!
//! * [`Machine`]: an ARMv7E-M core (Cortex-M7) with its interrupt controller, timers and memories, and a board.
//! * [`mps2_an500`]: the board that QEMU models too, which checks the interpreter.
//! * [`stm32h743`]: the hardware board with its converter.
//!
//! Time is counted in [`time::Ticks`]; what an instruction or an access takes is a parameter ([`Costs`]). The model is
//! strict: an instruction or a register it does not know, an access to a peripheral without a clock or in a wrong order
//! stops the run with one line. `docs/board-model.md` says what is modelled and what only silicon can tell.

pub mod ads1282;
pub mod ads131m04;
pub mod board;
pub mod core;
pub mod costs;
mod decode;
pub mod elf;
mod instruction;
pub mod memory;
pub mod mps2_an500;
pub mod sd_card;
pub mod stm32h743;
pub mod time;

pub use board::{Board, Bus, Refusal, Width};
pub use core::{Counts, Ending, Machine};
pub use costs::Costs;
pub use elf::Image;
