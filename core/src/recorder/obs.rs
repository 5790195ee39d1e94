//! The ocean-bottom recorder: blocks to azimuths, ranges, segments and tracks, and health.

use super::health::{Condition, Reporter};
use super::{DEAF_S, bytes_of, enough, silence};
use crate::block::Block;
use crate::config::{Schedule, StationConfig};
use crate::density;
use crate::intake::{Event, Step};
use crate::obs::{self, PlanError, Table};
use crate::run::Application;
use crate::utc::Pair;
use crate::wire::{Command, FaultCode, Message, Reply};

/// Everything the ocean-bottom recorder needs, in one place; meant for a `static`. Its propagation table is read where it
/// lies, for `'t`.
#[derive(Debug)]
pub struct ObsRecorder<'t> {
    plan: obs::Plan<'t>,
    configured: bool,
    state: obs::State,
    scratch: obs::Scratch,
    reporter: Reporter,
}

impl Default for ObsRecorder<'_> {
    fn default() -> Self {
        Self::new()
    }
}

impl<'t> ObsRecorder<'t> {
    /// A recorder without a configuration: it accounts for nothing and says nothing but hello.
    pub const fn new() -> Self {
        Self {
            plan: obs::Plan::EMPTY,
            configured: false,
            state: obs::State::new(),
            scratch: obs::Scratch::new(),
            reporter: Reporter::new(),
        }
    }

    /// Takes a configuration and the bytes of its propagation table, and starts afresh.
    ///
    /// # Errors
    /// What is wrong with either; the recorder is left as it was.
    pub fn configure(&mut self, config: &StationConfig, table: Option<&'t [u8]>) -> Result<(), SetupError> {
        let table = Table::parse(table.ok_or(SetupError::NoTable)?).map_err(SetupError::Table)?;
        self.plan.fill(config, &table).map_err(SetupError::Plan)?;
        if self.configured {
            self.state.forget();
        }
        self.configured = true;
        self.reporter.configure(config, 1);
        Ok(())
    }

    /// No samples have come for so many seconds: in the end what is open is closed.
    // Apart, because its work must not take stack while samples are worked on.
    #[inline(never)]
    fn wait(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
        if let Self { plan, configured: true, state, scratch, reporter } = self
            && seconds == obs::CLOSED_AFTER_S
        {
            obs::close(plan, state, scratch, &mut |message| {
                reporter.count(&message);
                sink(&message);
            });
        }
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

    /// Where its plan stands.
    pub(super) fn settings(&self) -> core::ops::Range<*const u8> {
        bytes_of(&self.plan)
    }

    fn condition(&self) -> Condition {
        Condition {
            accounting: self.state.accounting(),
            channels: self.state.channel_flags(),
            level_half_db: self.state.level_half_db(&self.plan),
        }
    }

    fn index(&self) -> u64 {
        self.state.next_index()
    }
}

/// Why an ocean-bottom configuration cannot be run.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// There is no propagation table.
    #[error("an ocean-bottom station needs a propagation table (key `propagation`)")]
    NoTable,
    /// It is not one.
    #[error(transparent)]
    Table(obs::table::TableError),
    /// No plan can be made.
    #[error(transparent)]
    Plan(PlanError),
}

impl Application for ObsRecorder<'_> {
    fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message)) {
        sink(&self.reporter.hello(reset_cause));
    }

    fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message)) {
        let mut rest = block;
        while let Self { plan, configured: true, state, scratch, reporter } = self
            && let Some(step) = state.intake.next(&plan.intake, &mut rest, &mut |message| sink(&message))
        {
            obs::take(plan, state, scratch, &step, &mut |message| {
                reporter.count(&message);
                sink(&message);
            });
            match step {
                Step::Event(Event::Restart(index)) => reporter.restart(index),
                Step::Time(index) => {
                    let condition = self.condition();
                    if let Some(message) = self.reporter.due(index, self.state.intake.arrived(), &condition) {
                        sink(&message);
                    }
                }
                _ => {}
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
        let index = self.index();
        self.state.intake.faults.note(code, index, value, &mut |message| sink(&message));
        if code == FaultCode::ConverterRestarted {
            self.reporter.estimated(index, value, sink);
        }
    }

    fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message)) {
        if let Command::SendSpectrum { token, channels } = command {
            let status = density::tell(token, channels, |c| self.state.averages.density(&self.plan, c), sink);
            return sink(&Message::Reply(Reply { token, status }));
        }
        let condition = self.condition();
        let index = self.index();
        self.reporter.command(command, index, &condition, &mut self.state.intake.faults, sink);
    }

    fn pair(&mut self, pair: Pair, sink: &mut impl FnMut(&Message)) {
        self.reporter.pair(pair, &mut self.state.intake.faults, sink);
    }

    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        if let Self { plan, configured: true, state, scratch, reporter } = self {
            obs::finish(plan, state, scratch, &mut |message| {
                reporter.count(&message);
                sink(&message);
            });
        }
        let condition = self.condition();
        sink(&self.reporter.health(self.index(), &condition));
    }
}
