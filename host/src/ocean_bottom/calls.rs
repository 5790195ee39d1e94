//! Calls of whales, from a recording: direction and range of notes that repeat (fin and blue whales about 20 Hz).
//!
//! A note reaches the floor once for each path, and the delays between its arrivals are those of the propagation table, as for a vessel's
//! interference [O 16]. For each kind of note ([`super::notes`]) a window about each minute of pressure and horizontal velocities is cut to its band and
//! made analytic.
//!
//! Spikes are put right as the recorder puts them right (`mended.rs`).
//!
//! - *Notes* are peaks of the smoothed power: of fin whales' calls the whole, of blue whales' the fall between their tones.
//! - *Azimuth*: the active intensity about each note's peak, less what vessels give between notes (`call_azimuths.rs`). Notes of which
//!   a horizontal component is clipped have none.
//! - *Range*: by the delays between a note's arrivals ([`super::call_ranges`]).
//!
//! A range is told where its place holds nine tenths of the posterior and explains what is heard; nearer than
//! [`super::notes::Kind::nearest_m`], beyond the table's reach and where nothing stands out there is none. Calls are joined to a caller's way,
//! apart from vessels' tracks ([`super::caller_ways`]). Not known: several whales of a kind at once whose notes interleave (the louder one counts),
//! and calls that are one long tone, which have no range.

use super::call_azimuths::{Field, LEAST_NOTES};
use super::call_ranges::{CallRange, Ranger};
use super::mended::{Mended, clipped};
use super::notes::{FIN, KINDS, Kind as Notes};
use crate::propagation::{Complex, Propagation};
use crate::recording::BlockSource;
use anyhow::{Result, bail};
use seabearing_core::angle::wrap_tau;
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::obs::lasting::Lasting;
use seabearing_signal::{Fft, Precision, RealToComplex};
use std::f64::consts::PI;
use std::sync::Arc;

/// Share of a note's samples that may be clipped in a horizontal component where its direction counts: one of 61.
const CUT_OFF: f64 = 0.02;
/// Bits of the horizontal components, and of all that are listened to.
const HORIZONTALS: u8 = 0b0110;
const USED: u8 = 0b0111;

/// What was heard of calls in the minutes about an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WhaleCall {
    /// Of which kind.
    pub kind: &'static str,
    /// The instant, s after the first sample.
    pub t_s: f64,
    /// Notes in the window.
    pub notes: usize,
    /// From note to note, s; `None` where it is not steady.
    pub interval_s: Option<f64>,
    /// True azimuth and its standard deviation, rad; `None` without the horizontal components.
    pub azimuth: Option<(f64, f64)>,
    /// What of that deviation the station's orientation and gains make, rad: calls from one direction share it.
    pub shared_azimuth: f64,
    /// Range, where the delays of the notes' arrivals are a range's.
    pub range: Option<CallRange>,
}

/// Looks for notes of each kind in one window after another of what is held.
struct Listener<'t> {
    ears: Vec<Ear<'t>>,
    held: Mended,
    /// Greatest code of the converter.
    full_scale: i32,
    /// Index up to which clipped instants are counted.
    counted_to: u64,
    heard: Heard,
}

/// Listens to one kind.
struct Ear<'t> {
    notes: Notes,
    ranger: Ranger<'t>,
    rate_hz: f64,
    /// What is not known of the station itself.
    lasting: Lasting,
    turn: f64,
    n: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn Fft<f64>>,
    /// Samples of a window.
    length: usize,
    /// Number of the next window's middle.
    minute: u64,
}

/// What was heard of calls in a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Heard {
    /// The calls, minute by minute.
    pub calls: Vec<WhaleCall>,
    /// Instants at which a spike was put right.
    pub spikes: u64,
    /// Instants at which pressure or a horizontal component was clipped.
    pub clipped: u64,
}

/// Calls of a recording, minute by minute.
///
/// # Errors
/// The recording cannot be read, or its rate is not between 50 and 100 Hz.
pub fn calls(source: &mut dyn BlockSource, config: &StationConfig, table: &Propagation) -> Result<Heard> {
    let rate_hz = config.rate_hz;
    if !(50.0..=100.0).contains(&rate_hz) {
        bail!("{rate_hz} Hz: notes are looked for in recordings of 50 to 100 Hz");
    }
    let Kind::Obs(obs) = &config.kind else { bail!("an ocean-bottom station is needed") };
    let lasting = Lasting::new(config.doubts, obs.orientation_of_north_deg, table.depth_m);
    let away = if obs.intensity_towards { 0.0 } else { PI };
    let ear = |notes: Notes| {
        let length = (2.0 * notes.half_window_s * rate_hz) as usize;
        let n = (2 * length).next_power_of_two();
        Ear {
            notes,
            ranger: Ranger::new(table, rate_hz, notes, lasting, config.doubts.table_depth_m.into()),
            rate_hz,
            lasting,
            turn: obs.orientation_of_north_deg.to_radians() + away,
            n,
            forward: f64::real_to_complex(n),
            inverse: f64::complex_inverse(n),
            length,
            minute: 1,
        }
    };
    let mut listener = Listener {
        ears: KINDS.into_iter().map(ear).collect(),
        held: Mended::new(),
        full_scale: config.full_scale,
        counted_to: 0,
        heard: Heard { calls: Vec::new(), spikes: 0, clipped: 0 },
    };
    while let Some(block) = source.next_block()? {
        if listener.held.end() != block.first_index {
            listener.listen(true);
            listener.held.restart(block.first_index);
        }
        listener.held.extend(block.frames);
        listener.listen(false);
    }
    listener.listen(true);
    let Listener { held, mut heard, .. } = listener;
    heard.calls.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    Ok(Heard { spikes: held.spikes, ..heard })
}

impl Listener<'_> {
    /// Listens to every window that is held; `ended`: nothing follows what is held.
    fn listen(&mut self, ended: bool) {
        let Self { ears, held, full_scale, counted_to, heard } = self;
        for ear in ears.iter_mut() {
            loop {
                // What began after the window's beginning was lost, or never was.
                while ear.from() < held.first() as f64 {
                    ear.minute += 1;
                }
                let from = ear.from() as u64;
                let at = (from - held.first()) as usize;
                let Some(window) = held.settled(ended).get(at..at + ear.length) else { break };
                let clipped = clipped(window, *full_scale);
                let counted = (counted_to.saturating_sub(from) as usize).min(clipped.len());
                let new = clipped[counted..].iter().filter(|bits| **bits & USED != 0).count();
                heard.clipped += new as u64;
                *counted_to = (*counted_to).max(from + ear.length as u64);
                heard.calls.extend(ear.window(window, &clipped));
                ear.minute += 1;
            }
        }
        let first = ears.iter().map(Ear::from).fold(f64::INFINITY, f64::min);
        held.drop_before(first as u64);
    }
}

impl Ear<'_> {
    /// Index at which the next window begins; below 0 before the recording.
    fn from(&self) -> f64 {
        ((60.0 * self.minute as f64 - self.notes.half_window_s) * self.rate_hz).round()
    }

    /// A channel cut to a band, as an analytic signal; `None` where a code is missing.
    fn analytic(&self, window: &[Frame], channel: usize, (lo, hi): (f64, f64)) -> Option<Vec<Complex<f64>>> {
        if window.iter().any(|f| f[channel] == MISSING) {
            return None;
        }
        let mean = window.iter().map(|f| f64::from(f[channel])).sum::<f64>() / window.len() as f64;
        let mut samples = vec![0.0; self.n];
        for (x, f) in samples.iter_mut().zip(window) {
            *x = f64::from(f[channel]) - mean;
        }
        let mut half = self.forward.make_output_vec();
        self.forward.process(&mut samples, &mut half).ok()?;
        let mut x = vec![Complex::default(); self.n];
        x.iter_mut().zip(half).for_each(|(x, h)| *x = h);
        for (k, x) in x.iter_mut().enumerate() {
            let hz = k as f64 * self.rate_hz / self.n as f64;
            // Edges of 1 Hz.
            let edge = (hz - lo + 1.0).min(hi + 1.0 - hz).clamp(0.0, 1.0);
            let inside = if 2 * k < self.n { edge * edge * (3.0 - 2.0 * edge) } else { 0.0 };
            *x *= 2.0 * inside / self.n as f64;
        }
        self.inverse.process(&mut x);
        x.truncate(window.len());
        Some(x)
    }

    fn window(&self, window: &[Frame], clipped: &[u8]) -> Option<WhaleCall> {
        let Notes { name, band_hz, .. } = self.notes;
        let pressure = self.analytic(window, 0, band_hz)?;
        let whole = self.analytic(window, 0, FIN.band_hz)?;
        let notes = self.notes.notes(&pressure, &whole, self.rate_hz);
        if notes.len() < LEAST_NOTES {
            return None;
        }
        let interval_s = Notes::interval_s(&notes, self.rate_hz);
        let horizontals = self.analytic(window, 1, band_hz).zip(self.analytic(window, 2, band_hz));
        let own = horizontals.and_then(|(north, east)| {
            let field = Field {
                notes: self.notes,
                pressure: &pressure,
                north: &north,
                east: &east,
                rate_hz: self.rate_hz,
            };
            let (azimuth, sd) = field.azimuth(&notes, |at| self.is_whole(at, clipped))?;
            Some((wrap_tau(azimuth + self.turn), sd))
        });
        let shared_azimuth = own.map_or(0.0, |(azimuth, _)| self.lasting.of_direction(azimuth).sqrt());
        let azimuth = own.map(|(azimuth, sd)| (azimuth, sd.hypot(shared_azimuth)));
        let range = self.ranger.range(&pressure, &notes, interval_s);
        let t_s = 60.0 * self.minute as f64;
        Some(WhaleCall { kind: name, t_s, notes: notes.len(), interval_s, azimuth, shared_azimuth, range })
    }

    /// Whether the horizontal components have the whole of a note: what is cut off one of them turns its direction. Pressure cut off makes
    /// both intensities less by the same part.
    fn is_whole(&self, note: usize, clipped: &[u8]) -> bool {
        let half = (self.notes.half_s * self.rate_hz) as usize;
        let span = clipped.get(note.saturating_sub(half)..(note + half + 1).min(clipped.len()));
        span.is_some_and(|span| {
            let cut = span.iter().filter(|bits| **bits & HORIZONTALS != 0).count();
            cut as f64 <= CUT_OFF * span.len() as f64
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ocean_bottom::caller_ways::ways;
    use crate::ocean_bottom::scenario::{ObsScenario, Whale};
    use crate::ocean_bottom::simulate::Simulator;
    use crate::ocean_bottom::station;
    use crate::propagation::{bottom::Bottom, profile::SpeedProfile, trace};
    use seabearing_core::angle::wrap_pi;
    use seabearing_core::config::Doubts;

    fn table() -> Propagation {
        let profile = SpeedProfile::subtropical(4340.0).unwrap();
        trace::trace("t", &profile, &Bottom::default(), 70.0, 600, || ())
    }

    fn heard(whales: &[(f64, f64, f64)]) -> Vec<WhaleCall> {
        let table = table();
        heard_with(whales, &table, &table)
    }

    /// What is found with one table of calls that came as another has it.
    fn heard_with(whales: &[(f64, f64, f64)], sea: &Propagation, told: &Propagation) -> Vec<WhaleCall> {
        heard_of(whales, sea, told, "duration_s = 900.0", Doubts::default()).calls
    }

    /// The same of a scenario with more said of it, and of a station of which not all is known.
    fn heard_of(
        whales: &[(f64, f64, f64)],
        sea: &Propagation,
        told: &Propagation,
        said: &str,
        doubts: Doubts,
    ) -> Heard {
        let scenario: ObsScenario = toml::from_str(&format!(
            "kind = \"obs\"\nseed = 4\npropagation = \"t\"\norientation_of_north_deg = 77.0\n{said}\n"
        ))
        .unwrap();
        let whale = |(azimuth_deg, range_m, level_db): &(f64, f64, f64)| Whale {
            azimuth_deg: *azimuth_deg,
            range_m: *range_m,
            start_s: -60.0,
            duration_s: 900.0,
            interval_s: 13.0,
            level_db: *level_db,
        };
        let scenario = ObsScenario { fin_whale: whales.iter().map(whale).collect(), ..scenario };
        let config = StationConfig { doubts, ..station::config(&scenario).unwrap() };
        let mut simulator = Simulator::new(scenario, sea.clone(), Vec::new()).unwrap();
        calls(&mut simulator, &config, told).unwrap()
    }

    #[test]
    fn a_fin_whale_has_azimuth_and_range() {
        for (azimuth, range) in [(200.0, 5_000.0), (340.0, 12_000.0)] {
            let found = heard(&[(azimuth, range, 18.0)]);
            assert!(found.len() >= 10, "{range}: {} windows", found.len());
            let ranges: Vec<f64> = found.iter().filter_map(|c| Some(c.range?.range_m)).collect();
            assert!(2 * ranges.len() >= found.len(), "{range}: {ranges:?}");
            assert!(ranges.iter().all(|r| (r / range - 1.0).abs() < 0.1), "{range}: {ranges:?}");
            for c in &found {
                let (a, _) = c.azimuth.unwrap();
                assert!(wrap_pi(a - f64::to_radians(azimuth)).abs() < 0.1, "{a}");
            }
            let ways = ways(&found);
            assert_eq!(ways.len(), 1);
            let off = (ways[0].place_m.0.hypot(ways[0].place_m.1) / range - 1.0).abs();
            assert!(off < 0.05, "{ways:?}");
        }
    }

    #[test]
    fn a_blue_whale_is_ranged_by_the_fall_between_its_tones_and_is_no_fin_whale() {
        let table = table();
        let range_m = 9_000.0;
        let mut scenario: ObsScenario = toml::from_str(
            "kind = \"obs\"\nseed = 4\npropagation = \"t\"\norientation_of_north_deg = 77.0\nduration_s = 900.0",
        )
        .unwrap();
        let whale = |interval_s| Whale {
            azimuth_deg: 200.0,
            range_m,
            start_s: -120.0,
            duration_s: 1_200.0,
            interval_s,
            level_db: 14.0,
        };
        scenario.blue_whale = vec![whale(63.0)];
        let config = station::config(&scenario).unwrap();
        let mut simulator = Simulator::new(scenario.clone(), table.clone(), Vec::new()).unwrap();
        let found = calls(&mut simulator, &config, &table).unwrap().calls;
        assert!(found.len() >= 8 && found.iter().all(|c| c.kind == "blue"), "{found:?}");
        let ranges: Vec<CallRange> = found.iter().filter_map(|c| c.range).collect();
        assert!(2 * ranges.len() >= found.len(), "{found:?}");
        assert!(
            ranges.iter().all(|r| (r.range_m - range_m).abs() < 4.0 * r.sd_m && r.sd_m < 100.0),
            "{ranges:?}"
        );
        for (azimuth, sd) in found.iter().filter_map(|c| c.azimuth) {
            assert!(wrap_pi(azimuth - f64::to_radians(200.0)).abs() < 4.0 * sd && sd < 0.1, "{azimuth} {sd}");
        }
        // Both at once: each kind is told.
        scenario.fin_whale = vec![Whale { azimuth_deg: 20.0, ..whale(14.0) }];
        let mut simulator = Simulator::new(scenario, table.clone(), Vec::new()).unwrap();
        let found = calls(&mut simulator, &config, &table).unwrap().calls;
        for c in found.iter().filter(|c| c.kind == "fin") {
            assert!(c.range.is_none_or(|r| (r.range_m / range_m - 1.0).abs() < 0.5), "{c:?}");
        }
    }

    #[test]
    fn a_whale_outside_what_can_be_told_has_an_azimuth_and_no_range() {
        let table = table();
        let mut short = table.clone();
        short.paths.iter_mut().for_each(|p| p.arrivals.truncate(400));
        let far = heard_with(&[(120.0, 38_000.0, 18.0)], &table, &short);
        let near = heard(&[(120.0, 700.0, 18.0)]);
        for found in [&far, &near] {
            assert!(
                found.len() >= 10 && found.iter().all(|c| c.range.is_none() && c.azimuth.is_some()),
                "{found:?}"
            );
            assert!(ways(found).is_empty());
        }
        // With a table that reaches so far it has a range.
        let told = heard(&[(120.0, 38_000.0, 18.0)]);
        let ranges: Vec<f64> = told.iter().filter_map(|c| Some(c.range?.range_m)).collect();
        assert!(2 * ranges.len() > told.len(), "{ranges:?}");
        assert!(ranges.iter().all(|r| (r - 38_000.0).abs() < 100.0), "{ranges:?}");
    }

    #[test]
    fn a_sea_without_calls_has_none() {
        assert!(heard(&[]).iter().all(|c| c.range.is_none()));
    }

    #[test]
    fn a_ship_beside_a_whale_does_not_turn_it() {
        let table = table();
        let (mut inside, mut all, mut sum, mut callers) = (0, 0, 0.0, Vec::new());
        for cpa_m in [12_000.0, 25_000.0] {
            let said = format!(
                "duration_s = 900.0\n[[vessels]]\nstraight = {{ cpa_time_s = 450.0, cpa_range_m = {cpa_m:.1}, heading_deg = 60.0, \
                 speed_m_s = 7.0, side = \"port\" }}"
            );
            let found = heard_of(&[(240.0, 12_000.0, 20.0)], &table, &table, &said, Doubts::default()).calls;
            for (azimuth, sd) in found.iter().filter_map(|c| c.azimuth) {
                let off = wrap_pi(azimuth - f64::to_radians(240.0));
                all += 1;
                sum += off;
                inside += usize::from(off.abs() < 2.5 * sd);
                assert!(sd < 0.15, "{off} {sd}");
            }
            callers.extend(ways(&found));
        }
        // It was 5 to 7 degrees towards the ship, stated to 0.5 degrees.
        assert!(all >= 20 && inside + 1 >= all, "{inside} of {all}");
        assert!((sum / all as f64).abs() < f64::to_radians(1.5), "{}", sum / all as f64);
        let place = (12_000.0 * f64::to_radians(240.0).sin(), 12_000.0 * f64::to_radians(240.0).cos());
        for way in &callers {
            let off = (way.place_m.0 - place.0).hypot(way.place_m.1 - place.1);
            assert!(off < 3.0 * way.sd_place_m, "{off} {way:?}");
            assert!(way.velocity_m_s.0.hypot(way.velocity_m_s.1) < 3.0 * way.sd_velocity_m_s, "{way:?}");
        }
    }

    const SPIKES: &str = "duration_s = 420.0\n[[faults]]\nkind = \"spikes\"\n";

    #[test]
    fn spikes_are_no_calls_and_a_whale_beneath_them_is_told_as_without() {
        let table = table();
        let exact = Doubts::default();
        for (every_s, counts, samples) in [(13.0, 20_000.0, 1), (7.0, 100_000.0, 1), (13.0, 20_000.0, 3)] {
            let said = format!("{SPIKES}every_s = {every_s:.1}\ncounts = {counts:.1}\nsamples = {samples}");
            let alone = heard_of(&[], &table, &table, &said, exact);
            assert!(
                alone.calls.iter().all(|c| c.azimuth.is_none_or(|(_, sd)| sd > 0.05)),
                "{said}: {alone:?}"
            );
            assert!(alone.spikes >= 30 && alone.clipped == 0, "{said}: {}", alone.spikes);
        }
        let said = format!("{SPIKES}every_s = 10.0\ncounts = 50000.0\nsamples = 1");
        let found = heard_of(&[(100.0, 12_000.0, 14.0)], &table, &table, &said, exact);
        assert!(found.calls.len() >= 4, "{found:?}");
        for c in &found.calls {
            let (azimuth, sd) = c.azimuth.unwrap();
            assert!(wrap_pi(azimuth - f64::to_radians(100.0)).abs() < 4.0 * sd && sd < 0.1, "{c:?}");
            assert!(c.range.is_none_or(|r| (r.range_m - 12_000.0).abs() < 50.0), "{c:?}");
        }
        assert!(found.calls.iter().any(|c| c.range.is_some()));
    }

    #[test]
    fn notes_cut_off_in_a_horizontal_component_tell_no_azimuth() {
        let table = table();
        for (level_db, counts) in [(25.0, 2_500.0), (15.0, 4_000.0)] {
            let said = format!("duration_s = 420.0\n[[faults]]\nkind = \"clipped\"\ncounts = {counts:.1}");
            let found = heard_of(&[(100.0, 10_000.0, level_db)], &table, &table, &said, Doubts::default());
            assert!(found.calls.len() >= 4 && found.clipped > 100 && found.spikes == 0, "{found:?}");
            for (azimuth, sd) in found.calls.iter().filter_map(|c| c.azimuth) {
                assert!(wrap_pi(azimuth - f64::to_radians(100.0)).abs() < 2.5 * sd, "{azimuth} {sd}");
            }
        }
    }

    #[test]
    fn what_is_not_known_of_the_station_is_in_what_is_told() {
        let sea = table();
        let profile = SpeedProfile::subtropical(4320.0).unwrap();
        let told = trace::trace("t", &profile, &Bottom::default(), 70.0, 600, || ());
        let doubts = Doubts { orientation_deg: 5.0, table_depth_m: 20.0, ..Doubts::default() };
        let whale = [(100.0, 12_000.0, 14.0)];
        let found = heard_of(&whale, &sea, &told, "duration_s = 420.0", doubts).calls;
        let ranges: Vec<CallRange> = found.iter().filter_map(|c| c.range).collect();
        assert!(ranges.len() >= 3, "{found:?}");
        for r in &ranges {
            assert!(
                (r.range_m - 12_000.0).abs() < 2.5 * r.sd_m && r.sd_m < 300.0 && r.shared_m < r.sd_m,
                "{r:?}"
            );
        }
        assert!(found.iter().all(|c| c.azimuth.unwrap().1 >= f64::to_radians(5.0)), "{found:?}");
        // Much less is known of the floor than what tells ranges apart.
        let vague = Doubts { table_depth_m: 500.0, ..doubts };
        let found = heard_of(&whale, &sea, &told, "duration_s = 300.0", vague).calls;
        assert!(
            found.len() >= 2 && found.iter().all(|c| c.range.is_none() && c.azimuth.is_some()),
            "{found:?}"
        );
    }
}
