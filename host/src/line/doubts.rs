//! What a line's fit says against itself.
//!
//! In: the orientation found and what was searched. Out: a clause for each thing that makes its deviations too small: η or the clock's shift
//! at the end of what was searched, where it is no longer free; bearings that contradict the others, which no noise makes so many; and
//! bearings that miss the track for parts of the pass by more than they scatter and tracks are usually off by.

use seabearing_locate::orient::line::LineOrientation;

/// Part of the searched η next to an end that is the end, though its deviation is less.
const END: f64 = 0.01;
/// The same of the shift, and the deviations that reach there.
const END_SHIFT: f64 = 0.05;
const REACH_SD: f64 = 2.0;
/// How often the scatter of successive bearings what lasts may be, and what a track is off by for long, metres, as for compact arrays.
const BEYOND_SCATTER: f64 = 5.0;
const TRACK_M: f64 = 3.0;
/// Share of the bearings that may contradict the others.
const MOST_WRONG: f64 = 0.1;

/// Whether η is at an end of what was searched, or its deviation reaches one; never where it was fixed.
pub fn at_limit(found: &LineOrientation, (least, greatest): (f64, f64)) -> bool {
    let near = (END * (greatest - least)).max(found.sd_eta);
    greatest > least && (found.eta <= least + near || found.eta >= greatest - near)
}

/// Whether the shift is at an end of what was searched, or its deviation reaches one; never where it was fixed, or is as likely none.
fn shift_at_limit(found: &LineOrientation) -> bool {
    let (least, greatest) = found.searched_s;
    let reach = REACH_SD * found.sd_time_shift_s;
    let known = if found.time_shift_s.abs() > reach { reach } else { 0.0 };
    let near = (0.5 * END_SHIFT * (greatest - least)).max(known);
    greatest > least && (found.time_shift_s <= least + near || found.time_shift_s >= greatest - near)
}

/// The clauses.
pub fn doubts(found: &LineOrientation, limits: (f64, f64)) -> Vec<String> {
    let mut all = Vec::new();
    if at_limit(found, limits) {
        all.push(format!(
            "η, {:.3}, is at the end of what was searched (--eta {} {}): are spacing_m, the speed of sound or the vessel's depth others?",
            found.eta, limits.0, limits.1
        ));
    }
    if shift_at_limit(found) {
        all.push(format!(
            "the clocks' shift, {:.1} s, is at the end of what was searched, {:.1} s: are the track's times others? (--max-shift-s)",
            found.time_shift_s,
            found.searched_s.0.abs().max(found.searched_s.1.abs())
        ));
    }
    if found.lasting > (BEYOND_SCATTER * found.successive).hypot(TRACK_M / found.range_m) {
        all.push(format!(
            "bearings miss the track by {:.3} in sine for a tenth of the pass on end, and scatter by {:.3}: is it another vessel's track, are its \
             times others, or is the line bent?",
            found.lasting, found.successive
        ));
    }
    let bearings = found.n + found.wrong;
    if found.wrong as f64 > MOST_WRONG * bearings as f64 {
        all.push(format!(
            "{} of {bearings} bearings contradict the others: are sensors exchanged, the track's times others, or was another vessel \
             heard alone?",
            found.wrong
        ));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::orientation::known_vessel::{LineRecord, LineSearch};
    use seabearing_locate::network::known_track::TrackPoint;
    use seabearing_locate::orient::line::LineBearing;

    const SEARCH: LineSearch =
        LineSearch { max_shift_s: None, free_shift: false, eta: (0.97, 1.03), gap_s: 60.0 };

    /// A vessel that passes a line to −35°; sines by so much too large, every so many-th wrong, and by a clock that is so late.
    fn found(larger: f64, wrong: usize, late_s: f64) -> LineOrientation {
        let place = |t_s: f64| [300.0, 7.0 * t_s - 420.0, 0.0];
        let track: Vec<_> = (-6..19)
            .map(|k| TrackPoint { t_s: 10.0 * f64::from(k), position_m: place(10.0 * f64::from(k)) })
            .collect();
        let bearing = |k: usize| {
            let t_s = k as f64;
            let [x, y, _] = place(t_s - late_s);
            let sine = larger * (x.atan2(y) + 35f64.to_radians()).cos() + 0.004 * (7.3 * t_s * t_s).sin();
            LineBearing { t_s, sine: if k % wrong == 5 { 0.5 - sine } else { sine.clamp(-1.0, 1.0) } }
        };
        let bearings = (0..120).map(bearing).collect();
        LineRecord::of_bearings(bearings, &SEARCH, "test".into()).fit(&track).unwrap()
    }

    #[test]
    fn a_line_as_told_is_not_doubted_and_another_spacing_and_wrong_bearings_are() {
        let well = found(1.0, usize::MAX, 0.0);
        assert!(doubts(&well, SEARCH.eta).is_empty(), "{well:?}");
        let spacing = found(0.75 / 0.70, usize::MAX, 0.0);
        let said = doubts(&spacing, SEARCH.eta);
        assert!(
            at_limit(&spacing, SEARCH.eta) && said.iter().any(|s| s.contains("spacing_m")),
            "{spacing:?}"
        );
        let wrong = found(1.0, 7, 0.0);
        let said = doubts(&wrong, SEARCH.eta);
        assert!(said.len() == 1 && said[0].contains("contradict"), "{said:?} {wrong:?}");
        assert!(!at_limit(&LineOrientation { eta: 1.0, ..well }, (1.0, 1.0)));
    }

    #[test]
    fn a_clock_farther_off_than_searched_is_doubted_and_one_within_is_not() {
        assert!(doubts(&found(1.0, usize::MAX, 8.0), SEARCH.eta).is_empty());
        for late_s in [20.0, 30.0, -20.0] {
            let late = found(1.0, usize::MAX, late_s);
            let said = doubts(&late, SEARCH.eta).join(" ");
            assert!(shift_at_limit(&late) && said.contains("--max-shift-s"), "{late_s}: {said} {late:?}");
        }
    }

    #[test]
    fn another_course_is_doubted_within_the_shifts_that_were_searched() {
        let well = found(1.0, usize::MAX, 0.0);
        // As of the pass of `found`, with what an array that is bent or hears another vessel leaves.
        let lasts = LineOrientation { lasting: 0.05, ..well };
        let said = doubts(&lasts, SEARCH.eta);
        assert!(said.len() == 1 && said[0].contains("on end"), "{said:?}");
    }
}
