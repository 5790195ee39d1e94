//! Records as they are stored, handed to any number of others: standard output, a page, alarms, a broker.
//!
//! [`Service`](super::service::Service) publishes what it has stored, in the order in which that came; others may publish
//! what they find themselves, as `{"type":"alarm",..}`. Whoever is slow misses records and is told how many; storing waits
//! only for a subscriber that asks for it, which is for input that can wait, too.

use serde_json::Value;
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Batches that wait for a subscriber who is waited for.
const AHEAD: usize = 16;
/// So long without records, one that missed some is told so by itself.
const QUIET: Duration = Duration::from_secs(1);

/// Where records are published. Clones are the same feed.
#[derive(Clone, Debug, Default)]
pub struct Feed {
    outlets: Arc<Mutex<Vec<Outlet>>>,
}

/// What a subscriber takes at once.
#[derive(Clone, Debug)]
pub struct Taken {
    /// Records that it missed before these, because it was too slow.
    pub missed: usize,
    /// Records as [`Base::json`](super::Base::json) gives them, in order.
    pub records: Arc<[Value]>,
}

/// How much a subscriber has not seen.
#[derive(Clone, Debug, Default)]
pub struct Behind {
    waiting: Arc<AtomicUsize>,
    missed: Arc<AtomicUsize>,
}

/// The way to one subscriber.
#[derive(Debug)]
struct Outlet {
    queue: SyncSender<Taken>,
    behind: Behind,
    /// Most records that wait; none: it is waited for.
    room: Option<usize>,
}

/// A subscriber's end.
#[derive(Debug)]
pub struct Subscription {
    queue: Receiver<Taken>,
    behind: Behind,
    /// Records taken last, which count as waiting until it asks for the next.
    held: Cell<usize>,
}

impl Feed {
    fn outlets(&self) -> MutexGuard<'_, Vec<Outlet>> {
        self.outlets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A subscriber for whom so many records wait at most, with those it is busy with; of a batch for which there is no room
    /// it misses all. A batch of any size is taken where nothing waits.
    pub fn subscribe(&self, room: usize) -> Subscription {
        self.add(Some(room), room.max(1))
    }

    /// A subscriber who misses nothing, and holds up whoever publishes until it has taken what there is.
    pub fn subscribe_waiting(&self) -> Subscription {
        self.add(None, AHEAD)
    }

    fn add(&self, room: Option<usize>, batches: usize) -> Subscription {
        let (queue, coming) = sync_channel(batches);
        let behind = Behind::default();
        self.outlets().push(Outlet { queue, behind: behind.clone(), room });
        Subscription { queue: coming, behind, held: Cell::new(0) }
    }

    /// Whether anybody takes records.
    pub fn is_taken(&self) -> bool {
        !self.outlets().is_empty()
    }

    /// Hands records to all subscribers. Those that have gone are forgotten.
    pub fn publish(&self, records: Vec<Value>) {
        if !records.is_empty() {
            let records: Arc<[Value]> = records.into();
            self.outlets().retain(|outlet| outlet.put(&records));
        }
    }

    /// Nothing is published any more: subscribers take what waits, and then nothing.
    pub fn end(&self) {
        self.outlets().clear();
    }
}

impl Outlet {
    /// False if the subscriber has gone.
    fn put(&self, records: &Arc<[Value]>) -> bool {
        let (count, records) = (records.len(), Arc::clone(records));
        let waiting = self.behind.waiting.load(Ordering::Relaxed);
        if self.room.is_some_and(|room| waiting > 0 && waiting + count > room) {
            self.behind.missed.fetch_add(count, Ordering::Relaxed);
            return true;
        }
        self.behind.waiting.fetch_add(count, Ordering::Relaxed);
        let missed = self.behind.missed.swap(0, Ordering::Relaxed);
        let taken = Taken { missed, records };
        if self.room.is_none() {
            return self.queue.send(taken).is_ok();
        }
        match self.queue.try_send(taken) {
            Err(TrySendError::Full(_)) => {
                self.behind.waiting.fetch_sub(count, Ordering::Relaxed);
                self.behind.missed.fetch_add(missed + count, Ordering::Relaxed);
                true
            }
            sent => sent.is_ok(),
        }
    }
}

impl Subscription {
    /// The next records, waited for; without any, but how many were missed, where none come after those for a second. `None` once the
    /// feed has ended.
    pub fn take(&self) -> Option<Taken> {
        loop {
            let taken = self.take_within(QUIET)?;
            if taken.missed > 0 || !taken.records.is_empty() {
                return Some(taken);
            }
        }
    }

    /// The next records, waited for so long. Without any, `records` is empty. `None` once the feed has ended.
    pub fn take_within(&self, time: Duration) -> Option<Taken> {
        self.release();
        match self.queue.recv_timeout(time) {
            Ok(taken) => Some(self.took(taken)),
            Err(RecvTimeoutError::Timeout) => {
                let missed = self.behind.missed.swap(0, Ordering::Relaxed);
                Some(Taken { missed, records: Arc::default() })
            }
            Err(RecvTimeoutError::Disconnected) => self.missed_last(),
        }
    }

    /// To look from elsewhere at how much it has not seen.
    pub fn behind(&self) -> Behind {
        self.behind.clone()
    }

    fn took(&self, taken: Taken) -> Taken {
        self.held.set(taken.records.len());
        taken
    }

    /// It is done with what it took last.
    fn release(&self) {
        self.behind.waiting.fetch_sub(self.held.take(), Ordering::Relaxed);
    }

    /// What was missed and not told when the feed ended.
    fn missed_last(&self) -> Option<Taken> {
        let missed = self.behind.missed.swap(0, Ordering::Relaxed);
        (missed > 0).then(|| Taken { missed, records: Arc::default() })
    }
}

impl Behind {
    /// Records that the subscriber has not asked beyond yet.
    pub fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed)
    }

    /// Records missed of which the subscriber has not been told yet.
    pub fn missed(&self) -> usize {
        self.missed.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn numbers(taken: &Taken) -> Vec<u64> {
        taken.records.iter().filter_map(|r| r["n"].as_u64()).collect()
    }

    fn some(range: std::ops::Range<u64>) -> Vec<Value> {
        range.map(|n| json!({ "n": n })).collect()
    }

    #[test]
    fn all_subscribers_get_all_in_order_and_those_that_go_are_forgotten() {
        let feed = Feed::default();
        assert!(!feed.is_taken());
        feed.publish(some(0..3));
        let (a, b) = (feed.subscribe(100), feed.clone().subscribe(100));
        feed.publish(some(3..5));
        feed.publish(some(5..6));
        for subscription in [&a, &b] {
            assert_eq!(numbers(&subscription.take().unwrap()), [3, 4]);
            assert_eq!(numbers(&subscription.take().unwrap()), [5]);
            let nothing = subscription.take_within(Duration::ZERO).unwrap();
            assert!(nothing.records.is_empty() && nothing.missed == 0);
        }
        drop((a, b));
        feed.publish(some(6..7));
        assert!(!feed.is_taken());
    }

    #[test]
    fn who_is_slow_misses_whole_batches_is_told_how_many_and_holds_nobody_up() {
        let feed = Feed::default();
        let (slow, quick) = (feed.subscribe(10), feed.subscribe(10));
        let mut seen = Vec::new();
        for n in 0..50 {
            feed.publish(some(4 * n..4 * n + 4));
            seen.extend(numbers(&quick.take().unwrap()));
        }
        assert_eq!(seen, (0..200).collect::<Vec<_>>());
        assert_eq!(slow.behind().missed(), 200 - 8);
        assert_eq!(numbers(&slow.take().unwrap()), [0, 1, 2, 3]);
        feed.publish(some(200..202));
        assert_eq!(numbers(&slow.take().unwrap()), [4, 5, 6, 7]);
        let after = slow.take().unwrap();
        assert_eq!((after.missed, numbers(&after)), (192, vec![200, 201]));
        // A batch larger than the room is taken where nothing waits; what is missed last is told at the end.
        assert!(slow.take_within(Duration::ZERO).unwrap().records.is_empty());
        feed.publish(some(0..40));
        feed.publish(some(40..41));
        feed.end();
        assert_eq!(slow.take().unwrap().records.len(), 40);
        assert_eq!(slow.take().map(|t| (t.missed, t.records.len())), Some((1, 0)));
        assert!(slow.take().is_none());
    }

    #[test]
    fn who_missed_the_last_records_is_told_before_others_come() {
        let feed = Feed::default();
        let slow = feed.subscribe(1);
        feed.publish(some(0..1));
        feed.publish(some(1..3));
        assert_eq!(numbers(&slow.take().unwrap()), [0]);
        assert_eq!(slow.take().map(|t| (t.missed, t.records.len())), Some((2, 0)));
    }

    #[test]
    fn who_is_waited_for_misses_nothing() {
        let feed = Feed::default();
        let subscription = feed.subscribe_waiting();
        let reader = std::thread::spawn(move || {
            let mut seen = Vec::new();
            while let Some(taken) = subscription.take() {
                assert_eq!(taken.missed, 0);
                seen.extend(numbers(&taken));
                std::thread::sleep(Duration::from_micros(100));
            }
            seen
        });
        (0..500).for_each(|n| feed.publish(some(n..n + 1)));
        feed.end();
        assert_eq!(reader.join().unwrap(), (0..500).collect::<Vec<_>>());
    }
}
