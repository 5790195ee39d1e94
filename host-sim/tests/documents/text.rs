//! Documents and what stands in them: blocks of code, code within a line, prose.

use std::path::{Path, PathBuf};

/// A page in Markdown.
pub struct Document {
    /// From the folder of the project.
    pub name: String,
    pub text: String,
}

/// A fenced block.
pub struct Block {
    /// Of its first line, from 1.
    pub line: usize,
    pub language: String,
    pub text: String,
}

/// The folder of the project.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// README and the chapters.
pub fn documents() -> Vec<Document> {
    let chapters = |folder: &'static str| {
        let entries = std::fs::read_dir(root().join(folder)).unwrap();
        entries.map(move |e| format!("{folder}/{}", e.unwrap().file_name().into_string().unwrap()))
    };
    let mut names: Vec<String> = chapters("docs").chain(chapters("docs/notebooks")).collect();
    names.retain(|name| name.ends_with(".md"));
    names.push("README.md".into());
    names.sort();
    names
        .into_iter()
        .map(|name| Document { text: std::fs::read_to_string(root().join(&name)).unwrap(), name })
        .collect()
}

impl Document {
    pub fn blocks(&self) -> Vec<Block> {
        let (mut blocks, mut open): (Vec<Block>, _) = (Vec::new(), None);
        for (i, line) in self.text.lines().enumerate() {
            match (line.trim_start().strip_prefix("```"), &mut open) {
                (Some(language), None) => {
                    open = Some(Block { line: i + 2, language: language.to_owned(), text: String::new() });
                }
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (None, Some(block)) => block.text += &format!("{line}\n"),
                (None, None) => {}
            }
        }
        assert!(open.is_none(), "{}: a block without end", self.name);
        blocks
    }

    /// Its lines, those of blocks empty.
    pub fn prose(&self) -> String {
        let mut within = false;
        let lines = self.text.lines().map(|line| {
            let fence = line.trim_start().starts_with("```");
            within ^= fence;
            if within || fence { "" } else { line }
        });
        lines.collect::<Vec<_>>().join("\n")
    }

    /// Code within lines, each with its line, blanks made single.
    pub fn code(&self) -> Vec<(usize, String)> {
        let (mut found, mut line, mut open): (_, usize, Option<String>) = (Vec::new(), 1, None);
        let prose = self.prose().replace("\\|", "|");
        let mut rest = prose.chars().peekable();
        while let Some(c) = rest.next() {
            line += usize::from(c == '\n');
            match (&mut open, c) {
                (Some(_), '`') => {
                    let code = open.take().unwrap_or_default();
                    found.push((line, code.split_whitespace().collect::<Vec<_>>().join(" ")));
                }
                (None, '`') => open = Some(String::new()),
                // Nothing goes over the end of a paragraph.
                (Some(code), '\n') if rest.peek() == Some(&'\n') => panic!("{}:{line}: `{code}", self.name),
                (Some(code), c) => code.push(c),
                (None, _) => {}
            }
        }
        found
    }
}
