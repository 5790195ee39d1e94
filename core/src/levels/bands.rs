//! Where bands lie: decidecades, decades, and the cells that both are made of.
//!
//! A *decidecade* (one-third octave, base ten) of number x has the midband frequency 10^(x/10) Hz and edges 10^(∓1/20) from it
//! (IEC 61260-1:2014 with G = 10^(3/10), b = 3, and numbers counted from 1 Hz instead of 1 kHz; ISO 18405:2017). A *decade* of
//! number n lies between 10ⁿ and 10ⁿ⁺¹ Hz (ISO 18405:2017). Cell c lies between 10^((c−2)/40) and 10^((c−1)/40) Hz: four make
//! a decidecade, forty a decade, and both begin where a cell does.

use crate::math;
use core::ops::Range;

/// Cells of a decidecade.
pub const IN_DECIDECADE: i32 = 4;

/// Cells of a decade.
pub const IN_DECADE: i32 = 40;

/// Lower edge of a cell, Hz; the upper one is that of the next.
pub fn edge_hz(cell: i32) -> f64 {
    math::f64::powf(10.0, f64::from(cell - 2) / 40.0)
}

/// Middle of a cell, Hz: the geometric mean of its edges.
pub fn middle_hz(cell: i32) -> f64 {
    math::f64::powf(10.0, (f64::from(cell) - 1.5) / 40.0)
}

/// Midband frequency of a decidecade, Hz.
pub fn decidecade_hz(number: i32) -> f64 {
    math::f64::powf(10.0, f64::from(number) / 10.0)
}

/// Cells of a decidecade.
pub fn of_decidecade(number: i32) -> Range<i32> {
    IN_DECIDECADE * number..IN_DECIDECADE * (number + 1)
}

/// Cells of a decade.
pub fn of_decade(number: i32) -> Range<i32> {
    IN_DECADE * number + 2..IN_DECADE * (number + 1) + 2
}

/// Least and greatest relative attenuation, dB, of a decidecade filter of class 1 for a tone at `ratio` times its midband
/// frequency. IEC 61260-1:2014: limits are those of an octave filter at Gʰ, moved to
/// 1 + (G^(1/6) − 1)/(G^(1/2) − 1) · (Gʰ − 1) (and its inverse below the middle), and linear in ln ratio between. The numbers
/// are those of the first edition (IEC 61260:1995), which left no room for the uncertainty of a laboratory's
/// measurement and so are the narrower ones.
pub fn class_1_db(ratio: f64) -> (f64, f64) {
    // Exponent h, least, greatest.
    const LIMITS: [(f64, f64, f64); 10] = [
        (0.0, -0.3, 0.3),
        (0.125, -0.3, 0.4),
        (0.25, -0.3, 0.6),
        (0.375, -0.3, 1.3),
        (0.5, -0.3, 5.0),
        (0.5, 2.0, 5.0),
        (1.0, 17.5, f64::INFINITY),
        (2.0, 42.0, f64::INFINITY),
        (3.0, 61.0, f64::INFINITY),
        (4.0, 70.0, f64::INFINITY),
    ];
    let g = |h: f64| math::f64::powf(10.0, 0.3 * h);
    let at = |h: f64| math::f64::ln(1.0 + (g(1.0 / 6.0) - 1.0) / (g(0.5) - 1.0) * (g(h) - 1.0));
    let x = math::f64::abs(math::f64::ln(ratio));
    for ((h0, low0, high0), (h1, low1, high1)) in LIMITS.iter().zip(LIMITS.iter().skip(1)) {
        let (x0, x1) = (at(*h0), at(*h1));
        if x < x1 {
            let between = |a: f64, b: f64| if b.is_finite() { a + (x - x0) / (x1 - x0) * (b - a) } else { b };
            return (between(*low0, *low1), between(*high0, *high1));
        }
    }
    (70.0, f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_begin_and_end_where_cells_do() {
        for number in -5..50 {
            let (cells, middle) = (of_decidecade(number), decidecade_hz(number));
            let edge = 10f64.powf(0.05);
            assert!((edge_hz(cells.start) * edge / middle - 1.0).abs() < 1e-12);
            assert!((edge_hz(cells.end) / edge / middle - 1.0).abs() < 1e-12);
        }
        assert!((edge_hz(of_decade(1).start) - 10.0).abs() < 1e-12);
        assert!((edge_hz(of_decade(1).end) - 100.0).abs() < 1e-10);
        assert!((decidecade_hz(30) - 1000.0).abs() < 1e-9);
    }

    #[test]
    fn limits_of_class_1_are_those_of_the_table_for_third_octaves() {
        // Ratios as IEC 61260:1995 prints them.
        for (ratio, low, high) in [
            (1.0, -0.3, 0.3),
            (1.02667, -0.3, 0.4),
            (1.05575, -0.3, 0.6),
            (1.08746, -0.3, 1.3),
            (1.122, -0.3, 5.0),
            (1.1221, 2.0, f64::INFINITY),
            (1.29437, 17.5, f64::INFINITY),
            (1.88173, 42.0, f64::INFINITY),
            (3.05365, 61.0, f64::INFINITY),
            (5.39195, 70.0, f64::INFINITY),
            (20.0, 70.0, f64::INFINITY),
        ] {
            for ratio in [ratio, 1.0 / ratio] {
                let got = class_1_db(ratio);
                assert!((got.0 - low).abs() < 0.02, "{ratio} {got:?}");
                assert!(got.1 == high || (got.1 - high).abs() < 0.02, "{ratio} {got:?}");
            }
        }
    }
}
