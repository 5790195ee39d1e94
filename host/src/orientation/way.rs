//! How long sound is on its way from a vessel to a station.

use super::sets::SightingSet;

/// What the sound goes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// Speed of sound, m/s.
    pub sound_m_s: f64,
    /// The stations lie at the floor of a deep sea: what is loudest from afar has been at the surface and the floor once more, three
    /// times through the water [O, II].
    pub thrice: bool,
}

impl Way {
    /// Straight from the vessel.
    pub fn straight(sound_m_s: f64) -> Self {
        Self { sound_m_s, thrice: false }
    }

    /// From a place to a station, seconds.
    pub fn time_s(&self, station_m: &[f64; 3], place_m: &[f64; 3]) -> f64 {
        let [x, y, z] = [0, 1, 2].map(|k| place_m[k] - station_m[k]);
        let through = if self.thrice { 3.0 } else { 1.0 };
        x.hypot(y).hypot(through * z) / self.sound_m_s
    }

    /// The mean of the stations of a set: that long before the set's time the vessel was at the place of its fix.
    pub fn mean_s(&self, set: &SightingSet, place_m: &[f64; 3]) -> f64 {
        let all = set.sightings.iter().map(|seen| self.time_s(&seen.array_m, place_m));
        all.sum::<f64>() / set.sightings.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_the_surface_to_the_floor_straight_and_by_another_turn() {
        let (station, place) = ([0.0, 0.0, -4005.0], [3000.0, 0.0, -5.0]);
        assert!((Way::straight(1500.0).time_s(&station, &place) - 5000.0 / 1500.0).abs() < 1e-12);
        let thrice = Way { sound_m_s: 1500.0, thrice: true };
        assert!((thrice.time_s(&station, &place) - 3000f64.hypot(12_000.0) / 1500.0).abs() < 1e-12);
    }
}
