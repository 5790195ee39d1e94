//! `seabearing base send … station`: recorders that come up with a new configuration, hang with it, or have no place for one.
//! They are the recorder's own code over a line of this computer, with a model of their flash.
#![cfg(unix)]

mod recorder;

use recorder::{Line, Noise, Since};
use seabearing::{blob, station::Station};
use seabearing_core::config_blob;
use seabearing_core::keeper::{BuiltIn, Done, Keeper};
use seabearing_core::outlet::Reliable;
use seabearing_core::port::NoBoard;
use seabearing_core::recorder::{Memory, configuration};
use seabearing_core::run::{BLOCK_FRAMES, run_over};
use seabearing_core::slots::Slots;
use seabearing_core::wire::Fault;
use seabearing_core::wire::configure::Configure;
use seabearing_core::wire::guard::{Guard, Recipient};
use seabearing_core::wire::link::flash::{Flash, ModelFlash, Word};
use seabearing_core::wire::link::{Link, MemoryStore, Settings};
use std::cell::RefCell;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::rc::Rc;
use std::sync::mpsc::{self, Receiver, Sender};

const KEY: [u8; 32] = [7; 32];

/// A flash that outlasts a restart.
#[derive(Clone)]
struct Chip(Rc<RefCell<ModelFlash<2, 256>>>);

impl Flash for Chip {
    const SECTORS: u8 = 2;
    const WORDS: u16 = 256;

    fn read(&self, sector: u8, word: u16) -> Option<Word> {
        self.0.borrow().read(sector, word)
    }

    fn write(&mut self, sector: u8, word: u16, value: &Word) {
        self.0.borrow_mut().write(sector, word, value);
    }

    fn erase(&mut self, sector: u8) {
        self.0.borrow_mut().erase(sector);
    }

    fn busy(&self) -> bool {
        self.0.borrow().busy()
    }
}

/// What a recorder is like.
#[derive(Clone, Copy, PartialEq)]
enum Like {
    ComesUp,
    /// The watchdog resets it with what it tries.
    Hangs,
    HasNoSlots,
}

/// Its places for configurations, or none.
enum Places<C> {
    Two(Slots<Chip, C>),
    None(BuiltIn),
}

impl<C: FnMut(&[u8]) -> bool> Keeper for Places<C> {
    fn take(&mut self, order: &Configure) -> Option<Done> {
        match self {
            Self::Two(slots) => slots.take(order),
            Self::None(none) => none.take(order),
        }
    }

    fn work(&mut self, now_s: u32, reached: bool) -> Option<Done> {
        match self {
            Self::Two(slots) => slots.work(now_s, reached),
            Self::None(none) => none.work(now_s, reached),
        }
    }

    fn sampled(&mut self) {
        match self {
            Self::Two(slots) => slots.sampled(),
            Self::None(none) => none.sampled(),
        }
    }

    fn news(&mut self) -> Option<Fault> {
        match self {
            Self::Two(slots) => slots.news(),
            Self::None(none) => none.news(),
        }
    }
}

/// A recorder, start after start; the names of the stations it starts as are told.
fn recorder(stream: TcpStream, built_in: &[u8], like: Like, starts: &Sender<String>) {
    let mut line = Line::over(stream);
    let chip = Chip(Rc::new(RefCell::new(ModelFlash::new())));
    let mut store = MemoryStore::<20_000>::new();
    let mut memory: Box<Memory<'static>> = Box::default();
    let mut clock = Since::now();
    for boot in 1.. {
        let usable = |blob: &[u8]| configuration(blob, 1).is_some();
        let mut slots = Slots::new(chip.clone(), Box::leak(Box::new([0; 4096])), usable);
        let mut found = [0; 4096];
        let running = slots.choose(&mut found);
        let blob = running.map_or(built_in, |running| &found[..running.length]);
        let config = config_blob::station(blob).unwrap();
        if starts.send(config.name.to_string()).is_err() {
            return;
        }
        let mut link = Link::new(Settings::serial(921_600), config.id, boot, config.hash(), store);
        let guard = Guard::keyed(KEY, Recipient { station: config.id, boot });
        let hangs = like == Like::Hangs && running.is_some_and(|running| running.trial);
        let mut samples = Noise::new(config.rate_hz, hangs);
        let places = if like == Like::HasNoSlots { Places::None(BuiltIn) } else { Places::Two(slots) };
        let mut outlet = Reliable::with(&mut line, &mut link, guard, places);
        let mut frames = [[0; 4]; BLOCK_FRAMES];
        let mut recorder = memory.configure(&config, None).unwrap();
        run_over(&mut recorder, &mut samples, &mut outlet, &mut clock, &mut NoBoard, &mut frames);
        if !outlet.restarts() && !hangs {
            return;
        }
        store = link.into_store();
    }
}

/// The demo's station at a lower rate, with this name and number.
fn station(folder: &Path, name: &str, id: u16) -> String {
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/demo-station.toml");
    let text = std::fs::read_to_string(demo).unwrap();
    let changes = [
        ("name = \"east\"", format!("name = \"{name}\"")),
        ("id = 1\n", format!("id = {id}\n")),
        ("rate_hz = 64000", "rate_hz = 8000".to_owned()),
    ];
    let text = changes.iter().fold(text, |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    });
    let file = format!("{name}.toml");
    std::fs::write(folder.join(&file), text).unwrap();
    file
}

/// Sends the station `new` to a recorder that is `old`; what the command said, and the recorder's starts.
fn send(like: Like, id: u16) -> (Output, Receiver<String>) {
    let dir = tempfile::tempdir().unwrap();
    let old = Station::read(&dir.path().join(station(dir.path(), "old", 1))).unwrap();
    let new = station(dir.path(), "new", id);
    let built_in = blob::of(&old).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let line = format!("tcp:{}", listener.local_addr().unwrap());
    std::fs::write(dir.path().join("one.key"), "07".repeat(32)).unwrap();
    let stations = format!("[[stations]]\nid = 1\nline = \"{line}\"\nkey_file = \"one.key\"\n");
    std::fs::write(dir.path().join("stations.toml"), stations).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_seabearing"));
    command.args(["base", "send", "--stations", "stations.toml", "--station", "1", "station", &new]);
    command.current_dir(dir.path()).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let sender = command.spawn().unwrap();
    let (starts, started) = mpsc::channel();
    // It ends with the line or the test.
    let run = move || {
        if let Ok((stream, _)) = listener.accept() {
            recorder(stream, &built_in, like, &starts);
        }
    };
    std::thread::Builder::new().stack_size(16 << 20).spawn(run).unwrap();
    (sender.wait_with_output().unwrap(), started)
}

#[test]
fn a_recorder_starts_again_with_the_new_configuration_and_keeps_it() {
    let (out, starts) = send(Like::ComesUp, 1);
    let said = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success(), "{} {said}", String::from_utf8_lossy(&out.stderr));
    assert_eq!(starts.try_iter().collect::<Vec<_>>(), ["old", "new"]);
    assert!(said.contains("\"type\":\"health\"") && !said.contains("RolledBack"), "{said}");
}

#[test]
fn a_recorder_that_hangs_with_it_goes_back_and_the_command_fails_and_says_why() {
    let (out, starts) = send(Like::Hangs, 1);
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success() && said.contains("gone back") && said.contains("watchdog"), "{said}");
    assert_eq!(starts.try_iter().collect::<Vec<_>>(), ["old", "new", "old"]);
}

#[test]
fn a_recorder_without_places_and_another_stations_file_are_named_in_one_line() {
    for (like, id, words) in
        [(Like::HasNoSlots, 1, "no place for another"), (Like::ComesUp, 2, "keeps its number")]
    {
        let (out, starts) = send(like, id);
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(!out.status.success() && said.contains(words) && said.lines().count() == 1, "{said}");
        assert!(starts.try_iter().all(|name| name == "old"));
    }
}
