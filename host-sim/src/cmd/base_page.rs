//! The live page of a base station (`--page`).

use crate::base::export::Positions;
use crate::base::service::Service;
use crate::base::stations::Listed;
use anyhow::Result;
use seabearing_page::{Page, Place, Serving};
use std::path::PathBuf;

/// Serves the page from now on: stations by their names where the file says them, and wherever their places are known.
pub(super) fn serve(
    page: Page,
    service: &Service,
    store: Option<PathBuf>,
    listed: &[Listed],
    positions: &Positions,
) -> Result<Serving> {
    let place = |station: u16| positions.of_station.get(&u64::from(station)).copied();
    let mut places: Vec<Place> = listed
        .iter()
        .map(|s| Place {
            station: Some(s.config.id),
            name: Some(s.config.name.to_string()).filter(|name| !name.is_empty()),
            lat_lon_deg: place(s.config.id),
        })
        .collect();
    for (station, lat_lon_deg) in &positions.of_station {
        let station = u16::try_from(*station).ok();
        if places.iter().all(|p| p.station != station) {
            places.push(Place { station, name: None, lat_lon_deg: Some(*lat_lon_deg) });
        }
    }
    if positions.otherwise.is_some() {
        places.push(Place { lat_lon_deg: positions.otherwise, ..Place::default() });
    }
    let url = page.url();
    let serving = page.serve(service.feed(), store, &places)?;
    log::info!("page at {url}");
    Ok(serving)
}

/// The page stays when all input has ended.
pub(super) fn stay() -> ! {
    log::info!("all input has ended; the page stays until this is interrupted");
    loop {
        std::thread::park();
    }
}
