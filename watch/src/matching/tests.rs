use super::*;
use crate::report::TrackId;
use seabearing_host::ais::AisReport;

const HERE: (f64, f64) = (50.0, -1.0);

/// Vessels that go North at 7 m/s so far East of the station, a report every 30 s; `late_s`: how long after the others.
fn fleet(courses: &[(u64, f64, f64)]) -> Fleet {
    let frame = LocalFrame::new(HERE.0, HERE.1);
    let mut reports = Vec::new();
    for (mmsi, east_m, late_s) in courses {
        for k in 0..60 {
            let t_s = 30.0 * f64::from(k) + 0.5;
            let lat_lon_deg = frame.lat_lon_deg(*east_m, 7.0 * (t_s - 900.0 - late_s));
            let none = AisReport {
                mmsi: *mmsi,
                t_s,
                lat_lon_deg,
                speed_m_s: None,
                status: None,
                ship_type: None,
                terrestrial: None,
                length_m: None,
            };
            reports.push(none);
        }
    }
    Fleet::of(&reports, &BTreeMap::new())
}

/// A track that goes North like them, with such a standard deviation, from 600 to 1200 s.
fn track(id: u16, east_m: f64, late_s: f64, sd_m: f64) -> Heard {
    let which = VesselId::Track(TrackId { station: Some(1), session: Some(1), id });
    let reports = (0..20).map(|k| 600.0 + 30.0 * f64::from(k)).map(|t_s| TrackReport {
        vessel: which,
        station: Some(1),
        is_final: false,
        is_withdrawn: false,
        utc_s: Some((t_s, Some(0.1))),
        place: Some((
            (east_m, 7.0 * (t_s - 900.0 - late_s)),
            Covariance { xx: sd_m * sd_m, yy: sd_m * sd_m, xy: 0.0 },
        )),
        heading_rad: Some((0.0, 0.05)),
        speed_m_s: Some((7.0, 0.5)),
        cpa_utc_s: None,
        cpa_range_m: None,
    });
    Heard {
        vessel: which,
        stations: vec![Some(1)],
        frame: LocalFrame::new(HERE.0, HERE.1),
        reports: reports.collect(),
    }
}

fn numbers(tracks: &[Heard], fleet: &Fleet) -> Vec<Option<u64>> {
    let number = |v: Verdict| match v {
        Verdict::Vessel { vessel, .. } => Some(fleet.vessels[vessel].mmsi),
        _ => None,
    };
    judge(tracks, fleet, &Rules::default()).into_iter().map(number).collect()
}

#[test]
fn the_vessel_is_found_in_space_and_in_time() {
    let fleet = fleet(&[(11, 500.0, 0.0), (12, 500.0, 200.0), (13, -800.0, 0.0)]);
    let found = numbers(
        &[track(1, 520.0, 0.0, 30.0), track(2, 490.0, 200.0, 30.0), track(3, -790.0, 2.0, 30.0)],
        &fleet,
    );
    assert_eq!(found, [Some(11), Some(12), Some(13)]);
}

#[test]
fn a_vessel_that_does_not_report_is_dark_and_not_its_neighbour() {
    let fleet = fleet(&[(11, 500.0, 0.0)]);
    let found = judge(&[track(1, -900.0, 0.0, 30.0)], &fleet, &Rules::default());
    assert!(matches!(found[0], Verdict::Dark { probability } if probability > 0.99), "{found:?}");
    // Beside a track that is the vessel for certain, another at the same time is not.
    let found = judge(&[track(1, 500.0, 0.0, 30.0), track(2, 640.0, 0.0, 60.0)], &fleet, &Rules::default());
    assert!(matches!(found[0], Verdict::Vessel { vessel: 0, .. }), "{found:?}");
    assert!(matches!(found[1], Verdict::Dark { .. }), "{found:?}");
}

#[test]
fn what_cannot_be_said_is_not_said_and_why() {
    let two = fleet(&[(11, 500.0, 0.0), (12, 530.0, 0.0)]);
    let reason = |tracks: &[Heard], fleet: &Fleet| match judge(tracks, fleet, &Rules::default()).remove(0) {
        Verdict::Unmatched(reason) => reason,
        other => panic!("{other:?}"),
    };
    assert_eq!(reason(&[track(1, 515.0, 0.0, 40.0)], &two), "ambiguous: 11 or 12");
    let one = fleet(&[(11, 500.0, 0.0)]);
    assert!(
        reason(&[track(1, 500.0, 0.0, 10_000.0)], &one)
            .starts_with("too uncertain: its place is known to 10000 m")
    );
    let mut late = track(1, 500.0, 0.0, 30.0);
    late.reports.iter_mut().for_each(|r| r.utc_s = Some((90_000.0, None)));
    assert_eq!(reason(&[late], &one), "no vessel reported at that time");
    let mut short = track(1, 500.0, 0.0, 30.0);
    short.reports.truncate(2);
    assert_eq!(reason(&[short.clone()], &one), "too short: its places are those of 30 s");
    // Of nobody's, either.
    short.reports.iter_mut().for_each(|r| r.place.as_mut().unwrap().0.0 = -900.0);
    assert_eq!(reason(&[short], &one), "too short: its places are those of 30 s");
    let mut blind = track(1, 500.0, 0.0, 30.0);
    blind.reports.iter_mut().for_each(|r| r.place = None);
    assert_eq!(reason(&[blind], &one), "its range is not observable");
}

#[test]
fn tracks_side_by_side_share_the_vessels_out() {
    // Each track alone might be either; together they are told apart.
    let fleet = fleet(&[(11, 500.0, 0.0), (12, 700.0, 0.0)]);
    let found = numbers(&[track(1, 540.0, 0.0, 40.0), track(2, 690.0, 0.0, 40.0)], &fleet);
    assert_eq!(found, [Some(11), Some(12)]);
    // Pieces of one vessel's passage one after the other are all its own.
    let (mut first, mut second) = (track(1, 500.0, 0.0, 30.0), track(2, 500.0, 0.0, 30.0));
    first.reports.truncate(10);
    second.reports.drain(..10);
    assert_eq!(numbers(&[first, second], &fleet), [Some(11), Some(11)]);
}

#[test]
fn one_that_goes_along_ahead_is_told_by_how_the_line_of_sight_turns() {
    // 500 m ahead of the only vessel that reports, which is 1.7 standard deviations: now farther away, now nearer than it is.
    let fleet = fleet(&[(11, 1500.0, 0.0)]);
    let ahead = track(1, 1500.0, -500.0 / 7.0, 300.0);
    assert_eq!(numbers(&[ahead], &fleet), [None]);
    // An error as large that stays, as of a speed of sound or an orientation, is no other vessel.
    let mut wrong = track(1, 1500.0, 0.0, 300.0);
    for report in &mut wrong.reports {
        let Some(((x, y), _)) = &mut report.place else { continue };
        let longer = 1.0 + 500.0 / x.hypot(*y);
        (*x, *y) = (*x * longer, *y * longer);
    }
    assert_eq!(numbers(&[wrong], &fleet), [Some(11)]);
}

#[test]
fn withdrawn_tracks_and_undated_reports_are_left_out() {
    let mut reports = track(1, 0.0, 0.0, 10.0).reports;
    let mut other = track(2, 0.0, 0.0, 10.0).reports;
    other[5].is_withdrawn = true;
    reports[0].utc_s = None;
    reports.extend(other);
    let (tracks, left_out) = heard(reports, &[(Some(1), HERE)].into());
    assert_eq!((tracks.len(), tracks[0].reports.len(), left_out), (1, 19, 1));
}
