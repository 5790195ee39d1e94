//! A real ship's arrival-time differences through `seabearing bearing`, against GPS (skipped where the data are absent).

use seabearing::reproduce::real_ship_ee::{ShipRecording, score};
use seabearing_testkit::shared_data;

#[test]
fn bearings_of_a_real_ship_keep_within_the_stated_errors() {
    let Some(data) = shared_data("real_ship_ee", "real/harp4_ship_tdoa_EE") else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = ShipRecording::convert(&data, folder.path()).unwrap();
    let s = score(&recording.judge().unwrap());
    println!("{s:?}");
    assert!(s.sets > 4000);
    assert!(s.kept >= 0.80, "{s:?}");
    assert!(s.median_deg <= 0.95, "{s:?}");
    assert!(s.beyond_10_deg < 0.01, "{s:?}");
}
