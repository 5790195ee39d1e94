//! `seabearing base` and a real broker, mosquitto: everything comes through once and in order whatever is killed, and a broker
//! that is away or refuses is one clear line and holds up nothing. Skipped where there is no mosquitto.
#![cfg(all(unix, feature = "mqtt", feature = "experiments"))]

mod base_process;

use base_process::{Base, hello, kept, of, wait};
use seabearing::reproduce::mosquitto::Mosquitto;
use seabearing_core::wire::{Encoder, End, Message};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn end(index: u64) -> Message {
    Message::End(End { index, frames: 0 })
}

/// A broker in a folder of its own, if there is one on this machine.
fn broker(dir: &Path, more: Option<&str>) -> Option<Mosquitto> {
    let Some(program) = Mosquitto::program() else {
        seabearing_testkit::skipped("base_mqtt", "no mosquitto (Debian: apt-get install mosquitto)");
        return None;
    };
    let folder = dir.join("broker");
    fs::create_dir_all(&folder).unwrap();
    Some(Mosquitto::start(program, &folder, more).unwrap())
}

/// A recorder that has said who it is, and `End`s of these indices.
fn say(base: &Base, station: u16, indices: std::ops::Range<u64>) -> TcpStream {
    let mut stream = base.call();
    let mut encoder = Encoder::default();
    stream.write_all(encoder.frame(&hello(station))).unwrap();
    for index in indices {
        stream.write_all(encoder.frame(&end(index))).unwrap();
    }
    stream
}

/// The records of stations without what differs between a base station and a centre.
fn by_station(folder: &Path) -> BTreeMap<u64, Vec<Value>> {
    let mut found: BTreeMap<u64, Vec<Value>> = BTreeMap::new();
    for record in kept(folder) {
        if let Some(station) = record["station"].as_u64() {
            found.entry(station).or_default().push(record);
        }
    }
    found
}

fn folder(dir: &Path, name: &str) -> std::path::PathBuf {
    let folder = dir.join(name);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Waits until it has said a text on standard error; gives the lines up to it.
fn said(base: &mut Base, text: &str) -> String {
    let mut all = String::new();
    loop {
        let mut line = String::new();
        assert!(base.stderr.read_line(&mut line).unwrap() > 0, "{text}: {all}");
        all += &line;
        if line.contains(text) {
            return all;
        }
    }
}

#[test]
fn every_record_reaches_a_centre_once_and_in_order_whatever_is_killed() {
    let dir = tempfile::tempdir().unwrap();
    let Some(mut broker) = broker(dir.path(), None) else { return };
    let (north, centre) = (folder(dir.path(), "north"), folder(dir.path(), "centre"));
    // A prefix of several levels, with a space, and letters that are not ASCII.
    let url = broker.url("flotte/ärmel kanal");
    let publish = ["--listen", "127.0.0.1:0", "--store", "store", "--mqtt", &url];
    let take = ["--listen", "127.0.0.1:0", "--store", "store", "--from-mqtt", &url];
    let mut central = Base::start(&centre, &take);
    said(&mut central, ": connected");
    let base = Base::start(&north, &publish);
    let _seven = say(&base, 7, 0..200);
    let _eight = say(&base, 8, 0..200);
    wait(&centre, "both stations", |all| of(all, 7, "end") + of(all, 8, "end") == 400);
    // The broker goes away: records wait in the store, and a base station that is killed meanwhile goes on from there.
    broker.stop();
    let _nine = say(&base, 9, 0..300);
    wait(&north, "without a broker", |all| of(all, 9, "end") == 300);
    let words = base.kill();
    assert_eq!(words.matches("it is tried again, records wait in the store").count(), 1, "{words}");
    central.kill();
    broker.again().unwrap();
    let base = Base::start(&north, &publish);
    let central = Base::start(&centre, &take);
    let _ten = say(&base, 10, 0..50);
    wait(&centre, "all", |all| of(all, 9, "end") == 300 && of(all, 10, "end") == 50);
    drop((base, central));
    // Lines go down when their base station is killed, and only the next one tells.
    let (sent, came) = (by_station(&north), by_station(&centre));
    assert_eq!(sent.keys().collect::<Vec<_>>(), came.keys().collect::<Vec<_>>());
    for (station, sent) in &sent {
        let came = &came[station];
        assert_eq!(sent[..came.len().min(sent.len())], came[..], "station {station}");
        assert_eq!(
            came.iter().filter(|r| r["type"] == "end").count(),
            sent.iter().filter(|r| r["type"] == "end").count()
        );
    }
    let check = Command::new(base_process::BINARY)
        .args(["base", "check", "--store", "store"])
        .current_dir(&centre)
        .output();
    let check = check.unwrap();
    assert!(check.status.success(), "{}", String::from_utf8_lossy(&check.stderr));
}

#[test]
fn the_last_state_of_stations_and_of_the_base_station_is_retained() {
    let dir = tempfile::tempdir().unwrap();
    let Some(broker) = broker(dir.path(), None) else { return };
    if Command::new("mosquitto_sub").arg("--help").output().is_err() {
        return seabearing_testkit::skipped("base_mqtt", "no mosquitto_sub (Debian: mosquitto-clients)");
    }
    fs::write(dir.path().join("broker.toml"), format!("url = \"{}\"\nname = \"pier\"\n", broker.url("sea")))
        .unwrap();
    let args = ["--listen", "127.0.0.1:0", "--store", "store", "--mqtt", "broker.toml"];
    let base = Base::start(dir.path(), &args);
    let line = say(&base, 7, 0..3);
    wait(dir.path(), "stored", |all| of(all, 7, "end") == 3);
    let retained = |topic: &str, wanted: &str| {
        let begun = Instant::now();
        loop {
            let mut command = Command::new("mosquitto_sub");
            command.args(["-p", &broker.port.to_string(), "-t", topic, "-C", "1", "-W", "2"]);
            let text = String::from_utf8(command.output().unwrap().stdout).unwrap();
            if text.contains(wanted) {
                return serde_json::from_str::<Value>(&text).unwrap();
            }
            assert!(begun.elapsed() < Duration::from_secs(30), "{topic}: {text}");
        }
    };
    assert_eq!(retained("sea/7/state/line", "\"up\"")["station"], 7);
    assert_eq!(retained("sea/7/state/hello", "rate_hz")["relay"]["base"], "pier");
    retained("sea/bases/pier/state", "\"online\"");
    drop(line);
    retained("sea/7/state/line", "\"down\"");
    base.kill();
    retained("sea/bases/pier/state", "\"offline\"");
}

#[test]
fn a_broker_that_refuses_is_one_clear_line_and_storing_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let users = dir.path().join("users");
    if Command::new("mosquitto_passwd")
        .args(["-b", "-c"])
        .arg(&users)
        .args(["pier", "right"])
        .output()
        .is_err()
    {
        return seabearing_testkit::skipped("base_mqtt", "no mosquitto_passwd (Debian: mosquitto)");
    }
    let list = dir.path().join("list");
    fs::write(&list, "user pier\ntopic write allowed/#\n").unwrap();
    let more = format!("password_file {}\nacl_file {}", users.display(), list.display());
    let Some(broker) = broker(dir.path(), Some(&more)) else { return };
    let url = |prefix: &str| broker.url(prefix).replace("://", "://pier@");
    let start = |name: &str, prefix: &str, password: &str| {
        let folder = folder(dir.path(), name);
        fs::write(folder.join("secret"), password).unwrap();
        let text = format!("url = \"{}\"\npassword_file = \"secret\"\n", url(prefix));
        fs::write(folder.join("broker.toml"), text).unwrap();
        let args = ["--listen", "127.0.0.1:0", "--store", "store", "--mqtt", "broker.toml"];
        (Base::start(&folder, &args), folder)
    };
    for (name, prefix, password, words) in [
        ("wrong", "allowed", "wrong", "the broker"),
        ("forbidden", "forbidden", "right", "the broker refuses records: NotAuthorized"),
    ] {
        let (mut base, folder) = start(name, prefix, password);
        let _line = say(&base, 7, 0..5);
        wait(&folder, "storing goes on", |all| of(all, 7, "end") == 5);
        let line = said(&mut base, "it is tried again");
        let log = || fs::read_to_string(broker.log()).unwrap();
        assert!(
            line.contains(words) && line.contains("records wait in the store"),
            "{name}: {line}\n{}",
            log()
        );
        // Tried again and again, and said once.
        std::thread::sleep(Duration::from_millis(2500));
        let more = base.kill();
        assert!(!more.contains("tried again"), "{more}");
    }
}

/// A certificate authority, a broker's certificate, and another authority, made by OpenSSL.
fn certificates(folder: &Path) -> bool {
    let openssl = |args: &str| {
        let made =
            Command::new("openssl").args(args.split(' ')).current_dir(folder).stderr(Stdio::null()).status();
        made.is_ok_and(|status| status.success())
    };
    fs::write(
        folder.join("names"),
        "subjectAltName=IP:127.0.0.1,DNS:localhost\nextendedKeyUsage=serverAuth,clientAuth\n",
    )
    .unwrap();
    let authority = |name: &str| {
        openssl(&format!(
            "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN={name} -keyout {name}.key -out {name}.crt"
        ))
    };
    authority("ca")
        && authority("other")
        && openssl(
            "req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj /CN=localhost -keyout server.key -out server.csr",
        )
        && openssl(
            "x509 -req -in server.csr -CA ca.crt -CAkey ca.key -CAcreateserial -days 2 -extfile names -out server.crt",
        )
}

#[test]
fn a_broker_is_trusted_by_the_authority_that_was_said_and_by_no_other() {
    let dir = tempfile::tempdir().unwrap();
    if !certificates(dir.path()) {
        return seabearing_testkit::skipped("base_mqtt", "no openssl to make certificates with");
    }
    let at = |name: &str| dir.path().join(name).display().to_string();
    let more = format!(
        "allow_anonymous true\ncafile {}\ncertfile {}\nkeyfile {}\nrequire_certificate true",
        at("ca.crt"),
        at("server.crt"),
        at("server.key")
    );
    let Some(broker) = broker(dir.path(), Some(&more)) else { return };
    let (north, centre) = (folder(dir.path(), "north"), folder(dir.path(), "centre"));
    let file = |folder: &Path, ca: &str| {
        let url = broker.url("sea").replace("mqtt://", "mqtts://");
        let client = "certificate_file = \"../server.crt\"\nkey_file = \"../server.key\"";
        fs::write(folder.join("broker.toml"), format!("url = \"{url}\"\nca_file = \"../{ca}\"\n{client}\n"))
            .unwrap();
    };
    file(&north, "other.crt");
    file(&centre, "ca.crt");
    let publish = ["--listen", "127.0.0.1:0", "--store", "store", "--mqtt", "broker.toml"];
    let mut base = Base::start(&north, &publish);
    let line = said(&mut base, "it is tried again");
    assert!(line.contains("TLS") && line.to_lowercase().contains("certificate"), "{line}");
    base.kill();
    file(&north, "ca.crt");
    let take = ["--listen", "127.0.0.1:0", "--store", "store", "--from-mqtt", "broker.toml"];
    let mut central = Base::start(&centre, &take);
    said(&mut central, ": connected");
    let base = Base::start(&north, &publish);
    let _line = say(&base, 7, 0..20);
    wait(&centre, "over TLS", |all| of(all, 7, "end") == 20);
}

#[test]
fn without_a_store_records_wait_in_memory_and_those_that_do_not_fit_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    let Some(mut broker) = broker(dir.path(), None) else { return };
    let text = format!("url = \"{}\"\nwaiting_records = 10\n", broker.url("sea"));
    fs::write(dir.path().join("broker.toml"), text).unwrap();
    broker.stop();
    let mut base = Base::start(dir.path(), &["--listen", "127.0.0.1:0", "--mqtt", "broker.toml"]);
    let _line = say(&base, 7, 0..100);
    // Shown, and so taken.
    let mut shown = BufReader::new(base.child.0.stdout.take().unwrap());
    let mut line = String::new();
    while !line.contains("\"index\":99") && !line.contains("\"t_s\":0.099") {
        line.clear();
        assert!(shown.read_line(&mut line).unwrap() > 0);
    }
    std::thread::spawn(move || shown.read_to_end(&mut Vec::new()));
    broker.again().unwrap();
    let all = said(&mut base, "records are not published");
    // A hundred, who it is and that its line is up; ten are left.
    assert!(all.contains(": 92 records are not published: no more fit into memory"), "{all}");
}

#[test]
fn a_file_for_a_broker_that_is_not_there_says_so_once_and_fails_with_its_records_shown() {
    let dir = tempfile::tempdir().unwrap();
    let mut encoder = Encoder::default();
    let mut bytes = encoder.frame(&hello(7)).to_vec();
    (0..5).for_each(|index| bytes.extend_from_slice(encoder.frame(&end(index))));
    fs::write(dir.path().join("telemetry.bin"), bytes).unwrap();
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut stores = Command::new(base_process::BINARY);
    stores.args(["base", "--json", "telemetry.bin", "--mqtt", &format!("mqtt://{nobody}")]);
    let out = stores.current_dir(dir.path()).output().unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success(), "{said}");
    let at = |text: &str| said.find(text).unwrap_or_else(|| panic!("{text}: {said}"));
    assert!(at("it is tried again") < at("6 records are not published: they are lost"), "{said}");
    assert_eq!(
        (said.matches("it is tried again").count(), said.matches("not published").count()),
        (1, 1),
        "{said}"
    );
    assert_eq!(String::from_utf8_lossy(&out.stdout).lines().count(), 6);
}
