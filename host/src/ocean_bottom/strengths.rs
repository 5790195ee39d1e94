//! Strength of each interference against range, measured from passages of known track [O App. C, D].
//!
//! Enters: frames of a recording and the courses of its vessels. On each frame with one vessel near, the cepstrum's
//! envelope is read at the delays that the table gives for the vessel's range at emission. In each cell of range,
//! `λ = mean(|Ĉ|²/σ²) − 2` is the noncentrality of a χ² law of two degrees of freedom, and `σ √λ` the mean envelope
//! [O C2]. A skew-normal law is then fitted to each branch by weighted least squares: every shape, location and scale of
//! a grid with the amplitude in closed form, then a search that halves its steps.

use super::stages::SpectralFrame;
use crate::course::VesselCourse;
use crate::propagation::Propagation;
use crate::propagation::strength::SkewNormal;
use seabearing_core::obs::cepstrum::noise_sd;
use seabearing_signal::{Complex, Fft, Precision, RealToComplex};

/// Width of a cell of range, m.
pub const CELL_M: f64 = 1_000.0;
/// Number of cells: beyond 50 km no interference is seen \[O\].
pub const CELLS: usize = 50;
/// Fewest frames of a cell that count.
const LEAST: usize = 8;
/// Branches nearer to each other than this cannot be told apart, s: three widths of the pulse.
pub(super) const APART_S: f64 = 0.15;

/// Greatest shape of a law that is looked at.
const MOST_SHAPE: f64 = 10.0;
/// Least and greatest scale, m.
const SCALES_M: (f64, f64) = (1_000.0, 40_000.0);

/// One cell of range of one branch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Its middle, m.
    pub range_m: f64,
    /// Frames in it.
    pub frames: usize,
    /// Mean envelope.
    pub envelope: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Noncentrality λ of its χ² law: power of the envelope over that of noise.
    pub noncentrality: f64,
}

/// One branch's measured strengths and their law; no law where too few cells have data.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Cells with data.
    pub cells: Vec<Cell>,
    /// The law.
    pub law: Option<SkewNormal>,
}

impl Branch {
    /// Parameters of its law that ended at the limit of what is looked at.
    pub fn at_limit(&self) -> Vec<&'static str> {
        let Some(law) = self.law else { return Vec::new() };
        let near = |x: f64, limit: f64| (x - limit).abs() < 1e-3 * limit;
        let all = [
            ("shape", near(law.shape, MOST_SHAPE)),
            ("scale", near(law.scale_m, SCALES_M.0) || near(law.scale_m, SCALES_M.1)),
        ];
        all.into_iter().filter(|(_, at)| *at).map(|(name, _)| name).collect()
    }
}

/// Squared envelopes of a recording's cepstra with their times, s.
pub struct Envelopes(Vec<(f64, Vec<f64>)>);

impl Envelopes {
    /// Of frames.
    pub fn of<'f>(frames: impl IntoIterator<Item = &'f SpectralFrame>) -> Self {
        let mut frames = frames.into_iter().peekable();
        let mut envelope = Envelope::new(frames.peek().map_or(0, |f| f.filtered.len()));
        Self(frames.map(|f| (f.t_s, envelope.of(&f.filtered))).collect())
    }

    /// At most so many of them, evenly chosen.
    pub fn thinned(&self, most: usize) -> Self {
        let every = self.0.len().div_ceil(most.max(1)).max(1);
        Self(self.0.iter().step_by(every).cloned().collect())
    }

    /// Every second stretch of so many seconds, and the others.
    pub fn halves(&self, stretch_s: f64) -> (Self, Self) {
        let first = |(t_s, _): &&(f64, Vec<f64>)| (t_s / stretch_s) as i64 % 2 == 0;
        (
            Self(self.0.iter().filter(first).cloned().collect()),
            Self(self.0.iter().filter(|e| !first(e)).cloned().collect()),
        )
    }

    /// Measured strengths of every branch of a table along courses.
    pub fn cells(&self, courses: &[VesselCourse], table: &Propagation) -> Vec<Vec<Cell>> {
        let branches = table.strengths.len();
        let mut sums = vec![[(0.0f64, 0usize, 0.0f64); CELLS]; branches];
        for (t_s, squares) in &self.0 {
            let Some(course) = alone(courses, *t_s) else { continue };
            for (b, sums) in sums.iter_mut().enumerate() {
                let Some((range, tau)) = at_emission(table, course, b, *t_s) else { continue };
                let row = (range / table.step_m).round() as usize;
                let crowded = (0..branches)
                    .filter(|c| *c != b)
                    .filter_map(|c| table.branch(c, row))
                    .any(|(other, _)| (other - tau).abs() < APART_S);
                let k = (tau * 50.0).round() as usize;
                let cell = (range / CELL_M) as usize;
                if crowded || cell >= CELLS || k + 8 > squares.len() || k < 8 {
                    continue;
                }
                let sigma = f64::from(noise_sd(k));
                let slot = &mut sums[cell];
                *slot = (slot.0 + squares[k] / (sigma * sigma), slot.1 + 1, sigma);
            }
        }
        let cell = |(i, &(sum, n, sigma)): (usize, &(f64, usize, f64))| {
            let lambda = (sum / n as f64 - 2.0).max(0.0);
            // The variance of a noncentral χ² of two degrees is 4 + 4 λ; overlapped frames count half.
            let sd_lambda = ((4.0 + 4.0 * lambda) / (0.5 * n as f64)).sqrt();
            let sd = sigma * 0.5 * sd_lambda / lambda.max(sd_lambda).sqrt();
            let range_m = (i as f64 + 0.5) * CELL_M;
            Cell { range_m, frames: n, envelope: sigma * lambda.sqrt(), sd, noncentrality: lambda }
        };
        let counts = |(_, sum): &(usize, &(f64, usize, f64))| sum.1 >= LEAST;
        sums.iter().map(|row| row.iter().enumerate().filter(counts).map(cell).collect()).collect()
    }
}

/// Stacks and fits every branch of a table.
pub fn fit(envelopes: &Envelopes, courses: &[VesselCourse], table: &Propagation) -> Vec<Branch> {
    let measured = envelopes.cells(courses, table);
    measured.into_iter().map(|cells| Branch { law: law(&cells), cells }).collect()
}

/// Mean envelope of the cepstrum against range and quefrency: a row for each cell of range (of the first branch that is
/// there), a value for each quefrency; NaN where nothing was heard [O, figure 5a].
pub fn stack(frames: &[SpectralFrame], courses: &[VesselCourse], table: &Propagation) -> Vec<Vec<f32>> {
    let quefrencies = frames.first().map_or(0, |f| f.filtered.len());
    let mut envelope = Envelope::new(quefrencies);
    let mut sums = vec![(vec![0f64; quefrencies], 0usize); CELLS];
    for f in frames {
        let Some(course) = alone(courses, f.t_s) else { continue };
        let heard = (0..table.strengths.len()).find_map(|b| at_emission(table, course, b, f.t_s));
        let Some((sum, n)) = heard.and_then(|(range, _)| sums.get_mut((range / CELL_M) as usize)) else {
            continue;
        };
        *n += 1;
        sum.iter_mut().zip(envelope.of(&f.filtered)).for_each(|(s, e)| *s += e.sqrt());
    }
    sums.into_iter()
        .map(|(sum, n)| {
            let mean = |s: f64| if n > 0 { (s / n as f64) as f32 } else { f32::NAN };
            sum.into_iter().map(mean).collect()
        })
        .collect()
}

/// The one vessel within 70 km at a time; none where there are several.
pub(super) fn alone(courses: &[VesselCourse], t_s: f64) -> Option<&VesselCourse> {
    let near = |c: &&VesselCourse| c.at(t_s).is_some_and(|p| p.0.hypot(p.1) < 70_000.0);
    let mut inside = courses.iter().filter(near);
    inside.next().filter(|_| inside.next().is_none())
}

/// Range at the emission of what interferes in a branch at a time (mean travel time of its two paths), and the delay.
pub(super) fn at_emission(
    table: &Propagation,
    course: &VesselCourse,
    branch: usize,
    t_s: f64,
) -> Option<(f64, f64)> {
    let mut place = course.at(t_s)?;
    for _ in 0..3 {
        let range = place.0.hypot(place.1);
        let delay = 0.5 * (table.arrival(branch, range)?.toa_s + table.arrival(branch + 1, range)?.toa_s);
        place = course.at(t_s - delay)?;
    }
    let range = place.0.hypot(place.1);
    Some((range, table.arrival(branch + 1, range)?.toa_s - table.arrival(branch, range)?.toa_s))
}

/// Squared envelope of a cepstrum: its analytic representation in quefrency.
struct Envelope {
    n: usize,
    forward: std::sync::Arc<dyn RealToComplex<f32>>,
    inverse: std::sync::Arc<dyn Fft<f32>>,
}

impl Envelope {
    fn new(quefrencies: usize) -> Self {
        let n = (2 * quefrencies.max(8)).next_power_of_two();
        Self { n, forward: f32::real_to_complex(n), inverse: f32::complex_inverse(n) }
    }

    fn of(&mut self, c: &[f32]) -> Vec<f64> {
        let mut x = vec![0f32; self.n];
        x.iter_mut().zip(c).for_each(|(x, c)| *x = *c);
        let mut half = self.forward.make_output_vec();
        if self.forward.process(&mut x, &mut half).is_err() {
            return Vec::new();
        }
        let mut full = vec![Complex::default(); self.n];
        for (f, h) in full.iter_mut().zip(&half).skip(1).take(self.n / 2 - 1) {
            *f = h * (2.0 / self.n as f32);
        }
        self.inverse.process(&mut full);
        full.iter().take(c.len()).map(|z| f64::from(z.norm_sqr())).collect()
    }
}

/// The skew-normal law that fits cells best; `None` for fewer than six cells or nothing above noise.
pub fn law(cells: &[Cell]) -> Option<SkewNormal> {
    if cells.len() < 6 || !cells.iter().any(|c| c.envelope > 2.0 * c.sd) {
        return None;
    }
    // For a form of unit amplitude: the best amplitude and what is left.
    let score = |p: [f64; 3]| -> (f64, f64) {
        let form = SkewNormal { k_m: 1.0, shape: p[0], location_m: p[1], scale_m: p[2] };
        let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
        for c in cells {
            let (w, x) = (1.0 / (c.sd * c.sd), form.at(c.range_m));
            xy += w * x * c.envelope;
            xx += w * x * x;
            yy += w * c.envelope * c.envelope;
        }
        let k = if xx > 0.0 { (xy / xx).max(0.0) } else { 0.0 };
        (yy - 2.0 * k * xy + k * k * xx, k)
    };
    let mut best = ([0.0, 0.0, 1.0], f64::INFINITY);
    let mut consider = |p: [f64; 3]| {
        let s = score(p).0;
        if s < best.1 {
            best = (p, s);
        }
    };
    for shape in 0..9 {
        for location in 0..50 {
            for scale in 2..32 {
                consider([f64::from(shape), 1e3 * f64::from(location), 1e3 * f64::from(scale)]);
            }
        }
    }
    let (mut p, mut least) = best;
    let mut step = [0.5, 500.0, 500.0];
    for _ in 0..200 {
        let mut moved = false;
        for i in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut q = p;
                q[i] += sign * step[i];
                let allowed = (0.0..=MOST_SHAPE).contains(&q[0])
                    && q[1] >= 0.0
                    && (SCALES_M.0..=SCALES_M.1).contains(&q[2]);
                let s = if allowed { score(q).0 } else { f64::INFINITY };
                if s < least {
                    (p, least, moved) = (q, s, true);
                }
            }
        }
        if !moved {
            step.iter_mut().for_each(|s| *s *= 0.5);
        }
    }
    Some(SkewNormal { k_m: score(p).1, shape: p[0], location_m: p[1], scale_m: p[2] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::propagation::strength::RR03;

    #[test]
    fn the_paper_s_laws_are_found_again() {
        for (n, truth) in RR03.iter().enumerate().take(3) {
            let cells: Vec<Cell> = (0..CELLS)
                .map(|i| (i as f64 + 0.5) * CELL_M)
                .map(|r| Cell {
                    range_m: r,
                    frames: 100,
                    envelope: truth.at(r),
                    sd: 0.002,
                    noncentrality: 0.0,
                })
                .collect();
            let found = law(&cells).unwrap();
            let worst = cells.iter().map(|c| (found.at(c.range_m) - c.envelope).abs()).fold(0.0, f64::max);
            assert!(worst < 5e-4, "branch {n}: {worst} {found:?}");
        }
    }

    #[test]
    fn nothing_gives_no_law() {
        let cells =
            vec![Cell { range_m: 500.0, frames: 10, envelope: 0.0, sd: 0.01, noncentrality: 0.0 }; 20];
        assert_eq!(law(&cells), None);
        assert_eq!(law(&[]), None);
    }

    #[test]
    fn the_envelope_of_a_pulse_is_its_height() {
        let c: Vec<f32> = (0..384)
            .map(|k| {
                let d = k as f64 / 50.0 - 3.0;
                (0.08 * (std::f64::consts::TAU * 15.0 * d - 1.0).cos() * (-(d / 0.05).powi(2)).exp()) as f32
            })
            .collect();
        let e = Envelope::new(384).of(&c);
        assert!((e[150].sqrt() - 0.08).abs() < 0.006, "{}", e[150].sqrt());
    }
}
