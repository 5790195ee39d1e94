//! Numbers by which a recorder's answers are known to be to this run: it may hold answers still that it gave in the runs before.
//!
//! A number is a byte, and one by chance may be that of an answer which is held. So the recorder is first asked who it is: what
//! it said before that has come when it answers, and the command gets a number that none of it has.

use seabearing_core::wire::Spectrum;
use serde_json::Value;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

static ANY: OnceLock<[u8; 2]> = OnceLock::new();
static ORDER: OnceLock<u8> = OnceLock::new();
static HEARD: [AtomicBool; 256] = [const { AtomicBool::new(false) }; 256];

/// Two numbers, other ones in every run.
fn any() -> [u8; 2] {
    *ANY.get_or_init(|| {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        // Mixed, so that runs a round time apart differ.
        let seed = now.as_nanos() as u64 ^ u64::from(std::process::id());
        let [.., a, b] = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_le_bytes();
        [a, b]
    })
}

/// Of the question before the command, who the recorder is.
pub fn who() -> u8 {
    let [who, _] = any();
    who
}

/// Of the command: none that was heard before this was asked for the first time, nor that of what a recorder sends unasked.
pub fn order() -> u8 {
    let heard = |token: u8| HEARD.get(usize::from(token)).is_some_and(|h| h.load(Ordering::Relaxed));
    *ORDER.get_or_init(|| {
        let [who, from] = any();
        free(from, |token| token == Spectrum::UNASKED || token == who || heard(token))
    })
}

/// Takes note of what the recorder says; whether it answers the question who it is.
pub fn hear(record: &Value) -> bool {
    let token = record["token"].as_u64().and_then(|token| u8::try_from(token).ok());
    let Some(token) = token.filter(|_| record["type"] == "reply") else { return false };
    if let Some(heard) = HEARD.get(usize::from(token)) {
        heard.store(true, Ordering::Relaxed);
    }
    token == who()
}

/// The next number from here on that is not taken; the first where all are.
fn free(from: u8, taken: impl Fn(u8) -> bool) -> u8 {
    (0..=255).map(|n| from.wrapping_add(n)).find(|token| !taken(*token)).unwrap_or(from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_command_has_a_number_that_no_answer_had() {
        assert_eq!(free(254, |token| token != 7), 7);
        assert_eq!(free(254, |token| !(2..=253).contains(&token)), 2);
        assert_eq!(free(9, |_| true), 9);
        assert!(order() != who() && order() == order());
    }

    #[test]
    fn an_answer_to_the_question_is_a_reply_with_its_number() {
        assert!(hear(&json!({"type": "reply", "token": who()})));
        for other in
            [json!({"type": "samples", "token": who()}), json!({"type": "reply", "token": who() ^ 1})]
        {
            assert!(!hear(&other));
        }
    }
}
