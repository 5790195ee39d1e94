//! The configuration of a station as the firmware stores it.

use crate::plan::no_such_rate;
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use seabearing_core::config::Kind;
use seabearing_core::config_blob::{BlobError, PROPAGATION, Writer};
use seabearing_core::slots;

/// Room for the blob of a station, its propagation table included.
const BLOB_BYTES: usize = 1 << 20;

/// Bytes of a sector of the hardware's flash: a place for a configuration.
const PLACE_BYTES: usize = 1 << 17;

/// The two places of the hardware's flash, from 0x08100000 on, as a probe writes them: the station's configuration, kept from the
/// start, in the first, nothing in the second.
///
/// # Errors
/// As of [`of`], and where the board would not take the configuration: it is too long, or the converters do not have its rate.
pub fn places(station: &Station) -> Result<Vec<u8>> {
    let blob = of(station)?;
    let ocean_bottom = matches!(station.config.kind, Kind::Obs(_));
    if let Some(misfit) = no_such_rate(ocean_bottom, station.config.rate_hz) {
        bail!("{misfit}");
    }
    let longest = slots::LONGEST[usize::from(ocean_bottom)];
    if blob.len() > longest {
        bail!("the configuration takes {} bytes; the recorder has room for {longest}", blob.len());
    }
    let mut bytes: Vec<u8> = slots::written(&blob).flatten().collect();
    bytes.resize(2 * PLACE_BYTES, 0xff);
    Ok(bytes)
}

/// Whether one of the two places has this configuration, marked as whole; which place, and whether it was tried, is nothing to this.
pub fn holds(places: &[u8], blob: &[u8]) -> bool {
    let Some(whole) = slots::written(blob).next() else { return false };
    let has = |place: &[u8]| place.get(slots::HEAD_BYTES..).is_some_and(|text| text.starts_with(blob));
    // A configuration's number among others is in the first word too, after what marks it whole.
    places.chunks(PLACE_BYTES).any(|place| has(place) && place.get(..4) == whole.get(..4))
}

/// The configuration blob of a station: what is flashed beside the firmware.
///
/// # Errors
/// The propagation table cannot be read, or it does not fit.
pub fn of(station: &Station) -> Result<Vec<u8>> {
    if let Some(channels) = station.file_channels.filter(|c| c.iter().any(|c| *c > 3)) {
        bail!("channels = {channels:?} are those of recordings; a recorder has channels 0 to 3");
    }
    let mut bytes = vec![0u8; BLOB_BYTES];
    let table = crate::ocean_bottom::table::of_station(station)?;
    let length = write_blob(&mut bytes, station, table.as_deref())
        .map_err(|_| anyhow!("the configuration takes more than {BLOB_BYTES} bytes"))?;
    bytes.truncate(length);
    Ok(bytes)
}

fn write_blob(bytes: &mut [u8], station: &Station, table: Option<&[u8]>) -> Result<usize, BlobError> {
    let mut writer = Writer::new(bytes)?;
    writer.station(&station.config)?;
    if let Some(table) = table {
        writer.section(PROPAGATION, |body| {
            body.get_mut(..table.len())?.copy_from_slice(table);
            Some(table.len())
        })?;
    }
    Ok(writer.finish())
}
