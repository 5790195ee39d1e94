//! Tells the linker which of `memory.x`'s regions the image runs in, and which scripts to use.

use std::{env, fs, path::PathBuf};

/// Flash and statics of the STM32H743.
const BOARD: &str = "\
REGION_ALIAS(\"FLASH\", H743_FLASH);
REGION_ALIAS(\"RAM\", H743_AXI);
";

/// Images with the link have their stack in tightly coupled memory: beside their statics AXI SRAM has no room for four times
/// what it needs.
const LINK_STACK: &str = "\
_stack_start = ORIGIN(H743_DTCM) + LENGTH(H743_DTCM);
_stack_end = ORIGIN(H743_DTCM);
";

/// The image that records sound needs AXI SRAM for what waits for the card, so the store stands elsewhere.
const CARD_STORE: &str = "\
SECTIONS {
  .sram (NOLOAD) : ALIGN(8) { __ssram = .; *(.sram .sram.*); . = ALIGN(8); __esram = .; } > H743_SRAM
} INSERT AFTER .uninit;
";

fn main() {
    println!("cargo:rerun-if-changed=../memory.x");
    println!("cargo:rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    println!("cargo:rerun-if-env-changed=SEABEARING_STATION_BLOB");
    println!("cargo:rerun-if-env-changed=SEABEARING_KEY");
    let has = |feature: &str| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    let board = if has("STM32H743") {
        let parts = [(true, BOARD), (has("LINK"), LINK_STACK), (has("CARD"), CARD_STORE)];
        parts.into_iter().filter(|(wanted, _)| *wanted).map(|(_, part)| part).collect()
    } else {
        String::from("REGION_ALIAS(\"FLASH\", AN500_CODE);\nREGION_ALIAS(\"RAM\", AN500_DATA);\n")
    };
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::write(out.join("board.x"), board).expect("OUT_DIR is writable");
    fs::copy("../memory.x", out.join("memory.x")).expect("memory.x stands beside the workspace's Cargo.toml");
    println!("cargo:rustc-link-search={}", out.display());
    for kind in ["bins", "examples"] {
        println!("cargo:rustc-link-arg-{kind}=--nmagic");
        println!("cargo:rustc-link-arg-{kind}=-Tlink.x");
    }
    if has("DEFMT") {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
