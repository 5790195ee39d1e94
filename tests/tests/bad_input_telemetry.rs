//! Damaged telemetry: whatever happens to a stream, every frame that came through whole is kept, and what was lost is
//! counted.

use proptest::prelude::*;
use seabearing::base::{Base, Beginning};
use seabearing_core::wire::{Encoder, End, Message, Reply};
use std::collections::BTreeSet;

#[derive(Clone, Debug)]
enum Damage {
    Flip { at: usize, bit: u8 },
    Remove { at: usize, n: usize },
    Insert { at: usize, bytes: Vec<u8> },
    Repeat { at: usize, n: usize },
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = 0..4000usize;
    prop_oneof![
        (at.clone(), 0..8u8).prop_map(|(at, bit)| Damage::Flip { at, bit }),
        (at.clone(), 1..60usize).prop_map(|(at, n)| Damage::Remove { at, n }),
        (at.clone(), prop::collection::vec(any::<u8>(), 1..300))
            .prop_map(|(at, bytes)| Damage::Insert { at, bytes }),
        (at, 1..60usize).prop_map(|(at, n)| Damage::Repeat { at, n }),
    ]
}

/// The stream with, for every byte, the number of the frame it came from (`None`: not from any).
fn apply(stream: &mut Vec<(u8, Option<usize>)>, d: &Damage) {
    let len = stream.len();
    match d {
        Damage::Flip { at, bit } => {
            let (byte, from) = &mut stream[at % len];
            *byte ^= 1 << bit;
            *from = None;
        }
        Damage::Remove { at, n } => {
            let at = at % len;
            stream.drain(at..(at + n).min(len));
        }
        Damage::Insert { at, bytes } => {
            let at = at % len;
            stream.splice(at..at, bytes.iter().map(|b| (*b, None)));
        }
        Damage::Repeat { at, n } => {
            let at = at % len;
            let again: Vec<_> = stream[at..(at + n).min(len)].iter().map(|(b, _)| (*b, None)).collect();
            stream.splice(at..at, again);
        }
    }
}

proptest! {
    #![proptest_config(seabearing_testkit::property(300))]

    #[test]
    fn whole_frames_are_kept_whatever_surrounds_them(damages in prop::collection::vec(damage(), 1..8)) {
        let mut encoder = Encoder::default();
        let mut stream = Vec::new();
        let mut lengths = Vec::new();
        for i in 0..200usize {
            let message = if i % 3 == 0 {
                Message::Reply(Reply { token: i as u8, status: 0 })
            } else {
                Message::End(End { index: i as u64 * 12_345, frames: i as u32 })
            };
            let frame = encoder.frame(&message);
            lengths.push(frame.len());
            stream.extend(frame.iter().map(|b| (*b, Some(i))));
        }
        for d in &damages {
            apply(&mut stream, d);
            if stream.is_empty() {
                return Ok(());
            }
        }
        // A frame came through if its bytes are all there, in a row, after a delimiter or at the beginning.
        let mut whole = Vec::new();
        for (i, length) in lengths.iter().enumerate() {
            let Some(at) = stream.iter().position(|(_, from)| *from == Some(i)) else { continue };
            let run = stream.get(at..at + length);
            let unbroken = run.is_some_and(|r| r.iter().all(|(_, from)| *from == Some(i)));
            if unbroken && (at == 0 || stream[at - 1].0 == 0) {
                whole.push(i as u64);
            }
        }
        let bytes: Vec<u8> = stream.iter().map(|(b, _)| *b).collect();
        let mut base = Base::new(Some(1.0));
        base.begin(1, Beginning::default(), None);
        let mut rows = Vec::new();
        // In pieces of any size.
        for piece in bytes.chunks(41) {
            base.push(1, 0, None, piece, &mut rows);
        }
        let (lost, records): (Vec<_>, Vec<_>) =
            rows.iter().map(|row| base.json(row)).partition(|r| r["type"] == "lost");
        let got: Vec<u64> = records.iter().map(|r| r["sequence"].as_u64().unwrap()).collect();
        let mut rest = got.iter();
        for wanted in &whole {
            prop_assert!(rest.any(|g| g == wanted), "frame {wanted} was not kept: {got:?}");
        }
        let counters = base.counters();
        // Between the first frame and the last, what did not come is lost; what came twice is not.
        let (first, last) = (got.iter().min().copied(), got.iter().max().copied());
        let span = first.zip(last).map_or(0, |(first, last)| last - first + 1);
        let distinct = got.iter().collect::<BTreeSet<_>>().len() as u64;
        if got.is_sorted() {
            prop_assert_eq!(counters.stream.lost, span - distinct);
        } else {
            // A frame that comes after a later one may have been given up meanwhile.
            prop_assert!(counters.stream.lost >= span - distinct && counters.stream.lost <= span, "{counters:?}");
        }
        // What was counted as lost was told; a frame that came after all is not told again.
        let told: u64 = lost.iter().map(|r| r["frames"].as_u64().unwrap()).sum();
        prop_assert!(told >= counters.stream.lost, "{told} {counters:?}");
        // Nothing is invented: what is received more often than sent was repeated whole.
        prop_assert_eq!(counters.stream.frames as usize, records.len());
        prop_assert_eq!(counters.bytes as usize, bytes.len());
        for r in &records {
            let i = r["sequence"].as_u64().unwrap();
            if r["type"] == "end" {
                prop_assert_eq!(r["t_s"].as_f64().unwrap(), i as f64 * 12_345.0);
            }
        }
    }

    #[test]
    fn noise_is_never_a_record(noise in prop::collection::vec(any::<u8>(), 0..3000)) {
        let mut base = Base::new(None);
        base.begin(1, Beginning::default(), None);
        let mut records = Vec::new();
        base.push(1, 0, None, &noise, &mut records);
        prop_assert!(records.is_empty());
    }
}
