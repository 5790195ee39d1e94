//! Where the samples of miniSEED and SAC files are, from their headers alone.

use super::mseed::{BLOCK, WORST_CLOCK};
use super::mseed_record::{self, Header, LONGEST};
use super::{complain, sac};
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes looked at together that hold most records whole; only for one that does not seem to be one more are read.
const AHEAD: usize = 1 << 14;

/// Least step from one possible record to the next, when looking for one after damage.
const RESYNC: usize = 64;

/// How a record's samples are written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Form {
    /// A record of miniSEED.
    MiniSeed,
    /// Floating-point numbers of a SAC file, in the order of its bytes.
    Sac(sac::Order),
}

/// Where a record's samples are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub(super) file: usize,
    pub(super) form: Form,
    pub(super) offset: u64,
    pub(super) bytes: usize,
    pub(super) start_ns: i128,
    /// Index of its first sample (after `place`) and number of samples.
    pub(super) first: i64,
    pub(super) samples: usize,
}

/// What the files hold of a channel, from one source (`NET.STA.LOC`) at one rate.
#[derive(Clone)]
pub(super) struct Stretch {
    pub(super) source: String,
    pub(super) rate_hz: f64,
    pub(super) pieces: Vec<Piece>,
}

/// Stretches by the channel's code.
pub(super) type Found = BTreeMap<String, Vec<Stretch>>;

/// Whether two rates are one, by two clocks or by one that drifts.
pub(super) fn same_clock(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() <= WORST_CLOCK
}

/// The pieces of a source at a rate.
fn pieces_of<'a>(channels: &'a mut Found, code: String, source: &str, rate_hz: f64) -> &'a mut Vec<Piece> {
    let stretches = channels.entry(code).or_default();
    let same = |s: &Stretch| s.source == source && same_clock(s.rate_hz, rate_hz);
    let at = stretches.iter().rposition(same).unwrap_or_else(|| {
        stretches.push(Stretch { source: source.to_owned(), rate_hz, pieces: Vec::new() });
        stretches.len() - 1
    });
    &mut stretches[at].pieces
}

/// Finds a SAC file's samples, in pieces that can be read one at a time.
pub(super) fn scan_sac(path: &Path, number: usize, channels: &mut Found) -> Result<()> {
    let about = sac::header(path)?;
    let pieces = pieces_of(channels, about.channel, &about.station, about.rate_hz);
    for first in (0..about.count).step_by(BLOCK) {
        pieces.push(Piece {
            file: number,
            form: Form::Sac(about.order),
            offset: sac::HEADER + 4 * first as u64,
            bytes: 4 * BLOCK.min(about.count - first),
            start_ns: about.start_ns + (first as f64 / about.rate_hz * 1e9).round() as i128,
            first: 0,
            samples: BLOCK.min(about.count - first),
        });
    }
    Ok(())
}

/// Finds the records of a miniSEED file.
pub(super) fn scan(path: &Path, number: usize, channels: &mut Found) -> Result<()> {
    let unreadable = || format!("cannot read {}", path.display());
    let mut file = File::open(path).with_context(unreadable)?;
    let (mut window, mut begins, mut at) = (Vec::new(), 0u64, 0);
    let (mut ahead, mut ended) = (AHEAD, false);
    let (mut damaged, mut found) = (0, 0usize);
    let mut reason = String::new();
    loop {
        if window.len() - at < ahead && !ended {
            window.drain(..at);
            begins += at as u64;
            at = 0;
            let room = (16 * ahead).min(2 * LONGEST) - window.len();
            let read = (&mut file).take(room as u64).read_to_end(&mut window).with_context(unreadable)?;
            ended = read < room;
        }
        if at >= window.len() {
            break;
        }
        match mseed_record::header(&window[at..]) {
            Ok(h) => {
                (found, ahead) = (found + 1, AHEAD);
                let Header { channel, station, rate_hz, start_ns, count, bytes } = h;
                let pieces = pieces_of(channels, channel, &station, rate_hz);
                if count > 0 {
                    pieces.push(Piece {
                        file: number,
                        form: Form::MiniSeed,
                        offset: begins + at as u64,
                        bytes,
                        start_ns,
                        first: 0,
                        samples: count,
                    });
                }
                at = (at + bytes.max(RESYNC)).min(window.len());
            }
            // It may be a longer one.
            Err(_) if window.len() - at < LONGEST && !ended => ahead = LONGEST,
            Err(e) => {
                if reason.is_empty() {
                    reason = format!("at byte {}: {e}", begins + at as u64);
                }
                let step = RESYNC.min(window.len() - at);
                damaged += step;
                at += step;
            }
        }
    }
    if found == 0 {
        bail!("{}: no readable miniSEED record ({reason})", path.display());
    }
    if damaged > 0 {
        complain(&format!(
            "{}: {damaged} bytes are damaged or cut, the rest is used ({reason})",
            path.display()
        ));
    }
    Ok(())
}
