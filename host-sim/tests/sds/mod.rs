//! An SDS archive of an ocean-bottom station, with the metadata that a data centre has of it.

use seabearing::ocean_bottom::scenario::ObsScenario;
use seabearing::ocean_bottom::simulate::Simulator;
use seabearing::ocean_bottom::write::write;
use seabearing::propagation::{bottom::Bottom, file, profile::SpeedProfile, trace};
use std::path::Path;

/// Twenty minutes over midnight of a station of network XX, as an SDS archive, and the station file.
pub fn archive(folder: &Path, name: &str) {
    let profile = SpeedProfile::subtropical(4340.0).unwrap();
    let table = trace::trace("t", &profile, &Bottom::default(), 350.0, 150, || ());
    file::write(&table, &folder.join("t.toml")).unwrap();
    let scenario = format!(
        "kind = \"obs\"\nname = \"{name}\"\nseed = 3\nduration_s = 1200.0\nstart_utc = \"2024-05-01T23:50:00Z\"\n\
        propagation = \"t.toml\"\norientation_of_north_deg = 77.0\n[[vessels]]\n\
        straight = {{ cpa_time_s = 600.0, cpa_range_m = 6000.0, heading_deg = 30.0, speed_m_s = 8.0, side = \"port\" }}\n"
    );
    std::fs::write(folder.join("s.toml"), scenario).unwrap();
    let scenario = ObsScenario::read(&folder.join("s.toml")).unwrap();
    let mut simulator = Simulator::new(scenario, table, Vec::new()).unwrap();
    let written = write(&mut simulator, &folder.join("out")).unwrap();
    let text = std::fs::read_to_string(&written.station)
        .unwrap()
        .replace("propagation = ", "propagation = \"../t.toml\" #");
    std::fs::write(folder.join("out/hand.toml"), text).unwrap();
    for path in &written.recordings {
        let bytes = std::fs::read(path).unwrap();
        let field = |from: usize, n: usize| String::from_utf8_lossy(&bytes[from..from + n]).trim().to_owned();
        let (network, station, code) = (field(18, 2), field(8, 5), field(15, 3));
        for (day, from, to) in
            [(122, 0, bytes.len() / 8192 * 4096), (123, bytes.len() / 8192 * 4096, bytes.len())]
        {
            let folder = folder.join(format!("sds/2024/{network}/{station}/{code}.D"));
            std::fs::create_dir_all(&folder).unwrap();
            let name = folder.join(format!("{network}.{station}..{code}.D.2024.{day}"));
            std::fs::write(name, &bytes[from..to]).unwrap();
        }
    }
}

/// Metadata as a data centre has it, with a second station that is none for us.
pub fn metadata(folder: &Path, name: &str) {
    let channel = |code: &str, azimuth: f64, dip: f64, unit: &str| {
        format!(
            "<Channel code=\"{code}\" locationCode=\"\"><Latitude>-25</Latitude><Longitude>62</Longitude>\
             <Elevation>-4340</Elevation><Depth>0</Depth><Azimuth>{azimuth}</Azimuth><Dip>{dip}</Dip>\
             <SampleRate>50</SampleRate><Response><InstrumentSensitivity><Value>1000</Value><Frequency>1</Frequency>\
             <InputUnits><Name>{unit}</Name></InputUnits></InstrumentSensitivity></Response></Channel>"
        )
    };
    let place = "<Latitude>-25</Latitude><Longitude>62</Longitude><Elevation>-4340</Elevation>";
    let text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<FDSNStationXML xmlns=\"http://www.fdsn.org/xml/station/1\" \
         schemaVersion=\"1.1\"><Source>test</Source><Network code=\"XX\"><Station code=\"LAND\">{place}{}</Station>\
         <Station code=\"{name}\">{place}{}{}{}{}</Station></Network></FDSNStationXML>",
        channel("BHZ", 0.0, -90.0, "m/s"),
        channel("BDH", 0.0, -90.0, "Pa"),
        channel("BH1", 77.0, 0.0, "m/s"),
        channel("BH2", 167.0, 0.0, "m/s"),
        channel("BHZ", 0.0, -90.0, "m/s"),
    );
    std::fs::write(folder.join("network.xml"), text).unwrap();
}
