//! Code within lines: subcommands, options, experiments, tasks and files that are named exist.

use crate::text::{documents, root};
use clap::{Command, CommandFactory};

/// Options of others: of cargo.
const OF_CARGO: [&str; 5] = ["--features", "--no-default-features", "--bench", "--path", "--release"];

/// The whole command.
pub fn command() -> Command {
    let mut command = seabearing::cmd::Cli::command();
    command.build();
    command
}

fn takes(command: &Command, option: &str) -> bool {
    command.get_arguments().any(|a| a.get_long() == option.strip_prefix("--"))
}

fn anywhere(command: &Command, option: &str) -> bool {
    takes(command, option) || command.get_subcommands().any(|c| anywhere(c, option))
}

/// Bytes of a signature (`docs/wire.md`), and no command.
const OF_SIGNATURES: &str = "seabearing command";

/// What stands for something else: dots, and names in capitals.
pub fn stands_for(word: &str) -> bool {
    let stem = word.split(['.', ':', '/']).next().unwrap_or_default();
    let capitals = stem.chars().all(|c| c.is_ascii_uppercase() || "-_".contains(c));
    word == "..." || word == "|" || (capitals && !stem.is_empty())
}

/// `--name` of a word, without brackets, a value, or a comma.
fn option(word: &str) -> Option<&str> {
    let word = word.trim_matches(['[', ']', ',']);
    let word = word.split_once('=').map_or(word, |(name, _)| name);
    (word.starts_with("--") && word.len() > 2).then_some(word)
}

/// What is wrong with words that follow `seabearing`.
pub fn wrong(words: &[&str]) -> Option<String> {
    let whole = command();
    let mut at = &whole;
    for (i, word) in words.iter().enumerate() {
        if let Some(below) = at.find_subcommand(word) {
            at = below;
        } else if let Some(option) = option(word) {
            if !takes(at, option) {
                return Some(format!("`{}` has no {option}", at.get_name()));
            }
        } else if i == 0 && !stands_for(word) {
            return Some(format!("no subcommand `{word}`"));
        }
    }
    let named = words.iter().skip(1).take_while(|w| option(w).is_none()).filter(|w| !stands_for(w));
    let known =
        |name: &str| name == "all" || seabearing::reproduce::EXPERIMENTS.iter().any(|e| e.name == name);
    let mut unknown = named.filter(|n| words.first() == Some(&"reproduce") && !known(n));
    unknown.next().map(|name| format!("no experiment `{name}`"))
}

/// What is wrong with words that follow `cargo`.
pub fn wrong_for_cargo(words: &[&str]) -> Option<String> {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).unwrap_or_default();
    if let Some((&"xtask", words)) = words.split_first() {
        let main = read("xtask/src/main.rs");
        let help = main.split("HELP: &str").nth(1).unwrap().split("\n\";").next().unwrap();
        let task = words.first()?;
        let of = help.lines().filter(|l| l.trim_start().split(' ').next() == Some(task)).collect::<String>();
        let unknown =
            words.iter().filter_map(|w| option(w)).find(|o| !of.contains(o) && !["--host-only"].contains(o));
        return if of.is_empty() {
            Some(format!("no task `{task}`"))
        } else {
            unknown.map(|o| format!("no {o}"))
        };
    }
    let after = |flag: &str| words.iter().skip_while(|w| **w != flag).nth(1);
    let package = |name: &str| {
        let folders = std::fs::read_dir(root()).unwrap().flatten();
        let mut manifests = folders.map(|f| read(&format!("{}/Cargo.toml", f.file_name().display())));
        manifests.any(|m| m.lines().any(|l| l == format!("name = \"{name}\"")))
    };
    if let Some(name) = after("-p").filter(|n| !package(n)) {
        return Some(format!("no package {name}"));
    }
    after("--path")
        .filter(|p| read(&format!("{p}/Cargo.toml")).is_empty())
        .map(|p| format!("no package in {p}"))
}

#[test]
fn subcommands_options_experiments_and_tasks_that_documents_name_exist() {
    let (whole, mut wrongs, mut seen) = (command(), Vec::new(), 0);
    let xtask = std::fs::read_to_string(root().join("xtask/src/main.rs")).unwrap();
    for document in documents() {
        for (line, code) in document.code() {
            let words: Vec<&str> = code.split(' ').collect();
            let said = match words.split_first() {
                _ if code == OF_SIGNATURES => None,
                Some((&"seabearing", rest)) => wrong(rest),
                Some((&"cargo", rest)) => wrong_for_cargo(rest),
                Some((first, [second, ..])) if *first == "reproduce" || option(second).is_some() => {
                    if whole.find_subcommand(first).is_none() {
                        continue;
                    }
                    wrong(&words)
                }
                Some((first, _)) if *first == "..." || option(first).is_some() => {
                    let known = |o: &&str| anywhere(&whole, o) || OF_CARGO.contains(o) || xtask.contains(*o);
                    words
                        .iter()
                        .filter_map(|w| option(w))
                        .find(|o| !known(o))
                        .map(|o| format!("nothing takes {o}"))
                }
                _ => continue,
            };
            seen += 1;
            wrongs.extend(said.map(|said| format!("{}:{line}: `{code}`: {said}", document.name)));
        }
    }
    assert!(wrongs.is_empty(), "{wrongs:#?}");
    assert!(seen > 200, "only {seen} found");
}

#[test]
fn files_of_the_project_that_documents_name_exist() {
    let mut wrongs = Vec::new();
    for document in documents() {
        for (line, code) in document.code() {
            let path = code.trim_end_matches('/');
            let first = path.split('/').next().unwrap_or_default();
            let plain = path.chars().all(|c| c.is_ascii_alphanumeric() || "/_-.".contains(c));
            let of_here =
                path.contains('/') && !["", "target", "out"].contains(&first) && root().join(first).is_dir();
            if plain && of_here && !code.contains("TARGET") && !root().join(path).exists() {
                wrongs.push(format!("{}:{line}: `{code}`", document.name));
            }
        }
    }
    assert!(wrongs.is_empty(), "{wrongs:#?}");
}

#[test]
fn what_does_not_exist_is_noticed() {
    let words = |line: &'static str| line.split(' ').collect::<Vec<_>>();
    assert_eq!(wrong(&words("base send --stations s.toml --station 7 snippet --channels 0")), None);
    for line in [
        "proces a.wav",
        "process --stations a.toml",
        "base send --page 1",
        "reproduce sea-week",
        "base --all",
    ] {
        assert!(wrong(&words(line)).is_some(), "{line}");
    }
    for line in
        ["xtask demon", "xtask demo --three", "test -p seabearing-hosts", "install --path host-simulator"]
    {
        assert!(wrong_for_cargo(&words(line)).is_some(), "{line}");
    }
}
