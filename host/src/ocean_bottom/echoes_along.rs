//! Whether a recording holds echoes along tracks, and whether it would hold more along the same tracks at another time or scale.
//!
//! Enters: squared envelopes of cepstra and courses. Along courses, in each cell of range of each branch the mean envelope's noncentrality is
//! so many standard deviations of noise alone; the mean of its square over cells is what is *heard*: about a fifth where nothing is, 1 for
//! weak vessels, a hundred for loud ones. Along the same courses ten minutes and more earlier or later there is noise, and what of echoes
//! the wrong delays touch by chance (up to a tenth of what the right ones hear): that is the yardstick.

use super::strengths::{Cell, Envelopes};
use crate::course::VesselCourse;
use crate::propagation::Propagation;
use seabearing_core::kit::quantile;

/// Longest shift in time looked at, s.
const LONGEST_S: f64 = 1_800.0;
/// Step of shifts, s: a vessel of 7 m/s goes on by 200 m, within which a delay hardly leaves its pulse.
const STEP_S: f64 = 30.0;
/// From here on a shift tells what chance hears, s.
const CHANCE_S: f64 = 600.0;
/// Step of scales, and how many are looked at on either side: 0.7 to 1.42.
const SCALE: f64 = 1.01;
const SCALES: i32 = 35;
/// Of shifts that are none, this share hears less than the yardstick.
const YARDSTICK: f64 = 0.9;
/// Echoes are there where so many times the yardstick is heard.
const ECHOES: f64 = 2.0;
/// Elsewhere they are if so many times the middle of what chance hears is heard there.
const ELSEWHERE: f64 = 20.0;
/// Step and number of short shifts on either side that halves of a recording are compared along, s.
const SHORT_S: f64 = 5.0;
const SHORT: i32 = 12;
/// Tracks are late where both halves say so by more than this, and to within so much of each other, s: a second's way is a tenth of what a
/// pulse is wide at the ranges that tell most.
const LATE_S: f64 = 7.0;
const ALIKE_S: f64 = 10.0;
/// A half of a recording is every second stretch so long, s.
const STRETCH_S: f64 = 600.0;
/// Another time or scale is better where so many times as much is heard there.
const BETTER: f64 = 1.2;
/// Most frames of a recording that are looked at; of longer ones every second, third and so on.
const FRAMES: usize = 10_000;

/// A time and a scale that fit tracks better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elsewhere {
    /// By how much later than told the vessels were where they are told to be, s.
    pub later_s: f64,
    /// Times as far as told from the station.
    pub scale: f64,
}

/// What a recording holds along tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Along {
    /// What is heard along them.
    pub heard: f64,
    /// What is heard by chance: nine tenths of the same tracks ten minutes and more off hear less.
    pub by_chance: f64,
    /// Where there is clearly more.
    pub elsewhere: Option<Elsewhere>,
}

impl Along {
    /// Looks along courses. `None` where there is no cell to look at.
    pub fn of(envelopes: &Envelopes, courses: &[VesselCourse], table: &Propagation) -> Option<Self> {
        let few = envelopes.thinned(FRAMES);
        let at = |later_s: f64, scale: f64| {
            let courses: Vec<_> = courses.iter().map(|c| c.moved(later_s, scale)).collect();
            heard(&few.cells(&courses, table)).map(|heard| (Elsewhere { later_s, scale }, heard))
        };
        let (_, here) = at(0.0, 1.0)?;
        let shifts = (LONGEST_S / STEP_S) as i32;
        let in_time = (-shifts..=shifts).filter_map(|k| at(STEP_S * f64::from(k), 1.0));
        let in_scale = (-SCALES..=SCALES).filter_map(|k| at(0.0, SCALE.powi(k)));
        let all: Vec<_> = in_time.chain(in_scale).collect();
        let (place, most) = all.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
        // Beside the best too it is no chance.
        let off = |e: &Elsewhere| e.later_s.abs().min((e.later_s - place.later_s).abs());
        let mut chance: Vec<f64> = all.iter().filter(|(e, _)| off(e) >= CHANCE_S).map(|(_, h)| *h).collect();
        let middle = quantile::median(&mut chance)?;
        let by_chance = quantile(&mut chance, YARDSTICK)?;
        let echoes = most > ECHOES * by_chance && (here > ECHOES * by_chance || most > ELSEWHERE * middle);
        let elsewhere = (echoes && most > BETTER * here).then_some(place);
        let along = here > ECHOES * by_chance;
        let elsewhere = elsewhere.or_else(|| {
            let later_s = if along { late(&few, courses, table) } else { None };
            later_s.map(|later_s| Elsewhere { later_s, scale: 1.0 })
        });
        Some(Self { heard: here, by_chance, elsewhere })
    }

    /// Whether there are echoes along the tracks as told.
    pub fn echoes(&self) -> bool {
        self.heard > ECHOES * self.by_chance
    }
}

/// By how much later than told vessels were there, where the halves of a recording agree on it, s.
fn late(envelopes: &Envelopes, courses: &[VesselCourse], table: &Propagation) -> Option<f64> {
    let best = |half: &Envelopes| {
        let at = |k: i32| {
            let later_s = SHORT_S * f64::from(k);
            let moved: Vec<_> = courses.iter().map(|c| c.moved(later_s, 1.0)).collect();
            heard(&half.cells(&moved, table)).map(|heard| (later_s, heard))
        };
        (-SHORT..=SHORT).filter_map(at).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(later_s, _)| later_s)
    };
    let (a, b) = envelopes.halves(STRETCH_S);
    let (a, b) = (best(&a)?, best(&b)?);
    let late = a.abs().min(b.abs()) > LATE_S && (a - b).abs() <= ALIKE_S;
    late.then_some(0.5 * (a + b))
}

/// Mean over cells of the squared deviations of noise alone by which a cell's noncentrality λ is above it; `None` of no cell.
fn heard(cells: &[Vec<Cell>]) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0.0f64);
    for c in cells.iter().flatten() {
        // Of noise alone λ has the variance 4/n; overlapped frames count half.
        sum += c.noncentrality.powi(2) * 0.5 * c.frames as f64 / 4.0;
        n += 1.0;
    }
    (n > 0.0).then(|| sum / n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight};
    use crate::ocean_bottom::simulate::Simulator;
    use crate::ocean_bottom::stages::frames;
    use crate::ocean_bottom::station;
    use crate::propagation::{bottom::Bottom, profile::SpeedProfile, trace};

    #[test]
    fn echoes_are_found_along_the_vessel_s_way_and_nowhere_else() {
        let profile = SpeedProfile::subtropical(4340.0).unwrap();
        let table = trace::trace("t", &profile, &Bottom::default(), 70.0, 1000, || ());
        let straight = Straight {
            cpa_time_s: 5_400.0,
            cpa_range_m: 8_000.0,
            heading_deg: 40.0,
            speed_m_s: 7.0,
            side: Side::Port,
        };
        let radiation = Radiation::default();
        let ship = ObsVessel { name: "a".into(), straight, active_s: [-1e9, 1e9], radiation };
        let envelopes = |vessels: Vec<ObsVessel>, seed: u64| {
            let quiet = "kind = \"obs\"\nseed = 1\nduration_s = 10800.0\npropagation = \"t\"\n";
            let scenario: ObsScenario = toml::from_str(quiet).unwrap();
            let scenario = ObsScenario { vessels, seed, ..scenario };
            let config = station::config(&scenario).unwrap();
            let mut simulator = Simulator::new(scenario, table.clone(), Vec::new()).unwrap();
            Envelopes::of(&frames(&mut simulator, &config).unwrap())
        };
        let told = VesselCourse::straight(&straight);
        let look = |e: &Envelopes, c: VesselCourse| Along::of(e, &[c], &table).unwrap();
        let heard = envelopes(vec![ship], 5);
        let right = look(&heard, told.clone());
        assert!(right.echoes() && right.elsewhere.is_none(), "{right:?}");
        for late_s in [-20.0, 15.0, 45.0] {
            let late = look(&heard, told.moved(late_s, 1.0));
            assert!(late.elsewhere.is_some_and(|e| (e.later_s + late_s).abs() <= 15.0), "{late_s}: {late:?}");
        }
        let late = look(&heard, told.moved(600.0, 1.0));
        assert!(!late.echoes(), "{late:?}");
        assert_eq!(late.elsewhere, Some(Elsewhere { later_s: -600.0, scale: 1.0 }));
        let far = look(&heard, told.moved(0.0, 1.3));
        assert!(!far.echoes() && (1.3 * far.elsewhere.unwrap().scale - 1.0).abs() < 0.01, "{far:?}");
        let nothing = look(&envelopes(Vec::new(), 6), told);
        assert!(!nothing.echoes() && nothing.elsewhere.is_none(), "{nothing:?}");
    }
}
