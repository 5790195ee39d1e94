//! What becomes of a component from one hop to the next while the others stay as they were: no sound does that.
//!
//! Enters: the moments of hops that follow one another ([`moments`](super::moments)). Leaves: that a horizontal component has become louder or quieter, that it
//! hears nothing any more, or that pressure goes with the others' motion the other way round. Directions would be wrong from then on, and the
//! checks that compare hours of noise and of vessels (`gains`, `deaf`, `signs`) find it after hours; they are told at once that what they know is of
//! what was.
//!
//! Hops before and after a moment are compared, [`HOPS`] of each. A vessel that passes, a call that sets in and noise that grows change pressure as well,
//! or both horizontal components, or take longer than three hops. Noise of a component's own (strumming) sets in like a gain does, but takes from
//! its coherence with a vessel; where that was less than a half it is taken for as likely.
//! Not observable: what happens while no sample comes, or while something else changes; signs that turn round, and a component that goes deaf without
//! a change of its noise, while no vessel is heard. Cost: 600 instructions a hop.

use super::moments::Moments;
use crate::math;

/// Hops on either side, and those next to the moment between which most of a jump lies.
const HOPS: usize = 9;
const NEXT: usize = 3;

/// Steps of a level, dB, and of a coherence.
const LEVEL_DB: f32 = 1.0 / 64.0;
const COHERENCE: f32 = 1.0 / 127.0;

/// Least jump of a horizontal component's level beside pressure's and the other one's, dB, most by which these two may change beside each other meanwhile, and
/// the jump downwards from which on it hears nothing. Of nine hops' means chance makes 0.2 dB, one deviation.
const JUMP_DB: f32 = 2.5;
const STILL_DB: f32 = 0.5;
const DEAF_DB: f32 = -10.0;

/// Part of a jump that lies between the hops next to it, and greatest mean distance of hops from the mean of their side, dB, and of the jump: the hop
/// that it falls into is of both.
const ABRUPT: f32 = 0.6;
const ROUGH: (f32, f32) = (0.6, 0.08);

/// Most by which levels change where pressure is turned round, dB: a sound that makes up for a coherence of a quarter on the other side adds 2.2 dB.
const AS_LOUD_DB: f32 = 1.5;

/// Coherence with pressure of a component that hears a vessel, of one that hears it well, of one that hears it so well that noise of its own would show, and
/// of one that hears none.
const HEARD: f32 = 0.25;
const WELL: f32 = 0.4;
const CERTAIN: f32 = 0.5;
const UNHEARD: f32 = 0.1;

/// Coherence of a component in which hardly anything but the vessel is heard: levels then go with the vessel's direction, and no coherence shows it.
const DOMINATES: f32 = 0.85;

/// Most by which the coherence of any component changes where nothing but a gain does, and that of one that is not concerned where another falls silent.
const UNCHANGED: f32 = 0.1;
const AS_BEFORE: f32 = 0.2;

/// Places among a hop's numbers: of each horizontal component that of its level beside pressure's and that of its coherence.
const NORTH: (usize, usize) = (0, 3);
const EAST: (usize, usize) = (1, 4);
const NORTH_OVER_EAST: usize = 2;
const VERTICAL: usize = 5;
const PRESSURE: usize = 6;

/// A hop: levels of pressure, north and east, coherences of north, east and vertical with pressure.
#[derive(Clone, Copy, Debug)]
struct Hop {
    level: [i16; 3],
    coherence: [i8; 3],
}

/// What has happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Jump {
    /// North is louder beside east by so many dB than it was: of its gain where that is certain, of its own noise or its gain where not.
    Louder(f32, bool),
    /// A horizontal component hears nothing any more: 0 north, 1 east.
    Deaf(usize),
    /// Pressure and motion go together the other way round.
    Reversed,
}

/// The last hops.
#[derive(Clone, Debug)]
pub(super) struct Jumps {
    hops: [Hop; 2 * HOPS],
    next: u8,
    held: u8,
    /// Hops left out since the newest.
    left_out: u8,
}

/// Means of both sides, and differences between those hops of each that are next to the moment.
#[derive(Clone, Copy, Debug)]
struct Sides {
    before: [f32; 7],
    after: [f32; 7],
    next: [f32; 7],
}

// Each is asked in many places, and flash is short.
impl Sides {
    #[inline(never)]
    fn change(&self, i: usize) -> f32 {
        match (self.after.get(i), self.before.get(i)) {
            (Some(after), Some(before)) => after - before,
            _ => 0.0,
        }
    }

    /// Whether most of the change lies next to the moment.
    #[inline(never)]
    fn is_abrupt(&self, i: usize) -> bool {
        self.next.get(i).is_some_and(|next| next / self.change(i) > ABRUPT)
    }

    /// Whether it was more than so much before, to either side.
    #[inline(never)]
    fn was(&self, i: usize, least: f32) -> bool {
        self.before.get(i).is_some_and(|before| math::f32::abs(*before) > least)
    }

    /// Whether that is less than so much after, to either side.
    fn is_below(&self, i: usize, most: f32) -> bool {
        self.after.get(i).is_some_and(|after| math::f32::abs(*after) < most)
    }

    /// Whether it changed by less than so much.
    #[inline(never)]
    fn keeps(&self, i: usize, most: f32) -> bool {
        math::f32::abs(self.change(i)) < most
    }

    /// Whether a component that heard a vessel hears it the other way round.
    #[inline(never)]
    fn is_turned(&self, i: usize) -> bool {
        let now = self.after.get(i).zip(self.before.get(i)).map_or(0.0, |(after, before)| after + before);
        self.was(i, HEARD) && math::f32::abs(now) < AS_BEFORE && self.is_abrupt(i)
    }
}

impl Hop {
    const NONE: Self = Self { level: [0; 3], coherence: [0; 3] };

    fn new(m: &Moments) -> Self {
        let [pressure, north, east, _] = m.power;
        let level = |power: f32| {
            let mean = (power / m.instants.max(1) as f32).max(1e-3);
            (10.0 * math::f32::log10(mean) / LEVEL_DB) as i16
        };
        let coherence = |c: f32| math::f32::round(c.clamp(-1.0, 1.0) / COHERENCE) as i8;
        Self { level: [pressure, north, east].map(level), coherence: m.coherences().map(coherence) }
    }

    /// Levels of north and east beside pressure's and of north beside east's, dB, then coherences, then the level of pressure.
    fn values(&self) -> [f32; 7] {
        let ([p, n, e], [cn, ce, cz]) = (self.level, self.coherence);
        let beside = |a: i16, b: i16| f32::from(a - b) * LEVEL_DB;
        let coherence = |c: i8| f32::from(c) * COHERENCE;
        let pressure = f32::from(p) * LEVEL_DB;
        [beside(n, p), beside(e, p), beside(n, e), coherence(cn), coherence(ce), coherence(cz), pressure]
    }
}

impl Jumps {
    /// Nothing heard; all zeros.
    pub(super) const fn new() -> Self {
        Self { hops: [Hop::NONE; 2 * HOPS], next: 0, held: 0, left_out: 0 }
    }

    /// The next hop does not follow those before.
    pub(super) fn interrupted(&mut self) {
        self.held = 0;
    }

    /// A hop was no measure: so many of them are time in which anything may have happened.
    pub(super) fn left_out(&mut self) {
        self.left_out = self.left_out.saturating_add(1);
        if usize::from(self.left_out) > HOPS {
            self.interrupted();
        }
    }

    /// Takes the next hop; what has happened [`HOPS`] hops before.
    pub(super) fn hop(&mut self, moments: &Moments) -> Option<Jump> {
        self.left_out = 0;
        if let Some(slot) = self.hops.get_mut(usize::from(self.next)) {
            *slot = Hop::new(moments);
        }
        self.next = (self.next + 1) % (2 * HOPS) as u8;
        self.held = (self.held + 1).min(2 * HOPS as u8);
        if usize::from(self.held) < 2 * HOPS {
            return None;
        }
        let found = self.found();
        if found.is_some() {
            self.held = 0;
        }
        found
    }

    /// Hop `k` from the oldest.
    #[inline(never)]
    fn at(&self, k: usize) -> [f32; 7] {
        let place = (usize::from(self.next) + k) % (2 * HOPS);
        self.hops.get(place).map_or([0.0; 7], Hop::values)
    }

    /// Means over the hops of both sides but for those beside the moment, which may be of both.
    fn sides(&self) -> Sides {
        let mut out = Sides { before: [0.0; 7], after: [0.0; 7], next: [0.0; 7] };
        for k in 0..2 * HOPS {
            // From the moment on, to either side.
            let (side, sign, from) = if k < HOPS {
                (&mut out.before, -1.0, HOPS - 1 - k)
            } else {
                (&mut out.after, 1.0, k - HOPS)
            };
            let part = if from == 0 { 0.0 } else { 1.0 / (HOPS - 1) as f32 };
            let of_next = if from < NEXT { sign / NEXT as f32 } else { 0.0 };
            for ((all, next), value) in side.iter_mut().zip(&mut out.next).zip(self.at(k)) {
                *all += part * value;
                *next += of_next * value;
            }
        }
        out
    }

    // Of its own: seldom more than its beginning is worked through.
    #[inline(never)]
    fn found(&self) -> Option<Jump> {
        let sides = self.sides();
        let signs = [NORTH.1, EAST.1, VERTICAL];
        // Every component that heard a vessel hears it the other way round: the vertical one too, which none does overhead.
        let (mut heard, mut turned, mut no_sound) = (0, 0, true);
        for i in signs {
            heard += u8::from(sides.was(i, HEARD));
            turned += u8::from(sides.is_turned(i));
            no_sound &= sides.keeps(i, UNCHANGED);
        }
        // Another sound that sets in on the other side is louder than the vessel; nothing else keeps its levels.
        let is_as_loud = sides.keeps(PRESSURE, AS_LOUD_DB) && sides.keeps(NORTH_OVER_EAST, AS_LOUD_DB);
        if turned >= 2 && turned == heard && is_as_loud {
            return Some(Jump::Reversed);
        }
        for (k, (own, other)) in [(NORTH, EAST), (EAST, NORTH)].into_iter().enumerate() {
            if !sides.keeps(other.0, STILL_DB) {
                continue;
            }
            let jumps = |i: usize| !sides.keeps(i, JUMP_DB) && sides.is_abrupt(i);
            let level = jumps(own.0) && jumps(NORTH_OVER_EAST) && self.is_even(&sides);
            let lost = sides.change(own.0) < DEAF_DB;
            // What has another gain is as coherent as before, unless it is lost in the noise of what converts it; sound that sets in is not.
            let is_direction = [own.1, other.1].into_iter().any(|i| sides.was(i, DOMINATES));
            if level && !lost && no_sound && !is_direction {
                // More noise would have taken a quarter and more from how it goes with a vessel's pressure, which is seen where that was much.
                return Some(Jump::Louder(sides.change(NORTH_OVER_EAST), sides.was(own.1, CERTAIN)));
            }
            let is_silent = sides.was(own.1, WELL)
                && sides.is_below(own.1, UNHEARD)
                && sides.keeps(other.1, AS_BEFORE)
                && sides.is_abrupt(own.1);
            if level && lost || is_silent {
                return Some(Jump::Deaf(k));
            }
        }
        None
    }

    /// Whether the hops' ratio of both horizontals keeps to the mean of its side.
    fn is_even(&self, sides: &Sides) -> bool {
        let off = |k: usize| {
            let mean = if k < HOPS { &sides.before } else { &sides.after };
            math::f32::abs(self.at(k)[NORTH_OVER_EAST] - mean[NORTH_OVER_EAST])
        };
        let rough = (0..2 * HOPS).map(off).sum::<f32>() / (2 * HOPS) as f32;
        rough < ROUGH.0 + ROUGH.1 * math::f32::abs(sides.change(NORTH_OVER_EAST))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// A hop of noise with a vessel of that part of the power in each component.
    fn hop(n: usize, heard: [f32; 4], noise: [f32; 4]) -> Moments {
        let chance = |k: usize| 1.0 + 0.07 * math::f32::sin(12.9 * ((n + 1) * (k + 3)) as f32);
        let [pressure, ..] = heard;
        let power: [f32; 4] = core::array::from_fn(|k| 1e6 * chance(k) * (heard[k] * heard[k] + noise[k]));
        let with_pressure = core::array::from_fn(|k| 1e6 * heard[k] * pressure);
        Moments { power, with_pressure, instants: 512, ..Moments::NONE }
    }

    fn said(hops: impl Iterator<Item = Moments>) -> Vec<Jump> {
        let mut jumps = Jumps::new();
        hops.filter_map(|m| jumps.hop(&m)).collect()
    }

    const HEARD_OF: [f32; 4] = [1.0, 1.0, -1.0, 0.7];

    /// The same hour with another factor of each component from its half on.
    fn altered(heard: [f32; 4], factors: [f32; 4]) -> Vec<Jump> {
        said((0..360).map(|n| {
            let mut m = hop(n, heard, [1.0, 0.8, 0.8, 1.0]);
            if n >= 180 {
                let [p, ..] = factors;
                for k in 0..4 {
                    m.power[k] *= factors[k] * factors[k];
                    m.with_pressure[k] *= factors[k] * p;
                }
            }
            m
        }))
    }

    #[test]
    fn a_gain_that_jumps_is_told_with_and_without_a_vessel() {
        for heard in [HEARD_OF, [0.0; 4]] {
            for (factors, ratio_db) in
                [([1.0, 1.41, 1.0, 1.0], 3.0), ([1.0, 0.71, 1.0, 1.0], -3.0), ([1.0, 1.0, 2.0, 1.0], -6.0)]
            {
                let said = altered(heard, factors);
                let [Jump::Louder(db, certain)] = said[..] else { panic!("{said:?}") };
                assert!((db - ratio_db).abs() < 0.3 && certain == (heard == HEARD_OF), "{db}");
            }
            assert_eq!(altered(heard, [1.0, 1.0, 0.01, 1.0]), [Jump::Deaf(1)]);
            // All louder alike is no component's.
            assert_eq!(altered(heard, [2.0; 4]), []);
        }
    }

    #[test]
    fn noise_of_a_component_s_own_is_no_certain_gain() {
        for north in [0.2f32, 0.4, 0.6, 0.8, 1.0, 1.5] {
            for noise in [0.78f32, 1.0, 3.0] {
                // So much more noise of north's own as makes it louder by that.
                let before = north * north + 0.8;
                let after = 0.8 + noise * before;
                let said = said((0..360).map(|n| {
                    hop(n, [1.0, north, -0.5, 0.7], [1.0, if n < 180 { 0.8 } else { after }, 0.8, 1.0])
                }));
                assert!(
                    !said.iter().any(|jump| matches!(jump, Jump::Louder(_, true))),
                    "{north} {noise}: {said:?}"
                );
            }
        }
    }

    #[test]
    fn pressure_that_is_turned_round_is_told_while_a_vessel_is_heard() {
        assert_eq!(altered(HEARD_OF, [-1.0, 1.0, 1.0, 1.0]), [Jump::Reversed]);
        assert_eq!(altered([0.0; 4], [-1.0, 1.0, 1.0, 1.0]), []);
        // One horizontal component alone: vessels overhead go so, though not at once.
        assert_eq!(altered(HEARD_OF, [1.0, -1.0, 1.0, 1.0]), []);
    }

    #[test]
    fn a_component_that_hears_its_own_noise_alone_is_told_while_a_vessel_is_heard() {
        let deaf = |n: usize| {
            let mut m = hop(n, HEARD_OF, [1.0, 0.8, 0.8, 1.0]);
            if n >= 180 {
                m.with_pressure[1] *= 0.02;
            }
            m
        };
        assert_eq!(said((0..360).map(deaf)), [Jump::Deaf(0)]);
    }

    #[test]
    fn vessels_that_pass_and_calls_that_set_in_are_none() {
        // Past, from north to south, two kilometres away at ten metres a second, as loud as it gets.
        let passes = |n: usize| {
            let along = 102.0 * (n as f32 - 180.0);
            let (range, level) = (math::f32::sqrt(along * along + 4e6), 3.0);
            let near = level * 2_000.0 / range;
            hop(n, [near, -near * along / range, near * 2_000.0 / range, 0.7 * near], [1.0, 0.8, 0.8, 1.0])
        };
        assert_eq!(said((0..360).map(passes)), []);
        // Sound from north that sets in at once; pressure's noise is louder than the ground's.
        for noise in [0.5, 1.0, 2.0] {
            let sets_in = |n: usize| {
                let s = if n < 180 { 0.0 } else { 1.0 };
                hop(n, [s, s, 0.0, 0.4 * s], [noise, 0.5, 0.5, 0.5])
            };
            assert_eq!(said((0..360).map(sets_in)), []);
        }
        // Another that sets in opposite to a vessel.
        for louder in [0.8f32, 1.0, 1.5, 2.0] {
            let opposite = |n: usize| {
                let s = if n < 180 { 0.0 } else { louder };
                let mut m = hop(n, [0.7, 0.7, 0.6, 0.1], [0.5, 0.5, 0.5, 0.5]);
                let other = hop(n, [s, -s, -s, 0.1 * s], [0.0; 4]);
                m.add(&Moments { instants: 0, ..other });
                m
            };
            assert!(!said((0..360).map(opposite)).contains(&Jump::Reversed), "{louder}");
        }
        // A gap.
        let mut jumps = Jumps::new();
        for n in 0..17 {
            assert_eq!(jumps.hop(&hop(n, HEARD_OF, [1.0; 4])), None);
        }
        jumps.interrupted();
        for n in 0..17 {
            assert_eq!(jumps.hop(&hop(n, [0.0; 4], [1.0, 3.0, 1.0, 1.0])), None);
        }
    }
}
