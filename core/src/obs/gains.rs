//! Whether the horizontal components are of one gain: by their noise, and by the vessels that both have heard.
//!
//! Enters: moments of minutes with and without a vessel. Leaves: by how much north is louder than east, and how sure that is; the news
//! that they are unequal, or may be, or no longer.
//!
//! - Noise. What of a horizontal component's power is not coherent with pressure is noise without a direction. The median of its
//!   ratio over minutes without a vessel is followed in small steps, larger ones at first and where it is far off: an hour of a shaking
//!   instrument moves it by a third of a decibel. Noise of several directions at once makes 1.5 dB of difference; its minutes are
//!   told by their horizontal components, which go together, unless its axis is one of theirs. While few are had the ratio is the mean over minutes with vessels.
//! - Vessels. A sensor or its place may be noisier than the other and as true. What of pressure is found in a component is that
//!   part of the sound along it, times its gain; the sum of both squares is the same from all sides where gains are, and goes with how well the vessel
//!   is heard, as the multiple coherence of pressure with both does, whatever their gains. So squares `X` and `Y` of minutes
//!   with a vessel, over that, lie on a line `α X + β Y = 1`, whose slope is the squared gain `β/α`: least squares, whose deviation is what they scatter.
//!   Of 24 days of five vessels it errs by 0.3 dB root mean square after 160 minutes (by 0.9 dB without the coherence, which makes eight tenths of the
//!   scatter). Where one is noisier, vessels along it are heard less well: a quarter of the ratio is taken for gain.
//! - Changes. Where the mean ratio of the last minutes without a vessel is another one, something became of a component: what vessels said
//!   before is of what it was, and the question is open again.
//! - Jumps. A gain that jumps from one moment to the next beside a vessel is known at once ([`super::jump`]), and what noise and vessels have said stays true of
//!   what is heard without it; where no vessel is heard the ratio jumps, and the question is open again.
//! - Time. An instrument that shakes along one component is as one of another gain until the tide turns: nothing of either is told before.
//! - Both. The ratio of the noise is one of gain, or of noise alone; without vessels neither is likelier, and what is told lies between them, as
//!   uncertain as they are apart. Vessels decide.
//!
//! Assumes: that a vessel's sound comes as steeply from one side as from another. Cost: 150 instructions a minute.

use super::moments::Moments;
use crate::math;

/// Least step of the medians, dB a minute; it is larger while they are of few minutes, and becomes smaller as they grow in number, to that share of it, for
/// hours of an instrument that shakes less than is noticed must not move them.
const STEP_DB: f32 = 0.01;
const FIRST_DB: f32 = 1.0;
const SETTLED: f32 = 400.0;
const MANY: f32 = 10_000.0;
const LEAST_STEP: f32 = 0.3;

/// Distance from the median at which the step of the ratio is twice as large, dB; it grows with its square.
const FAR_DB: f32 = 3.0;

/// A minute is no measure of the gain where the horizontal motion is this much above its median against pressure, dB.
const SHAKING_DB: f32 = 1.0;

/// What is left of the horizontal components has a direction of its own where they go together by more than this, twice what
/// chance makes of a minute: noise of several directions at once.
const TOGETHER: f32 = 0.08;

/// Least squared coherence with pressure of one component in a minute whose vessel counts.
const STRONG: f32 = 0.2;

/// Such minutes that are remembered, those that say as much as one where they are neighbours, and those before which they say nothing.
const MEMORY: f32 = 720.0;
const NEIGHBOURS: f64 = 15.0;
const LEAST: f32 = 40.0;

/// Deviation of what vessels say of the gain where there are many, dB: sound of some sides comes more steeply.
const BY_VESSELS_DB: f64 = 0.5;

/// Of the ratio of noise that is no gain, what vessels make of it, and its deviation.
const TAKEN: f64 = 0.25;
const TAKEN_SD: f64 = 0.2;

/// Ratio below which noise says nothing of the gain, and from which on gain is as likely as noise, dB: noise of one side makes 0.7 dB.
const ALIKE_DB: f32 = 1.25;
const UNEQUAL_DB: f32 = 2.0;

/// Probability at which unequal gains are told, and below which they are told to be over, or below this ratio, dB.
const TOLD: f32 = 0.95;
const OVER: f32 = 0.5;
const EQUAL_DB: f32 = 1.5;

/// Minutes in which one is louder, from which on it is told that it is, or that either may be so: a tide's current, which flows one way for 6.2 hours, shakes an
/// instrument for less. Minutes without a vessel from which on what is open is told, the least probability of a gain at which it is, and below which vessels have decided.
const LOUDER: u16 = 480;
const HEARD: f32 = 120.0;
const OPEN: f32 = 0.3;
const DECIDED: f32 = 0.1;

/// Deviation of what is told of both possibilities, of its distance to the farther one, and that of the ratio of noise where it is one of gain, dB.
const FARTHER: f32 = 0.6;
const BY_NOISE_DB: f32 = 0.7;

/// Minutes without a vessel below which those with one are better than none, most of these that the ratio is the mean of, and that deviation
/// while it is of them, dB: of 36 days whose vessels are heard from the first minute on, the mean of 60 and of 240 is 1.0 dB off, of whatever coherence.
const YOUNG: f32 = 10.0;
const BESIDE: f32 = 240.0;
const BESIDE_DB: f32 = 1.0;

/// Minutes without a vessel whose mean is looked at for a change, and what is one, dB: of 1070 such means of 36 simulated days the farthest is 1.0 dB off. And
/// minutes that the ratio counts as of after one.
const RECENT: f32 = 15.0;
const CHANGED_DB: f32 = 1.25;
const AFRESH: f32 = 10.0;

/// Deviation of a gain that has jumped beside a vessel, dB.
const KNOWN_DB: f32 = 0.4;

/// Natural logarithm of the odds at which vessels say that it was none.
const SURE: f64 = 3.0;

/// Natural logarithm of an amplitude's ratio of one decibel.
const NEPER: f32 = core::f32::consts::LN_10 / 20.0;

/// Probability below which a possibility fades from what is stated.
const FADES: f32 = 0.05;

/// Share of a doubt that is gone each minute after vessels have decided: courses hold directions told before.
const FORGOTTEN: f32 = 1.0 / 120.0;

/// State.
#[derive(Clone, Debug)]
pub(super) struct Gains {
    /// Medians of north over east, and of both over pressure, dB.
    ratio_db: f32,
    motion_db: Option<f32>,
    /// Minutes they are of, by their weights, and those with a vessel.
    compared: f32,
    beside: f32,
    /// Mean of the ratio over the last minutes without a vessel, dB, and their number.
    recent_db: f32,
    recent: f32,
    /// Sums over minutes with a vessel of X², XY, Y², X, Y, and their number.
    sums: [f32; 6],
    /// Variance that is stated, dB².
    doubt_db2: f32,
    said: bool,
    in_doubt: bool,
    /// Minutes in which one has been louder than the other, in a row.
    louder: u16,
    /// What is certain of it, dB: the sum of its jumps beside vessels. All else is of what is heard without it.
    known_db: f32,
    /// The last of these, dB; 0 where vessels have said that it was none.
    jump_db: f32,
}

/// North's gain over east's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gain {
    /// Decibels.
    pub(super) db: f32,
    /// Its standard deviation, dB.
    pub(super) sd_db: f32,
}

/// A ratio of powers in decibels.
fn decibels(ratio: f32) -> f32 {
    10.0 * math::f32::log10(ratio)
}

impl Gains {
    /// Nothing known; all zeros.
    pub(super) const fn new() -> Self {
        Self {
            ratio_db: 0.0,
            motion_db: None,
            compared: 0.0,
            beside: 0.0,
            recent_db: 0.0,
            recent: 0.0,
            sums: [0.0; 6],
            doubt_db2: 0.0,
            said: false,
            in_doubt: false,
            louder: 0,
            known_db: 0.0,
            jump_db: 0.0,
        }
    }

    /// Takes a minute without a vessel, or one whose vessel is hardly heard, which counts for less; whether the noise has changed.
    pub(super) fn noise(&mut self, m: &Moments, weight: f32) -> bool {
        let Some([north, east, together]) = m.own_of_horizontals() else { return false };
        let [pressure, ..] = m.power;
        if math::f32::abs(together) > TOGETHER * math::f32::sqrt(north * east) {
            return false;
        }
        let now_db = decibels(north / east);
        if weight >= 1.0 && self.has_changed(now_db) {
            return true;
        }
        self.compared = (self.compared + weight).min(MANY);
        let settled = (SETTLED / self.compared).clamp(LEAST_STEP, 1.0);
        let step_db = weight * (STEP_DB * settled).max(FIRST_DB / self.compared);
        // A shaking instrument says nothing of its gain; beside a vessel's pressure it is not told.
        let shakes = weight >= 1.0 && {
            let motion_db = decibels((north + east) / pressure);
            let usual_db = self.motion_db.get_or_insert(motion_db);
            *usual_db += step_db * (motion_db - *usual_db).signum();
            motion_db >= *usual_db + SHAKING_DB
        };
        if !shakes {
            let off_db = now_db - self.ratio_db;
            let far = off_db / FAR_DB;
            let step_db = (step_db * (1.0 + far * far)).min(math::f32::abs(off_db));
            self.ratio_db += step_db * off_db.signum();
        }
        false
    }

    /// Whether the mean of the last minutes is another than the median, which is of it from then on.
    fn has_changed(&mut self, now_db: f32) -> bool {
        self.recent += 1.0;
        self.recent_db += (now_db - self.recent_db) / self.recent.min(RECENT);
        let change_db = math::f32::abs(self.recent_db - self.ratio_db);
        let changed = self.recent >= RECENT && self.compared >= YOUNG && change_db > CHANGED_DB;
        if changed {
            self.ratio_db = self.recent_db;
            self.starts_afresh();
        }
        changed
    }

    /// North is louder beside east by so much than it was, from one moment to the next; whether that is certainly its gain.
    pub(super) fn jumped(&mut self, by_db: f32, certain: bool) {
        if certain {
            // What noise said stays true of what is heard without it; what vessels say from now on must not contradict it.
            self.known_db += by_db;
            self.jump_db = by_db;
            self.sums = [0.0; 6];
        } else {
            self.ratio_db += by_db;
            self.starts_afresh();
        }
    }

    /// Moments as they would be without the gain that is certain.
    pub(super) fn without_known(&self, m: &Moments) -> Moments {
        if self.known_db == 0.0 { *m } else { m.with_north(math::f32::exp(-NEPER * self.known_db)) }
    }

    /// And with it again.
    pub(super) fn with_known(&self, m: &Moments) -> Moments {
        if self.known_db == 0.0 { *m } else { m.with_north(math::f32::exp(NEPER * self.known_db)) }
    }

    /// What vessels said, and most of the noise, is of what was.
    fn starts_afresh(&mut self) {
        (self.compared, self.motion_db, self.louder) = (AFRESH, None, 0);
        // The mean holds minutes of both; the next is of one alone.
        self.recent = 0.0;
        self.sums = [0.0; 6];
    }

    /// Takes a minute with a vessel, of which the noise is had while there is no other.
    pub(super) fn beside(&mut self, m: &Moments) {
        if self.is_young()
            && let Some([north, east, _]) = m.own_of_horizontals()
        {
            self.beside = (self.beside + 1.0).min(BESIDE);
            self.ratio_db += (decibels(north / east) - self.ratio_db) / (self.beside + 2.0 * self.compared);
        }
    }

    fn is_young(&self) -> bool {
        self.compared < YOUNG
    }

    /// Takes a minute with one vessel.
    // Of its own: `Checks::minute` takes less flash without it.
    #[inline(never)]
    pub(super) fn vessel(&mut self, m: &Moments) {
        let ([pressure, north, east, _], [_, of_north, of_east, _]) = (m.power, m.with_pressure);
        let squared =
            |power: f32, product: f32| product * product / (power * pressure).max(f32::MIN_POSITIVE);
        if !(squared(north, of_north).max(squared(east, of_east)) >= STRONG) {
            return;
        }
        // Multiple coherence of pressure with both.
        let determinant = north * east - m.north_east * m.north_east;
        let explained =
            of_north * of_north * east - 2.0 * of_north * of_east * m.north_east + of_east * of_east * north;
        let coherence = explained / (determinant * pressure);
        if !(determinant > 0.0 && coherence > 0.0) {
            return;
        }
        // To the power of three quarters: of 14 000 minutes the sum of squares goes with that within a tenth, and varies by a third.
        let root = math::f32::sqrt(coherence);
        let heard = root * math::f32::sqrt(root);
        let [x, y] = [of_north, of_east].map(|product| (product / pressure) * (product / pressure) / heard);
        let [.., n] = self.sums;
        let kept = if n >= MEMORY { 1.0 - 1.0 / MEMORY } else { 1.0 };
        for (sum, new) in self.sums.iter_mut().zip([x * x, x * y, y * y, x, y, 1.0]) {
            *sum = *sum * kept + new;
        }
    }

    /// North's gain over east's by what both heard of vessels, and its variance, dB and dB².
    fn by_vessels(&self) -> Option<(f64, f64)> {
        let [xx, xy, yy, x, y, n] = self.sums.map(f64::from);
        let determinant = xx * yy - xy * xy;
        let (alpha, beta) = ((yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant);
        if n < f64::from(LEAST) || !(alpha > 0.0 && beta > 0.0 && determinant > 0.0) {
            return None;
        }
        let scatter = (1.0 - (alpha * x + beta * y) / n).max(0.0);
        let relative = yy / (alpha * alpha) + xx / (beta * beta) + 2.0 * xy / (alpha * beta);
        let a_decibel = core::f64::consts::LN_10 / 10.0;
        let variance = scatter * NEIGHBOURS * relative / (determinant * a_decibel * a_decibel);
        Some((10.0 * math::f64::log10(beta / alpha), variance + BY_VESSELS_DB * BY_VESSELS_DB))
    }

    /// Probability that the ratio of the noise is one of gain.
    fn probability(&self) -> f32 {
        let odds = ((math::f32::abs(self.ratio_db) - ALIKE_DB) / (UNEQUAL_DB - ALIKE_DB)).clamp(0.0, 1.0);
        let ratio_db = f64::from(self.ratio_db);
        // Of a gain of that ratio against one of none.
        let log = self.by_vessels().map_or(0.0, |(db, of_gain)| {
            let taken_sd = TAKEN_SD * ratio_db;
            let of_none = of_gain + taken_sd * taken_sd;
            let squared = |expected: f64, variance: f64| (db - expected) * (db - expected) / variance;
            0.5 * (squared(TAKEN * ratio_db, of_none) - squared(ratio_db, of_gain)
                + math::f64::ln(of_none / of_gain))
        });
        let odds = odds * math::f32::exp(log.clamp(-30.0, 30.0) as f32);
        odds / (1.0 + odds)
    }

    /// Where vessels contradict the last jump it was noise all the same.
    fn reconsider(&mut self) {
        let Some((db, variance)) = self.by_vessels().filter(|_| self.jump_db != 0.0) else { return };
        let jump_db = f64::from(self.jump_db);
        // With it taken out of what they hear they say as much less of a jump that was noise.
        let noise = jump_db * (1.0 - TAKEN);
        if db * db - (db + noise) * (db + noise) > 2.0 * SURE * variance {
            (self.known_db, self.ratio_db) = (self.known_db - self.jump_db, self.ratio_db + self.jump_db);
            self.jump_db = 0.0;
            self.starts_afresh();
        }
    }

    /// Ends a minute: the news that they are unequal, by north over east in dB, or that this is over.
    pub(super) fn news(&mut self) -> Option<Option<f32>> {
        self.reconsider();
        let (off_db, probability) = (math::f32::abs(self.ratio_db), self.probability());
        self.louder = match off_db {
            _ if off_db >= UNEQUAL_DB => self.louder.saturating_add(1),
            _ if off_db < EQUAL_DB => 0,
            _ => self.louder,
        };
        self.doubt_db2 = (self.doubt_db2 * (1.0 - FORGOTTEN)).max(self.variance_db2(probability));
        let known =
            math::f32::abs(self.known_db + probability * self.ratio_db) >= UNEQUAL_DB && self.known_db != 0.0;
        if !self.said && known {
            self.said = true;
            return Some(Some(self.known_db + probability * self.ratio_db));
        }
        if !self.said && off_db >= UNEQUAL_DB && self.louder >= LOUDER && probability > TOLD {
            self.said = true;
            return Some(Some(self.ratio_db));
        }
        if self.said && !known && (off_db < EQUAL_DB || probability < OVER) {
            self.said = false;
            return Some(None);
        }
        None
    }

    /// After [`Self::news`]: the news that north is louder than east, by so many dB, and it is open whether that is gain or noise, or that it is
    /// decided or over.
    pub(super) fn doubt(&mut self) -> Option<Option<f32>> {
        let (off_db, probability) = (math::f32::abs(self.ratio_db), self.probability());
        let open = if self.in_doubt {
            off_db >= EQUAL_DB && probability > DECIDED
        } else {
            self.louder >= LOUDER && self.compared >= HEARD && off_db >= UNEQUAL_DB && probability > OPEN
        };
        let open = open && !self.said;
        let louder_db = self.known_db + self.ratio_db;
        (core::mem::replace(&mut self.in_doubt, open) != open).then_some(open.then_some(louder_db))
    }

    /// Whether nothing is taken out yet: the ratio is of minutes beside vessels alone, which may be of one that lies along a component, and they
    /// have not decided.
    fn is_open(&self) -> bool {
        self.beside > 0.0 && self.is_young() && self.by_vessels().is_none()
    }

    fn variance_db2(&self, probability: f32) -> f32 {
        let (likelier, other) = (probability.max(1.0 - probability), probability.min(1.0 - probability));
        let told = if self.is_open() { 1.0 } else { likelier };
        let farther_db = FARTHER * self.ratio_db * told * (other / FADES).min(1.0);
        let ratio_sd_db = if self.is_young() { BESIDE_DB } else { BY_NOISE_DB };
        let known_sd_db = if self.known_db == 0.0 { 0.0 } else { KNOWN_DB };
        farther_db * farther_db + probability * ratio_sd_db * ratio_sd_db + known_sd_db * known_sd_db
    }

    /// By how much north is louder than east, as far as that is known.
    pub(super) fn gain(&self) -> Gain {
        let db = if self.is_open() { 0.0 } else { self.probability() * self.ratio_db };
        Gain { db: self.known_db + db, sd_db: math::f32::sqrt(self.doubt_db2) }
    }
}

#[cfg(test)]
#[path = "gains_tests.rs"]
mod tests;
