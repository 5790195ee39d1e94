//! The one hash of the project: of the schema, of configurations, of tables.

/// The 64-bit FNV-1a hash (Fowler, Noll, Vo; offset basis and prime of the published algorithm).
pub const fn fnv1a(bytes: &[u8]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}
