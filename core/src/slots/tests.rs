use super::*;
use crate::wire::configure::pieces;
use crate::wire::link::flash::{Cut, ModelFlash};
use std::boxed::Box;
use std::vec::Vec;

type Two = ModelFlash<2, 256>;
type Check = fn(&[u8]) -> bool;
type Tested = Slots<Two, Check>;

fn blob(seed: u8) -> Vec<u8> {
    (0..500u32).map(|n| (n as u8).wrapping_mul(31) ^ seed).collect()
}

/// Not what ends in this byte.
fn check(blob: &[u8]) -> bool {
    blob.last() != Some(&0xee)
}

fn slots(flash: Two) -> Tested {
    Slots::new(flash, Box::leak(Box::new([0; 1024])), check as Check)
}

/// Starts: what it runs with and why something was given up.
fn start(flash: Two) -> (Tested, Option<Vec<u8>>, Option<i64>) {
    let (mut slots, mut buffer) = (slots(flash), [0; 1024]);
    let found = slots.choose(&mut buffer);
    let news = Keeper::news(&mut slots).map(|fault| fault.value);
    (slots, found.map(|f| buffer[..f.length].to_vec()), news)
}

/// An order and its end.
fn order(slots: &mut Tested, order: Configure) -> Option<Done> {
    slots.take(&order).or_else(|| (0..100).find_map(|_| slots.work(5, true)))
}

/// Sends a blob; how it ended.
fn send(slots: &mut Tested, blob: &[u8]) -> Option<Done> {
    let crc = CRC.checksum(blob);
    let mut orders = std::vec![Configure::Begin { token: 1, length: blob.len() as u32, crc }];
    orders.extend((0..).zip(pieces(blob)).map(|(number, bytes)| Configure::Piece {
        token: 1,
        number,
        bytes,
    }));
    for next in orders {
        match order(slots, next) {
            Some(Done::Reply(1, 0)) => {}
            other => return other,
        }
    }
    order(slots, Configure::Take { token: 2 })
}

fn flash(slots: Tested) -> Two {
    let mut flash = slots.flash;
    flash.switch_on();
    flash
}

/// Comes up with what it tries, and a base station hears it, so that it is kept.
fn come_up(slots: &mut Tested) {
    slots.work(5, false);
    slots.sampled();
    (0..20).for_each(|_| _ = slots.work(6, true));
}

/// A flash in whose first place this is kept.
fn kept(blob: &[u8]) -> Two {
    let (mut slots, ..) = start(Two::new());
    assert_eq!(send(&mut slots, blob), Some(Done::Restart(Some(2))));
    let (mut slots, ..) = start(flash(slots));
    come_up(&mut slots);
    flash(slots)
}

#[test]
fn a_new_configuration_is_tried_and_kept_if_the_recorder_comes_up_and_is_heard() {
    let (mut slots, none, news) = start(Two::new());
    assert_eq!((none, news), (None, None));
    for seed in 1..6 {
        assert_eq!(send(&mut slots, &blob(seed)), Some(Done::Restart(Some(2))));
        let begin = Configure::Begin { token: 1, length: 100, crc: 0 };
        assert_eq!(slots.take(&begin), Some(Done::Reply(1, 1)), "not while it is leaving");
        let (mut tried, with, news) = start(flash(slots));
        assert_eq!((with, news), (Some(blob(seed)), None));
        assert_eq!(send(&mut tried, &blob(9)), Some(Done::Reply(1, 1)), "not while one is tried");
        come_up(&mut tried);
        let (again, with, news) = start(flash(tried));
        assert_eq!((with, news), (Some(blob(seed)), None));
        slots = again;
    }
    assert_eq!(slots.flash.misuses(), 0);
}

#[test]
fn one_that_does_not_come_up_is_given_up_and_told_until_it_stands_in_flash() {
    let (mut slots, ..) = start(kept(&blob(1)));
    // The watchdog, a panic or a loss of power.
    send(&mut slots, &blob(2));
    let (tried, with, _) = start(flash(slots));
    assert_eq!(with, Some(blob(2)));
    let (mut slots, with, news) = start(flash(tried));
    assert_eq!((with, news), (Some(blob(1)), Some(2 << 8 | Reason::StartedAgain as i64)));
    // No samples, no base station, and nothing that could be set up.
    for reason in [Reason::NoSamples, Reason::NotReached, Reason::Unusable] {
        send(&mut slots, &blob(3));
        let (mut tried, with, _) = start(flash(slots));
        assert_eq!(with, Some(blob(3)));
        match reason {
            Reason::Unusable => tried.give_up(),
            Reason::NotReached => tried.sampled(),
            _ => {}
        }
        let reached = reason == Reason::NoSamples;
        let wants =
            (0..2 * TRIAL_S).find_map(|second| tried.work(second, reached).map(|done| (second, done)));
        let second = if reason == Reason::Unusable { 0 } else { TRIAL_S };
        assert!(wants.is_some_and(|(at, done)| done == Done::Restart(None) && at >= second), "{wants:?}");
        let (again, with, news) = start(flash(tried));
        assert_eq!((with, news), (Some(blob(1)), Some(2 << 8 | reason as i64)));
        // Power goes before a base station has it, or too soon after.
        let (again, with, news) = start(flash(again));
        assert_eq!((with, news), (Some(blob(1)), Some(2 << 8 | reason as i64)));
        let (mut again, _, news) = start(flash(again));
        (0..TOLD_S).for_each(|second| _ = again.work(second, true));
        assert!(news.is_some() && again.work(2 * TOLD_S, false).is_none());
        let (mut again, _, news) = start(flash(again));
        (0..=TOLD_S).for_each(|second| _ = again.work(second, true));
        assert!(news.is_some());
        let (again, with, news) = start(flash(again));
        assert_eq!((with, news), (Some(blob(1)), None));
        slots = again;
    }
    assert_eq!(slots.flash.misuses(), 0);
}

#[test]
fn one_that_was_kept_and_cannot_be_run_any_more_gives_way_to_the_one_before() {
    let (mut slots, ..) = start(kept(&blob(1)));
    send(&mut slots, &blob(2));
    let (mut slots, ..) = start(flash(slots));
    come_up(&mut slots);
    let both = flash(slots);
    let given_up = Some(2 << 8 | Reason::Unusable as i64);
    // It could be read, and not be set up.
    let (mut slots, with, _) = start(both.clone());
    assert_eq!(with, Some(blob(2)));
    slots.give_up();
    assert!((0..20).find_map(|_| slots.work(0, true)).is_some_and(|done| done == Done::Restart(None)));
    let (_, with, news) = start(flash(slots));
    assert_eq!((with, news), (Some(blob(1)), given_up));
    // Another software cannot read it.
    let second = |of: &[u8]| of != blob(2);
    let mut slots = Slots::new(both.clone(), Box::leak(Box::new([0; 1024])), second as Check);
    let found = slots.choose(&mut [0; 1024]).map(|found| found.sequence);
    assert_eq!((found, Keeper::news(&mut slots).map(|fault| fault.value)), (Some(1), given_up));
    // A word of it is broken.
    let mut broken = both;
    broken.damage(1, HEAD + 3);
    let (slots, with, news) = start(broken);
    assert_eq!((with, news), (Some(blob(1)), Some(2 << 8 | Reason::Damaged as i64)));
    assert_eq!(slots.flash.misuses(), 0);
}

#[test]
fn what_is_not_announced_not_in_order_or_cannot_be_run_is_refused_and_nothing_changes() {
    let (mut slots, ..) = start(kept(&blob(1)));
    let refused = Some(Done::Reply(1, 1));
    let begin = |length, crc| Configure::Begin { token: 1, length, crc };
    let piece = |number| Configure::Piece { token: 1, number, bytes: [[1; 32]; 3] };
    let take = Configure::Take { token: 1 };
    assert_eq!(order(&mut slots, piece(0)), refused, "not begun");
    assert_eq!(order(&mut slots, take), refused, "not begun");
    assert_eq!(order(&mut slots, begin(0, 0)), refused);
    assert_eq!(order(&mut slots, begin(1025, 0)), refused, "too long");
    assert_eq!(order(&mut slots, begin(u32::MAX, 0)), refused, "too long");
    assert_eq!(order(&mut slots, begin(200, 0)), Some(Done::Reply(1, 0)));
    assert_eq!(order(&mut slots, piece(1)), refused, "not in order");
    assert_eq!(order(&mut slots, piece(0)), Some(Done::Reply(1, 0)));
    assert_eq!(order(&mut slots, piece(0)), refused, "twice");
    assert_eq!(order(&mut slots, take), refused, "not all");
    assert_eq!(order(&mut slots, piece(1)), Some(Done::Reply(1, 0)));
    assert_eq!(order(&mut slots, piece(2)), Some(Done::Reply(1, 0)));
    assert_eq!(order(&mut slots, piece(3)), refused, "more than all");
    assert_eq!(order(&mut slots, take), refused, "wrong checksum");
    let mut of_another_kind = blob(2);
    of_another_kind.push(0xee);
    assert_eq!(send(&mut slots, &of_another_kind), Some(Done::Reply(2, 1)));
    let (slots, with, news) = start(flash(slots));
    assert_eq!((with, news), (Some(blob(1)), None));
    assert_eq!(slots.flash.misuses(), 0);
}

/// A flash with a kept configuration in one place and one that was given up in the other.
fn used() -> Two {
    let (mut slots, ..) = start(kept(&blob(1)));
    send(&mut slots, &blob(7));
    let (tried, ..) = start(flash(slots));
    let (slots, with, news) = start(flash(tried));
    assert!(with == Some(blob(1)) && news.is_some());
    flash(slots)
}

/// A recorder, a restart, and what it then does; the power may go at any time.
fn change(from: Two, after: impl Fn(&mut Tested)) -> Tested {
    let (mut slots, ..) = start(from);
    send(&mut slots, &blob(2));
    if slots.flash.is_off() {
        return slots;
    }
    let (mut tried, with, _) = start(slots.flash);
    if !tried.flash.is_off() {
        assert_eq!(with, Some(blob(2)));
        after(&mut tried);
    }
    tried
}

/// Every cut of power in what `after` ends; `judge` sees the recorder at its next start and what it runs with.
fn every_cut(after: impl Fn(&mut Tested), mut judge: impl FnMut(Tested, Option<Vec<u8>>, Option<i64>)) {
    let from = used();
    for at in from.operations().. {
        let mut reached = false;
        for cut in [Cut::Before, Cut::During, Cut::After] {
            let mut flash_of = from.clone();
            flash_of.cut_at(at, cut);
            let slots = change(flash_of, &after);
            reached |= slots.flash.is_off();
            let (slots, with, news) = start(flash(slots));
            judge(slots, with, news);
        }
        if !reached {
            return;
        }
    }
}

/// It takes another, whatever was before.
fn takes_another(mut slots: Tested) {
    if slots.running().is_some_and(|found| found.trial) {
        come_up(&mut slots);
    }
    assert_eq!(send(&mut slots, &blob(3)), Some(Done::Restart(Some(2))));
    let (slots, with, _) = start(flash(slots));
    assert_eq!((with, slots.flash.misuses()), (Some(blob(3)), 0));
}

#[test]
fn power_cut_at_every_write_leaves_the_old_configuration_or_the_whole_new_one() {
    let (mut old, mut tried, mut new) = (0, 0, 0);
    every_cut(come_up, |slots, with, news| {
        let count = match slots.running() {
            Some(found) if found.sequence == 1 => &mut old,
            Some(found) if found.trial => &mut tried,
            _ => &mut new,
        };
        *count += 1;
        let right = if slots.running().is_some_and(|found| found.sequence == 1) { blob(1) } else { blob(2) };
        assert_eq!(with, Some(right.clone()));
        assert!(news.is_none() || right == blob(1));
        takes_another(slots);
    });
    assert!(old > 40 && tried >= 1 && new >= 2, "{old} {tried} {new}");
}

#[test]
fn power_cut_at_every_write_of_a_way_back_leads_back() {
    let mut told = [0; 6];
    let unusable = |slots: &mut Tested| {
        slots.give_up();
        (0..20).for_each(|_| _ = slots.work(6, true));
        // The restart, if the power is still there.
        if !slots.flash.is_off() {
            let again = start(slots.flash.clone()).0;
            slots.flash = again.flash;
        }
    };
    every_cut(unusable, |slots, with, news| {
        if let Some(news) = news {
            told[(news & 0xff) as usize] += 1;
        }
        let tried = slots.running().is_some_and(|found| found.trial);
        assert_eq!(with, Some(if tried { blob(2) } else { blob(1) }));
        takes_another(slots);
    });
    assert!(told[Reason::StartedAgain as usize] > 0 && told[Reason::Unusable as usize] > 0, "{told:?}");
}

/// A flash that takes no marks must not have the recorder start again for ever.
#[test]
fn on_a_flash_that_is_broken_nothing_is_tried_and_nothing_is_given_up_for_ever() {
    let (mut slots, ..) = start(kept(&blob(1)));
    send(&mut slots, &blob(2));
    let mut dead = slots.flash.clone();
    dead.cut_at(dead.operations(), Cut::Before);
    let (slots, with, _) = start(dead);
    assert_eq!((with, slots.running().map(|found| found.sequence)), (Some(blob(1)), Some(1)));
    let (mut slots, ..) = start(flash(slots));
    slots.flash.cut_at(slots.flash.operations(), Cut::Before);
    slots.give_up();
    assert_eq!((0..20).find_map(|_| slots.work(6, true)), None);
}

/// A flash written by a probe.
fn probed(blob: &[u8]) -> Two {
    let mut flash = Two::new();
    let words: Vec<Word> = written(blob).collect();
    // A probe writes no word that stays erased.
    (0..).zip(&words).filter(|(_, word)| **word != ERASED).for_each(|(at, word)| flash.write(0, at, word));
    flash
}

#[test]
fn what_a_probe_wrote_is_kept_without_a_trial_and_replaced_by_the_next() {
    let (mut slots, runs, news) = start(probed(&blob(7)));
    assert_eq!((runs, news), (Some(blob(7)), None));
    assert!(slots.running().is_some_and(|found| !found.trial));
    // A base station's comes after it, and is tried.
    assert_eq!(send(&mut slots, &blob(8)), Some(Done::Restart(Some(2))));
    let (mut slots, runs, news) = start(flash(slots));
    assert_eq!((runs, news), (Some(blob(8)), None));
    come_up(&mut slots);
    assert_eq!(start(flash(slots)).1, Some(blob(8)));
}

#[test]
fn what_a_probe_wrote_and_cannot_be_run_or_read_is_given_up() {
    let mut bad = blob(7);
    bad.push(0xee);
    let (_, runs, news) = start(probed(&bad));
    assert_eq!((runs, news.map(|value| value & 0xff)), (None, Some(Reason::Unusable as i64)));
    let mut flash = probed(&blob(7));
    flash.damage(0, HEAD + 1);
    let (_, runs, news) = start(flash);
    assert_eq!((runs, news.map(|value| value & 0xff)), (None, Some(Reason::Damaged as i64)));
}
