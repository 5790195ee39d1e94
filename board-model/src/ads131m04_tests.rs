//! What the modelled converter delivers when something happens while a frame is clocked out.

use super::*;

const FRAME: usize = 6 * WORD;

/// What was delivered of a frame whose supply failed after so many of its bytes.
fn delivered(clocked: usize) -> Vec<Codes> {
    let mut given = 0;
    let source = Box::new(move || {
        given += 1;
        Some([given, 20, 30, 40])
    });
    let mut converter = Ads131m04::new(source, 4000.0, 0.0);
    let now = PER_SECOND / 10;
    converter.advance(now);
    converter.delivered.clear();
    converter.codes.clear();
    converter.output = VecDeque::from([(Some(7), [1, 2, 3, 4])]);
    converter.select(true, now);
    let frame = converter.frame_out.len();
    (0..frame).for_each(|n| {
        if n == clocked {
            converter.set_dead(true, now);
        }
        converter.exchange(0, now);
    });
    converter.set_dead(true, now);
    converter.select(false, now);
    converter.codes.clone()
}

#[test]
fn what_was_clocked_out_before_the_supply_failed_was_delivered() {
    for clocked in [FRAME - 1, FRAME] {
        assert_eq!(delivered(clocked), [[1, 2, 3, 4]], "{clocked}");
    }
    for clocked in [0, 1, WORD, FRAME - 2] {
        assert_eq!(delivered(clocked), [[0; 4]; 0], "{clocked}");
    }
}

/// A converter whose supply is well, a frame of result 7 begun, while 8 waits.
fn clocking() -> (Ads131m04, Ticks) {
    let mut converter = Ads131m04::new(Box::new(|| Some([0; 4])), 4000.0, 0.0);
    let now = PER_SECOND / 10;
    converter.advance(now);
    converter.delivered.clear();
    converter.output = VecDeque::from([(Some(7), [0; 4]), (Some(8), [0; 4])]);
    converter.select(true, now);
    converter.exchange(0, now);
    (converter, now)
}

/// Clocks out the rest of the frame; numbers of the results delivered and of those that wait.
fn rest((mut converter, now): (Ads131m04, Ticks)) -> (Vec<u64>, Vec<u64>) {
    (1..FRAME).for_each(|_| {
        converter.exchange(0, now);
    });
    converter.select(false, now);
    (converter.delivered, converter.output.iter().filter_map(|result| result.0).collect())
}

#[test]
fn a_frame_begun_before_the_filters_begin_afresh_is_delivered_and_what_waited_is_not() {
    let (mut converter, now) = clocking();
    converter.resynchronise(now);
    assert_eq!(rest((converter, now)), (vec![7], vec![]));
}

#[test]
fn a_third_result_during_a_frame_leaves_what_is_clocked_out() {
    let (mut converter, now) = clocking();
    converter.output = VecDeque::from([(Some(8), [0; 4]), (Some(9), [0; 4])]);
    assert_eq!(rest((converter, now)), (vec![7], vec![8, 9]));
}
