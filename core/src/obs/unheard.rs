//! Whether both horizontal components have heard something lately; while one has not, directions may be the other one's axis.
//!
//! Enters: the coherences of both with pressure, minute by minute. Leaves: whether directions can be told.
//!
//! Where a component hears nothing but its own noise every vessel is found along the other one, with a small deviation. Which it is, deaf or well beside a
//! vessel along the other, `deaf` tells when vessels have passed it, after hours. Where the other clearly hears something and it never has, or
//! has not for [`LONG`] such minutes, no direction is told. A component hears where it clearly goes with pressure, or with what the other has of it
//! over twenty minutes as chance does not: a vessel 5° off the other's axis is heard by both. What that takes from vessels that come straight along a component is, of 36 simulated
//! days, half a percent of the minutes with vessels at the table's level and 5 dB below it, most of it before the first has been heard by both.
//! Cost: 20 instructions a minute.

use crate::math;

/// Coherence of a component that clearly hears something in a minute: five times what chance makes of a whole one.
const CLEARLY: f32 = 0.15;

/// Squared, that sum of products of both coherences over the root of the other's squares that chance does not make: four of its deviations, of which a deaf
/// component has one in some days. And the minutes that the sums are of.
const TOGETHER: f32 = 0.016;
const MEMORY: f32 = 20.0;

/// Minutes in which the other component clearly hears something and this one nothing, from which on it may be deaf.
const LONG: u8 = 45;

/// State.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unheard {
    /// Sum of the products of both coherences.
    product: f32,
    /// Of north and east: sum of the other one's squares, minutes of silence beside it, and whether it has ever been heard.
    squares: [f32; 2],
    silent: [u8; 2],
    heard: [bool; 2],
}

impl Unheard {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self { product: 0.0, squares: [0.0; 2], silent: [0; 2], heard: [false; 2] }
    }

    /// Takes a minute: coherences of north and east, over what chance makes of so long a one against a whole one.
    pub(super) fn minute(&mut self, coherence: [f32; 2]) {
        let [north, east] = coherence;
        self.product += north * east - self.product / MEMORY;
        let parts = self.squares.iter_mut().zip(&mut self.silent).zip(&mut self.heard);
        for (((square, silent), heard), (own, other)) in parts.zip([(north, east), (east, north)]) {
            *square += other * other - *square / MEMORY;
            let is_with_other = self.product * self.product > TOGETHER * *square;
            if is_with_other || math::f32::abs(own) >= CLEARLY {
                (*silent, *heard) = (0, true);
            } else if math::f32::abs(other) >= CLEARLY {
                *silent = silent.saturating_add(1);
            }
        }
    }

    /// A component, 0 north and 1 east, may have gone deaf: it is believed again once it hears something.
    pub(super) fn fallen_silent(&mut self, component: usize) {
        // What it had of vessels until now must not pass for what it hears.
        self.product = 0.0;
        if let Some(silent) = self.silent.get_mut(component) {
            *silent = LONG;
        }
    }

    /// Whether one of them may be deaf.
    pub(super) fn may_be_deaf(&self) -> bool {
        let longest = |heard: bool| if heard { LONG } else { 1 };
        self.silent.iter().zip(self.heard).any(|(minutes, heard)| *minutes >= longest(heard))
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
        // And one 8° from north.
        unheard = Unheard::new();
        let told = after(&mut unheard, (0..60).map(|n| [0.5, 0.07 + chance(n)]));
        let first = told.iter().position(|deaf| !deaf);
        assert!(first.is_some_and(|n| (1..10).contains(&n)), "{first:?}");
    }

    #[test]
    fn one_that_falls_silent_is_believed_for_some_time_with_vessels_and_no_longer() {
        let mut unheard = Unheard::new();
        after(&mut unheard, (0..30).map(|_| [0.5, 0.5]));
        // Hours without a vessel say nothing.
        assert!(after(&mut unheard, (0..600).map(|n| [chance(n), chance(n + 7)])).iter().all(|deaf| !deaf));
        let told = after(&mut unheard, (0..90).map(|n| [0.5, chance(n)]));
        assert_eq!(told.iter().position(|deaf| *deaf), Some(44));
        // It hears again.
        assert_eq!(after(&mut unheard, [[0.5, 0.2]].into_iter()), [false]);
    }
}
