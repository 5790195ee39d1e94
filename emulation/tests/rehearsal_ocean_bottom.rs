//! What the ocean-bottom image does when things go wrong: the table, case by case.
//!
//! A difference is an error. Where it is meant, `INSTA_UPDATE=always` keeps the new table.

use seabearing_core::config_blob;
use seabearing_emulation::rehearsal::{self, OceanBottom, Stage};
use std::path::PathBuf;

#[test]
fn every_fault_of_the_ocean_bottom_board_is_named_and_no_wrong_record_passes_as_good() {
    if !seabearing_testkit::emulated(
        "every_fault_of_the_ocean_bottom_board_is_named_and_no_wrong_record_passes_as_good",
    ) {
        return;
    }
    let firmware = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/firmware");
    let blob = std::fs::read(firmware.join("station-obs.sbcf")).unwrap();
    let image = &firmware.join("images/stm32h743-obs.elf");
    let rate_hz = config_blob::station(&blob).unwrap().rate_hz;
    let stage = Stage { image, link_image: image, blob: &blob, rate_hz };
    let length = OceanBottom { pace_s: 60.0, outages_s: vec![1.0], short: true, cuts: 2 };
    let rows = stage.rehearse_ocean_bottom(&length, |_| {}).unwrap();
    let table: Vec<String> = rows.iter().map(ToString::to_string).collect();
    insta::assert_snapshot!(table.join("\n"));
    rehearsal::verdict(&rows).unwrap();
}
