//! The host side of an ocean-bottom station: its propagation table for the core, its simulator, its pictures.

pub mod table;
