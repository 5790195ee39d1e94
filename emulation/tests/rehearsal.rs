//! What the hardware image does when things go wrong: the table, case by case.
//!
//! A difference is an error. Where it is meant, `INSTA_UPDATE=always` keeps the new table.

use seabearing_core::config_blob;
use seabearing_emulation::rehearsal::{self, LEAST_BREAKING, Length, Stage};
use std::path::PathBuf;

#[test]
fn every_fault_is_named_and_no_wrong_record_passes_as_good() {
    if !seabearing_testkit::emulated("every_fault_is_named_and_no_wrong_record_passes_as_good") {
        return;
    }
    let firmware = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/firmware");
    let blob = std::fs::read(firmware.join("station.sbcf")).unwrap();
    let stage = Stage {
        image: &firmware.join("images/stm32h743.elf"),
        link_image: &firmware.join("images/stm32h743-link.elf"),
        blob: &blob,
        rate_hz: config_blob::station(&blob).unwrap().rate_hz,
    };
    let length =
        Length { pace_s: 1.5, costs: vec![LEAST_BREAKING], outages_s: vec![0.001, 0.1, 1.0], cuts: Some(4) };
    let rows = stage.rehearse(&length, |_| {}).unwrap();
    let table: Vec<String> = rows.iter().map(ToString::to_string).collect();
    insta::assert_snapshot!(table.join("\n"));
    rehearsal::verdict(&rows).unwrap();
}

#[test]
fn a_card_that_fails_is_named_and_its_sound_is_whole_or_told_to_be_missing() {
    if !seabearing_testkit::emulated(
        "a_card_that_fails_is_named_and_its_sound_is_whole_or_told_to_be_missing",
    ) {
        return;
    }
    let firmware = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/firmware");
    let blob = std::fs::read(firmware.join("station.sbcf")).unwrap();
    let stage = Stage {
        image: &firmware.join("images/stm32h743.elf"),
        link_image: &firmware.join("images/stm32h743-card.elf"),
        blob: &blob,
        rate_hz: config_blob::station(&blob).unwrap().rate_hz,
    };
    let rows = stage.rehearse_card(4, |_| {}).unwrap();
    let table: Vec<String> = rows.iter().map(ToString::to_string).collect();
    insta::assert_snapshot!(table.join("\n"));
    rehearsal::verdict(&rows).unwrap();
}
