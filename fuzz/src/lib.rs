//! What the targets of the coverage-guided fuzzer share. The targets themselves are those of the mutated streams
//! (`experiments/src/fuzz_targets.rs`).

use anyhow::{Context, Result};
use seabearing_experiments::fuzz_targets::{Seeds, Target};
use std::path::Path;

/// Names the folder into which a target writes its seeds before it begins (`cargo xtask fuzz --guided` sets it).
pub const SEEDS: &str = "SEABEARING_FUZZ_SEEDS";

/// Writes the inputs that are right, with which the fuzzer begins.
///
/// # Panics
/// They cannot be written.
pub fn begin(target: &Target) {
    if let Some(folder) = std::env::var_os(SEEDS)
        && let Err(e) = write(target, Path::new(&folder))
    {
        panic!("{e:#}");
    }
}

fn write(target: &Target, folder: &Path) -> Result<()> {
    for (n, input) in Seeds::of(target)?.inputs.iter().enumerate() {
        let path = folder.join(format!("seed-{n}"));
        std::fs::write(&path, input).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// Takes an input. False frames are not counted here: a fuzzer that sees comparisons finds checksums that are right.
pub fn take(target: &Target, input: &[u8]) {
    (target.run)(input, &Seeds::default());
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_experiments::fuzz_targets::TARGETS;

    /// Inputs on which a target once failed (`fuzz/cases/TARGET/`); none if it never did.
    fn cases(target: &Target) -> Vec<Vec<u8>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("cases").join(target.file);
        let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
        files.map(|file| std::fs::read(file.path()).unwrap()).collect()
    }

    #[test]
    fn what_was_found_stays_mended_and_most_seeds_are_taken() {
        for target in TARGETS {
            let seeds = Seeds::of(&target).unwrap();
            cases(&target).iter().for_each(|input| take(&target, input));
            let came = seeds.inputs.iter().map(|input| (target.run)(input, &seeds));
            let (taken, wrong) =
                came.fold((0, 0), |(n, f), o| (n + usize::from(o.taken), f + o.false_frames));
            assert!(2 * taken > seeds.inputs.len() && wrong == 0, "{}: {taken}, {wrong}", target.name);
        }
    }

    #[test]
    fn every_target_has_its_program() {
        for target in TARGETS {
            let path =
                Path::new(env!("CARGO_MANIFEST_DIR")).join("targets").join(format!("{}.rs", target.file));
            assert!(path.is_file(), "{}", path.display());
        }
    }

    #[test]
    fn a_target_writes_its_seeds() {
        let folder = std::env::temp_dir().join(format!("seabearing-seeds-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let target = &TARGETS[0];
        write(target, &folder).unwrap();
        let written = std::fs::read_dir(&folder).unwrap().count();
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(written, Seeds::of(target).unwrap().inputs.len());
        assert!(write(target, &folder).is_err());
    }
}
