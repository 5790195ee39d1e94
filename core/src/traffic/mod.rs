//! Several vessels at once: bearings become tracks, one for each of up to eight vessels.
//!
//! In: [`Bearing`]s (whole band and sub-bands, several of one index). Out: [`Message::Track`], running every few
//! seconds and once, with stage 1, at the end of each passage. Chain: bearings of one index are judged together
//! (`assign`: gates, crossings); those that fit a track feed its passage (`track`) and its manoeuvre test
//! (`manoeuvre`); the rest may be a new vessel (`candidate`).
//!
//! * Birth: 8 agreeing bearings no more than 9 s apart. Death: [`Config::silence_s`] without a bearing.
//! * Crossing: within [`Config::merge_rad`] (and the doubt of both predictions) neither track is moved.
//! * Manoeuvre: the old track ends with the bearings before it; a new one, with its own number, starts with those after.
//!
//! Assumes straight tracks between manoeuvres and bearings whose variance is as reported plus the configured coloured
//! error. Cost and memory: `docs/budget.txt`.

mod assign;
mod candidate;
mod duty;
mod heard;
mod manoeuvre;
mod track;

use crate::config::StationConfig;
use crate::math::f64 as m;
use crate::passage::{self, MeasuredSpeed, Measurement, report};
use crate::wire::{Bearing, Message};
use assign::{Rules, Verdict};
use candidate::Candidate;
use duty::Duty;
use heard::Heard;
use track::{Track, distance_known};

/// Vessels tracked at once.
pub const VESSELS: usize = 8;
/// Vessels not yet believed in, at once.
const CANDIDATES: usize = 6;
/// Bearings of one index that are used (whole band and sub-bands).
const GROUP: usize = 8;

/// What the tracker assumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// The motion fit's own settings.
    pub motion: passage::Config,
    /// Height of the vessels above the array, metres, for the way their sound takes.
    pub height_m: f64,
    /// Depth assumed of vessels where none was measured, metres, and one over the array's own; 0 without an image in the surface.
    pub vessel_depth_m: f32,
    /// See `vessel_depth_m`.
    pub per_depth: f32,
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
    /// Or half of them, over so many seconds: of a source that is looked at less often.
    pub report_after_s: f64,
}

impl Config {
    /// From a validated station configuration.
    pub fn new(station: &StationConfig) -> Self {
        let height_m = passage::height_m(station);
        let vessel_depth_m = passage::vessel_depth_m(station);
        let imaged = station.depth_m > vessel_depth_m && vessel_depth_m > 0.0;
        let per_depth = if imaged { (1.0 / station.depth_m) as f32 } else { 0.0 };
        let vessel_depth_m = vessel_depth_m as f32;
        Self {
            height_m,
            vessel_depth_m,
            per_depth,
            ..Self::with(passage::Config::of_station(station), station.rate_hz)
        }
    }

    /// From the motion fit's settings and the sample rate, everything else as usual.
    pub fn with(motion: passage::Config, rate_hz: f64) -> Self {
        Self {
            motion,
            height_m: motion.medium.height_m,
            vessel_depth_m: 0.0,
            per_depth: 0.0,
            rate_hz,
            gate_sd: 4.5,
            merge_rad: 3.0 * crate::angle::RAD_PER_DEG,
            silence_s: 45.0,
            crossing_s: 90.0,
            report_s: 5.0,
            report_after: 20,
            report_after_s: 10.0,
        }
    }

    fn seconds(&self, index: u64) -> f64 {
        index as f64 / self.rate_hz
    }

    fn index(&self, t_s: f64) -> u64 {
        m::round(t_s * self.rate_hz) as u64
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
    /// Place whose fit was worked on last.
    served: u8,
    /// The newest bearing of the whole band, and its time.
    loudest: Option<(f64, Heard)>,
    /// Azimuth and depth of the strongest source, where its bearings are told by a measured depth.
    depth: Option<(f32, f32)>,
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
            served: 0,
            loudest: None,
            depth: None,
        }
    }

    fn live(&self) -> impl Iterator<Item = &Track> {
        self.tracks.iter().filter(|t| t.is_live())
    }

    /// Forgets everything, in place.
    pub fn forget(&mut self) {
        self.tracks.iter_mut().for_each(|track| *track = Track::new());
        self.candidates.iter_mut().for_each(|candidate| *candidate = Candidate::new());
        (self.gathered, self.index, self.issued, self.served) = (0, 0, 0, 0);
        (self.loudest, self.depth) = (None, None);
    }

    /// Vessels tracked now.
    pub fn vessels(&self) -> usize {
        self.live().count()
    }

    /// The number of the only vessel there is; `None` without one and with several.
    pub fn only_vessel(&self) -> Option<u16> {
        let mut live = self.live();
        live.next().filter(|_| live.next().is_none()).map(|t| t.id)
    }

    /// Azimuth (radians), distance along the sound's way and its standard deviation (metres) of each vessel whose track knows
    /// the distance well; helps the bearing estimator.
    pub fn places(&self) -> impl Iterator<Item = (f32, f32, f32)> + '_ {
        self.live().filter_map(|t| t.place)
    }

    /// Azimuth (radians) and depth (metres) of the strongest source, where its elevations were told by a measured depth and
    /// not by the one assumed of vessels.
    pub fn set_depth(&mut self, depth: Option<(f32, f32)>) {
        self.depth = depth;
    }

    /// The number of the track nearest to what it would predict for this bearing, judged as a bearing on its own; for
    /// displays, not for the fit.
    pub fn nearest(&self, config: &Config, bearing: &Bearing) -> Option<u16> {
        let t_s = config.seconds(bearing.index);
        let distance = |t: &Track| {
            let p = t.passage.predict(&t.motion(config), t_s)?;
            let d = crate::angle::wrap_pi(f64::from(bearing.azimuth) - p.azimuth);
            let square = d * d / (p.variance() + f64::from(bearing.var_azimuth));
            (square < config.gate_sd * config.gate_sd).then_some(square)
        };
        let gated = self.live().filter_map(|t| distance(t).map(|d| (d, t.id)));
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
    let heard = Heard::of(config, state.depth, bearing);
    if heard.is_echo(config, bearing, state.loudest.as_ref()) {
        return;
    }
    if bearing.band == 0 {
        state.loudest = Some((config.seconds(bearing.index), heard));
    }
    if let Some(slot) = state.group.get_mut(state.gathered) {
        *slot = heard;
        state.gathered += 1;
    }
}

/// The recording has reached sample `index`: what was gathered is judged, passages that have fallen silent are ended, and
/// one piece of the fits due is done. To be called at every multiple of a fixed number of samples, whatever the blocks,
/// for equal records.
pub fn advance(config: &Config, state: &mut State, index: u64, sink: &mut dyn FnMut(Message)) {
    if index <= state.index {
        return;
    }
    let searched = judge(config, state, sink);
    let t_s = config.seconds(index);
    for track in state.tracks.iter_mut().filter(|t| t.is_live()) {
        let silent = t_s - track.heard_s > config.silence_s;
        let lost = t_s - track.updated_s > config.silence_s + config.crossing_s;
        if silent || lost {
            track.duty = Duty::over();
        }
    }
    if !searched {
        duty::one_piece(config, state, sink);
    }
}

/// Samples are missing: what was gathered before them is judged. Passages go on; those silent for too long end with the
/// next [`advance`].
pub fn gap(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) {
    judge(config, state, sink);
}

/// Sample indices start anew: every passage ends, its last solution being sent piece by piece with the next calls of
/// [`advance`], and what was not yet believed in is forgotten. Bearings of any index are taken from now on.
pub fn restart(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) {
    judge(config, state, sink);
    for track in state.tracks.iter_mut().filter(|t| t.is_live()) {
        track.duty = Duty::over();
    }
    state.candidates = [const { Candidate::new() }; CANDIDATES];
    state.index = 0;
    state.loudest = None;
}

/// The recording is over: every passage ends now.
pub fn finish(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) {
    restart(config, state, sink);
    while duty::one_piece(config, state, sink) {}
}

/// Joins a measurement of a vessel's speed (its shaft rate's, say; mean and standard deviation, m/s) to the configured
/// prior, from its next bearing on and for as long as it is tracked, also past a manoeuvre. The newest measurement takes
/// the place of the one before, whose errors it usually shares. False if nothing was changed: no vessel has this number
/// now, or the speed is none (0.2 to 40 m/s, a positive spread). A configured speed without spread stays as it is.
pub fn set_speed(state: &mut State, id: u16, mean_m_s: f32, sd_m_s: f32) -> bool {
    let Some(speed) = MeasuredSpeed::new(mean_m_s, sd_m_s) else { return false };
    let Some(track) = state.tracks.iter_mut().find(|t| t.id == id && t.is_live()) else { return false };
    track.speed = Some(speed);
    true
}

/// Judges the bearings gathered for one index. True if a young passage was searched afresh for one, which costs as much
/// as a piece of a fit and happens once a call.
fn judge(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) -> bool {
    let gathered = core::mem::take(&mut state.gathered);
    if gathered == 0 {
        return false;
    }
    let group = state.group;
    let group = group.get(..gathered).unwrap_or(&[]);
    let t_s = config.seconds(state.index);
    let mut predictions = [None; VESSELS];
    let mut heard_s = [(0.0, 0.0); VESSELS];
    let mut impatient = 0u8;
    let places = predictions.iter_mut().zip(&mut heard_s).zip(&state.tracks);
    for (i, ((slot, heard_s), track)) in places.enumerate() {
        if track.is_live() {
            *slot = track.passage.predict(&track.motion(config), t_s);
            *heard_s = track.passage.times_s();
            let waiting_s = track.crossing_since_s.map_or(0.0, |since| t_s - since);
            impatient |= u8::from(waiting_s > config.crossing_s) << i;
        }
    }
    let rules = Rules { gate_sd: config.gate_sd, merge_rad: config.merge_rad, least_variance: 3e-8 };
    let verdicts = assign::assign(&rules, &predictions, &heard_s, group, impatient);
    let mut searched = false;
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
                reconsider(config, state, t_s, heard, &mut searched);
            }
            Verdict::Free => {
                if !reconsider(config, state, t_s, heard, &mut searched) {
                    court(config, state, t_s, heard);
                }
            }
        }
    }
    searched
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
    track.passage.push(&motion, &heard.measured(t_s));
    (track.updated_s, track.heard_s) = (t_s, t_s);
    track.crossing_since_s = None;
    let turned = track.manoeuvre.test(&motion, &track.passage, t_s, heard.azimuth, heard.variance);
    if let Some(onset_s) = turned
        && matches!(track.duty, Duty::Live | Duty::Polished)
    {
        track.duty = Duty::suspected(onset_s, manoeuvre::LEAST_GAIN);
    }
    if t_s >= track.next_report_s && track.is_telling(config) {
        track.next_report_s = t_s + config.report_s;
        if let Some(solution) = track.passage.solution(&motion) {
            track.reported = true;
            track.relative_sd = distance_known(config, &solution);
            let solution = track.judged(config, solution, state.index, sink);
            sink(Message::Track(report::track(&solution, track.id, 0, state.index)));
        }
    }
    track.stand(config, t_s, heard.azimuth);
}

/// Offers a bearing that no track explains to the young ones without one at this instant; true if one has taken it.
fn reconsider(config: &Config, state: &mut State, t_s: f64, heard: &Heard, searched: &mut bool) -> bool {
    for track in state.tracks.iter_mut().filter(|t| t.is_live() && t.updated_s < t_s) {
        if *searched {
            return false;
        }
        let motion = track.motion(config);
        let taken = track.passage.reconsider(&motion, &heard.measured(t_s));
        *searched |= taken.is_some();
        if taken == Some(true) {
            (track.updated_s, track.heard_s) = (t_s, t_s);
            return true;
        }
    }
    false
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
    let Some(track) = state.tracks.iter_mut().find(|t| t.duty == Duty::Free) else { return };
    state.issued = state.issued.wrapping_add(1).max(1);
    *track = Track { id: state.issued, duty: Duty::Live, updated_s: t_s, heard_s: t_s, ..Track::new() };
    for (t_s, azimuth, variance) in candidate.bearings() {
        track.passage.push(&config.motion, &Measurement::azimuth(t_s, azimuth, variance));
    }
    *candidate = Candidate::new();
}

#[cfg(test)]
mod manoeuvre_tests;
#[cfg(test)]
mod tests;
