//! The compact-array recorder: blocks to bearings, bearings to a track, and health.

use super::health::{Condition, Reporter};
use super::pieces;
use crate::array;
use crate::block::Block;
use crate::config::StationConfig;
use crate::motion::{Solution, recursive, report};
use crate::run::Application;
use crate::wire::{Bearing, Command, Message};
use micromath::F32Ext;

/// Seconds of samples between running track reports.
const TRACK_EVERY_S: f64 = 5.0;
/// Seconds without an accepted bearing after which a passage is over.
const PASSAGE_OVER_S: f64 = 45.0;
/// Bearings before a track is worth reporting.
const TRACK_AFTER: u32 = 20;

/// Everything the array recorder needs, in one place; meant for a `static`.
#[derive(Debug)]
pub struct ArrayRecorder {
    plan: Option<array::Plan>,
    state: array::State,
    scratch: array::Scratch,
    passage: Passage,
    reporter: Reporter,
}

impl Default for ArrayRecorder {
    fn default() -> Self {
        Self::new()
    }
}

impl ArrayRecorder {
    /// A recorder without a configuration: it accounts for nothing and says nothing but hello.
    pub const fn new() -> Self {
        Self {
            plan: None,
            state: array::State::new(),
            scratch: array::Scratch::new(),
            passage: Passage::new(),
            reporter: Reporter::new(),
        }
    }

    /// Takes a configuration and starts afresh.
    ///
    /// # Errors
    /// What is wrong with the configuration; the recorder is left as it was.
    pub fn configure(&mut self, config: &StationConfig) -> Result<(), array::PlanError> {
        let plan = array::Plan::new(config)?;
        if self.plan.is_some() {
            self.forget();
        }
        self.plan = Some(plan);
        self.passage.configure(config);
        self.reporter.configure(config, 0);
        Ok(())
    }

    /// Back to nothing heard. Apart, because the new state passes over the stack; a recorder just started needs none.
    #[inline(never)]
    fn forget(&mut self) {
        self.state = array::State::new();
    }

    fn condition(&self) -> Condition {
        Condition {
            accounting: self.state.accounting(),
            channels: self.state.channels(),
            level_half_db: self.state.level().map(half_db),
        }
    }

    fn report_if_due(&mut self, index: u64, sink: &mut impl FnMut(&Message)) {
        let condition = self.condition();
        if let Some(message) = self.reporter.due(index, &condition) {
            sink(&message);
        }
    }
}

impl Application for ArrayRecorder {
    fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message)) {
        sink(&self.reporter.hello(reset_cause));
    }

    fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message)) {
        for (piece, boundary) in pieces(block) {
            let Self { plan: Some(plan), state, scratch, passage, reporter } = self else { return };
            array::push(plan, state, scratch, piece, &mut |message| {
                reporter.count(&message);
                sink(&message);
                if let Message::Bearing(bearing) = &message {
                    passage.bearing(bearing, sink);
                }
            });
            if let Some(index) = boundary {
                passage.advance(index, sink);
                state.set_range_m(passage.range_m);
                self.report_if_due(index, sink);
            }
        }
    }

    fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message)) {
        let condition = self.condition();
        self.reporter.command(command, self.state.next_index(), &condition, sink);
    }

    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        if let Self { plan: Some(plan), state, scratch, passage, reporter } = self {
            array::finish(plan, state, scratch, &mut |message| {
                reporter.count(&message);
                sink(&message);
                if let Message::Bearing(bearing) = &message {
                    passage.bearing(bearing, sink);
                }
            });
            passage.finish(sink);
        }
        let condition = self.condition();
        sink(&self.reporter.health(self.state.next_index(), &condition));
    }
}

/// A power ratio in half decibels, for display: micromath's logarithm errs by up to 0.5 dB, one unit of this scale.
fn half_db(ratio: f32) -> i8 {
    if ratio > 0.0 { (20.0 * F32Ext::log10(ratio)).clamp(-127.0, 0.0) as i8 } else { i8::MIN }
}

/// One vessel at a time: bearings go to one filter until it has been silent for [`PASSAGE_OVER_S`].
#[derive(Debug)]
struct Passage {
    config: Option<recursive::Config>,
    filter: recursive::State,
    rate_hz: f64,
    id: u16,
    index: u64,
    next_report_s: f64,
    range_m: Option<f32>,
}

impl Passage {
    const fn new() -> Self {
        Self {
            config: None,
            filter: recursive::State::new(),
            rate_hz: 1.0,
            id: 1,
            index: 0,
            next_report_s: 0.0,
            range_m: None,
        }
    }

    fn configure(&mut self, station: &StationConfig) {
        *self = Self {
            config: Some(recursive::Config::of_station(station)),
            rate_hz: station.rate_hz,
            ..Self::new()
        };
    }

    fn seconds(&self, index: u64) -> f64 {
        index as f64 / self.rate_hz
    }

    fn bearing(&mut self, bearing: &Bearing, sink: &mut impl FnMut(&Message)) {
        let Some(config) = self.config else { return };
        if bearing.band != 0 {
            return;
        }
        let t_s = self.seconds(bearing.index);
        let variance = f64::from(bearing.var_azimuth);
        let update = recursive::update(&config, &mut self.filter, t_s, f64::from(bearing.azimuth), variance);
        if update.lost {
            self.finish(sink);
            return;
        }
        self.index = bearing.index;
        if t_s >= self.next_report_s && self.filter.seen() >= TRACK_AFTER {
            self.next_report_s = t_s + TRACK_EVERY_S;
            if let Some(solution) = recursive::solution(&config, &self.filter) {
                self.range_m = near_range(&solution);
                sink(&Message::Track(report::track(&solution, self.id, 0, bearing.index)));
            }
        }
    }

    /// The sample index has reached `index`: a silent passage ends.
    fn advance(&mut self, index: u64, sink: &mut impl FnMut(&Message)) {
        if self.filter.seen() > 0 && self.seconds(index) - self.seconds(self.index) > PASSAGE_OVER_S {
            self.finish(sink);
        }
    }

    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        let Some(config) = self.config else { return };
        if self.filter.seen() >= TRACK_AFTER
            && let Some(solution) = recursive::finish(&config, &self.filter)
        {
            sink(&Message::Track(report::track(&solution, self.id, 1, self.index)));
            self.id = self.id.wrapping_add(1);
        }
        self.filter = recursive::State::new();
        self.next_report_s = 0.0;
        self.range_m = None;
    }
}

/// The vessel's range now, where the track knows it well enough to help the bearing estimator.
fn near_range(solution: &Solution) -> Option<f32> {
    let [x, y] = solution.position1_m;
    let known = solution.range_observable && solution.sd_cpa_range_m < 0.3 * solution.cpa_range_m;
    known.then(|| crate::math::f64::hypot(x, y) as f32)
}
