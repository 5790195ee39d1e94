//! The frequency at which a source is heard within a band.
//!
//! A phase from sensor to sensor is `2π d f ξ/c` with the frequency that was heard: a tone beside the band's middle, read at the
//! middle, has its sine scaled by `f/f₀`. In: of each transform with a window h its value x at the band's frequency, and y, the same
//! with `i h'/(2π)` for a window: of a tone ν above the middle, y = ν x (the derivative of the window, as in the reassignment of
//! Auger and Flandrin 1995). Out: `Σ Re(y x*)/Σ |x|²` towards the source, the mean of ν over its power within the band, which is
//! what a covariance's phases go by. Steered to each source with nothing of the others. Noise falls on both sides of the middle
//! alike: it is taken off the denominator, and scatters the numerator. Cost: two steered sums a snapshot.

use super::complex::{Complex, unit};
use super::music::{LineArrival, LinePlan};
use super::{MAX_SENSORS, MAX_SOURCES};
use crate::math::f64 as m;

/// Part of a steering vector's power that must be left beside the other sources'.
const LEAST_LEFT: f64 = 0.05;

/// How far from the band's frequency a source is heard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// Offset, Hz.
    pub offset_hz: f64,
    /// Its standard deviation, Hz.
    pub sd_hz: f64,
}

/// A transform of all sensors: its values, and those with `i h'/(2π)` for a window, 1/s.
pub type WithSlope<'a> = (&'a [Complex; MAX_SENSORS], &'a [Complex; MAX_SENSORS]);

impl LinePlan {
    /// Where within the band source `of` of `arrivals` is heard, from transforms with their weights (any sum) of which `snapshots`
    /// are independent. `width_hz`: the root mean square of the offset over the window's response, `(∫h'²/∫h²)^½/(2π)`; that is
    /// stated where it cannot be measured, with no offset.
    pub fn heard<'a>(
        &self,
        arrivals: &[LineArrival],
        of: usize,
        transforms: impl Iterator<Item = (f64, WithSlope<'a>)>,
        snapshots: f64,
        width_hz: f64,
    ) -> Heard {
        let unknown = Heard { offset_hz: 0.0, sd_hz: width_hz };
        let Some(snr) = arrivals.get(of).map(|a| a.snr) else { return unknown };
        let Some(towards) = self.alone(arrivals, of) else { return unknown };
        let (mut product, mut power) = (0.0, 0.0);
        for (weight, (x, y)) in transforms {
            let steered = |x: &[Complex; MAX_SENSORS]| {
                x.iter().zip(&towards).fold(Complex::ZERO, |sum, (x, w)| sum + *x * w.conj())
            };
            let (x, y) = (steered(x), steered(y));
            if x.norm_sqr().is_finite() && y.norm_sqr().is_finite() {
                product += weight * (y * x.conj()).re;
                power += weight * x.norm_sqr();
            }
        }
        // Of the steered sum, over the source's.
        let noise = towards.iter().map(|w| w.norm_sqr()).sum::<f64>() / snr;
        let offset_hz = product * (1.0 + noise) / power;
        let squares = width_hz * width_hz + offset_hz * offset_hz;
        let sd_hz = m::sqrt(squares * noise * (1.0 + noise) / (2.0 * snapshots));
        if sd_hz < width_hz && offset_hz.is_finite() { Heard { offset_hz, sd_hz } } else { unknown }
    }

    /// Weights whose sum is one towards a source and zero towards the others; `None` where they are not told apart.
    fn alone(&self, arrivals: &[LineArrival], of: usize) -> Option<[Complex; MAX_SENSORS]> {
        let steering = |a: &LineArrival| {
            let mut out = [Complex::ZERO; MAX_SENSORS];
            for (k, v) in out.iter_mut().enumerate().take(self.sensors) {
                *v = unit(self.phase * a.sine * k as f64);
            }
            out
        };
        let size = |x: &[Complex; MAX_SENSORS]| x.iter().map(|v| v.norm_sqr()).sum::<f64>();
        // The others, made square to each other (Gram and Schmidt), then taken out.
        let mut others = [[Complex::ZERO; MAX_SENSORS]; MAX_SOURCES];
        let mut n = 0;
        let least = LEAST_LEFT * self.sensors as f64;
        for (_, other) in arrivals.iter().enumerate().filter(|(k, _)| *k != of) {
            let left = without(steering(other), others.get(..n)?);
            if size(&left) > least {
                *others.get_mut(n)? = left;
                n += 1;
            }
        }
        let mut own = without(steering(arrivals.get(of)?), others.get(..n)?);
        // Towards the source the sum of what is left is its own power.
        let power = size(&own);
        own.iter_mut().for_each(|v| *v = v.scale(1.0 / power));
        (power > least).then_some(own)
    }
}

/// A vector without what it has of others, which are square to each other.
fn without(mut x: [Complex; MAX_SENSORS], others: &[[Complex; MAX_SENSORS]]) -> [Complex; MAX_SENSORS] {
    for other in others {
        let (mut along, mut power) = (Complex::ZERO, 0.0);
        for (x, o) in x.iter().zip(other) {
            along += *x * o.conj();
            power += o.norm_sqr();
        }
        for (x, o) in x.iter_mut().zip(other) {
            *x -= (along * *o).scale(1.0 / power);
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH_HZ: f64 = 9.0;

    fn plan() -> LinePlan {
        LinePlan::new(16, 0.9, 450.0, 1484.0, 5, 0.4, 2).unwrap()
    }

    /// Snapshots of sources (sine, offset, power) in noise of variance one, with their slopes.
    fn snapshots(sources: &[(f64, f64, f64)], n: usize) -> std::vec::Vec<[[Complex; MAX_SENSORS]; 2]> {
        let mut seed = 7u32;
        let mut normal = || {
            let mut sum = -6.0;
            for _ in 0..12 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += f64::from(seed >> 8) / f64::from(1u32 << 24);
            }
            sum * m::sqrt(0.5)
        };
        (0..n)
            .map(|_| {
                let mut out = [[Complex::ZERO; MAX_SENSORS]; 2];
                for (sine, offset, power) in sources {
                    let loud = Complex::new(normal(), normal()).scale(m::sqrt(*power));
                    for k in 0..16 {
                        let x = loud * unit(plan().phase * sine * k as f64);
                        out[0][k] += x;
                        out[1][k] += x.scale(*offset);
                    }
                }
                for k in 0..16 {
                    out[0][k] += Complex::new(normal(), normal());
                    out[1][k] += Complex::new(normal(), normal()).scale(WIDTH_HZ);
                }
                out
            })
            .collect()
    }

    fn heard(sources: &[(f64, f64, f64)], of: usize, part: &[[[Complex; MAX_SENSORS]; 2]]) -> Heard {
        let arrivals: std::vec::Vec<_> = sources
            .iter()
            .map(|(sine, _, power)| LineArrival { sine: *sine, sd: 0.01, snr: *power })
            .collect();
        let transforms = part.iter().map(|[x, y]| (0.3, (x, y)));
        plan().heard(&arrivals, of, transforms, part.len() as f64, WIDTH_HZ)
    }

    #[test]
    fn a_tone_is_heard_where_it_is_and_the_deviation_holds() {
        let sources = [(0.4, -6.0, 0.5)];
        let all = snapshots(&sources, 40 * 200);
        let (mut sum, mut squares) = (0.0, 0.0);
        for part in all.chunks(40) {
            let Heard { offset_hz, sd_hz } = heard(&sources, 0, part);
            sum += (offset_hz + 6.0) / sd_hz / 200.0;
            squares += (offset_hz + 6.0).powi(2) / (sd_hz * sd_hz) / 200.0;
        }
        assert!(sum.abs() < 0.3 && (0.7..1.4).contains(&squares), "{sum} {squares}");
    }

    #[test]
    fn two_tones_are_each_heard_by_themselves() {
        let sources = [(0.4, -3.0, 2.0), (-0.2, 5.0, 8.0)];
        let all = snapshots(&sources, 60);
        for (of, (_, offset, _)) in sources.iter().enumerate() {
            let found = heard(&sources, of, &all);
            assert!((found.offset_hz - offset).abs() < 4.0 * found.sd_hz, "{of} {found:?}");
        }
        // In one direction nothing tells them apart.
        let one = [(0.4, -3.0, 2.0), (0.401, 5.0, 8.0)];
        assert_eq!(heard(&one, 0, &all), Heard { offset_hz: 0.0, sd_hz: WIDTH_HZ });
        assert_eq!(heard(&[(0.4, 0.0, 1e-4)], 0, &all).sd_hz, WIDTH_HZ);
    }
}
