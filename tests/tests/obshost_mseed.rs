//! miniSEED: what the simulator writes is what is read back, faults included; bad input is named; a real file reads.

use seabearing::ocean_bottom::scenario::ObsScenario;
use seabearing::ocean_bottom::simulate::Simulator;
use seabearing::ocean_bottom::write::write;
use seabearing::propagation::{Propagation, bottom::Bottom, file, profile::SpeedProfile, trace};
use seabearing::recording::{self, BlockSource};
use seabearing::station::Station;
use seabearing_core::block::{Frame, MISSING};
use std::path::{Path, PathBuf};

fn table() -> Propagation {
    let profile = SpeedProfile::subtropical(4340.0).unwrap();
    trace::trace("t", &profile, &Bottom::default(), 350.0, 200, || ())
}

fn scenario(folder: &Path, faults: &str) -> ObsScenario {
    file::write(&table(), &folder.join("t.toml")).unwrap();
    let text = format!(
        "kind = \"obs\"\nseed = 3\nduration_s = 900.0\npropagation = \"t.toml\"\norientation_of_north_deg = 77.0\n\
         [[vessels]]\nstraight = {{ cpa_time_s = 400.0, cpa_range_m = 8000.0, heading_deg = 30.0, speed_m_s = 8.0, side = \"port\" }}\n\
         [[fin_whale]]\nazimuth_deg = 120.0\nrange_m = 6000.0\nstart_s = 10.0\nduration_s = 500.0\n\
         interval_s = 13.0\nlevel_db = 20.0\n{faults}\n"
    );
    std::fs::write(folder.join("s.toml"), text).unwrap();
    ObsScenario::read(&folder.join("s.toml")).unwrap()
}

/// All samples by index.
fn all(source: &mut dyn BlockSource) -> Vec<(u64, Frame)> {
    let mut out = Vec::new();
    while let Some(b) = source.next_block().unwrap() {
        out.extend(b.frames.iter().enumerate().map(|(i, f)| (b.first_index + i as u64, *f)));
    }
    out
}

fn written(folder: &Path, s: &ObsScenario) -> (Station, Vec<PathBuf>) {
    let mut simulator = Simulator::new(s.clone(), table(), Vec::new()).unwrap();
    let w = write(&mut simulator, &folder.join("out")).unwrap();
    (Station::read(&w.station).unwrap(), w.recordings)
}

#[test]
fn what_is_written_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let s = scenario(
        dir.path(),
        "[[gaps]]\nstart_s = 100.0\nduration_s = 33.0\n[[gaps]]\nstart_s = 500.0\nduration_s = 0.5\n\
         [[faults]]\nkind = \"clock_step\"\nat_s = 700.0\nby_s = 12.0\n\
         [[faults]]\nkind = \"dead\"\nchannel = 2\nfrom_s = 200.0\nto_s = 260.0",
    );
    let (station, files) = written(dir.path(), &s);
    let mut source = recording::open(&files, &station, None).unwrap();
    assert_eq!(source.start(), Some(s.start));
    let got = all(source.as_mut());
    let want = all(&mut Simulator::new(s, table(), Vec::new()).unwrap());
    assert_eq!(got.len(), want.len());
    assert_eq!(got.len(), 45_000 - 33 * 50 - 25);
    assert_eq!(got, want);
    assert_eq!(got.last().unwrap().0, 45_000 + 12 * 50 - 1);
}

#[test]
fn one_file_with_all_channels_reads_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let s = scenario(dir.path(), "");
    let (station, files) = written(dir.path(), &s);
    let want = all(recording::open(&files, &station, None).unwrap().as_mut());
    let mut joined = Vec::new();
    for f in files.iter().rev() {
        joined.extend(std::fs::read(f).unwrap());
    }
    let one = dir.path().join("all.mseed");
    std::fs::write(&one, &joined).unwrap();
    assert_eq!(all(recording::open(std::slice::from_ref(&one), &station, None).unwrap().as_mut()), want);
    // Twice the same file: everything overlaps and is used once.
    assert_eq!(all(recording::open(&[one.clone(), one.clone()], &station, None).unwrap().as_mut()), want);
    // Damage in the middle costs one record of one component and nothing else.
    joined[10_000..10_040].fill(0x55);
    joined[8192..8200].fill(0);
    std::fs::write(&one, &joined).unwrap();
    let got = all(recording::open(&[one], &station, None).unwrap().as_mut());
    assert_eq!(got.len(), want.len());
    let differ = got.iter().zip(&want).filter(|(a, b)| a != b).count();
    assert!((1..=1010).contains(&differ), "{differ}");
    assert!(got.iter().zip(&want).all(|(a, b)| a == b || a.1.contains(&MISSING)));
}

#[test]
fn a_missing_component_is_missing_and_bad_input_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let s = scenario(dir.path(), "[[faults]]\nkind = \"missing\"\nchannel = 3");
    let (station, files) = written(dir.path(), &s);
    assert_eq!(files.len(), 3);
    let got = all(recording::open(&files, &station, None).unwrap().as_mut());
    assert!(got.iter().all(|(_, f)| f[3] == MISSING && f[0] != MISSING));
    let error = |files: &[PathBuf], station: &Station| {
        recording::open(files, station, None).map(|_| ()).unwrap_err().to_string()
    };
    let e = error(&files[1..], &station);
    assert!(e.contains("BDH") && e.contains("BH1"), "{e}");
    let mut other = station.clone();
    other.config.rate_hz = 62.5;
    let e = error(&files, &other);
    assert!(e.contains("50") && e.contains("62.5"), "{e}");
    let cut = dir.path().join("cut.mseed");
    std::fs::write(&cut, &std::fs::read(&files[0]).unwrap()[..4000]).unwrap();
    assert!(error(&[cut], &station).contains("BDH"));
}

#[test]
fn a_real_hydrophone_record_reads() {
    let name = "real/hydrophone_mseed_1T_MONN/1T_MONN_00_EDH.mseed";
    let Some(path) = seabearing_testkit::shared_data("a_real_hydrophone_record_reads", name) else { return };
    let text = "[station]\nkind = \"obs\"\n[sampling]\nrate_hz = 125\n[obs]\ncomponents = { pressure = \"EDH\", \
                north = \"EH1\", east = \"EH2\", vertical = \"EHZ\" }\n";
    let station = Station::parse(text, "s.toml", Path::new(".")).unwrap();
    let got = all(recording::open(&[path], &station, None).unwrap().as_mut());
    // The file's own README: Steim-1, 125 Hz, 7501 samples.
    assert_eq!(got.len(), 7501);
    assert_eq!(got.last().unwrap().0, 7500);
    assert!(got.iter().all(|(_, f)| f[0] != MISSING && f[1] == MISSING));
}
