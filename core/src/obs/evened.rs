//! Horizontal components of equal noise: what they have of their own along one axis is weighed down to what they have across it.
//!
//! Enters: moments of minutes without a vessel, and of those whose vessel is hardly heard. Leaves: the matrix that weighs intensities before they are coded as directions, and the true
//! azimuth of what is found in these.
//!
//! Where one component is noisier than the other, or the place shakes one way, a bin's directions are no longer spread evenly about the
//! vessel's: they crowd along the noisy axis, and their mean, their mode and any law that knows one spread alone are drawn that way,
//! by five degrees at 10 dB of difference. With the noise along that axis divided down to that across it, directions are spread evenly about one
//! that is turned, and the turn is known: along the axis it is what it was, divided by the factor.
//! Noise is what of the components is not coherent with pressure. Assumes: one axis and one ratio over the band, noise independent of pressure.
//! The first [`ALIKE_DB`] count for nothing: so much chance makes, and noise of two sides, and what they do is in what is stated.
//! Cost: 40 instructions a minute, and 8 a bin.

use super::moments::Moments;
use crate::math;

/// Ratio of noise along the axis and across it that counts for nothing, dB, and the greatest with which directions are told: with 20 dB, of
/// vessels 5 dB below the table's level, half of the azimuths lie in their 95 % and final tracks are up to 14 deviations off.
const ALIKE_DB: f32 = 0.5;
const MOST_DB: f32 = 14.0;

/// Share of the variance that weighing adds where it is strong: noise is not of one ratio over band and time. Chosen by passages of
/// vessels 5 dB below the table's level with 3 to 10 dB of difference.
const UNSURE: f32 = 0.4;

/// Minutes that the tensor is of in the long run, and those that it counts as nothing for from the first: that of one minute is chance.
const MEMORY: f32 = 240.0;
const BEFORE: f32 = 2.0;

/// Minutes that what was learned counts as after the noise has changed.
const AFRESH: f32 = 10.0;

/// Minutes below which any that can be had are better than none.
const YOUNG: f32 = 60.0;

/// The anisotropy of the noise of the horizontal components, learned.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnNoise {
    /// Power of north less that of east, and twice their product, over the sum of the powers.
    tensor: [f32; 2],
    minutes: f32,
}

impl OwnNoise {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self { tensor: [0.0; 2], minutes: 0.0 }
    }

    /// Takes a minute without a vessel, or one whose vessel is hardly heard, which counts for less.
    pub(super) fn take(&mut self, m: &Moments, weight: f32) {
        let Some([north, east, together]) = m.own_of_horizontals() else { return };
        self.minutes = (self.minutes + weight).min(MEMORY);
        let share = weight / (self.minutes + BEFORE);
        let now = [north - east, 2.0 * together].map(|x| x / (north + east));
        for (x, now) in self.tensor.iter_mut().zip(now) {
            *x += share * (now - *x);
        }
    }

    /// The noise is another than it was: what is learned of it soon counts for more than what was.
    pub(super) fn changed(&mut self) {
        self.minutes = self.minutes.min(AFRESH);
    }

    /// Whether it is of so few minutes that those whose vessel is hardly heard tell more.
    pub(super) fn is_young(&self) -> bool {
        self.minutes < YOUNG
    }

    /// How much louder noise is along its axis than across it, dB.
    fn ratio_db(&self) -> f32 {
        let [x, y] = self.tensor;
        let size = math::f32::sqrt(x * x + y * y).min(0.99);
        (10.0 / core::f32::consts::LN_10) * math::f32::ln((1.0 + size) / (1.0 - size))
    }

    /// Whether that is so much that no direction can be told.
    pub(super) fn hides_directions(&self) -> bool {
        self.ratio_db() > MOST_DB
    }

    /// How it is evened, where north's true azimuth (or the opposite one) is `north`, rad.
    pub(super) fn evened(&self, north: f32) -> Evened {
        let beyond_db = self.ratio_db() - ALIKE_DB;
        if !(beyond_db > 0.0) {
            return Evened { north, ..Evened::NONE };
        }
        let factor = math::f32::exp(beyond_db * (-core::f32::consts::LN_10 / 20.0));
        let [x, y] = self.tensor;
        Evened::along(0.5 * math::f32::atan2(y, x), factor, north)
    }
}

/// How intensities are weighed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evened {
    /// The symmetric matrix: of north and north, north and east, east and east.
    pub(super) matrix: [f32; 3],
    /// Its determinant.
    factor: f32,
    /// True azimuth of the north component, or the opposite one, rad.
    north: f32,
    /// North's gain over east's, as an amplitude.
    gain: f32,
}

impl Evened {
    /// As they are.
    pub(super) const NONE: Self = Self { matrix: [1.0, 0.0, 1.0], factor: 1.0, north: 0.0, gain: 1.0 };

    /// Of components that are of so different a gain, north over east in dB: what is found is told as it would be without that.
    pub(super) fn of_gain(self, db: f32) -> Self {
        Self { gain: math::f32::exp(db * (core::f32::consts::LN_10 / 20.0)), ..self }
    }

    /// By a factor along an axis, rad from north to east.
    fn along(axis: f32, factor: f32, north: f32) -> Self {
        let (s, c) = math::f32::sin_cos(axis);
        let less = 1.0 - factor;
        Self { matrix: [1.0 - less * c * c, -less * c * s, 1.0 - less * s * s], factor, north, gain: 1.0 }
    }

    /// By how much the variance of what is told is larger than that of directions spread evenly, for what the weighing leaves.
    pub(super) fn unsure(&self) -> f32 {
        1.0 + UNSURE * (1.0 - self.factor)
    }

    /// The true azimuth of what was found in a direction, rad, and by how much more that turns than it.
    pub(super) fn told(&self, found: f32) -> (f32, f32) {
        if self.factor == 1.0 && self.gain == 1.0 {
            return (found, 1.0);
        }
        let (s, c) = math::f32::sin_cos(found - self.north);
        let [nn, ne, ee] = self.matrix;
        // The inverse times the determinant, and what north heard with its gain taken out.
        let (n, e) = ((ee * c - ne * s) / self.gain, nn * s - ne * c);
        let azimuth = crate::angle::wrap_tau_f32(self.north + math::f32::atan2(e, n));
        (azimuth, self.factor / (self.gain * (n * n + e * e)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found of a direction.
    fn found(evened: &Evened, azimuth: f32) -> f32 {
        let (s, c) = math::f32::sin_cos(azimuth - evened.north);
        let [nn, ne, ee] = evened.matrix;
        evened.north + math::f32::atan2(ne * c + ee * s, nn * c + ne * s)
    }

    /// A minute of noise: north, east, their product.
    fn noise(north: f32, east: f32, north_east: f32) -> Moments {
        Moments { power: [1.0, north, east, 1.0], north_east, instants: 3000, ..Moments::NONE }
    }

    fn learned(m: &Moments) -> OwnNoise {
        let mut own = OwnNoise::new();
        (0..2000).for_each(|_| own.take(m, 1.0));
        own
    }

    #[test]
    fn a_direction_comes_back_as_it_was() {
        for m in [noise(10.0, 1.0, 0.0), noise(1.0, 2.0, 0.3), noise(3.0, 3.0, -2.5), noise(1.0, 20.0, 3.0)] {
            let evened = learned(&m).evened(1.3);
            for k in 0..200 {
                let azimuth = crate::angle::wrap_tau_f32(0.0314 * k as f32);
                let (told, slope) = evened.told(found(&evened, azimuth));
                let off = crate::angle::wrap_pi_f32(told - azimuth);
                assert!(off.abs() < 1e-4, "{evened:?} {azimuth} {off}");
                let (beside, _) = evened.told(found(&evened, azimuth) + 1e-3);
                let turned = crate::angle::wrap_pi_f32(beside - told) / 1e-3;
                assert!(
                    (turned - slope).abs() < 0.05 * slope + 2e-3,
                    "{evened:?} {azimuth} {turned} {slope}"
                );
            }
        }
    }

    #[test]
    fn noise_along_an_axis_becomes_as_loud_as_across_it_but_for_what_counts_for_nothing() {
        // Ten times as loud along 30°.
        let (s, c) = 30f32.to_radians().sin_cos();
        let (north, east, product) = (1.0 + 9.0 * c * c, 1.0 + 9.0 * s * s, 9.0 * s * c);
        let [nn, ne, ee] = learned(&noise(north, east, product)).evened(0.4).matrix;
        let power = |n: f32, e: f32| n * n * north + 2.0 * n * e * product + e * e * east;
        let (along, across) =
            (power(nn * c + ne * s, ne * c + ee * s), power(-nn * s + ne * c, -ne * s + ee * c));
        assert!((10.0 * (along / across).log10() - ALIKE_DB).abs() < 0.05, "{along} {across}");
    }

    #[test]
    fn noise_much_louder_along_an_axis_hides_directions() {
        let hides = |ratio_db: f32| learned(&noise(1.0, 10f32.powf(0.1 * ratio_db), 0.0)).hides_directions();
        assert_eq!(
            [-40.0, -15.0, -13.0, 0.0, 13.0, 15.0, 40.0].map(hides),
            [true, true, false, false, false, true, true]
        );
    }

    #[test]
    fn components_that_are_alike_are_left_as_they_are() {
        for m in [noise(1.0, 1.0, 0.0), noise(1.1, 1.0, 0.0), noise(1.0, 1.0, 0.05)] {
            let evened = learned(&m).evened(0.7);
            assert_eq!((evened.matrix, evened.told(0.4)), ([1.0, 0.0, 1.0], (0.4, 1.0)));
        }
        // What goes with pressure is sound from one side, and no noise of a component.
        let sound = Moments { with_pressure: [1.0, 3.0, 0.0, 0.0], ..noise(10.0, 1.0, 0.0) };
        assert_eq!(learned(&sound).evened(0.0).matrix, [1.0, 0.0, 1.0]);
        // Nothing learned, and nothing to learn from.
        let mut own = OwnNoise::new();
        own.take(&Moments::NONE, 1.0);
        assert_eq!(own.evened(0.0).matrix, [1.0, 0.0, 1.0]);
    }
}
