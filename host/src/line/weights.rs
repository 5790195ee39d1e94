//! How the steps about one count in its covariance.
//!
//! A direction that turns belongs to the mean time of what is averaged only where the weights lie alike before and after it: of a
//! one-sided memory the newer part is the denser one, and MUSIC follows that the more the faster a source turns (0.2 s with the
//! usual memory of steps of a second, 1.3 s with a long one). With the source's phase turning by `r` a second, the covariance at lag
//! l has the phase `l r κ₁ − l³ r³ κ₃/6 + …` with the cumulants κ of the weights over time: of weights that lie alike all but the
//! first vanish. So a step waits for those after it. Its own weight is `1 − μ` as in the recursion `R ← μ R + (1 − μ) x xᴴ`
//! (paper L: μ = 0.4), and that of a step k away falls as `ν^|k|`, `ν = μ/(2 − μ)`.

/// Weight, over the own step's, below which a step does not count.
const LEAST: f64 = 0.01;

/// Weights of steps by their distance, the own one's (1) first.
pub(super) fn weights(forgetting: f64) -> Vec<f64> {
    let ratio = ratio(forgetting);
    std::iter::successors(Some(1.0), |w| Some(w * ratio)).take_while(|w| *w > LEAST).collect()
}

/// What a step counts less than its neighbour on the near side, ν.
fn ratio(forgetting: f64) -> f64 {
    forgetting / (2.0 - forgetting)
}

/// Independent steps that a bearing rests on: `(Σ w)²/Σ w²` over all steps.
pub fn independent_steps(forgetting: f64) -> f64 {
    let nu = ratio(forgetting);
    ((1.0 + nu) / (1.0 - nu)).powi(2) * (1.0 - nu * nu) / (1.0 + nu * nu)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_step_has_the_rest_of_the_share() {
        assert_eq!(weights(0.0), [1.0]);
        for forgetting in [0.1, 0.4, 0.8, 0.95] {
            let weights = weights(forgetting);
            let both = |of: &dyn Fn(f64) -> f64| 2.0 * weights.iter().map(|w| of(*w)).sum::<f64>() - 1.0;
            let (sum, squares) = (both(&|w| w), both(&|w| w * w));
            assert!((1.0 / sum - (1.0 - forgetting)).abs() < 0.02, "{forgetting} {sum}");
            assert!((sum * sum / squares / independent_steps(forgetting) - 1.0).abs() < 0.03, "{forgetting}");
        }
    }
}
