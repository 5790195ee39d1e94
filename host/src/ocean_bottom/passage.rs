//! What a station receives of one moving vessel: every path with its own time of emission, phase and strength.
//!
//! Sound that arrives at t over path n left at tₙ with t = tₙ + Tₙ(r(tₙ)); it carries the conjugate of the table's
//! amplitude times the vessel's analytic signal at tₙ. Pressure is the real part of the sum. Particle velocity, in
//! units of pressure over ρc, is its part sin θ = c dTₙ/dr horizontally away from where the vessel was at tₙ, and
//! vertically cos θ (1 − R)/(1 + R) down, R the floor's coefficient: the floor moves as incident and reflected wave do.
//! Delays, amplitudes and azimuths are exact at nodes half a second apart and linear between them.

use super::source::Radiator;
use crate::course::{VesselCourse, polar};
use crate::propagation::bottom::Bottom;
use crate::propagation::{Complex, Propagation};

/// Speed of sound at the floor assumed for angles of incidence, m/s.
const FLOOR_M_S: f64 = 1520.0;

/// Samples from one node to the next.
const NODE: usize = 25;

/// Steps of the fixed point for the time of emission; each gains a factor of speed / sound speed, about 200.
const RETARDATION_STEPS: usize = 4;

/// Pressure and velocity in East, North, Up, in units of pressure.
pub type Field = [f32; 4];

/// One path at one node.
#[derive(Clone, Copy, Default)]
struct Node {
    delay_s: f64,
    amplitude: Complex<f64>,
    /// Velocity over pressure: East, North.
    horizontal: (f64, f64),
    /// Velocity over pressure, Up.
    vertical: Complex<f64>,
}

/// One vessel as received.
pub struct ReceivedVessel {
    /// Name in the truth.
    pub name: String,
    /// How it moves.
    pub course: VesselCourse,
    /// First and last time at which it sounds, s.
    pub active_s: (f64, f64),
    /// Paths received, counted from the direct one.
    pub paths: usize,
    radiator: Radiator,
}

impl ReceivedVessel {
    /// A vessel on a course.
    pub fn new(
        name: String,
        course: VesselCourse,
        active_s: (f64, f64),
        paths: usize,
        radiator: Radiator,
    ) -> Self {
        Self { name, course, active_s, paths, radiator }
    }

    /// Adds what arrives in samples `first..` (at `rate_hz`) to a field.
    pub fn add(&mut self, table: &Propagation, rate_hz: f64, first: u64, out: &mut [Field]) {
        let time = |i: usize| (first as f64 + i as f64) / rate_hz;
        let (from, to) = (time(0), time(out.len()));
        // Nothing outlasts the slowest path of the table.
        let slowest = table
            .paths
            .iter()
            .take(self.paths)
            .filter_map(|p| p.arrivals.iter().rev().flatten().next())
            .map(|a| a.toa_s)
            .fold(0.0, f64::max);
        if to < self.active_s.0 || from > self.active_s.1 + slowest + 1.0 {
            return;
        }
        let paths = self.paths.min(table.paths.len());
        let mut before = self.nodes(table, paths, time(0));
        if out.len() > NODE
            && before.iter().all(Option::is_none)
            && self.nodes(table, paths, to).iter().all(Option::is_none)
        {
            return;
        }
        self.radiator.prepare(from - slowest - 1.0, to);
        for (k, chunk) in out.chunks_mut(NODE).enumerate() {
            let after = self.nodes(table, paths, time((k + 1) * NODE));
            for (a, b) in before.iter().zip(&after) {
                let (a, b) = match (a, b) {
                    (Some(a), Some(b)) => (*a, *b),
                    // A path that begins or ends here fades over one node.
                    (Some(a), None) => (*a, Node { amplitude: Complex::default(), ..*a }),
                    (None, Some(b)) => (Node { amplitude: Complex::default(), ..*b }, *b),
                    (None, None) => continue,
                };
                for (i, field) in chunk.iter_mut().enumerate() {
                    let w = i as f64 / NODE as f64;
                    let mix = |x: f64, y: f64| x + (y - x) * w;
                    let t = time(k * NODE + i) - mix(a.delay_s, b.delay_s);
                    if t < self.active_s.0 || t > self.active_s.1 {
                        continue;
                    }
                    let p = (a.amplitude + (b.amplitude - a.amplitude) * w) * self.radiator.at(t);
                    field[0] += p.re as f32;
                    field[1] += (p.re * mix(a.horizontal.0, b.horizontal.0)) as f32;
                    field[2] += (p.re * mix(a.horizontal.1, b.horizontal.1)) as f32;
                    field[3] += (p * a.vertical).re as f32;
                }
            }
            before = after;
        }
    }

    fn nodes(&self, table: &Propagation, paths: usize, t_s: f64) -> Vec<Option<Node>> {
        (0..paths).map(|n| node(table, &self.course, n, t_s)).collect()
    }
}

/// Time of emission, range and azimuth of what arrives at a time over a path; `None` where it cannot arrive.
pub fn emission(
    table: &Propagation,
    course: &VesselCourse,
    path: usize,
    t_s: f64,
) -> Option<(f64, f64, f64)> {
    let mut left = t_s;
    let mut polar_then = polar(course.at(t_s).or_else(|| course.at(t_s - 30.0))?);
    for _ in 0..RETARDATION_STEPS {
        left = t_s - table.arrival(path, polar_then.0)?.toa_s;
        polar_then = polar(course.at(left)?);
    }
    Some((left, polar_then.0, polar_then.1))
}

fn node(table: &Propagation, course: &VesselCourse, path: usize, t_s: f64) -> Option<Node> {
    let (left, range, azimuth) = emission(table, course, path, t_s)?;
    let arrival = table.arrival(path, range)?;
    let slowness = table.slowness_s_m(path, range)?;
    let sine = (slowness * FLOOR_M_S).clamp(0.0, 1.0);
    let (vertical, horizontal) = directions(slowness, azimuth, sine);
    Some(Node { delay_s: t_s - left, amplitude: arrival.amplitude.conj(), horizontal, vertical })
}

/// Velocity over pressure of a wave from an azimuth: Up, and (East, North), away from the source.
fn directions(slowness_s_m: f64, azimuth: f64, sine: f64) -> (Complex<f64>, (f64, f64)) {
    let r = Bottom::default().reflection(slowness_s_m, FLOOR_M_S).conj();
    let one = Complex::new(1.0, 0.0);
    let ratio = if (one + r).norm() > 1e-3 { (one - r) / (one + r) } else { Complex::default() };
    let (s, c) = azimuth.sin_cos();
    (-ratio * (1.0 - sine * sine).sqrt(), (-sine * s, -sine * c))
}

/// Adds a short sound of given form, emitted at `at_s` from a place at rest, over all paths of a table.
pub fn add_event(
    table: &Propagation,
    paths: usize,
    rate_hz: f64,
    first: u64,
    out: &mut [Field],
    place: (f64, f64),
    at_s: f64,
    duration_s: f64,
    form: impl Fn(f64) -> Complex<f64>,
) {
    let (range, azimuth) = polar(place);
    for n in 0..paths.min(table.paths.len()) {
        let (Some(arrival), Some(slowness)) = (table.arrival(n, range), table.slowness_s_m(n, range)) else {
            continue;
        };
        let sine = (slowness * FLOOR_M_S).clamp(0.0, 1.0);
        let (vertical, horizontal) = directions(slowness, azimuth, sine);
        let start = (at_s + arrival.toa_s) * rate_hz - first as f64;
        let end = start + duration_s * rate_hz;
        if end < 0.0 || start > out.len() as f64 {
            continue;
        }
        let from = start.max(0.0).ceil() as usize;
        let to = (end.max(0.0) as usize).min(out.len());
        for (i, field) in out.iter_mut().enumerate().take(to).skip(from) {
            let p = arrival.amplitude.conj() * form((i as f64 - start) / rate_hz);
            field[0] += p.re as f32;
            field[1] += (p.re * horizontal.0) as f32;
            field[2] += (p.re * horizontal.1) as f32;
            field[3] += (p * vertical).re as f32;
        }
    }
}

/// Mean power of a steady unit signal received from a range: Σ|Aₙ|² over the paths that exist.
pub fn gain(table: &Propagation, paths: usize, range_m: f64) -> f64 {
    (0..paths).filter_map(|n| table.arrival(n, range_m)).map(|a| a.amplitude.norm_sqr()).sum()
}

#[cfg(test)]
mod tests {
    use super::super::source::ToneLine;
    use super::*;
    use crate::propagation::{profile::SpeedProfile, trace};

    fn table() -> Propagation {
        let profile =
            SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        trace::trace("t", &profile, &Bottom::default(), 140.0, 400, || ())
    }

    #[test]
    fn emission_and_travel_add_up() {
        let t = table();
        let course = VesselCourse::by_cpa(3600.0, 9000.0, 1.0, 8.0, true);
        for path in 0..5 {
            for at in [100.0, 3600.0, 6000.0] {
                let Some((left, range, _)) = emission(&t, &course, path, at) else { continue };
                assert!((left + t.arrival(path, range).unwrap().toa_s - at).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn velocity_points_away_from_the_vessel() {
        let t = table();
        // At rest 12 km to the north-east, one steady tone.
        let d = 12_000.0 / 2f64.sqrt();
        let course = VesselCourse::Fixes(vec![(-100.0, (d, d)), (500.0, (d, d))]);
        let radiator = Radiator::new(0.0, vec![ToneLine { hz: 15.3, amplitude: 1e4 }], 0.0, 3);
        let mut p = ReceivedVessel::new("v".into(), course, (-100.0, 500.0), 1, radiator);
        let mut out = vec![[0.0f32; 4]; 4096];
        p.add(&t, 50.0, 5000, &mut out);
        let east: f32 = out.iter().map(|f| f[0] * f[1]).sum();
        let north: f32 = out.iter().map(|f| f[0] * f[2]).sum();
        assert!(east < 0.0 && (east / north - 1.0).abs() < 1e-3, "{east} {north}");
        let power: f32 = out.iter().map(|f| f[0] * f[0]).sum::<f32>() / 4096.0;
        let want = 0.5e8 * gain(&t, 1, 12_000.0);
        assert!((f64::from(power) / want - 1.0).abs() < 0.02, "{power} {want}");
    }
}
