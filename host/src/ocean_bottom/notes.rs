//! Notes of whales: the part of a call that is short in a band of its own, and where such parts stand in a window.
//!
//! Enters: analytic pressure of a window, cut to the kind's band. Leaves: the samples at which notes peak, and the step between them.
//!
//! - Fin whales' calls are notes of a second about 20 Hz every 8 to 45 s.
//! - Antarctic blue whales' calls last 20 s and come a minute or so apart: about ten seconds at 24 to 28 Hz, two in which the call falls to
//!   19 Hz, and ten seconds there. Between the two tones the fall alone is heard, which is as short as a fin whale's note.
//!
//! - A note peaks 6 dB above the median power, the greatest first, none within [`Kind::apart_s`] of another.
//! - It is a fall where the call goes on before and after it: half of eight seconds on either side has a quarter of its power over the median in the band of both.
//!   A fin whale's note goes on on neither.

use crate::propagation::Complex;
use seabearing_core::kit::quantile;

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// Whose, as records name it.
    pub name: &'static str,
    /// Frequencies of its notes, Hz; the filter's edges are 1 Hz beyond.
    pub band_hz: (f64, f64),
    /// Half the length of a note, s.
    pub half_s: f64,
    /// Half a window, s.
    pub half_window_s: f64,
    /// Notes nearer to each other than this are one call's arrivals, s: longer than the longest delay of its strong paths.
    pub apart_s: f64,
    /// Least and greatest step from note to note, s.
    pub steps_s: (f64, f64),
    /// Nearest range told, m: nearer, delays hardly change with range, and the next cycle fits nearly as well.
    pub nearest_m: f64,
    /// Whether the call goes on before and after the note.
    pub goes_on: bool,
}

/// Fin whales.
pub const FIN: Kind = Kind {
    name: "fin",
    band_hz: (15.0, 25.0),
    half_s: 0.6,
    half_window_s: 90.0,
    apart_s: 8.0,
    steps_s: (8.0, 45.0),
    nearest_m: 2_700.0,
    goes_on: false,
};

/// Antarctic blue whales, by the fall between their tones.
pub const BLUE: Kind = Kind {
    name: "blue",
    band_hz: (19.8, 23.2),
    half_s: 0.9,
    half_window_s: 180.0,
    apart_s: 16.0,
    steps_s: (40.0, 120.0),
    nearest_m: 2_700.0,
    goes_on: true,
};

/// All kinds.
pub const KINDS: [Kind; 2] = [FIN, BLUE];

/// Peak power of a note over the median, times.
const STANDS_OUT: f64 = 4.0;
/// Half the length over which power is smoothed, s.
const SMOOTH_S: f64 = 0.4;
/// What is looked at before and after a note, s, the power against the note's, both over the median, that counts as its call, and the share of the time that has it.
const ABOUT_S: f64 = 8.0;
const GOES_ON: f64 = 0.25;
const MOSTLY: f64 = 0.5;

/// Power, smoothed.
fn power(pressure: &[Complex<f64>], rate_hz: f64) -> Vec<f64> {
    let half = (SMOOTH_S * rate_hz) as usize;
    let sums: Vec<f64> = std::iter::once(0.0)
        .chain(pressure.iter().scan(0.0, |sum, p| {
            *sum += p.norm_sqr();
            Some(*sum)
        }))
        .collect();
    let n = pressure.len();
    (0..n)
        .map(|i| {
            let (a, b) = (i.saturating_sub(half), (i + half + 1).min(n));
            (sums[b] - sums[a]) / (b - a) as f64
        })
        .collect()
}

/// Whether a call goes on before and after an instant, by the power of all of it.
fn goes_on(whole: &[f64], median: f64, at: usize, rate_hz: f64) -> [bool; 2] {
    let about = (ABOUT_S * rate_hz) as usize;
    let least = median + GOES_ON * (whole[at] - median);
    let mostly = |span: &[f64]| span.iter().filter(|p| **p > least).count() as f64 > MOSTLY * about as f64;
    [mostly(&whole[at.saturating_sub(about)..at]), mostly(&whole[at..(at + about).min(whole.len())])]
}

impl Kind {
    /// Samples at which notes peak, in order. `whole` is the pressure in the band of all kinds.
    pub fn notes(&self, pressure: &[Complex<f64>], whole: &[Complex<f64>], rate_hz: f64) -> Vec<usize> {
        let own = power(pressure, rate_hz);
        let whole = power(whole, rate_hz);
        let medians = [&own, &whole].map(|power| quantile::median(&mut power.clone()));
        let [Some(median), Some(of_whole)] = medians else { return Vec::new() };
        let mut order: Vec<usize> = (0..own.len()).filter(|i| own[*i] > STANDS_OUT * median).collect();
        order.sort_by(|a, b| own[*b].total_cmp(&own[*a]));
        let apart = (self.apart_s * rate_hz) as usize;
        let mut out: Vec<usize> = Vec::new();
        for i in order {
            if out.iter().all(|o| o.abs_diff(i) > apart) {
                out.push(i);
            }
        }
        out.sort_unstable();
        // An earthquake or a T phase stands out as well, but not as notes do: they are short and alike.
        let strongest = out.iter().map(|i| own[*i]).fold(0.0, f64::max);
        out.retain(|i| own[*i] > 0.1 * strongest);
        let long = own.iter().filter(|p| **p > 0.25 * strongest).count() as f64 / rate_hz;
        if long > 8.0 * out.len() as f64 {
            return Vec::new();
        }
        out.retain(|i| goes_on(&whole, of_whole, *i, rate_hz) == [self.goes_on; 2]);
        out
    }

    /// The interval of notes that come steadily, s.
    pub fn interval_s(notes: &[usize], rate_hz: f64) -> Option<f64> {
        let mut steps: Vec<f64> = notes.windows(2).map(|w| (w[1] - w[0]) as f64 / rate_hz).collect();
        let middle = quantile::median(&mut steps)?;
        // A note may be missing between two; most steps must agree.
        let near: Vec<f64> = steps.iter().copied().filter(|s| (s - middle).abs() < 0.15).collect();
        (2 * near.len() > steps.len()).then(|| near.iter().sum::<f64>() / near.len() as f64)
    }
}
