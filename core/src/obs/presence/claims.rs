//! Which ranges are whose: those about each tracked vessel and of its echoes as another pair of paths, and the rest.

use super::super::interference::Interference;
use super::super::limits::{CELL_M, CLASSES, SPEED_STEP_M_S};
use super::super::radial::speed_of;
use super::modes::EXPECTED_WITHIN_M;
use super::{
    CHANGE, Density, EXPECTED, Expected, ExpectedVessels, LIKELY, OWNERS, Presence, UNCLAIMED, ends, of,
    pack, range_of, stretches, unpack,
};
use crate::math;

impl Presence {
    /// Divides the ranges among the vessels expected and one not tracked, and keeps at least `EXPECTED` of each
    /// tracked vessel's posterior where its track says it is.
    pub fn claim(&mut self, model: &Interference<'_>, expected: &ExpectedVessels) {
        let inside = |e: &Expected| e.range_m < CELL_M * self.cells as f32;
        let expected = expected.map(|e| e.filter(inside));
        let tracked = expected.map(|e| e.is_some());
        if !tracked.contains(&true) && !self.tracked.contains(&true) {
            return;
        }
        let [known @ .., unclaimed] = &mut self.present;
        for (present, (now, before)) in known.iter_mut().zip(tracked.iter().zip(&self.tracked)) {
            if *now && !before {
                // A vessel just tracked is the one that was there; whether there is another is open.
                (*present, *unclaimed) = (*unclaimed, CHANGE);
            }
        }
        self.tracked = tracked;
        for (i, owner) in self.owner.iter_mut().enumerate() {
            let range_m = range_of(i);
            let nearest = expected
                .iter()
                .enumerate()
                .filter_map(|(k, e)| Some((k, math::f32::abs(e.as_ref()?.range_m - range_m))))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let echo = |e: &Option<Expected>| e.is_some_and(|e| model.mistakes(range_m, e.range_m));
            *owner = match nearest {
                Some((k, d)) if d < EXPECTED_WITHIN_M => k as u8,
                _ => expected.iter().position(echo).map_or(UNCLAIMED, |k| k as u8),
            };
        }
        let owner = &self.owner;
        let ends = ends(self.cells, |i, next| owner.get(i) == owner.get(next));
        let mut mass = [0f32; OWNERS];
        for column in self.density.as_flattened() {
            for at in stretches(&ends) {
                let (Some(owner), Some(cells)) = (self.owner.get(at.start), column.get(at)) else { continue };
                let mass = of(&mut mass, *owner);
                *mass = cells.iter().fold(*mass, |mass, d| mass + unpack(*d));
            }
        }
        let mut scale = mass.map(|m| 1.0 / m.max(1e-30));
        scale.iter_mut().zip(&expected).for_each(|(s, _)| *s *= 1.0 - EXPECTED);
        for column in self.density.as_flattened_mut() {
            for at in stretches(&ends) {
                let (Some(owner), Some(cells)) = (self.owner.get(at.start), column.get_mut(at)) else {
                    continue;
                };
                let scale = *of(&mut scale, *owner);
                cells.iter_mut().for_each(|d| *d = pack(unpack(*d) * scale));
            }
        }
        for (k, e) in expected.iter().enumerate() {
            if let Some(e) = e {
                self.keep(k as u8, e);
            }
        }
    }

    /// Adds `EXPECTED` about the place expected, in the cells of that owner.
    fn keep(&mut self, owner: u8, e: &Expected) {
        let i = (e.range_m / CELL_M) as usize;
        let k = math::f32::round((e.speed_m_s - speed_of(0)) / SPEED_STEP_M_S).max(0.0) as usize;
        // At the shares that it has there already.
        let near = |density: &Density| {
            let columns = density.iter().skip(k.saturating_sub(1)).take(3);
            columns.flat_map(|c| c.iter().skip(i.saturating_sub(2)).take(5)).map(|d| unpack(*d)).sum::<f32>()
        };
        let held = core::array::from_fn::<f32, CLASSES, _>(|n| self.density.get(n).map_or(0.0, near));
        let all = held.iter().sum::<f32>();
        for ((density, held), likely) in self.density.iter_mut().zip(held).zip(LIKELY) {
            let share = EXPECTED / 15.0 * if all > 1e-20 { 0.9 * held / all + 0.1 * likely } else { likely };
            for column in density.iter_mut().skip(k.saturating_sub(1)).take(3) {
                let cells = column.iter_mut().zip(&self.owner).take(self.cells);
                for (d, _) in cells.skip(i.saturating_sub(2)).take(5).filter(|(_, o)| **o == owner) {
                    *d = pack(unpack(*d) + share);
                }
            }
        }
    }
}
