//! Where the vector of a vessel's arrival times should be, by the segments before.
//!
//! Enters: vectors ([`super::change`]) and when they were heard. Leaves: where the next should be, and how certain that is. A line through them, which is
//! held back to how fast vessels turn, rise and fall, and bent by as much as they themselves show and a vessel does that comes nearer or goes away.
//!
//! Cost: 500 instructions.

use super::jump::unit;
use super::plan::Plan;
use super::wavefront;
use crate::math::f32 as m;

/// Standard deviation of how fast a vessel turns whose past does not tell it, rad/s: 7 m/s 200 m away.
const TURNING_RAD_S: f32 = 0.035;
/// Standard deviation of what a course bends by until the newest segment, in units of the square of the angle turned: a vector that turns
/// evenly leaves a line through its past by a sixth of it, a vessel's bearing at its fastest change by as much again.
const BEND: f32 = 0.1;
/// Standard deviation of the speed with which a vessel comes nearer or goes away, m/s: with the depth it tells how fast its elevation changes.
const RISING_M_S: f32 = 5.0;
/// On a straight course r²φ' stays the same, for the distance r along the surface and the azimuth's rate φ', which so changes by −2φ'·r'/r. Standard deviation
/// of r', m/s (half of what vessels have: as much, and late channels hide in it), and most of r'/r, 1/s.
const NEARING_M_S: f32 = 2.5;
const MOST_NEARING_A_S: f32 = 0.5;

/// A vector, and the sample at which it was heard.
pub(super) type Heard = ([f32; 3], u64);

/// A track of vectors: place now, change a second, and factor of one segment's variance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    pub(super) place: [f32; 3],
    rate: [f32; 3],
    pub(super) factor: f32,
    /// The same of a hop's variance, upwards: now, and for the squared seconds later.
    pub(super) up: (f32, f32),
    /// What its level part bends by in the square of the time, 1/s², and the variance of what that moves it by.
    bend: [f32; 2],
    pub(super) bent: f32,
    /// How long ago its first segment was, seconds.
    length_s: f32,
}

impl Course {
    /// Of nothing; all zeros.
    pub(super) const NONE: Self = Self {
        place: [0.0; 3],
        rate: [0.0; 3],
        factor: 0.0,
        up: (0.0, 0.0),
        bend: [0.0; 2],
        bent: 0.0,
        length_s: 0.0,
    };

    /// What these tell, newest first, at sample `index`: for the variance that a vector's level part scatters by, what paths move it by at least, and what
    /// pairs move it up and down by where they go from the vessel to its image and back.
    #[inline(never)]
    pub(super) fn of(
        plan: &Plan,
        index: u64,
        used: &[Heard],
        (noise, floor): (f32, f32),
        hop: f32,
    ) -> Option<Self> {
        let (newest, _) = used.first()?;
        let n = used.len() as f32;
        let (mut mean, mut middle) = ([0.0f32; 3], 0.0);
        for (v, when) in used {
            middle -= seconds(plan, *when, index) / n;
            for k in 0..3 {
                mean[k] += v[k] / n;
            }
        }
        let (mut square, mut slope) = (0.0, [0.0f32; 3]);
        for (v, when) in used {
            let t = -seconds(plan, *when, index) - middle;
            square += t * t;
            for k in 0..3 {
                slope[k] += t * v[k];
            }
        }
        // A few segments tell less of its turning than a vessel's usual speed does, and where pairs go from vessel to image and back, less of its rise or fall.
        let level = square + noise / (TURNING_RAD_S * TURNING_RAD_S);
        let from = unit(newest);
        let known = hop / (RISING_M_S * from[2] * from[2] / plan.depth_m).max(f32::MIN_POSITIVE);
        let upright = (square + known * known).max(level);
        if !(level > 0.0) {
            return None;
        }
        let factor = |square: f32| 1.0 / n + middle * middle / square;
        let mut course = Self { factor: factor(level), ..Self::NONE };
        for (k, square) in [level, level, upright].into_iter().enumerate() {
            course.rate[k] = slope[k] / square;
            course.place[k] = mean[k] - middle * course.rate[k];
        }
        course.up = (factor(upright), 1.0 / upright);
        course.length_s = used.last().map_or(0.0, |(_, when)| seconds(plan, *when, index));
        course.bent_by(plan, index, used, noise + floor * floor, (middle, square));
        Some(course)
    }

    /// Bends it by as much as segments show beside a line, whose level parts err by this variance and which have this mean and sum of squares in time.
    #[inline(never)]
    fn bent_by(
        &mut self,
        plan: &Plan,
        index: u64,
        used: &[Heard],
        variance: f32,
        (middle, square): (f32, f32),
    ) {
        let [x, y, up] = used.first().map_or([0.0; 3], |(newest, _)| unit(newest));
        let level = m::hypot(x, y).max(0.1);
        let nearing =
            (NEARING_M_S * up.max(0.0) / (plan.depth_m * level).max(f32::MIN_POSITIVE)).min(MOST_NEARING_A_S);
        let prior = nearing * m::hypot(self.rate[0], self.rate[1]);
        // Of the square of the time what no line explains.
        let (mut cube, mut of) = (0.0, 0.0);
        for (_, when) in used {
            let t = -seconds(plan, *when, index) - middle;
            cube += t * t * t;
            of += 1.0;
        }
        let (spread, skew) = (square / of, cube / square.max(f32::MIN_POSITIVE));
        let beside = |t: f32| t * t - skew * t - spread;
        let (mut power, mut along) = (0.0, [0.0f32; 2]);
        for (v, when) in used {
            let q = beside(-seconds(plan, *when, index) - middle);
            power += q * q;
            along.iter_mut().zip(v).for_each(|(sum, x)| *sum += q * x);
        }
        let power = power + variance / (prior * prior).max(f32::MIN_POSITIVE);
        let now = beside(-middle);
        self.bend = along.map(|sum| sum / power);
        self.bent = now * now * variance / power;
        for ((place, rate), bend) in self.place.iter_mut().zip(&mut self.rate).zip(self.bend) {
            *place += now * bend;
            *rate -= (2.0 * middle + skew) * bend;
        }
    }

    /// The same so many seconds later.
    #[inline(never)]
    pub(super) fn later(&self, t: f32) -> Self {
        let mut course = *self;
        for (place, rate) in course.place.iter_mut().zip(&course.rate) {
            *place += t * rate;
        }
        for ((place, rate), bend) in course.place.iter_mut().zip(&mut course.rate).zip(course.bend) {
            *place += t * t * bend;
            *rate += 2.0 * t * bend;
        }
        // The variance of what a line gives grows with the square of the time from its middle, of what a bend gives with that squared.
        let grown = 1.0 + t / (0.5 * course.length_s).max(0.1);
        let grown = grown * grown;
        course.factor *= grown;
        course.bent *= grown * grown;
        let (now, rate) = course.up;
        let sum = m::sqrt(now) + t * m::sqrt(rate);
        course.up.0 = sum * sum;
        course.length_s += t;
        course
    }

    /// Standard deviation of what its turning moves a vector by that no line has.
    pub(super) fn turn(&self) -> f32 {
        BEND * wavefront::dot(&self.rate, &self.rate) * self.length_s * self.length_s
    }
}

#[inline(never)]
pub(super) fn seconds(plan: &Plan, from: u64, to: u64) -> f32 {
    to.saturating_sub(from) as f32 / plan.rate_hz
}
