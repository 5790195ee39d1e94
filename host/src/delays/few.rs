//! Whether so few sets of a file are accepted that these are no better than the others.
//!
//! In: how many sets have delays enough for a direction, and how many of them were accepted. Out: what to say where nearly all were
//! rejected. Several pairs that are wrong alike in all sets leave no direction but where theirs happens to be one: what is accepted there
//! is wrong by as much as the rest.
//!
//! Not told apart: a file of which most sets are noise and a few a vessel's.

/// Fewest sets of which this is said.
const FEWEST: usize = 20;
/// Share of the sets that must be accepted.
const LEAST_ACCEPTED: f64 = 0.2;

/// How few sets were accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Few {
    /// Sets with delays enough for a direction that is not below the horizon.
    pub sets: usize,
    /// Those accepted.
    pub accepted: usize,
}

impl Few {
    /// What to say of it.
    pub fn said(&self) -> String {
        let Self { sets, accepted } = self;
        format!(
            "only {accepted} of {sets} sets are accepted: are several pairs wrong alike in all of them, or `hydrophones_m` or their order? \
             Accepted sets are marked `suspect`"
        )
    }
}

/// Whether few of them are; `None` where enough are, or none is.
pub(super) fn of(sets: usize, accepted: usize) -> Option<Few> {
    let few = sets >= FEWEST && accepted > 0 && (accepted as f64) < LEAST_ACCEPTED * sets as f64;
    few.then_some(Few { sets, accepted })
}

#[cfg(test)]
mod tests {
    use crate::delays::{SetResult, solve_rows};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use seabearing_core::config::StationConfig;
    use seabearing_core::geometry::PAIRS;

    const H: [[f64; 3]; 4] =
        [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

    /// Delays of a vessel that passes, with errors of 5 µs, and of pairs the same by so much in all sets but those at the closest point.
    fn rows(off_s: [f64; 6]) -> Vec<[f64; 7]> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let set = |k: i32| {
            let t_s = f64::from(k);
            let source = [300.0, 7.0 * t_s - 700.0, 164.0];
            let way = |h: &[f64; 3]| (0..3).map(|x| (source[x] - h[x]).powi(2)).sum::<f64>().sqrt();
            let off = if (95..105).contains(&k) { 0.0 } else { 1.0 };
            let mut row = [t_s; 7];
            for (p, (i, j)) in PAIRS.into_iter().enumerate() {
                row[p + 1] = (way(&H[j]) - way(&H[i])) / 1484.0 + off * off_s[p] + 5e-6 * normal();
            }
            row
        };
        (0..200).map(set).collect()
    }

    fn station() -> StationConfig {
        StationConfig { sound_speed_m_s: 1484.0, ..StationConfig::array(64_000.0, H) }
    }

    #[test]
    fn pairs_that_are_wrong_alike_make_the_few_accepted_sets_suspect() {
        let solved = solve_rows(&station(), rows([3e-4, -2e-4, 4e-4, 0.0, 0.0, 0.0]), None).unwrap();
        let accepted = solved.sets.iter().filter(|s| s.accepted()).count();
        assert!(accepted > 0 && accepted < 40, "{accepted}");
        let said = solved.suspect().unwrap();
        assert!(said.lines().count() == 1 && said.contains("suspect"), "{said}");
        let well = solve_rows(&station(), rows([0.0; 6]), None).unwrap();
        assert!(well.suspect().is_none() && well.sets.iter().all(SetResult::accepted));
    }
}
