//! Commands that documents show, run as they stand in a shell, in the order of the page, in a folder with the files they name.

use crate::text::{Document, documents};
use crate::{examples, mentions, sds};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// What becomes of a command that is not run to its end.
enum Otherwise {
    /// It waits for recorders until it is stopped, and says for what.
    Waits(&'static str),
    /// What it needs is not here. Its arguments are taken, and it says what it lacks.
    Lacks(&'static str),
    /// It would take too long. Its arguments are taken.
    Parsed,
}

use Otherwise::{Lacks, Parsed, Waits};

/// Commands that are not run to their end, and why.
const OTHERWISE: [(&str, Otherwise, &str); 15] = [
    ("seabearing base --serial /dev/ttyACM0 --store out/base", Waits("/dev/ttyACM0"), "needs a device"),
    ("seabearing base --serial /dev/ttyACM0", Waits("/dev/ttyACM0"), "needs a device"),
    (
        "seabearing base --listen 0.0.0.0:4500 --store out/base --page 127.0.0.1:8080",
        Waits("http://127.0.0.1:"),
        "waits for recorders",
    ),
    (
        "seabearing base --stations stations.toml --store out/network --alarms alarms.toml --page 127.0.0.1:8080",
        Waits("http://127.0.0.1:"),
        "waits for recorders",
    ),
    (
        "seabearing base --listen 0.0.0.0:4500 --store out/north --mqtt mqtt://127.0.0.1:1883/seabearing/north",
        Waits("records to mqtt://127.0.0.1:1883"),
        "waits for recorders",
    ),
    (
        "seabearing base --from-mqtt mqtt://127.0.0.1:1883/seabearing/north --stations stations.toml --store out/centre",
        Waits("records from mqtt://127.0.0.1:1883"),
        "waits for a broker",
    ),
    (
        "seabearing base send --stations stations.toml --station 7 station my-station.toml",
        Lacks("stations.toml"),
        "needs a recorder: `base_configure` has one",
    ),
    (
        "seabearing base send --stations stations.toml --station 7 station new.toml",
        Lacks("stations.toml"),
        "needs a recorder: `base_configure` has one",
    ),
    (
        "seabearing base send --stations stations.toml --station 7 stop",
        Lacks("stations.toml"),
        "needs a recorder: `base_station` has one",
    ),
    (
        "seabearing propagation --ray-table rays.csv --depth-m 4340 --out rr03.toml",
        Lacks("rays.csv"),
        "needs a table of rays that another program traced",
    ),
    (
        "seabearing propagation fit --station station.toml --tracks truth.csv --out fitted.toml *.mseed",
        Lacks("station.toml"),
        "needs days of passages",
    ),
    (
        "seabearing orient --station obs.toml --track a.csv --track b.csv records.jsonl",
        Lacks("obs.toml"),
        "needs hours of passages: `orient_ocean_bottom` has them",
    ),
    (
        "seabearing orient --geometry --station array.toml --track ship.csv --write mended.toml pass.wav",
        Lacks("array.toml"),
        "needs a pass past an array: `orient_compact` has one",
    ),
    (
        "seabearing process --station rr03.toml seedlink://server.example:18000/YV_RR03",
        Lacks("rr03.toml"),
        "needs a server",
    ),
    (
        "seabearing twin --board stm32h743 --station scenarios/demo-station.toml --rehearse 0.1 --seconds 60",
        Parsed,
        "needs an image of the firmware",
    ),
];

/// A line in a shell in which the command is found.
fn shell(line: &str, folder: &Path) -> Output {
    let binaries = Path::new(env!("CARGO_BIN_EXE_seabearing")).parent().unwrap();
    let path = format!("{}:{}", binaries.display(), std::env::var("PATH").unwrap_or_default());
    let mut command = Command::new("sh");
    command.args(["-c", line]).current_dir(folder).stdin(Stdio::null());
    command.env("PATH", path).env("COLUMNS", "400").env("SLURM_ARRAY_TASK_ID", "1").output().unwrap()
}

/// The words of a command line behind `seabearing`, as a shell gives them to it.
fn words(line: &str, folder: &Path) -> Vec<String> {
    let said = shell(&format!("seabearing() {{ printf '%s\\n' \"$@\"; }}\n{line}"), folder);
    String::from_utf8(said.stdout).unwrap().lines().map(str::to_owned).collect()
}

/// The first block in a language of a chapter.
fn block(pages: &[Document], name: &str, language: &str) -> String {
    let page = pages.iter().find(|d| d.name == name).unwrap();
    page.blocks().into_iter().find(|b| b.language == language).unwrap().text
}

/// The files that the documents name.
fn folder(pages: &[Document]) -> tempfile::TempDir {
    let dir = examples::folder();
    let at = |name: &str| dir.path().join(name);
    let copy = |from: &str, to: &str| {
        std::fs::copy(at(from), at(to)).unwrap();
    };
    for entry in std::fs::read_dir(crate::text::root().join("scenarios")).unwrap().flatten() {
        let to = at("scenarios").join(entry.file_name());
        if !to.exists() {
            std::fs::copy(entry.path(), to).unwrap();
        }
    }
    copy("east.toml", "my-station.toml");
    copy("east.toml", "new.toml");
    copy("recording.wav", "tone.wav");
    let west =
        std::fs::read_to_string(at("east.toml")).unwrap().replace("id = 1", "id = 2").replace("east", "west");
    std::fs::write(at("west.toml"), west).unwrap();
    std::fs::write(at("west-station.toml"), std::fs::read(at("west.toml")).unwrap()).unwrap();
    std::fs::create_dir(at("archive")).unwrap();
    copy("recording.wav", "archive/20240501T090000Z.wav");
    std::fs::write(at("stations.toml"), block(pages, "docs/base-station.md", "toml")).unwrap();
    std::fs::write(at("west.key"), "07".repeat(32)).unwrap();
    std::fs::write(at("alarms.toml"), block(pages, "docs/alarms.md", "toml")).unwrap();
    std::fs::write(at("line.toml"), block(pages, "docs/orientation.md", "toml")).unwrap();
    line_pass(dir.path());
    let deep = tempfile::tempdir().unwrap();
    sds::archive(deep.path(), "RR03");
    sds::metadata(deep.path(), "RR03");
    for (from, to) in [("sds", "sds"), ("network.xml", "network.xml"), ("t.toml", "table.toml")] {
        copy_all(&deep.path().join(from), &at(to));
    }
    dir
}

/// Twenty seconds of a vessel that radiates tones, as the line of the documents hears it (`line.wav`), and the vessel's track.
fn line_pass(folder: &Path) {
    const RATE_HZ: u32 = 2048;
    const SENSORS: u16 = 23;
    let place = |t_s: f64| [60.0 + 20.0 * t_s, 300.0 - 5.0 * t_s];
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut codes = Vec::new();
    for n in 0..20 * RATE_HZ {
        let t_s = f64::from(n) / f64::from(RATE_HZ);
        let [x, y] = place(t_s);
        let delay_s = 0.75 * (x.atan2(y) + 0.6).cos() / 1484.0;
        for sensor in 0..SENSORS {
            let at_s = t_s + delay_s * f64::from(sensor);
            let tones = [444.0, 666.0, 702.0].map(|f: f64| (std::f64::consts::TAU * f * at_s).cos());
            let noise: f64 = rng.random_range(-3.0..3.0);
            codes.extend(((3000.0 * (tones.iter().sum::<f64>() + noise)) as i16).to_le_bytes());
        }
    }
    let frame = 2 * SENSORS;
    let mut wav = Vec::new();
    let size = codes.len() as u32;
    wav.extend(b"RIFF");
    wav.extend((36 + size).to_le_bytes());
    wav.extend(b"WAVEfmt ");
    wav.extend(16u32.to_le_bytes());
    wav.extend([1, SENSORS].map(u16::to_le_bytes).concat());
    wav.extend([RATE_HZ, RATE_HZ * u32::from(frame)].map(u32::to_le_bytes).concat());
    wav.extend([frame, 16].map(u16::to_le_bytes).concat());
    wav.extend(b"data");
    wav.extend(size.to_le_bytes());
    wav.extend(codes);
    std::fs::write(folder.join("line.wav"), wav).unwrap();
    let rows = [-20.0, 0.0, 20.0, 40.0].map(|t_s| {
        let [x, y] = place(t_s);
        format!("{t_s},{x},{y}\n")
    });
    std::fs::write(folder.join("ship.csv"), format!("t_s,x_m,y_m\n{}", rows.concat())).unwrap();
}

/// Copies a file, or a folder with what is in it.
fn copy_all(from: &Path, to: &Path) {
    if !from.is_dir() {
        std::fs::copy(from, to).unwrap();
        return;
    }
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        copy_all(&entry.path(), &to.join(entry.file_name()));
    }
}

/// What must be printed, in the order of a session: `…` stands for anything.
fn agrees(said: &str, shown: &str) -> bool {
    let mut parts = shown.split('…');
    let Some(mut rest) = parts.next().and_then(|first| said.strip_prefix(first)) else { return false };
    for part in parts {
        let Some((_, after)) = rest.split_once(part) else { return false };
        rest = after;
    }
    rest.trim().is_empty() || shown.trim_end().ends_with('…')
}

/// A command of a document: where it stands, what is typed, and what a session shows after it.
struct Shown {
    place: String,
    line: String,
    printed: Option<String>,
}

/// The commands of a page's blocks, and after them those within its lines that are whole: without `...`, with files.
fn shown(page: &Document) -> Vec<Shown> {
    let mut found: Vec<Shown> = Vec::new();
    for block in page.blocks() {
        let session = block.language == "console";
        if !session && !["sh", "bash"].contains(&&*block.language) {
            let typed = block.text.lines().any(|l| l.starts_with("seabearing ") || l.starts_with("cargo "));
            assert!(!typed, "{}:{}: commands in a block of {:?}", page.name, block.line, block.language);
            continue;
        }
        let mut going_on = false;
        for (i, text) in block.text.lines().enumerate() {
            let place = format!("{}:{}", page.name, block.line + i);
            let typed = if session { text.strip_prefix("$ ") } else { Some(text) };
            match (typed, found.last_mut()) {
                (None, Some(last)) => *last.printed.get_or_insert_default() += &format!("{text}\n"),
                (Some(text), Some(last)) if going_on => last.line += text.trim_start(),
                (Some(text), _) if !text.trim_start().starts_with('#') && !text.trim().is_empty() => {
                    found.push(Shown { place, line: text.to_owned(), printed: None });
                }
                _ => {}
            }
            going_on = found.last_mut().is_some_and(|last| {
                let cut = last.line.strip_suffix('\\').map(str::to_owned);
                cut.map(|cut| last.line = cut).is_some()
            });
        }
    }
    for shown in &mut found {
        let remark = shown.line.find(" #").unwrap_or(shown.line.len());
        shown.line = shown.line[..remark].trim_end().to_owned();
    }
    for (line, code) in page.code() {
        let words: Vec<&str> = code.split(' ').collect();
        let named = words.iter().any(|w| w.contains(['.', '/']));
        if words.first() == Some(&"seabearing") && named && !words.iter().any(|w| mentions::stands_for(w)) {
            found.push(Shown { place: format!("{}:{line}", page.name), line: code, printed: None });
        }
    }
    found
}

#[test]
fn every_command_of_the_documents_does_what_they_say() {
    let pages = documents();
    let prepared = folder(&pages);
    let mut wrongs = Vec::new();
    let (mut otherwise, mut ran, mut cargo) = (BTreeSet::new(), 0, 0);
    for page in &pages {
        let commands = shown(page);
        if commands.is_empty() {
            continue;
        }
        let dir = tempfile::tempdir().unwrap();
        copy_all(prepared.path(), dir.path());
        // What a page makes it makes itself.
        std::fs::remove_dir_all(dir.path().join("out")).unwrap();
        for Shown { place, line, printed } in commands {
            if let Some(rest) = line.strip_prefix("cargo ") {
                // Builds, tests and hardware: minutes each. The task and its options exist.
                let said = mentions::wrong_for_cargo(&rest.split_whitespace().collect::<Vec<_>>());
                wrongs.extend(said.map(|said| format!("{place}: {line}: {said}")));
                cargo += 1;
                continue;
            }
            assert!(line.starts_with("seabearing "), "{place}: {line}: what is that?");
            if let Some((listed, how, _)) = OTHERWISE.iter().find(|(listed, ..)| *listed == line) {
                otherwise.insert(*listed);
                wrongs.extend(not_run(&line, how, dir.path()).map(|said| format!("{place}: {line}: {said}")));
                continue;
            }
            let out = shell(&line, dir.path());
            ran += 1;
            let said =
                String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
            let right =
                printed.as_ref().map_or(out.status.success(), |p| agrees(&said, p) && !out.status.success());
            if !right {
                wrongs.push(format!("{place}: {line}: {} {said}", out.status));
            }
            let words: Vec<&str> = line.split_whitespace().collect();
            let made = words
                .windows(2)
                .filter(|w| ["--out", "--plots", "--telemetry", "--store", ">"].contains(&w[0]));
            let missing =
                made.map(|w| w[1]).find(|name| printed.is_none() && !dir.path().join(name).exists());
            wrongs.extend(missing.map(|name| format!("{place}: {line}: made no {name}")));
        }
    }
    println!("{ran} run, {} otherwise, {cargo} of cargo", otherwise.len());
    assert!(wrongs.is_empty(), "{wrongs:#?}");
    let gone: Vec<_> = OTHERWISE.iter().map(|o| o.0).filter(|listed| !otherwise.contains(listed)).collect();
    assert!(gone.is_empty(), "listed here, and in no document: {gone:#?}");
}

/// What is wrong with a command that is not run to its end.
fn not_run(line: &str, how: &Otherwise, folder: &Path) -> Option<String> {
    let words = words(line, folder);
    let parsed = mentions::command()
        .try_get_matches_from(["seabearing"].into_iter().chain(words.iter().map(|w| &**w)));
    if let Err(error) = parsed {
        return Some(error.to_string());
    }
    match how {
        Parsed => {}
        Waits(what) => {
            // The ports are any free ones.
            let free = |text: &str| text.replace(":4500", ":0").replace(":8080", ":0");
            let words: Vec<String> = words.iter().map(|w| free(w)).collect();
            let stations = folder.join("stations.toml");
            std::fs::write(&stations, free(&std::fs::read_to_string(&stations).unwrap())).unwrap();
            examples::waits(&words, folder, what);
        }
        Lacks(what) => {
            let out = shell(line, tempfile::tempdir().unwrap().path());
            let said = String::from_utf8_lossy(&out.stderr).into_owned();
            return (out.status.code() != Some(1) || !said.contains(what)).then_some(said);
        }
    }
    None
}

#[test]
fn a_session_is_compared_with_what_is_printed() {
    assert!(
        agrees("a b c\n", "a … c\n") && agrees("no file x: why\n", "no file x: …\n") && agrees("a\n", "a\n")
    );
    assert!(!agrees("a b d\n", "a … c\n") && !agrees("b\n", "a\n") && !agrees("a\nb\n", "a\n"));
}
