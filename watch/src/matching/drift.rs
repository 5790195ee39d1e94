//! How the difference of a track from a vessel changes while the line of sight turns.

use crate::report::Covariance;

/// Standard deviation by which the difference from the track's own vessel changes between the halves of a track, in those of a
/// report: what reports do not share of their error.
const DRIFT: f64 = 0.5;

/// Differences of a track from a vessel along and across the line of sight, in standard deviations, report after report. From
/// its own vessel they stay nearly what they are. One that goes along at a distance is now more ahead, now more beside of it, as
/// the line of sight turns.
#[derive(Clone, Debug, Default)]
pub(super) struct Drift(Vec<(f64, f64)>);

impl Drift {
    /// Takes a difference (East and North) with its covariance, of a vessel at a place seen from the station.
    pub(super) fn add(&mut self, (dx, dy): (f64, f64), covariance: Covariance, (x, y): (f64, f64)) {
        let range = x.hypot(y);
        let (s, c) = if range > 0.0 { (x / range, y / range) } else { (0.0, 1.0) };
        let Covariance { xx, yy, xy } = covariance;
        let along = (dx * s + dy * c) / (s * s * xx + c * c * yy + 2.0 * s * c * xy).sqrt();
        let across = (dx * c - dy * s) / (c * c * xx + s * s * yy - 2.0 * s * c * xy).sqrt();
        self.0.push((along, across));
    }

    /// Likelihood of the change from the first half to the second, 1 where there is none.
    pub(super) fn likelihood(&self) -> f64 {
        let half = self.0.len() / 2;
        let mean = |part: &[(f64, f64)]| {
            let n = part.len().max(1) as f64;
            (part.iter().map(|p| p.0).sum::<f64>() / n, part.iter().map(|p| p.1).sum::<f64>() / n)
        };
        let (before, after) = (&self.0[..half], &self.0[self.0.len() - half..]);
        let ((a, b), (c, d)) = (mean(before), mean(after));
        (-0.5 * ((c - a).powi(2) + (d - b).powi(2)) / (DRIFT * DRIFT)).exp()
    }
}
