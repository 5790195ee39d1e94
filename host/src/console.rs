//! Printing results: the standard library's `println!` panics where nobody takes the line; the one of this crate ends
//! the command, quietly where the reader has gone, with one line where the disk is full.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};

/// Prints to standard output, as this crate's `print!` and `println!` do.
pub fn print(text: Arguments<'_>) {
    let Err(error) = std::io::stdout().lock().write_fmt(text) else { return };
    if error.kind() == ErrorKind::BrokenPipe {
        crate::interrupt::leave(0);
    }
    let _ = writeln!(std::io::stderr(), "seabearing: cannot write to standard output: {error}");
    crate::interrupt::leave(1)
}

/// As the standard library's, through [`print()`].
#[macro_export]
macro_rules! print {
    ($($text:tt)*) => { $crate::console::print(format_args!($($text)*)) };
}

/// As the standard library's, through [`print()`].
#[macro_export]
macro_rules! println {
    () => { $crate::console::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::console::print(format_args!("{}\n", format_args!($($text)*))) };
}
