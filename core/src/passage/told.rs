//! What is told of a passage: its best line, with what the bearings say of it and what they do not.
//!
//! In: the lines and averages of a [`Passage`]. Out: a [`Solution`]. Other headings ([`super::profile`]), two lines in the place of one, elevations
//! that are off, an error of the height, and what all azimuths or a vessel's own way have in common widen it.

use super::{Config, Known, Passage};
use crate::motion::model::{Limits, Line, PARAMETERS};
use crate::motion::normal::Matrix;
use crate::motion::solution::{Solution, consistency, covariance, from_covariance};

impl<const N: usize> Passage<N> {
    /// The running estimate; `None` until a line stands.
    pub fn solution(&self, config: &Config) -> Option<Solution> {
        let limits = config.limits(self.times_s());
        let (line, mut covariance, consistency) = self.fitted(config, &limits)?;
        let scale = covariance[3][3];
        covariance = self.with_profile(&covariance);
        self.doubt(config, &line, scale, &mut covariance);
        from_covariance(&line, &covariance, &limits, self.seen, consistency)
    }

    /// The best line within the limits, the covariance that its bearings give it, and their residual per degree of freedom.
    #[inline(never)]
    fn fitted(&self, config: &Config, limits: &Limits) -> Option<(Line, Matrix, f64)> {
        let links = self.links(config);
        let mut problem = self.problem(config, &links);
        // One nearer than the least range is told as that, with the least range as its spread; time and heading are the line's own.
        let near = problem.limits.range_m.0.min(limits.range_m.0);
        problem.limits = Limits { range_m: (near, limits.range_m.1), ..*limits };
        let (line, normal) = problem.within_limits(&self.best()?.line)?;
        let free = config.free();
        let consistency = consistency(&normal, &free, problem.measurements());
        Some((line, covariance(&line, &normal, &free, limits)?, consistency))
    }

    /// Adds to a line's covariance what its bearings do not tell; they give ln speed the variance `scale`.
    #[inline(never)]
    fn doubt(&self, config: &Config, line: &Line, scale: f64, covariance: &mut Matrix) {
        covariance[3][3] += config.scale_variance(scale);
        let misfit = config.misfit(line.p[4]).max(1.0 + f64::from(self.misfit));
        covariance.iter_mut().flatten().for_each(|c| *c *= misfit);
        // An error of all azimuths turns the track; one that changes with the azimuth, as positions' do, stretches it as well.
        for k in [0, 2] {
            covariance[k][k] += config.turned();
        }
    }

    /// What a line found before says of the times this passage remembers.
    pub(crate) fn solution_by(&self, config: &Config, known: &Known) -> Option<Solution> {
        let limits = config.limits(self.times_s());
        let line = known.line.moved(&[0.0; PARAMETERS], &limits);
        let mut covariance = known.covariance();
        self.doubt(config, &line, covariance[3][3], &mut covariance);
        from_covariance(&line, &covariance, &limits, self.seen, 1.0)
    }
}
