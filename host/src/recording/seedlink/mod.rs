//! A SeedLink server as a recording that goes on: the components of an ocean-bottom station as they come.
//!
//! Enters: an address, `seedlink://HOST:PORT/NET_STA`. Leaves: blocks, as of files. `line` speaks the protocol (version 3, records of
//! 512 bytes) and keeps the connection; `align` puts the components' records side by side.
//!
//! A connection that is lost is made again, with pauses that double up to a minute, and goes on after the last record that
//! came; what the server no longer holds is a gap. The first connection is tried once: a wrong address should be said.
//! A client of our own: two hundred lines, of a protocol that is frozen (docs/dependencies.md).

mod align;
mod line;
#[cfg(test)]
mod tests;

use super::{BlockSource, Span, complain, mseed, mseed_record};
use crate::interrupt;
use crate::station::Station;
use align::Aligner;
use anyhow::{Context, Result, bail};
use line::{Line, Patience};
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::Kind;
use std::fmt;
use std::path::Path;
use time::OffsetDateTime;

/// What an address begins with.
const SCHEME: &str = "seedlink://";

/// The port where none is told.
const PORT: u16 = 18_000;

/// A component whose records are so much later than another's is not waited for, s.
const LATEST_S: f64 = 120.0;

/// A station on a server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Address {
    host: String,
    port: u16,
    network: String,
    station: String,
}

impl Address {
    /// Whether a path is an address.
    pub(super) fn is_one(path: &Path) -> bool {
        path.to_str().is_some_and(|text| text.starts_with(SCHEME))
    }

    /// Reads `seedlink://HOST[:PORT]/NET_STA`.
    ///
    /// # Errors
    /// It is none.
    pub(super) fn parse(path: &Path) -> Result<Self> {
        let text = path.to_str().unwrap_or_default();
        let code = |text: &str, longest: usize| {
            (1..=longest).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_alphanumeric())
        };
        let parsed = || {
            let (place, source) = text.strip_prefix(SCHEME)?.split_once('/')?;
            // A colon in brackets belongs to the host (IPv6).
            let (host, port) = match place.rsplit_once(':') {
                Some((host, port)) if !port.ends_with(']') => (host, port.parse().ok()?),
                _ => (place, PORT),
            };
            let (network, station) = source.split_once(['_', '.'])?;
            let good = !host.is_empty() && code(network, 2) && code(station, 5);
            let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
            good.then(|| Self { host, port, network: network.to_owned(), station: station.to_owned() })
        };
        parsed().with_context(|| {
            format!("{text}: not a SeedLink station; one like {SCHEME}HOST:{PORT}/YV_RR03 was expected")
        })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{SCHEME}{}:{}/{}_{}", self.host, self.port, self.network, self.station)
    }
}

/// A station on a server, and what is wanted of it.
#[derive(Clone, Debug)]
pub(super) struct Remote {
    address: Address,
    /// Codes of pressure, north, east and vertical, and what their codes are multiplied by.
    codes: [String; 4],
    gains: [f64; 4],
    /// `LL`, where the station file tells the location.
    location: String,
    rate_hz: f64,
}

impl Remote {
    /// What a station file wants of an address.
    ///
    /// # Errors
    /// No address, one of another station than the file's `seed_id`, or an array.
    pub(super) fn of(path: &Path, station: &Station) -> Result<Self> {
        let address = Address::parse(path)?;
        if !matches!(station.config.kind, Kind::Obs(_)) {
            bail!(
                "{address}: servers have the components of ocean-bottom stations, and {} is an array",
                station.config.name
            );
        }
        let mut location = String::new();
        if let Some(id) = &station.seed_id {
            let named = format!("{}.{}", address.network, address.station);
            if !mseed::is_of(id, &named) {
                bail!("{address}: the station file says seed_id = \"{id}\"");
            }
            location = id.strip_prefix(&named).unwrap_or_default().trim_start_matches('.').to_owned();
        }
        let c = &station.components;
        let codes = [&c.pressure, &c.north, &c.east, &c.vertical].map(Clone::clone);
        Ok(Self { address, codes, gains: station.gains, location, rate_hz: station.config.rate_hz })
    }

    /// Connects, and waits for the first record. What came before `span.from` is asked for from there on.
    ///
    /// # Errors
    /// One line: the server is not there, is none, or has no such station or component.
    pub(super) fn open(&self, span: Span) -> Result<Live> {
        self.open_with(span, Patience::default())
    }

    fn open_with(&self, span: Span, patience: Patience) -> Result<Live> {
        let select = self.codes.each_ref().map(|code| format!("{}{code}.D", self.location));
        let line = Line::new(self.address.clone(), select.into(), span, patience);
        let aligner = Aligner::new(self.rate_hz, (LATEST_S * self.rate_hz) as i64);
        let mut live =
            Live { remote: self.clone(), line, aligner, frames: Vec::new(), start: None, damaged: 0 };
        while live.start.is_none() {
            if !live.record()? {
                bail!("{}: the server sent no record", self.address);
            }
        }
        Ok(live)
    }
}

/// Records that come.
pub(super) struct Live {
    remote: Remote,
    line: Line,
    aligner: Aligner,
    frames: Vec<Frame>,
    start: Option<OffsetDateTime>,
    damaged: u64,
}

impl Live {
    /// Takes the next record; `false` at the end, or where an interruption came.
    fn record(&mut self) -> Result<bool> {
        let address = &self.remote.address;
        let Some(raw) = self.line.next()? else { return Ok(false) };
        let read = mseed_record::header(&raw).and_then(|h| Ok((h, mseed_record::samples(&raw)?)));
        let (header, mut samples) = match read {
            Ok(read) => read,
            Err(e) => {
                self.damaged += 1;
                complain(&format!("{address}: lost a record: {e:#}"));
                return Ok(true);
            }
        };
        let Some(c) = self.remote.codes.iter().position(|code| *code == header.channel) else {
            return Ok(true);
        };
        if samples.is_empty() {
            return Ok(true);
        }
        let rate_hz = self.remote.rate_hz;
        if (header.rate_hz / rate_hz - 1.0).abs() > mseed::WORST_CLOCK {
            bail!(
                "{address}: component {} has {} samples a second, the station file says rate_hz = {rate_hz}: correct it there",
                header.channel,
                header.rate_hz
            );
        }
        let gain = self.remote.gains[c];
        if gain != 1.0 {
            samples.iter_mut().for_each(|x| *x = mseed::scaled(*x, gain));
        }
        if self.start.is_none() {
            let start = OffsetDateTime::from_unix_timestamp_nanos(header.start_ns);
            self.start = Some(start.context("a record's start is no time")?);
        }
        self.aligner.take(c, header.start_ns, samples);
        Ok(true)
    }
}

impl BlockSource for Live {
    fn start(&self) -> Option<OffsetDateTime> {
        self.start
    }

    fn expected_end(&self) -> Option<u64> {
        None
    }

    fn is_live(&self) -> bool {
        true
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let mut more = true;
        loop {
            // At the end what is there is all there will be.
            if let Some(first_index) = self.aligner.block(&mut self.frames, !more) {
                return Ok(Some(Block { first_index, frames: &self.frames }));
            }
            if !more || interrupt::asked() {
                return Ok(None);
            }
            more = self.record()?;
        }
    }
}
