//! Whether both horizontal components have heard something lately; while one has not, directions may be the other one's axis.
//!
//! Enters: the coherences of both with pressure, minute by minute. Leaves: whether directions can be told.
//!
//! Where a component hears nothing but its own noise every vessel is found along the other one, with a small deviation. Which it is, deaf or well beside a
//! vessel along the other, `deaf` tells when vessels have passed it, after hours. Where the other clearly hears something and it never has, or
//! has not for [`LONG`] such minutes, no direction is told. That takes them from vessels that come straight along a component: of 36 days
//! 1 % of the minutes with vessels at the table's level, 2 % of those 5 dB below it, half of them before the first has been heard by both.
//! A component hears where it goes with pressure as chance does not let it: clearly in a minute, or slightly in ten.
//! Cost: 20 instructions a minute.

use crate::math;

/// Coherence of a component that hears something in one minute, and the mean of its square over [`MEMORY`] of them: five times, and four times the square of,
/// what chance makes of a whole minute. Of a deaf one that is so in none of 200 days.
const CLEARLY: f32 = 0.15;
const SLIGHTLY: f32 = 0.004;
const MEMORY: f32 = 10.0;

/// Minutes in which the other component clearly hears something and this one nothing, from which on it may be deaf.
const LONG: u8 = 60;

/// State.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unheard {
    /// Of north and east: mean squared coherence, minutes of silence beside the other, and whether it has ever been heard.
    square: [f32; 2],
    silent: [u8; 2],
    heard: [bool; 2],
}

impl Unheard {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self { square: [0.0; 2], silent: [0; 2], heard: [false; 2] }
    }

    /// Takes a minute: coherences of north and east, over what chance makes of so long a one against a whole one.
    pub(super) fn minute(&mut self, coherence: [f32; 2]) {
        let [north, east] = coherence.map(math::f32::abs);
        let parts = self.square.iter_mut().zip(&mut self.silent).zip(&mut self.heard);
        for (((square, silent), heard), (own, other)) in parts.zip([(north, east), (east, north)]) {
            let own = own.min(CLEARLY);
            *square += (own * own - *square) / MEMORY;
            if own >= CLEARLY || *square > SLIGHTLY {
                (*silent, *heard) = (0, true);
            } else if other >= CLEARLY {
                *silent = silent.saturating_add(1);
            }
        }
    }

    /// Whether one of them may be deaf.
    pub(super) fn may_be_deaf(&self) -> bool {
        let parts = self.silent.iter().zip(self.heard);
        parts
            .map(|(minutes, heard)| (*minutes, heard))
            .any(|(minutes, heard)| minutes >= if heard { LONG } else { 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether, after each of these minutes, one may be deaf.
    fn after(unheard: &mut Unheard, minutes: impl Iterator<Item = [f32; 2]>) -> std::vec::Vec<bool> {
        minutes
            .map(|coherence| {
                unheard.minute(coherence);
                unheard.may_be_deaf()
            })
            .collect()
    }

    /// What chance makes of a minute.
    fn chance(n: usize) -> f32 {
        0.03 * math::f32::sqrt(2.0) * math::f32::sin(2.4 * n as f32)
    }

    #[test]
    fn a_component_is_believed_once_it_has_heard_something() {
        let mut unheard = Unheard::new();
        // All along north, strong, for a day: east may be deaf.
        assert!(after(&mut unheard, (0..1440).map(|n| [0.8, chance(n)])).iter().all(|deaf| *deaf));
        // One from between.
        assert_eq!(after(&mut unheard, [[0.3, -0.2]].into_iter()), [false]);
        // And a weak one, 8° from north.
        unheard = Unheard::new();
        let told = after(&mut unheard, (0..60).map(|n| [0.5, 0.07 + chance(n)]));
        let first = told.iter().position(|deaf| !deaf);
        assert!(first.is_some_and(|n| (3..30).contains(&n)), "{first:?}");
    }

    #[test]
    fn one_that_falls_silent_is_believed_for_an_hour_of_vessels_and_no_longer() {
        let mut unheard = Unheard::new();
        after(&mut unheard, (0..30).map(|_| [0.5, 0.5]));
        // Hours without a vessel say nothing.
        assert!(after(&mut unheard, (0..600).map(|n| [chance(n), chance(n + 7)])).iter().all(|deaf| !deaf));
        let told = after(&mut unheard, (0..90).map(|n| [0.5, chance(n)]));
        assert_eq!(told.iter().position(|deaf| *deaf), Some(59));
        // It hears again.
        assert_eq!(after(&mut unheard, [[0.5, 0.2]].into_iter()), [false]);
    }
}
