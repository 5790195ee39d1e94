//! The ocean-bottom board's samples on the host: a recording as its converters hear it.

use seabearing_board_model::ads131m04::Codes;
use seabearing_core::config_blob;
use seabearing_firmware::seismic::Conversion;
use seabearing_firmware::seismic::decimate::{FACTOR, HALF, between};
use std::collections::VecDeque;

/// Bits a second of that board's line.
pub const BAUD: u32 = 115_200;

/// How the samples of a station are made on the ocean-bottom board; `None`: it is none of its.
pub fn conversion(blob: &[u8]) -> Option<Conversion> {
    Conversion::of(config_blob::station(blob).ok()?.rate_hz)
}

/// Samples at the recorder's rate as the converters have them at theirs: every one of the recorder's once more, and four between
/// it and the next that have nothing above the recorder's band.
pub fn heard(
    conversion: Conversion,
    mut source: impl FnMut() -> Option<Codes> + Send + 'static,
) -> Box<dyn FnMut() -> Option<Codes> + Send> {
    /// Samples on either side that have their part.
    const REACH: usize = (HALF / FACTOR) as usize;
    if !conversion.decimated {
        return Box::new(source);
    }
    // The one in the middle is the newest that was reached.
    let mut about: VecDeque<Codes> = VecDeque::from(vec![[0; 4]; REACH + 1]);
    about.extend((0..REACH).map_while(|_| source()));
    let (mut phase, mut left) = (0, 0);
    Box::new(move || {
        if phase == 0 {
            about.pop_front();
            match source() {
                Some(codes) => about.push_back(codes),
                // What comes after the last is silence.
                None => {
                    left += 1;
                    about.push_back([0; 4]);
                }
            }
        }
        if left > REACH || about.len() <= 2 * REACH {
            return None;
        }
        let code = |channel: usize| {
            let part = |(n, codes): (usize, &Codes)| {
                let distance = (FACTOR as i64 * (n as i64 - REACH as i64) - phase as i64).unsigned_abs();
                between(distance) * f64::from(codes[channel])
            };
            about.iter().enumerate().map(part).sum::<f64>().round() as i32
        };
        let codes = std::array::from_fn(code);
        phase = (phase + 1) % FACTOR;
        Some(codes)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_firmware::seismic::chips::Rate;

    #[test]
    fn the_converters_hear_each_sample_where_it_is_and_a_smooth_line_between() {
        let tone = |n: f64| (1e6 * (std::f64::consts::TAU * 7.0 * n / 50.0).sin()).round() as i32;
        let mut n = 0;
        let source = move || {
            n += 1;
            (n <= 200).then(|| [tone(f64::from(n - 1)), 0, 0, 5])
        };
        let mut heard = heard(Conversion { rate: Rate::Sps250, decimated: true }, source);
        let all: Vec<Codes> = std::iter::from_fn(&mut heard).collect();
        assert_eq!(all.len(), 1000);
        for (n, codes) in all.iter().enumerate().skip(100).take(800) {
            let expected = tone(n as f64 / 5.0);
            assert!((codes[0] - expected).abs() < 500, "{n}: {} {expected}", codes[0]);
        }
        assert_eq!(all[500][3], 5);
    }
}
