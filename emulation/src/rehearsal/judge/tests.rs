use super::*;
use crate::board::mix;
use seabearing_board_model::ads131m04::Codes;
use seabearing_core::wire::{End, Fault};
use std::path::Path;

const RATE: u64 = 64_000;

fn blob() -> Vec<u8> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios/demo-station.toml"));
    let station = seabearing_host::station::Station::read(path).unwrap();
    let mut bytes = vec![0; 4096];
    let mut writer = config_blob::Writer::new(&mut bytes).unwrap();
    writer.station(&station.config).unwrap();
    let length = writer.finish();
    bytes.truncate(length);
    bytes
}

/// Noise from a direction.
fn sound(instant: u64) -> Codes {
    let code = |n: u64| (mix(n) >> 46) as i32 - (1 << 17);
    [0, 68, 33, 67].map(|earlier| code(instant + earlier))
}

/// What the host says of these instants, each message when its newest instant was heard.
fn says(blob: &[u8], numbers: &[u64], given: &[u64]) -> Vec<Said> {
    let codes: Vec<Codes> = numbers.iter().map(|n| sound(*n)).collect();
    let (mut decoder, mut said) = (Decoder::default(), Vec::new());
    let mut take = |frame: &[u8]| {
        for received in frame.iter().filter_map(|b| decoder.push::<Message>(*b)) {
            let index = match received.message {
                Message::Bearing(b) => b.index + 32_000,
                Message::Health(h) => h.index,
                Message::Fault(f) => f.index,
                _ => 0,
            };
            let at_s = index as f64 / RATE as f64;
            said.push(Said { at_s, sequence: received.sequence, boot: 0, message: received.message });
        }
        true
    };
    host(blob, None, (0, &[]), given, &codes, false, &mut take).unwrap();
    said
}

fn run(said: Vec<Said>, numbers: Vec<u64>) -> BoardRun {
    let codes = numbers.iter().map(|n| sound(*n)).collect();
    let last = numbers.last().copied().unwrap_or(0);
    BoardRun {
        firmware: Vec::new(),
        said,
        linked: false,
        seismic: None,
        missing: 0,
        flash: (0, 0),
        starts: vec![(0.0, 0)],
        converted: last,
        delivered: numbers.len() as u64,
        codes,
        moments_s: (0..=last).map(|n| n as f64 / RATE as f64).collect(),
        numbers,
        lost: 0,
        seconds: 0.0,
        handlers: Default::default(),
        thread: Default::default(),
        interrupts_per_s: 0.0,
        idle: 0.0,
        resets: 0,
        dma_items: 0,
        spi_hz: 0,
        card: None,
        stack: (0, 0),
    }
}

const UNDISTURBED: Known = Known { undisturbed_s: f64::INFINITY, doubtful_s: None };

fn fault(code: FaultCode, index: u64, value: u64) -> Said {
    let message = Message::Fault(Fault { code, index, value: value as i64 });
    Said { at_s: index as f64 / RATE as f64, sequence: 9, boot: 0, message }
}

fn judged(run: &BoardRun, known: Known) -> Numbers {
    numbers(run, &blob(), None, known).unwrap()
}

/// Two seconds of which `gap` is wanting; the board gives what comes after it `off` too late and says so.
fn estimated(gap: std::ops::Range<u64>, off: i64) -> BoardRun {
    let blob = blob();
    let numbers: Vec<u64> = (0..2 * RATE).filter(|n| !gap.contains(n)).collect();
    let put = |n: &u64| if *n >= gap.end { n.saturating_add_signed(off) } else { *n };
    let given: Vec<u64> = numbers.iter().map(put).collect();
    let mut said = says(&blob, &numbers, &given);
    let told = gap.end.saturating_add_signed(off);
    said.push(fault(FaultCode::ConverterRestarted, told, told - gap.start));
    run(said, numbers)
}

#[test]
fn an_estimate_is_right_as_far_as_it_can_be_and_no_further() {
    let right = judged(&estimated(40_000..50_000, 0), UNDISTURBED);
    assert_eq!((right.outcome.as_str(), right.right), ("estimate, within 1", true));
    // A gap of 10 000 after 40 000 that were measured: the rounding.
    let near = judged(&estimated(40_000..50_000, -1), UNDISTURBED);
    assert_eq!((near.outcome.as_str(), near.right, near.off), ("estimate, within 1", true, -1));
    for off in [2, -2, 16] {
        let far = judged(&estimated(40_000..50_000, off), UNDISTURBED);
        assert!(!far.right && far.outcome.starts_with("WRONG"), "{off}: {}", far.outcome);
    }
    assert_eq!([most_off(64, 32_000), most_off(64_000, 32_000), most_off(3_840_000, 32_000)], [1, 1, 16]);
}

#[test]
fn of_two_estimates_each_errs_by_itself() {
    let blob = blob();
    // Between the two enough is said to tell how the first was estimated.
    let gaps = [40_000..50_000, 130_000..140_000];
    let numbers: Vec<u64> = (0..4 * RATE).filter(|n| !gaps.iter().any(|gap| gap.contains(n))).collect();
    for (off, right) in [(0, true), (-1, true), (-2, false)] {
        let given: Vec<u64> = numbers
            .iter()
            .map(|n| if *n >= gaps[1].end { n.saturating_add_signed(off) } else { *n })
            .collect();
        let mut said = says(&blob, &numbers, &given);
        for (gap, off) in gaps.iter().zip([0, off]) {
            let told = gap.end.saturating_add_signed(off);
            said.push(fault(FaultCode::ConverterRestarted, told, told - gap.start));
        }
        let judged = judged(&run(said, numbers.clone()), UNDISTURBED);
        assert_eq!(judged.right, right, "{off}: {}", judged.outcome);
    }
}

#[test]
fn numbers_off_before_it_is_told_are_right_for_the_shortest_time_only() {
    let blob = blob();
    // Three conversions wanting from 40 000 on, told after so many more.
    for (late, right) in [(2000, true), (4000, false)] {
        let gaps = [40_000..40_003, 40_003 + late..40_400 + late];
        let numbers: Vec<u64> = (0..2 * RATE).filter(|n| !gaps.iter().any(|gap| gap.contains(n))).collect();
        let given: Vec<u64> =
            numbers.iter().map(|n| if (40_003..40_003 + late).contains(n) { n - 3 } else { *n }).collect();
        let mut said = says(&blob, &numbers, &given);
        said.push(fault(FaultCode::ConverterRestarted, gaps[1].end, 400));
        let judged = judged(&run(said, numbers), UNDISTURBED);
        assert_eq!(judged.right, right, "{late}: {}", judged.outcome);
    }
}

#[test]
fn a_session_that_was_cut_off_must_have_said_what_it_had_heard() {
    let blob = blob();
    let numbers: Vec<u64> = (0..3 * RATE).collect();
    let mut run = run(says(&blob, &numbers, &numbers), numbers);
    let whole = run.clone();
    assert!(judged(&run, UNDISTURBED).right);
    // A second start without a word, at 2 s.
    run.starts.push((2.0, 2 * RATE as usize));
    let Message::Hello(hello) = run.said[0].message else { panic!("no Hello") };
    let again = Said { at_s: 2.0, sequence: 0, boot: 0, message: Message::Hello(hello) };
    let cut = |run: &BoardRun, until_s: f64| {
        let mut said: Vec<Said> = run.said.iter().filter(|s| s.at_s < until_s).copied().collect();
        said.push(again);
        let second: Vec<u64> = (0..RATE).collect();
        said.extend(says(&blob, &second, &second).into_iter().skip(1));
        let mut numbers: Vec<u64> = (0..2 * RATE).collect();
        numbers.extend(2 * RATE..3 * RATE);
        let codes = (0..2 * RATE).map(sound).chain((0..RATE).map(sound)).collect();
        BoardRun { said, numbers, codes, ..run.clone() }
    };
    let known = Known { undisturbed_s: 2.0, doubtful_s: None };
    let right = judged(&cut(&run, 2.0), known);
    assert!(right.right, "{}", right.outcome);
    // Bearings are of each half second: the last that must be there is that of 1 s to 1.5 s.
    for until_s in [0.1, 1.2] {
        let wrong = judged(&cut(&run, until_s), known);
        assert!(!wrong.right, "{until_s}: {}", wrong.outcome);
    }
    // And of a run that was not cut off nothing may be wanting, or else than the host says it.
    let mut less = whole.clone();
    less.said.retain(|s| !matches!(s.message, Message::Bearing(b) if b.index > RATE));
    assert!(!judged(&less, UNDISTURBED).right);
}

#[test]
fn what_was_said_before_the_settings_changed_must_be_right_and_what_comes_after_the_start_too() {
    let blob = blob();
    let numbers: Vec<u64> = (0..3 * RATE).collect();
    let mut run = run(says(&blob, &numbers, &numbers), numbers);
    let known = Known { undisturbed_s: 2.0, doubtful_s: Some(2.0) };
    let turn = |run: &mut BoardRun, from_s: f64| {
        for said in run.said.iter_mut().filter(|s| s.at_s >= from_s) {
            if let Message::Bearing(bearing) = &mut said.message {
                bearing.azimuth += 0.1;
            }
        }
    };
    turn(&mut run, 2.0);
    let told = judged(&run, known);
    assert!(told.right && told.outcome.ends_with("then told as doubtful"), "{}", told.outcome);
    turn(&mut run, 0.0);
    assert!(!judged(&run, known).right);
}

#[test]
fn what_must_not_be_said_is_missed_where_it_is() {
    let wanted = [Wanted::Never(FaultCode::FalseEdge)];
    assert_eq!(told(&[], &wanted, 1.0)[0].1, Some(0.0));
    // Before the event too.
    assert_eq!(told(&[fault(FaultCode::FalseEdge, 0, 1)], &wanted, 1.0)[0].1, None);
    let end = Said { message: Message::End(End { index: 5, frames: 0 }), ..fault(FaultCode::Gap, 0, 1) };
    assert_eq!(told(&[end], &[Wanted::Fault(FaultCode::Gap, None)], 0.0)[0].1, None);
}
