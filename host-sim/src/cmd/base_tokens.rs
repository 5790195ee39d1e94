//! Numbers by which the answers to this run's commands are known: other ones than those of the runs before, whose answers a
//! recorder may hold still.

use std::sync::OnceLock;
use std::time::{SystemTime, UNIX_EPOCH};

static FIRST: OnceLock<u8> = OnceLock::new();

/// One of the three numbers of this run: 0 to 2.
fn of_run(n: u8) -> u8 {
    let first = FIRST.get_or_init(|| {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        // Thousandths of a second, mixed so that runs a round time apart differ; 0 is nobody's.
        let mixed = (now.as_millis() as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        1 + 3 * (mixed % 84) as u8
    });
    first + n
}

/// Of the command that was asked for.
pub fn order() -> u8 {
    of_run(0)
}

/// Of the question before it, who the recorder is.
pub fn who() -> u8 {
    of_run(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_of_a_run_stay_and_differ() {
        assert_eq!((order(), who()), (order(), who()));
        assert!(order() != who() && order() > 0);
    }
}
