//! Whether two lines explain a passage better than one: what is asked before it is parted.

use super::lines::{Lines, Problem};
use super::settings::Config;
use super::{Passage, SEARCH_STEPS};

impl<const N: usize> Passage<N> {
    /// By how much the weighted squared residual falls where two lines take the place of the best one, one near it before a time and a fresh
    /// one after it: seldom more than [`Passage::split`] finds, for less work than a search.
    pub(crate) fn gain_of_two(&self, config: &Config, t_s: f64) -> Option<f64> {
        let cut = self.nodes().iter().filter(|n| self.origin_s + n.t_s() < t_s).count();
        let links = self.links(config);
        let (all, line) = (self.problem(config, &links), self.best()?.line);
        let near = |problem: &Problem<'_>| problem.freed(&line).map(|(_, normal)| normal.cost());
        let (nodes, links) = (all.nodes.split_at_checked(cut)?, all.links.split_at_checked(cut)?);
        let older = Problem { nodes: nodes.0, links: links.0, ..all };
        let newer = Problem { nodes: nodes.1, links: links.1, ..all };
        Some(near(&all)? - near(&older)? - Lines::new().improve(&newer, true, SEARCH_STEPS)?)
    }
}
