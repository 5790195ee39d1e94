//! The version that `Hello` tells.

/// Version of the package, from its manifest.
pub(crate) const VERSION: (u8, u8, u8) = (
    decimal(env!("CARGO_PKG_VERSION_MAJOR")),
    decimal(env!("CARGO_PKG_VERSION_MINOR")),
    decimal(env!("CARGO_PKG_VERSION_PATCH")),
);

const fn decimal(text: &str) -> u8 {
    let bytes = text.as_bytes();
    let mut value = 0u8;
    let mut i = 0;
    while i < bytes.len() {
        value = value.wrapping_mul(10).wrapping_add(bytes[i].wrapping_sub(b'0'));
        i += 1;
    }
    value
}
