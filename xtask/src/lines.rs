//! Lines of code outside tests, package by package.
//!
//! Counted are the lines of `.rs` files that git tracks, blank ones, comments and tests left out. Tests are files under
//! `tests/` and files named `tests.rs` or `…_tests.rs`, and what follows an attribute `#[cfg(test)]` to the end of its item.

use crate::process::{find, output};
use crate::root;
use anyhow::{Context, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Prints the count of each package and the sum; of the working tree, or of a revision of git.
pub fn command(revision: Option<&str>) -> Result<()> {
    let git = find("git").context("git is not installed")?;
    let folder = root();
    let top = folder.to_str().context("the workspace's path is not text")?;
    let ask = |rest: &[&str]| {
        let arguments: Vec<&str> = ["-C", top].iter().chain(rest).copied().collect();
        output(&git, &arguments)
    };
    let listed = match revision {
        Some(revision) => ask(&["ls-tree", "-r", "--name-only", revision]),
        None => ask(&["ls-files"]),
    };
    let listed =
        listed.with_context(|| format!("git lists no files of {}", revision.unwrap_or("this tree")))?;
    let mut packages: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
    for path in listed.lines().filter(|p| p.ends_with(".rs") && !is_test(p)) {
        let text = match revision {
            Some(revision) => ask(&["show", &format!("{revision}:{path}")]).context("git show")?,
            None => std::fs::read_to_string(root().join(path)).with_context(|| path.to_owned())?,
        };
        let package = path.split('/').next().unwrap_or(path);
        let count = packages.entry(package).or_default();
        count.0 += 1;
        count.1 += of(&text);
    }
    for (package, (files, lines)) in &packages {
        println!("{package:12} {files:4} files {lines:7} lines");
    }
    let sum = packages.values().fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    println!("{:12} {:4} files {:7} lines", "all", sum.0, sum.1);
    Ok(())
}

/// Whether a file holds tests only.
fn is_test(path: &str) -> bool {
    let name = Path::new(path).file_stem().map_or("", |n| n.to_str().unwrap_or(""));
    path.split('/').any(|part| part == "tests") || name == "tests" || name.ends_with("_tests")
}

/// Lines of code of one file.
fn of(text: &str) -> usize {
    let (mut count, mut in_comment) = (0, false);
    // Depth of braces within a test item: `None` outside, 0 before its first brace.
    let mut test: Option<(i32, bool)> = None;
    for line in text.lines().map(str::trim) {
        if in_comment {
            in_comment = !line.contains("*/");
            continue;
        }
        if line.is_empty() || line.starts_with("//") {
            continue;
        }
        if line.starts_with("/*") {
            in_comment = !line.contains("*/");
            continue;
        }
        if test.is_none() && line.starts_with("#[cfg(test)]") {
            test = Some((0, false));
            continue;
        }
        let Some((depth, opened)) = &mut test else {
            count += 1;
            continue;
        };
        for c in line.chars() {
            *depth += i32::from(c == '{') - i32::from(c == '}');
            *opened |= c == '{';
        }
        let ended = if *opened { *depth <= 0 } else { line.ends_with(';') };
        if ended {
            test = None;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_counts_and_comments_blanks_and_tests_do_not() {
        let text = "//! About.\n\nuse a;\n#[cfg(test)]\nuse b;\nfn f() {\n    // Why.\n    g() // here\n}\n\n\
                    #[cfg(test)]\nmod tests {\n    fn t() {\n        f()\n    }\n}\n/* a\n b */\nfn h() {}\n";
        assert_eq!(of(text), 5);
    }

    #[test]
    fn files_of_tests_are_known() {
        assert!(
            is_test("tests/tests/a.rs")
                && is_test("core/src/demon/tests.rs")
                && is_test("core/src/obs/station_tests.rs")
        );
        assert!(!is_test("core/src/obs/station.rs"));
    }
}
