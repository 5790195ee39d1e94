//! The recorder's state machine: blocks of samples and commands in, messages out.
//!
//! [`ArrayRecorder`] and [`ObsRecorder`] own the memory of their chain; [`Memory`] holds both, for a `static`, and gives the
//! [`Recorder`] the configuration asks for. Samples go through [`crate::intake`] to the chain; what happens at intervals
//! (health, the end of a silent passage) happens when it says the time, so that how the samples are cut into blocks changes
//! nothing. Only while no samples come is it the board's clock that says the time.

mod configuration;
mod health;

#[cfg(feature = "array")]
mod array;
#[cfg(feature = "obs")]
mod obs;
#[cfg(feature = "array")]
mod shaft;

#[cfg(feature = "array")]
pub use array::ArrayRecorder;
pub use configuration::configuration;
pub use health::{Condition, HEALTH_EVERY_S, Reporter, TIME_EVERY_S};
#[cfg(feature = "obs")]
pub use obs::{ObsRecorder, SetupError as ObsSetupError};

use crate::block::Block;
use crate::config::{Kind, Schedule, StationConfig};
use crate::intake::Intake;
use crate::run::Application;
use crate::utc::Pair;
use crate::wire::{Command, FaultCode, Message};

/// Seconds without samples after which the source is called silent.
const SILENT_S: u32 = 10;

/// Seconds without samples after which the last levels say nothing of now.
const DEAF_S: u32 = 60;

/// Instants that end a silence: half a second's. Less in so many seconds is a source that stutters, and no time passes by it.
fn enough(reporter: &Reporter) -> u32 {
    (0.5 * reporter.rate_hz()) as u32
}

/// So many seconds have gone by without samples: says so once unless that is wanted, and goes on with faults held back and
/// health.
fn silence(
    intake: &mut Intake,
    reporter: &Reporter,
    condition: &Condition,
    (seconds, wanted): (u32, bool),
    sink: &mut impl FnMut(&Message),
) {
    let index = intake.next_index();
    if seconds == SILENT_S && !wanted {
        intake.faults.note(FaultCode::NoSamples, index, u64::from(seconds), &mut |message| sink(&message));
    }
    if seconds.is_multiple_of(60) {
        intake.faults.tell(index, &mut |message| sink(&message));
    }
    if seconds >= SILENT_S && reporter.due_in_silence(seconds) {
        sink(&reporter.health(index, condition));
    }
}

/// Why a configuration cannot be run.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// The array's plan cannot be made.
    #[cfg(feature = "array")]
    #[error(transparent)]
    Array(crate::array::PlanError),
    /// The ocean-bottom station's plan cannot be made.
    #[cfg(feature = "obs")]
    #[error(transparent)]
    Obs(obs::SetupError),
    /// This software holds no recorder for this kind of station.
    #[error("this software holds no recorder for this kind of station")]
    Kind,
}

/// Memory for every kind of recorder this software holds. A propagation table is read where it lies, for `'t`.
#[derive(Debug, Default)]
pub struct Memory<'t> {
    /// The compact array's.
    #[cfg(feature = "array")]
    pub array: ArrayRecorder,
    /// The ocean-bottom station's.
    #[cfg(feature = "obs")]
    pub obs: ObsRecorder<'t>,
    #[cfg(not(feature = "obs"))]
    table: core::marker::PhantomData<&'t [u8]>,
}

impl<'t> Memory<'t> {
    /// Unconfigured; all zeros, so that a `static` of it costs no flash.
    pub const fn new() -> Self {
        Self {
            #[cfg(feature = "array")]
            array: ArrayRecorder::new(),
            #[cfg(feature = "obs")]
            obs: ObsRecorder::new(),
            #[cfg(not(feature = "obs"))]
            table: core::marker::PhantomData,
        }
    }

    /// The recorder a configuration asks for, configured and started afresh. `table` is the propagation table of an
    /// ocean-bottom station. What a recorder before it in this memory had open is forgotten unsent: let it finish first.
    ///
    /// # Errors
    /// Why there is none.
    pub fn configure(
        &mut self,
        config: &StationConfig,
        table: Option<&'t [u8]>,
    ) -> Result<Recorder<'_, 't>, SetupError> {
        #[cfg(not(feature = "obs"))]
        let _ = table; // only that kind has one
        match &config.kind {
            #[cfg(feature = "array")]
            Kind::Array(_) => {
                self.array.configure(config).map_err(SetupError::Array)?;
                Ok(Recorder::Array(&mut self.array))
            }
            #[cfg(feature = "obs")]
            Kind::Obs(_) => {
                self.obs.configure(config, table).map_err(SetupError::Obs)?;
                Ok(Recorder::Obs(&mut self.obs))
            }
            _ => Err(SetupError::Kind),
        }
    }
}

/// A configured recorder.
#[derive(Debug)]
pub enum Recorder<'m, 't> {
    /// Compact array.
    #[cfg(feature = "array")]
    Array(&'m mut ArrayRecorder),
    /// Ocean-bottom station.
    #[cfg(feature = "obs")]
    Obs(&'m mut ObsRecorder<'t>),
    /// No recorder at all, in a software that holds none.
    #[cfg(not(feature = "obs"))]
    Unavailable(core::convert::Infallible, core::marker::PhantomData<(&'m (), &'t ())>),
}

/// The same call of whichever recorder it is.
macro_rules! whichever {
    ($recorder:expr, $r:ident => $call:expr) => {
        match $recorder {
            #[cfg(feature = "array")]
            Recorder::Array($r) => $call,
            #[cfg(feature = "obs")]
            Recorder::Obs($r) => $call,
            #[cfg(not(feature = "obs"))]
            Recorder::Unavailable(never, _) => match *never {},
        }
    };
}

impl Recorder<'_, '_> {
    /// Where what was worked out of the configuration stands, which does not change while it runs: for a board that watches its memory.
    pub fn settings(&self) -> core::ops::Range<*const u8> {
        whichever!(self, r => r.settings())
    }
}

/// The bytes of a value.
fn bytes_of<T>(value: &T) -> core::ops::Range<*const u8> {
    let value = core::slice::from_ref(value).as_ptr_range();
    value.start.cast()..value.end.cast()
}

impl Application for Recorder<'_, '_> {
    fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.start(reset_cause, sink));
    }

    fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.push(block, sink));
    }

    fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.command(command, sink));
    }

    fn enough(&self) -> u32 {
        whichever!(self, r => r.enough())
    }

    fn silent(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.silent(seconds, sink));
    }

    fn schedule(&self) -> (Schedule, f64) {
        whichever!(self, r => r.schedule())
    }

    fn pause(&mut self, until: u64, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.pause(until, sink));
    }

    fn paused(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.paused(seconds, sink));
    }

    fn fault(&mut self, code: FaultCode, value: u64, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.fault(code, value, sink));
    }

    fn pair(&mut self, pair: Pair, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.pair(pair, sink));
    }

    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        whichever!(self, r => r.finish(sink));
    }
}

#[cfg(all(test, feature = "array", feature = "obs"))]
mod hostile_tests;
#[cfg(all(test, feature = "array", feature = "obs"))]
mod pause_tests;
#[cfg(all(test, feature = "array", feature = "obs"))]
mod silence_tests;
#[cfg(all(test, feature = "array", feature = "obs"))]
mod slow_levels_tests;
#[cfg(all(test, feature = "array", feature = "obs"))]
mod spectrum_tests;
#[cfg(all(test, feature = "array", feature = "obs"))]
mod test_recorder;
