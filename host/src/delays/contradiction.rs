//! Whether measured delays contradict the array they are solved with.
//!
//! In: sets of six delays, the array and what was told of its errors, which sets were accepted. Out: whether those that close around every
//! triangle, as delays of one source do, are a direction's: its vector has the length one, but for noise, which the triangles show, and for
//! what is told of places and of the speed of sound. A hydrophone that is late, places that are wrong: directions that happen to have a right
//! length are accepted, and are wrong.
//!
//! Not seen: lateness that turns directions and keeps their length, as that of the uppermost hydrophone for vessels near the horizon.

use super::late::{Model, Told};
use seabearing_core::geometry::{Geometry, PAIRS};
use seabearing_core::kit::{median, spd};

/// Fewest sets that close.
const FEWEST: usize = 8;
/// Standard deviation of a coordinate where none is told, metres, and of the speed of sound at least, as a share of it.
const UNTOLD_PLACE_M: f64 = 0.01;
const LEAST_SPEED: f64 = 0.005;
/// Median deviation of the length, in standard deviations, from which on it is no chance: half of normal numbers are beyond 0.67.
const CONTRADICTED: f64 = 1.5;
/// Share of the sets that close which must be accepted.
const LEAST_ACCEPTED: f64 = 0.5;
/// Mean square over three degrees of freedom where its median is one: the median of χ² of three is 2.366.
const MEDIAN_OF_THREE: f64 = 3.0 / 2.366;

/// What makes accepted sets suspect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contradiction {
    /// Sets whose delays close around every triangle, and how many of them are accepted.
    pub closing: usize,
    /// See `closing`.
    pub accepted: usize,
    /// Median by which the length of their directions is off one, and that which noise and what is told would make, shares.
    pub off: f64,
    /// See `off`.
    pub expected: f64,
}

impl Contradiction {
    /// What to say of it.
    pub fn said(&self) -> String {
        let Self { closing, accepted, off, expected } = self;
        format!(
            "delays agree among themselves and contradict the array: of {closing} sets that close around every triangle {accepted} are \
             accepted, and their directions' length is off by {:.1} % ({:.1} % is expected): is a hydrophone late in all sets, or are \
             `hydrophones_m`, their order or the speed of sound wrong? Accepted sets are marked `suspect`",
            100.0 * off,
            100.0 * expected
        )
    }
}

/// Whether sets contradict the array; `None` where too few close, or they do not.
pub(super) fn of(
    geometry: &Geometry,
    told: &Told,
    sets: &[[f64; 6]],
    accepted: &[bool],
) -> Option<Contradiction> {
    let model = Model::new(geometry, told);
    let c = model.sound_speed_m_s;
    // By set: vector, mean square of what keeps it from closing (three degrees of freedom), whether it was accepted.
    let closing: Vec<([f64; 3], f64, bool)> = sets
        .iter()
        .zip(accepted)
        .filter_map(|(s, accepted)| Some((model.vector(s, told.tolerance_s)?, open(s) / 3.0, *accepted)))
        .collect();
    if closing.len() < FEWEST {
        return None;
    }
    let mut noise: Vec<f64> = closing.iter().map(|(_, square, _)| *square).collect();
    // Arrivals by least squares over six pairs have a quarter of a pair's variance.
    let arrival_m2 = c * c * MEDIAN_OF_THREE * median(&mut noise)? / 4.0;
    let place_m = if told.position_sd_m > 0.0 { told.position_sd_m } else { UNTOLD_PLACE_M };
    let speed = (told.sound_speed_sd_m_s / c).max(LEAST_SPEED);
    let (mut off, mut relative, mut expected) = (Vec::new(), Vec::new(), Vec::new());
    for (v, _, _) in &closing {
        let length = spd::dot(v, v).sqrt().max(1e-6);
        let u = v.map(|x| x / length);
        let across: f64 = model.duals.iter().map(|d| spd::dot(d, &u).powi(2)).sum();
        let sd = ((arrival_m2 + place_m * place_m) * across + speed * speed).sqrt();
        let by = (length - 1.0 - model.curvature * model.bend(&u)).abs();
        off.push(by);
        relative.push(by / sd);
        expected.push(0.6745 * sd);
    }
    let kept = closing.iter().filter(|(_, _, accepted)| *accepted).count();
    let few = (kept as f64) < LEAST_ACCEPTED * closing.len() as f64;
    (few || median(&mut relative)? > CONTRADICTED).then_some(Contradiction {
        closing: closing.len(),
        accepted: kept,
        off: median(&mut off)?,
        expected: median(&mut expected)?,
    })
}

/// Sum of squares by which six delays do not close.
fn open(delays_s: &[f64; 6]) -> f64 {
    let mut times = [0.0; 4];
    for ((i, j), tau) in PAIRS.into_iter().zip(delays_s) {
        times[i] -= tau / 4.0;
        times[j] += tau / 4.0;
    }
    PAIRS.iter().zip(delays_s).map(|((i, j), tau)| (tau - times[*j] + times[*i]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const C: f64 = 1484.0;
    const H: [[f64; 3]; 4] =
        [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.14]];

    fn found(late_s: [f64; 4], places_sd_m: f64, told_m: f64, seed: u64) -> Option<Contradiction> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let h = H.map(|h| h.map(|x| x + places_sd_m * normal()));
        let set = |k: i32| {
            let source = [300.0, 6.0 * f64::from(k - 50), 96.0];
            let mut t = [0.0; 4];
            for ((t, h), late_s) in t.iter_mut().zip(&h).zip(late_s) {
                let way: f64 = (0..3).map(|x| (source[x] - h[x]).powi(2)).sum();
                *t = way.sqrt() / C + late_s + 3e-6 * normal();
            }
            PAIRS.map(|(i, j)| t[j] - t[i] + 3e-6 * normal())
        };
        let sets: Vec<[f64; 6]> = (0..100).map(set).collect();
        let told =
            Told { range_m: 500.0, position_sd_m: told_m, sound_speed_sd_m_s: 0.0, tolerance_s: 28e-6 };
        of(&Geometry::new(&H, 0.0, C).unwrap(), &told, &sets, &[true; 100])
    }

    #[test]
    fn an_array_as_told_is_not_suspect_and_a_late_hydrophone_makes_it_so() {
        let count = |late_s: [f64; 4], sd_m: f64, told_m: f64| {
            (0..40).filter(|seed| found(late_s, sd_m, told_m, *seed).is_some()).count()
        };
        assert_eq!(count([0.0; 4], 0.0, 0.0), 0);
        assert!(count([0.0; 4], 0.01, 0.01) <= 6 && count([0.0; 4], 0.03, 0.03) <= 6);
        assert_eq!(count([200e-6, 0.0, 0.0, 0.0], 0.0, 0.0), 40);
        assert_eq!(count([0.0, -150e-6, 0.0, 0.0], 0.0, 0.0), 40);
        let said = found([200e-6, 0.0, 0.0, 0.0], 0.0, 0.0, 1).unwrap().said();
        assert!(said.lines().count() == 1 && said.contains("suspect"), "{said}");
    }
}
