//! The speed of sound of a propagation table, where it may be another: told to the recorder as an error of the table's depth.

use seabearing_core::config::Doubts;

/// Greatest deviation, m/s.
const MOST_SD_M_S: f32 = 100.0;

/// Greatest deviation of the table's depth, m.
const MOST_DEPTH_SD_M: f32 = 1000.0;

/// What an error of the table's depth is over one of its speed of sound, as shares of each.
///
/// The delay between the paths that cross the water once and three times, `(R₃ − R₁)/c` with `Rₙ² = r² + n² h²`, stays as it is where `r` is off by
/// `R₁R₃/r` of the share of `c`; of an error of `h` it is off by `(h/r) (9 R₁ − R₃)/(R₃ − R₁)`. The ratio over `h` is 1 above the station, 0.82 one
/// depth aside, 0.67 two, and 0.5 far away.
const AS_DEPTH: f64 = 0.6;

/// Adds a deviation of the speed of sound, m/s, to what is not known of a station. `water`: its depth, m, and the speed of sound, m/s.
///
/// # Errors
/// What is wrong with it.
pub(super) fn count(doubts: &mut Doubts, sd_m_s: f32, water: (f64, f64)) -> Result<(), String> {
    let (depth_m, sound_m_s) = water;
    if !(0.0..=MOST_SD_M_S).contains(&sd_m_s) {
        return Err(format!("table_sound_speed_sd_m_s = {sd_m_s}; 0 to {MOST_SD_M_S} was expected"));
    }
    if sd_m_s == 0.0 {
        return Ok(());
    }
    if !(depth_m > 0.0) {
        return Err(
            "table_sound_speed_sd_m_s needs the depth of the water: `depth_m` of the station's position"
                .into(),
        );
    }
    let own_m = doubts.table_depth_m;
    // What is wrong with the depth's own is said of that.
    if (0.0..=MOST_DEPTH_SD_M).contains(&own_m) {
        let as_depth_m = AS_DEPTH * depth_m * f64::from(sd_m_s) / sound_m_s;
        doubts.table_depth_m = own_m.hypot(as_depth_m as f32);
        if doubts.table_depth_m > MOST_DEPTH_SD_M {
            return Err(format!(
                "table_sound_speed_sd_m_s = {sd_m_s}: with table_depth_sd_m = {own_m} that is as much as a table {:.0} m off, and at most \
                 {MOST_DEPTH_SD_M} m can be told",
                doubts.table_depth_m
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_counts_beside_the_depths_own() {
        let mut doubts = Doubts { table_depth_m: 30.0, ..Doubts::default() };
        count(&mut doubts, 0.0, (0.0, 1500.0)).unwrap();
        assert_eq!(doubts.table_depth_m, 30.0);
        count(&mut doubts, 15.0, (4000.0, 1500.0)).unwrap();
        assert!((doubts.table_depth_m - 30f32.hypot(24.0)).abs() < 1e-3);
    }

    #[test]
    fn it_is_within_what_is_said_of_far_and_near_ranges() {
        let h: f64 = 4000.0;
        for (range_m, least, most) in [(4000.0, 0.72, 0.75), (8000.0, 0.88, 0.92), (60_000.0, 1.17, 1.2)] {
            let delay = |r: f64, h: f64, c: f64| (r.hypot(3.0 * h) - r.hypot(h)) / c;
            let slope = |f: &dyn Fn(f64) -> f64, x: f64, d: f64| (f(x + d) - f(x - d)) / (2.0 * d);
            let by_range = slope(&|r| delay(r, h, 1500.0), range_m, 1.0);
            let by_depth = slope(&|h| delay(range_m, h, 1500.0), h, 1.0) / by_range;
            let by_sound = slope(&|c| delay(range_m, h, c), 1500.0, 0.1) / by_range;
            let stated = AS_DEPTH * h / 1500.0 * by_depth / by_sound;
            assert!((least..most).contains(&stated.abs()), "{range_m}: {stated}");
        }
    }

    #[test]
    fn what_cannot_be_is_said() {
        let mut doubts = Doubts { table_depth_m: -5.0, ..Doubts::default() };
        count(&mut doubts, 15.0, (4000.0, 1500.0)).unwrap();
        assert_eq!(doubts.table_depth_m, -5.0);
        let mut doubts = Doubts { table_depth_m: 990.0, ..Doubts::default() };
        assert!(count(&mut doubts, 100.0, (4000.0, 1500.0)).unwrap_err().contains("= 990 that"));
        for (sd, depth_m, what) in
            [(-1.0, 4000.0, "0 to 100"), (f32::NAN, 4000.0, "0 to 100"), (5.0, 0.0, "depth_m")]
        {
            let error = count(&mut Doubts::default(), sd, (depth_m, 1500.0)).unwrap_err();
            assert!(error.contains(what), "{error}");
        }
    }
}
