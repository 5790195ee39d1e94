//! Which sign vertical motion has with pressure where a sound from below sets in.
//!
//! Enters: the four components, filtered ([`super::moments`]), instant by instant. Leaves: the sign, once [`ALIKE`] sounds in a row have had the same.
//!
//! An earthquake's first waves come steeply from below. Until the surface has given them back, twice the water's depth later, they go up past the station
//! alone: the water is pressed together as the floor rises, whatever way the earth first moved. That is the sign opposite to a vessel's, whose sound comes
//! from above, and it needs no vessel. Power is summed over half seconds; a sound counts
//!
//! * that is [`SETS_IN`] times above the usual in pressure and vertical motion within [`RISES`] of them;
//! * that is alone: nothing [`LOUD`] times above the usual was heard in the [`QUIET`] blocks before it, nor is in as many once it has had [`OWN`] to fade
//!   away. Calls of whales and a survey's shots are not;
//! * whose first second is steeper than 55°, and moves pressure and the vertical together;
//! * that lasts for [`LASTS`] half seconds without a pause, as an earthquake and no call, spike or single shot does.
//!
//! *Fails* where a single long sound sets in suddenly overhead. In water of less than 1.6 km the surface's answer is in the first second: there nothing is asked;
//! nor in a record with a gap every twenty minutes, where nothing is known to be alone.
//! Cost: 12 instructions an instant.

use crate::block::CHANNELS;
use crate::math;

/// Length of a block, seconds.
const BLOCK_S: f64 = 0.5;
/// The surface must be silent for so long: three blocks, of which the sound sets in within the first or just before it, and what the filter adds.
const UP_ALONE_S: f32 = 1.7;
/// Sine of the least steep that counts: the surface answers so much sooner than straight up and back.
const SINE: f32 = 0.82;

/// Power that sets in, that lasts, and that is something else, in units of the usual.
const SETS_IN: f32 = 30.0;
const STAYS: f32 = 2.5;
const LOUD: f32 = 6.0;
/// Blocks without anything else before it and after it, of it alone, and in which it must last without a pause.
const QUIET: u16 = 1200;
const RISES: u8 = 4;
const OWN: u16 = 240;
const LASTS: u8 = 16;
/// Blocks over which the usual power is averaged, and most that one counts, in units of it.
const AVERAGED: f32 = 120.0;
const MOST: f32 = 4.0;
/// Vertical power over horizontal: tan² 55°.
const STEEP: f32 = 2.0;
/// Least coherence of pressure and vertical motion.
const TOGETHER: f32 = 0.7;
/// Sounds in a row.
const ALIKE: i8 = 3;

/// Sums over instants: powers of pressure, vertical and both horizontal components, and the product of the first two.
type Sums = [f32; 4];

/// Instants of a block where the water is deep enough, by the time that sound takes straight up to the surface (seconds); 0: it is not.
pub(super) fn block(rate_hz: f64, straight_up_s: f32) -> u16 {
    if 2.0 * SINE * straight_up_s < UP_ALONE_S { 0 } else { math::f64::round(BLOCK_S * rate_hz) as u16 }
}

/// What sounds from below have shown. All zeros at the beginning.
#[derive(Clone, Debug)]
pub(super) struct FirstMotions {
    sums: Sums,
    instants: u16,
    /// Blocks since anything loud.
    quiet: u16,
    /// Usual powers of pressure and vertical motion in a block.
    usual: [f32; 2],
    /// The first second of the sound that goes on, and how many blocks it has lasted; 0: none does.
    onset: Sums,
    lasted: u8,
    /// Whether it rose as fast as an earthquake does.
    rose: bool,
    /// The sign of one that lasted, and blocks since: it counts once it is known to have been alone. 0: none.
    held: i8,
    since: u16,
    /// Sounds in a row with the same sign: above 0 together, below 0 against each other.
    alike: i8,
}

impl FirstMotions {
    pub(super) const NONE: Self = Self {
        sums: [0.0; 4],
        instants: 0,
        quiet: 0,
        usual: [0.0; 2],
        onset: [0.0; 4],
        lasted: 0,
        rose: false,
        held: 0,
        since: 0,
        alike: 0,
    };

    /// A run begins: no sound goes on.
    pub(super) fn begin(&mut self) {
        *self = Self { usual: self.usual, alike: self.alike, ..Self::NONE };
    }

    /// Takes an instant's filtered pressure, north, east and vertical, of blocks of so many.
    #[inline(always)]
    pub(super) fn push(&mut self, block: u16, [pressure, north, east, vertical]: [f32; CHANNELS]) {
        let values =
            [pressure * pressure, vertical * vertical, north * north + east * east, pressure * vertical];
        self.sums.iter_mut().zip(values).for_each(|(sum, x)| *sum += x);
        self.instants += 1;
        if self.instants >= block {
            self.end_block();
        }
    }

    #[inline(never)]
    fn end_block(&mut self) {
        self.instants = 0;
        let sums = core::mem::take(&mut self.sums);
        let [pressure, vertical, ..] = sums;
        let [usual_pressure, usual_vertical] = self.usual;
        let above = |times: f32| pressure > times * usual_pressure && vertical > times * usual_vertical;
        if self.lasted > 0 {
            if self.lasted == 1 {
                self.onset.iter_mut().zip(sums).for_each(|(all, x)| *all += x);
            }
            self.rose |= self.lasted < RISES && above(SETS_IN);
            self.lasted = if above(STAYS) { self.lasted + 1 } else { 0 };
            if self.lasted > LASTS {
                (self.held, self.since, self.lasted) = (self.sign(), 0, 0);
            }
        } else if above(LOUD) && self.quiet >= QUIET {
            (self.onset, self.lasted, self.rose) = (sums, 1, above(SETS_IN));
        }
        self.since = self.since.saturating_add(1);
        if above(LOUD) {
            self.quiet = 0;
            if self.since > OWN {
                self.held = 0;
            }
        } else {
            self.quiet = self.quiet.saturating_add(1);
            if self.quiet >= QUIET {
                self.count();
            }
        }
        for (usual, power) in self.usual.iter_mut().zip(sums) {
            *usual =
                if *usual > 0.0 { *usual + ((MOST * *usual).min(power) - *usual) / AVERAGED } else { power };
        }
    }

    /// The sign of the sound that lasted; 0 where it has none.
    fn sign(&self) -> i8 {
        let [pressure, vertical, level, product] = self.onset;
        let together = product
            / math::f32::sqrt(pressure).max(f32::MIN_POSITIVE)
            / math::f32::sqrt(vertical).max(f32::MIN_POSITIVE);
        if !self.rose || vertical < STEEP * level || !(math::f32::abs(together) > TOGETHER) {
            return 0;
        }
        if together > 0.0 { 1 } else { -1 }
    }

    /// Counts the sound that was alone, if one was.
    fn count(&mut self) {
        let before = match self.held {
            0 => return,
            1 => self.alike.max(0),
            _ => self.alike.min(0),
        };
        self.alike = (before + core::mem::take(&mut self.held)).clamp(-ALIKE, ALIKE);
    }

    /// Whether pressure and vertical motion go together in sounds from below, once that is known.
    pub(super) fn together(&self) -> Option<bool> {
        (self.alike.abs() >= ALIKE).then_some(self.alike > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::mend::tests::gaussian;
    use super::*;

    const BLOCK: u16 = 25;

    /// A sound: when it sets in and for how long (blocks), amplitude over the sea's, steepness, and the sign of its vertical motion.
    #[derive(Clone, Copy)]
    struct Sound {
        at: usize,
        blocks: usize,
        amplitude: f32,
        up: f32,
        level: f32,
    }

    const QUAKE: Sound = Sound { at: 0, blocks: 60, amplitude: 20.0, up: 0.95, level: 0.3 };

    fn together(length: usize, sounds: &[Sound]) -> Option<bool> {
        let (mut motions, mut seed) = (FirstMotions::NONE, 7);
        for n in 0..length * usize::from(BLOCK) {
            let mut frame = [0.0f32; CHANNELS].map(|_| gaussian(&mut seed));
            let wave = gaussian(&mut seed);
            for sound in sounds {
                let age = n as f32 / f32::from(BLOCK) - sound.at as f32 - 0.4;
                if age > 0.0 && age < sound.blocks as f32 {
                    let x = sound.amplitude * wave * math::f32::exp(-1.5 * age / sound.blocks as f32);
                    let [up, level] = [sound.up, sound.level];
                    frame.iter_mut().zip([1.0, level, level, up]).for_each(|(y, factor)| *y += factor * x);
                }
            }
            motions.push(BLOCK, frame);
        }
        motions.together()
    }

    fn every(blocks: usize, sound: Sound) -> [Sound; 5] {
        core::array::from_fn(|k| Sound { at: 1300 + k * blocks, ..sound })
    }

    #[test]
    fn three_earthquakes_tell_the_sign() {
        let down = Sound { up: -QUAKE.up, ..QUAKE };
        assert_eq!(together(9000, &every(1500, QUAKE)), Some(true));
        assert_eq!(together(9000, &every(1500, down)), Some(false));
        assert_eq!(together(5000, &every(1500, QUAKE)), None);
        let [a, b, c, d, _] = every(1500, QUAKE);
        let turned = |s: Sound| Sound { up: -s.up, ..s };
        assert_eq!(together(9000, &[a, b, turned(c), d]), None);
    }

    #[test]
    fn no_call_shot_spike_level_sound_or_noise_tells_one() {
        for wrong in [
            Sound { blocks: 2, ..QUAKE },
            Sound { level: 0.95, ..QUAKE },
            Sound { amplitude: 3.0, ..QUAKE },
            Sound { up: 0.0, level: 0.0, ..QUAKE },
        ] {
            assert_eq!(together(9000, &every(1500, wrong)), None);
        }
        // Shots of a survey and calls, however long they are and however few are as loud as an earthquake.
        let calls: [Sound; 40] = core::array::from_fn(|k| Sound {
            at: 1300 + k * 300,
            blocks: 40,
            amplitude: if k % 10 == 0 { 20.0 } else { 4.0 },
            ..QUAKE
        });
        assert_eq!(together(15_000, &calls), None);
        assert_eq!(together(20_000, &[]), None);
    }

    #[test]
    fn shallow_water_is_not_asked() {
        assert_eq!(block(50.0, 0.5), 0);
        assert_eq!(block(50.0, 2.9), 25);
        assert_eq!(block(500.0, 2.9), 250);
    }
}
