//! The hardware board.
