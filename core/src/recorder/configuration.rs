//! Whether this software can be a station.

use crate::config::{Kind, StationConfig};
use crate::config_blob;

/// The configuration in a blob, if it is this station's and this software holds a recorder for it. What only a plan shows
/// [`super::Memory::configure`] finds out.
pub fn configuration(blob: &[u8], station: u16) -> Option<StationConfig> {
    let config = config_blob::station(blob).ok().filter(|config| config.id == station)?;
    let held = match &config.kind {
        #[cfg(feature = "array")]
        Kind::Array(_) => true,
        #[cfg(feature = "obs")]
        Kind::Obs(_) => config_blob::section(blob, config_blob::PROPAGATION)
            .is_ok_and(|table| crate::obs::Table::parse(table).is_ok()),
        _ => false,
    };
    held.then_some(config)
}

#[cfg(all(test, feature = "array", feature = "obs"))]
mod tests {
    use super::*;
    use crate::config::LineConfig;
    use crate::config_blob::{PROPAGATION, Writer};
    use crate::obs::station_tests as bottom;
    use crate::recorder::test_recorder::{ARRAY_RATE, HYDROPHONES_M};
    use std::vec::Vec;

    fn blob(config: &StationConfig, table: Option<&[u8]>) -> Vec<u8> {
        let mut buffer = std::vec![0; 1 << 16];
        let mut writer = Writer::new(&mut buffer).unwrap();
        writer.station(config).unwrap();
        if let Some(table) = table {
            let copy = |body: &mut [u8]| {
                body.get_mut(..table.len())?.copy_from_slice(table);
                Some(table.len())
            };
            writer.section(PROPAGATION, copy).unwrap();
        }
        let length = writer.finish();
        buffer.truncate(length);
        buffer
    }

    #[test]
    fn a_station_of_this_number_and_of_a_kind_that_is_here_is_taken_and_no_other() {
        let array = StationConfig::array(ARRAY_RATE as f64, HYDROPHONES_M);
        let whole = blob(&array, None);
        assert_eq!(configuration(&whole, array.id), Some(array.clone()));
        assert_eq!(configuration(&whole, array.id + 1), None);
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            assert_eq!(configuration(&damaged, array.id), None, "{at}");
        }
        let line = Kind::Line(LineConfig { sensors: 23, spacing_m: 0.75 });
        let line = StationConfig { kind: line, ..array };
        assert_eq!(configuration(&blob(&line, None), line.id), None);
        let (bottom, table) = (bottom::config(50.0), bottom::table(50.0));
        assert!(configuration(&blob(&bottom, Some(table)), bottom.id).is_some());
        assert!(configuration(&blob(&bottom, None), bottom.id).is_none());
        assert!(configuration(&blob(&bottom, Some(&table[1..])), bottom.id).is_none());
    }
}
