//! Whether the channel that is called pressure is it: of a vessel's sound pressure has its part in every direction.
//!
//! Enters: the moments of minutes in which something other than calls is heard. Leaves: which component pressure is exchanged with.
//!
//! A vessel along one horizontal component is not heard by the other, nor, over a floor that reflects, much by the vertical one in phase
//! with pressure; of all four pressure alone takes part in each such minute, whatever signs and gains are. So minutes are
//! counted in which two components go together and another with none of the three others: a channel that is absent where those others
//! agree is no pressure, and of those beside it the one that never is absent takes its place. What goes together beside it is
//! vessels' where north and east do with both signs, for an instrument that shakes does so along one axis for long.
//! Pressure of two vessels on opposite sides goes with neither horizontal component, which go together; but it is loud then. Absent
//! is only what is as quiet as where no vessel is heard.
//! Vertical motion goes with pressure with one sign (`checks`), also where the two are exchanged: what a shaking
//! instrument has of pressure has either, but one sign as long as one tide's current flows. So for these two the axis of what is heard must move as well:
//! vessels pass, and a current flows one way for hours.
//!
//! Not observable: pressure exchanged with any over a floor that lets sound in, where vertical motion goes with pressure in all that it does;
//! nor before vessels were heard along both horizontal components. Cost: 100 instructions a minute.

use super::moments::Moments;
use super::signs::{COHERENT, Votes};
use crate::block::CHANNELS;
use crate::math;

/// Least squared coherence of the two that agree best, and the share of it below which a third is with neither.
const STRONG: f32 = 0.15;
const ABSENT: f32 = 0.125;

/// Power of what is called pressure up to which it hears no vessel, in its least, and the part of that by which the least grows a minute
/// (twice as much in six hours), for the sea grows louder too.
const QUIET: f32 = 1.5;
const GROWS: f32 = 1.0 / 512.0;

/// Minutes in which each of those was absent that must have been, and those of one channel from which on the older half is forgotten.
const MINUTES: u16 = 4;
const MOST: u16 = 1000;

/// Pressure is absent in no more than one of so many of the minutes in which any other is; and minutes without the one called so from
/// which on that is doubted.
const SELDOM: u16 = 10;
const FEW: u16 = 3;

/// A horizontal component in place of pressure has its part in vessels' sound, an instrument that shakes has none in pressure: so many times
/// the minutes without what is called pressure are without the vertical one. And of vessels along the other horizontal component
/// what is called pressure hears as little as the vertical one, which goes with all that shakes upwards too: one in so many of those minutes,
/// at least, is without both (of vessels more than nine in ten, of strumming hardly any).
const TAKES_PART: u16 = 2;
const WITHOUT_BOTH: u16 = 2;

/// Minutes without the vertical component from which on either horizontal one would have been absent, were neither pressure.
const LOUD: u16 = 20;

/// Minutes of a block, and blocks: a minute's axis is compared with that of the whole blocks before its own. Least length of an axis and of the mean of theirs, and
/// cosine of twice the angle between the two below which it has moved: 15°.
const BLOCK: u16 = 15;
const BLOCKS: usize = 4;
const AXIS: f32 = 0.1;
const STAYS: f32 = 0.866;

/// Pressure is exchanged with the vertical component where the axis has moved in so many of the minutes without it, one in so many: where it shakes it
/// moves once a tide, for three blocks.
const MOVED: u16 = 30;
const MOVES: u16 = 4;

/// Minutes of each sign in which north and east go together.
const EITHER_SIGN: u16 = 5;

/// State.
#[derive(Clone, Copy, Debug)]
pub(super) struct Misplaced {
    /// Minutes in which a channel was absent: what is called pressure, north, east, vertical.
    absent: [u16; CHANNELS],
    /// Minutes without what is called pressure and the vertical one.
    both: u16,
    /// Those without what is called pressure whose axis had moved.
    moved: u16,
    axes: Axes,
    /// While what is called pressure was: of north with east, and of it with the vertical one.
    horizontals: Votes,
    vertical: Votes,
    /// The least power of what is called pressure; 0 before the first minute.
    least: f32,
}

/// Axis of horizontal motion, of powers and their product: direction of the vector is twice its angle, 0 to 1 long.
fn axis(north: f32, east: f32, together: f32) -> [f32; 2] {
    let all = (north + east).max(f32::MIN_POSITIVE);
    [(north - east) / all, 2.0 * together / all]
}

/// Axes of the last blocks.
#[derive(Clone, Copy, Debug)]
struct Axes {
    /// Sums of a block each, the newest first.
    blocks: [[f32; 2]; BLOCKS],
    minutes: u16,
}

impl Axes {
    const NONE: Self = Self { blocks: [[0.0; 2]; BLOCKS], minutes: 0 };

    /// Takes a minute's, whose length is 0 where nothing is heard; whether it is another than those of the blocks before.
    fn minute(&mut self, [c, s]: [f32; 2]) -> bool {
        if self.minutes >= BLOCK {
            self.blocks.rotate_right(1);
            (self.blocks[0], self.minutes) = ([0.0; 2], 0);
        }
        self.minutes += 1;
        let [newest, older @ ..] = &mut self.blocks;
        (newest[0], newest[1]) = (newest[0] + c, newest[1] + s);
        let [x, y] = older.iter().fold([0.0; 2], |[x, y], [c, s]| [x + c, y + s]);
        let (now, then) = (math::f32::hypot(c, s), math::f32::hypot(x, y));
        let is_axis = now > AXIS && then > AXIS * f32::from(BLOCK) * older.len() as f32;
        is_axis && c * x + s * y < STAYS * now * then
    }
}

/// Where pressure is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pressure {
    /// Where it should be, as far as is known.
    Right,
    /// That is not known yet: what has been heard is as of another place too.
    Open,
    /// In a component's place, and whether vessels on either side of another say so.
    Elsewhere(u8, bool),
}

impl Misplaced {
    /// Nothing known; all zeros.
    pub(super) const NONE: Self = Self {
        absent: [0; CHANNELS],
        both: 0,
        moved: 0,
        axes: Axes::NONE,
        horizontals: Votes::NONE,
        vertical: Votes::NONE,
        least: 0.0,
    };

    /// Takes a minute.
    pub(super) fn minute(&mut self, m: &Moments) {
        let [p, n, e, z] = m.power;
        let power = p / m.instants.max(1) as f32;
        let grown = self.least * (1.0 + GROWS);
        self.least = if grown > 0.0 { grown.min(power) } else { power };
        let ([_, pn, pe, pz], [nz, ez]) = (m.with_pressure, m.with_vertical);
        // Squared coherences with the sign of the product.
        let signed =
            |product: f32, a: f32, b: f32| product * math::f32::abs(product) / (a * b).max(f32::MIN_POSITIVE);
        let (ne, pz) = (signed(m.north_east, n, e), signed(pz, p, z));
        let [pn, pe, nz, ez, ne_size, pz_size] =
            [signed(pn, p, n), signed(pe, p, e), signed(nz, n, z), signed(ez, e, z), ne, pz]
                .map(math::f32::abs);
        // How well each channel goes with any other.
        let best = [
            pn.max(pe).max(pz_size),
            pn.max(ne_size).max(nz),
            pe.max(ne_size).max(ez),
            pz_size.max(nz).max(ez),
        ];
        let most = best.iter().fold(0f32, |most, x| most.max(*x));
        let axis = if most < STRONG { [0.0; 2] } else { axis(n, e, m.north_east) };
        let moved = self.axes.minute(axis);
        if most < STRONG {
            return;
        }
        let is_absent = |x: f32| x < ABSENT * most;
        let [pressure, _, _, vertical] = best;
        let quiet = power <= QUIET * self.least;
        for (c, (count, best)) in self.absent.iter_mut().zip(best).enumerate() {
            *count += u16::from(is_absent(best) && (c > 0 || quiet));
        }
        self.both += u16::from(is_absent(pressure) && quiet && is_absent(vertical));
        if self.absent.iter().any(|count| *count >= MOST) {
            self.absent.iter_mut().for_each(|count| *count /= 2);
            self.both /= 2;
            self.moved /= 2;
        }
        if is_absent(pressure) && quiet {
            self.moved += u16::from(moved);
            let [slightly, clearly] = COHERENT;
            self.horizontals.take(ne, clearly * clearly);
            self.vertical.take(pz, slightly * slightly);
        }
    }

    /// Where pressure is by what was heard.
    pub(super) fn pressure(&self) -> Pressure {
        let [pressure, north, east, vertical] = self.absent;
        if pressure < FEW {
            let one_never = vertical >= LOUD && north.min(east) == 0 && north.max(east) < LOUD;
            return if one_never { Pressure::Open } else { Pressure::Right };
        }
        let components = [(1, north), (2, east), (3, vertical)];
        let (component, least) = components.iter().fold((0, u16::MAX), |a, b| if b.1 < a.1 { *b } else { a });
        let often = least * SELDOM;
        // Where it is the vertical component that is called pressure, that has little of either.
        let takes_part = vertical >= TAKES_PART * pressure && WITHOUT_BOTH * self.both >= pressure;
        let moves = self.moved >= MOVED && MOVES * self.moved >= pressure;
        let may_be = if component == 3 { moves && self.vertical.is_one_sided() } else { takes_part };
        if pressure < often || !may_be {
            return Pressure::Right;
        }
        let enough = |count: u16| count >= often.max(MINUTES);
        let others = components.iter().all(|(c, count)| *c == component || enough(*count));
        if !enough(pressure) || !others {
            return Pressure::Open;
        }
        let either = self.horizontals.with.min(self.horizontals.against) >= EITHER_SIGN;
        Pressure::Elsewhere(component, either)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::vec::Vec;

    /// Moments of a minute of sound from an azimuth, of so many times the noise's power in pressure; of the vertical motion's power `goes`
    /// is in phase with pressure, `all` of the pressure's there at all.
    pub(in crate::obs) fn sound(azimuth: f32, power: f32, [goes, all]: [f32; 2]) -> Moments {
        let (s, c) = math::f32::sin_cos(azimuth);
        let vertical = -goes * all;
        Moments {
            power: [power + 1.0, power * c * c + 1.0, power * s * s + 1.0, power * all * all + 1.0],
            with_pressure: [power + 1.0, power * c, power * s, power * vertical],
            north_east: power * c * s,
            with_vertical: [power * vertical * c, power * vertical * s],
            instants: 3000,
        }
    }

    /// The same with channels in another order: which one stands where pressure, north, east and vertical should.
    pub(in crate::obs) fn order(m: &Moments, places: [usize; 4]) -> Moments {
        let product = |a: usize, b: usize| {
            let ([_, pn, pe, pz], [nz, ez]) = (m.with_pressure, m.with_vertical);
            match (places[a].min(places[b]), places[a].max(places[b])) {
                (0, 1) => pn,
                (0, 2) => pe,
                (0, 3) => pz,
                (1, 2) => m.north_east,
                (1, 3) => nz,
                (2, 3) => ez,
                (same, _) => m.power[same],
            }
        };
        Moments {
            power: places.map(|c| m.power[c]),
            with_pressure: core::array::from_fn(|c| product(0, c)),
            north_east: product(1, 2),
            with_vertical: [product(1, 3), product(2, 3)],
            instants: m.instants,
        }
    }

    /// Where pressure is after minutes of vessels all around (on the northern and eastern sides alone where not `around`), their
    /// components put in their places by `places` (of pressure, north, east, vertical in the order of the channels).
    fn found(places: [usize; 4], around: bool) -> Pressure {
        let mut misplaced = Misplaced::NONE;
        for n in 0..400 {
            let angle = n as f32 / if around { 60.0 } else { 260.0 };
            misplaced.minute(&order(&sound(angle, 4.0, [0.3, 0.8]), places));
        }
        misplaced.pressure()
    }

    #[test]
    fn pressure_is_found_in_each_place_and_missed_where_it_is() {
        assert_eq!(found([0, 1, 2, 3], true), Pressure::Right);
        assert_eq!(found([0, 2, 1, 3], true), Pressure::Right);
        assert_eq!(found([0, 3, 2, 1], true), Pressure::Right);
        assert_eq!(found([1, 0, 2, 3], true), Pressure::Elsewhere(1, true));
        assert_eq!(found([2, 1, 0, 3], true), Pressure::Elsewhere(2, true));
        assert_eq!(found([3, 1, 2, 0], true), Pressure::Elsewhere(3, true));
        // All on one side.
        assert_eq!(found([1, 0, 2, 3], false), Pressure::Elsewhere(1, false));
    }

    #[test]
    fn pressure_of_vessels_on_opposite_sides_is_pressure() {
        // Both as loud: what pressure has of one with a component it has of the other against it. Before them none is heard, then one.
        let mut misplaced = Misplaced::NONE;
        for n in 0..1200 {
            let angle = n as f32 / 120.0;
            let heard = if n % 300 < 20 { 0.0 } else { 4.0 };
            let [mut m, b] =
                [angle, angle + core::f32::consts::PI].map(|angle| sound(angle, heard, [0.05, 0.8]));
            if n % 300 > 150 {
                m.add(&b);
                m.instants = b.instants;
            }
            misplaced.minute(&m);
            assert!(!matches!(misplaced.pressure(), Pressure::Elsewhere(..)), "{n}");
        }
    }

    /// Moments of a minute in which the instrument shakes along an axis and upwards, amplitudes over the noise's; none of it in pressure.
    fn shaking(angle: f32, along: f32, up: f32) -> Moments {
        let (s, c) = math::f32::sin_cos(angle);
        let [n, e, z] = [along * c, along * s, up];
        Moments {
            power: [1.0, 1.0 + n * n, 1.0 + e * e, 1.0 + z * z],
            with_pressure: [1.0, 0.0, 0.0, 0.0],
            north_east: n * e,
            with_vertical: [n * z, e * z],
            instants: 3000,
        }
    }

    #[test]
    fn an_instrument_that_shakes_is_no_pressure() {
        // Along north, along east, and between, with a fifth of it upwards and none in pressure.
        let shaking = |angle: f32| shaking(angle, 6.0, 1.2);
        for angles in [[0.0, 0.0], [0.0, 1.571], [0.785, 2.356], [0.0, 0.785]] {
            let mut misplaced = Misplaced::NONE;
            let told: Vec<bool> = (0..2000usize)
                .map(|n| {
                    let [first, second] = angles;
                    misplaced.minute(&shaking(if n % 400 < 200 { first } else { second }));
                    matches!(misplaced.pressure(), Pressure::Elsewhere(..))
                })
                .collect();
            assert!(!told.contains(&true), "{angles:?}");
        }
    }

    #[test]
    fn an_instrument_that_shakes_upwards_as_well_is_no_exchange_with_pressure() {
        // Tides of five hours along one axis each, which are many, with nothing between them; four fifths of it upwards.
        let mut misplaced = Misplaced::NONE;
        for n in 0..7200usize {
            let (tide, within) = (n / 745, n % 745);
            let angle = [0.0, 0.785, 1.571, 2.356, 0.4, 1.2][tide % 6];
            misplaced.minute(&if within < 300 { shaking(angle, 6.0, 4.8) } else { shaking(0.0, 0.0, 0.0) });
            assert!(!matches!(misplaced.pressure(), Pressure::Elsewhere(..)), "{n}: {misplaced:?}");
        }
    }

    #[test]
    fn strumming_beside_a_sound_from_the_north_is_no_pressure_in_norths_place() {
        // Each tide shakes along another axis between north and east, upwards by a third of it; vessels pass in the north.
        let mut misplaced = Misplaced::NONE;
        for n in 0..600usize {
            let tide = n / 20 % 6;
            let minute = if tide >= 2 {
                sound(0.0, 4.0, [0.05, 0.1])
            } else {
                let angle = core::f32::consts::FRAC_PI_4;
                shaking(if tide == 0 { angle } else { -angle }, core::f32::consts::SQRT_2, 0.4)
            };
            misplaced.minute(&minute);
            assert!(!matches!(misplaced.pressure(), Pressure::Elsewhere(..)), "{n}: {misplaced:?}");
        }
    }

    #[test]
    fn counts_stay_bounded() {
        let mut misplaced = Misplaced::NONE;
        for n in 0..200_000u32 {
            misplaced.minute(&order(&sound(n as f32 / 60.0, 4.0, [0.3, 0.8]), [0, 3, 2, 1]));
        }
        assert!(misplaced.absent.iter().all(|count| *count <= MOST), "{misplaced:?}");
    }
}
