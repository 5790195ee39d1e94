//! What the station finds doubtful about its own set-up, from what it hears anyway.
//!
//! Enters: once a minute, the moments of its four components (`moments`), whether a vessel was heard, and how fast it comes nearer. Leaves:
//! a fault where something has been wrong for long, once, and [`FaultCode::SetUpGood`] when it is right again (of a component that was
//! deaf [`FaultCode::ChannelBack`]).
//!
//! - Sign of pressure and vertical motion, and a vertical component in a horizontal one's place (`signs`): that something is wrong
//!   ([`FaultCode::SignInDoubt`]), and later what.
//!   Where no vessels have passed yet, by earthquakes (`first_motion`).
//! - Gain of the horizontal components: by noise and by vessels (`gains`).
//! - A horizontal component that hears nothing: while vessels pass the other (`deaf`); until that is known no direction is told (`unheard`).
//! - Pressure exchanged with a component of motion: what is called so has no part in some vessels' sound (`misplaced`).
//!
//! Horizontal components exchanged, one of them turned round, or an orientation that is off are beyond any check here: the
//! station's world is then turned or mirrored, and vessels of a mirrored world are vessels. Vessels of known track tell them.
//! Cost: 400 instructions a minute.

use super::deaf::{Deafness, HEARS, Hearing, News};
use super::evened::OwnNoise;
use super::gains::{Gain, Gains};
use super::misplaced::{Misplaced, Pressure};
use super::moments::Moments;
use super::pairs::{Pairs, Profiles};
use super::signs::{AllSigns, FEW_VOTES, VERTICAL};
use super::unheard::Unheard;
use crate::intake::Faults;
use crate::math;
use crate::wire::{Fault, FaultCode, Message};

/// Coherence of both horizontal components, squared, of a minute whose vessel hides no noise of theirs, and what such a minute counts beside one
/// without a vessel: in 24 days the ratio of their noise is within 0.5 dB of that of quiet minutes in most, and beside several vessels 3 dB off.
const HARDLY_HEARD: f32 = 0.06;
const BESIDE: f32 = 0.3;

/// Difference of two pairs of paths at which the table does not fit, and below which it fits again, m.
const APART_M: f32 = 250.0;
const TOGETHER_M: f32 = 150.0;

/// Added to the component that takes the place of pressure.
const PRESSURE: u8 = 4;

/// Least part of a minute whose moments are a measure, in this part of it.
const PART: u64 = 2;

/// What the minute holds beside its moments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// A vessel.
    Vessel,
    /// A vessel that is tracked and does not stand out.
    Expected,
    /// Nothing that stands out.
    Nothing,
    /// Something else: calls.
    Other,
}

/// A minute, beside its moments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Minute {
    /// Sample index.
    pub(super) index: u64,
    /// What was heard.
    pub(super) heard: Heard,
    /// Whether that is several vessels.
    pub(super) several: bool,
    /// Radial speed of the vessel whose range is sure, m/s.
    pub(super) speed_m_s: Option<f32>,
    /// Whether sound from above moves the ground with the sign of its pressure.
    pub(super) towards: bool,
    /// Whether sounds from below have, where that is known ([`super::first_motion`]).
    pub(super) from_below: Option<bool>,
    /// Instants of a whole one.
    pub(super) whole: u64,
}

/// State.
#[derive(Clone, Debug)]
pub(super) struct Checks {
    minute: Moments,
    signs: AllSigns,
    gains: Gains,
    pub(super) own_noise: OwnNoise,
    deafness: Deafness,
    unheard: Unheard,
    misplaced: Misplaced,
    /// The component that was said to be wrong, the vertical one by its sign, a horizontal one by being the vertical, one with
    /// [`PRESSURE`] by being pressure; 0: none.
    said_component: u8,
    /// Whether it was said that one of them is wrong, and not yet which.
    in_doubt: bool,
    /// Whether vessels have said or doubted anything of signs: earthquakes are asked no more.
    by_vessels: bool,
    pairs: Pairs,
    said_table: bool,
}

impl Checks {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self {
            minute: Moments::NONE,
            signs: AllSigns::NONE,
            gains: Gains::new(),
            own_noise: OwnNoise::new(),
            deafness: Deafness::new(),
            unheard: Unheard::new(),
            misplaced: Misplaced::NONE,
            said_component: 0,
            in_doubt: false,
            by_vessels: false,
            pairs: Pairs::new(),
            said_table: false,
        }
    }

    /// Takes a hop in which no component was wrong.
    pub(super) fn hop(&mut self, moments: &Moments) {
        self.minute.add(moments);
    }

    /// Takes what both horizontal components heard in the minute that ends, before directions are told of it.
    pub(super) fn listen(&mut self, whole: u64) {
        if self.minute.instants > 0 {
            let ([north, east, _], chance) = (self.minute.coherences(), self.minute.chance(whole));
            self.unheard.minute([north, east].map(|coherence| coherence / chance));
        }
    }

    /// Ends a minute.
    pub(super) fn minute(&mut self, minute: &Minute, faults: &mut Faults, sink: &mut dyn FnMut(Message)) {
        let m = core::mem::replace(&mut self.minute, Moments::NONE);
        if m.instants == 0 {
            return;
        }
        let (coherence, chance) = (m.coherences(), m.chance(minute.whole));
        match minute.heard {
            Heard::Vessel => {
                self.signs.take(&coherence, chance, minute.towards);
                if !minute.several {
                    self.gains.vessel(&m);
                }
            }
            Heard::Nothing | Heard::Expected | Heard::Other => {}
        }
        let [north, east, _] = coherence;
        let is_hardly_heard = north * north + east * east < HARDLY_HEARD * chance;
        let of_noise = match minute.heard {
            Heard::Nothing => 1.0,
            Heard::Vessel | Heard::Expected
                if is_hardly_heard && !minute.several && self.own_noise.is_young() =>
            {
                BESIDE
            }
            _ => 0.0,
        };
        if of_noise > 0.0 {
            if self.gains.noise(&m, of_noise) {
                self.own_noise.changed();
            }
            self.own_noise.take(&m, of_noise);
        } else if minute.heard == Heard::Vessel {
            self.gains.beside(&m);
        }
        let is_measure = u64::from(m.instants) * PART >= minute.whole;
        if is_measure && minute.heard != Heard::Other {
            self.misplaced.minute(&m);
        }
        self.tell_order(minute, faults, sink);
        self.tell_gain(minute.index, faults, sink);
        if is_measure {
            let Minute { several, speed_m_s, .. } = *minute;
            let vessel = minute.heard == Heard::Vessel;
            let hears = HEARS * chance;
            let news = self.deafness.minute(&Hearing { coherence, hears, vessel, several, speed_m_s });
            let told = news.map(|news| match news {
                News::Deaf(component) => (FaultCode::OwnNoise, component),
                News::Back(component) => (FaultCode::ChannelBack, component),
            });
            if let Some((code, component)) = told {
                faults.note(code, minute.index, u64::from(component), sink);
            }
        }
    }

    /// By how much north is louder than east, as far as that is known.
    pub(super) fn gain(&self) -> Gain {
        self.gains.gain()
    }

    /// Whether a horizontal component is deaf.
    pub(super) fn deaf(&self) -> bool {
        self.deafness.is_deaf()
    }

    /// Whether one may be, for it has heard nothing for long.
    pub(super) fn may_be_deaf(&self) -> bool {
        self.unheard.may_be_deaf()
    }

    fn tell_order(&mut self, minute: &Minute, faults: &mut Faults, sink: &mut dyn FnMut(Message)) {
        let Minute { towards, index, .. } = *minute;
        if self.said_component == 0 && !self.in_doubt && self.signs.are_contrary() {
            (self.in_doubt, self.by_vessels) = (true, true);
            self.signs.forget_right(towards);
            faults.note(FaultCode::SignInDoubt, index, VERTICAL as u64, sink);
        }
        let vertical = self.signs.vertical();
        let by_vessels = match self.misplaced.pressure() {
            Pressure::Right => self.signs.wrong(towards),
            // An instrument that shakes leaves the vertical component its sign, which it has beside pressure alone.
            Pressure::Elsewhere(component, either)
                if vertical.is_not(towards)
                    || either && (usize::from(component) == VERTICAL || vertical.all() < FEW_VOTES) =>
            {
                Some(PRESSURE | component)
            }
            // Signs of what may be no pressure are those of no component.
            _ => None,
        };
        self.by_vessels |= by_vessels.is_some();
        let by_earthquakes = || minute.from_below.filter(|_| !self.by_vessels);
        let wrong = |together: bool| if together == towards { VERTICAL as u8 } else { 0 };
        let Some(found) = by_vessels.or_else(|| by_earthquakes().map(wrong)) else { return };
        if core::mem::take(&mut self.in_doubt) {
            faults.note(FaultCode::SetUpGood, index, FaultCode::SignInDoubt as u64, sink);
        }
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

    /// Whether no direction is one: components are said to be exchanged, or something is wrong with them and it was not yet said what.
    pub(super) fn are_misplaced(&self) -> bool {
        match usize::from(self.said_component) {
            0 => self.in_doubt,
            said => said != VERTICAL,
        }
    }

    /// Whether what is called pressure is said to be none: no range is one then.
    pub(super) fn no_pressure(&self) -> bool {
        self.said_component & PRESSURE > 0
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
        match self.gains.news() {
            Some(Some(ratio_db)) => {
                let value = math::f32::round(10.0 * ratio_db) as i64;
                faults.gather(Fault { code: FaultCode::Unequal, index, value }, sink);
            }
            Some(None) => faults.note(FaultCode::SetUpGood, index, FaultCode::Unequal as u64, sink),
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::mend::tests::gaussian;
    use super::super::misplaced::tests::{order, sound};
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

    /// Minute `n`, of a station whose vertical motion should go against pressure.
    fn minute(n: usize, heard: Heard) -> Minute {
        Minute {
            index: n as u64,
            heard,
            several: false,
            speed_m_s: None,
            towards: false,
            from_below: None,
            whole: 3000,
        }
    }

    /// What is said in so many minutes.
    fn said(minutes: usize, heard: Heard, moments: impl Fn(usize) -> Moments) -> Vec<(FaultCode, i64)> {
        let (mut checks, mut faults, mut said) = (Checks::new(), Faults::new(), Vec::new());
        for n in 0..minutes {
            checks.hop(&moments(n));
            let minute = minute(n, heard);
            checks.minute(&minute, &mut faults, &mut |m| {
                if let Message::Fault(f) = m {
                    said.push((f.code, f.value));
                }
            });
        }
        said
    }

    /// It is known that something is wrong, and then what.
    const DOUBT: (FaultCode, i64) = (FaultCode::SignInDoubt, 3);
    const OVER: (FaultCode, i64) = (FaultCode::SetUpGood, FaultCode::SignInDoubt as i64);

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
        assert_eq!(traffic(|v| v.map(|x| -x)), [DOUBT, OVER, (FaultCode::Reversed, 3)]);
        assert_eq!(traffic(|[n, e, z]| [z, e, n]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
        assert_eq!(traffic(|[n, e, z]| [n, z, e]), [DOUBT, OVER, (FaultCode::Exchanged, 2)]);
        // What cannot be told: a mirrored world.
        assert_eq!(traffic(|[n, e, z]| [e, n, z]), []);
        assert_eq!(traffic(|[n, e, z]| [-n, e, z]), []);
    }

    /// What is said of vessels all around, with channels in another order.
    fn in_order(places: [usize; 4]) -> Vec<(FaultCode, i64)> {
        said(1200, Heard::Vessel, |n| order(&sound(n as f32 / 60.0, 4.0, [0.3, 0.8]), places))
    }

    #[test]
    fn pressure_exchanged_with_a_component_is_named_once() {
        assert_eq!(in_order([0, 1, 2, 3]), []);
        assert_eq!(in_order([1, 0, 2, 3]), [(FaultCode::Exchanged, 5)]);
        assert_eq!(in_order([2, 1, 0, 3]), [(FaultCode::Exchanged, 6)]);
        assert_eq!(in_order([3, 1, 2, 0]), [(FaultCode::Exchanged, 7)]);
        assert_eq!(in_order([0, 3, 2, 1]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
        // Where vertical motion goes with pressure in all that it does, the two cannot be told apart, and nothing wrong is said.
        let soft =
            |places| said(1200, Heard::Vessel, |n| order(&sound(n as f32 / 60.0, 4.0, [1.0, 0.8]), places));
        assert_eq!((soft([0, 1, 2, 3]), soft([3, 1, 2, 0])), (Vec::new(), Vec::new()));
    }

    /// What is said in a day of which minute `n` knows this of sounds from below, and of which a vessel, from minute 700 on, says that all is well.
    fn of_earthquakes(
        towards: bool,
        from_below: impl Fn(usize) -> Option<bool>,
    ) -> Vec<(FaultCode, i64, u64)> {
        let (mut checks, mut faults, mut said) = (Checks::new(), Faults::new(), Vec::new());
        for n in 0..1440 {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            let up = if towards { 0.4 } else { -0.4 };
            let heard = if n < 700 { Heard::Nothing } else { Heard::Vessel };
            checks.hop(&vessel(if n < 700 { [0.0; 3] } else { [0.5 * c, 0.5 * s, up] }));
            let minute = Minute { towards, from_below: from_below(n), ..minute(n, heard) };
            checks.minute(&minute, &mut faults, &mut |m| {
                if let Message::Fault(f) = m {
                    said.push((f.code, f.value, f.index));
                }
            });
        }
        said
    }

    #[test]
    fn what_earthquakes_told_before_does_not_overrule_vessels() {
        // Vessels of other strength and from elsewhere every ninety minutes, ten days; north and vertical stand for each other from minute 700 on.
        for seed in 1..12 {
            let (mut checks, mut faults, mut noise) = (Checks::new(), Faults::new(), Noise(seed));
            let mut random = |sd: f32| sd * noise.next() / 0.03;
            let (mut azimuth, mut power, mut named, mut cleared) = (0.0, 0.2, false, 0);
            for n in 0..14_400 {
                if n % 90 == 0 {
                    (azimuth, power) = (random(3.0), (0.12 + random(0.06)).max(0.03));
                }
                let (s, c) = math::f32::sin_cos(azimuth + (n % 90) as f32 / 30.0);
                let [north, east, up] =
                    [0.4 * c + random(0.03), 0.4 * s + random(0.03), random(0.06) - power];
                let is_vessel = n % 90 < 60;
                let heard = match (is_vessel, n < 700) {
                    (false, _) => [(); 3].map(|()| random(0.03)),
                    (true, true) => [north, east, up],
                    (true, false) => [up, east, north],
                };
                checks.hop(&vessel(heard));
                let heard = if is_vessel { Heard::Vessel } else { Heard::Nothing };
                let minute = Minute { from_below: (n > 500).then_some(true), ..minute(n, heard) };
                checks.minute(&minute, &mut faults, &mut |_| {});
                named |= usize::from(checks.said_component) == 1;
                cleared += usize::from(named && !checks.are_misplaced());
            }
            assert!(named && cleared == 0, "{seed}: {named} {cleared}");
        }
    }

    #[test]
    fn earthquakes_tell_a_sign_until_vessels_do() {
        let over = (FaultCode::SetUpGood, FaultCode::Reversed as i64);
        for towards in [false, true] {
            assert_eq!(of_earthquakes(towards, |n| (n > 300).then_some(!towards)), []);
            let wrong = of_earthquakes(towards, |n| (n > 300).then_some(towards));
            let [named, overruled] = wrong[..] else { panic!("{wrong:?}") };
            assert_eq!(named, (FaultCode::Reversed, 3, 301));
            assert!((overruled.0, overruled.1) == over && overruled.2 > 700, "{overruled:?}");
            let back = of_earthquakes(towards, |n| (n > 300).then_some(towards == (n < 500)));
            assert_eq!(back, [(FaultCode::Reversed, 3, 301), (over.0, over.1, 500)]);
        }
    }

    /// What chance makes of a minute's coherence.
    struct Noise(u32);

    impl Noise {
        fn next(&mut self) -> f32 {
            0.03e-3 * gaussian(&mut self.0)
        }
    }

    /// The same where so much of the vertical motion goes with pressure, and by chance as much in a minute as of 1000 products.
    fn over_a_floor(share: f32, sides: f32, order: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<(FaultCode, i64)> {
        let mut chance = Noise(3);
        let noise: Vec<f32> = (0..1200).map(|_| chance.next()).collect();
        said(1200, Heard::Vessel, |n| {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            vessel(order([0.5 * (c + sides), 0.5 * s, noise[n] - share]))
        })
    }

    #[test]
    fn a_floor_that_reflects_all_hides_no_sign() {
        assert_eq!(over_a_floor(0.04, 0.0, |v| v), []);
        assert_eq!(over_a_floor(0.04, 0.0, |v| v.map(|x| -x)), [DOUBT, OVER, (FaultCode::Reversed, 3)]);
        assert_eq!(over_a_floor(0.04, 0.0, |[n, e, z]| [z, e, n]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
        // One that is not heard at all is nothing, not even where all vessels pass north.
        assert_eq!(over_a_floor(0.0, 0.0, |v| v), []);
        assert_eq!(over_a_floor(0.0, 1.2, |v| v), []);
    }

    #[test]
    fn a_vessel_of_one_line_exchanges_nothing() {
        // It passes north of the station; the sign of its vertical motion turns as its paths interfere, slowest at the closest point.
        let passage = |order: fn([f32; 3]) -> [f32; 3]| {
            said(1200, Heard::Vessel, |n| {
                let minutes = (n % 400) as f32 - 200.0;
                let range_m = math::f32::hypot(4000.0, 270.0 * minutes);
                let (north, east) = (4000.0 / range_m, 270.0 * minutes / range_m);
                let vertical = 0.3 * math::f32::cos(math::f32::TAU * range_m / 1000.0) - 0.1;
                vessel(order([0.5 * north + 0.2, 0.5 * east, vertical]))
            })
        };
        assert_eq!(passage(|v| v), []);
        assert_eq!(passage(|[n, e, z]| [-n, e, z]), []);
    }

    /// Of 1200 minutes of traffic whose components are so from minute `from` on: the first after which no direction is one, and how many.
    fn withheld(from: usize, order: impl Fn([f32; 3]) -> [f32; 3]) -> (Option<usize>, usize) {
        let (mut checks, mut faults, mut minutes) = (Checks::new(), Faults::new(), Vec::new());
        for n in 0..1200 {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            let products = [0.5 * c, 0.5 * s, -0.1];
            checks.hop(&vessel(if n < from { products } else { order(products) }));
            let minute = minute(n, Heard::Vessel);
            checks.minute(&minute, &mut faults, &mut |_| {});
            if checks.are_misplaced() {
                minutes.push(n);
            }
        }
        (minutes.first().copied(), minutes.len())
    }

    #[test]
    fn no_direction_is_told_while_a_sign_is_wrong_and_it_is_not_known_which() {
        assert_eq!(withheld(0, |v| v), (None, 0));
        for from in [0, 300, 600] {
            let reversed = withheld(from, |v| v.map(|x| -x));
            assert!(reversed.0.is_some_and(|first| (from..from + 20).contains(&first)), "{reversed:?}");
            // Named, it is told with a warning: half a turn puts it right.
            assert!((100..400).contains(&reversed.1), "{from} {reversed:?}");
            let (first, minutes) = withheld(from, |[n, e, z]| [z, e, n]);
            let first = first.expect("some");
            assert!(
                (from..from + 250).contains(&first) && first + minutes == 1200,
                "{from} {first} {minutes}"
            );
        }
    }

    #[test]
    fn a_vertical_component_that_hears_little_or_nothing_withholds_no_direction() {
        for seed in 1..=20 {
            let mut noise = Noise(seed);
            let (mut signs, mut doubted) = (AllSigns::NONE, 0);
            for n in 0..100_000 {
                signs.take(&[0.5, -0.5, noise.next()], 1.0, n % 2000 < 1000);
                doubted += usize::from(signs.are_contrary());
            }
            assert_eq!(doubted, 0, "{seed}");
        }
    }

    #[test]
    fn what_is_right_again_is_told() {
        let turned = said(2400, Heard::Vessel, |n| {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            vessel([0.5 * c, 0.5 * s, if n < 600 { 0.4 } else { -0.4 }])
        });
        assert_eq!(
            turned,
            [DOUBT, OVER, (FaultCode::Reversed, 3), (FaultCode::SetUpGood, FaultCode::Reversed as i64)]
        );
    }
}
