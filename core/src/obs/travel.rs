//! Travel time against range, and what the vessel did before its sound arrived.
//!
//! What arrives at t left at t − toa(r): 16 s earlier from 20 km, 25 s from 35 km. Both estimators therefore see the
//! vessel where it was; a track fitted to them without this correction is late by those times.

use super::table::{KNOT_M, KNOTS, Table};

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
