//! The station's propagation table: how the paths from a vessel at the surface interfere, against range.
//!
//! Enters: a blob of bytes, made on the host ([`super::table_encode`]) and stored with the station's configuration in
//! flash. Leaves: a borrowed, checked view, read in place. A branch is the interference of two paths, named by their
//! crossings of the water: 13, 35, 57, 79. At each model range it draws in the cepstrum, at quefrency q, the pulse
//! `a cos(2π f0 (q − τ) − φ) exp(−(q − τ)²/Δτ²)` [O 17] with delay τ, phase φ and strength a. Everything that
//! follows from those and the transforms' rate alone is in the blob, so that the recorder computes and keeps nothing.
//! Cost: none; nothing is copied.
//!
//! # Layout (little endian)
//! | bytes | type | meaning |
//! |---|---|---|
//! | 4 | bytes | `SBIT` |
//! | 2 | u16 | version, 2 |
//! | 2 | u16 | branches B, 1 to [`MAX_BRANCHES`] |
//! | 4 | f32 | rate of the transforms it was made for, Hz |
//! | 4 | f32 | farthest range of the propagation it was made from, m |
//! | 4 × 101 | f32 | travel time of the first arrival that carries energy, every km from 0, s |
//! | B × 2 × 201 | u16 | delay τ every 500 m from 0, in 10⁻⁴ s; 0: no such branch |
//! | 16 × 21 | f32 × 4 | Gaussian of the pulse at a distance of −10 to 10 quefrencies, for four fine delays |
//! | 12 × 384 | f32 × 3 | of each quefrency: cos and sin of 2π f0 q, and 1/σ²(q) |
//! | 4 × 716 | f32 | of each model range: `½ Σ_q μ²/σ²` with μ the sum of all branches |
//! | B × 6 × 716 | u16, i16, i16 | pulse of each model range: delay in 1/128 quefrency (0: none), a cos and a sin of 2π f0 τ + φ in 2⁻¹⁵ |
//! | 8 | u64 | [`fnv1a`] of all bytes before it |

use super::limits::{DELAYS, FINE, MODEL_RANGES, QUEFRENCIES};
use crate::wire::hash::fnv1a;

/// Branches a table may hold: 13, 35, 57 and 79 (the fourth keeps the fifth path from passing for a nearer range).
pub const MAX_BRANCHES: usize = 4;

/// Knots of the travel time, and the distance between them, m.
pub const KNOTS: usize = 101;
/// Distance between two knots of the travel time, m.
pub const KNOT_M: f32 = 1000.0;

/// Ranges at which the plain delays are kept, beyond the model too: 0 to 100 km.
pub const FAR_RANGES: usize = 201;

/// Step of those, m; delays bend so slowly that a straight line between them errs by less than a millisecond.
pub const FAR_STEP_M: f32 = 500.0;

/// Plain delays are stored in steps of this, s.
pub const DELAY_UNIT_S: f32 = 1e-4;

/// Longest half pulse in quefrencies: 3 Δτ times the transforms' rate.
pub const HALF: usize = 10;

/// Rows of the pulse's Gaussian.
pub const KERNEL: usize = 2 * HALF + 1;

/// Steps between two fine delays in which the place of a pulse is stored: 0.16 ms at 50 Hz.
pub const PARTS: usize = 32;

/// Strengths are stored in steps of this.
pub const STRENGTH_UNIT: f32 = 1.0 / 32_768.0;

pub(super) const MAGIC: [u8; 4] = *b"SBIT";
pub(super) const VERSION: u16 = 2;
const HEADER_BYTES: usize = 16;
const CHECKSUM_BYTES: usize = 8;

/// Bytes of a table of that many branches.
pub const fn blob_bytes(branches: usize) -> usize {
    let fixed = 4 * KNOTS + 4 * FINE * KERNEL + 12 * QUEFRENCIES + 4 * MODEL_RANGES;
    HEADER_BYTES + fixed + branches * (2 * FAR_RANGES + 6 * MODEL_RANGES) + CHECKSUM_BYTES
}

/// Why bytes are no table, or none can be made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TableError {
    /// Not a propagation table at all.
    #[error("not a propagation table")]
    Magic,
    /// Made for another version of this layout.
    #[error(
        "propagation table of version {0}, only {VERSION} is understood: write the blob anew with `seabearing blob`"
    )]
    Version(u16),
    /// Branches or ranges outside what is supported, or slices of unlike length.
    #[error("propagation table needs 1 to {MAX_BRANCHES} branches and at least 2 ranges")]
    Size,
    /// Shorter or longer than its header says: bytes wanted.
    #[error("propagation table cut: its header asks for {0} bytes")]
    Length(usize),
    /// Damaged.
    #[error("propagation table damaged: checksum differs")]
    Checksum,
    /// A value that cannot be: step, f0 or Δτ not positive, a delay or travel time below zero, a strength outside 0 to 1.
    #[error("propagation table holds an impossible step, delay, travel time or strength")]
    Value,
    /// The pulse is wider than the detector's: its Δτ and the widest, s.
    #[error("propagation table's pulse is {0} s wide, at this rate at most {1:.3} s")]
    Width(f32, f32),
}

/// A branch at a range: where its pulse lies, in fine delays over [`PARTS`] (0: no pulse), and how the envelope
/// projects on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// Delay, in quefrencies over `FINE × PARTS`.
    pub delay: u16,
    /// Strength times the cosine of its phase at quefrency 0.
    pub re: i16,
    /// Strength times the sine.
    pub im: i16,
}

impl Pulse {
    /// No pulse.
    pub const NONE: Self = Self { delay: 0, re: 0, im: 0 };

    /// From a table's bytes.
    pub fn read([a, b, c, d, e, f]: [u8; 6]) -> Self {
        Self {
            delay: u16::from_le_bytes([a, b]),
            re: i16::from_le_bytes([c, d]),
            im: i16::from_le_bytes([e, f]),
        }
    }

    /// As a table's bytes.
    pub fn bytes(self) -> [u8; 6] {
        let ([a, b], [c, d], [e, f]) =
            (self.delay.to_le_bytes(), self.re.to_le_bytes(), self.im.to_le_bytes());
        [a, b, c, d, e, f]
    }

    /// Its energy but for a factor.
    pub(super) fn energy(self) -> f32 {
        f32::from(self.re) * f32::from(self.re) + f32::from(self.im) * f32::from(self.im)
    }

    /// Where it lies, in quefrencies.
    pub fn centre(self) -> f32 {
        f32::from(self.delay) * (1.0 / (FINE * PARTS) as f32)
    }
}

/// A checked view of a table's bytes; fields as in the layout.
#[derive(Clone, Copy, Debug)]
pub struct Table<'t> {
    pub(super) rate_hz: f32,
    pub(super) max_range_m: f32,
    pub(super) branches: usize,
    pub(super) travel: &'t [[u8; 4]],
    pub(super) far: &'t [[u8; 2]],
    pub(super) kernel: &'t [[u8; 4 * FINE]],
    pub(super) weights: &'t [[u8; 12]],
    pub(super) half_energy: &'t [[u8; 4]],
    pub(super) pulses: &'t [[u8; 6]],
}

/// The next `count` items of `N` bytes.
fn take<'t, const N: usize>(rest: &mut &'t [u8], count: usize) -> Option<&'t [[u8; N]]> {
    let (head, tail) = rest.split_at_checked(N * count)?;
    *rest = tail;
    Some(head.as_chunks().0)
}

/// Three numbers.
pub(super) fn three([a, b, c, d, e, f, g, h, i, j, k, l]: [u8; 12]) -> [f32; 3] {
    [[a, b, c, d], [e, f, g, h], [i, j, k, l]].map(f32::from_le_bytes)
}

impl<'t> Table<'t> {
    /// Reads and checks a blob. Bytes after the table are an error.
    ///
    /// # Errors
    /// What is wrong first.
    pub fn parse(bytes: &'t [u8]) -> Result<Self, TableError> {
        let cut = TableError::Length(HEADER_BYTES);
        let rest = &mut bytes.strip_prefix(&MAGIC).ok_or(TableError::Magic)?;
        let [version, branches] = *take::<2>(rest, 2).and_then(<[_]>::first_chunk).ok_or(cut)?;
        let (version, branches) = (u16::from_le_bytes(version), usize::from(u16::from_le_bytes(branches)));
        if version != VERSION {
            return Err(TableError::Version(version));
        }
        if !(1..=MAX_BRANCHES).contains(&branches) {
            return Err(TableError::Size);
        }
        let short = TableError::Length(blob_bytes(branches));
        let (body, tail) = bytes.split_last_chunk::<CHECKSUM_BYTES>().ok_or(short)?;
        if bytes.len() != blob_bytes(branches) {
            return Err(short);
        }
        if fnv1a(body) != u64::from_le_bytes(*tail) {
            return Err(TableError::Checksum);
        }
        let [rate_hz, max_range_m] =
            take::<4>(rest, 2).and_then(<[_]>::first_chunk).ok_or(short)?.map(f32::from_le_bytes);
        let table = Self {
            rate_hz,
            max_range_m,
            branches,
            travel: take(rest, KNOTS).ok_or(short)?,
            far: take(rest, branches * FAR_RANGES).ok_or(short)?,
            kernel: take(rest, KERNEL).ok_or(short)?,
            weights: take(rest, QUEFRENCIES).ok_or(short)?,
            half_energy: take(rest, MODEL_RANGES).ok_or(short)?,
            pulses: take(rest, branches * MODEL_RANGES).ok_or(short)?,
        };
        if table.possible() { Ok(table) } else { Err(TableError::Value) }
    }

    fn possible(&self) -> bool {
        let within = |bytes: &[u8; 4], most: f32| (0.0..=most).contains(&f32::from_le_bytes(*bytes));
        let fits = |p: &[u8; 6]| usize::from(Pulse::read(*p).delay) < PARTS * (DELAYS - 1);
        [self.rate_hz, self.max_range_m].iter().all(|x| x.is_finite() && *x > 0.0)
            && self.travel.iter().all(|t| within(t, 1000.0))
            && self.kernel.as_flattened().as_chunks().0.iter().all(|k| within(k, 1.0))
            && self.weights.iter().flat_map(|w| three(*w)).all(f32::is_finite)
            && self.half_energy.iter().all(|e| within(e, f32::MAX))
            && self.pulses.iter().all(fits)
    }

    /// Rate of the transforms it was made for, Hz.
    pub fn rate_hz(&self) -> f32 {
        self.rate_hz
    }

    /// Number of branches.
    pub fn branches(&self) -> usize {
        self.branches
    }

    /// The farthest range of the propagation it was made from, m.
    pub fn max_range_m(&self) -> f32 {
        self.max_range_m
    }

    /// Pulses of a branch at every model range; none of a branch that is not there.
    pub fn pulses(&self, branch: usize) -> impl Iterator<Item = Pulse> + 't {
        self.stored(branch).iter().map(|p| Pulse::read(*p))
    }

    /// The same as stored.
    pub(super) fn stored(&self, branch: usize) -> &'t [[u8; 6]] {
        let from = branch * MODEL_RANGES;
        self.pulses.get(from..from + MODEL_RANGES).unwrap_or_default()
    }

    /// The pulse that a branch draws at the model range of number `j`; none outside the model.
    pub fn pulse(&self, branch: usize, j: usize) -> Pulse {
        let own = self.pulses.get(branch * MODEL_RANGES..(branch + 1) * MODEL_RANGES);
        own.and_then(|own| own.get(j)).map_or(Pulse::NONE, |p| Pulse::read(*p))
    }

    /// Delay of a branch at any range up to 100 km, s; `None` where it does not exist.
    pub fn delay_s(&self, branch: usize, range_m: f32) -> Option<f32> {
        let x = (range_m / FAR_STEP_M).max(0.0);
        let j = x as usize;
        let delays = self.far.get(branch * FAR_RANGES..(branch + 1) * FAR_RANGES)?;
        let (a, b) = (u16::from_le_bytes(*delays.get(j)?), u16::from_le_bytes(*delays.get(j + 1)?));
        if a == 0 || b == 0 {
            return None;
        }
        Some(DELAY_UNIT_S * (f32::from(a) + (f32::from(b) - f32::from(a)) * (x - j as f32)))
    }

    /// Travel time of the first arrival at each knot, s.
    pub fn travel_times_s(&self) -> impl Iterator<Item = f32> + 't {
        self.travel.iter().map(|t| f32::from_le_bytes(*t))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obs::table_encode::example;

    #[test]
    fn damage_is_named() {
        let good = example(50.0);
        let with = |at: usize, byte: u8| {
            let mut b = good.clone();
            b[at] = byte;
            b
        };
        assert_eq!(Table::parse(&with(0, b'X')).unwrap_err(), TableError::Magic);
        assert_eq!(Table::parse(&with(4, 9)).unwrap_err(), TableError::Version(9));
        assert_eq!(Table::parse(&with(6, 5)).unwrap_err(), TableError::Size);
        assert_eq!(Table::parse(&with(40, 1)).unwrap_err(), TableError::Checksum);
        assert_eq!(Table::parse(&good[..50]).unwrap_err(), TableError::Length(good.len()));
        assert_eq!(Table::parse(&[]).unwrap_err(), TableError::Magic);
        assert_eq!(Table::parse(&good[..7]).unwrap_err(), TableError::Length(HEADER_BYTES));
    }

    #[test]
    fn a_table_of_the_layout_before_is_refused_in_one_line() {
        let mut old = example(50.0);
        old[4] = 1;
        let line = std::format!("{}", Table::parse(&old).unwrap_err());
        assert!(line.contains("version 1") && line.contains("`seabearing blob`"), "{line}");
    }
}
