//! What a line's fit says against itself.
//!
//! In: the orientation found and what was searched. Out: a clause for each thing that makes its deviations too small: η at the end of what
//! was searched, where it is no longer free, and bearings that contradict the others, which no noise makes so many.

use seabearing_locate::orient::line::LineOrientation;

/// Part of the searched η next to an end that is the end, though its deviation is less.
const END: f64 = 0.01;
/// Share of the bearings that may contradict the others.
const MOST_WRONG: f64 = 0.1;

/// Whether η is at an end of what was searched, or its deviation reaches one; never where it was fixed.
pub fn at_limit(found: &LineOrientation, (least, greatest): (f64, f64)) -> bool {
    let near = (END * (greatest - least)).max(found.sd_eta);
    greatest > least && (found.eta <= least + near || found.eta >= greatest - near)
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

    /// A vessel that passes a line to −35°; sines by so much too large, and every so many-th wrong.
    fn found(larger: f64, wrong: usize) -> LineOrientation {
        let place = |t_s: f64| [300.0, 7.0 * t_s - 420.0, 0.0];
        let track: Vec<_> = (0..13)
            .map(|k| TrackPoint { t_s: 10.0 * f64::from(k), position_m: place(10.0 * f64::from(k)) })
            .collect();
        let bearing = |k: usize| {
            let t_s = k as f64;
            let [x, y, _] = place(t_s);
            let sine = larger * (x.atan2(y) + 35f64.to_radians()).cos() + 0.004 * (7.3 * t_s * t_s).sin();
            LineBearing { t_s, sine: if k % wrong == 5 { 0.5 - sine } else { sine.clamp(-1.0, 1.0) } }
        };
        let bearings = (0..120).map(bearing).collect();
        LineRecord::of_bearings(bearings, &SEARCH, "test".into()).fit(&track).unwrap()
    }

    #[test]
    fn a_line_as_told_is_not_doubted_and_another_spacing_and_wrong_bearings_are() {
        let well = found(1.0, usize::MAX);
        assert!(doubts(&well, SEARCH.eta).is_empty(), "{well:?}");
        let spacing = found(0.75 / 0.70, usize::MAX);
        assert!(at_limit(&spacing, SEARCH.eta) && doubts(&spacing, SEARCH.eta).len() == 1, "{spacing:?}");
        let wrong = found(1.0, 7);
        let said = doubts(&wrong, SEARCH.eta);
        assert!(said.len() == 1 && said[0].contains("contradict"), "{said:?} {wrong:?}");
        assert!(!at_limit(&LineOrientation { eta: 1.0, ..well }, (1.0, 1.0)));
    }
}
