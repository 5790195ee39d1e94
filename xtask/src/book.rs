//! `cargo xtask book`: the book out of docs/.

use crate::process::{cargo, find, run, say};
use crate::root;
use anyhow::Result;
use std::process::Command;

/// The version that is installed where there is none.
const VERSION: &str = "0.5.4";

/// Builds the book into `target/book`. That its links lead somewhere the tests check (`cargo test -p seabearing --test documents`).
pub fn build() -> Result<()> {
    let own = root().join("target/mdbook");
    let program = match find("mdbook") {
        Some(program) => program,
        None => {
            let program = own.join("bin").join(format!("mdbook{}", std::env::consts::EXE_SUFFIX));
            if !program.is_file() {
                say("installing mdBook (a few minutes)");
                let mut install = cargo();
                install.args([
                    "install",
                    "--quiet",
                    "--locked",
                    "--no-default-features",
                    "mdbook",
                    "--version",
                    VERSION,
                ]);
                run(install.arg("--root").arg(&own), "cargo install mdbook")?;
            }
            program
        }
    };
    run(Command::new(program).arg("build"), "mdbook")?;
    say("the book: target/book/index.html");
    Ok(())
}
