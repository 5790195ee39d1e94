//! Several vessels at once: bearings become tracks, one for each of up to eight vessels.
//!
//! In: [`Bearing`]s (whole band and sub-bands, several of one index). Out: [`Message::Track`], running every few
//! seconds and once, with stage 1, at the end of each passage. Chain: bearings of one index are judged together
//! (`assign`: gates, crossings); those that fit a track feed its fit (`fit`) and its manoeuvre test
//! (`manoeuvre`); the rest may be a new vessel (`candidate`).
//!
//! * Birth: 8 agreeing bearings no more than 9 s apart. Death: [`Config::silence_s`] without a bearing.
//! * Crossing: within [`Config::merge_rad`] (and the doubt of both predictions) neither track is moved.
//! * Manoeuvre: the old track ends with the bearings before it; a new one, with its own number, starts with those after.
//!
//! Assumes straight tracks between manoeuvres and bearings whose variance is as reported plus the configured coloured
//! error. Cost on the Cortex-M7: about 10⁴ instructions a bearing and known vessel, 3·10⁵ every 2 s and vessel for its
//! fit, some 10⁷ at the end of a passage. Memory: [`State`] below 22 KiB, stack below 8 KiB.

mod assign;
mod candidate;
mod fit;
mod known;
mod manoeuvre;

use crate::config::StationConfig;
use crate::math::f64 as m;
use crate::motion::settings::MeasuredSpeed;
use crate::motion::{Solution, recursive, report};
use crate::wire::{Bearing, Message};
use assign::{Rules, Verdict};
use candidate::Candidate;
use fit::Fit;
use manoeuvre::Manoeuvre;

/// Vessels tracked at once.
pub const VESSELS: usize = 8;
/// Vessels not yet believed in, at once.
const CANDIDATES: usize = 6;
/// Bearings of one index that are used (whole band and sub-bands).
const GROUP: usize = 8;

/// Elevations used, radians (−30 to 80°). Low ones are not cut off: where noise decides which of them are kept, their mean
/// is too high. Further up the array's own tilt decides.
const ELEVATIONS_RAD: (f32, f32) = (-0.52, 1.4);
/// Standard deviation of an elevation beyond what is reported, radians (1°): multipath that changes as the vessel moves.
const ELEVATION_SD_RAD: f32 = 0.017_453;

/// What the tracker assumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// The motion fit's own settings.
    pub motion: recursive::Config,
    /// Samples a second.
    pub rate_hz: f64,
    /// Half-width of a track's gate, standard deviations.
    pub gate_sd: f64,
    /// Vessels closer than this in azimuth give one bearing for both, radians.
    pub merge_rad: f64,
    /// Silence after which a passage is over, seconds.
    pub silence_s: f64,
    /// Longest time a track waits for a crossing to resolve, seconds.
    pub crossing_s: f64,
    /// Time between running reports of a track, seconds.
    pub report_s: f64,
    /// Bearings before a track is reported.
    pub report_after: u32,
}

impl Config {
    /// From a validated station configuration.
    pub fn new(station: &StationConfig) -> Self {
        Self::with(recursive::Config::of_station(station), station.rate_hz)
    }

    /// From the motion fit's settings and the sample rate, everything else as usual.
    pub fn with(motion: recursive::Config, rate_hz: f64) -> Self {
        Self {
            motion,
            rate_hz,
            gate_sd: 4.5,
            merge_rad: 3.0 * crate::angle::RAD_PER_DEG,
            silence_s: 45.0,
            crossing_s: 90.0,
            report_s: 5.0,
            report_after: 20,
        }
    }

    fn seconds(&self, index: u64) -> f64 {
        index as f64 / self.rate_hz
    }
}

/// A bearing without what association does not need.
#[derive(Clone, Copy, Debug)]
struct Heard {
    azimuth: f64,
    variance: f64,
    /// Elevation and its variance, radians and rad²; infinite where there is none.
    elevation: (f32, f32),
}

impl Heard {
    const NO_ELEVATION: (f32, f32) = (0.0, f32::INFINITY);

    /// An azimuth alone.
    const fn azimuth(azimuth: f64, variance: f64) -> Self {
        Self { azimuth, variance, elevation: Self::NO_ELEVATION }
    }

    /// A bearing; its elevation where the vessel's height above the array is known and it can tell range.
    fn of(config: &Config, bearing: &Bearing) -> Self {
        let (azimuth, variance) = (f64::from(bearing.azimuth), f64::from(bearing.var_azimuth));
        let (least, most) = ELEVATIONS_RAD;
        let usable = config.motion.medium.height_m > 0.0
            && (least..=most).contains(&bearing.elevation)
            && bearing.var_elevation >= 0.0
            && bearing.var_elevation.is_finite();
        if !usable {
            return Self::azimuth(azimuth, variance);
        }
        let own = bearing.var_elevation + ELEVATION_SD_RAD * ELEVATION_SD_RAD;
        Self { azimuth, variance, elevation: (bearing.elevation, own) }
    }
}

/// One vessel; number 0 is a free place.
#[derive(Clone, Debug)]
struct Track {
    id: u16,
    fit: Fit,
    manoeuvre: Manoeuvre,
    /// Index of its newest bearing.
    index: u64,
    updated_s: f64,
    /// Newest bearing that may have been its own.
    heard_s: f64,
    /// Start of the crossing it is in.
    crossing_since_s: Option<f64>,
    next_report_s: f64,
    range_m: Option<f32>,
    speed: Option<MeasuredSpeed>,
}

impl Track {
    const fn new() -> Self {
        Self {
            id: 0,
            fit: Fit::new(),
            manoeuvre: Manoeuvre::new(),
            index: 0,
            updated_s: 0.0,
            heard_s: 0.0,
            crossing_since_s: None,
            next_report_s: 0.0,
            range_m: None,
            speed: None,
        }
    }

    /// What its fit assumes: the configured settings with what was measured of this vessel.
    fn motion(&self, config: &Config) -> recursive::Config {
        config.motion.with_speed(self.speed)
    }
}

/// All vessels, and the bearings of the index now being gathered.
#[derive(Clone, Debug)]
pub struct State {
    tracks: [Track; VESSELS],
    candidates: [Candidate; CANDIDATES],
    group: [Heard; GROUP],
    gathered: usize,
    index: u64,
    issued: u16,
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}

impl State {
    /// No vessel yet.
    pub const fn new() -> Self {
        Self {
            tracks: [const { Track::new() }; VESSELS],
            candidates: [const { Candidate::new() }; CANDIDATES],
            group: [Heard { azimuth: 0.0, variance: 0.0, elevation: (0.0, 0.0) }; GROUP],
            gathered: 0,
            index: 0,
            issued: 0,
        }
    }

    /// Vessels tracked now.
    pub fn vessels(&self) -> usize {
        self.tracks.iter().filter(|t| t.id != 0).count()
    }

    /// The number of the only vessel there is; `None` without one and with several.
    pub fn only_vessel(&self) -> Option<u16> {
        let mut live = self.tracks.iter().filter(|t| t.id != 0);
        live.next().filter(|_| live.next().is_none()).map(|t| t.id)
    }

    /// Range of the vessel heard last, metres, where its track knows it well; helps the bearing estimator.
    pub fn range_m(&self) -> Option<f32> {
        let known = self.tracks.iter().filter(|t| t.id != 0);
        known.max_by_key(|t| (t.index, t.fit.seen())).and_then(|t| t.range_m)
    }

    /// The number of the track nearest to what it would predict for this bearing, judged as a bearing on its own; for
    /// displays, not for the fit.
    pub fn nearest(&self, config: &Config, bearing: &Bearing) -> Option<u16> {
        let t_s = config.seconds(bearing.index);
        let distance = |t: &Track| {
            let p = t.fit.predict(&t.motion(config), t_s)?;
            let d = crate::angle::wrap_pi(f64::from(bearing.azimuth) - p.azimuth);
            let square = d * d / (p.variance() + f64::from(bearing.var_azimuth));
            (square < config.gate_sd * config.gate_sd).then_some(square)
        };
        let live = self.tracks.iter().filter(|t| t.id != 0);
        let gated = live.filter_map(|t| distance(t).map(|d| (d, t.id)));
        gated.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, id)| id)
    }
}

/// Takes a bearing; those of one index are judged together once a later one, [`advance`] or [`finish`] arrives. Bearings
/// that are not finite, have no variance or come from before the newest index are ignored.
pub fn bearing(config: &Config, state: &mut State, bearing: &Bearing, sink: &mut dyn FnMut(Message)) {
    let (azimuth, variance) = (f64::from(bearing.azimuth), f64::from(bearing.var_azimuth));
    if !azimuth.is_finite() || !variance.is_finite() || variance < 0.0 || bearing.index < state.index {
        return;
    }
    if bearing.index > state.index {
        judge(config, state, sink);
        state.index = bearing.index;
    }
    if let Some(slot) = state.group.get_mut(state.gathered) {
        *slot = Heard::of(config, bearing);
        state.gathered += 1;
    }
}

/// The recording has reached sample `index`: what was gathered is judged, and passages that have fallen silent end.
pub fn advance(config: &Config, state: &mut State, index: u64, sink: &mut dyn FnMut(Message)) {
    if index > state.index {
        judge(config, state, sink);
        let t_s = config.seconds(index);
        for track in state.tracks.iter_mut().filter(|t| t.id != 0) {
            let silent = t_s - track.heard_s > config.silence_s;
            let lost = t_s - track.updated_s > config.silence_s + config.crossing_s;
            if silent || lost {
                end(config, track, sink);
            }
        }
    }
}

/// The recording is over: every passage ends.
pub fn finish(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) {
    judge(config, state, sink);
    for track in state.tracks.iter_mut().filter(|t| t.id != 0) {
        end(config, track, sink);
    }
    state.candidates = [const { Candidate::new() }; CANDIDATES];
}

/// Reports the end-of-passage solution of a track worth reporting and frees its place.
fn end(config: &Config, track: &mut Track, sink: &mut dyn FnMut(Message)) {
    if track.fit.seen() >= config.report_after
        && let Some(solution) = track.fit.finish(&track.motion(config))
    {
        sink(Message::Track(report::track(&solution, track.id, 1, track.index)));
    }
    *track = Track::new();
}

/// Joins a measurement of a vessel's speed (its shaft rate's, say; mean and standard deviation, m/s) to the configured
/// prior, from its next bearing on and for as long as it is tracked, also past a manoeuvre. The newest measurement takes
/// the place of the one before, whose errors it usually shares. False if nothing was changed: no vessel has this number
/// now, or the speed is none (0.2 to 40 m/s, a positive spread). A configured speed without spread stays as it is.
pub fn set_speed(state: &mut State, id: u16, mean_m_s: f32, sd_m_s: f32) -> bool {
    let Some(speed) = MeasuredSpeed::new(mean_m_s, sd_m_s) else { return false };
    let Some(track) = state.tracks.iter_mut().find(|t| t.id == id && id != 0) else { return false };
    track.speed = Some(speed);
    true
}

/// Judges the bearings gathered for one index.
fn judge(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) {
    let gathered = core::mem::take(&mut state.gathered);
    if gathered == 0 {
        return;
    }
    let group = state.group;
    let group = group.get(..gathered).unwrap_or(&[]);
    let t_s = config.seconds(state.index);
    let mut predictions = [None; VESSELS];
    let mut impatient = 0u8;
    for (i, (slot, track)) in predictions.iter_mut().zip(&state.tracks).enumerate() {
        if track.id != 0 {
            *slot = track.fit.predict(&track.motion(config), t_s);
            let waiting_s = track.crossing_since_s.map_or(0.0, |since| t_s - since);
            impatient |= u8::from(waiting_s > config.crossing_s) << i;
        }
    }
    let rules = Rules { gate_sd: config.gate_sd, merge_rad: config.merge_rad, least_variance: 3e-8 };
    let verdicts = assign::assign(&rules, &predictions, group, impatient);
    for (verdict, heard) in verdicts.iter().zip(group) {
        match *verdict {
            Verdict::Track(i) => serve(config, state, i, t_s, heard, sink),
            Verdict::Deferred(mask) => {
                for (i, track) in state.tracks.iter_mut().enumerate() {
                    if mask >> i & 1 == 1 {
                        track.heard_s = t_s;
                        track.crossing_since_s.get_or_insert(t_s);
                    }
                }
            }
            Verdict::Spare => {
                reconsider(config, state, t_s, heard);
            }
            Verdict::Free => {
                if !reconsider(config, state, t_s, heard) {
                    court(config, state, t_s, heard);
                }
            }
        }
    }
}

/// Gives a bearing to the track in place `i`, tests for a manoeuvre, reports.
fn serve(
    config: &Config,
    state: &mut State,
    i: usize,
    t_s: f64,
    heard: &Heard,
    sink: &mut dyn FnMut(Message),
) {
    let Some(track) = state.tracks.get_mut(i) else { return };
    let motion = track.motion(config);
    track.fit.push(&motion, t_s, heard);
    (track.index, track.updated_s, track.heard_s) = (state.index, t_s, t_s);
    track.crossing_since_s = None;
    let turned = track.manoeuvre.test(&motion, &track.fit, t_s, heard.azimuth, heard.variance);
    if let Some(onset_s) = turned {
        let newer = track.fit.split(&motion, onset_s);
        let (index, updated_s, speed) = (track.index, track.updated_s, track.speed);
        end(config, track, sink);
        state.issued = state.issued.wrapping_add(1).max(1);
        *track = Track {
            id: state.issued,
            fit: newer,
            index,
            updated_s,
            heard_s: updated_s,
            next_report_s: t_s,
            speed,
            ..Track::new()
        };
    }
    if t_s >= track.next_report_s && track.fit.seen() >= config.report_after {
        track.next_report_s = t_s + config.report_s;
        if let Some(solution) = track.fit.solution(&motion) {
            track.range_m = near_range(&solution);
            sink(Message::Track(report::track(&solution, track.id, 0, track.index)));
        }
    }
}

/// Offers a bearing that no track explains to the young ones without one at this instant; true if one has taken it.
fn reconsider(config: &Config, state: &mut State, t_s: f64, heard: &Heard) -> bool {
    let index = state.index;
    state.tracks.iter_mut().filter(|t| t.id != 0 && t.updated_s < t_s).any(|track| {
        let motion = track.motion(config);
        let taken = track.fit.reconsider(&motion, t_s, heard);
        if taken {
            (track.index, track.updated_s, track.heard_s) = (index, t_s, t_s);
        }
        taken
    })
}

/// Lets a free bearing join the candidate that expects it most, or begin one; a candidate grown up becomes a track.
fn court(config: &Config, state: &mut State, t_s: f64, heard: &Heard) {
    let mut best: Option<(f64, usize)> = None;
    for (i, candidate) in state.candidates.iter().enumerate() {
        if let Some(distance) = candidate.distance(t_s, heard)
            && best.is_none_or(|(least, _)| distance < least)
        {
            best = Some((distance, i));
        }
    }
    let Some((_, i)) = best else {
        let oldest = state
            .candidates
            .iter_mut()
            .min_by(|a, b| (!a.is_idle(t_s)).cmp(&!b.is_idle(t_s)).then(a.last_s().total_cmp(&b.last_s())));
        if let Some(candidate) = oldest {
            candidate.begin(t_s, heard);
        }
        return;
    };
    let Some(candidate) = state.candidates.get_mut(i) else { return };
    if !candidate.join(t_s, heard) {
        return;
    }
    let Some(track) = state.tracks.iter_mut().find(|t| t.id == 0) else { return };
    state.issued = state.issued.wrapping_add(1).max(1);
    *track = Track { id: state.issued, index: state.index, updated_s: t_s, heard_s: t_s, ..Track::new() };
    for (t_s, azimuth, variance) in candidate.bearings() {
        track.fit.push(&config.motion, t_s, &Heard::azimuth(azimuth, variance));
    }
    *candidate = Candidate::new();
}

/// The vessel's range now, where the track knows it well enough to help the bearing estimator.
fn near_range(solution: &Solution) -> Option<f32> {
    let [x, y] = solution.position1_m;
    let known = solution.range_observable && solution.sd_cpa_range_m < 0.3 * solution.cpa_range_m;
    known.then(|| m::hypot(x, y) as f32)
}

#[cfg(test)]
mod tests;
