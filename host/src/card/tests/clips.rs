//! A recorder that keeps clips: what a detection claims is on the card, what nothing claims is given up, and a file that is filled
//! again never shows older sound.

use super::*;
use seabearing_core::config;
use seabearing_firmware::card::clips::Claims;
use std::ops::Range;

/// The files last 1.3 s each.
const CLIPS: config::Clips = config::Clips { before_s: 3, after_s: 2, apart_s: 8 };
/// A detection is told so long after its sound, ms.
const LATE: u64 = 700;
/// What the card has taken is told every two seconds, and 0.5 s may wait.
const UNTOLD: u64 = 2600 * STEP;

fn clips() -> Clips {
    Clips::new(CLIPS, RATE_HZ)
}

/// The samples that these detections claim.
fn claimed(detections: &[u64]) -> Vec<Range<u64>> {
    let mut claims = Box::new(Claims::new());
    claims.begin(clips());
    detections.iter().filter_map(|index| claims.heard(*index)).collect()
}

/// Plays so many milliseconds with detections in some; their indices.
fn play(recorder: &mut Session<'_>, steps: u64, heard: impl Fn(u64) -> bool, until: u64) -> Vec<u64> {
    let mut detections = Vec::new();
    for step in 0..steps {
        recorder.steps(1);
        if step >= LATE && heard(step) {
            let index = recorder.index - LATE * STEP;
            recorder.writer.heard(index);
            detections.push(index);
        }
        if recorder.writer.drive().0.borrow().writes > until {
            break;
        }
    }
    detections
}

/// Claimed samples before `end` that are in none of the files.
fn wanting(kept: &[Kept], detections: &[u64], end: u64) -> u64 {
    let files: Vec<Range<u64>> = kept.iter().map(|k| k.label.first_index..k.end_index()).collect();
    let there = |index: &u64| files.iter().any(|file| file.contains(index));
    let of =
        |claim: Range<u64>| (claim.start..claim.end.min(end)).filter(|index| !there(index)).count() as u64;
    claimed(detections).into_iter().map(of).sum()
}

#[test]
fn clips_are_whole_and_what_nothing_claims_is_given_up() {
    let holder = holder(60);
    let (detections, end) = keeping(clips(), &holder, 1, |recorder| {
        // Heard for two seconds at 30 s, where one claim is all, and at 70 s; a minute of nothing before the end.
        let heard = |step: u64| {
            step == 30_000 || step.is_multiple_of(500) && (30_000..32_000).contains(&step) || step == 70_000
        };
        let detections = play(recorder, 130_000, heard, u64::MAX);
        let end = recorder.index;
        recorder.finish();
        assert_eq!((recorder.events.clone(), recorder.writer.lost()), (Vec::new(), 0));
        (detections, end)
    });
    assert_eq!(claimed(&detections).len(), 2);
    let mut kept = read(&holder.borrow().sectors);
    assert_eq!(wanting(&kept, &detections, end), 0);
    // All of it takes 97 files; of clips two times five or six, and what waits for a detection.
    assert!((20..28).contains(&kept.len()), "{}", kept.len());
    let told: u32 = kept.iter().map(|k| k.detections).sum();
    assert_eq!(told as usize, detections.len());
    super::super::in_order(&mut kept, |k| Some(k), |k| k.label.file);
    assert!(kept.windows(2).all(|pair| pair[1].is_next_clip(&pair[0])));
    assert!(kept.iter().any(|k| k.first_detection == Some(detections[0])));
    // Read as a recording, time goes on, and what was given up is told as such.
    let (folder, station) = (folder(&holder.borrow().sectors), station());
    let mut source = crate::recording::open(&[folder.path().to_owned()], &station, None).unwrap();
    let (mut next, mut pauses) = (0, 0);
    loop {
        let left_out = source.left_out().unwrap();
        let Some(block) = source.next_block().unwrap() else { break };
        if next > 0 && block.first_index > next {
            assert_eq!(left_out, Some(block.first_index));
            pauses += 1;
        }
        for (index, frame) in (block.first_index..).zip(block.frames) {
            assert_eq!(*frame, codes(1, index));
        }
        next = block.first_index + block.frames.len() as u64;
    }
    assert_eq!((pauses, next), (2, end));
}

proptest! {
    #![proptest_config(seabearing_testkit::property(10))]

    #[test]
    fn power_cut_at_any_write_leaves_what_was_claimed_and_told_and_no_older_sound(
        seed in any::<u64>(), cut in 0u64..2500
    ) {
        let holder = holder(40);
        let (detections, end) = keeping(clips(), &holder, 1, |recorder| {
            let detections = play(recorder, 40_000, |step| mix(seed ^ step).is_multiple_of(9000), cut);
            let mut holder = holder.borrow_mut();
            if let Some((sector, bytes)) = holder.under_way.take() {
                let torn = (mix(seed) as usize) % bytes.len();
                holder.sectors.write(sector, &bytes[..torn]);
            }
            (holder.done_us, holder.stall_us) = (0, 0);
            (detections, recorder.index)
        });
        let kept = read(&holder.borrow().sectors);
        prop_assert_eq!(wanting(&kept, &detections, end.saturating_sub(UNTOLD)), 0);
        // The next start takes unused files and leaves these alone.
        let before: Vec<Kept> = kept.into_iter().filter(|k| k.frames > 0).collect();
        keeping(clips(), &holder, 2, |recorder| {
            play(recorder, 3000, |_| false, u64::MAX);
        });
        let after = read(&holder.borrow().sectors);
        prop_assert!(before.iter().all(|k| after.contains(k)));
        prop_assert!(after.iter().any(|k| k.label.session == 2));
    }
}

#[test]
fn a_card_that_only_clips_fill_is_full_once_clips_have_filled_it() {
    let holder = holder(20);
    keeping(clips(), &holder, 1, |recorder| {
        let detections = play(recorder, 120_000, |step| step.is_multiple_of(9000), u64::MAX);
        assert!(matches!(recorder.events[..], [Event::Full(_)]), "{:?}", recorder.events);
        let kept = read(&holder.borrow().sectors);
        assert_eq!(kept.len(), 20);
        // The first clips are whole, whatever came after them.
        assert_eq!(wanting(&kept, &detections[..2], u64::MAX), 0);
    });
}
