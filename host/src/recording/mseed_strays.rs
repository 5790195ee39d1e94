//! Records whose header names another station or rate than nearly all others of the channel: damage, which costs them alone.
//!
//! Enters: a channel's records by source and rate. Leaves: those that belong together; what was left out is named. Two stations' files, or
//! files of two rates, are left as they are: which is meant only a person can say.

use super::complain;
use super::mseed_scan::{Stretch, same_clock};

/// Of so many records one may be a stray.
const OF: usize = 50;

/// Records of a channel without strays.
pub(super) fn without_strays(code: &str, mut stretches: Vec<Stretch>) -> Vec<Stretch> {
    let all: usize = stretches.iter().map(|s| s.pieces.len()).sum();
    let Some(most) = stretches.iter().max_by_key(|s| s.pieces.len()) else { return stretches };
    let (source, rate_hz) = (most.source.clone(), most.rate_hz);
    let (mut left_out, mut named) = (0, String::new());
    stretches.retain(|s| {
        let is_other = s.source != source || !same_clock(s.rate_hz, rate_hz);
        let stray = is_other && !s.pieces.is_empty() && OF * s.pieces.len() <= all;
        if stray {
            left_out += s.pieces.len();
            named = format!("{} at {} Hz", s.source, s.rate_hz);
        }
        !stray
    });
    if left_out > 0 {
        complain(&format!(
            "component {code}: {left_out} of {all} records left out, whose headers say another station or rate ({named}; the others \
             {source} at {rate_hz} Hz)"
        ));
    }
    stretches
}

#[cfg(test)]
mod tests {
    use super::super::mseed_scan::{Form, Piece};
    use super::*;

    fn stretch(source: &str, rate_hz: f64, records: usize) -> Stretch {
        let piece = Piece {
            file: 0,
            form: Form::MiniSeed,
            offset: 0,
            bytes: 512,
            start_ns: 0,
            first: 0,
            samples: 100,
        };
        Stretch { source: source.into(), rate_hz, pieces: vec![piece; records] }
    }

    #[test]
    fn one_damaged_header_costs_its_record_and_two_stations_stay_two() {
        // A clock that is told twice, a letter and a rate damaged.
        let drifting = [50.0, 50.001].map(|rate_hz| stretch("XX.RR03.", rate_hz, 50)).into_iter();
        let damaged = [stretch("XX.R003.", 50.0, 1), stretch("XX.RR03.", 3500.0, 1)];
        let kept = without_strays("BDH", drifting.chain(damaged).collect());
        assert!(kept.len() == 2 && kept.iter().all(|s| s.source == "XX.RR03." && s.rate_hz < 51.0));
        for (source, rate_hz, records) in [("XX.RR04.", 50.0, 3), ("XX.RR03.", 100.0, 3)] {
            let two = vec![stretch("XX.RR03.", 50.0, 100), stretch(source, rate_hz, records)];
            assert_eq!(without_strays("BDH", two).len(), 2);
        }
        assert_eq!(without_strays("BDH", vec![stretch("a", 50.0, 5), stretch("b", 50.0, 1)]).len(), 2);
    }
}
