//! The way of `seabearing base` over a broker: records published (`--mqtt`), and those of other base stations taken
//! (`--from-mqtt`).

use super::mistake;
use crate::base::service::Service;
use crate::base::store::Tail;
use anyhow::Result;
use seabearing_watch::mqtt::broker::Broker;
use seabearing_watch::mqtt::publish::{self, Publisher, Source};
use seabearing_watch::mqtt::subscribe::{self, Subscriber};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// Longest that reading files waits for a broker's first word.
const FIRST: Duration = Duration::from_secs(2);

/// Options.
#[derive(clap::Args)]
pub(super) struct Mqtt {
    /// Publish every record to this broker: mqtt://USER@HOST:PORT/PREFIX, all but HOST may be left out; mqtts for TLS; or a TOML file
    #[arg(long, value_name = "BROKER")]
    mqtt: Option<String>,
    /// Take the records that other base stations publish to this broker
    #[arg(long, value_name = "BROKER")]
    from_mqtt: Option<String>,
}

/// The brokers, read and not yet spoken to.
pub(super) struct Brokers {
    to: Option<Broker>,
    from: Option<Broker>,
}

/// What is at work.
#[derive(Default)]
pub(super) struct AtWork {
    publisher: Option<Publisher>,
    subscriber: Option<Subscriber>,
}

impl Mqtt {
    /// Reads what is said of brokers: before anything is begun.
    pub(super) fn read(&self) -> Result<Brokers> {
        let read = |option: &str, text: &Option<String>| {
            let Some(text) = text else { return Ok(None) };
            if text.trim().is_empty() {
                mistake!("{option}: no broker is named; mqtt://HOST or a TOML file was expected");
            }
            Broker::read(text).map(Some).or_else(|e| match text.contains("://") {
                true => mistake!("{option}: {e:#}"),
                // A file of the broker's.
                false => Err(e),
            })
        };
        let brokers =
            Brokers { to: read("--mqtt", &self.mqtt)?, from: read("--from-mqtt", &self.from_mqtt)? };
        if let (Some(to), Some(from)) = (&brokers.to, &brokers.from)
            && from.hears(to)
        {
            mistake!(
                "--from-mqtt takes the topics below {} that --mqtt publishes, on one broker: records would go round for \
                 ever; give --mqtt another prefix",
                to.prefix
            );
        }
        Ok(brokers)
    }
}

impl Brokers {
    /// Whether records come from a broker.
    pub(super) fn brings(&self) -> bool {
        self.from.is_some()
    }

    /// Starts what is asked for.
    pub(super) fn start(self, service: &mut Service, store: Option<&Path>) -> Result<AtWork> {
        let mut at_work = AtWork::default();
        if let Some(broker) = self.to {
            let source = match store {
                Some(folder) => Source::Store(Tail::open(folder)?),
                None => Source::Memory(service.waiting(broker.room)),
            };
            log::info!("records to {broker}, topics {}/STATION/TYPE", broker.prefix);
            let publisher = publish::start(broker, source, store)?;
            if service.ends() {
                // Where files are read at once a broker that is not there is better known before.
                publisher.begun(FIRST);
            }
            at_work.publisher = Some(publisher);
        }
        if let Some(broker) = self.from
            && let Some(door) = service.door()
        {
            log::info!("records from {broker}");
            let own = at_work.publisher.as_ref().map(|p| p.logs().clone());
            at_work.subscriber = Some(subscribe::start(broker, door, store, own)?);
        }
        Ok(at_work)
    }
}

impl AtWork {
    /// What a person should know; each is told once.
    pub(super) fn notes(&self) -> Vec<String> {
        let of = self.publisher.iter().map(Publisher::counts);
        of.chain(self.subscriber.iter().map(Subscriber::counts)).flat_map(|counts| counts.notes()).collect()
    }

    /// Counters for Prometheus.
    pub(super) fn counters(&self) -> impl Fn() -> String + Clone + Send + Sync + 'static {
        let publisher = self.publisher.as_ref().map(|p| Arc::clone(p.counts()));
        let subscriber = self.subscriber.as_ref().map(|s| Arc::clone(s.counts()));
        move || {
            let text = |counts: &Option<Arc<seabearing_watch::mqtt::Counts>>, way| {
                counts.as_ref().map_or(String::new(), |counts| counts.text(way))
            };
            text(&publisher, "publish") + &text(&subscriber, "subscribe")
        }
    }

    /// All input has ended: the broker is given time to take what there is, and what a person should know is told. Says what is
    /// not published, and `kept` in a store or not.
    pub(super) fn settle(&self, kept: bool, most: Duration, tell: &dyn Fn(Vec<String>)) -> Option<String> {
        let publisher = self.publisher.as_ref()?;
        let left = publisher.settle(most, || tell(self.notes()));
        let then = if kept { "they wait in the store" } else { "they are lost" };
        (left > 0).then(|| format!("{left} records are not published: {then}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broker_without_a_name_is_a_mistake_of_arguments() {
        for options in [
            Mqtt { mqtt: Some(String::new()), from_mqtt: None },
            Mqtt { mqtt: None, from_mqtt: Some(" ".to_owned()) },
        ] {
            let error = options.read().err().unwrap();
            assert!(
                error.is::<crate::cmd::Mistake>() && error.to_string().contains("no broker is named"),
                "{error}"
            );
        }
    }
}
