//! What the station finds doubtful about its own set-up, from what it hears anyway.
//!
//! Enters: once a minute, the moments of its four components (`moments`), whether a vessel was heard, and how fast it comes nearer. Leaves:
//! a fault where something has been wrong for long, once, and [`FaultCode::SetUpGood`] when it is right again (of a component that was
//! deaf [`FaultCode::ChannelBack`]).
//!
//! - What becomes of a component from one hop to the next (`jump`): what the others know of it is then of what was.
//! - Sign of pressure and vertical motion, and a vertical component in a horizontal one's place (`signs`): that something is wrong
//!   ([`FaultCode::SignInDoubt`]), and later what, or that it was not.
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
use super::jump::{Jump, Jumps};
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
    jumps: Jumps,
    /// Whether pressure was turned round since the last minute.
    turned: bool,
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
            jumps: Jumps::new(),
            turned: false,
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

    /// Time without samples.
    pub(super) fn interrupted(&mut self) {
        self.jumps.interrupted();
    }

    /// Takes a hop, of which there are moments where no component was wrong in it.
    pub(super) fn hop(&mut self, moments: Option<&Moments>) {
        let Some(moments) = moments else {
            self.jumps.left_out();
            return;
        };
        self.minute.add(&self.gains.without_known(moments));
        match self.jumps.hop(moments) {
            Some(Jump::Louder(ratio_db, certain)) => {
                self.gains.jumped(ratio_db, certain);
                self.own_noise.changed();
            }
            Some(Jump::Deaf(component)) => self.unheard.fallen_silent(component),
            Some(Jump::Reversed) => self.turned = true,
            None => {}
        }
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
            self.own_noise.take(&self.gains.with_known(&m), of_noise);
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
        let turned = core::mem::take(&mut self.turned);
        if self.said_component == 0 && !self.in_doubt && (turned || self.signs.are_contrary()) {
            (self.in_doubt, self.by_vessels) = (true, true);
            self.signs.doubt(towards);
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
        if self.in_doubt && by_vessels.is_none() && self.signs.are_right_after_all() {
            self.in_doubt = false;
            faults.note(FaultCode::SetUpGood, index, FaultCode::SignInDoubt as u64, sink);
        }
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

    /// Whether no direction is one: components are said to be exchanged or a sign turned round (whose, a vertical component does not know), or
    /// something is wrong with them and it was not yet said what.
    pub(super) fn are_misplaced(&self) -> bool {
        self.in_doubt || self.said_component > 0
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
        for (code, news) in
            [(FaultCode::Unequal, self.gains.news()), (FaultCode::GainInDoubt, self.gains.doubt())]
        {
            match news {
                Some(Some(ratio_db)) => {
                    let value = math::f32::round(10.0 * ratio_db) as i64;
                    faults.gather(Fault { code, index, value }, sink);
                }
                Some(None) => faults.note(FaultCode::SetUpGood, index, code as u64, sink),
                None => {}
            }
        }
    }
}

#[cfg(test)]
#[path = "checks_tests.rs"]
mod tests;
