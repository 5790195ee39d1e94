//! What a second vessel's noise adds to the intensity of every bin, and how far it bends the direction of a tone.
//!
//! Enters: the intensity vectors of a frame's bins. Leaves: for each bin the mean vector of the bins around it, lines left
//! out. Wideband noise of another vessel adds its own intensity b to a tone's a and turns it by about |b| sin Δ/|a|:
//! degrees, where that vessel is near and this one far. Noise power in one bin is exponentially distributed, and a direction
//! found from many frames is their median rather than their mean, so `TYPICAL` of the mean is what bends it.
//! Assumes: noise that changes little over ±2 Hz. Cost: 266 × 40 instructions a frame.

/// Intensity of a bin, east and north.
type Vector = [f32; 2];

/// Bins on either side that take part (2 Hz at 50 Hz).
const AROUND: usize = 40;

/// A bin stronger than this many times the mean power is a line and takes no part.
const LINE: f32 = 6.0;

/// Median of an exponential law over its mean.
const TYPICAL: f32 = core::f32::consts::LN_2;

/// Power over the background's at which a bin stands out: a tone, not the background itself.
const STANDS_OUT: f32 = 16.0;

fn power([east, north]: &Vector) -> f32 {
    east * east + north * north
}

/// Mean vector of the bins around each bin, in order.
#[derive(Clone, Debug)]
pub struct Background<'a> {
    bins: &'a [Vector],
    most: f32,
    next: usize,
    sum: Vector,
    count: u32,
}

impl<'a> Background<'a> {
    /// Of the bins of a frame.
    pub fn new(bins: &'a [Vector]) -> Self {
        let mut most = f32::INFINITY;
        // Each pass leaves out the lines the one before has found.
        for _ in 0..3 {
            let quiet = bins.iter().map(power).filter(|p| *p <= most);
            let (sum, n) = quiet.fold((0f32, 0u32), |(s, n), p| (s + p, n + 1));
            most = LINE * sum / n.max(1) as f32;
        }
        let mut out = Self { bins, most, next: 0, sum: [0.0; 2], count: 0 };
        (0..AROUND).for_each(|k| out.take_in(k));
        out
    }

    fn quiet(&self, k: usize) -> Option<Vector> {
        self.bins.get(k).copied().filter(|z| power(z) <= self.most)
    }

    fn take_in(&mut self, k: usize) {
        if let Some(z) = self.quiet(k) {
            self.sum.iter_mut().zip(z).for_each(|(s, x)| *s += x);
            self.count += 1;
        }
    }
}

impl Iterator for Background<'_> {
    type Item = Vector;

    fn next(&mut self) -> Option<Vector> {
        let k = self.next;
        if k >= self.bins.len() {
            return None;
        }
        self.next += 1;
        self.take_in(k + AROUND);
        if let Some(z) = k.checked_sub(AROUND + 1).and_then(|gone| self.quiet(gone)) {
            self.sum.iter_mut().zip(z).for_each(|(s, x)| *s -= x);
            self.count -= 1;
        }
        let n = self.count.max(1) as f32;
        Some(self.sum.map(|x| x / n))
    }
}

/// A bin's intensity without what bends it; `None` where it does not stand out of the background.
pub fn straightened(own: &Vector, background: &Vector) -> Option<Vector> {
    let ([x, y], [bx, by]) = (own, background);
    (power(own) > STANDS_OUT * power(background)).then_some([x - TYPICAL * bx, y - TYPICAL * by])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;
    use std::vec::Vec;

    /// Noise of one vessel to the east in every bin, a line of another to the north in bin 100.
    fn bins(seed: &mut u32) -> Vec<Vector> {
        let mut uniform = || {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((*seed >> 8) as f32 + 0.5) / 16_777_216.0
        };
        (0..266)
            .map(|k| {
                let east = -math::f32::ln(uniform());
                [east, if k == 100 { 12.0 } else { 0.0 }]
            })
            .collect()
    }

    #[test]
    fn a_line_is_straightened_in_the_median_and_left_out_of_the_mean() {
        let mut seed = 7;
        let (mut bent, mut straight) = (Vec::new(), Vec::new());
        for _ in 0..400 {
            let all = bins(&mut seed);
            let b = Background::new(&all).nth(100).unwrap();
            assert!((b[0] - 1.0).abs() < 0.5 && b[1].abs() < 1e-6, "{b:?}");
            let s = straightened(&all[100], &b).unwrap();
            bent.push(math::f32::atan2(all[100][0], all[100][1]));
            straight.push(math::f32::atan2(s[0], s[1]));
        }
        bent.sort_by(f32::total_cmp);
        straight.sort_by(f32::total_cmp);
        assert!(bent[200] > 0.045, "{}", bent[200]);
        assert!(straight[200].abs() < 0.01, "{}", straight[200]);
    }

    #[test]
    fn one_mean_a_bin_and_nothing_from_nothing() {
        let all = bins(&mut 3);
        assert_eq!(Background::new(&all).count(), all.len());
        assert_eq!(Background::new(&[]).count(), 0);
        let quiet = [[0.0; 2]; 3];
        assert!(Background::new(&quiet).all(|b| b == [0.0; 2]));
        assert_eq!(straightened(&quiet[0], &quiet[0]), None);
    }
}
