//! A recorder that only counts, until the estimators are in: says hello, health, and nothing else.

use crate::block::Block;
use crate::config::StationConfig;
use crate::health::Accounting;
use crate::run::Application;
use crate::wire::{Command, Health, Hello, Message, SCHEMA_HASH, WIRE_VERSION};

/// Counts samples.
#[derive(Debug)]
pub struct StandIn {
    /// The station.
    pub config: StationConfig,
    /// What was seen.
    pub seen: Accounting,
}

impl Application for StandIn {
    fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message)) {
        sink(&Message::Hello(Hello {
            wire_version: WIRE_VERSION,
            schema_hash: SCHEMA_HASH,
            config_hash: self.config.hash(),
            version: (0, 1, 0),
            station: self.config.id,
            kind: 0,
            rate_hz: self.config.rate_hz as f32,
            reset_cause,
        }));
    }
    fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message)) {
        self.seen.processed += block.frames.len() as u64;
        if block.first_index.is_multiple_of(65536) {
            sink(&Message::Health(Health {
                index: block.first_index,
                processed: self.seen.processed,
                ..Health::default()
            }));
        }
    }
    fn command(&mut self, _: Command, _: &mut impl FnMut(&Message)) {}
    fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
        sink(&Message::Health(Health { processed: self.seen.processed, ..Health::default() }));
    }
}
