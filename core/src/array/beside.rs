//! What another vessel does to a bearing that it passes by too closely to be told apart.
//!
//! Enters: where the strongest source and another that was followed stood and how they turned, when the one came so near to the other that
//! it is not looked for there. Leaves: the error that it puts on the strongest one's direction until they have parted. Two vessels alike
//! within the array's resolution are heard as one between them; beyond it, hardly.

use super::plan::Plan;
use super::wavefront::{self, Direction};

/// What a vessel as far as that puts on a direction, in units of what they are apart, where that is less than so many resolution cells: a law
/// that fits passes of two vessels alike within 6 dB at 16 and 64 kHz. Beyond that it falls by the fourth power.
const PULLED: f32 = 0.35;
const RESOLVED_CELLS: f32 = 2.0;
/// Standard deviation of what they are apart, which is foreseen, in the same cells.
const FORESEEN_CELLS: f32 = 0.5;
/// Segments after which it is not foreseen any more.
const LONGEST: u32 = 1200;

/// Another vessel beside the strongest one. All zeros where there is none, as the recorder's memory begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside {
    /// How far it is from the strongest, clockwise and up, radians, and by how much the first grows from segment to segment.
    apart: [f32; 2],
    turning: f32,
    segment: u32,
    is: bool,
}

impl Beside {
    /// Nobody.
    pub(super) const NONE: Self = Self { apart: [0.0; 2], turning: 0.0, segment: 0, is: false };

    /// One is there now, `turning` against the strongest by so much from segment to segment (radians).
    pub(super) fn there(strongest: &Direction, other: &Direction, turning: f32, segment: u32) -> Self {
        let e = wavefront::tangents(strongest);
        let apart = [&e.0, &e.1].map(|tangent| wavefront::dot(other, tangent));
        Self { apart, turning, segment, is: true }
    }

    /// How far it is clockwise, radians.
    fn level(&self, segment: u32) -> f32 {
        self.apart[0] + self.turning * segment.wrapping_sub(self.segment) as f32
    }

    /// Ends where they have parted by this angle, radians.
    pub(super) fn until(&mut self, parted: f32, segment: u32) {
        self.is &= self.level(segment).abs() < parted && segment.wrapping_sub(self.segment) < LONGEST;
    }

    /// What it puts on the direction across and up, rad², if it is there.
    #[inline(never)]
    pub(super) fn puts(&self, plan: &Plan, segment: u32) -> Option<[f32; 2]> {
        let cell = plan.whole.resolution;
        let (level, doubt, width) = (self.level(segment), FORESEEN_CELLS * cell, RESOLVED_CELLS * cell);
        let away = ((level.abs() - doubt) / width).max(1.0);
        let pulled = PULLED / (away * away * away * away);
        let [_, up] = self.apart;
        let (across, up) = (level * level + doubt * doubt, up * up);
        self.is.then_some([across, up].map(|square| pulled * pulled * square))
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::plan;
    use super::*;
    use crate::angle::unit_vector;

    #[test]
    fn it_pulls_by_a_third_of_what_they_are_apart_and_hardly_where_they_are_resolved() {
        for rate_hz in [16_000.0, 64_000.0] {
            let plan = plan(rate_hz);
            let cell = plan.whole.resolution;
            let sd = |apart: f32, segment| {
                let at = |azimuth| unit_vector(azimuth, 0.0);
                let beside = Beside::there(&at(1.0), &at(1.0 + apart), -0.1 * cell, 7);
                beside.puts(&plan, segment).map(|[across, _]| across.sqrt() / cell)
            };
            let near = |a: Option<f32>, b: f32| a.is_some_and(|a| (a - b).abs() < 0.02);
            assert!(near(sd(cell, 7), 0.35 * 1.118), "{:?}", sd(cell, 7));
            // Ten segments later it is there.
            assert!(near(sd(cell, 17), 0.35 * 0.5), "{:?}", sd(cell, 17));
            assert!(sd(6.0 * cell, 7).is_some_and(|sd| sd < 0.06), "{:?}", sd(6.0 * cell, 7));
        }
        assert!(Beside::NONE.puts(&plan(16_000.0), 0).is_none());
    }
}
