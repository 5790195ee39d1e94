//! Steps of a line's transforms, each with those about it: from there to its bearings.

use super::bend::{Bend, Told};
use super::frames::{Held, width_hz};
use super::weights::weights;
use super::{Analysis, LineBearing};
use anyhow::Result;
use seabearing_locate::line::{
    Heard, JoinedArrival, LineArrival, LinePlan, MAX_FREQUENCIES, MAX_SOURCES, Scratch, State, join,
};
use std::collections::VecDeque;

/// Deviations by which a sine may lie beyond one and still be a direction's.
const BEYOND: f64 = 4.0;
/// Deviation of a turning source's directions within the average, of a beam: two of half a beam apart are told as two, and such a
/// pair has a quarter of one.
const WITHIN: f64 = 0.25;

/// The steps that are still needed.
pub(super) struct Chain<'a> {
    plans: Vec<LinePlan>,
    analysis: &'a Analysis,
    scratch: Box<Scratch>,
    /// Weights of the steps by their distance.
    weights: Vec<f64>,
    /// Without a gap between them, each with the sines heard in it alone and their deviations.
    held: VecDeque<(Held, Vec<(f64, f64)>)>,
    /// Which of them is told next.
    next: usize,
    bend: Bend,
    steps: u64,
}

impl<'a> Chain<'a> {
    pub(super) fn new(plans: Vec<LinePlan>, analysis: &'a Analysis) -> Self {
        let (scratch, weights) = (Box::new(Scratch::new()), weights(analysis.forgetting));
        let bend = Bend::new(deviation_s(&weights, analysis.step_s), analysis.step_s, beam(&plans));
        Self { plans, analysis, scratch, weights, held: VecDeque::new(), next: 0, bend, steps: 0 }
    }

    /// Other plans, for what follows an end.
    pub(super) fn plan(&mut self, plans: Vec<LinePlan>) {
        self.bend =
            Bend::new(deviation_s(&self.weights, self.analysis.step_s), self.analysis.step_s, beam(&plans));
        self.plans = plans;
    }

    /// Steps so far.
    pub(super) fn steps(&self) -> u64 {
        self.steps
    }

    /// The transforms of a step are complete: tells the steps that have as many after as before them.
    pub(super) fn step(
        &mut self,
        held: Held,
        sink: &mut impl FnMut(LineBearing) -> Result<()>,
    ) -> Result<()> {
        self.steps += 1;
        // What one step alone is too weak for is heard with those about it, and its turning is not known.
        let alone = match self.weights.len() {
            1 => Vec::new(),
            _ => hear(&self.plans, self.analysis, &[(1.0, &held)], 0, &mut self.scratch),
        };
        let sines = alone.iter().map(|joined| (joined.arrival.sine, joined.arrival.sd)).collect();
        self.held.push_back((held, sines));
        let most = self.weights.len() - 1;
        while self.next < self.held.len() && self.next + self.next.min(most) < self.held.len() {
            self.tell(sink)?;
        }
        Ok(())
    }

    /// No step follows, or not at once: tells the rest, with the fewer the nearer they are to the end. What follows begins anew.
    pub(super) fn end(&mut self, sink: &mut impl FnMut(LineBearing) -> Result<()>) -> Result<()> {
        while self.next < self.held.len() {
            self.tell(sink)?;
        }
        self.held.clear();
        self.next = 0;
        self.bend.end().into_iter().try_for_each(sink)
    }

    /// Most steps to either side of the next over which its sources stay in their part of a beam, as the steps alone show it.
    fn reach(&self) -> usize {
        let most = (self.weights.len() - 1).min(self.next).min(self.held.len() - 1 - self.next);
        let sines = self.held.get(self.next).map_or(&[][..], |(_, sines)| sines);
        sines.iter().map(|own| self.reach_of(*own, most)).min().unwrap_or(most)
    }

    /// The same of one source.
    fn reach_of(&self, own: (f64, f64), most: usize) -> usize {
        let near = 0.5 * beam(&self.plans);
        let beams = self.plans.iter().map(LinePlan::beam);
        let variance = (WITHIN * beams.fold(f64::INFINITY, f64::min)).powi(2);
        let nearest = |k: Option<usize>, (sine, _): (f64, f64)| {
            let (_, sines) = self.held.get(k?)?;
            let away = |s: &(f64, f64)| (s.0 - sine).abs();
            sines.iter().copied().min_by(|a, b| away(a).total_cmp(&away(b))).filter(|s| away(s) < near)
        };
        // Weighted sums over the steps: weights, sines and squares from the own one's, and what is the bearings' error in these.
        let (mut n, mut sum, mut squares, mut errors) = (1.0, 0.0, 0.0, own.1.powi(2));
        let mut last = [own; 2];
        for (reach, weight) in self.weights.iter().enumerate().take(most + 1).skip(1) {
            let steps = [self.next.checked_sub(reach), Some(self.next + reach)];
            for (last, k) in last.iter_mut().zip(steps) {
                let Some(found) = nearest(k, *last) else { continue };
                *last = found;
                n += weight;
                sum += weight * (found.0 - own.0);
                squares += weight * (found.0 - own.0).powi(2);
                errors += weight * found.1.powi(2);
            }
            if (squares - errors) / n - (sum / n).powi(2) > variance {
                return reach - 1;
            }
        }
        most
    }

    /// The bearings of the next step, from as many steps before as after it; what none after it needs is dropped.
    fn tell(&mut self, sink: &mut impl FnMut(LineBearing) -> Result<()>) -> Result<()> {
        let most = self.weights.len() - 1;
        let reach = self.reach();
        let about: Vec<(f64, &Held)> = (self.next - reach..=self.next + reach)
            .filter_map(|k| Some((*self.weights.get(k.abs_diff(self.next))?, &self.held.get(k)?.0)))
            .collect();
        let total: f64 = about.iter().map(|(w, _)| w).sum();
        let t_s = about.iter().map(|(w, held)| w * held.mean_s()).sum::<f64>() / total;
        let joined = hear(&self.plans, self.analysis, &about, reach, &mut self.scratch);
        let within_s2 = self.analysis.step_s.powi(2) / 12.0;
        let variance_s2 =
            about.iter().map(|(w, h)| w * ((h.mean_s() - t_s).powi(2) + within_s2)).sum::<f64>();
        let bearing = |(source, joined): (usize, &JoinedArrival)| {
            let JoinedArrival { arrival: LineArrival { sine, sd, snr }, frequencies } = *joined;
            let snr_db = 10.0 * (snr / f64::from(frequencies.max(1))).max(1e-12).log10();
            LineBearing { t_s, source, sine, sd, snr_db, frequencies }
        };
        let bearings = joined.iter().enumerate().map(bearing).collect();
        self.next += 1;
        while self.next > most {
            self.held.pop_front();
            self.next -= 1;
        }
        let told = Told { variance_s2: variance_s2 / total, bearings };
        self.bend.push(told).into_iter().try_for_each(sink)
    }
}

/// Sources of the steps with their weights, the one told being number `reach`: strongest first.
fn hear(
    plans: &[LinePlan],
    analysis: &Analysis,
    about: &[(f64, &Held)],
    reach: usize,
    scratch: &mut Scratch,
) -> Vec<JoinedArrival> {
    let mut heard = [([LineArrival::default(); MAX_SOURCES], 0); MAX_FREQUENCIES];
    let of_each = heard.iter_mut().zip(plans).zip(&analysis.frequencies_hz).enumerate();
    for (band, (((arrivals, count), plan), frequency_hz)) in of_each {
        let at = At { plan, frequency_hz: *frequency_hz, band, reach, analysis };
        *count = at.look(about, scratch, arrivals);
    }
    let mut joined = [JoinedArrival::default(); MAX_SOURCES];
    let n = join(heard.get(..plans.len()).unwrap_or_default(), beam(plans), &mut joined);
    joined.into_iter().take(n.min(analysis.sources)).collect()
}

/// Standard deviation of the times of steps with such weights by their distance, seconds.
fn deviation_s(weights: &[f64], step_s: f64) -> f64 {
    let (sum, squares) = weights
        .iter()
        .enumerate()
        .skip(1)
        .fold((1.0, 0.0), |(sum, squares), (k, w)| (sum + 2.0 * w, squares + 2.0 * w * (k * k) as f64));
    step_s * (squares / sum + 1.0 / 12.0).sqrt()
}

/// The widest beam, a difference of sines.
fn beam(plans: &[LinePlan]) -> f64 {
    plans.iter().map(LinePlan::beam).fold(0.0, f64::max)
}

/// A frequency at a step.
struct At<'a> {
    plan: &'a LinePlan,
    frequency_hz: f64,
    /// Its number.
    band: usize,
    /// Steps before, and after.
    reach: usize,
    analysis: &'a Analysis,
}

impl At<'_> {
    /// Sources heard, their sines by the frequency at which they were; how many.
    fn look(
        &self,
        about: &[(f64, &Held)],
        scratch: &mut Scratch,
        arrivals: &mut [LineArrival; MAX_SOURCES],
    ) -> usize {
        let Self { plan, frequency_hz, band, reach, analysis } = *self;
        let bands = || about.iter().filter_map(|(w, held)| Some((*w, held.bands.get(band)?)));
        let (mut state, mut total) = (State::new(), 0.0);
        for (weight, of_step) in bands() {
            total += weight;
            plan.take(&mut state, 1.0 - weight / total, &of_step.values);
        }
        let own = bands().nth(reach).map_or(&[][..], |(_, own)| &own.values);
        // A step without usable snapshots has no bearing.
        let found = plan.find(&state, scratch, own, analysis.method, arrivals).unwrap_or(0);
        let as_found = *arrivals;
        let as_found = as_found.get(..found).unwrap_or_default();
        let width_hz = width_hz(analysis.frame_s);
        let mut count = 0;
        for (of, arrival) in as_found.iter().enumerate() {
            let transforms = bands().flat_map(|(weight, of_step)| {
                let each = weight / of_step.values.len().max(1) as f64;
                of_step.values.iter().zip(&of_step.slopes).map(move |both| (each, both))
            });
            let Heard { offset_hz, sd_hz } =
                plan.heard(as_found, of, transforms, state.snapshots(), width_hz);
            let heard_hz = frequency_hz + offset_hz;
            let sine = arrival.sine * frequency_hz / heard_hz;
            let sd = (arrival.sd * frequency_hz / heard_hz).hypot(sine * sd_hz / heard_hz);
            if let Some(slot) = arrivals.get_mut(count)
                && sine.abs() <= 1.0 + BEYOND * sd
            {
                *slot = LineArrival { sine: sine.clamp(-1.0, 1.0), sd, ..*arrival };
                count += 1;
            }
        }
        count
    }
}
