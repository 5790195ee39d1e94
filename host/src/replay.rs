//! Recordings through the recorder core, exactly as the recorder would: blocks in, messages out.

use crate::levels::{Beside, Meter};
use crate::record::Level;
use crate::recording::BlockSource;
use anyhow::{Result, anyhow};
use cpu_time::{ProcessTime, ThreadTime};
use seabearing_core::config::StationConfig;
use seabearing_core::recorder::Memory;
use seabearing_core::run::Application;
use seabearing_core::wire::{End, Message};
use std::time::Duration;

/// What a replay did.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReplaySummary {
    /// Sample instants fed.
    pub instants: u64,
    /// Index after the last sample.
    pub index: u64,
    /// Processor time spent in the core alone.
    pub core: Duration,
    /// Processor time of the whole process, reading and writing included.
    pub all: Duration,
}

/// What a replay says.
#[derive(Clone, Copy, Debug)]
pub enum Said<'a> {
    /// What the recorder sends.
    Message(&'a Message),
    /// Levels of an interval that begins at this index.
    Level(u64, &'a Level),
}

/// Samples that the recorder left out on purpose, as its loop tells them: second by second.
fn pause(
    recorder: &mut impl Application,
    samples: std::ops::Range<u64>,
    rate_hz: f64,
    sink: &mut impl FnMut(&Message),
) {
    recorder.pause(samples.end, sink);
    let seconds = ((samples.end - samples.start) as f64 / rate_hz) as u32;
    (1..=seconds).for_each(|second| recorder.paused(second, sink));
}

/// Feeds a recording to the recorder the station asks for; `heard` gets every message in order and may fail.
/// `table` is the propagation table of an ocean-bottom station as its binary blob.
///
/// # Errors
/// The configuration cannot be run, the source is lost, or what `heard` says.
pub fn replay(
    config: &StationConfig,
    table: Option<&[u8]>,
    source: &mut dyn BlockSource,
    mut heard: impl FnMut(&Message) -> Result<()>,
) -> Result<ReplaySummary> {
    with_levels(config, table, source, None, |said| match said {
        Said::Message(message) => heard(message),
        Said::Level(..) => Ok(()),
    })
}

/// The same, and levels beside it, on a second processor where there is one. Levels come after the messages of the block
/// that ends their interval.
///
/// # Errors
/// As [`replay`].
pub fn with_levels(
    config: &StationConfig,
    table: Option<&[u8]>,
    source: &mut dyn BlockSource,
    meter: Option<&mut Meter>,
    mut heard: impl FnMut(Said<'_>) -> Result<()>,
) -> Result<ReplaySummary> {
    let begun = ProcessTime::now();
    let mut summary = ReplaySummary::default();
    // The recorder's memory is large: it is built in place, on the heap.
    let mut memory: Box<Memory<'_>> = Box::default();
    let mut recorder = memory.configure(config, table).map_err(|e| anyhow!("{}: {e}", config.name))?;
    let mut frames = 0u32;
    let mut deliver = |messages: &mut Vec<Message>, levels: Vec<(u64, Level)>| -> Result<()> {
        frames = frames.wrapping_add(messages.len() as u32);
        messages.drain(..).try_for_each(|m| heard(Said::Message(&m)))?;
        levels.iter().try_for_each(|(index, level)| heard(Said::Level(*index, level)))
    };
    std::thread::scope(|scope| {
        // What is live is not kept waiting for what comes after it: there is time to measure it at once.
        let live = source.is_live();
        let (mut at_once, meter) = if live { (meter, None) } else { (None, meter) };
        let mut beside = meter.map(|meter| Beside::begin(scope, meter));
        let mut messages = Vec::new();
        recorder.start(0, &mut |m| messages.push(*m));
        deliver(&mut messages, Vec::new())?;
        loop {
            if let Some(until) = source.left_out()?.filter(|until| *until > summary.index) {
                pause(&mut recorder, summary.index..until, config.rate_hz, &mut |m| messages.push(*m));
                summary.index = until;
            }
            let Some(block) = source.next_block()? else { break };
            if let Some(beside) = &mut beside {
                beside.measure(block)?;
            }
            let before = ThreadTime::now();
            recorder.push(block, &mut |m| messages.push(*m));
            summary.core += before.elapsed();
            summary.instants += block.frames.len() as u64;
            summary.index = block.first_index + block.frames.len() as u64;
            let levels = at_once.as_deref_mut().map(|meter| {
                meter.push(block);
                meter.take()
            });
            match &mut beside {
                None => deliver(&mut messages, levels.unwrap_or_default())?,
                Some(beside) => beside.said(&mut messages, &mut deliver)?,
            }
        }
        let before = ThreadTime::now();
        recorder.finish(&mut |m| messages.push(*m));
        summary.core += before.elapsed();
        let levels = match (beside, at_once) {
            (Some(beside), _) => beside.end(&mut deliver)?,
            (None, Some(meter)) => {
                meter.finish();
                meter.take()
            }
            (None, None) => Vec::new(),
        };
        deliver(&mut messages, levels)
    })?;
    heard(Said::Message(&Message::End(End { index: summary.index, frames })))?;
    summary.all = begun.elapsed();
    log::debug!(
        "{}: {:.1} s of data in {:.2} s of processor time",
        config.name,
        summary.instants as f64 / config.rate_hz,
        summary.all.as_secs_f64()
    );
    Ok(summary)
}
