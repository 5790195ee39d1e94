//! Records that wait in memory for somebody who takes them later, as a broker that is away: a base station without a store
//! has no other place for them.

use super::Base;
use super::record::Row;
use super::store::Numbered;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The records, numbered from 1 as they came. Where there is no room the oldest are dropped.
#[derive(Debug)]
pub struct Waiting {
    room: usize,
    queue: Mutex<Queue>,
}

#[derive(Debug, Default)]
struct Queue {
    newest: i64,
    records: VecDeque<Numbered>,
}

impl Waiting {
    /// None yet; at most so many.
    pub fn new(room: usize) -> Self {
        Self { room, queue: Mutex::default() }
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// More records of a base station.
    pub(crate) fn put(&self, base: &Base, rows: &[Row]) {
        let mut queue = self.queue();
        for row in rows {
            queue.newest += 1;
            let number = queue.newest;
            queue.records.push_back(Numbered { number, row: row.clone(), rate_hz: base.rate_of(row) });
            if queue.records.len() > self.room {
                queue.records.pop_front();
            }
        }
    }

    /// Number of the newest.
    pub fn newest(&self) -> i64 {
        self.queue().newest
    }

    /// Those after a number, at most so many. Where some were dropped the first is a later one.
    pub fn after(&self, after: i64, most: usize) -> Vec<Numbered> {
        let queue = self.queue();
        let first = queue.records.partition_point(|r| r.number <= after);
        queue.records.iter().skip(first).take(most).cloned().collect()
    }

    /// Those up to a number are not wanted again.
    pub fn forget(&self, up_to: i64) {
        let mut queue = self.queue();
        let gone = queue.records.partition_point(|r| r.number <= up_to);
        queue.records.drain(..gone);
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::Body;
    use super::*;
    use serde_json::json;

    #[test]
    fn the_oldest_make_room_and_what_was_taken_is_forgotten() {
        let (waiting, base) = (Waiting::new(4), Base::new(None));
        let row = Row {
            origin: None,
            station: Some(7),
            session: None,
            sequence: None,
            utc: None,
            received_us: None,
            body: Body::Said(json!({ "type": "line" })),
        };
        waiting.put(&base, &vec![row.clone(); 3]);
        let numbers = |after, most| waiting.after(after, most).iter().map(|r| r.number).collect::<Vec<_>>();
        assert_eq!((numbers(0, 2), numbers(2, 9)), (vec![1, 2], vec![3]));
        waiting.forget(2);
        waiting.put(&base, &vec![row; 4]);
        assert_eq!((numbers(0, 9), waiting.newest()), (vec![4, 5, 6, 7], 7));
    }
}
