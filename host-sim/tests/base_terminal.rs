//! `seabearing base` on a terminal: a pseudo-terminal of which this test is the other end.
#![cfg(target_os = "linux")]

mod base_process;

use base_process::{BINARY, Running, hello};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};
use seabearing_core::wire::{Encoder, Fault, FaultCode, Message};
use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// A base station on a terminal.
struct OnTerminal {
    child: Running,
    /// The person's end, and the program's.
    keys: File,
    tty: File,
    bytes: Receiver<Vec<u8>>,
    seen: String,
}

impl OnTerminal {
    /// Starts it in a folder with a terminal of this kind, whose first line it listens at.
    fn start(folder: &Path, term: &str, args: &[&str]) -> Self {
        let keys = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&keys).unwrap();
        unlockpt(&keys).unwrap();
        let name = ptsname(&keys, Vec::new()).unwrap();
        let tty = File::options().read(true).write(true).open(OsStr::from_bytes(name.to_bytes())).unwrap();
        tcsetwinsize(&tty, Winsize { ws_row: 24, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        let end = || Stdio::from(tty.try_clone().unwrap());
        let mut command = Command::new(BINARY);
        command.arg("base").args(args).current_dir(folder).env("TERM", term).env_remove("NO_COLOR");
        let child = Running(command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap());
        let keys = File::from(keys);
        let (mut read, (tell, bytes)) = (keys.try_clone().unwrap(), channel());
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(n @ 1..) = read.read(&mut buffer) {
                if tell.send(buffer[..n].to_vec()).is_err() {
                    return;
                }
            }
        });
        Self { child, keys, tty, bytes, seen: String::new() }
    }

    /// Reads until something has been said, words without spaces: these are left out where a cell is blank already.
    fn until(&mut self, words: &str) {
        let begun = Instant::now();
        while !self.seen.contains(words) {
            assert!(begun.elapsed() < Duration::from_secs(30), "no `{words}`: {:?}", self.seen);
            if let Ok(bytes) = self.bytes.recv_timeout(Duration::from_millis(100)) {
                self.seen += &String::from_utf8_lossy(&bytes);
            }
        }
    }

    fn call(&mut self) -> TcpStream {
        self.until("listening at ");
        self.until("\n");
        let at =
            self.seen.split("listening at ").nth(1).unwrap().split_whitespace().next().unwrap().to_owned();
        TcpStream::connect(at).unwrap()
    }

    /// Whether keys come one by one and are not shown, as the view wants them.
    fn is_raw(&self) -> bool {
        !tcgetattr(&self.tty).unwrap().local_modes.contains(LocalModes::ICANON | LocalModes::ECHO)
    }
}

fn fault(value: i64) -> Message {
    Message::Fault(Fault { index: 10, code: FaultCode::Gap, value })
}

#[test]
fn the_view_is_drawn_and_the_terminal_given_back_after_a_key_and_after_a_signal() {
    let dir = tempfile::tempdir().unwrap();
    for by_key in [true, false] {
        let mut base = OnTerminal::start(dir.path(), "xterm", &["--listen", "127.0.0.1:0"]);
        let mut line = base.call();
        let mut encoder = Encoder::default();
        line.write_all(encoder.frame(&hello(7))).unwrap();
        line.write_all(encoder.frame(&fault(4321))).unwrap();
        base.until("\x1b[?1049h");
        base.until("Gap");
        assert!(base.is_raw());
        // Of another size all is drawn anew.
        base.seen.clear();
        tcsetwinsize(&base.tty, Winsize { ws_row: 30, ws_col: 90, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        let pid = base.child.0.id().to_string();
        assert!(Command::new("kill").args(["-s", "WINCH", &pid]).status().unwrap().success());
        base.until("Gap");
        match by_key {
            true => base.keys.write_all(b"\x03").unwrap(),
            false => assert!(Command::new("kill").args(["-s", "TERM", &pid]).status().unwrap().success()),
        }
        base.until("\x1b[?1049l");
        base.until("seabearing: interrupted");
        base.child.0.wait().unwrap();
        assert!(!base.is_raw(), "by key: {by_key}");
    }
}

#[test]
fn the_end_of_all_input_gives_the_terminal_back_and_says_what_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = OnTerminal::start(dir.path(), "xterm", &["--listen", "127.0.0.1:0", "--once"]);
    let mut line = base.call();
    line.write_all(Encoder::default().frame(&hello(7))).unwrap();
    base.until("recorder");
    drop(line);
    base.until("\x1b[?1049l");
    base.until("station 7");
    assert!(base.child.0.wait().unwrap().success() && !base.is_raw());
}

#[test]
fn a_terminal_that_cannot_be_drawn_on_gets_a_line_an_event_and_no_escapes() {
    let dir = tempfile::tempdir().unwrap();
    let mut base = OnTerminal::start(dir.path(), "dumb", &["--listen", "127.0.0.1:0"]);
    let mut line = base.call();
    let mut encoder = Encoder::default();
    line.write_all(encoder.frame(&hello(7))).unwrap();
    line.write_all(encoder.frame(&fault(99))).unwrap();
    base.until("7 fault Gap 99\r\n");
    assert!(!base.is_raw() && !base.seen.contains('\x1b'), "{:?}", base.seen);
}
