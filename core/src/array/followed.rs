//! Which other sources than the strongest are known, where each is expected, and whose turn it is to be looked at.
//!
//! Enters: what searches find ([`super::others`]) and where the strongest source is. Leaves: what is looked at next, what of the pairs'
//! peaks the known ones explain, and what one that the strongest passes by does to its direction.

use super::beside::Beside;
use super::estimate::Context;
use super::jump::unit;
use super::plan::Plan;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::math::f32 as m;

/// A second source nearer than this to the first, in resolution cells, is what is left of the first; and beside it, both far off: what is left of a
/// vessel, and its echoes, stand above and below it.
pub(super) const SECOND_APART_CELLS: f32 = 6.0;
const BESIDE_CELLS: f32 = 3.0;
/// Sine of the elevation below which a vessel is far off, and the most that one beside it is higher or lower, in units of what they are apart in azimuth.
const FAR_OFF: f32 = 0.5;
const LEVEL: f32 = 0.5;
/// Other sources than the strongest that are followed at once.
const OTHERS: usize = 3;
/// Segments from one search for another source to the next, and where one is followed: where there are two, a third is likelier.
const SECOND_EVERY: u32 = 8;
const FURTHER_EVERY: u32 = 4;
/// And where one found is to be found again: in sound that the two have not in common.
const AGAIN_AFTER: u32 = 2;
/// Share of the newest turning in what the strongest source's is taken to be.
const TURNED: f32 = 0.1;
/// Share of the newest turning in what is expected.
const SMOOTHED: f32 = 0.5;
/// Sine of the elevation from which on a vessel's azimuth may turn by anything as it passes over, and its elevation is sure: it and its image stand
/// together there.
const HIGH: f32 = 0.9;
/// Farthest a second source moves between two searches, radians: a vessel at 100 m turns by 4° a second.
pub(super) const SECOND_MOVES_RAD: f32 = 0.28;

/// A place for another source than the strongest. All of it is zero where there is none, so that the recorder's memory begins as zeros.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known {
    direction: Direction,
    /// By how much its azimuth grows from segment to segment, radians. Its elevation is as uncertain as it changes.
    pub(super) turning: f32,
    /// By how much its level part grows, by which it goes on where it is high.
    pub(super) moving: [f32; 2],
    /// Segment in which it was found last.
    pub(super) segment: u32,
    /// How often it was found: 0 is no source, 1 one to be found again, 2 one that is followed.
    pub(super) found: u8,
    /// Looks in a row that did not find it.
    pub(super) missed: u8,
    /// It is not much fainter than the strongest.
    strong: bool,
    /// It was the strongest once, as nothing is that a sick channel feigns; or, of those by which an exchange is looked for, it has shown one.
    pub(super) led: bool,
}

impl Known {
    pub(super) const NONE: Self = Self {
        direction: [0.0; 3],
        turning: 0.0,
        moving: [0.0; 2],
        segment: 0,
        found: 0,
        missed: 0,
        strong: false,
        led: false,
    };

    /// One that was found so often.
    pub(super) fn at(direction: Direction, segment: u32, found: u8) -> Self {
        Self { direction, segment, found, ..Self::NONE }
    }

    pub(super) fn lasts(&self) -> bool {
        self.found >= 2
    }

    /// Where it is expected in a segment.
    #[inline(never)]
    pub(super) fn expected(&self, segment: u32) -> Direction {
        let later = segment.wrapping_sub(self.segment) as f32;
        let [x, y, z] = self.direction;
        if z > HIGH {
            let [east, north] = self.moving;
            return unit(&[x + later * east, y + later * north, z]);
        }
        let (s, c) = m::sin_cos(self.turning * later);
        [x * c + y * s, y * c - x * s, z]
    }

    /// Whether it is expected in this direction.
    #[inline(never)]
    pub(super) fn is_at(&self, plan: &Plan, direction: &Direction, segment: u32) -> bool {
        self.found > 0 && is_near(plan, &self.expected(segment), direction)
    }

    /// Takes where it was found.
    #[inline(never)]
    pub(super) fn take(&mut self, direction: Direction, segment: u32) {
        let passed = segment.wrapping_sub(self.segment).max(1) as f32;
        let share = if self.lasts() { SMOOTHED } else { 1.0 };
        let own = turned(&self.direction, &direction) / passed;
        let turning = self.turning + share * (own - self.turning);
        let mut moving = self.moving;
        for ((moving, new), old) in moving.iter_mut().zip(&direction).zip(&self.direction) {
            *moving += share * ((new - old) / passed - *moving);
        }
        *self = Self { direction, turning, moving, segment, found: 2, missed: 0, strong: true, ..*self };
    }
}

/// The other sources that are known, and whose turn it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Followed {
    pub(super) known: [Known; OTHERS],
    /// Place to be looked at next.
    place: usize,
    /// Segment of the last search.
    searched: u32,
    /// Direction of the strongest source in the segment before, zero where there was none, and by how much its azimuth grows, radians.
    strongest: Direction,
    turning: f32,
    /// One of them that the strongest passes by.
    beside: Beside,
}

/// What is done in a segment beside its strongest source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    /// One octave is searched.
    Octave,
    /// Another source is searched for in the whole band.
    Search,
    /// A known one, by its place, is looked at.
    Follow(usize),
}

impl Followed {
    pub(super) const NONE: Self = Self {
        known: [Known::NONE; OTHERS],
        place: 0,
        searched: 0,
        strongest: [0.0; 3],
        turning: 0.0,
        beside: Beside::NONE,
    };

    /// Whether any other source was found lately.
    pub(super) fn any(&self) -> bool {
        self.known.iter().any(|k| k.found > 0)
    }

    /// Whether there are any that two searches found.
    pub(super) fn lasts(&self) -> bool {
        self.known.iter().any(|k| k.lasts())
    }

    /// Whether a pair hears one of them, or of those that were the strongest once (`led`), at a delay (seconds), to so many samples.
    #[inline(never)]
    pub(super) fn explain(
        &self,
        context: &Context<'_>,
        segment: u32,
        (pair, delay_s): (usize, f32),
        (samples, led): (f32, bool),
    ) -> bool {
        let plan = context.plan;
        self.known.iter().filter(|known| known.found > 0 && (known.led || !led)).any(|known| {
            let delays = context.delays_from(&known.expected(segment));
            delays.get(pair).is_some_and(|tau| m::abs(tau - delay_s) * plan.rate_hz < samples)
        })
    }

    /// The pairs' delays, seconds, at which each that is followed is expected.
    pub(super) fn expected<'a>(
        &'a self,
        context: &'a Context<'a>,
        segment: u32,
    ) -> impl Iterator<Item = [f32; PAIR_COUNT]> + 'a {
        let lasting = self.known.iter().filter(|known| known.lasts());
        lasting.map(move |known| context.delays_from(&known.expected(segment)))
    }

    /// What is next: each that is followed, then an octave or, every [`SECOND_EVERY`] segments, a search; sooner where another is followed and where one found is to be
    /// found again. A search costs as much as the first, and others move slowly.
    pub(super) fn turn(&mut self, segment: u32) -> Turn {
        for place in self.place..OTHERS {
            if self.known.get(place).is_some_and(Known::lasts) {
                self.place = place + 1;
                return Turn::Follow(place);
            }
        }
        self.place = 0;
        let every = if self.known.iter().any(|k| k.found == 1 && k.strong) {
            AGAIN_AFTER
        } else if self.known.iter().any(Known::lasts) {
            FURTHER_EVERY
        } else {
            SECOND_EVERY
        };
        if !self.known.iter().all(Known::lasts) && segment.wrapping_sub(self.searched) >= every {
            self.searched = segment;
            return Turn::Search;
        }
        Turn::Octave
    }

    /// Takes the strongest source's direction: where that was one of the others, they change places. Whether it is another that is followed.
    #[inline(never)]
    pub(super) fn strongest(&mut self, plan: &Plan, direction: Direction, segment: u32) -> bool {
        let before = core::mem::replace(&mut self.strongest, direction);
        let other = before != [0.0; 3] && !is_near(plan, &before, &direction);
        if !other && before != [0.0; 3] {
            self.turning += TURNED * (turned(&before, &direction) - self.turning);
        }
        self.beside.until(SECOND_APART_CELLS * plan.whole.resolution, segment);
        let mut followed = false;
        for known in &mut self.known {
            if known.is_at(plan, &direction, segment) {
                if !other && known.lasts() {
                    let turning = known.turning - self.turning;
                    self.beside = Beside::there(&direction, &known.expected(segment), turning, segment);
                }
                followed |= known.lasts();
                let found = if other { known.found } else { 0 };
                let segment = segment.wrapping_sub(1);
                *known = Known { direction: before, segment, found, led: true, ..Known::NONE };
            }
        }
        other && followed
    }

    /// By how much the strongest source's azimuth grows from segment to segment, radians.
    pub(super) fn strongest_turning(&self) -> f32 {
        self.turning
    }

    /// What one of them that the strongest passes by too closely puts on its direction, across and up, rad².
    pub(super) fn puts(&self, plan: &Plan, segment: u32) -> Option<[f32; 2]> {
        self.beside.puts(plan, segment)
    }

    /// Takes a source found by a search: whether it is one that was there before, within what it can have moved. It is kept where
    /// there is room.
    pub(super) fn found(&mut self, direction: Direction, segment: u32, strong: bool) -> bool {
        let same =
            |k: &Known| k.found > 0 && wavefront::dot(&k.direction, &direction) > m::cos(SECOND_MOVES_RAD);
        let there = self.known.iter().position(same);
        // What was not found again makes room.
        let place = there.or_else(|| self.known.iter().position(|k| !k.lasts()));
        let Some(known) = place.and_then(|place| self.known.get_mut(place)) else { return false };
        if there.is_some() && (strong || known.lasts()) {
            known.take(direction, segment);
        } else {
            *known = Known { direction, segment, found: 1, strong, ..Known::NONE };
        }
        there.is_some()
    }

    /// What a search did not find again did not last.
    pub(super) fn drop_doubtful(&mut self) {
        for known in self.known.iter_mut().filter(|k| !k.lasts()) {
            known.found = 0;
        }
    }
}

/// By how much an azimuth has grown from one direction to another, radians.
#[inline(never)]
fn turned([x0, y0, _]: &Direction, [x, y, _]: &Direction) -> f32 {
    m::atan2(x * y0 - y * x0, x * x0 + y * y0)
}

/// Whether two directions are one source's, or one of them is what is left of the other.
#[inline(never)]
pub(super) fn is_near(plan: &Plan, a: &Direction, b: &Direction) -> bool {
    let cell = plan.whole.resolution;
    let least = BESIDE_CELLS * cell;
    let [east, north, up] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let across = east * east + north * north;
    let far_off = a[2] < FAR_OFF && b[2] < FAR_OFF;
    let beside = far_off && across > least * least && up * up < LEVEL * LEVEL * across;
    !beside && wavefront::dot(a, b) > m::cos(SECOND_APART_CELLS * cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::unit_vector;
    use crate::config::StationConfig;

    fn plan() -> Plan {
        let hydrophones_m =
            [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];
        Plan::new(&StationConfig::array(64_000.0, hydrophones_m)).unwrap()
    }

    fn at(azimuth_deg: f32) -> Direction {
        unit_vector(azimuth_deg.to_radians(), 0.2)
    }

    #[test]
    fn what_two_searches_found_is_followed_where_it_goes_and_each_has_its_turn() {
        let mut others = Followed::NONE;
        assert_eq!((1..8).map(|n| others.turn(n)).filter(|t| *t != Turn::Octave).count(), 0);
        assert_eq!(others.turn(8), Turn::Search);
        assert!(!others.found(at(40.0), 8, true) && others.any());
        // It is soon looked for again.
        assert_eq!((others.turn(9), others.turn(10)), (Turn::Octave, Turn::Search));
        assert!(others.found(at(41.0), 10, true));
        assert_eq!((others.turn(11), others.turn(12)), (Turn::Follow(0), Turn::Octave));
        // Where there are two, a third is soon looked for.
        assert_eq!((others.turn(13), others.turn(14)), (Turn::Follow(0), Turn::Search));
        let expected = wavefront::angles(&others.known[0].expected(20)).0.to_degrees();
        assert!((expected - 46.0).abs() < 0.01, "{expected}");
        // A second one, and both have a turn.
        assert!(!others.found(at(200.0), 18, true) && others.found(at(200.1), 20, true));
        let turns = [21, 22, 23].map(|n| others.turn(n));
        assert!(turns.contains(&Turn::Follow(0)) && turns.contains(&Turn::Follow(1)), "{turns:?}");
    }

    #[test]
    fn what_is_much_fainter_is_left_to_the_searches_and_what_is_not_found_again_goes() {
        let mut others = Followed::NONE;
        assert!(!others.found(at(40.0), 8, false) && others.found(at(40.5), 16, false));
        assert!(!(17..24).any(|n| matches!(others.turn(n), Turn::Follow(_))));
        others.drop_doubtful();
        assert!(!others.any());
    }

    #[test]
    fn the_strongest_and_another_change_places() {
        let (plan, mut others) = (plan(), Followed::NONE);
        others.strongest(&plan, at(100.0), 1);
        assert!(!others.found(at(40.0), 8, true) && others.found(at(40.0), 10, true));
        assert!(!others.strongest(&plan, at(100.2), 10));
        assert!(others.strongest(&plan, at(40.0), 11));
        assert!(others.known[0].lasts() && others.known[0].is_at(&plan, &at(100.2), 11), "{others:?}");
        // Its own direction is no other source's.
        assert!(!others.strongest(&plan, at(40.1), 12));
        assert!(!others.known.iter().any(|k| k.is_at(&plan, &at(40.1), 12)));
    }

    #[test]
    fn one_beside_another_is_another_and_one_above_it_is_its_echo() {
        let plan = plan();
        let cell = plan.whole.resolution.to_degrees();
        let of = |azimuth_deg: f32, elevation_deg: f32| {
            unit_vector(azimuth_deg.to_radians(), elevation_deg.to_radians())
        };
        let vessel = of(40.0, 12.0);
        for (azimuth, elevation, near) in [
            (40.0 + 2.0 * cell, 12.0, true),
            (40.0 + 4.0 * cell, 12.0, false),
            (40.0, 12.0 + 4.0 * cell, true),
            (40.0 + 3.2 * cell, 12.0 + 3.0 * cell, true),
            (40.0, 12.0 + 7.0 * cell, false),
        ] {
            assert_eq!(is_near(&plan, &vessel, &of(azimuth, elevation)), near, "{azimuth}° {elevation}°");
        }
        // High up, both may be one vessel's that passes.
        assert!(is_near(&plan, &of(40.0, 40.0), &of(40.0 + 5.0 * cell, 40.0)));
    }

    #[test]
    fn one_that_the_strongest_passes_by_is_remembered_until_they_have_parted() {
        let (plan, mut others) = (plan(), Followed::NONE);
        assert!(others.puts(&plan, 0).is_none());
        // The other stands at 40°, the strongest goes by at a quarter of a degree from segment to segment.
        let mut worst = 0.0f32;
        for segment in 1..200u32 {
            let azimuth_deg = 20.0 + 0.25 * segment as f32;
            others.strongest(&plan, at(azimuth_deg), segment);
            if segment < 30 {
                others.found(at(40.0), segment, true);
            }
            let apart = (azimuth_deg - 40.0).abs();
            let sd = others.puts(&plan, segment).map(|[across, _]| across.sqrt());
            if apart < 1.5 {
                assert!(sd.is_some_and(|sd| sd > 0.3 * apart.to_radians()), "{apart}: {sd:?}");
            }
            if apart > 8.0 {
                assert_eq!(sd, None, "{apart}");
            }
            worst = worst.max(sd.unwrap_or(0.0));
        }
        assert!((0.004..0.02).contains(&worst), "{worst}");
    }
}
