//! StationXML instead of a station file: an SDS archive and its metadata, nothing written by hand.

use seabearing::ocean_bottom::scenario::ObsScenario;
use seabearing::ocean_bottom::simulate::Simulator;
use seabearing::ocean_bottom::write::write;
use seabearing::propagation::{bottom::Bottom, file, profile::SpeedProfile, trace};
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Twenty minutes over midnight of a station that the data centre calls XX.S01, as an SDS archive, and the station file.
fn archive(folder: &Path) {
    let profile = SpeedProfile::subtropical(4340.0).unwrap();
    let table = trace::trace("t", &profile, &Bottom::default(), 350.0, 150, || ());
    file::write(&table, &folder.join("t.toml")).unwrap();
    let scenario = "kind = \"obs\"\nname = \"S01\"\nseed = 3\nduration_s = 1200.0\nstart_utc = \"2024-05-01T23:50:00Z\"\n\
        propagation = \"t.toml\"\norientation_of_north_deg = 77.0\n[[vessels]]\n\
        straight = { cpa_time_s = 600.0, cpa_range_m = 6000.0, heading_deg = 30.0, speed_m_s = 8.0, side = \"port\" }\n";
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
fn metadata(folder: &Path) {
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
         <Station code=\"S01\">{place}{}{}{}{}</Station></Network></FDSNStationXML>",
        channel("BHZ", 0.0, -90.0, "m/s"),
        channel("BDH", 0.0, -90.0, "Pa"),
        channel("BH1", 77.0, 0.0, "m/s"),
        channel("BH2", 167.0, 0.0, "m/s"),
        channel("BHZ", 0.0, -90.0, "m/s"),
    );
    std::fs::write(folder.join("network.xml"), text).unwrap();
}

fn seabearing(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.args(line.split_whitespace()).current_dir(folder).stdin(Stdio::null()).output().unwrap()
}

/// Records without those that say whose they are.
fn records(ran: &Output) -> Vec<String> {
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let text = String::from_utf8(ran.stdout.clone()).unwrap();
    text.lines().filter(|l| !l.contains("\"type\":\"hello\"")).map(str::to_owned).collect()
}

#[test]
fn an_archive_with_stationxml_gives_the_records_of_one_with_a_station_file() {
    let dir = tempfile::tempdir().unwrap();
    archive(dir.path());
    metadata(dir.path());
    let by_hand = records(&seabearing(dir.path(), "process --station out/hand.toml sds"));
    assert!(by_hand.iter().filter(|r| r.contains("\"type\":\"azimuth\"")).count() > 5, "{by_hand:#?}");
    let direct = records(&seabearing(dir.path(), "process --station network.xml --propagation t.toml sds"));
    assert!(direct == by_hand);
    let made = seabearing(
        dir.path(),
        "station import network.xml --station S01 --network XX --location -- --propagation t.toml --out made/s.toml",
    );
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    assert!(records(&seabearing(dir.path(), "process --station made/s.toml sds")) == by_hand);
    let checked = seabearing(dir.path(), "config check made/s.toml --json");
    assert!(String::from_utf8_lossy(&checked.stdout).contains("\"name\":\"XX.S01\""));
    // By days, and a station that the archive does not hold is no error.
    let out = seabearing(dir.path(), "process --station network.xml --propagation t.toml sds --out days");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let mut names: Vec<String> = std::fs::read_dir(dir.path().join("days"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|n| n.ends_with("jsonl"))
        .collect();
    names.sort();
    assert_eq!(names, ["XX.S01.2024-05-01.jsonl", "XX.S01.2024-05-02.jsonl"]);
}

#[test]
fn what_cannot_be_imported_is_said_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    metadata(dir.path());
    std::fs::write(dir.path().join("page.xml"), "<html><body/></html>").unwrap();
    for (line, what) in [
        ("network.xml --station LAND", "XX.LAND: BHZ has no two horizontal components"),
        ("network.xml --station S02", "no such station"),
        ("page.xml", "no StationXML: the outermost element is <html>"),
        ("absent.xml", "cannot read absent.xml"),
        ("network.xml --at yesterday", "--at yesterday"),
    ] {
        let ran = seabearing(dir.path(), &format!("station import {line} --out s.toml"));
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert!(!ran.status.success() && said.contains(what) && said.lines().count() == 1, "{line}: {said}");
    }
    assert!(!dir.path().join("s.toml").exists());
    // Without a table one of a typical sea is traced.
    let made = seabearing(dir.path(), "station import network.xml --station S01 --out s.toml");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    assert!(seabearing(dir.path(), "config check s.toml").status.success());
}
