//! A place for what the configuration makes: like `Option`, but empty is all zeros, so that a `static` costs no flash.

/// Empty, or full. The explicit tag keeps the compiler from marking "empty" with a non-zero value inside `T`.
#[derive(Clone, Debug)]
#[repr(u8)]
pub(crate) enum Slot<T> {
    /// Nothing there.
    Empty = 0,
    /// What was made.
    Full(T) = 1,
}

impl<T> Slot<T> {
    /// Whether something is there.
    pub(crate) fn is_full(&self) -> bool {
        matches!(self, Self::Full(_))
    }
}
