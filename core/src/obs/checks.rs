//! What the station finds doubtful about its own set-up, from what it hears anyway.
//!
//! Enters: once a minute, the moments of its four components (`moments`) and whether a vessel was heard. Leaves: a fault where
//! something has been wrong for long, once, and [`FaultCode::SetUpGood`] when it is right again.
//!
//! - Sign. Vessels sound from above: vertical motion and pressure go together with one sign, whatever the direction. A vote a
//!   minute in which a vessel is heard and the two are coherent. Mostly the other sign: pressure or the motion is turned round.
//!   Both signs in turn, but a horizontal component with one only: that is the vertical one.
//! - Gain. What of a horizontal component's power is not coherent with pressure is noise without a direction, and as strong in
//!   one as in the other. The median of its ratio over minutes without a vessel, followed in small steps: an hour of a shaking
//!   instrument moves it by a third of a decibel. Noise of several directions at once makes 1.5 dB of difference; its minutes are told
//!   by their horizontal components, which go together, unless its axis is one of theirs.
//!
//! Horizontal components exchanged, one of them turned round, or an orientation that is off are beyond any check here: the
//! station's world is then turned or mirrored, and vessels of a mirrored world are vessels. Vessels of known track tell them.
//! Cost: 200 instructions a minute.

use super::moments::Moments;
use super::pairs::{Pairs, Profiles};
use crate::intake::Faults;
use crate::math;
use crate::wire::{Fault, FaultCode, Message};

/// Least coherence of a minute for a vote: four times what chance makes of a minute's 1000 independent products.
const COHERENT: f32 = 0.12;

/// Votes of the vertical component below which nothing is said, and those from which on the older half is forgotten.
const VOTES: u16 = 90;
const MOST_VOTES: u16 = 360;

/// Share of the votes that says which sign a component has; above the second it has one only, below the third it has both.
const MOSTLY: f32 = 0.85;
const ONE_SIDED: f32 = 0.97;
const BOTH_SIDES: f32 = 0.92;

/// Step of the medians, dB a minute; after so many minutes it becomes smaller as they grow in number, to that share of it, for
/// hours of an instrument that shakes less than is noticed must not move them.
const STEP_DB: f32 = 0.01;
const SETTLED: u16 = 400;
const LEAST_STEP: f32 = 0.3;

/// A minute is no measure of the gain where the horizontal motion is this much above its median against pressure, dB.
const SHAKING_DB: f32 = 1.0;

/// What is left of the horizontal components has a direction of its own where they go together by more than this, twice what
/// chance makes of a minute: noise of several directions at once.
const TOGETHER: f32 = 0.08;

/// Ratio at which horizontal components are unequal, and below which they are equal again, dB.
const UNEQUAL_DB: f32 = 2.0;
const EQUAL_DB: f32 = 1.5;

/// Difference of two pairs of paths at which the table does not fit, and below which it fits again, m.
const APART_M: f32 = 250.0;
const TOGETHER_M: f32 = 150.0;

/// Components: pressure, north, east, vertical.
const NORTH: usize = 1;
const EAST: usize = 2;
const VERTICAL: usize = 3;

/// What the minute holds beside its moments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// A vessel.
    Vessel,
    /// Nothing that stands out.
    Nothing,
    /// Something else: calls.
    Other,
}

/// Minutes in which a component went with pressure, and against it.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    with: u16,
    against: u16,
}

/// A ratio of powers in decibels.
fn decibels(ratio: f32) -> f32 {
    10.0 * math::f32::log10(ratio)
}

impl Votes {
    const NONE: Self = Self { with: 0, against: 0 };

    fn all(self) -> u16 {
        self.with + self.against
    }

    /// Share of the votes for the more frequent sign; none of too few.
    fn lean(self) -> Option<f32> {
        let most = self.with.max(self.against);
        (self.all() >= VOTES).then(|| f32::from(most) / f32::from(self.all()))
    }

    fn is_one_sided(self) -> bool {
        self.lean().is_some_and(|share| share >= ONE_SIDED)
    }

    fn is_both_sided(self) -> bool {
        self.lean().is_some_and(|share| share < BOTH_SIDES)
    }
}

/// State.
#[derive(Clone, Debug)]
pub(super) struct Checks {
    minute: Moments,
    /// Of north, east, vertical.
    votes: [Votes; 3],
    /// Medians of north over east, and of both over pressure, dB.
    ratio_db: f32,
    motion_db: Option<f32>,
    /// Minutes they are of.
    compared: u16,
    /// The component that was said to be wrong, the vertical one by its sign, a horizontal one by being the vertical; 0: none.
    said_component: u8,
    said_unequal: bool,
    pairs: Pairs,
    said_table: bool,
}

impl Checks {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self {
            minute: Moments::NONE,
            votes: [Votes::NONE; 3],
            ratio_db: 0.0,
            motion_db: None,
            compared: 0,
            said_component: 0,
            said_unequal: false,
            pairs: Pairs::new(),
            said_table: false,
        }
    }

    /// Takes a hop in which no component was wrong.
    pub(super) fn hop(&mut self, moments: &Moments) {
        self.minute.add(moments);
    }

    /// Ends a minute at `index`; `towards`: sound from above moves the ground with the sign of its pressure.
    pub(super) fn minute(
        &mut self,
        heard: Heard,
        towards: bool,
        index: u64,
        faults: &mut Faults,
        sink: &mut dyn FnMut(Message),
    ) {
        let m = core::mem::replace(&mut self.minute, Moments::NONE);
        if m.instants == 0 {
            return;
        }
        match heard {
            Heard::Vessel => {
                self.vote(&m);
                self.tell_sign(towards, index, faults, sink);
            }
            Heard::Nothing => {
                self.compare(&m);
                self.tell_gain(index, faults, sink);
            }
            Heard::Other => {}
        }
    }

    fn vote(&mut self, m: &Moments) {
        let components = self.votes.iter_mut().zip(m.power.iter().zip(&m.with_pressure).skip(NORTH));
        let [pressure, ..] = m.power;
        for (votes, (power, product)) in components {
            let coherence = product / math::f32::sqrt(power * pressure).max(f32::MIN_POSITIVE);
            votes.with += u16::from(coherence > COHERENT);
            votes.against += u16::from(coherence < -COHERENT);
            if votes.all() >= MOST_VOTES {
                *votes = Votes { with: votes.with / 2, against: votes.against / 2 };
            }
        }
    }

    fn tell_sign(&mut self, towards: bool, index: u64, faults: &mut Faults, sink: &mut dyn FnMut(Message)) {
        let [north, east, vertical] = self.votes;
        let Some(lean) = vertical.lean() else { return };
        let right = (vertical.with > vertical.against) == towards;
        // While every vessel is on one side of a component, that may be the vertical one; and while all are on one side of both,
        // nothing can be said.
        let found = match (lean >= MOSTLY, north.is_both_sided(), east.is_both_sided()) {
            (true, true, true) => {
                if right {
                    0
                } else {
                    VERTICAL
                }
            }
            (false, false, true) if north.is_one_sided() => NORTH,
            (false, true, false) if east.is_one_sided() => EAST,
            _ => return,
        } as u8;
        let said = core::mem::replace(&mut self.said_component, found);
        if said == found {
            return;
        }
        let code = |component: u8| {
            if usize::from(component) == VERTICAL { FaultCode::Reversed } else { FaultCode::Exchanged }
        };
        if said > 0 {
            faults.note(FaultCode::SetUpGood, index, code(said) as u64, sink);
        }
        if found > 0 {
            faults.note(code(found), index, u64::from(found), sink);
        }
    }

    fn compare(&mut self, m: &Moments) {
        let [pressure, north, east, _] = m.power;
        let [_, of_north, of_east, _] = m.with_pressure;
        let alone = |power: f32, product: f32| power - product * product / pressure.max(f32::MIN_POSITIVE);
        let (north, east) = (alone(north, of_north), alone(east, of_east));
        if !(north > 0.0 && east > 0.0 && pressure > 0.0) {
            return;
        }
        let together = m.north_east - of_north * of_east / pressure;
        if math::f32::abs(together) > TOGETHER * math::f32::sqrt(north * east) {
            return;
        }
        let motion_db = decibels((north + east) / pressure);
        let usual_db = self.motion_db.get_or_insert(motion_db);
        self.compared = self.compared.saturating_add(1);
        let step_db = STEP_DB * (f32::from(SETTLED) / f32::from(self.compared)).clamp(LEAST_STEP, 1.0);
        *usual_db += step_db * (motion_db - *usual_db).signum();
        // A shaking instrument says nothing of its gain.
        if motion_db < *usual_db + SHAKING_DB {
            self.ratio_db += step_db * (decibels(north / east) - self.ratio_db).signum();
        }
    }

    /// Takes what a minute says of the propagation table.
    pub(super) fn ranges(
        &mut self,
        profiles: &mut Profiles,
        index: u64,
        faults: &mut Faults,
        sink: &mut dyn FnMut(Message),
    ) {
        let Some(apart_m) = self.pairs.take(profiles) else { return };
        if !self.said_table && math::f32::abs(apart_m) >= APART_M {
            self.said_table = true;
            let value = math::f32::round(apart_m) as i64;
            faults.gather(Fault { code: FaultCode::TableOff, index, value }, sink);
        } else if self.said_table && math::f32::abs(apart_m) < TOGETHER_M {
            self.said_table = false;
            faults.note(FaultCode::SetUpGood, index, FaultCode::TableOff as u64, sink);
        }
    }

    /// Whether it was said that the propagation table does not fit.
    pub(super) fn table_is_off(&self) -> bool {
        self.said_table
    }

    fn tell_gain(&mut self, index: u64, faults: &mut Faults, sink: &mut dyn FnMut(Message)) {
        let off_db = math::f32::abs(self.ratio_db);
        if !self.said_unequal && off_db >= UNEQUAL_DB {
            self.said_unequal = true;
            let value = math::f32::round(10.0 * self.ratio_db) as i64;
            faults.gather(Fault { code: FaultCode::Unequal, index, value }, sink);
        } else if self.said_unequal && off_db < EQUAL_DB {
            self.said_unequal = false;
            faults.note(FaultCode::SetUpGood, index, FaultCode::Unequal as u64, sink);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Moments of a minute with a vessel: products of north, east, vertical with pressure, all powers 1.
    fn vessel(products: [f32; 3]) -> Moments {
        let [north, east, vertical] = products;
        Moments {
            power: [1.0; 4],
            with_pressure: [1.0, north, east, vertical],
            instants: 3000,
            ..Moments::NONE
        }
    }

    /// What is said in so many minutes.
    fn said(minutes: usize, heard: Heard, moments: impl Fn(usize) -> Moments) -> Vec<(FaultCode, i64)> {
        let (mut checks, mut faults, mut said) = (Checks::new(), Faults::new(), Vec::new());
        for n in 0..minutes {
            checks.hop(&moments(n));
            checks.minute(heard, false, n as u64, &mut faults, &mut |m| {
                if let Message::Fault(f) = m {
                    said.push((f.code, f.value));
                }
            });
        }
        said
    }

    /// A vessel every two hours, on the other side of each component than the one before; `order` puts its components, of sound
    /// from above, in their places.
    fn traffic(order: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<(FaultCode, i64)> {
        said(1200, Heard::Vessel, |n| {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            vessel(order([0.5 * c, 0.5 * s, -0.4]))
        })
    }

    #[test]
    fn a_sign_turned_round_and_components_exchanged_are_named_once() {
        assert_eq!(traffic(|v| v), []);
        assert_eq!(traffic(|v| v.map(|x| -x)), [(FaultCode::Reversed, 3)]);
        assert_eq!(traffic(|[n, e, z]| [z, e, n]), [(FaultCode::Exchanged, 1)]);
        assert_eq!(traffic(|[n, e, z]| [n, z, e]), [(FaultCode::Exchanged, 2)]);
        // What cannot be told: a mirrored world.
        assert_eq!(traffic(|[n, e, z]| [e, n, z]), []);
        assert_eq!(traffic(|[n, e, z]| [-n, e, z]), []);
    }

    #[test]
    fn what_is_right_again_is_told() {
        let turned = said(2400, Heard::Vessel, |n| {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            vessel([0.5 * c, 0.5 * s, if n < 600 { 0.4 } else { -0.4 }])
        });
        assert_eq!(turned, [(FaultCode::Reversed, 3), (FaultCode::SetUpGood, FaultCode::Reversed as i64)]);
    }

    #[test]
    fn unequal_components_are_named_and_a_shaking_instrument_is_not() {
        let noise = |north: f32| Moments {
            power: [1.0, north, 1.0, 1.0],
            with_pressure: [1.0, 0.0, 0.0, 0.0],
            instants: 3000,
            ..Moments::NONE
        };
        let two_db = |north: f32| said(400, Heard::Nothing, |_| noise(north));
        assert_eq!(two_db(2.0), [(FaultCode::Unequal, 20)]);
        assert_eq!(two_db(0.5), [(FaultCode::Unequal, -20)]);
        assert_eq!(two_db(1.3), []);
        // Four hours of strumming along north, 10 dB above the noise.
        assert_eq!(said(1440, Heard::Nothing, |n| noise(if n % 720 > 480 { 10.0 } else { 1.0 })), []);
        // Noise from north that goes with pressure is no gain.
        let coherent = Moments { with_pressure: [1.0, 0.7, 0.0, 0.0], ..noise(1.49) };
        assert_eq!(said(1000, Heard::Nothing, |_| coherent), []);
        // Noise of two directions at once, whose difference points between north and east, or stronger.
        let two = Moments { north_east: 0.2, ..noise(2.0) };
        assert_eq!(said(1000, Heard::Nothing, |_| two), []);
        // As it would be without that.
        assert_eq!(said(1000, Heard::Nothing, |_| noise(1.7)), [(FaultCode::Unequal, 20)]);
    }
}
