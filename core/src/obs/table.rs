//! The station's propagation table: how the paths from a vessel at the surface interfere, against range.
//!
//! Enters: a blob of bytes, made on the host and stored with the station's configuration. Leaves: a borrowed,
//! checked view. A branch is the interference of two paths, named by their crossings of the water: 13, 35, 57, 79.
//! Per branch and range: delay τ between the two paths, phase φ of the later against the earlier, and strength a,
//! the height of the pulse `a cos(2π f0 (q − τ) − φ) exp(−(q − τ)²/Δτ²)` that the interference draws in the
//! cepstrum at quefrency q [O 17]. Ranges run from 0 in equal steps; a branch that does not exist at a range has
//! NaN there. Cost: none; nothing is copied.
//!
//! # Layout (little endian)
//! | offset | type | meaning |
//! |---|---|---|
//! | 0 | 4 bytes | `SBIT` |
//! | 4 | u16 | version, 1 |
//! | 6 | u16 | branches B, 1 to [`MAX_BRANCHES`] |
//! | 8 | u16 | ranges R, 2 to [`MAX_RANGES`] |
//! | 10 | u16 | 0 |
//! | 12 | f32 | range step, m |
//! | 16 | f32 | centre frequency f0, Hz |
//! | 20 | f32 | pulse width Δτ, s |
//! | 24 | f32 × R | travel time of the first arrival that carries energy, s |
//! | then, B times | f32 × R, f32 × R, f32 × R | delay s, phase rad, strength |
//! | end − 8 | u64 | [`fnv1a`] of all bytes before it |

use crate::wire::hash::fnv1a;

/// Branches a table may hold: 13, 35, 57 and 79 (the fourth keeps the fifth path from passing for a nearer range).
pub const MAX_BRANCHES: usize = 4;

/// Ranges a table may hold: 100 km in steps of 70 m.
pub const MAX_RANGES: usize = 1429;

/// Bytes before the first array.
pub const HEADER_BYTES: usize = 24;

/// Bytes of the checksum at the end.
pub const CHECKSUM_BYTES: usize = 8;

const MAGIC: [u8; 4] = *b"SBIT";
const VERSION: u16 = 1;

/// Bytes of a table of that size.
pub const fn blob_bytes(branches: usize, ranges: usize) -> usize {
    HEADER_BYTES + 4 * ranges * (1 + 3 * branches) + CHECKSUM_BYTES
}

/// Why bytes are no table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableError {
    /// Not a propagation table at all.
    Magic,
    /// Made for another version of this layout.
    Version(u16),
    /// Branches or ranges outside what is supported, or slices of unlike length.
    Size,
    /// Shorter or longer than its header says: bytes wanted.
    Length(usize),
    /// Damaged.
    Checksum,
    /// A value that cannot be: step, f0 or Δτ not positive, a delay or travel time below zero, a strength outside 0 to 1.
    Value,
}

impl core::fmt::Display for TableError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Magic => write!(f, "not a propagation table"),
            Self::Version(v) => write!(f, "propagation table of version {v}, only {VERSION} is understood"),
            Self::Size => {
                write!(f, "propagation table needs 1 to {MAX_BRANCHES} branches and 2 to {MAX_RANGES} ranges")
            }
            Self::Length(n) => write!(f, "propagation table cut: its header asks for {n} bytes"),
            Self::Checksum => write!(f, "propagation table damaged: checksum differs"),
            Self::Value => {
                write!(f, "propagation table holds an impossible step, delay, travel time or strength")
            }
        }
    }
}

impl core::error::Error for TableError {}

/// One interference against range, for [`encode`]. All slices have the table's number of ranges; NaN = no such branch.
#[derive(Clone, Copy, Debug)]
pub struct BranchColumns<'a> {
    /// Delay between the two paths, s.
    pub delay_s: &'a [f32],
    /// Phase of the later path against the earlier in the convention of the module's formula, rad.
    pub phase_rad: &'a [f32],
    /// Height of the cepstral pulse, 0 to 1.
    pub strength: &'a [f32],
}

/// What a table says that is not an array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// Distance between two ranges, m; the first is 0.
    pub step_m: f32,
    /// Centre frequency f0 of a vessel's wideband noise, Hz (RR03: 16.5).
    pub f0_hz: f32,
    /// Width Δτ of the pulse, s (RR03: 0.05).
    pub width_s: f32,
}

/// A checked view of a table's bytes.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a> {
    header: Header,
    branches: usize,
    ranges: usize,
    /// Travel times, then delay, phase, strength of each branch.
    values: &'a [u8],
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk::<2>().map(|b| u16::from_le_bytes(*b))
}

fn f32_at(bytes: &[u8], at: usize) -> Option<f32> {
    bytes.get(at..)?.first_chunk::<4>().map(|b| f32::from_le_bytes(*b))
}

impl<'a> Table<'a> {
    /// Reads and checks a blob. Bytes after the table are an error.
    ///
    /// # Errors
    /// What is wrong first.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, TableError> {
        if bytes.first_chunk::<4>() != Some(&MAGIC) {
            return Err(TableError::Magic);
        }
        let short = TableError::Length(HEADER_BYTES);
        let version = u16_at(bytes, 4).ok_or(short)?;
        if version != VERSION {
            return Err(TableError::Version(version));
        }
        let branches = usize::from(u16_at(bytes, 6).ok_or(short)?);
        let ranges = usize::from(u16_at(bytes, 8).ok_or(short)?);
        if !(1..=MAX_BRANCHES).contains(&branches) || !(2..=MAX_RANGES).contains(&ranges) {
            return Err(TableError::Size);
        }
        let header = Header {
            step_m: f32_at(bytes, 12).ok_or(short)?,
            f0_hz: f32_at(bytes, 16).ok_or(short)?,
            width_s: f32_at(bytes, 20).ok_or(short)?,
        };
        let wanted = blob_bytes(branches, ranges);
        if bytes.len() != wanted {
            return Err(TableError::Length(wanted));
        }
        let (body, tail) = bytes.split_last_chunk::<CHECKSUM_BYTES>().ok_or(short)?;
        if fnv1a(body) != u64::from_le_bytes(*tail) {
            return Err(TableError::Checksum);
        }
        let values = body.get(HEADER_BYTES..).ok_or(short)?;
        let table = Self { header, branches, ranges, values };
        table.check()?;
        Ok(table)
    }

    fn check(&self) -> Result<(), TableError> {
        let h = &self.header;
        let positive = [h.step_m, h.f0_hz, h.width_s].iter().all(|x| x.is_finite() && *x > 0.0);
        // NaN marks a missing branch, so the tests below must let it pass: only a present value can be wrong.
        let wrong = |x: Option<f32>, most: f32| x.is_some_and(|x| !x.is_nan() && !(0.0..=most).contains(&x));
        let any_wrong = (0..self.ranges).any(|j| {
            wrong(self.value(0, j), 1000.0)
                || (0..self.branches).any(|b| {
                    wrong(self.value(1 + 3 * b, j), 100.0)
                        || wrong(
                            self.value(2 + 3 * b, j).map(|x| if x.is_infinite() { -1.0 } else { 0.0 }),
                            1.0,
                        )
                        || wrong(self.value(3 + 3 * b, j), 1.0)
                })
        });
        if positive && !any_wrong { Ok(()) } else { Err(TableError::Value) }
    }

    fn value(&self, column: usize, j: usize) -> Option<f32> {
        if j < self.ranges { f32_at(self.values, 4 * (column * self.ranges + j)) } else { None }
    }

    /// Step, f0 and Δτ.
    pub fn header(&self) -> Header {
        self.header
    }

    /// Number of branches.
    pub fn branches(&self) -> usize {
        self.branches
    }

    /// Number of ranges.
    pub fn ranges(&self) -> usize {
        self.ranges
    }

    /// The farthest range held, m.
    pub fn max_range_m(&self) -> f32 {
        self.header.step_m * (self.ranges - 1) as f32
    }

    /// Place of a range between two rows: the lower row and the part of a step above it.
    fn place(&self, range_m: f32) -> Option<(usize, f32)> {
        let x = range_m / self.header.step_m;
        if !(x >= 0.0 && x <= (self.ranges - 1) as f32) {
            return None;
        }
        let j = (x as usize).min(self.ranges - 2);
        Some((j, x - j as f32))
    }

    /// Travel time of the first arrival from a range, s, linear between rows; `None` where the table is silent.
    pub fn travel_time_s(&self, range_m: f32) -> Option<f32> {
        let (j, part) = self.place(range_m)?;
        blend(self.value(0, j)?, self.value(0, j + 1)?, part)
    }

    /// Delay (s), phase (rad) and strength of a branch at a range, linear between rows (the phase the short way
    /// round); `None` where the branch does not exist.
    pub fn branch(&self, branch: usize, range_m: f32) -> Option<(f32, f32, f32)> {
        if branch >= self.branches {
            return None;
        }
        let (j, part) = self.place(range_m)?;
        let at = |column, row| self.value(1 + 3 * branch + column, row);
        let delay = blend(at(0, j)?, at(0, j + 1)?, part)?;
        let phase = at(1, j)?;
        let turn = crate::angle::wrap_pi_f32(at(1, j + 1)? - phase);
        let phase = blend(phase, phase + turn, part)?;
        let strength = blend(at(2, j)?, at(2, j + 1)?, part)?;
        Some((delay, phase, strength))
    }
}

/// Linear between two values; `None` unless those that count are finite.
fn blend(a: f32, b: f32, part: f32) -> Option<f32> {
    let x = if part == 0.0 { a } else { a + (b - a) * part };
    x.is_finite().then_some(x)
}

/// Writes a table into `out`; the bytes used.
///
/// # Errors
/// [`TableError::Size`] for unlike slices or too many of them, [`TableError::Length`] if `out` is too short,
/// [`TableError::Value`] for values no table may hold.
pub fn encode(
    header: &Header,
    travel_time_s: &[f32],
    branches: &[BranchColumns<'_>],
    out: &mut [u8],
) -> Result<usize, TableError> {
    let ranges = travel_time_s.len();
    let same = |c: &BranchColumns<'_>| [c.delay_s, c.phase_rad, c.strength].iter().all(|s| s.len() == ranges);
    if !(1..=MAX_BRANCHES).contains(&branches.len())
        || !(2..=MAX_RANGES).contains(&ranges)
        || !branches.iter().all(same)
    {
        return Err(TableError::Size);
    }
    let wanted = blob_bytes(branches.len(), ranges);
    let out = out.get_mut(..wanted).ok_or(TableError::Length(wanted))?;
    let (body, tail) = out.split_last_chunk_mut::<CHECKSUM_BYTES>().ok_or(TableError::Length(wanted))?;
    let head = MAGIC
        .into_iter()
        .chain(VERSION.to_le_bytes())
        .chain((branches.len() as u16).to_le_bytes())
        .chain((ranges as u16).to_le_bytes())
        .chain([0, 0])
        .chain([header.step_m, header.f0_hz, header.width_s].into_iter().flat_map(f32::to_le_bytes));
    let columns = core::iter::once(travel_time_s)
        .chain(branches.iter().flat_map(|c| [c.delay_s, c.phase_rad, c.strength]))
        .flatten()
        .flat_map(|x| x.to_le_bytes());
    body.iter_mut().zip(head.chain(columns)).for_each(|(slot, byte)| *slot = byte);
    *tail = fnv1a(body).to_le_bytes();
    Table::parse(out)?;
    Ok(wanted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    fn example() -> Vec<u8> {
        let toa = [f32::NAN, 1.0, 2.0];
        let delay = [f32::NAN, 5.0, 4.0];
        let phase = [f32::NAN, 3.0, -3.0];
        let strength = [0.0, 0.1, 0.2];
        let c = BranchColumns { delay_s: &delay, phase_rad: &phase, strength: &strength };
        let mut out = vec![0; blob_bytes(2, 3)];
        let h = Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 };
        assert_eq!(encode(&h, &toa, &[c, c], &mut out), Ok(out.len()));
        out
    }

    #[test]
    fn round_trip_with_interpolation_and_gaps() {
        let bytes = example();
        let t = Table::parse(&bytes).unwrap();
        assert_eq!((t.branches(), t.ranges(), t.max_range_m()), (2, 3, 140.0));
        assert_eq!(t.travel_time_s(105.0), Some(1.5));
        assert_eq!(t.travel_time_s(35.0), None);
        assert_eq!(t.travel_time_s(141.0), None);
        let (tau, phi, a) = t.branch(1, 105.0).unwrap();
        assert_eq!(tau, 4.5);
        assert!((crate::angle::wrap_pi_f32(phi) - core::f32::consts::PI).abs() < 1e-5, "{phi}");
        assert!((a - 0.15).abs() < 1e-6);
        assert_eq!(t.branch(0, 30.0), None);
        assert_eq!(t.branch(2, 100.0), None);
    }

    #[test]
    fn damage_is_named() {
        let good = example();
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
    }

    #[test]
    fn impossible_values_are_refused() {
        let (h, x) = (Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 }, [1.0f32, 1.0]);
        let mut out = vec![0; blob_bytes(1, 2)];
        let bad = BranchColumns { delay_s: &[-1.0, 1.0], phase_rad: &x, strength: &x };
        assert_eq!(encode(&h, &x, &[bad], &mut out), Err(TableError::Value));
        let good = BranchColumns { delay_s: &x, phase_rad: &x, strength: &x };
        assert_eq!(encode(&h, &x, &[good], &mut out[..20]), Err(TableError::Length(blob_bytes(1, 2))));
        assert_eq!(encode(&Header { step_m: 0.0, ..h }, &x, &[good], &mut out), Err(TableError::Value));
    }
}
