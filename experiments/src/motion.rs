//! What the experiments of paper M share: passes, bearing errors, repeated fits, and their comparison with the bounds.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
pub use seabearing_host::bounds::passage::{POSITIONS, STEP_S, StraightPass, config, limits};
use seabearing_locate::motion::bound;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml;
use seabearing_locate::motion::whiten::{Factorisation, Workspace};

/// Speed of the simulated vessel [M section IV-A], m/s.
pub const SPEED_M_S: f64 = 7.0;

/// How bearing errors are drawn.
#[derive(Clone, Copy, Debug)]
pub enum BearingNoise {
    /// By the linear model exactly: the sum of τ/step equal impulses.
    Linear,
    /// First-order Gauss-Markov.
    Markov,
    /// White noise through a sixth-order Butterworth low-pass with cut-off `1/(2π τ_α)`, as the paper does; its
    /// correlation is near the sinc model's.
    Butterworth(Butterworth),
}

/// Draws of the errors of a pass.
pub trait Drawn {
    /// Errors of one run, radians.
    fn errors(&self, noise: &BearingNoise, rng: &mut ChaCha8Rng) -> Vec<f64>;
}

impl Drawn for StraightPass {
    fn errors(&self, noise: &BearingNoise, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let n = self.count();
        let mut gauss = || -> f64 { StandardNormal.sample(rng) };
        let steps = (self.tau_s / STEP_S).round() as usize;
        if steps == 0 {
            return (0..n).map(|_| self.sd_rad * gauss()).collect();
        }
        match noise {
            BearingNoise::Linear => {
                let w: Vec<f64> = (0..n + steps).map(|_| gauss()).collect();
                let mut sum: f64 = w[..steps].iter().sum();
                let scale = self.sd_rad / (steps as f64).sqrt();
                (0..n)
                    .map(|k| {
                        let e = sum;
                        sum += w[k + steps] - w[k];
                        scale * e
                    })
                    .collect()
            }
            BearingNoise::Markov => {
                let keep = (-STEP_S / self.tau_s).exp();
                let mut e = gauss();
                (0..n)
                    .map(|_| {
                        let now = e;
                        e = keep * e + (1.0 - keep * keep).sqrt() * gauss();
                        self.sd_rad * now
                    })
                    .collect()
            }
            BearingNoise::Butterworth(filter) => {
                let mut filter = *filter;
                for _ in 0..12 * steps {
                    filter.step(gauss());
                }
                (0..n).map(|_| self.sd_rad * filter.step(gauss())).collect()
            }
        }
    }
}

/// Sixth-order Butterworth low-pass as three biquads, scaled to unit variance for white input.
#[derive(Clone, Copy, Debug)]
pub struct Butterworth {
    sections: [[f64; 3]; 3],
    state: [[f64; 2]; 3],
    gain: f64,
}

impl Butterworth {
    /// Correlation interval in samples: cut-off `1/(2π τ)` cycles a sample, bilinear transform with prewarping.
    pub fn new(tau: f64) -> Self {
        let w = (0.5 / tau).tan();
        let sections = [1.0, 3.0, 5.0].map(|k: f64| {
            let damping = 2.0 * (k * std::f64::consts::PI / 12.0).sin();
            let norm = 1.0 / (1.0 + damping * w + w * w);
            [w * w * norm, 2.0 * (w * w - 1.0) * norm, (1.0 - damping * w + w * w) * norm]
        });
        let mut filter = Self { sections, state: [[0.0; 2]; 3], gain: 1.0 };
        let length = (20.0 * tau) as usize + 100;
        let energy: f64 = (0..length).map(|k| filter.step(f64::from(u8::from(k == 0))).powi(2)).sum();
        Self { sections, state: [[0.0; 2]; 3], gain: 1.0 / energy.sqrt() }
    }

    fn step(&mut self, input: f64) -> f64 {
        let mut x = input;
        for ([b, a1, a2], s) in self.sections.iter().zip(&mut self.state) {
            let y = b * x + s[0];
            s[0] = 2.0 * b * x - a1 * y + s[1];
            s[1] = b * x - a2 * y;
            x = y;
        }
        self.gain * x
    }
}

/// Root-mean-square errors of range (m) and heading (degrees) over runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rmse {
    /// Range of CPA, m.
    pub range_m: f64,
    /// Heading, degrees.
    pub heading_deg: f64,
}

/// A random generator for one run of one point.
pub fn generator(seed: u64, point: u64, run: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(point));
    rng.set_stream(run as u64);
    rng
}

/// Fits `runs` noisy passes with each of the models over the same errors. `speeds` gives a run's true and assumed
/// speed.
pub fn repeat(
    scene: &StraightPass,
    models: &[Model],
    noise: &BearingNoise,
    runs: usize,
    seed: (u64, u64),
    speeds: impl Fn(&mut ChaCha8Rng) -> (f64, f64) + Sync,
) -> Vec<Rmse> {
    let zero = || vec![(0.0, 0.0); models.len()];
    let sums = (0..runs)
        .into_par_iter()
        .map_init(
            || Box::new(Workspace::<POSITIONS>::new()),
            |work, run| {
                let mut rng = generator(seed.0, seed.1, run);
                let (truth, assumed) = speeds(&mut rng);
                let scene = StraightPass { speed_m_s: truth, ..*scene };
                let errors = scene.errors(noise, &mut rng);
                let heading = scene.line().heading_rad();
                models
                    .iter()
                    .map(|model| {
                        let c = config(*model, scene.tau_s, assumed);
                        let s = scene.samples(&c.medium, &errors);
                        match ml::fit(&c, &s, work, &mut []) {
                            Ok(f) => {
                                let dr = f.solution.cpa_range_m - scene.range_m;
                                let dh = wrap_pi(f.solution.heading_rad - heading).to_degrees();
                                (dr * dr, dh * dh)
                            }
                            // A fit that fails counts as an error of the whole range and a right angle.
                            Err(_) => (scene.range_m * scene.range_m, 8100.0),
                        }
                    })
                    .collect::<Vec<_>>()
            },
        )
        .reduce(zero, |a, b| a.iter().zip(&b).map(|(a, b)| (a.0 + b.0, a.1 + b.1)).collect());
    let n = runs.max(1) as f64;
    sums.iter().map(|s| Rmse { range_m: (s.0 / n).sqrt(), heading_deg: (s.1 / n).sqrt() }).collect()
}

/// The paper's own bound of CPA range, m: from the 2×2 block of position in the middle of the window [M 28], heading held.
pub fn paper(scene: &StraightPass) -> Option<f64> {
    let mut work = Box::new(Workspace::<POSITIONS>::new());
    let c = config(Model::Linear, scene.tau_s, scene.speed_m_s);
    let s = scene.samples(&c.medium, &vec![0.0; scene.count()]);
    let plan = Factorisation::new(c.model, c.tau_s, s.iter().map(|s| s.t_s), &mut work, &mut []).ok()?;
    // With the closest point due north, range is the second of the block's coordinates.
    let mut line = scene.line();
    line.p[0] = 0.0;
    bound::paper(&s, &line, 0.0, &plan, &mut work, &[]).map(|[_, north, _]| north)
}

/// The second-order (Bhattacharyya) bounds of CPA range (m) and heading (degrees) for an unbiased estimator: what
/// curvature adds to the Cramér-Rao bound. With the scores of first and second order as a basis,
/// `B = [F, ⟨J_k, μ_ij⟩; ·, F_ik F_jl + F_il F_jk + ⟨μ_ij, μ_kl⟩]`, the bound of `g(θ)` is `[g_i, g_ij] B⁻¹ [g_i, g_ij]ᵀ`.
pub fn second_order(scene: &StraightPass) -> Option<Rmse> {
    const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    let mut work = Box::new(Workspace::<POSITIONS>::new());
    let c = config(Model::Linear, scene.tau_s, scene.speed_m_s);
    let s = scene.samples(&c.medium, &vec![0.0; scene.count()]);
    let line = scene.line();
    let times = || s.iter().map(|s| s.t_s);
    let plan = Factorisation::new(c.model, c.tau_s, times(), &mut work, &mut []).ok()?;
    // Steps for second derivatives: small parts of a radian, of the passage, of ln q.
    let h = [1e-4, 1e-4 * scene.range_m / scene.speed_m_s, 1e-4];
    let moved = |k: usize, sign: f64| {
        let mut l = line;
        l.p[k] += sign * h[k];
        l
    };
    // All nine derivatives of the bearing at a time: three of first, six of second order.
    let derivatives = |t: f64| {
        let mut d = [0.0; 9];
        d[..3].copy_from_slice(&line.expected(&c.medium, t).d_azimuth[..3]);
        for (n, (i, j)) in PAIRS.into_iter().enumerate() {
            let up = moved(j, 1.0).expected(&c.medium, t).d_azimuth[i];
            let down = moved(j, -1.0).expected(&c.medium, t).d_azimuth[i];
            d[3 + n] = (up - down) / (2.0 * h[j]);
        }
        d.map(|x| x / scene.sd_rad)
    };
    let mut inner = [[0.0; 9]; 9];
    for (a, b) in [(0, 3), (0, 6), (3, 6)] {
        let normal = plan.normal(times(), &mut work, &[], |_, t| {
            let d = derivatives(t);
            [d[a], d[a + 1], d[a + 2], d[b], d[b + 1], d[b + 2]]
        })?;
        let place = |k: usize| if k < 3 { a + k } else { b + k - 3 };
        let gram = normal.gram();
        for i in 0..6 {
            for j in i..6 {
                inner[place(i)][place(j)] = gram[i][j];
                inner[place(j)][place(i)] = gram[i][j];
            }
        }
    }
    let f = inner;
    for (m, (i, j)) in PAIRS.into_iter().enumerate() {
        for (n, (k, l)) in PAIRS.into_iter().enumerate() {
            inner[3 + m][3 + n] += f[i][k] * f[j][l] + f[i][l] * f[j][k];
        }
    }
    // Range is exp(ln v − ln q): its derivatives by ln q are −r and r; heading is the first parameter.
    let mut range = [0.0; 9];
    (range[2], range[8]) = (-scene.range_m, scene.range_m);
    let mut heading = [0.0; 9];
    heading[0] = 1.0;
    let scale: Vec<f64> = (0..9).map(|i| 1.0 / inner[i][i].sqrt()).collect();
    let b = nalgebra::SMatrix::<f64, 9, 9>::from_fn(|i, j| inner[i][j] * scale[i] * scale[j]);
    let factor = b.cholesky()?;
    let bound = |g: &[f64; 9]| {
        let v = nalgebra::SVector::<f64, 9>::from_fn(|i, _| g[i] * scale[i]);
        v.dot(&factor.solve(&v)).sqrt()
    };
    Some(Rmse { range_m: bound(&range), heading_deg: bound(&heading).to_degrees() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_errors_have_the_stated_variance_and_correlation() {
        let scene = StraightPass { range_m: 500.0, window_s: 40.0, sd_rad: 1.0, tau_s: 10.0, speed_m_s: 7.0 };
        for (noise, at_half) in [
            (BearingNoise::Linear, 0.5),
            (BearingNoise::Markov, (-0.5f64).exp()),
            (BearingNoise::Butterworth(Butterworth::new(20.0)), 0.5f64.sin() / 0.5),
        ] {
            let (mut own, mut cross) = (0.0, 0.0);
            for run in 0..1500 {
                let e = scene.errors(&noise, &mut generator(3, 1, run));
                own += e[40] * e[40] / 1500.0;
                cross += e[40] * e[50] / 1500.0;
            }
            assert!((own - 1.0).abs() < 0.12, "{noise:?} {own}");
            assert!((cross - at_half).abs() < 0.12, "{noise:?} {cross}");
        }
    }
}
