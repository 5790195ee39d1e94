//! Links within the project: files that exist, headings that exist, chapters that are in the book.

use crate::text::{Document, documents, root};

/// Targets of the links in a text, each with its line.
fn targets(document: &Document) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (i, line) in document.prose().lines().enumerate() {
        // Code within the line is no link.
        let visible: String =
            line.split('`').enumerate().map(|(k, part)| if k % 2 == 0 { part } else { "" }).collect();
        for after in visible.split("](").skip(1) {
            let target = after.split(')').next().unwrap_or_default();
            found.push((i + 1, target.to_owned()));
        }
    }
    found
}

/// The anchors of a page: what its headings are called in a link.
fn anchors(text: &str) -> Vec<String> {
    let page = Document { name: String::new(), text: text.to_owned() };
    let (prose, mut found) = (page.prose(), Vec::<String>::new());
    for heading in prose.lines().filter(|l| l.starts_with('#')) {
        let shown = heading.trim_start_matches('#').trim().to_lowercase();
        let kept = shown.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        let anchor: String = kept.map(|c| if c == ' ' { '-' } else { c }).collect();
        let before = found.iter().filter(|f| **f == anchor).count();
        found.push(if before == 0 { anchor } else { format!("{anchor}-{before}") });
    }
    found
}

/// What is wrong with a link of a page, if anything.
fn wrong(page: &str, target: &str) -> Option<String> {
    let (path, anchor) = target.split_once('#').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
    let folder = std::path::Path::new(page).parent().unwrap();
    let path = if path.is_empty() { root().join(page) } else { root().join(folder).join(path) };
    let Ok(found) = path.canonicalize() else { return Some("no such file".into()) };
    if page.starts_with("docs/") && !found.starts_with(root().join("docs")) {
        return Some("outside the book".into());
    }
    let anchor = anchor?;
    let text = std::fs::read_to_string(found).unwrap_or_default();
    (!anchors(&text).iter().any(|a| a == anchor)).then(|| "no such heading".into())
}

#[test]
fn every_link_leads_somewhere() {
    let mut pages = documents();
    for name in ["CHANGELOG.md", "core/README.md", "wire/README.md"] {
        pages.push(Document { name: name.into(), text: std::fs::read_to_string(root().join(name)).unwrap() });
    }
    let (mut wrongs, mut seen) = (Vec::new(), 0);
    for page in pages {
        for (line, target) in targets(&page) {
            if target.starts_with("https://") || target.starts_with("http://") {
                continue;
            }
            seen += 1;
            wrongs.extend(
                wrong(&page.name, &target).map(|said| format!("{}:{line}: {target}: {said}", page.name)),
            );
        }
    }
    assert!(wrongs.is_empty(), "{wrongs:#?}");
    assert!(seen > 150, "only {seen} found");
}

#[test]
fn every_chapter_is_in_the_book_once() {
    let pages = documents();
    let summary = pages.iter().find(|d| d.name == "docs/SUMMARY.md").unwrap();
    let mut listed: Vec<String> = targets(summary).into_iter().map(|(_, t)| format!("docs/{t}")).collect();
    listed.push("docs/SUMMARY.md".into());
    listed.sort();
    let there: Vec<&str> = pages.iter().map(|d| &*d.name).filter(|n| n.starts_with("docs/")).collect();
    assert_eq!(listed, there);
}

#[test]
fn a_link_that_leads_nowhere_is_noticed() {
    assert_eq!(wrong("README.md", "docs/firmware.md#boards"), None);
    assert_eq!(wrong("docs/deploy.md", "firmware.md"), None);
    for (page, target) in [
        ("README.md", "docs/nowhere.md"),
        ("README.md", "docs/firmware.md#bords"),
        ("docs/wire.md", "../README.md"),
    ] {
        assert!(wrong(page, target).is_some(), "{target}");
    }
    assert_eq!(
        anchors("# A `key`, or two\n```\n# none\n```\n## B-c\n## B-c"),
        ["a-key-or-two", "b-c", "b-c-1"]
    );
}
