//! What stands in `deploy/` runs: the base station of the systemd unit and of the container serves its page.
#![cfg(all(unix, feature = "page"))]

mod base_process;

use base_process::{BINARY, Running};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};

fn deployed(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy").join(name);
    std::fs::read_to_string(path).unwrap()
}

/// Runs a base station with these arguments, whose folders are here and whose ports are any; what its page answers.
fn page(args: &[&str]) -> String {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path().display().to_string();
    std::fs::write(dir.path().join("stations.toml"), STATIONS).unwrap();
    std::fs::write(dir.path().join("alarms.toml"), "[[alarms]]\nkind = \"silent\"\n").unwrap();
    let ours = |arg: &&str| {
        let arg = arg.replace("/etc/seabearing", &here).replace("/var/lib/seabearing", &here);
        match arg.rsplit_once(':') {
            Some((_, port)) if port.parse::<u16>().is_ok() => "127.0.0.1:0".to_owned(),
            _ => arg,
        }
    };
    let mut command = Command::new(BINARY);
    command.args(args.iter().map(ours)).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = Running(command.spawn().unwrap());
    let mut said = String::new();
    let mut stderr = BufReader::new(child.0.stderr.take().unwrap());
    let at = loop {
        let mut line = String::new();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "{args:?}: {said}");
        said += &line;
        if let Some((_, at)) = line.trim().split_once("page at http://") {
            break at.trim_end_matches('/').to_owned();
        }
    };
    let mut stream = TcpStream::connect(&at).unwrap();
    write!(stream, "GET / HTTP/1.1\r\nHost: {at}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

const STATIONS: &str = "[[stations]]\nid = 1\nline = \"listen:127.0.0.1:0\"\nposition = { lat_deg = 49.0, lon_deg = -123.0, depth_m = 9.0 }\n";

#[test]
fn the_service_and_the_container_serve_the_page() {
    let unit = deployed("seabearing-base.service").replace("\\\n", " ");
    let exec = unit.lines().find_map(|l| l.strip_prefix("ExecStart=/usr/local/bin/seabearing ")).unwrap();
    assert!(page(&exec.split_whitespace().collect::<Vec<_>>()).contains("<title>seabearing</title>"));
    let file = deployed("Containerfile");
    let list = |name: &str| {
        let line = file.lines().find_map(|l| l.strip_prefix(name)).unwrap();
        serde_json::from_str::<Vec<String>>(line).unwrap()
    };
    let all = [list("ENTRYPOINT "), list("CMD ")].concat();
    let args: Vec<&str> = all.iter().skip(1).map(String::as_str).collect();
    assert!(page(&args).contains("<title>seabearing</title>"));
    let features = file.split("--features ").nth(1).and_then(|rest| rest.split_whitespace().next()).unwrap();
    assert!(features.split(',').any(|f| f == "page"), "{features}");
    let port = all.iter().find_map(|a| a.strip_prefix("0.0.0.0:")).unwrap();
    let exposed = file.lines().find_map(|l| l.strip_prefix("EXPOSE ")).unwrap();
    assert!(exposed.split(' ').any(|p| p == port), "{exposed}");
}
