//! The core's chain over a recording: what the recorder would say, as messages.

use super::table;
use crate::propagation::Propagation;
use crate::recording::BlockSource;
use anyhow::{Result, anyhow};
use seabearing_core::config::StationConfig;
use seabearing_core::obs::{Plan, Scratch, State, Table, finish, push};
use seabearing_core::wire::Message;

/// Runs the chain over all blocks of a source; `said` gets every message in order.
///
/// # Errors
/// The table or the configuration does not fit the core, or the source is lost.
pub fn run(
    config: &StationConfig,
    propagation: &Propagation,
    source: &mut dyn BlockSource,
    said: &mut dyn FnMut(Message),
) -> Result<()> {
    let bytes = table::of(config, propagation, &propagation.name)?;
    let view = Table::parse(&bytes).map_err(|e| anyhow!("{e}"))?;
    let plan = Box::new(Plan::new(config, &view).map_err(|e| anyhow!("{e}"))?);
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    while let Some(block) = source.next_block()? {
        push(&plan, &mut state, &mut scratch, block, said);
    }
    finish(&plan, &mut state, &mut scratch, said);
    Ok(())
}
