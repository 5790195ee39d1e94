//! What the tests of every crate share: property tests that mean the same every time, and a register of what was
//! skipped, so that a green run never hides what it did not do.

use proptest::test_runner::{Config, FileFailurePersistence, RngSeed};
use std::io::Write;
use std::path::PathBuf;

/// Seed of every property test, but for a random run.
const SEED: u64 = 1;

/// Names how many times the cases of a test a random run tries (`cargo xtask test --random N` sets it).
pub const RANDOM: &str = "SEABEARING_RANDOM";

/// Names the file that gathers what was skipped (`cargo xtask test` sets it and prints the file at its end).
pub const SKIPPED: &str = "SEABEARING_SKIPPED";

/// Settings of a property test of `cases` cases: the same ones every time.
///
/// In a random run there are `N · cases` of them, other ones every time. What fails then is kept beside the source as
/// `FILE.cases`; committed, it is tried first in every run from then on.
pub fn property(cases: u32) -> Config {
    let times = std::env::var(RANDOM).ok().map(|n| n.parse::<u32>().expect("SEABEARING_RANDOM is a number"));
    Config {
        cases: cases * times.unwrap_or(1),
        rng_seed: if times.is_some() { RngSeed::Random } else { RngSeed::Fixed(SEED) },
        failure_persistence: Some(Box::new(FileFailurePersistence::WithSource("cases"))),
        ..Config::default()
    }
}

/// Says that a test does nothing and why: straight to standard error, for what tests print with `println!` is kept back
/// when they pass, and into the register.
pub fn skipped(test: &str, reason: &str) {
    let line = format!("skipped {test}: {reason}\n");
    // One write, so that tests beside each other do not mix their lines.
    let _ = std::io::stderr().write_all(line.as_bytes());
    if let Some(register) = std::env::var_os(SKIPPED) {
        let mut file =
            std::fs::File::options().append(true).create(true).open(register).expect("the register of skips");
        file.write_all(line.as_bytes()).expect("the register of skips");
    }
}

/// A file or folder of real recordings and ship positions beside the project (`../shared/data/NAME`).
///
/// They carry no licence to redistribute and are no part of the project. A test that needs one names itself and returns
/// where the answer is `None`; that is in the register then.
pub fn shared_data(test: &str, name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    if !path.exists() {
        skipped(test, &format!("no real data at ../shared/data/{name}"));
        return None;
    }
    Some(path)
}

/// Whether tests may boot the firmware in the emulator: `cargo xtask test` says `now` once it has built the image for
/// this tree, and `later` while that is still to come. Otherwise that is in the register, and the test returns.
pub fn emulated(test: &str) -> bool {
    match std::env::var("SEABEARING_EMULATED").as_deref() {
        Ok("now") => return true,
        Ok("later") => {}
        _ => skipped(test, "it boots the firmware in QEMU; `cargo xtask test` builds that and runs this"),
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::strategy::{Strategy, ValueTree};
    use proptest::test_runner::TestRunner;

    #[test]
    fn a_property_test_has_the_same_cases_every_time() {
        if std::env::var_os(RANDOM).is_some() {
            return;
        }
        let draw = || {
            let mut runner = TestRunner::new(property(3));
            [(); 3].map(|()| (0u64..u64::MAX).new_tree(&mut runner).unwrap().current())
        };
        assert_eq!(draw(), draw());
    }

    /// Rust files of the project below a folder.
    fn sources(folder: &std::path::Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let (path, name) = (entry.path(), entry.file_name());
            if path.is_dir() && name != "target" && !name.to_string_lossy().starts_with('.') {
                sources(&path, found);
            } else if path.extension().is_some_and(|e| e == "rs") {
                found.push(path);
            }
        }
    }

    #[test]
    fn every_property_test_takes_its_settings_from_here() {
        let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut found = Vec::new();
        sources(&root, &mut found);
        let (block, settings) = (concat!("proptest", "! {"), concat!("seabearing_testkit", "::property("));
        let mut blocks = 0;
        for file in found {
            let text = std::fs::read_to_string(&file).unwrap();
            let here = text.matches(block).count();
            assert_eq!(here, text.matches(settings).count(), "{}", file.display());
            blocks += here;
        }
        assert!(blocks >= 10, "{blocks}");
    }
}
