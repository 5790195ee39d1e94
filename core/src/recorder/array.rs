//! The compact-array recorder: blocks to bearings and shaft rates, both to the tracks of up to eight vessels, and health.

use super::health::{Condition, Reporter};
use super::shaft;
use super::{DEAF_S, SILENT_S, bytes_of, enough, silence};
use crate::array;
use crate::block::Block;
use crate::config::{Schedule, StationConfig};
use crate::demon::SpeedCurve;
use crate::density;
use crate::intake::{Event, Run, Step};
use crate::keeper::REFUSED;
use crate::run::Application;
use crate::slot::Slot;
use crate::traffic;
use crate::utc::Pair;
use crate::wire::{Command, FaultCode, Message, Reply};

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

    /// Back to nothing heard, in place: a second configuration needs no more stack than the first.
    #[inline(never)]
    fn forget(&mut self) {
        self.state.forget();
        self.vessels.forget();
    }

    /// Where its plan stands.
    pub(super) fn settings(&self) -> core::ops::Range<*const u8> {
        bytes_of(&self.plan)
    }

    fn condition(&self) -> Condition {
        Condition {
            accounting: self.state.accounting(),
            channels: match &self.plan {
                Slot::Full(plan) => self.state.channels(&plan.array),
                Slot::Empty => 0,
            },
            level_half_db: match &self.plan {
                Slot::Full(plan) => self.state.level_half_db(&plan.array),
                Slot::Empty => [i8::MIN; 4],
            },
        }
    }

    /// Says the spectra of the last step; the status of the reply.
    // Apart, because its work must not take stack while samples are worked on.
    #[inline(never)]
    fn spectrum(&self, token: u8, channels: u8, sink: &mut impl FnMut(&Message)) -> u8 {
        let Slot::Full(plan) = &self.plan else { return REFUSED };
        density::tell(token, channels, |channel| self.state.density(&plan.array, channel), sink)
    }

    /// Takes samples that follow those before.
    fn samples(&mut self, run: &Run<'_>, sink: &mut impl FnMut(&Message)) {
        let Self { plan: Slot::Full(plan), state, scratch, vessels, reporter } = self else { return };
        array::samples(&plan.array, state, scratch, run, &mut outlet(plan, vessels, reporter, sink));
    }

    /// Takes a break. Before time starts again what is open is finished: the segment, the shaft rate, every passage.
    fn event(&mut self, event: Event, sink: &mut impl FnMut(&Message)) {
        let Self { plan: Slot::Full(plan), state, scratch, vessels, reporter } = self else { return };
        array::event(&plan.array, state, scratch, event, &mut outlet(plan, vessels, reporter, sink));
        let Event::Restart(index) = event else {
            traffic::gap(&plan.traffic, vessels, &mut |track| sink(&track));
            return;
        };
        if let Some(report) = state.take_shaft_report() {
            shaft::tell(plan.speed_curve.as_ref(), &report, vessels, sink);
        }
        traffic::restart(&plan.traffic, vessels, &mut |track| sink(&track));
        state.set_places(core::iter::empty());
        reporter.restart(index);
    }

    /// No samples have come for so many seconds: what is open goes on as if the index had gone on with the board's clock.
    // Apart, because its work must not take stack while samples are worked on.
    #[inline(never)]
    fn wait(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
        let Self { plan: Slot::Full(plan), state, scratch, vessels, reporter } = self else { return };
        if seconds < SILENT_S {
            return;
        }
        if seconds == SILENT_S {
            array::pause(&plan.array, state, scratch, &mut outlet(plan, vessels, reporter, sink));
        }
        let missed = f64::from(seconds) * reporter.rate_hz();
        let index = state.next_index().saturating_add(missed as u64);
        traffic::advance(&plan.traffic, vessels, index, &mut |track| sink(&track));
        state.set_places(vessels.places());
    }

    /// The same, and what follows for levels, faults and health; `wanted`: by the schedule.
    // Apart: called from two places, it is in flash once.
    #[inline(never)]
    fn without_samples(&mut self, seconds: u32, wanted: bool, sink: &mut impl FnMut(&Message)) {
        self.wait(seconds, sink);
        if seconds >= DEAF_S {
            self.state.silent();
        }
        let condition = self.condition();
        silence(&mut self.state.intake, &self.reporter, &condition, (seconds, wanted), sink);
    }

    /// The recording has reached this index.
    fn time(&mut self, index: u64, sink: &mut impl FnMut(&Message)) {
        let Self { plan: Slot::Full(plan), state, vessels, .. } = self else { return };
        if let Some(report) = state.take_shaft_report() {
            shaft::tell(plan.speed_curve.as_ref(), &report, vessels, sink);
        }
        traffic::advance(&plan.traffic, vessels, index, &mut |track| sink(&track));
        state.set_places(vessels.places());
        vessels.set_depth(state.depth_known());
        let condition = self.condition();
        if let Some(message) = self.reporter.due(index, self.state.intake.arrived(), &condition) {
            sink(&message);
        }
    }
}

/// Where the chain's messages go: out, and bearings to the tracks as well.
fn outlet(
    plan: &Plan,
    vessels: &mut traffic::State,
    reporter: &mut Reporter,
    sink: &mut impl FnMut(&Message),
) -> impl FnMut(Message) {
    move |message| {
        reporter.count(&message);
        sink(&message);
        if let Message::Bearing(bearing) = &message {
            traffic::bearing(&plan.traffic, vessels, bearing, &mut |track| sink(&track));
        }
    }
}

impl Application for ArrayRecorder {
    fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message)) {
        sink(&self.reporter.hello(reset_cause));
    }

    fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message)) {
        let mut rest = block;
        loop {
            let Slot::Full(plan) = &self.plan else { return };
            let intake = &mut self.state.intake;
            match intake.next(&plan.array.intake, &mut rest, &mut |message| sink(&message)) {
                Some(Step::Samples(run)) => self.samples(&run, sink),
                Some(Step::Mended(instant)) => self.samples(&instant.run(), sink),
                Some(Step::Event(event)) => self.event(event, sink),
                Some(Step::Time(index)) => self.time(index, sink),
                None => return,
            }
        }
    }

    fn enough(&self) -> u32 {
        enough(&self.reporter)
    }

    fn silent(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
        self.without_samples(seconds, false, sink);
    }

    fn schedule(&self) -> (Schedule, f64) {
        self.reporter.listens()
    }

    fn pause(&mut self, until: u64, sink: &mut impl FnMut(&Message)) {
        self.state.intake.rest(until, &mut |message| sink(&message));
    }

    fn paused(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
        self.without_samples(seconds, true, sink);
    }

    fn fault(&mut self, code: FaultCode, value: u64, sink: &mut impl FnMut(&Message)) {
        let index = self.state.next_index();
        self.state.intake.faults.note(code, index, value, &mut |message| sink(&message));
        if code == FaultCode::ConverterRestarted {
            self.reporter.estimated(index, value, sink);
        }
    }

    fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message)) {
        if let Command::SendSpectrum { token, channels } = command {
            let status = self.spectrum(token, channels, sink);
            return sink(&Message::Reply(Reply { token, status }));
        }
        let condition = self.condition();
        let index = self.state.next_index();
        self.reporter.command(command, index, &condition, &mut self.state.intake.faults, sink);
    }

    fn pair(&mut self, pair: Pair, sink: &mut impl FnMut(&Message)) {
        self.reporter.pair(pair, &mut self.state.intake.faults, sink);
    }

    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        if let Self { plan: Slot::Full(plan), state, scratch, vessels, reporter } = self {
            array::finish(&plan.array, state, scratch, &mut outlet(plan, vessels, reporter, sink));
            if let Some(report) = state.take_shaft_report() {
                shaft::tell(plan.speed_curve.as_ref(), &report, vessels, sink);
            }
            traffic::finish(&plan.traffic, vessels, &mut |track| sink(&track));
        }
        let condition = self.condition();
        sink(&self.reporter.health(self.state.next_index(), &condition));
    }
}
