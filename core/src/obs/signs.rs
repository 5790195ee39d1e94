//! Which signs the components have with pressure, and what these say is wrong.
//!
//! Enters: the coherences of north, east and vertical with pressure of each minute in which a vessel is heard. Leaves: whether the vertical one has its sign
//! turned round, or a horizontal one is it; and, long before that is known, whether either may be so.
//!
//! Vessels sound from above: vertical motion and pressure go together with one sign, whatever the direction. A vote a
//! minute in which the two are coherent. Mostly the other sign: pressure or the motion is turned round.
//! Both signs in turn, but a horizontal component with one only: that is the vertical one.
//! A floor that reflects everything moves up and down a quarter of a period after pressure, and what goes with it is little: the vertical
//! one votes where it is slightly coherent already. What chance adds is as much on either side, and cannot make it lean. A
//! component has both signs only where it was clearly so, and for long: of a vessel whose power is in few lines the vertical motion goes with
//! pressure now with one sign and now with the other, as paths interfere along its way (every few minutes, up to ten at its closest
//! point), where a horizontal component changes its sign once, as the vessel comes abeam.
//! Which of the two it is says only a vessel on either side of each horizontal component. That something is wrong is known after an hour or two with
//! vessels, from what the vertical one has of the wrong sign beyond what it has of the right one since (a cumulative sum: Page, Biometrika 41, 1954); until it is
//! known what, no direction is told. It is over where vessels on all
//! sides have the right one after all: something shook the instrument. Cost: 100 instructions a minute.

use crate::math;

/// Least coherence of a whole minute for a slight vote and for a clear one: twice and four times what chance makes of its 1000 independent
/// products. In days of four vessels over floors 2700 to 5300 m deep 96 % and more of the vertical's slight votes were right.
pub(super) const COHERENT: [f32; 2] = [0.06, 0.12];

/// Votes of a component below which nothing is said, or nothing beside other signs of something wrong, and those from which on the older
/// half is forgotten.
const VOTES: u16 = 90;
pub(super) const FEW_VOTES: u16 = 40;
const MOST_VOTES: u16 = 360;

/// Minutes in a row from which on a sign is clearly so.
const LASTING: u8 = 20;

/// Share of the slight votes that says which sign a component has, and from which on it has one only; of the clear ones that below which it
/// has both. Percent.
const MOSTLY: u32 = 85;
const ONE_SIDED: u32 = 95;
const BOTH_SIDES: u32 = 92;

/// What a minute's coherence counts at most towards the wrong sign's sum, what is taken from the sum in each minute so that chance adds up to nothing,
/// and the sum that is not chance. In 48 simulated days of two to five vessels it is never above 0.41 where nothing is wrong; turned round it is reached
/// after 80 to 170 minutes with vessels, from the start or from the eighth hour on.
const COUNTS: f32 = 0.06;
const CHANCE: f32 = 0.0075;
const CONTRARY: f32 = 0.8;

/// The same sum of the right sign at which a doubt is over, of vessels on either side of north and of east each: of a component that stands in another's place, or
/// in that of pressure, one of them has the wrong sign or none.
const AGREEING: f32 = 0.6;

/// Components: pressure, north, east, vertical.
const NORTH: usize = 1;
const EAST: usize = 2;
pub(super) const VERTICAL: usize = 3;

/// Minutes in which a component went with pressure, and against it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Votes {
    pub(super) with: u16,
    pub(super) against: u16,
}

impl Votes {
    pub(super) const NONE: Self = Self { with: 0, against: 0 };

    pub(super) fn all(self) -> u16 {
        self.with + self.against
    }

    /// Whether so many of them, percent, are for this sign.
    fn are_for(self, with: bool, percent: u32) -> bool {
        let these = if with { self.with } else { self.against };
        100 * u32::from(these) >= percent * u32::from(self.all())
    }

    /// Whether so many of them, percent, are for one sign; none of too few.
    // Called from many places.
    #[inline(never)]
    fn lean(self, percent: u32) -> Option<bool> {
        (self.all() >= VOTES).then(|| self.are_for(self.with > self.against, percent))
    }

    /// Whether nearly all have one sign.
    pub(super) fn is_one_sided(self) -> bool {
        self.lean(ONE_SIDED) == Some(true)
    }

    /// Whether it has not this sign, or both.
    pub(super) fn is_not(self, with: bool) -> bool {
        let least = if self.all() < VOTES { BOTH_SIDES } else { ONE_SIDED };
        self.all() >= FEW_VOTES && !self.are_for(with, least)
    }

    /// Takes a minute's coherence, whose sign counts where it is greater than this.
    // Called from several places.
    #[inline(never)]
    pub(super) fn take(&mut self, coherence: f32, least: f32) {
        self.with += u16::from(coherence > least);
        self.against += u16::from(coherence < -least);
        if self.all() >= MOST_VOTES {
            *self = Self { with: self.with / 2, against: self.against / 2 };
        }
    }
}

/// Of one component.
#[derive(Clone, Copy, Debug)]
struct Signs {
    slight: Votes,
    clear: Votes,
    /// The last clear sign, and minutes in a row that had it.
    with: bool,
    minutes: u8,
}

impl Signs {
    const NONE: Self = Self { slight: Votes::NONE, clear: Votes::NONE, with: false, minutes: 0 };

    fn is_both_sided(&self) -> bool {
        self.clear.lean(BOTH_SIDES) == Some(false)
    }
}

/// Of all components.
#[derive(Clone, Copy, Debug)]
pub(super) struct AllSigns {
    /// Of north, east, vertical.
    of: [Signs; 3],
    /// What the vertical one had of the wrong sign; and of the right one since that was in doubt, of vessels on either side of north and of east.
    contrary: f32,
    agreeing: [f32; 4],
}

impl AllSigns {
    /// Nothing known; all zeros.
    pub(super) const NONE: Self = Self { of: [Signs::NONE; 3], contrary: 0.0, agreeing: [0.0; 4] };

    /// Takes a minute's coherences with pressure, how much larger chance makes them than those of a whole minute, and the sign that the vertical one should
    /// have.
    pub(super) fn take(&mut self, coherence: &[f32; 3], chance: f32, towards: bool) {
        let [north, east, vertical] = *coherence;
        let wrong = if towards { -vertical } else { vertical } / chance;
        let wrong = wrong.clamp(-COUNTS, COUNTS);
        self.contrary = (self.contrary + wrong - CHANCE).clamp(0.0, CONTRARY);
        let [slightly, clearly] = COHERENT.map(|least| least * chance);
        if math::f32::abs(north).min(math::f32::abs(east)) > slightly
            && let Some(agreeing) =
                self.agreeing.get_mut(2 * usize::from(north > 0.0) + usize::from(east > 0.0))
        {
            *agreeing = (*agreeing - wrong - CHANCE).clamp(0.0, AGREEING);
        }
        for (signs, coherence) in self.of.iter_mut().zip(coherence) {
            signs.slight.take(*coherence, slightly);
            if math::f32::abs(*coherence) > clearly {
                let with = *coherence > 0.0;
                let before = if with == signs.with { signs.minutes } else { 0 };
                (signs.with, signs.minutes) = (with, before.saturating_add(1));
                if signs.minutes >= LASTING {
                    signs.clear.take(*coherence, clearly);
                }
            }
        }
    }

    /// The vertical one's slight votes.
    pub(super) fn vertical(&self) -> Votes {
        let [.., vertical] = &self.of;
        vertical.slight
    }

    /// Whether the vertical one has had the wrong sign for so long that something is wrong.
    pub(super) fn are_contrary(&self) -> bool {
        self.contrary >= CONTRARY
    }

    /// Whether it has had the right one for so long since that was in doubt that nothing is; the doubt is over with that.
    pub(super) fn are_right_after_all(&mut self) -> bool {
        let over = self.agreeing.iter().all(|sum| *sum >= AGREEING);
        if over {
            self.contrary = 0.0;
        }
        over
    }

    /// They are in doubt: what was right before says nothing of what is wrong now.
    pub(super) fn doubt(&mut self, towards: bool) {
        self.agreeing = [0.0; 4];
        if self.vertical().are_for(towards, 50) {
            self.of = [Signs::NONE; 3];
        }
    }

    /// What signs say is wrong; none where they say nothing yet.
    pub(super) fn wrong(&self, towards: bool) -> Option<u8> {
        let [north, east, vertical] = &self.of;
        let leans = vertical.slight.lean(MOSTLY)?;
        let right = (vertical.slight.with > vertical.slight.against) == towards;
        // While every vessel is on one side of a component, that may be the vertical one; and while all are on one side of both,
        // nothing can be said.
        let found = match (leans, north.is_both_sided(), east.is_both_sided()) {
            (true, true, true) => {
                if right {
                    0
                } else {
                    VERTICAL
                }
            }
            // A vertical one that hears no vessel leans nowhere, but by chance.
            _ if !vertical.is_both_sided() => return None,
            (false, false, true) if north.slight.is_one_sided() => NORTH,
            (false, true, false) if east.slight.is_one_sided() => EAST,
            _ => return None,
        };
        Some(found as u8)
    }
}
