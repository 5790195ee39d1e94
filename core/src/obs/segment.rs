//! When a vessel is there: general presence, and within it the approaching and the leaving part.
//!
//! Enters: each minute's log presence in azimuth and range and the share of the posterior that approaches. Leaves:
//! `Segment` messages when a presence ends. In place of the paper's centred means over one or two hours, which know
//! nothing near the ends of a record, the log terms `ln(1 − Pd + Pd M)` [O 24] are summed from where they last turned
//! positive and the sum is held between 0 and a ceiling: presence begins where the sum left 0 for good and ends where
//! it last rose. The term of range comes from the posterior, whose update holds its Pd. A gap adds nothing. A change from leaving to approaching splits a segment: another vessel.

use super::presence::RangePresence;
use super::tonal::Directions;
use crate::math;
use crate::wire::{Message, Segment};

/// Probability of detection in azimuth [O, III D].
const DETECTION: f32 = 0.9;

/// One minute cannot say more than this, or a whale's e⁶⁰ would outweigh hours of silence.
const MOST: f32 = 3.0;

/// Sum at which presence is believed, and the ceiling; ten minutes of both detectors, and as much silence to end it.
const OPEN: f32 = 30.0;
const CEILING: f32 = 60.0;

/// Shortest segment reported, minutes.
const SHORTEST: u32 = 15;

/// Weight of a minute in the running balance of approaching and leaving (memory 8 minutes), and the balance believed.
const PHASE_SHARE: f32 = 0.12;
const PHASE_CLEAR: f32 = 0.4;

/// State.
#[derive(Clone, Debug)]
pub struct Segmenter {
    sum: f32,
    /// First minute since the sum was 0, last minute it rose.
    from: u32,
    to: u32,
    open: bool,
    /// Running mean of (leaving − approaching), its sign when last clear, and the change seen.
    balance: f32,
    phase: i8,
    turn: Option<u32>,
    /// Sum of all terms since `from`, and what it was at `to`.
    evidence: f32,
    evidence_to: f32,
    id: u16,
}

/// `ln(1 − Pd + Pd M)`, bounded.
fn term(pd: f32, log_presence: f32) -> f32 {
    let m = math::f32::exp(log_presence.min(20.0));
    math::f32::ln(1.0 - pd + pd * m).min(MOST)
}

impl Segmenter {
    /// Nothing yet.
    pub const fn new() -> Self {
        Self {
            sum: 0.0,
            from: 0,
            to: 0,
            open: false,
            balance: 0.0,
            phase: 0,
            turn: None,
            evidence: 0.0,
            evidence_to: 0.0,
            id: 0,
        }
    }

    /// Takes a minute; `index_of` gives the sample index of a minute.
    pub fn minute(
        &mut self,
        now: u32,
        directions: &Directions,
        ranges: &RangePresence,
        index_of: impl Fn(u32) -> u64,
        sink: &mut dyn FnMut(Message),
    ) {
        let tonal = directions.modes.iter().flatten().filter(|m| !m.impulsive).map(|m| m.log_presence);
        let azimuth = tonal.fold(directions.log_below, f32::max);
        let gain = term(DETECTION, azimuth) + ranges.log_evidence.min(MOST);
        if self.sum <= 0.0 {
            self.begin(now);
        }
        self.sum = (self.sum + gain).clamp(0.0, CEILING);
        self.evidence += gain;
        if gain > 0.0 {
            self.to = now;
            self.evidence_to = self.evidence;
        }
        if self.sum <= 0.0 {
            self.close(&index_of, sink);
            return;
        }
        self.open |= self.sum >= OPEN;
        if ranges.log_odds > 0.0 {
            let lean = 1.0 - 2.0 * ranges.approaching;
            self.balance += PHASE_SHARE * (lean - self.balance);
            let phase = match self.balance {
                b if b > PHASE_CLEAR => 1,
                b if b < -PHASE_CLEAR => -1,
                _ => self.phase,
            };
            match (self.phase, phase) {
                (-1, 1) => self.turn = Some(now),
                (1, -1) if self.open => {
                    self.to = now;
                    self.evidence_to = self.evidence;
                    self.close(&index_of, sink);
                    self.begin(now);
                    self.sum = OPEN;
                    self.open = true;
                }
                _ => {}
            }
            self.phase = phase;
        }
    }

    fn begin(&mut self, now: u32) {
        self.from = now;
        self.to = now;
        self.open = false;
        self.turn = None;
        self.evidence = 0.0;
        self.evidence_to = 0.0;
        self.phase = 0;
        self.balance = 0.0;
    }

    /// Reports the presence that just ended, if it was one.
    pub fn close(&mut self, index_of: &impl Fn(u32) -> u64, sink: &mut dyn FnMut(Message)) {
        let length = self.to.saturating_sub(self.from);
        if self.open && length >= SHORTEST {
            let turn = self.turn.filter(|t| *t < self.to && *t > self.from);
            let mut send = |kind, from: u32, to: u32, turn: Option<u32>| {
                sink(Message::Segment(Segment {
                    id: self.id,
                    start: index_of(from),
                    end: index_of(to),
                    turn: turn.map(&index_of),
                    kind,
                    log_evidence: self.evidence_to / (length + 1) as f32,
                }));
            };
            send(0, self.from, self.to, turn);
            match (turn, self.phase) {
                (Some(t), _) => {
                    send(1, self.from, t, None);
                    send(2, t, self.to, None);
                }
                (None, -1) => send(1, self.from, self.to, None),
                (None, 1) => send(2, self.from, self.to, None),
                _ => {}
            }
            self.id = self.id.wrapping_add(1);
        }
        self.open = false;
        self.sum = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obs::limits::{AZIMUTH_MODES, RANGE_MODES};
    use crate::obs::tonal::Mode;
    use std::vec::Vec;

    /// A minute with one tonal direction (a mode, or below the threshold of one) and that evidence of range.
    fn minute(mode: Option<f32>, log_below: f32, log_evidence: f32) -> (Directions, RangePresence) {
        let mut modes = [None; AZIMUTH_MODES];
        modes[0] = mode.map(|log_presence| Mode {
            azimuth: 1.0,
            sd: 0.02,
            log_presence,
            bins: 3,
            step: 40,
            impulsive: false,
            moved: None,
        });
        let log_presence = mode.unwrap_or(log_below);
        let directions = Directions { modes, log_presence, log_below, frames: 17 };
        let range =
            RangePresence { log_odds: -1.0, log_evidence, approaching: 0.5, modes: [None; RANGE_MODES] };
        (directions, range)
    }

    /// The general segments of a record of such minutes.
    fn segments(minutes: &[(Directions, RangePresence)]) -> Vec<Segment> {
        let (mut segmenter, mut said) = (Segmenter::new(), Vec::new());
        let mut sink = |m: Message| {
            if let Message::Segment(s) = m
                && s.kind == 0
            {
                said.push(s);
            }
        };
        for (now, (d, r)) in (0..).zip(minutes) {
            segmenter.minute(now, d, r, u64::from, &mut sink);
        }
        segmenter.close(&u64::from, &mut sink);
        said
    }

    #[test]
    fn evidence_is_that_of_the_presence_not_of_the_silence_after_it() {
        let present = [minute(Some(20.0), f32::NEG_INFINITY, 2.0); 30];
        let silent = [minute(None, -60.0, -0.9); 12];
        let s = segments(&[&present[..], &silent[..]].concat());
        assert!(s.len() == 1 && s[0].end == 29, "{s:?}");
        // Three of azimuth, which is the most, and the two of range as they are.
        assert!((s[0].log_evidence - 5.0).abs() < 1e-4, "{s:?}");
    }

    #[test]
    fn a_direction_below_the_threshold_of_a_mode_is_evidence_still() {
        // A presence ratio of e⁶: no mode, but no silence.
        let s = segments(&[minute(None, 6.0, 0.0); 30]);
        assert!(s.len() == 1 && (s[0].log_evidence - MOST).abs() < 1e-4, "{s:?}");
        assert!(segments(&[minute(None, -3.0, 0.0); 30]).is_empty());
    }
}
