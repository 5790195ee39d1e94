//! Bad recordings: one clear line that names file and remedy; everything valid before and after is kept.

use seabearing::recording;
use seabearing::recording::write::{Encoding, wav};
use seabearing::recording::{Asked, Recording, Span};
use seabearing::station::Station;
use seabearing_core::block::{Frame, MISSING};
use std::path::{Path, PathBuf};
use time::macros::datetime;

const STATION: &str = "[station]\nid = 1\nkind = \"array\"\n[sampling]\nrate_hz = 16000\n[array]\nhydrophones_m = \
    [[0.0,1.06,-0.38],[0.92,-0.53,-0.38],[-0.92,-0.53,-0.38],[0.0,0.0,1.13]]\n";

fn station() -> Station {
    Station::parse(STATION, "station.toml", Path::new(".")).unwrap()
}

fn ramp(from: i32, n: i32) -> impl Iterator<Item = Frame> {
    (from..from + n).map(|i| [i, i + 1, i + 2, i + 3])
}

fn good(folder: &Path, name: &str, from: i32, n: i32) -> PathBuf {
    let path = folder.join(name);
    wav(&path, 16_000, Encoding::Int24, ramp(from, n)).unwrap();
    path
}

/// Everything a list of files gives, as (index, frame).
fn read(paths: &[PathBuf]) -> anyhow::Result<Vec<(u64, Frame)>> {
    let mut source = recording::open(paths, &station(), None)?;
    let mut all = Vec::new();
    while let Some(block) = source.next_block()? {
        all.extend((block.first_index..).zip(block.frames.iter().copied()));
    }
    Ok(all)
}

fn complaint(path: PathBuf) -> String {
    let text = format!("{:#}", read(&[path]).unwrap_err());
    assert_eq!(text.lines().count(), 1, "{text}");
    text
}

/// A WAV of any channels and rate, by hand.
fn foreign(folder: &Path, name: &str, channels: u16, rate: u32) -> PathBuf {
    let path = folder.join(name);
    let data = vec![0u8; 3 * usize::from(channels) * 100];
    let mut bytes = b"RIFF\0\0\0\0WAVEfmt \x10\0\0\0\x01\0".to_vec();
    bytes.extend_from_slice(&channels.to_le_bytes());
    bytes.extend_from_slice(&rate.to_le_bytes());
    bytes.extend_from_slice(&(rate * u32::from(channels) * 3).to_le_bytes());
    bytes.extend_from_slice(&(channels * 3).to_le_bytes());
    bytes.extend_from_slice(&24u16.to_le_bytes());
    bytes.extend_from_slice(b"data");
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&data);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn each_complaint_names_the_file_and_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    for (path, name, what) in [
        (dir.path().join("absent.wav"), "absent.wav", "cannot read"),
        (file("empty.wav", b""), "empty.wav", "empty file"),
        (file("text.wav", b"these are notes of a cruise, no sound"), "text.wav", "not a recording"),
        (file("header.wav", b"RIFF\x24\0\0\0WAVEfmt \x10\0\0\0"), "header.wav", "header"),
        (file("flac.flac", b"fLaC\0\0\0\x22 not really"), "flac.flac", "header"),
        (foreign(dir.path(), "two.wav", 2, 16_000), "two.wav", "2 channels"),
        (foreign(dir.path(), "slow.wav", 4, 8000), "slow.wav", "rate_hz"),
        (good(dir.path(), "nothing.wav", 0, 0), "nothing.wav", "no samples"),
    ] {
        let text = complaint(path);
        assert!(text.contains(name) && text.contains(what), "{text}");
    }
    let folder = dir.path().join("folder");
    std::fs::create_dir(&folder).unwrap();
    assert!(complaint(folder).contains("no recording"));
}

#[test]
fn good_files_among_bad_ones_are_used() {
    let dir = tempfile::tempdir().unwrap();
    let bad = dir.path().join("b.wav");
    std::fs::write(&bad, b"no sound").unwrap();
    let files = [
        good(dir.path(), "a.wav", 0, 5000),
        bad,
        foreign(dir.path(), "c.wav", 3, 16_000),
        good(dir.path(), "d.wav", 5000, 700),
    ];
    let want: Vec<_> = (0u64..).zip(ramp(0, 5700)).collect();
    assert_eq!(read(&files).unwrap(), want);
}

#[test]
fn a_truncated_file_gives_what_is_whole_and_the_next_keeps_its_place() {
    let dir = tempfile::tempdir().unwrap();
    let first = good(dir.path(), "a.wav", 0, 5000);
    let second = good(dir.path(), "b.wav", 5000, 1000);
    let bytes = std::fs::read(&first).unwrap();
    // 1000 frames and a bit are gone.
    std::fs::write(&first, &bytes[..bytes.len() - 12_000 - 5]).unwrap();
    let got = read(&[first, second]).unwrap();
    let want: Vec<_> = (0u64..).zip(ramp(0, 3999)).chain((5000u64..).zip(ramp(5000, 1000))).collect();
    assert_eq!(got, want);
}

#[test]
fn nan_and_infinity_become_missing_samples() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("nan.wav");
    wav(&path, 16_000, Encoding::Float, [[1, MISSING, 3, -4], [5, 6, 7, 8]].into_iter()).unwrap();
    assert_eq!(read(&[path]).unwrap(), [(0, [1, MISSING, 3, -4]), (1, [5, 6, 7, 8])]);
}

#[test]
fn times_in_names_make_gaps_and_overlaps_and_small_clock_drift_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let starts = |names: &[&str]| -> Vec<u64> {
        let files: Vec<PathBuf> =
            names.iter().enumerate().map(|(i, n)| good(dir.path(), n, i as i32 * 100_000, 16_000)).collect();
        let all = read(&files).unwrap();
        (0..names.len()).map(|i| all.iter().find(|(_, f)| f[0] == i as i32 * 100_000).unwrap().0).collect()
    };
    let names = ["s_20240501T000000.000Z.wav", "s_20240501T000001.000Z.wav", "s_20240501T000004.500Z.wav"];
    assert_eq!(starts(&names), [0, 16_000, 72_000]);
    // Half a second early: an overlap for the core to notice. Whole seconds only: no gap below a second.
    let names = ["o_20240501T000000.000Z.wav", "o_20240501T000000.500Z.wav"];
    assert_eq!(starts(&names), [0, 8000]);
    let names = ["w_20240501_000000.wav", "w_20240501_000002.wav", "w_20240501_000005.wav"];
    assert_eq!(starts(&names), [0, 16_000, 80_000]);
    let names = ["d_20240501T000000.00000Z.wav", "d_20240501T000001.00004Z.wav"];
    assert_eq!(starts(&names), [0, 16_000]);
}

#[test]
fn a_sidecar_overrules_the_name_and_a_wrong_one_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = good(dir.path(), "x_20240501T000000Z.wav", 0, 100);
    std::fs::write(dir.path().join("x_20240501T000000Z.wav.start"), "2024-05-02T01:02:03.5Z\n").unwrap();
    let source = recording::open(std::slice::from_ref(&path), &station(), None).unwrap();
    assert_eq!(source.start().unwrap().to_string(), "2024-05-02 1:02:03.5 +00:00:00");
    std::fs::write(dir.path().join("x_20240501T000000Z.wav.start"), "yesterday").unwrap();
    assert!(complaint(path).contains(".start: not a time"));
}

/// A WAV of one channel, 24 bits, 16 kHz.
fn mono(path: &Path, codes: impl Iterator<Item = i32>) {
    let data: Vec<u8> = codes.flat_map(|x| x.to_le_bytes()[..3].to_vec()).collect();
    let mut bytes =
        b"RIFF\0\0\0\0WAVEfmt \x10\0\0\0\x01\0\x01\0\x80\x3e\0\0\x80\xbb\0\0\x03\0\x18\0data".to_vec();
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&data);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn frames(source: &mut dyn recording::BlockSource) -> Vec<(u64, Frame)> {
    let mut all = Vec::new();
    while let Some(block) = source.next_block().unwrap() {
        all.extend((block.first_index..).zip(block.frames.iter().copied()));
    }
    all
}

#[test]
fn one_file_per_channel_is_one_recording() {
    let dir = tempfile::tempdir().unwrap();
    let want: Vec<_> = (0u64..).zip(ramp(0, 1400)).collect();
    // Two moments, a folder for each channel, and a copy of nothing: the second time is not a copy of the first.
    for c in 0..4 {
        for (second, from) in [("00", 0), ("01", 16_000)] {
            let name = format!("stamped/{c}/unit_20240501T0000{second}Z.wav");
            mono(&dir.path().join(name), (from..from + 16_000).map(|i| i + c));
        }
        mono(&dir.path().join(format!("named/dive3_ch{}.wav", c + 8)), (0..1400).map(|i| i + c));
    }
    let got = read(&[dir.path().join("stamped")]).unwrap();
    assert!(got == (0u64..).zip(ramp(0, 32_000)).collect::<Vec<_>>());
    assert_eq!(read(&[dir.path().join("named")]).unwrap(), want);
    // One of them shorter: as much as all have. One of them missing: said, with the file.
    mono(&dir.path().join("named/dive3_ch9.wav"), (0..1000).map(|i| i + 1));
    assert_eq!(read(&[dir.path().join("named")]).unwrap(), want[..1000]);
    std::fs::remove_file(dir.path().join("named/dive3_ch9.wav")).unwrap();
    let text = complaint(dir.path().join("named"));
    assert!(text.contains("dive3_ch8.wav: 1 channels (and 2 in files of the same time)"), "{text}");
}

#[test]
fn of_more_channels_the_station_file_chooses_four() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("six.wav");
    let data: Vec<u8> = (0..500_i32)
        .flat_map(|i| (0..6).flat_map(move |c| (10 * i + c).to_le_bytes()[..3].to_vec()))
        .collect();
    let mut bytes = std::fs::read(foreign(dir.path(), "six.wav", 6, 16_000)).unwrap();
    bytes.truncate(40);
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&data);
    std::fs::write(&path, bytes).unwrap();
    let text = complaint(path.clone());
    assert!(text.contains("six.wav: 6 channels") && text.contains("`channels = "), "{text}");
    let station = |c: &str| Station::parse(&format!("{STATION}channels = {c}\n"), "s.toml", Path::new("."));
    let read = |s: &Station| frames(&mut *recording::open(std::slice::from_ref(&path), s, None).unwrap());
    let got = read(&station("[5, 0, 2, 3]").unwrap());
    assert!(got.into_iter().eq((0u64..500).zip((0..500).map(|i| [
        10 * i + 5,
        10 * i,
        10 * i + 2,
        10 * i + 3
    ]))));
    // A recorder's own channels are sorted by the recorder.
    let own = station("[1, 0, 2, 3]").unwrap();
    assert_eq!(read(&own)[1].1, [10, 11, 12, 13]);
    let twice = station("[5, 0, 5, 3]").unwrap_err().to_string();
    assert!(twice.contains("channels") && twice.contains("line 8"), "{twice}");
}

#[test]
fn folders_are_searched_and_a_span_of_time_is_cut_out_to_the_sample() {
    let dir = tempfile::tempdir().unwrap();
    for (i, name) in ["2024/05/a_20240501_100000.wav", "2024/05/a_20240501_100001", "b_20240501_100004.wav"]
        .iter()
        .enumerate()
    {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        wav(&path, 16_000, Encoding::Int24, ramp(16_000 * i as i32, 16_000)).unwrap();
    }
    std::fs::write(dir.path().join("notes.txt"), "calm").unwrap();
    std::fs::write(dir.path().join("2024/.a_20240501_100000.wav"), "hidden").unwrap();
    let all = read(&[dir.path().to_owned()]).unwrap();
    assert_eq!((all.len(), all.last().unwrap().0), (48_000, 79_999));
    // The names are two hours ahead of UTC.
    let asked = |from, to| Asked {
        span: Span { from, to },
        name_offset: Some(time::UtcOffset::from_hms(2, 0, 0).unwrap()),
        ..Asked::default()
    };
    let find = |asked: &Asked| Recording::find(&[dir.path().to_owned()], &station(), asked);
    let whole = find(&asked(None, None)).unwrap();
    assert!(whole.days().unwrap().into_iter().eq([time::macros::date!(2024 - 05 - 01)]));
    let span = Span {
        from: Some(datetime!(2024-05-01 08:00:00.5 UTC)),
        to: Some(datetime!(2024-05-01 08:00:04.25 UTC)),
    };
    let mut source = find(&asked(span.from, span.to)).unwrap().source(span).unwrap();
    assert_eq!(source.start(), span.from);
    let got = frames(&mut *source);
    let want: Vec<_> =
        all.iter().filter(|a| (8000..68_000).contains(&a.0)).map(|(i, f)| (i - 8000, *f)).collect();
    assert!(got == want, "{} {}", got.len(), want.len());
    // The same through the files' own places, late in the second file.
    let late = Span { from: Some(datetime!(2024-05-01 08:00:01.75 UTC)), to: None };
    let got = frames(&mut *whole.source(late).unwrap());
    assert!(got.iter().map(|g| g.1).eq(all.iter().filter(|a| a.0 >= 28_000).map(|a| a.1)));
    let after = Span { from: Some(datetime!(2024-05-02 00:00 UTC)), to: None };
    let none = whole.source(after).map(|_| ()).unwrap_err().to_string();
    assert_eq!(none, "nothing was recorded from 2024-05-02T00:00:00Z on");
}
