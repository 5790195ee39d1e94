//! miniSEED: what the simulator writes is what is read back, faults included; bad input is named; a real file reads.

use seabearing::ocean_bottom::scenario::ObsScenario;
use seabearing::ocean_bottom::simulate::Simulator;
use seabearing::ocean_bottom::write::write;
use seabearing::propagation::{Propagation, bottom::Bottom, file, profile::SpeedProfile, trace};
use seabearing::recording::{self, Asked, BlockSource, Recording, Span};
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

/// The samples of a station's miniSEED files as SAC files, version 6.
fn as_sac(folder: &Path, start: time::OffsetDateTime, all: &[(u64, Frame)], big: bool) -> Vec<PathBuf> {
    ["BDH", "BH1", "BH2", "BHZ"]
        .iter()
        .enumerate()
        .map(|(c, code)| {
            let mut words = [(-12345i32).cast_unsigned(); 158];
            words[..70].fill((-12345f32).to_bits());
            let (first, last) = (all[0].0, all[all.len() - 1].0);
            assert_eq!(last - first + 1, all.len() as u64);
            words[0] = 0.02f32.to_bits();
            words[5] = (first as f32 / 50.0).to_bits();
            let at = [start.year(), start.ordinal().into(), start.hour().into(), start.minute().into()];
            for (word, value) in
                (70..).zip(at.into_iter().chain([start.second().into(), start.millisecond().into(), 6]))
            {
                words[if word == 76 { 76 } else { word }] = value.cast_unsigned();
            }
            for (word, value) in [(79, all.len() as u32), (85, 1), (105, 1)] {
                words[word] = value;
            }
            let order = |w: u32| if big { w.to_be_bytes() } else { w.to_le_bytes() };
            let mut bytes: Vec<u8> = words.iter().flat_map(|w| order(*w)).collect();
            bytes[440..].fill(b' ');
            bytes[440..443].copy_from_slice(b"S01");
            bytes[600..603].copy_from_slice(code.as_bytes());
            bytes[608..610].copy_from_slice(b"XX");
            bytes.extend(all.iter().flat_map(|(_, f)| order((f[c] as f32).to_bits())));
            let path = folder.join(format!("{code}.{big}.sac"));
            std::fs::write(&path, bytes).unwrap();
            path
        })
        .collect()
}

#[test]
fn sac_files_give_what_miniseed_gives() {
    let dir = tempfile::tempdir().unwrap();
    let (station, files) = written(dir.path(), &scenario(dir.path(), ""));
    let mut source = recording::open(&files, &station, None).unwrap();
    let start = source.start().unwrap();
    let want: Vec<_> = all(source.as_mut()).into_iter().take(20_000).collect();
    // 24-bit codes are whole 32-bit floating-point numbers.
    assert!(want.iter().all(|(_, f)| f.iter().all(|x| x.abs() < 1 << 24)));
    for big in [false, true] {
        let sac = as_sac(dir.path(), start, &want, big);
        let mut source = recording::open(&sac, &station, None).unwrap();
        assert_eq!(source.start(), Some(start));
        assert!(all(source.as_mut()) == want);
    }
    let volts = dir.path().join("BDH.false.sac");
    let mut bytes = std::fs::read(&volts).unwrap();
    bytes[632..]
        .as_chunks_mut::<4>()
        .0
        .iter_mut()
        .for_each(|b| *b = (f32::from_le_bytes(*b) * 1e-9).to_le_bytes());
    std::fs::write(&volts, bytes).unwrap();
    let error = recording::open(&[volts], &station, None).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("BDH"), "{error}");
}

#[test]
fn of_an_archive_the_named_station_and_the_days_asked_for_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let (mut station, files) = written(dir.path(), &scenario(dir.path(), ""));
    let want = all(recording::open(&files, &station, None).unwrap().as_mut());
    let day = recording::open(&files, &station, None).unwrap().start().unwrap().date();
    // As SDS has it: YEAR/NET/STA/CHAN.D/NET.STA.LOC.CHAN.D.YEAR.DAY, no ending in the name; beside it other stations'.
    let archive = dir.path().join("sds");
    for (station, shift) in [("OTHER", 1u8), ("S01", 0)] {
        for path in &files {
            let mut bytes = std::fs::read(path).unwrap();
            let code = String::from_utf8_lossy(&bytes[15..18]).into_owned();
            for record in bytes.chunks_mut(4096) {
                record[8..13].copy_from_slice(format!("{station:5}").as_bytes());
                let last = record.len() - 1;
                record[last] ^= shift;
            }
            let folder = archive.join(format!("{}/XX/{station}/{code}.D", day.year()));
            std::fs::create_dir_all(&folder).unwrap();
            let name = format!("XX.{station}..{code}.D.{}.{:03}", day.year(), day.ordinal());
            std::fs::write(folder.join(name), bytes).unwrap();
        }
    }
    let find =
        |station: &Station, asked: &Asked| Recording::find(std::slice::from_ref(&archive), station, asked);
    let several = find(&station, &Asked::default()).map(|_| ()).unwrap_err().to_string();
    assert!(several.contains("several stations") && several.contains("seed_id"), "{several}");
    station.seed_id = Some("XX.S01".into());
    assert!(
        all(find(&station, &Asked::default()).unwrap().source(Span::default()).unwrap().as_mut()) == want
    );
    let midnight = (day.next_day().unwrap().next_day().unwrap()).midnight().assume_utc();
    let later = Asked { span: Span { from: Some(midnight), to: None }, ..Asked::default() };
    let none = find(&station, &later).map(|_| ()).unwrap_err().to_string();
    assert!(none.contains("no recording from"), "{none}");
    station.seed_id = Some("XX.S0".into());
    let none = find(&station, &Asked::default()).map(|_| ()).unwrap_err().to_string();
    assert!(none.contains("no recording"), "{none}");
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
