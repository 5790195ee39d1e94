//! The base station's live page: what recorders say, on a map and in plots, in any browser, without anything from outside.
//!
//! Records come over the base station's feed (`hub`) and make a picture (`picture`); what was before is looked up in the store.
//! `server` answers the browser's requests; what runs in the browser is `page/web/`, built into the program.

mod hub;
mod picture;
mod server;

use anyhow::{Context, Result};
use hub::Hub;
use picture::Picture;
use seabearing_base::feed::Feed;
use seabearing_base::record::micros;
use seabearing_base::store::History;
use serde_json::{Value, json};
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;

/// How far back the first picture's tracks go, microseconds.
const BACK_US: i64 = 3_600_000_000;

/// Where a station is, as a person said.
#[derive(Clone, Debug, Default)]
pub struct Place {
    /// Its number; none: any station that is not named.
    pub station: Option<u16>,
    /// Its name.
    pub name: Option<String>,
    /// Latitude and longitude, degrees.
    pub lat_lon_deg: Option<(f64, f64)>,
}

impl Place {
    fn json(&self) -> Value {
        let (lat, lon) = self.lat_lon_deg.unzip();
        json!({ "station": self.station, "name": self.name, "lat_deg": lat, "lon_deg": lon })
    }
}

/// An address at which a page will be served.
#[derive(Debug)]
pub struct Page {
    listener: TcpListener,
    address: SocketAddr,
}

impl Page {
    /// Takes the address, so that one in use is known before anything else begins.
    ///
    /// # Errors
    /// One line: the address is none, or cannot be had.
    pub fn bind(at: &str) -> Result<Self> {
        let cannot = || format!("cannot serve the page at {at}: give --page another ADDRESS:PORT");
        let listener = TcpListener::bind(at).with_context(cannot)?;
        listener.set_nonblocking(true).with_context(cannot)?;
        let address = listener.local_addr().with_context(cannot)?;
        Ok(Self { listener, address })
    }

    /// What a person types into a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Serves it from now on, in threads of its own. `store`: to look back into.
    ///
    /// # Errors
    /// The store cannot be read, or the system gives no thread.
    pub fn serve(self, feed: &Feed, store: Option<PathBuf>, places: &[Place]) -> Result<Serving> {
        let before = match &store {
            Some(folder) => {
                let now = micros(time::OffsetDateTime::now_utc());
                Picture::of(&History::open(folder)?.moment(now, now - BACK_US)?)
            }
            None => Picture::default(),
        };
        let hub = Hub::start(feed, before);
        let places: Vec<Value> = places.iter().map(Place::json).collect();
        server::start(self.listener, Arc::clone(&hub), store, places.into())?;
        Ok(Serving { hub })
    }
}

/// A page at work.
pub struct Serving {
    hub: Arc<Hub>,
}

impl Serving {
    /// Shows alarms of before that may stand, oldest first: a look back at who was heard may not find them.
    pub fn stand(&self, alarms: &[Value]) {
        let mut picture = self.hub.picture();
        alarms.iter().for_each(|alarm| picture.stand(alarm));
    }

    /// Shows a line for a person among the events.
    pub fn note(&self, text: &str) {
        self.hub.note(text);
    }
}
