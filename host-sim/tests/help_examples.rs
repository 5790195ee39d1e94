//! Every example that `--help` shows, run as it stands.

mod examples;

use examples::{folder, seabearing, waits, words};

/// What an example must come to.
#[derive(Debug, PartialEq)]
enum Expected {
    /// It runs to its end.
    Runs,
    /// Its arguments are taken; what it needs is not here (a device, an emulator, or files that other tests make).
    Lacks(&'static str),
    /// It waits for recorders until it is stopped, and says for what.
    Waits(&'static str),
}

use Expected::{Lacks, Runs, Waits};

/// Subcommands, and what becomes of each example, in the order of the help.
const EXAMPLES: [(&str, &[Expected]); 33] = [
    ("simulate", &[Runs, Runs]),
    ("process", &[Runs, Runs, Runs, Runs, Runs]),
    ("bearing", &[Runs]),
    ("track", &[Runs, Runs, Runs, Runs]),
    ("shaft-rate", &[Runs]),
    ("calls", &[Lacks("station.toml")]),
    ("ships", &[Lacks("obs.toml"), Lacks("obs.toml"), Lacks("obs.toml")]),
    ("far", &[Lacks("obs.toml"), Runs]),
    ("levels", &[Runs, Runs]),
    // What these give from whole networks and passages is in `network_cli` and `orient_ocean_bottom`.
    (
        "locate",
        &[
            Lacks("network.toml"),
            Lacks("network.toml"),
            Lacks("network.toml"),
            Lacks("network.toml"),
            Lacks("network.toml"),
        ],
    ),
    (
        "orient",
        &[
            Lacks("line.toml"),
            Lacks("line.toml"),
            Lacks("array.toml"),
            Lacks("array.toml"),
            Lacks("array.toml"),
            Lacks("obs.toml"),
            Lacks("obs.toml"),
            Lacks("obs.toml"),
        ],
    ),
    ("twin", &[Lacks("out/station.toml"), Lacks("out/station.toml"), Lacks("out/station.toml")]),
    (
        "base",
        &[
            Runs,
            Waits("/dev/ttyACM0"),
            Waits("127.0.0.1:"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Waits("records to mqtt://127.0.0.1:1883"),
            Lacks("stations.toml"),
            Runs,
        ],
    ),
    (
        "base send",
        &[
            Lacks("east.key"),
            Lacks("east.key"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
            Lacks("stations.toml"),
        ],
    ),
    ("export", &[Runs, Runs, Runs, Runs]),
    ("demo", &[]),
    ("blob", &[Runs, Runs]),
    ("card", &[]),
    ("card prepare", &[Runs, Lacks("east.toml")]),
    ("card check", &[Runs]),
    ("reproduce", &[Runs]),
    ("propagation", &[Lacks("rays.csv"), Runs]),
    ("propagation fit", &[Lacks("station.toml")]),
    ("schema", &[Runs, Runs, Runs]),
    ("station", &[]),
    ("station import", &[Lacks("network.xml"), Lacks("network.xml")]),
    ("completions", &[Runs]),
    ("man", &[Runs]),
    ("config", &[]),
    ("config check", &[Runs, Runs, Runs, Lacks("network.toml")]),
    ("plan", &[Runs, Runs]),
    ("ais speeds", &[Runs]),
    ("ais match", &[Lacks("stations.toml"), Lacks("stations.toml")]),
];

/// The command lines that a help text shows, without remarks and what a shell would do.
fn examples(help: &str) -> Vec<String> {
    let lines = help.lines().map(str::trim).filter(|l| l.starts_with("seabearing ") && !l.contains('<'));
    lines
        .map(|l| l.split([' ', '\t']).take_while(|w| !["#", "|", ">"].contains(w)))
        .map(|w| w.collect::<Vec<_>>().join(" "))
        .collect()
}

#[test]
fn every_example_of_the_help_does_what_it_says() {
    let dir = folder();
    for (subcommand, expected) in EXAMPLES {
        let asked: Vec<&str> = subcommand.split(' ').chain(["--help"]).collect();
        let help = seabearing(&asked, dir.path());
        assert!(help.status.success(), "{subcommand}: {}", String::from_utf8_lossy(&help.stderr));
        let shown = examples(&String::from_utf8_lossy(&help.stdout));
        assert_eq!(shown.len(), expected.len(), "{subcommand}: {shown:#?}");
        for (line, expected) in shown.iter().zip(expected) {
            if let Waits(what) = expected {
                // The port is any free one.
                waits(
                    &words(&line.replace(":4500", ":0"), dir.path()),
                    tempfile::tempdir().unwrap().path(),
                    what,
                );
                continue;
            }
            let words = words(line, dir.path());
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            let out = match expected {
                Runs => seabearing(&words, dir.path()),
                Lacks(_) | Waits(_) => seabearing(&words, tempfile::tempdir().unwrap().path()),
            };
            let said = String::from_utf8_lossy(&out.stderr);
            match expected {
                Runs => assert!(out.status.success(), "{line}: {said}"),
                // 2 would be a mistake in the arguments.
                Lacks(what) | Waits(what) => {
                    assert!(
                        out.status.code() == Some(1) && said.contains(what),
                        "{line}: {:?} {said}",
                        out.status
                    );
                }
            }
        }
    }
    let whole = clap::Command::new("seabearing");
    left_out(&<::seabearing::cmd::Subcommand as clap::Subcommand>::augment_subcommands(whole), "");
}

/// No subcommand is left out, at any depth; only those without examples that have others below them.
fn left_out(command: &clap::Command, path: &str) {
    for below in command.get_subcommands() {
        let path = format!("{path}{}{}", if path.is_empty() { "" } else { " " }, below.get_name());
        let shown = below.get_after_help().is_some_and(|text| text.to_string().contains("seabearing "));
        let needed = shown || (command.get_name() == "seabearing" && !below.has_subcommands());
        assert!(!needed || EXAMPLES.iter().any(|(name, _)| *name == path), "{path}");
        left_out(below, &path);
    }
}
