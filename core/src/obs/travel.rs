//! Travel time against range, and what the vessel did before its sound arrived.
//!
//! What arrives at t left at t − toa(r): 16 s earlier from 20 km, 25 s from 35 km. Both estimators therefore see the
//! vessel where it was; a track fitted to them without this correction is late by those times.

use super::table::Table;

/// Knots of the stored curve.
const KNOTS: usize = 101;

/// Distance between knots, m.
const KNOT_M: f32 = 1000.0;

/// Travel time of the first arrival at every kilometre.
#[derive(Clone, Debug)]
pub struct TravelTime {
    toa_s: [f32; KNOTS],
}

impl TravelTime {
    /// No curve yet; all zeros.
    pub const EMPTY: Self = Self { toa_s: [0.0; KNOTS] };

    /// From the table; where it is silent, straight on at 1500 m/s. `ignored` gives zero everywhere \[O\].
    pub fn fill(&mut self, table: &Table<'_>, ignored: bool) {
        let toa_s = &mut self.toa_s;
        toa_s.fill(0.0);
        if !ignored {
            // The first row of a table is often empty: the overhead time then comes from its nearest neighbour.
            let step = table.header().step_m;
            let overhead =
                (0..table.ranges()).find_map(|j| table.travel_time_s(step * j as f32)).unwrap_or(0.0);
            let mut last = overhead;
            for (k, toa) in toa_s.iter_mut().enumerate() {
                let known = table.travel_time_s(KNOT_M * k as f32);
                last = known.unwrap_or(if k == 0 { overhead } else { last + KNOT_M / 1500.0 });
                *toa = last;
            }
        }
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
