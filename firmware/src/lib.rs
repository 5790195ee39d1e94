//! The recorder application, generic over its board.
#![no_std]
