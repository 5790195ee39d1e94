//! Tonal directions: the wrapped-Cauchy detector of [O 7 to 13], in the log domain, with several modes.
//!
//! Enters: the azigram rows of a window (17 or 18 frames of three minutes). Leaves: modes, each with azimuth, spread and
//! its presence ratio. A tone fills one bin in every frame, so a bin's evidence for azimuth a is the product over
//! frames of `w(u, a) = WC(u; a, R) / uniform`, and a window's is the mean of that over bins [O 11] and azimuths [O 12].
//!
//! Beyond \[O\], unless paper compatibility is asked for:
//! - R is unknown: w is a mixture of three R and a little uniform, so noise costs bounded evidence. Each factor keeps
//!   mean one in noise, therefore P(ratio > x) ≤ 1/x there and the threshold x = 10⁴ bounds false detections.
//! - A second way to be no vessel: motion of the instrument along an axis, unrelated to pressure, points either way
//!   at random. The evidence is divided by 1 + that hypothesis's own ratio.
//! - A third: ambient noise with a direction, learned in each bin over hours (see `ambient`).
//! - A fourth: short sounds rich in frequency. In frames whose pressure is uneven in time the bin's neighbours tell what
//!   directions a call gives it; and since a call lies in both frames that overlap it, such frames count half against it.
//! - The phase between pressure and velocity must be steady over the window as well.
//! - What fills three eighths of the band must be surer than a line: a sound of minutes that swells or fades does so in some frames only.
//! - Bins that agree with the strongest mode within their own spread are set aside and the rest searched again: several
//!   vessels give several modes.
//!
//! Cost: 0.2 M instructions a window in noise, up to 15 M when every bin carries a vessel.

use super::ambient::Ambient;
use super::between::Between;
use super::cauchy::{Codes, Profile, WrappedCauchy, distance, step_of};
use super::evened::Evened;
use super::limits::{AZIMUTH_BINS, AZIMUTH_MODES, AZIMUTHS, CIRCLE, SPAN};
use super::row::Row;
use super::shared::Tonal;
use crate::math::{self, log_sum};

/// Natural logarithm of the presence ratio a mode must exceed: 10⁴, so that noise passes at most once in 10⁴ windows.
const LOG_THRESHOLD: f32 = 9.21;

/// Mean over a window of its frames' unevenness, in eighths, from which on every frame of it may hold a call: calls of a whale so far away
/// that none stands out of its frame, and their echoes, are heard in all of them (17.8 to 19.8; noise and vessels 14 to 19, in the median
/// 16). The neighbours of a vessel's tone do not point its way, and it is told from them even then.
const LIVELY: f32 = 17.0;

/// Fewest frames a window needs.
const LEAST_FRAMES: usize = 8;

/// Half the width within which bins add to a vessel's azimuth, in azimuth steps (15 degrees).
pub(super) const SAME_VESSEL: usize = 11;

/// Standard deviations of a bin's own direction within which it may be a vessel's that is farther off, at most
/// [`FARTHEST`] azimuth steps (45 degrees): a vessel fills dozens of bins a minute, and the worst of a day must not pass for
/// another vessel.
const WITHIN: f32 = 5.0;
const FARTHEST: f32 = 32.0;

/// One direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Azimuth, radians clockwise from true North.
    pub azimuth: f32,
    /// Its standard deviation, rad.
    pub sd: f32,
    /// Natural logarithm of the mode's own presence ratio.
    pub log_presence: f32,
    /// Bins that carry it.
    pub bins: u16,
    /// Azimuth step, for other detectors on the same grid.
    pub step: u16,
    /// Short sounds rich in frequency, not tones: a whale, not a vessel.
    pub impulsive: bool,
    /// By how much its lines have moved since the minute before, relative to their frequency; `None` where it has none that are steady.
    pub moved: Option<f32>,
}

/// What a window says.
#[derive(Clone, Copy, Debug)]
pub struct Directions {
    /// Modes, strongest first.
    pub modes: [Option<Mode>; AZIMUTH_MODES],
    /// Natural logarithm of the presence ratio of the whole window.
    pub log_presence: f32,
    /// That of the strongest direction too weak to be a mode; −∞ where there was none.
    pub log_below: f32,
    /// Frames used.
    pub frames: usize,
}

/// A call fills at least this share of the band's bins, the inverse of it; a vessel's tones fewer.
const CALL_BINS: usize = 8;

/// Logarithm of the presence ratio of a window without directions.
const NO_PRESENCE: f32 = -60.0;

impl Directions {
    /// Says nothing, as of frames without directions.
    pub(super) fn withhold(&mut self) {
        self.modes = [None; AZIMUTH_MODES];
        self.log_presence = NO_PRESENCE;
        self.log_below = f32::NEG_INFINITY;
    }

    /// Gives the modes their true azimuths, where noise along an axis was weighed.
    pub(super) fn turn_back(&mut self, evened: &Evened) {
        for m in self.modes.iter_mut().flatten() {
            let (azimuth, slope) = evened.told(m.azimuth);
            if slope != 1.0 {
                let least = LEAST_SD * LEAST_SD;
                let var = (m.sd * m.sd - least).max(0.0) * slope * slope * evened.unsure();
                m.sd = math::f32::sqrt(var + least);
            }
            m.azimuth = azimuth;
        }
    }

    /// Gives the modes that are a call's (its direction, and many bins) to the call.
    pub fn attribute(&mut self, azimuth: f32, bins: usize) {
        for m in self.modes.iter_mut().flatten() {
            let near = math::f32::abs(crate::angle::wrap_pi_f32(m.azimuth - azimuth)) < 0.35;
            m.impulsive = near && CALL_BINS * usize::from(m.bins) >= bins;
        }
    }
}

impl WrappedCauchy {
    /// Searches a window. `rows` are the frames in it, in any order.
    pub fn search(&self, bins: usize, ambient: &Ambient, s: &mut Tonal, rows: &[&Row]) -> Directions {
        let mut out = Directions {
            modes: [None; AZIMUTH_MODES],
            log_presence: NO_PRESENCE,
            log_below: f32::NEG_INFINITY,
            frames: rows.len(),
        };
        if out.frames < LEAST_FRAMES {
            return out;
        }
        self.weigh_bins(bins, ambient, s, rows);
        for slot in &mut out.modes {
            let Some(mode) = self.next_mode(bins, s, rows) else { break };
            let wideband = WIDEBAND.1 * usize::from(mode.bins) >= WIDEBAND.0 * bins;
            if !self.paper && wideband && mode.log_presence < SURE_WIDEBAND {
                continue;
            }
            if out.log_presence < mode.log_presence {
                out.log_presence = mode.log_presence;
            }
            let threshold = if self.paper { 0.0 } else { LOG_THRESHOLD };
            if mode.log_presence <= threshold {
                out.log_below = mode.log_presence;
                break;
            }
            *slot = Some(mode);
        }
        out
    }

    /// Finds the bins worth a full profile, and their peak and correction.
    fn weigh_bins(&self, bins: usize, ambient: &Ambient, s: &mut Tonal, rows: &[&Row]) {
        s.free = [0; AZIMUTH_BINS];
        s.peak = [0.0; AZIMUTH_BINS];
        // A short sound lies in both frames that overlap it: against one, uneven frames count half.
        let frames = rows.len().max(1) as f32;
        let lively = rows.iter().map(|r| f32::from(r.uneven)).sum::<f32>() > LIVELY * frames;
        let may_hold_a_call = |r: &Row| lively || r.may_hold_a_call();
        let bursts = rows.iter().filter(|r| r.may_hold_a_call()).count();
        let share = 1.0 - 0.5 * bursts as f32 / frames;
        let weights =
            s.peak.iter_mut().zip(&mut s.adjust).zip(&mut s.best).zip(&mut s.free).zip(&mut s.reach);
        for (f, ((((peak, adjust), best), free), reach)) in weights.enumerate().take(bins) {
            let codes = Codes::of(rows, f);
            let frames = codes.azimuths().len();
            if frames < LEAST_FRAMES {
                continue;
            }
            // Two fifths of the frames must point one way, or the bin cannot matter.
            let Some(middle) = codes.crowd((2 * frames).div_ceil(5)) else { continue };
            s.profile = [0.0; SPAN];
            self.accumulate(&codes, middle, &mut s.profile);
            let (k, top) = top(&s.profile);
            let step = step_of(middle, k);
            *adjust = if self.paper {
                0.0
            } else {
                let noise = ambient.log_ratio(f, codes.azimuths());
                let axial = self.log_axial(step, &codes);
                let phase = self.log_steady_phase(&codes);
                let short = self.log_short(rows.iter().filter(|r| may_hold_a_call(r)), f, bins);
                let against_short = share * (top + phase - short) - top;
                (phase - log_sum(log_sum(0.0, axial), noise)).min(against_short)
            };
            (*peak, *best, *free) = (top + *adjust, step as u16, 1);
            let spread = if self.paper { 0.0 } else { WITHIN * codes.sd_of_mean(step) };
            *reach = spread.max(SAME_VESSEL as f32).min(FARTHEST) as u16;
        }
    }

    /// The strongest direction among the bins still free; its bins are set aside.
    fn next_mode(&self, bins: usize, s: &mut Tonal, rows: &[&Row]) -> Option<Mode> {
        let top_peak = free_bins(s).map(|(_, p, _)| p).fold(f32::NEG_INFINITY, f32::max);
        if !top_peak.is_finite() {
            return None;
        }
        // The mean over bins and azimuths [O 11, 12]; bins e²⁰ below the best cannot change it.
        s.sum = [0.0; AZIMUTHS];
        for f in 0..bins.min(AZIMUTH_BINS) {
            let (free, peak, adjust) = (get(&s.free, f), get(&s.peak, f), get(&s.adjust, f));
            if free == 0 || peak < top_peak - 20.0 {
                continue;
            }
            let middle = usize::from(get(&s.best, f));
            s.profile = [0.0; SPAN];
            self.accumulate(&Codes::of(rows, f), middle, &mut s.profile);
            let shift = adjust - top_peak;
            for (k, l) in s.profile.iter().enumerate() {
                let x = l + shift;
                if x > -20.0
                    && let Some(sum) = s.sum.get_mut(step_of(middle, k))
                {
                    *sum += math::f32::exp(x);
                }
            }
        }
        let total: f32 = s.sum.iter().sum();
        let (best, _) = top(&s.sum);
        let log_presence = top_peak + math::f32::ln(total.max(1e-30) / (AZIMUTHS * bins.max(1)) as f32);
        // Refine with every bin that agrees, not only the best: their product.
        s.profile = [0.0; SPAN];
        let mut used = 0u16;
        for f in 0..bins.min(AZIMUTH_BINS) {
            let apart = distance(usize::from(get(&s.best, f)), best);
            if get(&s.free, f) == 0 || apart > usize::from(get(&s.reach, f)) {
                continue;
            }
            if let Some(free) = s.free.get_mut(f) {
                *free = 0;
            }
            if apart <= SAME_VESSEL && (get(&s.peak, f) > 0.0 || self.paper) {
                used += 1;
                self.accumulate(&Codes::of(rows, f), best, &mut s.profile);
            }
        }
        let (step, part) = if self.paper { (best, 0.0) } else { refine(&s.profile, best) };
        let azimuth = (step as f32 + part) * (math::f32::TAU / AZIMUTHS as f32);
        let (lean, var) = self.weighted(bins, s, rows, best, azimuth);
        let sd = math::f32::sqrt(var + LEAST_SD * LEAST_SD);
        Some(Mode {
            azimuth: crate::angle::wrap_tau_f32(if self.paper { azimuth } else { azimuth + lean }),
            sd,
            log_presence,
            bins: used,
            step: step as u16,
            impulsive: false,
            moved: None,
        })
    }

    /// How far the mode's bins lean from `azimuth` in the mean, rad, and that mean's variance, rad². Never inlined: it would
    /// be copied for every mode.
    ///
    /// Each bin counts by its own scatter, for bins of strong tones point more closely than those of weak ones. A limit cuts
    /// off what lies farther than [`TAKEN`], so that a bin answers a turn of its vessel by less than the whole: by one less
    /// the density at the limit times its width (the slope of a truncated mean). Of [`ALIKE`] directions one is independent.
    /// Where bins point apart the direction may be that of two vessels heard as one, and the variance allows for it (see `between`).
    /// Bins of wideband sound, of which hardly one is sure by itself, are those that chance let point alike, and scatter more than they show: where the
    /// mean of their log ratios is below [`BY_THEMSELVES`] the variance is up to twice as large.
    #[inline(never)]
    fn weighted(&self, bins: usize, s: &Tonal, rows: &[&Row], best: usize, azimuth: f32) -> (f32, f32) {
        let (mut weights, mut sum) = (0f32, 0f32);
        let (mut peaks, mut used) = (0f32, 0f32);
        let mut between = Between::default();
        for f in 0..bins.min(AZIMUTH_BINS) {
            let (mut lean, mut square, mut n, mut cut) = (0f32, 0f32, 0f32, 0f32);
            let apart = distance(usize::from(get(&s.best, f)), best);
            let peak = get(&s.peak, f);
            if get(&s.free, f) == 0 && peak > 0.0 && apart <= SAME_VESSEL {
                (peaks, used) = (peaks + peak, used + 1.0);
                for c in Codes::of(rows, f).azimuths() {
                    let code = f32::from(*c) * (math::f32::TAU / CIRCLE as f32);
                    let d = crate::angle::wrap_pi_f32(code - azimuth);
                    if d.abs() < TAKEN {
                        (lean, square, n) = (lean + d, square + d * d, n + 1.0);
                        cut += if d.abs() > EDGE { 1.0 } else { 0.0 };
                    }
                }
                let var = (square + FRAMES_BEFORE * VAR_BEFORE) / (n + FRAMES_BEFORE);
                let slope = (1.0 - TAKEN / (TAKEN - EDGE) * cut / n.max(1.0)).max(0.1);
                between.take(lean / (n * slope).max(0.1), n * slope * slope, var);
                lean *= slope / var;
                weights += n * slope * slope / var;
                sum += lean;
            }
        }
        if weights <= 0.0 {
            return (0.0, MOST_VAR);
        }
        let chance = ((BY_THEMSELVES.1 - peaks / used) / (BY_THEMSELVES.1 - BY_THEMSELVES.0)).clamp(0.0, 1.0);
        (sum / weights, ((1.0 + chance) * ALIKE / weights + between.told()).min(MOST_VAR))
    }
}

/// Farther from the azimuth than this a frame's direction is no vessel's, rad (20 degrees).
const TAKEN: f32 = 0.35;

/// From here to [`TAKEN`] a bin's directions are counted for how many the limit cuts off, rad.
const EDGE: f32 = 0.25;

/// Share of the band's bins from which on a mode is a wideband sound's, and the least log presence of a vessel's then. A vessel that fills so
/// many bins is sure in the surest of them (15.1 and more in 2 700 such windows of vessels at 3 to 60 km); a T phase or an earthquake that
/// swells or fades within the window fills them in some of its frames only (mostly below 14.5).
const WIDEBAND: (usize, usize) = (3, 8);
const SURE_WIDEBAND: f32 = 14.5;

/// Directions for one that is independent. Of a tone's three bins errors go together to 2/3 and 1/6 by the Hann window, which makes 2.67 of
/// one, and half-overlapped frames to 1/6, 1.33: 3.55. Those of wideband sound go together to the squares of these: 2.05. A vessel's bins are
/// mostly tones' where it is weak; chosen so that azimuths of vessels 10 dB below the table's level lie in their 95 %.
const ALIKE: f32 = 3.1;

/// Mean log ratio of a mode's bins up to which chance chose them, and from which on it did not. Of vessels with lines 10 dB and more above their
/// wideband sound it is above 12 in 98 of 100 minutes and directions err by 0.8 to 1.06 times what is stated; of those with wideband sound 5 dB up and lines
/// of 12 dB it is 5 to 12 in four of five, and without this they err by 1.4 times (2 400 and 1 500 minutes of twelve vessels).
const BY_THEMSELVES: (f32, f32) = (10.0, 13.0);

/// Frames that a bin's scatter counts for before it is seen, and their variance (5 degrees squared), rad².
const FRAMES_BEFORE: f32 = 2.0;
const VAR_BEFORE: f32 = 0.0076;

/// Greatest variance of an azimuth: that of nothing known within 17 degrees, rad².
const MOST_VAR: f32 = 0.03;

/// What no averaging removes: a third of a degree, the size of an orientation error, rad.
const LEAST_SD: f32 = 0.006;

fn get<T: Copy + Default, const N: usize>(xs: &[T; N], i: usize) -> T {
    xs.get(i).copied().unwrap_or_default()
}

fn free_bins(s: &Tonal) -> impl Iterator<Item = (usize, f32, u16)> + '_ {
    let all = s.free.iter().zip(&s.peak).zip(&s.best).enumerate();
    all.filter(|(_, ((free, _), _))| **free > 0).map(|(f, ((_, p), b))| (f, *p, *b))
}

/// Index and value of the largest.
fn top<const M: usize>(xs: &[f32; M]) -> (usize, f32) {
    xs.iter().enumerate().fold((0, f32::NEG_INFINITY), |b, (i, x)| if *x > b.1 { (i, *x) } else { b })
}

/// Maximum of a joint profile about `middle`, as a step and a fraction by a parabola through its neighbours.
fn refine(profile: &Profile, middle: usize) -> (usize, f32) {
    let near = profile.iter().enumerate().skip(SPAN / 2 - SAME_VESSEL).take(2 * SAME_VESSEL + 1);
    let (best, c) = near.fold((SPAN / 2, f32::NEG_INFINITY), |b, (i, x)| if *x > b.1 { (i, *x) } else { b });
    let at = |i: usize| profile.get(i).copied().unwrap_or(f32::NEG_INFINITY);
    let (l, r) = (at(best - 1), at(best + 1));
    let bend = l - 2.0 * c + r;
    let part = if bend < -1e-6 { (0.5 * (l - r) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    (step_of(middle, best), part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obs::shared::Shared;
    use std::vec::Vec;

    /// Frames of random directions; `calls` bins from 100 on scatter about code 300, `tone` bins about code 800.
    fn window(calls: usize, tone: usize, uneven: u8) -> Vec<Row> {
        let mut seed = 5u32;
        let mut random = move |n: u32| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((seed >> 8) % n) as u16
        };
        let mut rows = Vec::new();
        for _ in 0..18 {
            let mut row = Row::EMPTY;
            row.uneven = uneven;
            row.fill((0..AZIMUTH_BINS).map(|bin| {
                Some(match bin {
                    _ if (130..130 + tone).contains(&bin) => (790 + random(20), 7 + random(2) as u8),
                    _ if (100..100 + calls).contains(&bin) => {
                        (260 + random(40) + random(40), 5 + random(2) as u8)
                    }
                    _ => (random(1024), random(16) as u8),
                })
            }));
            rows.push(row);
        }
        rows
    }

    /// A lone vessel: four bins that point to code 800 closely and one, of a weak tone, that scatters 18° beside it by 12°.
    fn lone() -> Vec<Row> {
        let mut rows = window(0, 4, 14);
        for (n, row) in rows.iter_mut().enumerate() {
            let mut codes: Vec<_> = row.directions().collect();
            codes[180] = Some((781 + (n * 83 % 140) as u16, 5 + (n % 4) as u8));
            row.fill(codes.into_iter());
        }
        rows
    }

    #[test]
    fn a_weak_tone_of_a_lone_vessel_is_no_second_one() {
        let found = modes(&lone());
        assert!(found.len() == 1 && (found[0] - 281.0).abs() < 2.0, "{found:?}");
    }

    fn modes(rows: &[Row]) -> Vec<f32> {
        let law = WrappedCauchy { paper: false };
        let rows: Vec<&Row> = rows.iter().collect();
        let found = law.search(266, &Ambient::new(), Shared::new().tonal(), &rows);
        found.modes.iter().flatten().map(|m| m.azimuth.to_degrees()).collect()
    }

    #[test]
    fn calls_are_no_tone_and_hide_none() {
        assert!(modes(&window(0, 0, 14)).is_empty());
        assert!(modes(&window(60, 0, 40)).is_empty());
        // The same directions, steady: a vessel's wideband noise.
        let steady = modes(&window(60, 0, 14));
        assert!(steady.len() == 1 && (steady[0] - 105.0).abs() < 3.0, "{steady:?}");
        let tone = modes(&window(60, 3, 40));
        assert!(tone.len() == 1 && (tone[0] - 281.0).abs() < 2.0, "{tone:?}");
    }

    #[test]
    fn a_wideband_sound_that_fades_within_the_window_is_no_tone() {
        // Full of one direction in the first frames, and of none in the others.
        let fading = |full: usize, bins: usize, tone: usize| {
            let mut rows = window(bins, tone, 14);
            let empty = window(0, tone, 14);
            for (row, other) in rows.iter_mut().zip(empty).skip(full) {
                *row = other;
            }
            modes(&rows)
        };
        for full in 6..10 {
            assert!(fading(full, 140, 0).is_empty(), "{full}");
        }
        assert_eq!(fading(18, 140, 0).len(), 1);
        // A vessel beside it is heard, and so is one whose few bins fade.
        assert_eq!(fading(8, 140, 3).len(), 1);
    }

    #[test]
    fn calls_of_which_none_stands_out_of_its_frame_are_no_tone_and_hide_none() {
        // Faint: three of eight bins of a frame point elsewhere.
        let faint = |tone, uneven| {
            let mut rows = window(60, tone, uneven);
            for (n, row) in rows.iter_mut().enumerate() {
                let mut codes: Vec<_> = row.directions().collect();
                for (bin, code) in codes.iter_mut().enumerate().take(160).skip(100) {
                    let tonal = (130..130 + tone).contains(&bin);
                    *code = code.map(|(a, p)| {
                        if tonal || (bin * 7 + n * 11) % 16 < 10 {
                            (a, p)
                        } else {
                            (
                                ((usize::from(a) + bin * 389 + n * 241) % 1024) as u16,
                                ((bin * 5 + n * 7) % 16) as u8,
                            )
                        }
                    });
                }
                row.fill(codes.into_iter());
            }
            modes(&rows)
        };
        let calls = faint(0, 19);
        assert!(calls.is_empty(), "{calls:?}");
        assert_eq!(faint(0, 14).len(), 1);
        let tone = faint(3, 19);
        assert!(tone.len() == 1 && (tone[0] - 281.0).abs() < 2.0, "{tone:?}");
    }
}
