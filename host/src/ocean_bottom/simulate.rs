//! The simulator: a scenario becomes blocks of four-channel codes in the order pressure, north, east, vertical.
//!
//! Samples come in order and in fixed memory, so that a week can run straight into the core. Everything random comes
//! from the scenario's seed. [`Simulator`] is a [`BlockSource`].

use super::ambient::{AmbientNoise, Directional, HOP, Shaking};
use super::event::{Caller, HeardEvent, Species, Wave};
use super::passage::{Field, ReceivedVessel, gain};
use super::scenario::{ObsFault, ObsScenario, Radiation};
use super::source::{Modulation, NoiseShape, Radiator, ToneLine};
use crate::course::VesselCourse;
use crate::propagation::Propagation;
use crate::recording::BlockSource;
use anyhow::Result;
use seabearing_core::block::{Block, Frame, MISSING};
use std::collections::VecDeque;

/// Full scale of the simulated converter (24 bits).
const FULL_SCALE: f32 = 8_388_607.0;

/// Range at which levels of vessels are stated, m.
const REFERENCE_M: f64 = 20_000.0;

/// Noise bandwidth of one bin of the 1024-point Hann spectrum at 50 Hz.
const BIN_HZ: f64 = 1.5 * 50.0 / 1024.0;

/// One vessel in the truth.
#[derive(Clone, Debug)]
pub struct MovingVessel {
    /// Its name.
    pub name: String,
    /// How it moves.
    pub course: VesselCourse,
    /// When it sounds, s.
    pub active_s: (f64, f64),
}

/// A vessel on a course of its own, beside those of the scenario file.
#[derive(Clone, Debug)]
pub struct Extra {
    /// The vessel.
    pub vessel: MovingVessel,
    /// What it radiates.
    pub radiation: Radiation,
}

/// The simulator of one scenario.
pub struct Simulator {
    scenario: ObsScenario,
    table: Propagation,
    start: time::OffsetDateTime,
    ambient: AmbientNoise,
    passages: Vec<ReceivedVessel>,
    callers: Vec<Caller>,
    waves: Vec<Wave>,
    /// Vessels, for the truth.
    pub vessels: Vec<MovingVessel>,
    next: u64,
    end: u64,
    /// Runs of samples ready to leave.
    ready: VecDeque<(u64, Vec<Frame>)>,
    out: (u64, Vec<Frame>),
}

/// Root-mean-square amplitudes of a vessel at 1 m from its levels at 20 km.
fn radiator(r: &Radiation, ambient_rms: f64, rate_hz: f64, gain_20_km: f64, seed: u64) -> Radiator {
    let density = ambient_rms.powi(2) / (rate_hz / 2.0);
    // Power of the noise's shape in 5 to 25 Hz against all of it.
    let shape = NoiseShape { centre_hz: r.centre_hz, half_width_hz: r.half_width_hz };
    let power = |lo: u32| (lo..250).map(|k| shape.at(0.1 * f64::from(k)).powi(2)).sum::<f64>();
    let part = power(50) / power(0);
    let noise = 10f64.powf(r.wideband_db / 10.0) * density * 20.0 / (part * gain_20_km);
    let line = (2.0 * 10f64.powf(r.tone_db / 10.0) * density * BIN_HZ / gain_20_km).sqrt();
    // Harmonic k is log2 k octaves above the first.
    let comb = |hz: f64| {
        let harmonics = (1..).map(f64::from).take_while(move |k| hz > 0.0 && hz * k < 24.5);
        harmonics.map(move |k| ToneLine {
            hz: hz * k,
            amplitude: line * 10f64.powf(-r.comb_fall_db * k.log2() / 20.0),
        })
    };
    let single = r.tones_hz.iter().filter(|f| **f > 0.0 && **f < 24.8);
    let tones = single
        .map(|hz| ToneLine { hz: *hz, amplitude: line })
        .chain(comb(r.blade_hz))
        .chain(comb(r.engine_hz))
        .collect();
    let modulation = (r.modulation > 0.0).then_some(Modulation { hz: r.blade_hz, depth: r.modulation });
    Radiator::shaped(noise.sqrt(), shape, modulation, tones, r.wander, seed)
}

impl Simulator {
    /// Prepares a scenario.
    ///
    /// # Errors
    /// A value of the scenario, or a table that says nothing about 20 km, where levels are stated.
    pub fn new(scenario: ObsScenario, table: Propagation, extra: Vec<Extra>) -> Result<Self> {
        scenario.check()?;
        let start = scenario.start;
        let (rate, rms, paths) = (scenario.rate_hz, scenario.ambient.pressure_counts, scenario.paths);
        let reference = gain(&table, paths, REFERENCE_M);
        if reference <= 0.0 {
            anyhow::bail!("the propagation table has no path at 20 km, where levels are stated");
        }
        // Every source has a seed of its own, far from its neighbours'.
        let mut number = 0u64;
        let mut seed = || {
            number += 1;
            seabearing_core::wire::hash::fnv1a(&[scenario.seed.to_le_bytes(), number.to_le_bytes()].concat())
        };
        let straight = scenario.vessels.iter().enumerate().map(|(i, s)| Extra {
            vessel: MovingVessel {
                name: if s.name.is_empty() { format!("ship-{}", i + 1) } else { s.name.clone() },
                course: VesselCourse::straight(&s.straight),
                active_s: (s.active_s[0], s.active_s[1]),
            },
            radiation: s.radiation.clone(),
        });
        let all: Vec<Extra> = straight.chain(extra).collect();
        let passages = all
            .iter()
            .map(|e| {
                let v = e.vessel.clone();
                let r = radiator(&e.radiation, rms, rate, reference, seed());
                ReceivedVessel::new(v.name, v.course, v.active_s, paths, r)
            })
            .collect();
        let whales = [(Species::Fin, &scenario.fin_whale), (Species::Blue, &scenario.blue_whale)];
        let callers = whales
            .into_iter()
            .flat_map(|(species, list)| list.iter().map(move |w| (species, w)))
            .filter_map(|(species, w)| Caller::new(species, w, rms, &table, paths))
            .collect();
        let bin = (rms.powi(2) / (rate / 2.0) * BIN_HZ).sqrt();
        let straight_up_s = table.arrival(0, 0.0).map_or(0.0, |a| a.toa_s);
        let waves = (scenario.earthquake.iter().map(|b| Wave::earthquake(b, rms, seed(), straight_up_s)))
            .collect::<Vec<_>>()
            .into_iter()
            .chain(scenario.t_phase.iter().map(|b| Wave::t_phase(b, rms, seed())).collect::<Vec<_>>())
            .chain(scenario.strumming.iter().map(|s| Wave::strumming(s, bin, seed())).collect::<Vec<_>>())
            .collect();
        let a = &scenario.ambient;
        let factor = |db: f64| rms * 10f64.powf(db / 20.0);
        let levels = [rms, factor(a.horizontal_db), factor(a.horizontal_db), factor(a.vertical_db)];
        let directional = a
            .directional
            .iter()
            .map(|d| Directional {
                azimuth: d.azimuth_deg.to_radians(),
                rms: factor(d.level_db),
                elevation: 0.3,
            })
            .collect();
        let shaking = (a.shaking.iter())
            .map(|s| Shaking { axis: s.axis_deg.to_radians(), rms: factor(s.level_db) })
            .collect();
        let ambient = AmbientNoise::new(rate, levels, a.microseism_db, directional, shaking, seed());
        let end = (scenario.duration_s * rate).round() as u64;
        Ok(Self {
            table,
            start,
            ambient,
            passages,
            callers,
            waves,
            vessels: all.into_iter().map(|e| e.vessel).collect(),
            next: 0,
            end,
            ready: VecDeque::new(),
            out: (0, Vec::new()),
            scenario,
        })
    }

    /// The scenario.
    pub fn scenario(&self) -> &ObsScenario {
        &self.scenario
    }

    /// The propagation table.
    pub fn table(&self) -> &Propagation {
        &self.table
    }

    /// Whales, earthquakes and the like, for the truth.
    pub fn heard(&self) -> Vec<HeardEvent> {
        let mut all: Vec<HeardEvent> = self.callers.iter().map(|c| c.heard(&self.table)).collect();
        all.extend(self.waves.iter().map(Wave::heard));
        all.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        all
    }

    /// Samples in the whole recording.
    pub fn len(&self) -> u64 {
        self.end
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.end == 0
    }

    /// The next run of samples with the index its clock gives it; `None` at the end.
    pub fn next_run(&mut self) -> Option<(u64, Vec<Frame>)> {
        while self.ready.is_empty() && self.next < self.end {
            self.make();
        }
        self.ready.pop_front()
    }

    fn make(&mut self) {
        let rate = self.scenario.rate_hz;
        let mut field = self.ambient.next_hop();
        for p in &mut self.passages {
            p.add(&self.table, rate, self.next, &mut field);
        }
        for c in &self.callers {
            c.add(&self.table, self.scenario.paths, rate, self.next, &mut field);
        }
        for w in &mut self.waves {
            w.add(rate, self.next, &mut field);
        }
        let n = (self.end - self.next).min(HOP as u64) as usize;
        let frames: Vec<Frame> = field.iter().take(n).enumerate().map(|(i, f)| self.frame(i, f)).collect();
        self.cut(frames);
        self.next += n as u64;
    }

    /// Components, polarity, converter and dead channels.
    fn frame(&self, i: usize, field: &Field) -> Frame {
        let s = &self.scenario;
        let (sin, cos) = s.orientation_of_north_deg.to_radians().sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let [p, e, n, u] = *field;
        let sign = if s.intensity == "towards" { -1.0 } else { 1.0 };
        let values = [p, sign * (n * cos + e * sin), sign * (e * cos - n * sin), sign * u];
        let mut frame = values.map(|x| x.round().clamp(-FULL_SCALE, FULL_SCALE) as i32);
        let t = (self.next + i as u64) as f64 / s.rate_hz;
        for fault in &s.faults {
            match *fault {
                ObsFault::Dead(a) if a.at(t) => frame[a.channel] = 0,
                ObsFault::Saturated(a) if a.at(t) => frame[a.channel] = FULL_SCALE as i32,
                ObsFault::Missing(c) => frame[c.channel] = MISSING,
                ObsFault::Spikes(k) => {
                    // From the sample on in which the next multiple of the interval falls.
                    let number = |t: f64| (t / k.every_s).floor();
                    if t >= k.every_s && number(t) != number(t - k.samples as f64 / s.rate_hz) {
                        for x in frame.iter_mut().filter(|x| **x != MISSING) {
                            *x = (f64::from(*x) + k.counts)
                                .clamp(-f64::from(FULL_SCALE), f64::from(FULL_SCALE))
                                as i32;
                        }
                    }
                }
                ObsFault::Clipped(c) => {
                    let most = c.counts as i32;
                    let there = frame.iter_mut().filter(|x| **x != MISSING);
                    there.for_each(|x| *x = (*x).clamp(-most, most));
                }
                _ => {}
            }
        }
        frame
    }

    /// Gaps and clock steps cut the frames into runs.
    fn cut(&mut self, frames: Vec<Frame>) {
        let s = &self.scenario;
        let steps: Vec<(f64, f64)> = (s.faults.iter())
            .filter_map(|f| if let ObsFault::ClockStep(c) = f { Some((c.at_s, c.by_s)) } else { None })
            .collect();
        if s.gaps.is_empty() && steps.is_empty() {
            self.ready.push_back((self.next, frames));
            return;
        }
        let mut run: Option<(u64, Vec<Frame>)> = None;
        for (i, frame) in frames.into_iter().enumerate() {
            let t = (self.next + i as u64) as f64 / s.rate_hz;
            let step: f64 = steps.iter().filter(|c| c.0 <= t).map(|c| c.1).sum();
            let index = (self.next + i as u64).saturating_add_signed((step * s.rate_hz).round() as i64);
            let lost = s.gaps.iter().any(|g| (g.start_s..g.start_s + g.duration_s).contains(&t));
            match &mut run {
                Some((first, held)) if !lost && *first + held.len() as u64 == index => held.push(frame),
                _ => {
                    self.ready.extend(run.take());
                    run = (!lost).then(|| (index, vec![frame]));
                }
            }
        }
        self.ready.extend(run);
    }
}

impl BlockSource for Simulator {
    fn start(&self) -> Option<time::OffsetDateTime> {
        Some(self.start)
    }

    fn expected_end(&self) -> Option<u64> {
        Some(self.end)
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        let Some(run) = self.next_run() else { return Ok(None) };
        self.out = run;
        Ok(Some(Block { first_index: self.out.0, frames: &self.out.1 }))
    }
}
