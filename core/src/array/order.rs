//! In which order channels may hold the hydrophones.
//!
//! Two change places where wires or slots of a converter are exchanged, both pairs where two stereo lines are, all four where
//! the frame of a serial line slips by a slot or more. All 24 orders are looked for.

use crate::block::CHANNELS;

/// Number of orders, that of the geometry with them.
pub(super) const ORDERS: usize = 24;
/// Orders by which two channels are exchanged: from 1 on.
pub(super) const SWAPS: usize = 6;
/// From this order on they come in pairs, of which each undoes the other. Those before undo themselves.
const ONE_WAY: u8 = 10;

/// Which hydrophone each channel holds: as they should be, two exchanged, two and two, three, and all four in a ring.
const HELD: [[u8; CHANNELS]; ORDERS] = [
    [0, 1, 2, 3],
    [1, 0, 2, 3],
    [2, 1, 0, 3],
    [3, 1, 2, 0],
    [0, 2, 1, 3],
    [0, 3, 2, 1],
    [0, 1, 3, 2],
    [1, 0, 3, 2],
    [2, 3, 0, 1],
    [3, 2, 1, 0],
    [1, 2, 0, 3],
    [2, 0, 1, 3],
    [1, 3, 2, 0],
    [3, 0, 2, 1],
    [2, 1, 3, 0],
    [3, 1, 0, 2],
    [0, 2, 3, 1],
    [0, 3, 1, 2],
    [1, 2, 3, 0],
    [3, 0, 1, 2],
    [1, 3, 0, 2],
    [2, 0, 3, 1],
    [2, 3, 1, 0],
    [3, 2, 0, 1],
];

/// The order that undoes one.
pub(super) const fn inverse(order: u8) -> u8 {
    if order < ONE_WAY { order } else { order ^ 1 }
}

/// The hydrophone that a channel holds; in an order that is none its own.
pub(super) fn held(order: u8, channel: usize) -> usize {
    HELD.get(usize::from(order)).and_then(|held| held.get(channel)).map_or(channel, |h| usize::from(*h))
}

/// What channels in this order hear of what hydrophones do.
#[inline(never)]
pub(super) fn heard(times: &[f32; CHANNELS], order: u8) -> [f32; CHANNELS] {
    core::array::from_fn(|channel| times.get(held(order, channel)).copied().unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PAIRS;

    #[test]
    fn all_orders_are_there_once_and_each_is_undone() {
        let hydrophones = [0.0, 1.0, 2.0, 3.0];
        for order in 0..ORDERS as u8 {
            let once = heard(&hydrophones, order);
            assert_eq!(heard(&once, inverse(order)), hydrophones, "{order}");
            assert_eq!(once == hydrophones, order == 0, "{order}");
            for other in 0..order {
                assert_ne!(once, heard(&hydrophones, other), "{order} {other}");
            }
        }
        assert_eq!(heard(&hydrophones, ORDERS as u8), hydrophones);
    }

    #[test]
    fn the_first_are_exchanges_of_the_pairs_in_their_order() {
        for ((i, j), order) in PAIRS.into_iter().zip(1u8..) {
            let mut swapped = [0.0, 1.0, 2.0, 3.0];
            swapped.swap(i, j);
            assert_eq!(heard(&[0.0, 1.0, 2.0, 3.0], order), swapped);
        }
        assert_eq!(PAIRS.len(), SWAPS);
    }
}
