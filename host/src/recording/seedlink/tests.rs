//! The client against a server that disturbs.

use super::line::Patience;
use super::*;
use miniseed_rs::{ByteOrder, EncodingFormat, MseedRecord, Samples, encode};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::thread::JoinHandle;
use std::time::Duration;

const RATE_HZ: f64 = 50.0;
/// Samples of a record.
const LENGTH: usize = 75;
const CODES: [&str; 4] = ["BDH", "BH1", "BH2", "BHZ"];
/// 2013-05-21T01:02:03Z.
const BEGINS_S: i64 = 1_369_098_123;

/// What component c was at index n.
fn sample(c: usize, n: usize) -> i32 {
    (1000 * (c as i32 + 1) + n as i32) * if n.is_multiple_of(2) { 1 } else { -1 }
}

/// The kth record of component c.
fn record(c: usize, k: usize) -> Vec<u8> {
    let at = OffsetDateTime::from_unix_timestamp(BEGINS_S).unwrap()
        + time::Duration::seconds_f64((k * LENGTH) as f64 / RATE_HZ);
    let mut r = MseedRecord::new()
        .with_nslc("YV", "RR03", "00", CODES[c])
        .with_start_time(mseed_record::nano_time(at))
        .with_sample_rate(RATE_HZ)
        .with_encoding(EncodingFormat::Steim2)
        .with_record_length(512)
        .with_samples(Samples::Int((0..LENGTH).map(|n| sample(c, k * LENGTH + n)).collect()));
    r.byte_order = ByteOrder::Big;
    encode(&r).unwrap()
}

fn packet(number: usize, c: usize, k: usize) -> Vec<u8> {
    let mut out = format!("SL{number:06X}").into_bytes();
    out.extend(record(c, k));
    assert_eq!(out.len(), 520);
    out
}

/// A server: each connection gets what stands in its turn, after the conversation; what was asked for is returned. `None`
/// at the end of a turn keeps the line open and silent until the client gives up.
fn serve(turns: Vec<(Vec<u8>, bool)>) -> (u16, JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let thread = std::thread::spawn(move || {
        let mut asked = Vec::new();
        for (bytes, silent) in turns {
            let (stream, _) = listener.accept().unwrap();
            asked.push(converse(&stream, ""));
            let mut stream = stream;
            // The client may be gone already.
            let _ = stream.write_all(&bytes);
            if silent {
                let _ = stream.read(&mut [0; 1]);
            }
        }
        asked
    });
    (port, thread)
}

/// Answers commands until `END`, refusing what begins with `refused`; what was asked for as data.
fn converse(stream: &TcpStream, refused: &str) -> String {
    let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
    let mut out = stream;
    let mut data = String::new();
    while let Some(Ok(line)) = lines.next() {
        let answer: &[u8] = match line.as_str() {
            "END" => break,
            "HELLO" => b"SeedLink v3.1 (2020.075) :: SLPROTO:3.1 CAP\r\nTest server\r\n",
            _ if !refused.is_empty() && line.starts_with(refused) => b"ERROR\r\n",
            _ => b"OK\r\n",
        };
        if line.starts_with("DATA") || line.starts_with("TIME") {
            data = line;
        }
        out.write_all(answer).unwrap();
    }
    data
}

fn remote(port: u16) -> Remote {
    Remote {
        address: Address::parse(Path::new(&format!("seedlink://127.0.0.1:{port}/YV_RR03"))).unwrap(),
        codes: CODES.map(str::to_owned),
        gains: [1.0; 4],
        location: "00".into(),
        rate_hz: RATE_HZ,
    }
}

fn quick() -> Patience {
    let ms = Duration::from_millis;
    Patience { answer: ms(20_000), silence: ms(1500), pause: ms(10), longest_pause: ms(40) }
}

/// Rounds of records of all components, numbered on.
fn rounds(number: &mut usize, rounds: std::ops::Range<usize>) -> Vec<u8> {
    let mut out = Vec::new();
    for k in rounds {
        for c in 0..4 {
            out.extend(packet(*number, c, k));
            *number += 1;
        }
    }
    out
}

fn all(live: &mut Live) -> Vec<(u64, Vec<Frame>)> {
    let mut out: Vec<(u64, Vec<Frame>)> = Vec::new();
    while let Some(block) = live.next_block().unwrap() {
        match out.last_mut() {
            Some((first, frames)) if *first + frames.len() as u64 == block.first_index => {
                frames.extend_from_slice(block.frames);
            }
            _ => out.push((block.first_index, block.frames.to_vec())),
        }
    }
    out
}

#[test]
fn whatever_the_line_does_every_sample_comes_once_and_gaps_are_gaps() {
    let mut number = 0;
    // Broken within a record.
    let mut first = rounds(&mut number, 0..3);
    first.extend(&packet(number, 0, 3)[..200]);
    // What came already comes again; then what is no packet.
    let mut again = number - 4;
    let mut second = rounds(&mut again, 2..3);
    second.extend(rounds(&mut number, 3..5));
    second.extend(b"HTTP/1.1 500 oh dear");
    // Two rounds are lost for good, one record is damaged; then silence.
    let mut third = rounds(&mut number, 7..8);
    let mut damaged = packet(number, 1, 8);
    damaged[8 + 46] = 0xff;
    third.extend(packet(number, 0, 8));
    third.extend(damaged);
    third.extend(packet(number + 2, 2, 8));
    third.extend(packet(number + 3, 3, 8));
    number += 4;
    let mut fourth = rounds(&mut number, 9..10);
    fourth.extend(b"END");
    let (port, server) = serve(vec![(first, false), (second, false), (third, true), (fourth, false)]);
    let mut live = remote(port).open_with(Span::default(), quick()).unwrap();
    assert_eq!(live.start().unwrap().unix_timestamp(), BEGINS_S);
    let got = all(&mut live);
    assert_eq!(server.join().unwrap(), ["DATA", "DATA 00000C", "DATA 000014", "DATA 00001C"]);
    let spans: Vec<(u64, usize)> = got.iter().map(|(first, frames)| (*first, frames.len())).collect();
    assert_eq!(spans, [(0, 5 * LENGTH), (7 * LENGTH as u64, 3 * LENGTH)], "rounds 5 and 6 are a gap");
    for (first, frames) in &got {
        for (n, frame) in (*first as usize..).zip(frames) {
            for (c, x) in frame.iter().enumerate() {
                let lost = c == 1 && n / LENGTH == 8;
                let want = if lost { seabearing_core::block::MISSING } else { sample(c, n) };
                assert_eq!(*x, want, "{c} {n}");
            }
        }
    }
    assert_eq!(live.damaged, 1);
}

#[test]
fn a_span_is_asked_for() {
    let (port, server) = serve(vec![([rounds(&mut 0, 0..1), b"END".to_vec()].concat(), false)]);
    let at = |s: i64| OffsetDateTime::from_unix_timestamp(s).ok();
    let span = Span { from: at(BEGINS_S), to: at(BEGINS_S + 60) };
    let mut live = remote(port).open_with(span, quick()).unwrap();
    assert_eq!(all(&mut live).len(), 1);
    assert_eq!(server.join().unwrap(), ["TIME 2013,05,21,01,02,03 2013,05,21,01,03,03"]);
}

#[test]
fn what_cannot_be_is_one_line_at_once() {
    let refused = |refused: &'static str| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = std::thread::spawn(move || converse(&listener.accept().unwrap().0, refused));
        let error = format!("{:#}", remote(port).open_with(Span::default(), quick()).err().unwrap());
        server.join().unwrap();
        error
    };
    assert!(refused("STATION").contains("the server has no such station"), "{}", refused("STATION"));
    assert!(refused("SELECT 00BH2").contains("no component 00BH2.D"), "{}", refused("SELECT 00BH2"));
    // Something else listens; nothing does.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let server = std::thread::spawn(move || {
        let _ = listener.accept().unwrap().0.write_all(b"220 mail ready\r\n");
    });
    let error = format!("{:#}", remote(port).open_with(Span::default(), quick()).err().unwrap());
    assert!(error.contains("no SeedLink server, it says \"220 mail ready\""), "{error}");
    server.join().unwrap();
    let error = format!("{:#}", remote(port).open_with(Span::default(), quick()).err().unwrap());
    assert!(error.starts_with(&format!("seedlink://127.0.0.1:{port}/YV_RR03: ")), "{error}");
    assert!(!error.contains('\n'));
}

#[test]
fn addresses_are_told_apart() {
    let read = |text: &str| Address::parse(Path::new(text)).map(|a| a.to_string()).ok();
    assert_eq!(read("seedlink://h/YV_RR03").unwrap(), "seedlink://h:18000/YV_RR03");
    assert_eq!(read("seedlink://h.example:1800/YV.RR03").unwrap(), "seedlink://h.example:1800/YV_RR03");
    assert_eq!(Address::parse(Path::new("seedlink://[::1]:18/A_B")).unwrap().host, "::1");
    for wrong in
        ["seedlink://h", "seedlink:///YV_RR03", "seedlink://h:x/YV_RR03", "seedlink://h/YVX_RR03", "x"]
    {
        assert_eq!(read(wrong), None, "{wrong}");
    }
    let array = "[station]\nid = 1\nkind = \"array\"\n[sampling]\nrate_hz = 64000\n[array]\nhydrophones_m = \
        [[0.0,1.06,-0.38],[0.92,-0.53,-0.38],[-0.92,-0.53,-0.38],[0.0,0.0,1.13]]\n";
    let array = Station::parse(array, "s", Path::new(".")).unwrap();
    let refused = Remote::of(Path::new("seedlink://h/YV_RR03"), &array).err().unwrap();
    assert!(refused.to_string().contains("is an array"), "{refused}");
    assert!(Address::is_one(Path::new("seedlink://x")) && !Address::is_one(Path::new("x.mseed")));
}

#[test]
fn a_component_that_stays_away_is_waited_for_and_then_missing() {
    let mut aligner = Aligner::new(RATE_HZ, 200);
    let mut frames = Vec::new();
    let at = |n: i64| i128::from(n) * 20_000_000;
    for k in 0..4 {
        for c in 0..3 {
            aligner.take(c, at(50 * k), vec![7; 50]);
        }
        assert_eq!(aligner.block(&mut frames, false), None, "the fourth may come");
    }
    aligner.take(0, at(200), vec![7; 50]);
    assert_eq!((aligner.block(&mut frames, false), frames.len()), (Some(0), 50));
    assert_eq!(frames[49], [7, 7, 7, seabearing_core::block::MISSING]);
    // What comes later than that is not used, what follows is.
    aligner.take(3, at(0), vec![8; 100]);
    assert_eq!((aligner.block(&mut frames, false), frames.len()), (Some(50), 50));
    assert_eq!(frames[0], [7, 7, 7, 8]);
    assert_eq!((aligner.block(&mut frames, true), frames.len()), (Some(100), 150));
    assert_eq!(
        frames[149],
        [
            7,
            seabearing_core::block::MISSING,
            seabearing_core::block::MISSING,
            seabearing_core::block::MISSING
        ]
    );
}
