//! The compact-array recorder: blocks to bearings and shaft rates, both to the tracks of up to eight vessels, and health.

use super::health::{Condition, Reporter};
use super::pieces;
use super::shaft;
use crate::array;
use crate::block::Block;
use crate::config::StationConfig;
use crate::demon::SpeedCurve;
use crate::run::Application;
use crate::slot::Slot;
use crate::traffic;
use crate::wire::{Command, Message};
use micromath::F32Ext;

/// What follows from the configuration.
#[derive(Debug)]
struct Plan {
    array: array::Plan,
    traffic: traffic::Config,
    speed_curve: Option<SpeedCurve>,
}

/// Everything the array recorder needs, in one place; meant for a `static`.
#[derive(Debug)]
pub struct ArrayRecorder {
    plan: Slot<Plan>,
    state: array::State,
    scratch: array::Scratch,
    vessels: traffic::State,
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
            plan: Slot::Empty,
            state: array::State::new(),
            scratch: array::Scratch::new(),
            vessels: traffic::State::new(),
            reporter: Reporter::new(),
        }
    }

    /// Takes a configuration and starts afresh.
    ///
    /// # Errors
    /// What is wrong with the configuration; the recorder is left as it was.
    // Apart, because the new plan passes over the stack, which must not stay taken while samples are worked on.
    #[inline(never)]
    pub fn configure(&mut self, config: &StationConfig) -> Result<(), array::PlanError> {
        let plan = Plan {
            array: array::Plan::new(config)?,
            traffic: traffic::Config::new(config),
            speed_curve: config.tracking.shaft_speed,
        };
        if self.plan.is_full() {
            self.forget();
        }
        self.plan = Slot::Full(plan);
        self.reporter.configure(config, 0);
        Ok(())
    }

    /// Back to nothing heard. Apart, because the new state passes over the stack; a recorder just started needs none.
    #[inline(never)]
    fn forget(&mut self) {
        self.state = array::State::new();
        self.vessels = traffic::State::new();
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
            let Self { plan: Slot::Full(plan), state, scratch, vessels, reporter } = self else {
                return;
            };
            array::push(&plan.array, state, scratch, piece, &mut |message| {
                reporter.count(&message);
                sink(&message);
                if let Message::Bearing(bearing) = &message {
                    traffic::bearing(&plan.traffic, vessels, bearing, &mut |track| sink(&track));
                }
            });
            if let Some(index) = boundary {
                if let Some(report) = state.take_shaft_report() {
                    shaft::tell(plan.speed_curve.as_ref(), &report, vessels, sink);
                }
                traffic::advance(&plan.traffic, vessels, index, &mut |track| sink(&track));
                state.set_places(vessels.places());
                self.report_if_due(index, sink);
            }
        }
    }

    fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message)) {
        let condition = self.condition();
        self.reporter.command(command, self.state.next_index(), &condition, sink);
    }

    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        if let Self { plan: Slot::Full(plan), state, scratch, vessels, reporter } = self {
            array::finish(&plan.array, state, scratch, &mut |message| {
                reporter.count(&message);
                sink(&message);
                if let Message::Bearing(bearing) = &message {
                    traffic::bearing(&plan.traffic, vessels, bearing, &mut |track| sink(&track));
                }
            });
            if let Some(report) = state.take_shaft_report() {
                shaft::tell(plan.speed_curve.as_ref(), &report, vessels, sink);
            }
            traffic::finish(&plan.traffic, vessels, &mut |track| sink(&track));
        }
        let condition = self.condition();
        sink(&self.reporter.health(self.state.next_index(), &condition));
    }
}

/// A power ratio in half decibels, for display: micromath's logarithm errs by up to 0.5 dB, one unit of this scale.
fn half_db(ratio: f32) -> i8 {
    if ratio > 0.0 { (20.0 * F32Ext::log10(ratio)).clamp(-127.0, 0.0) as i8 } else { i8::MIN }
}
