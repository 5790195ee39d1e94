//! Compass offsets of real buoys (data beside the project; skipped where absent).

use seabearing::reproduce::difar;
use seabearing_testkit::shared_data;

#[test]
fn difar_offsets_are_robust() {
    let name = "real/difar_vessel_bearings_A/vessel_bearings.csv";
    let Some(file) = shared_data("difar_offsets_are_robust", name) else { return };
    let s = difar::score(&file).unwrap();
    assert!(s.buoys >= 70 && s.bearings >= 500, "{} buoys", s.buoys);
    assert!(s.within_7_deg >= 0.90, "{}", s.within_7_deg);
    assert!(s.within_1_deg_of_median >= 0.85, "{}", s.within_1_deg_of_median);
    // The robust fit beats least squares on tracks: it repeats and predicts better.
    assert!(s.repeat_deg[0] < s.repeat_deg[1], "{:?}", s.repeat_deg);
    assert!(s.predicted_deg[0] < s.predicted_deg[1], "{:?}", s.predicted_deg);
    assert!(s.excess_kurtosis > 5.0, "real errors are far from Gaussian: {}", s.excess_kurtosis);
}
