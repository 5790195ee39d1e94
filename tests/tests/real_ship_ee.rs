//! A real ship's arrival-time differences through `seabearing bearing`, against GPS (skipped where the data are absent).

use seabearing::delays::solve_rows;
use seabearing::reproduce::real_ship_ee::{ShipRecording, score};
use seabearing_core::geometry::PAIRS;
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

#[test]
fn no_hydrophone_of_a_real_array_is_called_late_until_one_is() {
    let Some(data) = shared_data("real_ship_ee", "real/harp4_ship_tdoa_EE") else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = ShipRecording::convert(&data, folder.path()).unwrap();
    let lateness = recording.solved().unwrap().lateness.unwrap();
    println!("{lateness:?}");
    assert_eq!(lateness.said(), None);
    let text = std::fs::read_to_string(&recording.tdoa).unwrap();
    let rows: Vec<[f64; 7]> = text
        .lines()
        .skip(1)
        .map(|line| {
            let mut numbers = line.split(',').map(|x| x.parse().unwrap());
            std::array::from_fn(|_| numbers.next().unwrap())
        })
        .collect();
    for hydrophone in 0..4 {
        for late_s in [150e-6, 1e-3] {
            let mut rows = rows.clone();
            for row in &mut rows {
                for ((i, j), tau) in PAIRS.into_iter().zip(&mut row[1..]) {
                    *tau += if j == hydrophone { late_s } else { 0.0 }
                        - if i == hydrophone { late_s } else { 0.0 };
                }
            }
            let lateness = solve_rows(&recording.station.config, rows, None).unwrap().lateness.unwrap();
            println!("{hydrophone} {late_s}: {:?}", lateness.said());
            if late_s > 5e-4 {
                let late = lateness.late();
                assert!(late.len() == 1 && late[0].hydrophone == hydrophone, "{late:?}");
                // The array itself may be off by what its own sets say, some 20 µs.
                assert!((late[0].late_s - late_s).abs() < 5.0 * late[0].sd_s, "{late:?}");
            }
        }
    }
}
