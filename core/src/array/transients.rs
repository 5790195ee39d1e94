//! Transients: what is kept out of the bearings as an impulse or a burst, told as what it is.
//!
//! Enters: frames of raw codes with the limits of what stands out on each channel ([`super::impulses`]). Leaves: a
//! [`Transient`] when it has ended, with time, duration, level, channels, and the direction of its first arrival
//! ([`super::arrival`]).
//!
//! * One transient lasts until nothing has stood out for [`APART_S`], at most [`LONGEST_S`]. So an echo that comes later is one
//!   of its own, and a train of clicks is as many.
//! * Told is what exceeds [`TOLD`] deviations and is heard on two channels, or [`TOLD_ALONE`] on one.
//! * Direction: of the first arrival also where a burst lasts a second, because what comes later is mixed with its own echoes.
//! * At most [`AT_ONCE`] at once and one a second on end are measured and told one by one. The others are counted, and the strongest of
//!   them is told with their number a minute after the first. So nothing is silently missing, and a sea full of snapping shrimp
//!   floods neither link nor processor.

use super::arrival::Capture;
use super::curved::Arrival;
use super::impulses::{NEAR, TOLD};
use super::plan::{FRAME, HOP, Plan};
use crate::block::CHANNELS;
use crate::math::f32 as m;
use crate::slot::Slot;
use crate::wire::{Message, Transient};

/// What is heard on one channel only must exceed so many deviations: by chance once in a week.
const TOLD_ALONE: f32 = 7.0;
/// Sounds less than this apart are one, seconds; and at least so many samples, which the search for a direction wants.
const APART_S: f32 = 0.01;
const APART_SAMPLES: u64 = 160;
/// Longer ones are told in pieces, seconds.
const LONGEST_S: f32 = 5.0;
/// So many may be told one by one at once, and then one in so many seconds.
pub const AT_ONCE: u32 = 15;
/// Seconds of samples in which one more may be told by itself.
pub const ONE_IN_S: f32 = 1.0;
/// Tenths of a decibel by which another must be stronger than the strongest of those that wait, to be measured for it.
const STRONGER: i16 = 10;

/// What stands out in a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outstanding {
    /// Constant part of each channel, codes.
    pub(super) constant: [i32; CHANNELS],
    /// Standard deviation that each is measured by, codes; 0 where nothing stands out.
    pub(super) sd: [f32; CHANNELS],
    /// Whether the frame as a whole is a burst.
    pub(super) burst: bool,
}

/// One that has not ended.
#[derive(Clone, Copy, Debug)]
struct Open {
    first: u64,
    last: u64,
    /// Greatest magnitude of each channel, codes, and the deviation that it is measured by.
    peak: [u32; CHANNELS],
    sd: [f32; CHANNELS],
    channels: u8,
    kind: u8,
}

/// What is known of transients (1.3 KiB).
#[derive(Clone, Debug)]
pub(super) struct Transients {
    open: Slot<Open>,
    capture: Capture,
    /// Index after the newest sample looked at.
    next: u64,
    /// [`crate::intake::Intake::elapsed`] up to which the allowance is used up.
    used_up: u64,
    /// The strongest of those not told, and when the first of them was.
    held: Slot<(Transient, u64)>,
}

impl Transients {
    pub(super) const fn new() -> Self {
        Self { open: Slot::Empty, capture: Capture::new(), next: 0, used_up: 0, held: Slot::Empty }
    }

    /// Takes a frame that begins at `index`, before anything in it is blanked; `out` (bit c) are channels that are not trusted. At
    /// `elapsed` instants. Apart: most frames have none.
    pub(super) fn take(
        &mut self,
        plan: &Plan,
        (index, codes): (u64, &[[i32; FRAME]; CHANNELS]),
        outstanding: &Outstanding,
        out: u8,
        elapsed: u64,
        sink: &mut dyn FnMut(Message),
    ) {
        let stands_out = outstanding.sd.iter().any(|sd| *sd > 0.0);
        if stands_out || self.open.is_full() {
            self.look(plan, (index, codes), outstanding, out, elapsed, sink);
        }
        self.next = index.saturating_add(FRAME as u64);
    }

    #[inline(never)]
    fn look(
        &mut self,
        plan: &Plan,
        (index, codes): (u64, &[[i32; FRAME]; CHANNELS]),
        outstanding: &Outstanding,
        out: u8,
        elapsed: u64,
        sink: &mut dyn FnMut(Message),
    ) {
        // What was looked at in the frame before; of another time nothing was.
        let seen = self.next.wrapping_sub(index);
        let mut from = if seen <= (FRAME - HOP) as u64 { seen as usize } else { 0 };
        self.capture.take(index, codes);
        while from < FRAME {
            from = self.go_on(plan, index, codes, outstanding, from);
            if from < FRAME {
                self.close(plan, out, elapsed, sink);
            }
        }
        // Nothing has stood out for long enough.
        let end = index.saturating_add(FRAME as u64);
        if let Slot::Full(open) = &self.open
            && end.saturating_sub(open.last) > apart(plan)
        {
            self.close(plan, out, elapsed, sink);
        }
    }

    /// Takes the samples of a frame from one on, up to the first that belongs to another transient than the open one.
    #[inline(never)]
    fn go_on(
        &mut self,
        plan: &Plan,
        index: u64,
        codes: &[[i32; FRAME]; CHANNELS],
        outstanding: &Outstanding,
        from: usize,
    ) -> usize {
        let limits = outstanding.sd.map(|sd| if sd > 0.0 { (NEAR * sd) as u32 } else { u32::MAX });
        let (apart, longest) = (apart(plan), (LONGEST_S * plan.rate_hz) as u64);
        let [c0, c1, c2, c3] = codes.each_ref().map(|row| row.get(from..).unwrap_or(&[]));
        let instants = c0.iter().zip(c1).zip(c2).zip(c3);
        for (n, (((a, b), c), d)) in (from..).zip(instants) {
            let mut heard = 0u8;
            let mut far = [0u32; CHANNELS];
            let all = [a, b, c, d].into_iter().zip(&outstanding.constant).zip(&limits);
            for (c, (((x, constant), limit), far)) in all.zip(&mut far).enumerate() {
                *far = x.abs_diff(*constant);
                heard |= u8::from(*far > *limit) << c;
                heard |=
                    u8::from(*far > *limit && x.unsigned_abs() >= plan.clip_code.unsigned_abs()) << (4 + c);
            }
            if heard == 0 {
                continue;
            }
            let at = index.saturating_add(n as u64);
            match &mut self.open {
                Slot::Full(open) if at.saturating_sub(open.last) > apart || at - open.first > longest => {
                    return n;
                }
                Slot::Full(open) => open.hear(at, heard, &far, outstanding),
                Slot::Empty => {
                    let mut open = Open::new(at);
                    open.hear(at, heard, &far, outstanding);
                    self.open = Slot::Full(open);
                    self.capture.begin(index, at, codes);
                }
            }
        }
        FRAME
    }

    /// The open one has ended: it is told or held.
    #[inline(never)]
    fn close(&mut self, plan: &Plan, out: u8, elapsed: u64, sink: &mut dyn FnMut(Message)) {
        let Slot::Full(open) = core::mem::replace(&mut self.open, Slot::Empty) else { return };
        if let Some(told) = self.ended(plan, &open, out, elapsed) {
            sink(Message::Transient(told));
        }
    }

    /// What to say of one that has ended, if that may be said now.
    #[inline(never)]
    fn ended(&mut self, plan: &Plan, open: &Open, out: u8, elapsed: u64) -> Option<Transient> {
        let mut transient = open.transient(plan)?;
        // Three hydrophones know no direction, and what one hears alone has none.
        let all = out == 0 && (transient.channels & 0b1111).count_ones() > 1;
        let each = (ONE_IN_S * plan.rate_hz) as u64;
        let burst = each.saturating_mul(u64::from(AT_ONCE) - 1);
        if self.used_up <= elapsed.saturating_add(burst) {
            self.used_up = self.used_up.max(elapsed).saturating_add(each);
            if all {
                transient.take(self.capture.direction(plan));
            }
            return Some(transient);
        }
        let (held, since) = match &self.held {
            Slot::Full((held, since)) => (Some(held), *since),
            Slot::Empty => (None, elapsed),
        };
        let count = held.map_or(0, |held| held.count).saturating_add(1);
        let strongest =
            held.is_none_or(|held| transient.peak_tenth_db >= held.peak_tenth_db.saturating_add(STRONGER));
        if strongest {
            if all {
                transient.take(self.capture.direction(plan));
            }
            self.held = Slot::Full((Transient { count, ..transient }, since));
        } else if let Slot::Full((held, _)) = &mut self.held {
            held.count = count;
        }
        None
    }

    /// Tells of those that were held, where that is due: a minute after the first, or `now`.
    #[inline(never)]
    pub(super) fn due(&mut self, elapsed: u64, minute: u64, now: bool, sink: &mut dyn FnMut(Message)) {
        if let Slot::Full((held, since)) = self.held
            && (now || elapsed.saturating_sub(since) >= minute)
        {
            self.held = Slot::Empty;
            sink(Message::Transient(held));
        }
    }

    /// The sound ends, or time starts again: all is told.
    #[inline(never)]
    pub(super) fn end(&mut self, plan: &Plan, out: u8, elapsed: u64, sink: &mut dyn FnMut(Message)) {
        self.close(plan, out, elapsed, sink);
        self.due(elapsed, 0, true, sink);
    }
}

/// Samples without anything that stands out, after which a transient has ended.
fn apart(plan: &Plan) -> u64 {
    ((APART_S * plan.rate_hz) as u64).max(APART_SAMPLES)
}

impl Open {
    fn new(first: u64) -> Self {
        Self {
            first,
            last: first,
            peak: [0; CHANNELS],
            sd: [0.0; CHANNELS],
            channels: 0,
            kind: Transient::IMPULSE,
        }
    }

    /// An instant that stands out on some channels.
    #[inline(never)]
    fn hear(&mut self, at: u64, heard: u8, far: &[u32; CHANNELS], outstanding: &Outstanding) {
        self.last = at;
        self.channels |= heard;
        if outstanding.burst {
            self.kind = Transient::BURST;
        }
        let known = self.peak.iter_mut().zip(&mut self.sd).zip(far).zip(&outstanding.sd);
        for (_, (((peak, sd), far), now)) in known.enumerate().filter(|(c, _)| heard >> c & 1 == 1) {
            if far > peak {
                (*peak, *sd) = (*far, *now);
            }
        }
    }

    /// What is said of it, without a direction; `None` where it is too weak.
    fn transient(&self, plan: &Plan) -> Option<Transient> {
        let mut most = (0.0f32, 0u8, 0u32);
        for (c, (peak, sd)) in (0..).zip(self.peak.iter().zip(&self.sd)) {
            let deviations = *peak as f32 / sd.max(f32::MIN_POSITIVE);
            if self.channels >> c & 1 == 1 && deviations > most.0 {
                most = (deviations, c, *peak);
            }
        }
        let (deviations, channel, peak) = most;
        let alone = (self.channels & 0b1111).count_ones() < 2;
        if deviations < if alone { TOLD_ALONE } else { TOLD } {
            return None;
        }
        let tenths = 200.0 * m::log10((peak as f32 / plan.full_scale).max(f32::MIN_POSITIVE));
        Some(Transient {
            index: self.first,
            duration: u32::try_from(self.last.saturating_sub(self.first))
                .map_or(u32::MAX, |n| n.saturating_add(1)),
            count: 1,
            peak_tenth_db: (tenths + 10_000.5) as i16 - 10_000,
            azimuth: 0.0,
            elevation: 0.0,
            var_azimuth: f32::INFINITY,
            var_elevation: f32::INFINITY,
            cov: 0.0,
            channel,
            channels: self.channels,
            kind: self.kind,
        })
    }
}

/// A transient's direction.
trait Directed {
    fn take(&mut self, arrival: Option<Arrival>);
}

impl Directed for Transient {
    fn take(&mut self, arrival: Option<Arrival>) {
        if let Some(arrival) = arrival {
            self.azimuth = arrival.azimuth;
            self.elevation = arrival.elevation;
            self.var_azimuth = arrival.var_azimuth;
            self.var_elevation = arrival.var_elevation;
            self.cov = arrival.cov;
        }
    }
}

#[cfg(test)]
#[path = "transients_tests.rs"]
mod tests;
