//! A horizontal component that hears nothing but its own noise, while the other hears vessels.
//!
//! Enters, minute by minute: coherences of the components with pressure, whether a vessel is heard, and its radial speed where its range
//! is sure. Leaves: that a component is deaf, and that it hears again. Directions are then all along the other component.
//!
//! A vessel along one component is not heard by the other either. So silence alone says nothing; but a vessel that passes comes
//! abeam of every component, unless it passes overhead, which the vertical one shows (one such passage counts, for few are so exactly along
//! a component that it hears nothing of them; no further ones, for they may all go one way). While a component is silent, a vessel has passed it
//! where the other heard it from one side and soon after from the other side; the more surely if its range shrank before and grew
//! after. One that leaves and one that comes, both along one component, change sides too: there the range grows before and shrinks
//! after. A vessel whose range shrinks and then grows on one side has passed it too. Two such signs are wanted, and that the mean direction
//! since the component was last heard is the other component's to [`TILT`].
//!
//! Not observable: a deaf component while vessels pass overhead or stand still, and both deaf at once (no direction is told then).
//! Minutes with several vessels say nothing. Cost: 100 instructions a minute.

use crate::math;

/// Coherence with pressure above which a component hears something: four times what chance makes of a whole minute.
pub(super) const HEARS: f32 = 0.12;

/// Coherence of the other component with pressure from which on a minute counts.
const STRONG: f32 = 0.15;

/// Coherence of the vertical component with pressure from which on a vessel may be overhead.
const ABOVE: f32 = 0.8;

/// Minutes on one side before a change of sides counts; longest time from one side to the other, and time on the other in which one that
/// comes would have come into range, minutes.
const HELD: u8 = 10;
const SOON: u8 = 60;

/// Minutes in which a vessel came nearer before it is known to.
const CAME: u8 = 5;

/// Radial speed below which a vessel neither comes nor leaves, m/s.
const MOVING_M_S: f32 = 1.0;

/// Signs wanted, and the sum of squared coherences of the other component: 10 is an hour or so.
const SIGNS: u8 = 2;
const ENOUGH: f32 = 10.0;

/// Greatest mean of the directions' tangents on a side, and the sum of squared coherences from which on it is known (chance makes 0.02).
const TILT: f32 = 0.02;
const SIDE: f32 = 2.0;

/// Minutes by which those in which a deaf component hears something must outnumber those in which only the other does.
const BACK: u8 = 10;

/// One minute.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hearing {
    /// Coherences of north, east and vertical with pressure.
    pub(super) coherence: [f32; 3],
    /// Coherence from which on a component hears something: [`HEARS`], more of a part of a minute.
    pub(super) hears: f32,
    /// Whether a vessel is heard.
    pub(super) vessel: bool,
    /// Whether they are several: which of them a side or a range is of is not known.
    pub(super) several: bool,
    /// Its radial speed where its range is sure, m/s.
    pub(super) speed_m_s: Option<f32>,
}

/// A change of sides whose meaning waits for the next range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    None,
    /// The vessel had come nearer before.
    Coming,
    /// Not known.
    Unknown,
}

/// What the other component heard since this one last heard something.
#[derive(Clone, Copy, Debug)]
struct Silence {
    /// Sums of the other's squared coherence and of its product with this one's, from its negative side and its positive one.
    sides: [[f32; 2]; 2],
    /// Sign of the side last heard; 0: none.
    side: i8,
    /// Minutes there, and since the last of them.
    minutes: u8,
    since: u8,
    /// Minutes in which the vessel came nearer.
    came: u8,
    change: Change,
    /// Whether a vessel may have been overhead since, and whether one that may have been is among the signs.
    above: bool,
    overhead: bool,
    signs: u8,
}

impl Silence {
    const NONE: Self = Self {
        sides: [[0.0; 2]; 2],
        side: 0,
        minutes: 0,
        since: 0,
        came: 0,
        change: Change::None,
        above: false,
        overhead: false,
        signs: 0,
    };

    /// What is heard next is another vessel.
    fn forget_vessel(&mut self) {
        (self.side, self.minutes, self.came, self.change, self.above) = (0, 0, 0, Change::None, false);
    }

    fn sign(&mut self) {
        self.signs = self.signs.saturating_add(1);
    }

    /// Takes a minute: coherences of the other component and this one.
    fn minute(&mut self, other: f32, own: f32, hearing: &Hearing) {
        if math::f32::abs(own) > hearing.hears {
            *self = Self::NONE;
            return;
        }
        self.since = self.since.saturating_add(1);
        let [_, _, vertical] = hearing.coherence;
        if math::f32::abs(vertical) > ABOVE {
            (self.above, self.came, self.change) = (true, 0, Change::None);
            return;
        }
        if hearing.several {
            (self.came, self.change) = (0, Change::None);
            return;
        }
        if !hearing.vessel || math::f32::abs(other) < STRONG {
            return;
        }
        let [negative, positive] = &mut self.sides;
        let [square, product] = if other > 0.0 { positive } else { negative };
        (*square, *product) = (*square + other * other, *product + other * own);
        if self.since > SOON {
            self.forget_vessel();
        }
        self.since = 0;
        let side = if other > 0.0 { 1 } else { -1 };
        if side == self.side {
            self.minutes = self.minutes.saturating_add(1);
            if self.change == Change::Unknown && self.minutes >= SOON {
                self.sign();
                self.change = Change::None;
            }
        } else {
            let passed = self.minutes >= HELD;
            self.change = match (passed && !self.above, self.came >= CAME) {
                (false, _) => Change::None,
                (true, true) => Change::Coming,
                (true, false) => Change::Unknown,
            };
            let overhead = passed && self.above && !self.overhead;
            self.overhead |= overhead;
            if overhead || self.change == Change::Coming {
                self.sign();
            }
            (self.side, self.minutes, self.came) = (side, 1, 0);
        }
        self.above = false;
        match hearing.speed_m_s {
            Some(speed) if speed > MOVING_M_S => {
                let passed =
                    self.change == Change::Coming || self.change == Change::None && self.came >= CAME;
                self.signs = self.signs.saturating_add(u8::from(passed));
                (self.came, self.change) = (0, Change::None);
            }
            Some(speed) if speed < -MOVING_M_S => {
                // One left on the one side, another comes on the other.
                self.signs = self.signs.saturating_sub(u8::from(self.change == Change::Coming));
                (self.came, self.change) = (self.came.saturating_add(1), Change::None);
            }
            _ => {}
        }
    }

    fn is_deafness(&self) -> bool {
        let along = |[square, product]: &[f32; 2]| *square < SIDE || math::f32::abs(*product) < TILT * square;
        let sum: f32 = self.sides.iter().map(|[square, _]| square).sum();
        self.signs >= SIGNS && sum >= ENOUGH && self.sides.iter().all(along)
    }
}

/// State of the horizontal components.
#[derive(Clone, Debug)]
pub(super) struct Deafness {
    silences: [Silence; 2],
    /// The component that is deaf: 1 north, 2 east, 0 none.
    deaf: u8,
    /// By how many minutes those in which it hears outnumber the others.
    hears: u8,
}

/// What has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum News {
    /// This component is deaf.
    Deaf(u8),
    /// It hears again.
    Back(u8),
}

impl Deafness {
    /// Nothing known.
    pub(super) const fn new() -> Self {
        Self { silences: [Silence::NONE; 2], deaf: 0, hears: 0 }
    }

    /// Whether a component is deaf: directions are worth nothing.
    pub(super) fn is_deaf(&self) -> bool {
        self.deaf > 0
    }

    /// Takes a minute.
    pub(super) fn minute(&mut self, hearing: &Hearing) -> Option<News> {
        let [north, east, _] = hearing.coherence;
        for (silence, (other, own)) in self.silences.iter_mut().zip([(east, north), (north, east)]) {
            silence.minute(other, own, hearing);
        }
        if self.deaf == 0 {
            let found = self.silences.iter().position(Silence::is_deafness)?;
            self.deaf = found as u8 + 1;
            self.hears = 0;
            return Some(News::Deaf(self.deaf));
        }
        let (other, own) = if self.deaf == 1 { (east, north) } else { (north, east) };
        if math::f32::abs(own) > hearing.hears {
            self.hears += 1;
        } else if math::f32::abs(other) > STRONG {
            self.hears = self.hears.saturating_sub(1);
        }
        (self.hears >= BACK).then(|| News::Back(core::mem::replace(&mut self.deaf, 0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Minutes from two and a half hours before to after a vessel's closest point: what is heard of it by true coherences.
    fn passage(abeam_deg: f32, closest_m: f32, ranged: bool) -> impl Iterator<Item = Hearing> {
        (-150..150).map(move |minute: i32| {
            let along_m = 420.0 * minute as f32;
            let range_m = math::f32::sqrt(along_m * along_m + closest_m * closest_m);
            let azimuth = math::f32::atan2(along_m, closest_m) + abeam_deg.to_radians();
            let (s, c) = math::f32::sin_cos(azimuth);
            // Chance, without a generator of its own.
            let chance = 0.02 * math::f32::sin(12.9 * (minute * minute) as f32);
            let level = (25_000.0 / range_m).min(1.0) * (range_m / 2_000.0).min(1.0);
            let speed = 7.0 * along_m / range_m;
            Hearing {
                coherence: [
                    0.8 * level * c + chance,
                    0.8 * level * s - chance,
                    -(3_000.0 / range_m).min(0.95),
                ],
                hears: HEARS,
                vessel: true,
                several: false,
                speed_m_s: (ranged && (7_000.0..45_000.0).contains(&range_m)).then_some(speed),
            }
        })
    }

    fn news(minutes: impl Iterator<Item = Hearing>) -> Vec<News> {
        let mut deafness = Deafness::new();
        minutes.filter_map(|m| deafness.minute(&m)).collect()
    }

    /// The same without what a component hears of it.
    fn without(component: usize, m: Hearing) -> Hearing {
        let mut m = m;
        m.coherence[component] = 0.02 * math::f32::sin(1e5 * m.coherence[component]);
        m
    }

    #[test]
    fn a_component_that_a_vessel_passed_unheard_is_deaf_and_well_ones_are_not() {
        for abeam in (0..360).step_by(15) {
            let ways = |ranged| {
                [3_000.0, 12_000.0, 20_000.0].into_iter().flat_map(move |r| passage(abeam as f32, r, ranged))
            };
            assert_eq!(news(ways(true)), [], "{abeam}");
            assert_eq!(news(ways(false)), [], "{abeam}");
            for component in [0, 1] {
                let deaf = || ways(true).map(|m| without(component, m));
                assert_eq!(news(deaf()), [News::Deaf(component as u8 + 1)], "{abeam} {component}");
                let back = [News::Deaf(component as u8 + 1), News::Back(component as u8 + 1)];
                assert_eq!(news(deaf().chain(ways(true))), back, "{abeam} {component}");
            }
        }
    }

    #[test]
    fn vessels_along_a_component_make_the_other_no_deaf_one() {
        // Overhead along north, day by day.
        assert_eq!(news((0..5).flat_map(|_| passage(90.0, 1.0, true)).map(|m| without(1, m))), []);
        // One stands north for a day, then south.
        let still = |side: f32| Hearing {
            coherence: [0.7 * side, 0.01, -0.1],
            hears: HEARS,
            vessel: true,
            several: false,
            speed_m_s: Some(0.2),
        };
        assert_eq!(news((0..2880).map(|n| still(if n < 1440 { 1.0 } else { -1.0 }))), []);
        // Those that leave north and come from south, or the other way round, again and again.
        let change = |n: usize| {
            let (side, leaves) = ([1.0, -1.0][n / 60 % 2], n % 60 > 30);
            let speed_m_s = Some(if leaves { 7.0 } else { -7.0 });
            Hearing {
                coherence: [0.5 * side, 0.01, -0.1],
                hears: HEARS,
                vessel: true,
                several: false,
                speed_m_s: speed_m_s.filter(|s| *s < 0.0),
            }
        };
        assert_eq!(news((0..6000).map(change)), []);
    }
}
