//! Calls of whales, from a recording: direction and range of short notes that repeat (fin whales about 20 Hz).
//!
//! A note reaches the floor once for each path, and the delays between its arrivals are those of the propagation table, as for a vessel's
//! interference [O 16]. Each minute's three-minute window of pressure and horizontal velocities is cut to [`BAND_HZ`] and made analytic.
//!
//! Spikes are put right as the recorder puts them right (`mended.rs`).
//!
//! - *Notes* are peaks of the smoothed power 6 dB above its median, the greatest first, none within [`APART_S`] of another.
//! - *Azimuth*: the active intensity about each note's peak, less what vessels give between notes (`call_azimuths.rs`). Notes of which
//!   a horizontal component is clipped have none.
//! - *Range*: by the delays between a note's arrivals ([`super::call_ranges`]).
//!
//! A range is told where its place holds nine tenths of the posterior and explains what is heard; nearer than
//! [`super::call_ranges::NEAREST_M`], beyond the table's reach and where nothing stands out there is none. Calls are joined to a caller's way,
//! apart from vessels' tracks ([`super::caller_ways`]). Not known: several whales at once whose notes interleave (the louder one counts), and
//! calls longer than a few seconds, which have no range.

use super::call_azimuths::{Field, LEAST_NOTES};
use super::call_ranges::{CallRange, OWN_S, Ranger};
use super::mended::{Mended, clipped};
use crate::propagation::{Complex, Propagation};
use crate::recording::BlockSource;
use anyhow::{Result, bail};
use seabearing_core::angle::wrap_tau;
use seabearing_core::block::{Frame, MISSING};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::kit::quantile;
use seabearing_core::obs::lasting::Lasting;
use seabearing_signal::{Fft, Precision, RealToComplex};
use std::f64::consts::PI;
use std::sync::Arc;

/// Frequencies of the notes, Hz.
pub const BAND_HZ: (f64, f64) = (15.0, 25.0);
/// Half a window, s.
const HALF_WINDOW_S: f64 = 90.0;
/// Notes nearer to each other than this are one call's arrivals, s: longer than the longest delay of its strong paths.
pub const APART_S: f64 = 8.0;
/// Peak power of a note over the median, times.
const STANDS_OUT: f64 = 4.0;
/// Half the length over which power is smoothed, s.
const SMOOTH_S: f64 = 0.4;
/// Share of a note's samples that may be clipped in a horizontal component where its direction counts: one of 61.
const CUT_OFF: f64 = 0.02;
/// Bits of the horizontal components, and of all that are listened to.
const HORIZONTALS: u8 = 0b0110;
const USED: u8 = 0b0111;

/// What was heard of calls in the three minutes about an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WhaleCall {
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

/// Looks for calls in one window after another of what is held.
struct Listener<'t> {
    ranger: Ranger<'t>,
    rate_hz: f64,
    /// Greatest code of the converter.
    full_scale: i32,
    /// What is not known of the station itself.
    lasting: Lasting,
    turn: f64,
    n: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn Fft<f64>>,
    held: Mended,
    /// Samples of a window.
    length: usize,
    /// Number of the next window's middle.
    minute: u64,
    /// Index up to which clipped instants are counted.
    counted_to: u64,
    heard: Heard,
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
    let length = (2.0 * HALF_WINDOW_S * rate_hz) as usize;
    let n = (2 * length).next_power_of_two();
    let mut listener = Listener {
        ranger: Ranger::new(table, rate_hz, lasting, config.doubts.table_depth_m.into()),
        rate_hz,
        full_scale: config.full_scale,
        lasting,
        turn: obs.orientation_of_north_deg.to_radians() + away,
        n,
        forward: f64::real_to_complex(n),
        inverse: f64::complex_inverse(n),
        held: Mended::new(),
        length,
        minute: 1,
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
    Ok(Heard { spikes: listener.held.spikes, ..listener.heard })
}

impl Listener<'_> {
    /// Index at which the next window begins; below 0 before the recording.
    fn from(&self) -> f64 {
        ((60.0 * self.minute as f64 - HALF_WINDOW_S) * self.rate_hz).round()
    }

    /// Listens to every window that is held; `ended`: nothing follows what is held.
    fn listen(&mut self, ended: bool) {
        loop {
            // What began after the window's beginning was lost, or never was.
            while self.from() < self.held.first() as f64 {
                self.minute += 1;
            }
            let from = self.from() as u64;
            let at = (from - self.held.first()) as usize;
            let Some(window) = self.held.settled(ended).get(at..at + self.length) else { break };
            let clipped = clipped(window, self.full_scale);
            let counted = (self.counted_to.saturating_sub(from) as usize).min(clipped.len());
            let new = clipped[counted..].iter().filter(|bits| **bits & USED != 0).count();
            let call = self.window(window, &clipped, 60.0 * self.minute as f64);
            self.heard.clipped += new as u64;
            self.counted_to = from + self.length as u64;
            self.heard.calls.extend(call);
            self.minute += 1;
        }
        self.held.drop_before(self.from() as u64);
    }

    /// A channel cut to the band, as an analytic signal; `None` where a code is missing.
    fn analytic(&self, window: &[Frame], channel: usize) -> Option<Vec<Complex<f64>>> {
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
        let (lo, hi) = BAND_HZ;
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

    fn window(&self, window: &[Frame], clipped: &[u8], t_s: f64) -> Option<WhaleCall> {
        let pressure = self.analytic(window, 0)?;
        let notes = self.notes(&pressure);
        if notes.len() < LEAST_NOTES {
            return None;
        }
        let interval_s = self.interval(&notes);
        let horizontals = self.analytic(window, 1).zip(self.analytic(window, 2));
        let own = horizontals.and_then(|(north, east)| {
            let field = Field { pressure: &pressure, north: &north, east: &east, rate_hz: self.rate_hz };
            let (azimuth, sd) = field.azimuth(&notes, |at| self.is_whole(at, clipped))?;
            Some((wrap_tau(azimuth + self.turn), sd))
        });
        let shared_azimuth = own.map_or(0.0, |(azimuth, _)| self.lasting.of_direction(azimuth).sqrt());
        let azimuth = own.map(|(azimuth, sd)| (azimuth, sd.hypot(shared_azimuth)));
        let range = self.ranger.range(&pressure, &notes, interval_s);
        Some(WhaleCall { t_s, notes: notes.len(), interval_s, azimuth, shared_azimuth, range })
    }

    /// Samples at which notes peak, in order.
    fn notes(&self, pressure: &[Complex<f64>]) -> Vec<usize> {
        let half = (SMOOTH_S * self.rate_hz) as usize;
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(pressure.iter().scan(0.0, |sum, p| {
                *sum += p.norm_sqr();
                Some(*sum)
            }))
            .collect();
        let n = pressure.len();
        let power: Vec<f64> = (0..n)
            .map(|i| {
                let (a, b) = (i.saturating_sub(half), (i + half + 1).min(n));
                (sums[b] - sums[a]) / (b - a) as f64
            })
            .collect();
        let Some(median) = quantile::median(&mut power.clone()) else { return Vec::new() };
        let mut order: Vec<usize> = (0..n).filter(|i| power[*i] > STANDS_OUT * median).collect();
        order.sort_by(|a, b| power[*b].total_cmp(&power[*a]));
        let apart = (APART_S * self.rate_hz) as usize;
        let mut out: Vec<usize> = Vec::new();
        for i in order {
            if out.iter().all(|o| o.abs_diff(i) > apart) {
                out.push(i);
            }
        }
        out.sort_unstable();
        // An earthquake or a T phase stands out as well, but not as notes do: they are short and alike.
        let strongest = out.iter().map(|i| power[*i]).fold(0.0, f64::max);
        out.retain(|i| power[*i] > 0.1 * strongest);
        let long = power.iter().filter(|p| **p > 0.25 * strongest).count() as f64 / self.rate_hz;
        if long > 8.0 * out.len() as f64 { Vec::new() } else { out }
    }

    /// The interval of notes that come steadily.
    fn interval(&self, notes: &[usize]) -> Option<f64> {
        let mut steps: Vec<f64> = notes.windows(2).map(|w| (w[1] - w[0]) as f64 / self.rate_hz).collect();
        let middle = quantile::median(&mut steps)?;
        // A note may be missing between two; most steps must agree.
        let near: Vec<f64> = steps.iter().copied().filter(|s| (s - middle).abs() < 0.15).collect();
        (2 * near.len() > steps.len()).then(|| near.iter().sum::<f64>() / near.len() as f64)
    }

    /// Whether the horizontal components have the whole of a note: what is cut off one of them turns its direction. Pressure cut off makes
    /// both intensities less by the same part.
    fn is_whole(&self, note: usize, clipped: &[u8]) -> bool {
        let half = (OWN_S * self.rate_hz) as usize;
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
        let config = StationConfig { doubts, ..station::config(&scenario, false).unwrap() };
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
