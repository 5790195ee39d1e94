//! What each minute said, kept compactly: the modes of azimuth and range, not their grids.
//!
//! Enters: the modes of a minute. Leaves: a ring of the last [`MINUTES`] minutes for search and fit of tracks. A minute
//! takes 38 bytes; a track's likelihood is then a sum over minutes of the logarithm of a mixture of a few Gaussians
//! and a uniform floor.

use super::limits::{AZIMUTH_MODES, RANGE_MODES};
use super::presence::RangePresence;
use super::tonal::Directions;
use crate::angle::wrap_tau_f32;
use crate::math;

/// Minutes kept: a quarter of an hour short of eight hours, the time a vessel of 4 m/s is within 50 km; they are what memory has room for.
pub const MINUTES: usize = 465;

/// A direction: azimuth in 2π/65536, standard deviation as [`sd_code`] says (0: none), the move of its lines in [`MOVE`].
#[derive(Clone, Copy, Debug, Default)]
struct AzimuthMark {
    azimuth: u16,
    sd: u8,
    moved: i8,
}

/// Steps of a relative move, and the code of none.
const MOVE: f64 = 1e-5;
const NO_MOVE: i8 = i8::MIN;

/// Bits of a number's exponent and sixteenths, and that of 2⁻¹⁵ rad, below which no standard deviation is.
const SIXTEENTHS: u32 = 19;
const LEAST_SD: u32 = (127 - 15) << 4;

/// A standard deviation of up to 2 rad in eight bits, to a sixteenth.
fn sd_code(sd: f32) -> u8 {
    let rounded = (sd.max(0.0).to_bits() + (1 << (SIXTEENTHS - 1))) >> SIXTEENTHS;
    rounded.saturating_sub(LEAST_SD).clamp(1, 255) as u8
}

/// The standard deviation of a code.
fn sd_of(code: u8) -> f32 {
    f32::from_bits((u32::from(code) + LEAST_SD) << SIXTEENTHS)
}

/// A range: metres, standard deviation in 8 m (0: none), speed and its deviation in 1/8 m/s, weight as [`weight_code`] says, and
/// whether it is sure in the lowest bit.
#[derive(Clone, Copy, Debug, Default)]
struct RangeMark {
    range: u16,
    sd: u8,
    speed: i8,
    sd_speed: u8,
    weight_sure: u8,
}

/// Bits of a number's exponent and eighths, and that of the least weight kept, 2⁻¹⁵: a lighter mode is no better than none.
const EIGHTHS: u32 = 20;
const LEAST_WEIGHT: u32 = (127 - 15) << 3;

/// A weight up to 1 in seven bits, to an eighth: a mode that holds a thousandth of the posterior must not pass for one that holds ten.
fn weight_code(weight: f32) -> u8 {
    let rounded = (weight.clamp(0.0, 1.0).to_bits() + (1 << (EIGHTHS - 1))) >> EIGHTHS;
    rounded.saturating_sub(LEAST_WEIGHT).min(127) as u8
}

/// The weight of a code; none of 0.
fn weight_of(code: u8) -> f32 {
    if code == 0 { 0.0 } else { f32::from_bits((u32::from(code) + LEAST_WEIGHT) << EIGHTHS) }
}

impl AzimuthMark {
    fn view(&self) -> AzimuthEvidence {
        AzimuthEvidence {
            azimuth: f64::from(self.azimuth) * (math::f64::TAU / 65_536.0),
            sd: f64::from(sd_of(self.sd)),
            moved: (self.moved != NO_MOVE).then_some(f64::from(self.moved) * MOVE),
        }
    }
}

impl RangeMark {
    fn view(&self) -> RangeEvidence {
        RangeEvidence {
            range_m: f64::from(self.range),
            sd_m: f64::from(self.sd) * 8.0,
            speed_m_s: f64::from(self.speed) / 8.0,
            sd_speed_m_s: f64::from(self.sd_speed) / 8.0,
            weight: f64::from(weight_of(self.weight_sure >> 1)),
            sure: self.weight_sure & 1 == 1,
        }
    }
}

/// One minute.
#[derive(Clone, Copy, Debug)]
pub struct Minute {
    /// Number of the minute.
    pub number: u32,
    azimuth: [AzimuthMark; AZIMUTH_MODES],
    range: [RangeMark; RANGE_MODES],
}

/// One minute as it is kept: of its number the lower half, which the newest's tells.
#[derive(Clone, Copy, Debug)]
struct Kept {
    number: u16,
    azimuth: [AzimuthMark; AZIMUTH_MODES],
    range: [RangeMark; RANGE_MODES],
}

impl Kept {
    const NONE: Self = Self { number: 0, azimuth: Minute::NONE.azimuth, range: Minute::NONE.range };

    fn new(m: &Minute) -> Self {
        Self { number: m.number as u16, azimuth: m.azimuth, range: m.range }
    }

    /// The minute, `newest` being the number of the last. Wanted in many places.
    #[inline(never)]
    fn minute(&self, newest: u32) -> Minute {
        let before = (newest as u16).wrapping_sub(self.number);
        Minute { number: newest.wrapping_sub(before.into()), azimuth: self.azimuth, range: self.range }
    }
}

/// A direction as the fit sees it.
#[derive(Clone, Copy, Debug)]
pub struct AzimuthEvidence {
    /// Azimuth, rad.
    pub azimuth: f64,
    /// Standard deviation, rad.
    pub sd: f64,
    /// By how much its lines moved since the minute before, relative.
    pub moved: Option<f64>,
}

/// A range as the fit sees it.
#[derive(Clone, Copy, Debug)]
pub struct RangeEvidence {
    /// Range, m.
    pub range_m: f64,
    /// Standard deviation, m.
    pub sd_m: f64,
    /// Radial speed, m/s.
    pub speed_m_s: f64,
    /// Standard deviation, m/s.
    pub sd_speed_m_s: f64,
    /// Share of that minute's posterior.
    pub weight: f64,
    /// Whether its echoes are nearly of the table's strengths.
    pub sure: bool,
}

impl Minute {
    const NONE: Self = Self {
        number: 0,
        azimuth: [AzimuthMark { azimuth: 0, sd: 0, moved: 0 }; AZIMUTH_MODES],
        range: [RangeMark { range: 0, sd: 0, speed: 0, sd_speed: 0, weight_sure: 0 }; RANGE_MODES],
    };

    /// Keeps the modes of a minute; `impulsive` directions are no vessel's and are left out.
    pub fn new(number: u32, directions: &Directions, ranges: &RangePresence) -> Self {
        let mut out = Self { number, ..Self::NONE };
        for (mark, mode) in
            out.azimuth.iter_mut().zip(directions.modes.iter().flatten().filter(|m| !m.impulsive))
        {
            let turns = wrap_tau_f32(mode.azimuth) / math::f32::TAU;
            *mark = AzimuthMark {
                azimuth: (turns * 65_536.0) as u32 as u16,
                sd: sd_code(mode.sd),
                moved: mode.moved.map_or(NO_MOVE, |moved| {
                    math::f32::round(moved * (1.0 / MOVE as f32)).clamp(-127.0, 127.0) as i8
                }),
            };
        }
        for (mark, mode) in out.range.iter_mut().zip(ranges.modes.iter().flatten()) {
            *mark = RangeMark {
                range: mode.range_m.clamp(0.0, 65_535.0) as u16,
                sd: (mode.sd_range_m / 8.0 + 0.5).clamp(1.0, 255.0) as u8,
                speed: math::f32::round(mode.speed_m_s * 8.0).clamp(-127.0, 127.0) as i8,
                sd_speed: math::f32::round(mode.sd_speed_m_s * 8.0).clamp(1.0, 255.0) as u8,
                weight_sure: weight_code(mode.weight) * 2 + u8::from(mode.sure),
            };
        }
        out
    }

    /// The same with its directions turned by what `turned` says of each, rad, and its ranges and radial speeds moved by what
    /// `moved` says, m and m/s.
    pub fn shifted(
        mut self,
        turned: impl Fn(&AzimuthEvidence) -> f64,
        moved: impl Fn(&RangeEvidence) -> (f64, f64),
    ) -> Self {
        for mark in self.azimuth.iter_mut().filter(|mark| mark.sd > 0) {
            let by = turned(&mark.view()) / math::f64::TAU * 65_536.0;
            mark.azimuth = mark.azimuth.wrapping_add(math::f64::round(by) as i32 as u16);
        }
        for mark in self.range.iter_mut().filter(|mark| mark.sd > 0) {
            let seen = mark.view();
            let (range, speed) = moved(&seen);
            mark.range = (seen.range_m + range).clamp(0.0, 65_535.0) as u16;
            mark.speed = math::f64::round((seen.speed_m_s + speed) * 8.0).clamp(-127.0, 127.0) as i8;
        }
        self
    }

    /// The same without the modes for which the tests say true.
    pub fn without(
        mut self,
        direction: impl Fn(&AzimuthEvidence) -> bool,
        distance: impl Fn(&RangeEvidence) -> bool,
    ) -> Self {
        for mark in &mut self.azimuth {
            if mark.sd > 0 && direction(&mark.view()) {
                mark.sd = 0;
            }
        }
        for mark in &mut self.range {
            if mark.sd > 0 && distance(&mark.view()) {
                mark.sd = 0;
            }
        }
        self
    }

    /// Its directions.
    pub fn directions(&self) -> impl Iterator<Item = AzimuthEvidence> + '_ {
        self.azimuth.iter().filter(|m| m.sd > 0).map(AzimuthMark::view)
    }

    /// Its ranges.
    pub fn distances(&self) -> impl Iterator<Item = RangeEvidence> + '_ {
        self.range.iter().filter(|m| m.sd > 0).map(RangeMark::view)
    }
}

/// The ring.
#[derive(Clone, Debug)]
pub struct Evidence {
    minutes: [Kept; MINUTES],
    /// Number of the newest.
    newest: u32,
    next: usize,
    held: usize,
}

impl Evidence {
    /// Empty; all zeros.
    pub const fn new() -> Self {
        Self { minutes: [Kept::NONE; MINUTES], newest: 0, next: 0, held: 0 }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.held = 0;
    }

    /// Adds a minute; the oldest goes.
    pub fn push(&mut self, minute: Minute) {
        if let Some(slot) = self.minutes.get_mut(self.next) {
            *slot = Kept::new(&minute);
            self.newest = minute.number;
        }
        self.next = (self.next + 1) % MINUTES;
        self.held = (self.held + 1).min(MINUTES);
    }

    /// Removes what a vessel that has gone explains, so that it is not found again.
    pub fn forget(&mut self, explained: impl Fn(Minute) -> Minute) {
        let newest = self.newest;
        self.minutes.iter_mut().for_each(|m| *m = Kept::new(&explained(m.minute(newest))));
    }

    /// Minutes from number `from` to `to`, both included, oldest first.
    pub fn between(&self, from: u32, to: u32) -> impl Iterator<Item = Minute> + Clone + '_ {
        let (newer, older) = self.minutes.split_at_checked(self.next).unwrap_or_default();
        let skip = MINUTES - self.held;
        let minutes = older.iter().chain(newer).skip(skip).map(|m| m.minute(self.newest));
        minutes.filter(move |m| (from..=to).contains(&m.number))
    }

    /// The same, newest first.
    pub fn between_back(&self, from: u32, to: u32) -> impl Iterator<Item = Minute> + Clone + '_ {
        let (newer, older) = self.minutes.split_at_checked(self.next).unwrap_or_default();
        let all = newer.iter().rev().chain(older.iter().rev()).take(self.held);
        all.map(|m| m.minute(self.newest)).filter(move |m| (from..=to).contains(&m.number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weight_is_kept_to_an_eighth_and_a_light_mode_stays_light() {
        for weight in [1.0f32, 0.93, 0.5, 0.26, 0.01, 0.001, 1e-4] {
            let kept = weight_of(weight_code(weight));
            assert!((kept / weight - 1.0).abs() <= 1.0 / 15.0, "{weight}: {kept}");
        }
        assert_eq!(weight_of(weight_code(1.0)), 1.0);
        assert_eq!((weight_code(0.0), weight_of(weight_code(1e-6))), (0, 0.0));
    }
}
