//! `seabearing locate` and the network estimators behind it: golden errors, invariance, refusal.

use proptest::prelude::*;
use seabearing_locate::network::model::bearing;
use seabearing_locate::network::{FixSettings, Region, Sighting, locate};

const THREE: [[f64; 3]; 3] = [[0.0, 100.0, -168.0], [86.6, -50.0, -168.0], [-86.6, -50.0, -168.0]];

fn sightings(arrays: &[[f64; 3]], source_m: [f64; 3], errors: &[(f64, f64)]) -> Vec<Sighting> {
    arrays
        .iter()
        .zip(errors)
        .map(|(array_m, (ea, eb))| {
            let (azimuth, elevation) = bearing(array_m, &source_m);
            Sighting {
                array_m: *array_m,
                azimuth: azimuth + ea,
                elevation: Some(elevation + eb),
                sd_azimuth: 0.026,
                sd_elevation: 0.028,
            }
        })
        .collect()
}

fn turned([x, y, z]: [f64; 3], angle: f64) -> [f64; 3] {
    let (s, c) = angle.sin_cos();
    [x * c + y * s, y * c - x * s, z]
}

proptest! {
    #![proptest_config(seabearing_testkit::property(48))]

    /// Turning the whole scene clockwise turns the fix, and nothing else.
    #[test]
    fn a_turned_network_gives_the_turned_fix(
        x in -600.0f64..600.0, y in -600.0f64..600.0, angle in 0.0f64..6.0,
        e in prop::array::uniform6(-0.03f64..0.03),
    ) {
        let errors = [(e[0], e[1]), (e[2], e[3]), (e[4], e[5])];
        let settings = FixSettings { region: Region::at_depth([0.0, 0.0], 5000.0, -5.0), robust: false };
        let a = locate(&sightings(&THREE, [x, y, -5.0], &errors), &settings);
        let arrays = THREE.map(|p| turned(p, angle));
        let b = locate(&sightings(&arrays, turned([x, y, -5.0], angle), &errors), &settings);
        let (a, b) = (a.unwrap(), b.unwrap());
        let p = turned(a.position_m, angle);
        let sd = a.covariance_m2[0][0].max(a.covariance_m2[1][1]).sqrt();
        prop_assert!((p[0] - b.position_m[0]).hypot(p[1] - b.position_m[1]) < 1e-2 * sd);
    }

    /// Nothing that is not finite leaves, whatever the bearings are.
    #[test]
    fn any_bearings_give_a_finite_fix_or_a_reason(
        angles in prop::array::uniform6(-1.5f64..1.5), azimuths in prop::array::uniform3(0.0f64..6.3),
        robust in any::<bool>(), depth_known in any::<bool>(),
    ) {
        let s: Vec<Sighting> = THREE.iter().zip(azimuths).zip(angles).map(|((array_m, azimuth), e)| Sighting {
            array_m: *array_m, azimuth, elevation: Some(e), sd_azimuth: 0.026, sd_elevation: 0.028,
        }).collect();
        let region = if depth_known {
            Region::at_depth([0.0, 0.0], 2000.0, -5.0)
        } else {
            Region::between([0.0, 0.0], 2000.0, (-168.0, 0.0))
        };
        if let Ok(fix) = locate(&s, &FixSettings { region, robust }) {
            prop_assert!(fix.position_m.iter().all(|x| x.is_finite()));
            prop_assert!(fix.covariance_m2.iter().flatten().all(|x| x.is_finite()));
            prop_assert!((0..3).all(|k| fix.covariance_m2[k][k] >= 0.0));
            prop_assert!(fix.position_m[0].abs() <= 2300.0 && fix.position_m[1].abs() <= 2300.0);
        }
    }

    /// The order of the arrays does not matter.
    #[test]
    fn permuted_arrays_give_the_same_fix(
        x in -500.0f64..500.0, y in -500.0f64..500.0, e in prop::array::uniform6(-0.03f64..0.03),
    ) {
        let s = sightings(&THREE, [x, y, -5.0], &[(e[0], e[1]), (e[2], e[3]), (e[4], e[5])]);
        let settings = FixSettings { region: Region::at_depth([0.0, 0.0], 2000.0, -5.0), robust: true };
        let other = [s[2], s[0], s[1]];
        let (a, b) = (locate(&s, &settings).unwrap(), locate(&other, &settings).unwrap());
        prop_assert!((a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]) < 0.05);
        // It is where the vessel is, too.
        let sd = (a.covariance_m2[0][0] + a.covariance_m2[1][1]).sqrt();
        prop_assert!((a.position_m[0] - x).hypot(a.position_m[1] - y) < 4.0 * sd, "{a:?}");
    }
}
