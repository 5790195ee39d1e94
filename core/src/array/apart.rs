//! A vessel and its image in the surface where the array hears them apart.
//!
//! Enters: the correlations of a segment and the direction found in it. Leaves: which of the two that is, how deep the vessel lies, and its direction without
//! what the image puts on it. Above and below the direction found the correlations peak a second time, nearly as high: the upper one is the image's, by its
//! longer way and the surface the fainter one. What is between them is `2 d sin β cos β / D` (d the vessel's depth, D the array's, β the elevation of the surface between them),
//! whether or not fringes tell the depth. Each pulls the other's peak: upright pairs hear the vessel alone, level ones both, at the mean of their
//! delays. So the image's expected cross-spectra are taken out as another source's are, and the vessel is refined in what is left; twice, as the image's place is only as good
//! as the vessel's.
//!
//! Cost: 25 000 instructions to look, up to 90 000 in shallow water; 400 000 to take the image out, and 150 000 to take both out where another source is looked for.

use super::estimate::{Context, Found, SpectrumWork};
use super::fringes::Told;
use super::refine;
use super::search::SearchWork;
use super::spectra::Spectra;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::math::f32 as m;

/// Least height of the other peak, in units of the direction's own: of 17 000 segments that hear the two apart 19 in 20 have more, and a third of that is usual
/// where they do not.
const LEAST_SHARE: f32 = 0.7;
/// Least angle between them, resolutions: nearer ones join.
const LEAST_CELLS: f32 = 1.75;
/// Least height of the direction's own peak, standard deviations of noise: fainter ones have others as high by chance.
const SURE: f32 = 16.0;
/// Deepest vessel looked for, metres; and how often, in each resolution, up to so many times.
const DEEPEST_M: f32 = 12.0;
const A_CELL: f32 = 4.0;
const MOST: f32 = 160.0;
/// Greatest angle between them, radians.
const MOST_APART: f32 = 1.0;
/// Standard deviation of the angle between their peaks, which pull each other, resolutions: a law that fits the same passes.
const SD_CELLS: f32 = 0.15;
/// Depths farther apart than this share are not one.
const OTHER_DEPTH: f32 = 0.25;
/// How often the image is taken out.
const ROUNDS: usize = 2;
/// Sines of the lowest and the highest elevation of either.
const SINES: core::ops::Range<f32> = 0.0..0.998;

/// The two.
#[derive(Clone, Copy)]
pub(super) struct Apart {
    vessel: Direction,
    image: Direction,
    /// Sine of the elevation of the surface between them.
    surface: f32,
    /// Depth of the vessel and its standard deviation, metres.
    depth: (f32, f32),
    /// The vessel's own delay of each pair, and those that its direction has, seconds: known once it is told.
    pair_delay: [f32; PAIR_COUNT],
    tau: [f32; PAIR_COUNT],
}

impl Apart {
    /// Looks above and below a source found; `None` where it is heard as one.
    #[inline(never)]
    pub(super) fn seen(context: &Context<'_>, search: &SearchWork, found: &Found) -> Option<Self> {
        let plan = context.plan;
        let cell = plan.whole.resolution;
        let own = &found.refined.direction;
        let sine = own[2].clamp(SINES.start, SINES.end);
        let rise = sine * m::sqrt(1.0 - sine * sine);
        let most = (2.0 * DEEPEST_M * rise / plan.depth_m).min(MOST_APART);
        if !(plan.vessel_over_array_depth > 0.0 && most > LEAST_CELLS * cell) {
            return None;
        }
        let (curvature, _) = context.curvature(own);
        let e = wavefront::tangents(own);
        let at = |up: f32| {
            let (sine, cosine) = m::sin_cos(up);
            wavefront::stepped(own, &e, 0.0, sine / cosine)
        };
        let heard = |up: f32| {
            let delays = context.delays(&at(up), curvature);
            delays.iter().enumerate().map(|(p, tau)| search.pair_value(plan, p, *tau)).sum::<f32>()
        };
        let here = heard(0.0);
        let pairs = context.band.used.pairs();
        if !(here > SURE * context.deviation(pairs * context.bins())) {
            return None;
        }
        let steps = (A_CELL * most / cell).min(MOST);
        let step = most / steps;
        let first = (LEAST_CELLS * cell / step) as usize;
        let (mut highest, mut up) = (LEAST_SHARE * here, 0.0);
        for step in [-step, step] {
            let (mut before, mut here) = (f32::MAX, heard(step * first as f32));
            for n in first + 1..=steps as usize {
                let next = heard(step * n as f32);
                let place = (n - 1) as f32;
                if here > highest && here >= before && here > next && SINES.contains(&at(step * place)[2]) {
                    let bend = before - 2.0 * here + next;
                    highest = here;
                    up = step * (place + 0.5 * (before - next) / bend);
                }
                (before, here) = (here, next);
            }
        }
        if up == 0.0 {
            return None;
        }
        let (own, other) = (*own, at(up));
        let (vessel, image) = if up > 0.0 { (own, other) } else { (other, own) };
        let between = at(0.5 * up)[2].max(0.0);
        let a_metre = 2.0 * between * m::sqrt((1.0 - between * between).max(0.0)) / plan.depth_m;
        let depth_m = m::abs(up) / a_metre;
        let depth = (depth_m, SD_CELLS * cell / a_metre);
        (a_metre > 0.0 && depth_m <= DEEPEST_M).then_some(Self {
            vessel,
            image,
            surface: between,
            depth,
            pair_delay: [0.0; PAIR_COUNT],
            tau: [0.0; PAIR_COUNT],
        })
    }

    /// The depth, where the source is so coherent.
    pub(super) fn told(&self, coherence: f32) -> Told {
        Told::apart(self.depth, coherence)
    }

    /// Sine of the elevation of the surface between them.
    pub(super) const fn surface(&self) -> f32 {
        self.surface
    }

    /// Whether it is another depth than fringes tell: then the other peak is another lobe, or another path's.
    pub(super) fn contradicts(&self, depth_m: f32) -> bool {
        m::abs(self.depth.0 - depth_m) > OTHER_DEPTH * depth_m
    }

    /// The delays of a vessel that is told: each pair's own, and those that its direction has.
    pub(super) const fn pair_delays(&self) -> (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]) {
        (&self.pair_delay, &self.tau)
    }

    /// The vessel's direction.
    pub(super) const fn vessel(&self) -> Direction {
        self.vessel
    }

    /// The delays of vessel and image, and what the image has alone of the spectra's coherence into the work space `raw`.
    fn delays(
        &self,
        context: &Context<'_>,
        spectra: &Spectra,
        work: &mut SpectrumWork,
    ) -> [[f32; PAIR_COUNT]; 2] {
        let (plan, band) = (context.plan, context.band);
        let [own, others] = [&self.vessel, &self.image].map(|u| context.delays_from(u));
        refine::coherence(plan, band, spectra, &own, &mut work.smooth);
        refine::coherence(plan, band, spectra, &others, &mut work.raw);
        refine::alone(plan, band, (&own, &others), &work.smooth, &mut work.raw);
        [own, others]
    }

    /// Takes vessel and image out of the spectra; work space for coherence is used up.
    #[inline(never)]
    pub(super) fn remove(&self, context: &Context<'_>, spectra: &mut Spectra, work: &mut SpectrumWork) {
        let (plan, band) = (context.plan, context.band);
        let [own, others] = self.delays(context, spectra, work);
        work.raw.iter_mut().for_each(|c| *c = c.max(0.0));
        refine::remove(plan, band, spectra, &others, &work.raw);
        refine::coherence(plan, band, spectra, &own, &mut work.raw);
        work.raw.iter_mut().for_each(|c| *c = c.max(0.0));
        refine::remove(plan, band, spectra, &own, &work.raw);
    }

    /// The same two, the vessel where it is found in what the image leaves by the weights of the bins as they are. The spectra are left as they
    /// were; work space for coherence is used up.
    #[inline(never)]
    pub(super) fn told_apart(
        mut self,
        context: &Context<'_>,
        spectra: &mut Spectra,
        work: &mut SpectrumWork,
    ) -> Option<Self> {
        let (plan, band) = (context.plan, context.band);
        let first = self.vessel;
        for _ in 0..ROUNDS {
            let [_, others] = self.delays(context, spectra, work);
            refine::smoothed(band, context.noise(1.0), &work.raw, &mut work.smooth);
            refine::remove(plan, band, spectra, &others, &work.smooth);
            let (curvature, _) = context.curvature(&self.vessel);
            let refined = refine::refine(plan, band, spectra, &work.weight, &self.vessel, curvature);
            work.smooth.iter_mut().for_each(|c| *c = -*c);
            refine::remove(plan, band, spectra, &others, &work.smooth);
            let refined = refined?;
            self.pair_delay = refined.pair_delay;
            self.tau = context.delays(&refined.direction, curvature);
            let refined = refined.direction;
            // The image is as much too low as the vessel was too high, and as far aside.
            let off = |k: usize| self.vessel[k] - refined[k];
            let [x, y, z] = self.image;
            let moved = [x - off(0), y - off(1), z + off(2)];
            let length = m::sqrt(wavefront::dot(&moved, &moved)).max(f32::MIN_POSITIVE);
            self.image = moved.map(|x| x / length);
            self.vessel = refined;
        }
        (wavefront::dot(&self.vessel, &first) > m::cos(band.resolution)).then_some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{Heard, error_from, hear, noisy, planned, source};
    use crate::block::CHANNELS;
    use crate::wire::Bearing;
    use std::vec::Vec;

    const RATE_HZ: f64 = 64_000.0;
    const SECONDS: usize = 8;
    /// Elevation of the surface above the vessel.
    const BETWEEN: f64 = 0.9;

    /// A vessel so deep (metres) and its image of this amplitude, 168 m above an array that takes vessels for 4 m deep: the directions of both, and what is told.
    fn told(azimuth: f64, depth_m: f64, amplitude: f64, rms: f64) -> ([f64; 2], Vec<Bearing>) {
        let (up, heard) = late(azimuth, depth_m, (amplitude, rms), None);
        (up, heard.bearings)
    }

    /// The same with a hydrophone a sample late.
    fn late(
        azimuth: f64,
        depth_m: f64,
        (amplitude, rms): (f64, f64),
        channel: Option<usize>,
    ) -> ([f64; 2], Heard) {
        let plan = planned(RATE_HZ, |array| array.vessel_depth_m = 4.0);
        let half = depth_m * BETWEEN.sin() * BETWEEN.cos() / 168.0;
        let late = (2.0 * depth_m * BETWEEN.sin() / 1500.0 * RATE_HZ) as usize;
        let up = [BETWEEN - half, BETWEEN + half];
        let [direct, image] = up.map(|up| source(&plan, (azimuth, up), rms, None, SECONDS, 7));
        let sea: Vec<_> = (late + 1..direct.len())
            .map(|n| {
                core::array::from_fn::<f64, CHANNELS, _>(|c| {
                    let n = n - usize::from(channel == Some(c));
                    direct[n][c] - amplitude * image[n - late][c]
                })
            })
            .collect();
        let mut heard = hear(&plan, &noisy(sea, 5));
        heard.bearings.retain(|b| b.band == 0);
        (up, heard)
    }

    #[test]
    fn a_hydrophone_that_is_late_from_the_start_is_in_what_is_stated_of_a_vessel_without_its_image() {
        let (mut told, mut hidden) = (0, 0);
        for n in 0..8 {
            let azimuth = 0.3 + 0.8 * n as f64;
            let ([vessel, _], heard) = late(azimuth, 7.0, (0.9, 4.0), Some(n % CHANNELS));
            let wrong = |b: &Bearing| {
                let (across, up) = error_from(b, (azimuth, vessel));
                let sd = |variance: f32| f64::from(variance).sqrt();
                across.abs() > 4.0 * sd(b.var_azimuth) || up.abs() > 4.0 * sd(b.var_elevation)
            };
            let bearings = heard.bearings.get(4..).unwrap();
            told += bearings.len();
            hidden += usize::from(bearings.iter().any(wrong));
        }
        // In directions from which all that it does is to turn the bearing nothing shows it; of no scene would all bearings be right without.
        assert!(told > 60 && hidden <= 2, "{told} {hidden}");
    }

    #[test]
    fn the_vessel_is_told_and_not_its_image_nor_what_lies_between() {
        for n in 0..6 {
            // Of nearly one amplitude the direction found may be that of the image.
            let (azimuth, amplitude) = (0.3 + n as f64, if n < 3 { 0.9 } else { 0.99 });
            let ([vessel, image], bearings) = told(azimuth, 7.0, amplitude, 4.0);
            assert!(bearings.len() > 12, "{n}: {}", bearings.len());
            for (k, b) in bearings.iter().enumerate() {
                let (across, up) = error_from(b, (azimuth, vessel));
                let sd = |variance: f32| f64::from(variance).sqrt();
                assert!(
                    across.abs() < 3.5 * sd(b.var_azimuth) && up.abs() < 3.0 * sd(b.var_elevation),
                    "{n} {k}"
                );
                // Four segments agree.
                if k >= 4 {
                    assert!(
                        across.abs() * vessel.cos() < 5e-4 && up.abs() < 0.06 * (image - vessel),
                        "{n} {k}: {across} {up}"
                    );
                }
            }
        }
    }

    #[test]
    fn where_there_is_no_image_none_is_taken_out() {
        for (n, rms) in [4.0, 0.3].into_iter().enumerate() {
            let ([vessel, _], bearings) = told(1.0 + n as f64, 7.0, 0.0, rms);
            assert!(bearings.len() > 10, "{n}");
            // As far below what is heard as a vessel of the usual depth is.
            let below = 4.0 * BETWEEN.sin() * BETWEEN.cos() / 168.0;
            for b in &bearings {
                let (_, up) = error_from(b, (1.0 + n as f64, vessel - below));
                assert!(up.abs() < 0.1 * below + 4.0 * 1e-3 / rms, "{n}: {up}");
            }
        }
    }
}
