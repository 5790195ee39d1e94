//! Travel time against range, and what the vessel did before its sound arrived.
//!
//! What arrives at t left at t − toa(r): 16 s earlier from 20 km, 25 s from 35 km. Both estimators therefore see the
//! vessel where it was; a track fitted to them without this correction is late by those times.

use super::table::{KNOT_M, KNOTS, Table};

/// Travel time straight up at RR03, 4340 m at 1504.5 m/s, s.
pub(super) const RR03_S: f64 = 2.885;

/// Travel time of the first arrival at every kilometre.
#[derive(Clone, Debug)]
pub struct TravelTime {
    toa_s: [f32; KNOTS],
}

impl TravelTime {
    /// No curve yet; all zeros.
    pub const EMPTY: Self = Self { toa_s: [0.0; KNOTS] };

    /// From the table; `ignored` gives zero everywhere (paper O).
    pub fn fill(&mut self, table: &Table<'_>, ignored: bool) {
        self.toa_s.fill(0.0);
        if !ignored {
            self.toa_s.iter_mut().zip(table.travel_times_s()).for_each(|(slot, toa_s)| *slot = toa_s);
        }
    }

    /// Depth of the water over that of RR03, where lengths that go with it were measured: paths that cross the water n times have length
    /// `√(r² + n² h²)`, so all that their interference does at range r over depth h it does at 2 r over 2 h. 1 where it is not known.
    pub fn depth_ratio(&self) -> f64 {
        let [straight_up_s, ..] = self.toa_s;
        if straight_up_s > 0.0 { f64::from(straight_up_s) / RR03_S } else { 1.0 }
    }

    /// Travel time from a range, s; beyond 100 km straight on.
    pub fn at(&self, range_m: f64) -> f64 {
        let x = (range_m / f64::from(KNOT_M)).max(0.0);
        let j = (x as usize).min(KNOTS - 2);
        let part = x - j as f64;
        match (self.toa_s.get(j), self.toa_s.get(j + 1)) {
            (Some(a), Some(b)) => f64::from(*a) + f64::from(b - a) * part,
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_go_with_the_depth() {
        let over = |straight_up_s: f32| TravelTime { toa_s: [straight_up_s; KNOTS] }.depth_ratio();
        assert_eq!((over(0.0), over(RR03_S as f32) as f32), (1.0, 1.0));
        assert!((over(0.5339) - 800.0 / 4340.0).abs() < 0.002);
    }
}
