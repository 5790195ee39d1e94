//! What leaves of a minute's azigrams: the mean direction in each of 24 bands of frequency, the message [`Azigram`].
//!
//! Enters: the rows of the frames within half a minute of a centre. A bin's unit vectors are added up over the frames, and the
//! sums of a band's bins are averaged, each with its own length as its weight: a line that stays where it is speaks louder
//! than noise, which comes from everywhere. Leaves: of each band the azimuth of that mean, and the square root of its length:
//! 1 where all point to one side, √(m/n) where m bins of n do. A bin without a direction points nowhere. How strong the sound
//! is does not count: one burst must not speak for a minute. Cost: 20 instructions a bin and frame; nothing is kept from
//! minute to minute.

use super::evened::Evened;
use super::limits::{CIRCLE, FRAME};
use super::plan::Plan;
use super::row::Row;
use crate::math;
use crate::math::constant::cos_of_turn;
use crate::wire::{AZIGRAM_BANDS, Azigram};

/// Directions of a full circle that are told apart, a power of two: no fewer than a message tells.
const STEPS: usize = 256;

/// One, as a cosine is stored.
const ONE: i16 = 1 << 14;

/// Cosine of each direction.
static COSINE: [i16; STEPS] = cosines();

const fn cosines() -> [i16; STEPS] {
    let mut out = [0; STEPS];
    let mut n = 0;
    while n < STEPS {
        let x = cos_of_turn(n, STEPS) * ONE as f64;
        out[n] = (if x < 0.0 { x - 0.5 } else { x + 0.5 }) as i16;
        n += 1;
    }
    out
}

/// East and North of the unit vector to an azimuth, in steps of [`CIRCLE`].
fn unit(azimuth: u16) -> [i32; 2] {
    let step = (usize::from(azimuth) + CIRCLE / STEPS / 2) / (CIRCLE / STEPS);
    // The sine is the cosine a quarter of a turn before.
    [step + STEPS - STEPS / 4, step].map(|n| COSINE.get(n % STEPS).map_or(0, |x| i32::from(*x)))
}

/// East and North of the sum of a bin's unit vectors, and how many frames have one.
fn sum(rows: &[&Row], bin: usize) -> ([i32; 2], u32) {
    let azimuths = rows.iter().filter_map(|row| row.azimuth(bin));
    azimuths.fold(([0; 2], 0), |([east, north], n), azimuth| {
        let [x, y] = unit(azimuth);
        ([east + x, north + y], n + 1)
    })
}

/// The azigram of a minute about `index`, of its rows; none where no bin has a direction.
// Called from `report`, whose stack it must not share.
#[inline(never)]
pub(super) fn azigram(plan: &Plan<'_>, evened: &Evened, index: u64, rows: &[&Row]) -> Option<Azigram> {
    let band = &plan.band;
    let edge = |n: usize| Azigram::edge(band.bins, n);
    let mut out = Azigram {
        index,
        frames: rows.len() as u8,
        bin_hz: (plan.inner_rate_hz() / FRAME as f64) as f32,
        first_bin: band.first_bin as u16,
        bins: band.bins as u16,
        azimuth: [0; AZIGRAM_BANDS],
        coherence: [0; AZIGRAM_BANDS],
    };
    // The length of a sum that all frames agree on.
    let all = rows.len() as f32 * f32::from(ONE);
    let mut some = 0;
    let told = out.azimuth.iter_mut().zip(&mut out.coherence);
    for (n, (azimuth, coherence)) in told.enumerate() {
        let (mut east, mut north) = (0f32, 0f32);
        for bin in edge(n)..edge(n + 1) {
            let ([x, y], frames) = sum(rows, bin);
            some += frames;
            let (x, y) = (x as f32 / all, y as f32 / all);
            let weight = math::f32::sqrt(x * x + y * y);
            (east, north) = (east + weight * x, north + weight * y);
        }
        let mean = math::f32::sqrt(east * east + north * north) / (edge(n + 1) - edge(n)) as f32;
        // One turn more, so that what is cut to a whole step is never negative.
        let (azimuth_told, _) = evened.told(math::f32::atan2(east, north));
        let turn = 1.0 + azimuth_told / math::f32::TAU;
        *azimuth = ((turn * STEPS as f32 + 0.5) as u32 % STEPS as u32) as u8;
        // Rounded; a conversion ends at the greatest value.
        *coherence = (255.0 * math::f32::sqrt(mean) + 0.5) as u8;
    }
    (some > 0).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::super::station_tests::plan;
    use super::*;
    use std::vec::Vec;

    /// A row in which a bin points where it is told to.
    fn row(directions: impl Fn(usize) -> Option<u16>) -> Row {
        let mut row = Row::EMPTY;
        row.fill((0..266).map(|k| directions(k).map(|azimuth| (azimuth, 3))));
        row
    }

    /// The azigram at 50 Hz of six such rows.
    fn of(directions: impl Fn(usize, usize) -> Option<u16>) -> Option<Azigram> {
        let rows: Vec<Row> = (0..6).map(|frame| row(|bin| directions(frame, bin))).collect();
        azigram(&plan(50.0), &Evened::NONE, 3000, &rows.iter().collect::<Vec<_>>())
    }

    #[test]
    fn a_band_has_the_direction_in_which_its_bins_agree_and_how_far_they_do() {
        let edge = |band: usize| Azigram::edge(266, band);
        assert_eq!((edge(0), edge(AZIGRAM_BANDS)), (0, 266));
        for azimuth in (0..1024).step_by(61) {
            // Band 3 points one way, 4 half the time the other, 5 half the time aside; 6 has it half the time, 7 in a bin of 11.
            let [opposite, aside] = [512, 256].map(|by| (azimuth + by) % 1024);
            let a = of(|frame, bin| match (0..AZIGRAM_BANDS).find(|b| bin < edge(b + 1))? {
                3 => Some(azimuth),
                4 => Some(if frame % 2 == 0 { azimuth } else { opposite }),
                5 => Some(if frame % 2 == 0 { azimuth } else { aside }),
                6 => (frame % 2 == 0).then_some(azimuth),
                7 => (bin == edge(7)).then_some(azimuth),
                _ => None,
            });
            let a = a.unwrap();
            assert_eq!((a.index, a.frames, a.bins), (3000, 6, 266));
            for (band, wanted, coherence) in [
                (3, azimuth, 1.0),
                (5, azimuth + 128, 0.5f32.sqrt()),
                (6, azimuth, 0.5),
                (7, azimuth, (1.0f32 / 11.0).sqrt()),
            ] {
                let off = f32::from(a.azimuth[band]) - f32::from(wanted) / 4.0;
                assert!(((off + 128.0).rem_euclid(256.0) - 128.0).abs() <= 1.0, "{band} {azimuth} {a:?}");
                assert!((f32::from(a.coherence[band]) / 255.0 - coherence).abs() < 0.006, "{band} {a:?}");
            }
            assert!(a.coherence.iter().enumerate().all(|(n, c)| matches!(n, 3 | 5..=7) || *c < 3), "{a:?}");
        }
    }

    #[test]
    fn a_line_is_heard_through_directions_at_random_which_alone_do_not_agree() {
        let mut seed = 5u32;
        let random: Vec<u16> = (0..6 * 266)
            .map(|_| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (seed >> 22) as u16
            })
            .collect();
        // A line of three bins in every fourth band.
        let line = |bin: usize| bin % 44 < 3;
        let a = of(|frame, bin| Some(if line(bin + 2) { 300 } else { random[266 * frame + bin] })).unwrap();
        for (n, (azimuth, coherence)) in a.azimuth.iter().zip(a.coherence).enumerate() {
            match (Azigram::edge(266, n)..Azigram::edge(266, n + 1)).filter(|bin| line(bin + 2)).count() {
                0 => assert!(coherence < 100, "{n} {a:?}"),
                3 => assert!(azimuth.abs_diff(75) < 16 && coherence > 110, "{n} {a:?}"),
                _ => {}
            }
        }
    }

    #[test]
    fn nothing_is_said_without_a_direction() {
        assert_eq!(azigram(&plan(50.0), &Evened::NONE, 0, &[]), None);
        assert_eq!(of(|_, _| None), None);
        assert!(of(|frame, bin| (bin + frame == 0).then_some(0)).is_some());
    }
}
