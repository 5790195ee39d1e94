//! Azimuths of calls: what a note's active intensity is over that of the steady sound before and after it.
//!
//! Enters: analytic pressure and horizontal velocities of a window, its notes, and which instants have something cut off. Leaves: one azimuth
//! and its standard deviation, or none.
//!
//! Intensities add, so those of vessels are in a note's as they are between notes. What the pieces about a note give, a note long each, is
//! taken away; pieces louder than [`STEADY`] times the median, another call's or an echo's, are no steady sound. The deviation has the notes'
//! scatter across the mean direction, no less than the pieces', and what is not known of the steady part where notes share their pieces.
//!
//! Peaks are found where a vessel's noise adds to a call's, and some are the vessel's alone, so that more of it is in them than between them: of
//! notes that come steadily all count, heard or not, at the instants of their step. Where no step is found, [`FOUND`] of what was taken away is not sure.

use super::notes::Kind;
use crate::propagation::Complex;
use seabearing_core::kit::quantile;

/// Fewest notes with a direction.
pub(super) const LEAST_NOTES: usize = 3;
/// What is told of a note's surroundings reaches so far, s.
const ABOUT_S: f64 = 15.0;
/// Fewest pieces about a note that tell the steady sound.
const LEAST_PIECES: usize = 4;
/// Most power of a piece over the median: of twelve independent amplitudes five deviations.
const STEADY: f64 = 2.5;
/// Greatest standard deviation of a direction, rad: of notes that agree on none the sum is anywhere.
const MOST_SD: f64 = 0.35;

/// Share of the turn by what was taken away that is not sure where notes stand at their peaks: found notes had 0.1 to 0.25 more of a vessel.
const FOUND: f64 = 0.4;
/// By how much a note may be out of step, s.
const OUT_OF_STEP_S: f64 = 0.15;
/// Fewest notes in step.
const LEAST_IN_STEP: usize = 4;

/// Instants of notes that come steadily, from the first to the last that was heard, those between them that were not heard included; `None` where
/// two thirds of the notes are in no step.
fn in_step(notes: &[usize], steps_s: (f64, f64), rate_hz: f64) -> Option<Vec<usize>> {
    let t: Vec<f64> = notes.iter().map(|n| *n as f64 / rate_hz).collect();
    // Notes in step: number of each, counted from `from`, and instant.
    let those = |from: f64, step: f64, off_s: &dyn Fn(f64) -> f64| -> Vec<(f64, f64)> {
        let numbered = t.iter().map(|t| (((t - from) / step).round(), *t));
        numbered.filter(|(k, t)| (t - from - k * step).abs() < off_s(*k)).collect()
    };
    let mut best: Option<(usize, f64, f64)> = None;
    for (i, from) in t.iter().enumerate() {
        let later = t.iter().skip(i + 1).take(3).flat_map(|to| [to - from, 0.5 * (to - from)]);
        for step in later.filter(|s| (steps_s.0..=steps_s.1).contains(s)) {
            // A step from two notes errs the more the farther it is carried.
            let found = those(*from, step, &|k| OUT_OF_STEP_S * (0.3 * k.abs() + 1.0));
            let (Some(first), Some(last)) = (found.first(), found.last()) else { continue };
            let enough = found.len() >= LEAST_IN_STEP && 3 * found.len() >= 2 * t.len();
            let dense = 2.0 * found.len() as f64 > last.0 - first.0 + 1.0;
            // Half the step has all that the step has.
            let better = best.is_none_or(|(n, s, _)| (found.len(), step) > (n, s));
            if enough && dense && better {
                best = Some((found.len(), step, *from));
            }
        }
    }
    let (_, mut step, mut from) = best?;
    let mut found = those(from, step, &|k| OUT_OF_STEP_S * (0.3 * k.abs() + 1.0));
    for _ in 0..2 {
        let n = found.len() as f64;
        let (k0, t0) = found.iter().fold((0.0, 0.0), |s, (k, t)| (s.0 + k / n, s.1 + t / n));
        let (kt, kk) =
            found.iter().fold((0.0, 0.0), |s, (k, t)| (s.0 + (k - k0) * (t - t0), s.1 + (k - k0).powi(2)));
        if kk == 0.0 {
            return None;
        }
        step = kt / kk;
        from = t0 - k0 * step;
        found = those(from, step, &|_| 2.0 * OUT_OF_STEP_S);
        if found.len() < LEAST_IN_STEP {
            return None;
        }
    }
    let (first, last) = (found.first()?.0 as i64, found.last()?.0 as i64);
    Some((first..=last).map(|k| ((from + step * k as f64) * rate_hz).round() as usize).collect())
}

/// A stretch as long as a note.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Its middle, samples.
    at: usize,
    power: f64,
    /// Active intensity, East and North.
    intensity: [f64; 2],
}

/// Pressure and the horizontal velocities of a window, each analytic.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field<'a> {
    pub(super) notes: Kind,
    pub(super) pressure: &'a [Complex<f64>],
    pub(super) north: &'a [Complex<f64>],
    pub(super) east: &'a [Complex<f64>],
    pub(super) rate_hz: f64,
}

impl Field<'_> {
    /// Half a note, samples.
    fn half(&self) -> usize {
        (self.notes.half_s * self.rate_hz) as usize
    }

    /// The stretch about an instant.
    fn piece(&self, at: usize) -> Piece {
        let span = at.saturating_sub(self.half())..(at + self.half() + 1).min(self.pressure.len());
        let mut piece = Piece { at, power: 0.0, intensity: [0.0; 2] };
        for k in span {
            let p = self.pressure[k];
            piece.power += p.norm_sqr();
            piece.intensity[0] += (p.conj() * self.east[k]).re;
            piece.intensity[1] += (p.conj() * self.north[k]).re;
        }
        piece
    }

    /// Pieces of steady sound: clear of the notes, whole, and no louder than such pieces are.
    fn steady(&self, notes: &[usize], whole: impl Fn(usize) -> bool) -> Vec<Piece> {
        let (half, clear) = (self.half(), 4 * self.half());
        let mut pieces: Vec<Piece> = (half..self.pressure.len().saturating_sub(half))
            .step_by(2 * half + 1)
            .filter(|at| notes.iter().all(|note| note.abs_diff(*at) >= clear) && whole(*at))
            .map(|at| self.piece(at))
            .collect();
        let mut powers: Vec<f64> = pieces.iter().map(|p| p.power).collect();
        let most = STEADY * quantile::median(&mut powers).unwrap_or(0.0);
        pieces.retain(|p| p.power <= most);
        pieces
    }

    /// Direction of the notes that are whole, clockwise from the station's North, and its standard deviation, rad; `None` of too few or
    /// where they agree on none. `notes` are all that were found.
    pub(super) fn azimuth(&self, notes: &[usize], whole: impl Fn(usize) -> bool) -> Option<(f64, f64)> {
        let stepped = in_step(notes, self.notes.steps_s, self.rate_hz);
        let notes = stepped.as_deref().unwrap_or(notes);
        let steady = self.steady(notes, &whole);
        let own: Vec<Piece> =
            notes.iter().filter(|note| whole(**note)).map(|note| self.piece(*note)).collect();
        if own.len() < LEAST_NOTES || steady.len() < LEAST_PIECES {
            return None;
        }
        let about = (ABOUT_S * self.rate_hz) as usize;
        // How much of each piece is taken away in all, and what of its variance the notes' own scatter shows.
        let mut taken = vec![(0.0, 0.0); steady.len()];
        let each: Vec<[f64; 2]> = own
            .iter()
            .map(|note| {
                let near = |p: &Piece| p.at.abs_diff(note.at) <= about;
                let count = steady.iter().filter(|p| near(p)).count();
                let all = count < LEAST_PIECES;
                let share = 1.0 / if all { steady.len() } else { count } as f64;
                let mut left = note.intensity;
                for (p, (sum, squares)) in steady.iter().zip(&mut taken).filter(|(p, _)| all || near(p)) {
                    left = [left[0] - share * p.intensity[0], left[1] - share * p.intensity[1]];
                    *sum += share;
                    *squares += share * share;
                }
                left
            })
            .collect();
        let [x, y] = each.iter().fold([0.0; 2], |s, d| [s[0] + d[0], s[1] + d[1]]);
        let length = x.hypot(y);
        if !(length > 0.0) {
            return None;
        }
        let across = |d: [f64; 2]| (d[1] * x - d[0] * y) / length;
        let n = each.len() as f64;
        let scatter = each.iter().map(|d| across(*d).powi(2)).sum::<f64>() * n / (n - 1.0);
        // Neighbours are compared, so that a vessel that goes by is no scatter.
        let steps = steady.windows(2).map(|w| (across(w[1].intensity) - across(w[0].intensity)).powi(2));
        let piece = 0.5 * steps.sum::<f64>() / (steady.len() - 1) as f64;
        let shared: f64 = taken.iter().map(|(sum, squares)| sum * sum - squares).sum();
        let variance = scatter.max(n * piece) + shared * piece;
        // Of few notes their scatter is not well known either (Student's law).
        let sd = (variance.sqrt() / length).max(1e-3) * (1.0 + 1.25 / (n - 1.0));
        let with_all =
            own.iter().fold([0.0; 2], |s, note| [s[0] + note.intensity[0], s[1] + note.intensity[1]]);
        let turned = across(with_all) / with_all[0].hypot(with_all[1]);
        let sd = if stepped.is_some() { sd } else { sd.hypot(FOUND * turned) };
        (sd < MOST_SD).then(|| (x.atan2(y), sd))
    }
}

#[cfg(test)]
mod tests {
    use super::super::notes::FIN;
    use super::*;

    #[test]
    fn notes_in_step_are_counted_heard_or_not_and_others_have_no_step() {
        // Steps of 13 s, of which the fourth is missing and two are others'.
        let notes = [100, 750, 1400, 1800, 2700, 3351, 3999, 4300, 4650];
        let found = in_step(&notes, FIN.steps_s, 50.0).unwrap();
        let expected = [100, 750, 1400, 2050, 2700, 3350, 4000, 4650];
        assert_eq!(found.len(), expected.len());
        assert!(found.iter().zip(expected).all(|(f, e)| f.abs_diff(e) <= 3), "{found:?}");
        assert_eq!(in_step(&[100, 750, 1270, 2100, 2600, 3700, 4190, 5000], FIN.steps_s, 50.0), None);
        assert_eq!(in_step(&[100, 750, 1400], FIN.steps_s, 50.0), None);
        assert_eq!(in_step(&[], FIN.steps_s, 50.0), None);
    }
}
