//! Where nothing checks the orientations and clocks of stations: in words.

use crate::station::{CLOCK_SD_S, ORIENTATION_SD_DEG};

/// What would.
const REMEDY: &str =
    "a third array, elevations, or a vessel of known track (`seabearing orient --track`) would check them";

/// Of positions that have been made, none of which has more bearings than it needs.
pub fn of_positions() -> String {
    format!(
        "no position has more bearings than it needs: nothing checks the orientations and clocks of the arrays, and if one is wrong \
         vessels are told somewhere else without a contradiction; {REMEDY}. Stated errors hold orientation_sd_deg and clock_sd_s of \
         the network file, {ORIENTATION_SD_DEG}° and {CLOCK_SD_S} s where it does not say them"
    )
}

/// Of a list of stations; `None` of three or more, where a third azimuth checks two.
pub fn of_stations(stations: usize) -> Option<String> {
    (stations <= 2).then(|| {
        format!(
            "two azimuths always meet somewhere: where no elevations are heard nothing checks the orientations and clocks of {stations} \
             stations, and if one is wrong vessels are told somewhere else without a contradiction; {REMEDY}"
        )
    })
}
