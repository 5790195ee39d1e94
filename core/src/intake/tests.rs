use super::*;
use crate::wire::{Fault, FaultsHeld};
use std::vec::Vec;

const RATE_HZ: f64 = 100.0;

fn plan() -> Plan {
    Plan::new(RATE_HZ, ALL, 4)
}

/// What a chain would see: index and codes of every instant, breaks and faults.
#[derive(Debug, Default, PartialEq)]
struct Seen {
    instants: Vec<(u64, Frame, u8)>,
    events: Vec<Event>,
    times: Vec<u64>,
    faults: Vec<(FaultCode, u64, i64)>,
    held: Vec<FaultsHeld>,
    accounting: Accounting,
}

fn see(blocks: &[(u64, Vec<Frame>)], cut: usize) -> Seen {
    let (plan, mut intake, mut seen) = (plan(), Intake::new(), Seen::default());
    let mut open = 0;
    let mut sink = |message| match message {
        Message::Fault(Fault { code, index, value }) => seen.faults.push((code, index, value)),
        Message::FaultsHeld(held) => seen.held.push(held),
        other => panic!("{other:?}"),
    };
    for (first, frames) in blocks {
        for (k, frames) in frames.chunks(cut).enumerate() {
            let mut rest = Block { first_index: first + (k * cut) as u64, frames };
            while let Some(step) = intake.next(&plan, &mut rest, &mut sink) {
                let mut take = |run: &Run<'_>| {
                    open += if run.counted { 0 } else { run.frames.len() as u64 };
                    let frames = run.frames.iter().enumerate();
                    seen.instants.extend(frames.map(|(k, f)| (run.first_index + k as u64, *f, run.mended)));
                };
                match step {
                    Step::Samples(run) => take(&run),
                    Step::Mended(instant) => take(&instant.run()),
                    Step::Event(event) => seen.events.push(event),
                    Step::Time(index) => seen.times.push(index),
                }
            }
        }
    }
    intake.finish(&plan, &mut sink);
    intake.accounting.processed = open;
    seen.accounting = intake.accounting;
    seen
}

fn ramp(from: u64, n: usize) -> (u64, Vec<Frame>) {
    (from, (from..).take(n).map(|i| [i as i32, 2, 3, -4]).collect())
}

fn cut(frames: (u64, Vec<Frame>), from: usize, to: usize) -> (u64, Vec<Frame>) {
    (frames.0 + from as u64, frames.1[from..to].to_vec())
}

#[test]
fn short_absences_are_bridged_and_long_ones_end_the_run() {
    let whole = ramp(0, 100);
    // Three instants that did not come, four without codes, five without codes.
    let mut later = cut(whole.clone(), 33, 100);
    later.1[20..24].fill([MISSING; 4]);
    later.1[40..45].fill([MISSING; 4]);
    let seen = see(&[cut(whole, 0, 30), later], usize::MAX);
    assert_eq!(seen.events, [Event::Gap]);
    let indices = seen.instants.iter().map(|i| i.0);
    assert!(indices.eq((0..73).chain(78..100)), "{:?}", seen.instants);
    // The ramp goes on through the bridges.
    assert!(seen.instants.iter().all(|(i, f, _)| f[0] == *i as i32));
    assert_eq!(seen.instants.iter().filter(|i| i.2 == ALL).count(), 7);
    assert_eq!(
        seen.faults,
        [(FaultCode::Gap, 33, 3), (FaultCode::Invalid, 57, 4), (FaultCode::Invalid, 78, 5)]
    );
    assert_eq!((seen.accounting.lost[0], seen.accounting.lost[2], seen.accounting.total()), (3, 9, 100));
}

#[test]
fn a_channel_without_codes_holds_its_last_and_the_others_go_on() {
    let mut whole = ramp(0, 300);
    whole.1[50..250].iter_mut().for_each(|f| f[2] = MISSING);
    let seen = see(&[whole], 70);
    assert!(seen.events.is_empty());
    assert!(seen.instants.iter().all(|(i, f, _)| *f == [*i as i32, 2, 3, -4]));
    assert_eq!(seen.instants.iter().filter(|i| i.2 == 0b0100).count(), 200);
    // Told after the first second, and when it ends.
    assert_eq!(seen.faults, [(FaultCode::Invalid, 150, 100), (FaultCode::Invalid, 250, 100)]);
    assert_eq!((seen.accounting.lost[2], seen.accounting.total()), (200, 300));
}

#[test]
fn repeats_are_left_out_and_time_that_falls_far_back_starts_again() {
    let seen = see(&[ramp(0, 5000), ramp(4000, 2000), ramp(10, 600)], usize::MAX);
    // It is believed after 256 instants.
    assert_eq!(seen.events, [Event::Restart(266)]);
    assert!(seen.instants.iter().map(|i| i.0).eq((0..6000).chain(266..610)));
    let (repeats, unused) = ((FaultCode::Overlap, 5000, 1000), (FaultCode::Overlap, 6000, 256));
    assert_eq!(seen.faults, [repeats, unused, (FaultCode::Restarted, 266, 5990)]);
    assert_eq!(seen.accounting.total(), 7600);
    // An index that stands still: after half a minute of repeats it is believed.
    let stuck: Vec<_> = (0..40).map(|_| ramp(700, 100)).collect();
    let seen = see(&stuck, usize::MAX);
    assert_eq!(seen.events, [Event::Restart(700)]);
    assert_eq!((seen.accounting.lost[1], seen.accounting.total()), (3800, 4000));
}

#[test]
fn an_index_no_recording_reaches_is_damage() {
    for index in [u64::MAX, u64::MAX - 3, 1 << 63, 330_000_000_000] {
        let seen = see(&[ramp(0, 500), (index, std::vec![[1; 4]; 3]), ramp(500, 500)], 128);
        assert!(seen.events.is_empty() && seen.instants.len() == 1000, "{index}");
        assert_eq!(seen.faults, [(FaultCode::Invalid, 500, 3)]);
        assert_eq!((seen.accounting.lost[2], seen.accounting.total()), (3, 1003));
    }
}

#[test]
fn many_faults_are_gathered_by_the_minute() {
    // Every tenth instant has no code, for two minutes and a half.
    let mut whole = ramp(0, 15_000);
    whole.1.iter_mut().step_by(10).for_each(|f| *f = [MISSING; 4]);
    let seen = see(&[whole], usize::MAX);
    assert_eq!(seen.faults.len(), 9);
    let held: Vec<_> = seen.held.iter().map(|h| (h.code, h.count, h.value)).collect();
    assert_eq!(held.iter().map(|h| h.1).sum::<u32>(), 1500 - 9, "{held:?}");
    assert!(held.len() == 3 && held.iter().all(|h| h.0 == FaultCode::Invalid && i64::from(h.1) == h.2));
    assert_eq!(seen.accounting.lost[2], 1500);
}

proptest::proptest! {
    #![proptest_config(seabearing_testkit::property(256))]

    #[test]
    fn the_cut_into_blocks_changes_nothing_and_every_instant_is_in_one_bucket(
        parts in proptest::collection::vec((-4000i64..4000, 1usize..900, 0u8..4, 1usize..300), 1..9),
        cut in 1usize..700,
    ) {
        let (mut at, mut blocks, mut came) = (100_000i64, Vec::new(), 0u64);
        for (jump, n, kind, every) in parts {
            at = if kind == 3 { at } else { (at + jump).max(0) };
            let mut block = ramp(at as u64, n);
            match kind {
                1 => block.1.iter_mut().step_by(every).for_each(|f| *f = [MISSING; 4]),
                2 => block.1.iter_mut().skip(every).for_each(|f| f[1] = MISSING),
                _ => {}
            }
            came += n as u64;
            at += n as i64;
            blocks.push(block);
        }
        let whole = see(&blocks, usize::MAX);
        proptest::prop_assert_eq!(whole.accounting.total(), came + whole.accounting.lost[0]);
        proptest::prop_assert_eq!(&whole, &see(&blocks, cut));
        // Within a run indices follow each other.
        let breaks = whole.instants.windows(2).filter(|w| w[1].0 != w[0].0 + 1).count();
        proptest::prop_assert!(breaks <= whole.events.len());
    }
}
