//! What the modelled converter delivers when its supply fails.

use super::*;

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
    const FRAME: usize = 6 * WORD;
    for clocked in [FRAME - 1, FRAME] {
        assert_eq!(delivered(clocked), [[1, 2, 3, 4]], "{clocked}");
    }
    for clocked in [0, 1, WORD, FRAME - 2] {
        assert_eq!(delivered(clocked), [[0; 4]; 0], "{clocked}");
    }
}
