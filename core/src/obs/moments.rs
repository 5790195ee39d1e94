//! Powers of the four components and their products with each other in the band of vessels' noise, hop by hop: what a station
//! checks its own set-up with (`checks`).
//!
//! Enters: codes of all four components at the recording's rate. Leaves: sums over a hop of the products of what a band-pass
//! of second order about 16 Hz lets through (half its power from 10 to 26 Hz), which keeps out the microseism and any offset.
//! Instants in which a channel is [`LIMIT`] deviations off do not count: a spike of all channels at once, too long to be put right, would make
//! components that hear nothing go together. Cost: 80 instructions an instant.

use crate::block::{CHANNELS, Frame};
use crate::math;

/// Middle of the band, Hz; lower where the rate does not reach so far.
const CENTRE_HZ: f32 = 16.0;

/// Highest middle, cycles a sample.
const MOST: f32 = 0.32;

/// Largest value that counts, in standard deviations of the hop before (of Gaussian noise one instant of 370 has more), the part of a hop's
/// instants from which on the sound has grown louder, and least limit, codes.
const LIMIT: f32 = 3.0;
const LOUDER: u32 = 8;
const LEAST: f32 = 1.0;

/// The filter: `H(z) = b (1 − z⁻²) / (1 + a₁ z⁻¹ + a₂ z⁻²)`, quality 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct BandPass {
    b: f32,
    a1: f32,
    a2: f32,
}

impl BandPass {
    /// Lets nothing through; all zeros.
    pub(super) const EMPTY: Self = Self { b: 0.0, a1: 0.0, a2: 0.0 };

    /// For a rate, Hz.
    pub(super) fn new(rate_hz: f32) -> Self {
        let (sin, cos) = math::f32::sin_cos(math::f32::TAU * (CENTRE_HZ / rate_hz).min(MOST));
        let alpha = 0.5 * sin;
        let a0 = 1.0 + alpha;
        Self { b: alpha / a0, a1: -2.0 * cos / a0, a2: (1.0 - alpha) / a0 }
    }
}

/// Sums over instants.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Moments {
    /// Power of pressure, north, east, vertical.
    pub(super) power: [f32; CHANNELS],
    /// Products with pressure; the first is its power again.
    pub(super) with_pressure: [f32; CHANNELS],
    /// Product of north and east.
    pub(super) north_east: f32,
    /// Products of north and east with vertical.
    pub(super) with_vertical: [f32; 2],
    /// Instants.
    pub(super) instants: u32,
}

impl Moments {
    /// Of nothing.
    pub(super) const NONE: Self = Self {
        power: [0.0; CHANNELS],
        with_pressure: [0.0; CHANNELS],
        north_east: 0.0,
        with_vertical: [0.0; 2],
        instants: 0,
    };

    /// Coherences of north, east and vertical with pressure, their signs kept.
    pub(super) fn coherences(&self) -> [f32; 3] {
        let ([pressure, power @ ..], [_, with_pressure @ ..]) = (self.power, self.with_pressure);
        let mut out = with_pressure;
        for (coherence, power) in out.iter_mut().zip(power) {
            *coherence /= math::f32::sqrt(power * pressure).max(f32::MIN_POSITIVE);
        }
        out
    }

    /// How much larger chance makes coherences than those of a minute of so many instants.
    pub(super) fn chance(&self, whole: u64) -> f32 {
        math::f32::sqrt(whole as f32 / self.instants.max(1) as f32)
    }

    /// Powers of what of north and east is not coherent with pressure, and its product; none where there is nothing of one of them.
    pub(super) fn own_of_horizontals(&self) -> Option<[f32; 3]> {
        let [pressure, north, east, _] = self.power;
        let [_, of_north, of_east, _] = self.with_pressure;
        let alone = |product: f32, one: f32, other: f32| product - one * other / pressure;
        let (north, east) = (alone(north, of_north, of_north), alone(east, of_east, of_east));
        let some = pressure > 0.0 && north > 0.0 && east > 0.0;
        some.then(|| [north, east, alone(self.north_east, of_north, of_east)])
    }

    /// The same with north so many times as loud.
    // Of its own: it is seldom wanted.
    #[inline(never)]
    pub(super) fn with_north(&self, gain: f32) -> Self {
        let mut out = *self;
        let [_, power, ..] = &mut out.power;
        *power *= gain * gain;
        let [_, product, ..] = &mut out.with_pressure;
        *product *= gain;
        out.north_east *= gain;
        let [product, _] = &mut out.with_vertical;
        *product *= gain;
        out
    }

    /// Adds those of other instants.
    pub(super) fn add(&mut self, other: &Self) {
        let sum = |a: &mut [f32], b: &[f32]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        sum(&mut self.power, &other.power);
        sum(&mut self.with_pressure, &other.with_pressure);
        sum(&mut self.with_vertical, &other.with_vertical);
        self.north_east += other.north_east;
        self.instants += other.instants;
    }
}

/// The filters' memory, and the sums of the hop that goes on.
#[derive(Clone, Debug)]
pub(super) struct Filtered {
    /// Both states of each channel's filter, channels side by side: wide registers take all four at once.
    first: [f32; CHANNELS],
    second: [f32; CHANNELS],
    /// Largest value of each channel that counts; 0 before the first run.
    limit: [f32; CHANNELS],
    /// Instants of the hop that did not count.
    left_out: u32,
    pub(super) sums: Moments,
}

impl Filtered {
    /// Nothing heard; all zeros.
    pub(super) const fn new() -> Self {
        Self {
            first: [0.0; CHANNELS],
            second: [0.0; CHANNELS],
            limit: [0.0; CHANNELS],
            left_out: 0,
            sums: Moments::NONE,
        }
    }

    /// A run begins with this instant: as if it had always been so.
    pub(super) fn begin(&mut self, filter: &BandPass, first: &Frame) {
        (self.sums, self.left_out) = (Moments::NONE, 0);
        self.first = first.map(|code| -filter.b * code as f32);
        self.second = self.first;
        // Nothing is known yet of how loud it is.
        if self.limit == [0.0; CHANNELS] {
            self.limit = [f32::MAX; CHANNELS];
        }
    }

    /// Ends a hop: its moments.
    pub(super) fn end_hop(&mut self) -> Moments {
        let moments = core::mem::replace(&mut self.sums, Moments::NONE);
        let is_louder = LOUDER * core::mem::take(&mut self.left_out) > moments.instants;
        for (limit, power) in self.limit.iter_mut().zip(moments.power) {
            let deviation = math::f32::sqrt(power / moments.instants.max(1) as f32);
            *limit = if is_louder { 2.0 * *limit } else { (LIMIT * deviation).max(LEAST) };
        }
        moments
    }

    /// Takes an instant, which the caller counts: what the filter lets through of it.
    #[inline(always)]
    pub(super) fn push(&mut self, filter: &BandPass, frame: &Frame) -> [f32; CHANNELS] {
        let (mut y, mut is_off) = ([0f32; CHANNELS], false);
        let states = self.first.iter_mut().zip(&mut self.second).zip(&self.limit);
        for ((y, ((s1, s2), limit)), code) in y.iter_mut().zip(states).zip(frame) {
            let x = filter.b * *code as f32;
            let out = x + *s1;
            *s1 = *s2 - filter.a1 * out;
            *s2 = -x - filter.a2 * out;
            *y = out;
            is_off |= math::f32::abs(out) > *limit;
        }
        if is_off {
            self.left_out += 1;
            return y;
        }
        let [pressure, north, east, vertical] = y;
        for ((power, product), y) in self.sums.power.iter_mut().zip(&mut self.sums.with_pressure).zip(y) {
            *power += y * y;
            *product += y * pressure;
        }
        self.sums.north_east += north * east;
        let [of_north, of_east] = &mut self.sums.with_vertical;
        *of_north += north * vertical;
        *of_east += east * vertical;
        y
    }
}

#[cfg(test)]
mod tests {
    use super::super::mend::tests::gaussian;
    use super::*;

    /// Powers of the components of a tone of amplitude 1000 in pressure, north and (reversed) vertical, 10 s at a rate.
    fn of_tone(hz: f32, rate_hz: f32) -> Moments {
        let filter = BandPass::new(rate_hz);
        let mut filtered = Filtered::new();
        filtered.begin(&filter, &[5_000_000, 0, -300, 0]);
        for k in 0..(10.0 * rate_hz) as u32 {
            let x = math::f64::sin(math::f64::TAU * f64::from(k) * f64::from(hz / rate_hz));
            let x = (1000.0 * x) as i32;
            filtered.push(&filter, &[5_000_000 + x, x, -300, -x]);
        }
        filtered.sums
    }

    #[test]
    fn spikes_of_all_channels_do_not_make_them_go_together() {
        let filter = BandPass::new(50.0);
        let mut seed = 11;
        let mut noise = || gaussian(&mut seed);
        for (height, most) in [(0.0, 0.03), (8_000.0, 0.03), (30_000.0, 0.03), (3e5, 0.03)] {
            let mut filtered = Filtered::new();
            filtered.begin(&filter, &[0; CHANNELS]);
            let mut all = Moments::NONE;
            // Five samples every 11 s, 200 hops.
            for k in 0..200 * 512 {
                let spike = if k % 550 < 5 { height } else { 0.0 };
                filtered.push(&filter, &[0; CHANNELS].map(|_: i32| (noise() + spike) as i32));
                filtered.sums.instants += 1;
                if k % 512 == 511 {
                    let hop = filtered.end_hop();
                    // The first is not limited yet, nor are the next by much.
                    if k > 5 * 512 {
                        all.add(&hop);
                    }
                }
            }
            let coherences = all.coherences();
            assert!(coherences.iter().all(|c| c.abs() < most), "{height}: {coherences:?}");
        }
    }

    #[test]
    fn the_band_passes_and_neither_microseism_nor_offset_does() {
        for rate_hz in [50.0, 62.5, 250.0, 500.0] {
            let power = |hz: f32| of_tone(hz, rate_hz).power[0] / (10.0 * rate_hz) / 0.5e6;
            assert!((power(16.0) - 1.0).abs() < 0.05, "{rate_hz}: {}", power(16.0));
            assert!(power(11.0) > 0.3 && power(20.0) > 0.3, "{rate_hz}: {} {}", power(11.0), power(20.0));
            assert!(power(0.2) < 1e-3, "{rate_hz}: {}", power(0.2));
            let m = of_tone(16.0, rate_hz);
            assert!((m.with_pressure[1] / m.power[0] - 1.0).abs() < 1e-3);
            assert!((m.with_pressure[3] / m.power[0] + 1.0).abs() < 1e-3);
            assert!((m.with_vertical[0] / m.power[0] + 1.0).abs() < 1e-3 && m.with_vertical[1] == 0.0);
            assert!(m.power[2] < 1.0);
        }
    }
}
