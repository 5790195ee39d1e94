//! The configuration of a station as the firmware stores it.

use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use seabearing_core::config::Kind;
use seabearing_core::config_blob::{BlobError, PROPAGATION, Writer};
use seabearing_core::slots;

/// Room for the blob of a station, its propagation table included.
const BLOB_BYTES: usize = 1 << 20;

/// Bytes of a sector of the hardware's flash: a place for a configuration.
const PLACE_BYTES: usize = 1 << 17;
/// Longest configuration that a place takes, bytes: an array's and an ocean-bottom station's (`firmware/src/stm32h743/kept.rs`).
const LONGEST: [usize; 2] = [4096, 32_768];

/// The two places of the hardware's flash, from 0x08100000 on, as a probe writes them: the station's configuration, kept from the
/// start, in the first, nothing in the second.
///
/// # Errors
/// As of [`of`], and where the configuration is longer than a place takes.
pub fn places(station: &Station) -> Result<Vec<u8>> {
    let blob = of(station)?;
    let longest = LONGEST[usize::from(matches!(station.config.kind, Kind::Obs(_)))];
    if blob.len() > longest {
        bail!("the configuration takes {} bytes; the recorder has room for {longest}", blob.len());
    }
    let mut bytes: Vec<u8> = slots::written(&blob).flatten().collect();
    bytes.resize(2 * PLACE_BYTES, 0xff);
    Ok(bytes)
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
