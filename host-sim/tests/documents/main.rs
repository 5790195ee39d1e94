//! What README and the book's chapters show is so: their commands run, their options exist, their links lead somewhere.
#![cfg(unix)]

mod commands;
#[path = "../examples/mod.rs"]
mod examples;
mod links;
mod mentions;
#[path = "../sds/mod.rs"]
mod sds;
mod statuses;
mod text;
