//! The tones of a ship: lines that come from where its track points, minute after minute, as they were radiated.
//!
//! Enters: lines of each minute with their directions (`far/tones.rs`, 0.008 Hz wide). A line within 12° of the track counts, at its
//! frequency without the track's Doppler shift; minutes in which another track is near count for none. A tone is a frequency that is heard
//! in a tenth of the minutes. Lines of noise come from within 12° of a track once in fifteen times, at any frequency, and are not.

use super::super::far::tones::Minute;
use super::Way;
use crate::angle::turn_deg;
use std::collections::BTreeSet;

/// A line is a track's if its direction is no farther off, degrees.
const TOWARDS_DEG: f64 = 12.0;
/// Another track nearer than this takes the minute, degrees.
const ALONE_DEG: f64 = 20.0;
/// Half the width of a tone, Hz: what the straight path's shift leaves of the others', and what engines wander.
const HALF_HZ: f64 = 0.04;
/// Step in which frequencies are counted, Hz, and their end.
const STEP_HZ: f64 = 0.01;
const MOST_HZ: f64 = 25.0;
/// Share of the minutes, and number, in which a tone is heard at least.
const LEAST: (f64, usize) = (0.1, 8);
/// Tones that are told at most.
const MOST: usize = 12;

/// Teeth of a comb at least, and the highest tooth that a tone may be.
const TEETH: usize = 3;
const HIGHEST: u32 = 12;
/// Share of the teeth up to the highest that are there at least, of those that can be heard: of a third or a half of the spacing fewer are.
const THERE: f64 = 0.75;
/// Where lines are looked for from, Hz.
const BAND_FROM_HZ: f64 = super::super::far::tones::BAND_HZ.0;
/// Standard deviation of a tone at least, Hz: its lines are 0.008 Hz wide.
const TONE_SD_HZ: f64 = 0.002;
/// How far a tooth may be off its place, Hz.
const OFF_HZ: f64 = 0.02;
/// Least spacing, Hz: below it everything is a multiple.
const LEAST_SPACING_HZ: f64 = 1.0;

/// A tone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShipTone {
    /// Frequency as radiated, Hz.
    pub hz: f64,
    /// Share of the minutes in which it was heard, 0 to 1.
    pub share: f64,
}

/// A comb of tones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comb {
    /// Its spacing, Hz: a blade or shaft rate.
    pub hz: f64,
    /// Standard deviation of that, Hz.
    pub sd_hz: f64,
}

/// The tones of one of the ways, the most steadily heard first.
pub(super) fn of(ways: &[Way<'_>], k: usize, lines: &[Minute]) -> Vec<ShipTone> {
    let Some(own) = ways.get(k) else { return Vec::new() };
    let others = |t_s: f64| {
        ways.iter()
            .enumerate()
            .any(|(j, other)| j != k && other.is_heard(t_s) && own.apart_deg(other, t_s) < ALONE_DEG)
    };
    let mut heard: Vec<(f64, usize)> = Vec::new();
    let mut minutes = 0;
    for minute in lines.iter().filter(|m| own.is_heard(m.t_s) && !others(m.t_s)) {
        let azimuth_deg = own.azimuth_deg(minute.t_s);
        let radiated = own.radiated(minute.t_s);
        let towards =
            minute.lines.iter().filter(|l| turn_deg(azimuth_deg, l.azimuth.to_degrees()).abs() < TOWARDS_DEG);
        heard.extend(towards.map(|l| (l.hz * radiated, minutes)));
        minutes += 1;
    }
    let least = (LEAST.0 * minutes as f64).max(LEAST.1 as f64);
    let mut out = Vec::new();
    while out.len() < MOST {
        let Some((hz, n)) = fullest(&heard) else { break };
        if (n as f64) < least {
            break;
        }
        let near = |h: &&(f64, usize)| (h.0 - hz).abs() <= HALF_HZ;
        let mut own: Vec<f64> = heard.iter().filter(near).map(|h| h.0).collect();
        let hz = seabearing_core::kit::median(&mut own).unwrap_or(hz);
        heard.retain(|h| (h.0 - hz).abs() > 2.0 * HALF_HZ);
        out.push(ShipTone { hz, share: n as f64 / minutes as f64 });
    }
    out
}

/// The frequency about which lines of most minutes are, and of how many.
fn fullest(heard: &[(f64, usize)]) -> Option<(f64, usize)> {
    let steps = (MOST_HZ / STEP_HZ) as usize + 1;
    let reach = (HALF_HZ / STEP_HZ) as usize;
    let mut minutes: Vec<Vec<usize>> = vec![Vec::new(); steps];
    for (hz, minute) in heard {
        let at = (hz / STEP_HZ).round() as usize;
        for cell in minutes.iter_mut().take(at + reach + 1).skip(at.saturating_sub(reach)) {
            // Minutes come in order: a second line of one is its last.
            if cell.last() != Some(minute) {
                cell.push(*minute);
            }
        }
    }
    let (at, own) =
        minutes.iter().enumerate().max_by(|a, b| a.1.len().cmp(&b.1.len()).then(b.0.cmp(&a.0)))?;
    (!own.is_empty()).then_some((at as f64 * STEP_HZ, own.len()))
}

/// The spacing of which most tones, at least three and more than chance gives, are neighbouring multiples; of several the greatest. `None`
/// too where its teeth may as well be those of two combs that have the spacing in common.
pub(super) fn comb(tones: &[ShipTone]) -> Option<Comb> {
    let spacings = tones.iter().flat_map(|t| (1..=HIGHEST).map(|n| t.hz / f64::from(n)));
    let fitting = spacings.filter(|s| *s >= LEAST_SPACING_HZ).filter_map(|spacing| {
        let tooth = |hz: f64| (hz / spacing).round().max(1.0);
        let teeth: Vec<(f64, f64)> = tones
            .iter()
            .map(|t| (t.hz, tooth(t.hz)))
            .filter(|(hz, n)| *n <= f64::from(HIGHEST) && (hz - n * spacing).abs() <= OFF_HZ)
            .collect();
        // Tones that are there by chance are this often near a multiple; one fits because the spacing was made of it.
        let chance = (2.0 * OFF_HZ / spacing).min(1.0) * tones.len() as f64;
        let distinct: BTreeSet<u32> = teeth.iter().map(|t| t.1 as u32).collect();
        let enough = distinct.len() >= TEETH && teeth.len() as f64 > 2.0 + 4.0 * chance;
        (enough && is_whole(&distinct, spacing) && !is_of_two(&distinct))
            .then(|| (teeth.len(), Comb::through(&teeth)))
    });
    let all: Vec<(usize, Comb)> = fitting.collect();
    let most = all.iter().map(|a| a.0).max()?;
    all.into_iter().filter(|a| a.0 == most).map(|a| a.1).max_by(|a, b| a.hz.total_cmp(&b.hz))
}

/// Whether enough of the teeth that can be heard, up to the highest that is there, are.
fn is_whole(teeth: &BTreeSet<u32>, spacing: f64) -> bool {
    let first = (BAND_FROM_HZ / spacing).ceil().max(1.0) as u32;
    let Some(last) = teeth.last() else { return false };
    let heard = teeth.range(first..).count() as f64;
    heard >= THERE * f64::from((last + 1).saturating_sub(first))
}

/// Whether every tooth is one of two combs whose spacings are multiples of this one, so that none speaks for it alone: 2, 3, 4, 6.
fn is_of_two(teeth: &BTreeSet<u32>) -> bool {
    let wider =
        |of: &[u32]| -> Vec<u32> { (2..=HIGHEST).filter(|d| of.iter().all(|n| n % d == 0)).collect() };
    let all: Vec<u32> = teeth.iter().copied().collect();
    !wider(&all).is_empty()
        || (2..=HIGHEST).any(|d| {
            let rest: Vec<u32> = all.iter().copied().filter(|n| n % d != 0).collect();
            rest.len() < all.len() && !wider(&rest).is_empty()
        })
}

impl Comb {
    /// The spacing that teeth of these frequencies and numbers together say.
    fn through(teeth: &[(f64, f64)]) -> Self {
        let (up, down) = teeth.iter().fold((0.0, 0.0), |(u, d), (hz, n)| (u + n * hz, d + n * n));
        let hz = up / down;
        let square: f64 = teeth.iter().map(|(f, n)| (f - n * hz).powi(2)).sum();
        let free = (teeth.len() as f64 - 1.0).max(1.0);
        // Of few teeth their scatter is not well known either (Student's law).
        let scatter = (square / free).sqrt() * (1.0 + 1.25 / free);
        Self { hz, sd_hz: scatter.max(TONE_SD_HZ) / down.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::far::tones::Line;
    use super::super::course::tests::{passage, way};
    use super::*;

    fn tones(hz: &[f64]) -> Vec<ShipTone> {
        hz.iter().map(|hz| ShipTone { hz: *hz, share: 0.5 }).collect()
    }

    #[test]
    fn a_ships_tones_are_found_among_anothers_and_noise_as_they_are_radiated() {
        let (a, b) = (passage(1, 5000.0), passage(2, -9000.0));
        let ways = [way(&a), way(&b)];
        let mut seed = 9u64;
        let mut random = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 53) as f64
        };
        let lines: Vec<Minute> = (2..119)
            .map(|m| {
                let t_s = 60.0 * f64::from(m);
                let line = |hz: f64, way: &Way<'_>, off_deg: f64| Line {
                    hz: hz / way.radiated(t_s),
                    azimuth: (way.azimuth_deg(t_s) + off_deg).to_radians().rem_euclid(std::f64::consts::TAU),
                    stands_out: 20.0,
                };
                let mut lines =
                    vec![line(12.6, &ways[0], 3.0), line(20.7, &ways[0], -4.0), line(17.0, &ways[1], 2.0)];
                lines.extend((0..20).map(|_| Line {
                    hz: 5.0 + 19.5 * random(),
                    azimuth: std::f64::consts::TAU * random(),
                    stands_out: 13.0,
                }));
                Minute { t_s, lines }
            })
            .collect();
        let mut own = of(&ways, 0, &lines);
        own.sort_by(|a, b| a.hz.total_cmp(&b.hz));
        assert_eq!(own.len(), 2, "{own:?}");
        assert!((own[0].hz - 12.6).abs() < 2e-3 && (own[1].hz - 20.7).abs() < 2e-3 && own[0].share > 0.99);
        let other = of(&ways, 1, &lines);
        assert!(other.len() == 1 && (other[0].hz - 17.0).abs() < 2e-3, "{other:?}");
        assert!(of(&ways, 0, &[]).is_empty());
    }

    #[test]
    fn a_comb_is_its_greatest_spacing_and_tones_of_no_comb_have_none() {
        let near = |hz: &[f64], spacing: f64| {
            let found = comb(&tones(hz)).unwrap();
            assert!(
                (found.hz - spacing).abs() < 4.0 * found.sd_hz && found.sd_hz < 2e-3,
                "{hz:?}: {found:?}"
            );
        };
        near(&[5.4, 10.805, 16.2, 12.6, 17.9], 5.4);
        // Teeth below the band are not missed, and one in four may be.
        near(&[6.0, 8.0, 10.0, 12.0, 16.0], 2.0);
        near(&[5.1, 6.8, 8.5, 10.2, 11.9, 13.6, 15.3, 17.0, 18.7, 20.4, 22.1, 23.8], 1.7);
        // Without the first tooth they may as well be a comb of 10.8 and a tone.
        assert_eq!(comb(&tones(&[10.8, 16.2, 21.6])), None);
        assert_eq!(comb(&tones(&[12.1, 14.3, 16.9, 18.2, 20.6, 22.7])), None);
        assert_eq!(comb(&tones(&[12.0, 24.0])), None);
        assert_eq!(comb(&[]), None);
    }

    #[test]
    fn what_two_combs_have_in_common_is_no_comb() {
        for (blade, engine) in
            [(6.8, 11.9), (7.2, 9.0), (5.0, 8.75), (8.0, 14.0), (6.0, 9.0), (7.5, 11.25), (8.0, 12.0)]
        {
            let mut hz: Vec<f64> = [blade, engine]
                .iter()
                .flat_map(|hz| (1..).map(move |n| hz * f64::from(n)).take_while(|hz| *hz < 24.5))
                .collect();
            hz.sort_by(f64::total_cmp);
            hz.dedup();
            let found = comb(&tones(&hz)).unwrap();
            assert!((found.hz - blade).abs() < 1e-3, "{blade} {engine}: {found:?}");
        }
        // Of neither are enough teeth there.
        assert_eq!(comb(&tones(&[7.5, 11.25, 15.0])), None);
    }
}
