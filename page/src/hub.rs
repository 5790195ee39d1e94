//! Between the feed and the browsers: one thread takes records, keeps the picture, and hands them on.

use crate::picture::Picture;
use seabearing_base::feed::{Feed, Subscription};
use serde_json::{Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::broadcast;

/// Records that wait for the page.
const WAITING: usize = 50_000;
/// Time in which records are handed on together.
const TOGETHER: Duration = Duration::from_millis(100);
/// Batches that wait for a browser; one that is slower is told to look anew.
const BATCHES: usize = 64;

/// What all browsers share.
pub struct Hub {
    picture: Mutex<Picture>,
    live: broadcast::Sender<Arc<str>>,
    feed: Feed,
}

impl Hub {
    /// A hub with a picture of what was before; it takes what is published from now on.
    pub fn start(feed: &Feed, picture: Picture) -> Arc<Self> {
        let (live, _) = broadcast::channel(BATCHES);
        let hub = Arc::new(Self { picture: Mutex::new(picture), live, feed: feed.clone() });
        let (records, of) = (feed.subscribe(WAITING), Arc::clone(&hub));
        std::thread::spawn(move || of.take_all(&records));
        hub
    }

    /// What is shown now.
    pub fn picture(&self) -> MutexGuard<'_, Picture> {
        self.picture.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What comes from now on, as texts of JSON.
    pub fn subscribe(&self) -> broadcast::Receiver<Arc<str>> {
        self.live.subscribe()
    }

    /// Browsers that listen.
    pub fn listeners(&self) -> usize {
        self.live.receiver_count()
    }

    /// Hands on an acknowledgement to whoever raised the alarm.
    pub fn acknowledge(&self, id: &Value) {
        self.feed.publish(vec![json!({ "type": "acknowledge", "id": id })]);
    }

    /// Shows a line for a person among the events.
    pub fn note(&self, text: &str) {
        let at = seabearing_base::record::micros(time::OffsetDateTime::now_utc());
        let at = seabearing_base::record::rfc3339(at);
        self.show(&[json!({ "type": "note", "text": text, "utc": at, "received_utc": at })], 0);
    }

    fn take_all(&self, records: &Subscription) {
        while let Some(first) = records.take() {
            let (begun, mut missed) = (Instant::now(), first.missed);
            let mut all = first.records.to_vec();
            while let Some(more) = records.take_within(Duration::ZERO).filter(|m| !m.records.is_empty()) {
                missed += more.missed;
                all.extend(more.records.iter().cloned());
            }
            self.show(&all, missed);
            std::thread::sleep(TOGETHER.saturating_sub(begun.elapsed()));
        }
        let _ = self.live.send(json!({ "ended": true }).to_string().into());
    }

    fn show(&self, records: &[Value], missed: usize) {
        let mut picture = self.picture();
        records.iter().for_each(|r| picture.take(r));
        // Under the lock: who looks at the picture and then listens misses nothing.
        if self.live.receiver_count() > 0 {
            let _ = self.live.send(json!({ "missed": missed, "records": records }).to_string().into());
        }
    }
}
