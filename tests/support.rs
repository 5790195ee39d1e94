//! Helpers shared by the cross-crate tests.

use std::path::PathBuf;

/// The folder of real recordings and ship positions beside the project (`../shared/data`), if it is there.
///
/// The data carry no licence to redistribute and are not part of the project; a test that needs them
/// calls this and returns after the printed reason where it answers `None`.
pub fn shared_data(test: &str) -> Option<PathBuf> {
    let dir = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    if dir.is_dir() {
        Some(dir)
    } else {
        println!("skipped {test}: no real data at ../shared/data");
        None
    }
}
