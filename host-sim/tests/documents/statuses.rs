//! Exit statuses: help, manual page and the chapter say the same, and the command does it.

use crate::examples::seabearing;
use crate::text::root;

/// What a text lists, each status with the first words of its meaning.
fn statuses(text: &str) -> Vec<String> {
    let known = ["0", "1", "2", "3", "128 + n"];
    let lines = text.lines().map(|l| l.trim_start_matches(['|', ' ']));
    let listed = lines.filter_map(|l| {
        let of = known.iter().find(|of| {
            l.strip_prefix(**of).is_some_and(|rest| rest.starts_with("  ") || rest.starts_with(" |"))
        })?;
        let meaning = l[of.len()..].trim_start_matches([' ', '|']);
        Some(format!("{of}: {}", meaning.split([' ', ';', ',']).take(3).collect::<Vec<_>>().join(" ")))
    });
    listed.collect()
}

#[test]
fn exit_statuses_are_those_of_the_documents() {
    let dir = tempfile::tempdir().unwrap();
    let help = String::from_utf8(seabearing(&["--help"], dir.path()).stdout).unwrap();
    let (_, told) = help.split_once("Exit status:").unwrap();
    let chapter = std::fs::read_to_string(root().join("docs/command.md")).unwrap();
    assert_eq!(statuses(told).len(), 5, "{told}");
    assert_eq!(statuses(told), statuses(&chapter));
    assert!(seabearing(&["man", "."], dir.path()).status.success());
    let page = std::fs::read_to_string(dir.path().join("seabearing.1")).unwrap();
    assert_eq!(statuses(page.split_once("Exit status:").unwrap().1).len(), 5, "{page}");

    let runs: [(&[&str], i32); 5] = [
        (&["--version"], 0),
        (&["config", "check", "nowhere.toml"], 1),
        (&["config", "check", "--nonsense"], 2),
        (&["nonsense"], 2),
        // Three runs a point are too few to keep within a tenth of the bound.
        (&["reproduce", "motion-fig3", "--runs", "3"], 3),
    ];
    for (words, status) in runs {
        assert_eq!(seabearing(words, dir.path()).status.code(), Some(status), "{words:?}");
    }
}
