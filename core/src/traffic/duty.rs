//! What is to be done for each vessel's fit, one piece a call.
//!
//! In: all tracks. Out: one piece of work done for the next track that has some, and the records it led to. A piece is a
//! step of a track's lines, a search for fresh ones, or their polish; the end of a passage takes a search and a polish, the trial of two lines a
//! polish and a few steps of both, the proof of a manoeuvre a search, a polish and the fit of both parts.

use super::{Config, State, Track, VESSELS};
use crate::motion::Solution;
use crate::passage::report;
use crate::wire::Message;

/// What a place is used for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Duty {
    /// No vessel.
    Free,
    /// A vessel.
    Live,
    /// A vessel whose lines have just been polished: two are to be tried in their place.
    Polished,
    /// A vessel that seems to have left its line at `onset_s`; pieces of the proof done so far.
    Suspected {
        /// Time of reception.
        onset_s: f64,
        /// By how much two lines have to explain the bearings better.
        gain: f64,
        /// 0 to 2.
        done: u8,
    },
    /// Its passage is over; pieces of the last solution done so far.
    Over {
        /// 0 or 1.
        done: u8,
    },
}

impl Duty {
    /// A passage that has just ended.
    pub(super) const fn over() -> Self {
        Self::Over { done: 0 }
    }

    /// A manoeuvre not yet proved.
    pub(super) const fn suspected(onset_s: f64, gain: f64) -> Self {
        Self::Suspected { onset_s, gain, done: 0 }
    }
}

/// Does one piece for the next track that has some; false if none has.
#[inline(never)]
pub(super) fn one_piece(config: &Config, state: &mut State, sink: &mut dyn FnMut(Message)) -> bool {
    for n in 1..=VESSELS {
        let place = (usize::from(state.served) + n) % VESSELS;
        let Some(track) = state.tracks.get_mut(place) else { continue };
        let worked = match track.duty {
            Duty::Free => false,
            Duty::Live => track.passage.work(&track.motion(config)) || polish(config, track),
            Duty::Polished => {
                part(config, track);
                true
            }
            Duty::Suspected { onset_s, gain, done } => {
                state.issued = prove(config, track, (onset_s, gain), done, state.issued, sink);
                true
            }
            Duty::Over { done } => conclude(config, track, done, sink),
        };
        if worked {
            state.served = place as u8;
            return true;
        }
    }
    false
}

/// Polishes a track's lines where two are to be tried in the place of one; false if that is not due.
fn polish(config: &Config, track: &mut Track) -> bool {
    let due = track.manoeuvre.is_due(&track.passage);
    if due {
        track.passage.polish(&track.motion(config));
        track.duty = Duty::Polished;
    }
    due
}

/// Tries two lines in the place of the best one.
fn part(config: &Config, track: &mut Track) {
    let left = track.manoeuvre.tried(&track.motion(config), &mut track.passage);
    track.duty = left.map_or(Duty::Live, |(onset_s, gain)| Duty::suspected(onset_s, gain));
}

/// A piece of the last solution; at the end it is reported and the place is free. False if there was nothing to do but that.
fn conclude(config: &Config, track: &mut Track, done: u8, sink: &mut dyn FnMut(Message)) -> bool {
    let motion = track.motion(config);
    let due = track.reported || track.is_telling(config);
    if due && done == 0 {
        track.passage.search(&motion);
        track.duty = Duty::Over { done: 1 };
        return true;
    }
    if due {
        track.passage.conclude(&motion);
        tell(config, track, track.passage.solution(&motion), sink);
    }
    *track = Track::new();
    due
}

/// Sends a passage's last solution, of its newest bearing; where there is none, what was known before.
fn tell(config: &Config, track: &mut Track, solution: Option<Solution>, sink: &mut dyn FnMut(Message)) {
    let motion = track.motion(config);
    let known = track.manoeuvre.reference().or(track.passage.best());
    let before = || known.and_then(|known| track.passage.solution_by(&motion, known));
    if let Some(solution) = solution.or_else(before) {
        let index = config.index(solution.t1_s);
        let solution = track.judged(config, solution, index, sink);
        sink(Message::Track(report::track(&solution, track.id, 1, index)));
    }
}

/// A piece of the proof that a vessel has left its line. Proved, the older part's passage ends with its own last bearing,
/// and a new one, with the number after `issued`, goes on with the rest. The newest number issued.
fn prove(
    config: &Config,
    track: &mut Track,
    (onset_s, gain): (f64, f64),
    done: u8,
    issued: u16,
    sink: &mut dyn FnMut(Message),
) -> u16 {
    let motion = track.motion(config);
    match done {
        0 => track.passage.search(&motion),
        1 => track.passage.polish(&motion),
        _ => {
            track.duty = Duty::Live;
            let Some(mut newer) = track.passage.split(&motion, onset_s, gain) else { return issued };
            let enough = track.is_telling(config);
            if enough || track.reported {
                let solution = track.passage.solution(&motion).filter(|_| enough);
                tell(config, track, solution, sink);
            }
            track.id = issued.wrapping_add(1).max(1);
            track.manoeuvre = track.manoeuvre.after(gain, &mut newer);
            track.passage = newer;
            (track.reported, track.crossing_since_s) = (false, None);
            (track.relative_sd, track.place) = (None, None);
            track.next_report_s = track.updated_s;
            return track.id;
        }
    };
    track.duty = Duty::Suspected { onset_s, gain, done: done + 1 };
    issued
}
