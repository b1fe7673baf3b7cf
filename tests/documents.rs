//! Checks the documents as a reader sees them as files: each begins with a title, each
//! reference has a target in its own file, relative links exist, and code names its language.
//! Together they have less than 18,250 words.
//! rustdoc replaces the targets of the guide's links, so `links.md` needs all of them.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use pulldown_cmark::{
    BrokenLink, CodeBlockKind, CowStr, Event, HeadingLevel, Options, Parser, Tag, TagEnd,
};

/// Folders without documents of this repository.
const NO_DOCUMENTS: [&str; 3] = ["target", ".git", "pictures"];

fn documents(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !NO_DOCUMENTS.contains(&name) {
            documents(&path, found);
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
}

/// What a document has and lacks.
#[derive(Default)]
struct Document {
    anchors: BTreeSet<String>,
    links: Vec<String>,
    defects: Vec<String>,
    /// Number of words in sentences and tables, without code.
    words: usize,
}

/// Returns the anchor of a heading, as forges make it.
fn anchor(heading: &str) -> String {
    let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
    heading.to_lowercase().chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn read(text: &str) -> Document {
    let mut document = Document::default();
    let mut undefined = Vec::new();
    let mut note = |link: BrokenLink<'_>| {
        undefined.push(format!("no target for [{}]", link.reference));
        None::<(CowStr<'_>, CowStr<'_>)>
    };
    let (mut heading, mut is_code) = (None::<String>, false);
    let parser = Parser::new_with_broken_link_callback(text, Options::all(), Some(&mut note));
    for (number, event) in parser.enumerate() {
        let is_title = matches!(event, Event::Start(Tag::Heading { level: HeadingLevel::H1, .. }));
        if number == 0 && !is_title {
            document.defects.push("expected a title at its beginning".to_owned());
        }
        match &event {
            Event::Start(Tag::CodeBlock(_)) => is_code = true,
            Event::End(TagEnd::CodeBlock) => is_code = false,
            _ => {}
        }
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::End(TagEnd::Heading(_)) => {
                document.anchors.extend(heading.take().map(|heading| anchor(&heading)));
            }
            Event::Text(text) | Event::Code(text) => {
                if !is_code {
                    let is_word = |word: &&str| word.contains(char::is_alphabetic);
                    document.words += text.split_whitespace().filter(is_word).count();
                }
                if let Some(heading) = &mut heading {
                    heading.push_str(&text);
                }
            }
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                document.links.push(dest_url.into_string());
            }
            Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(language)))
                if language.is_empty() =>
            {
                document.defects.push("a code block without a language".to_owned());
            }
            _ => {}
        }
    }
    document.defects.append(&mut undefined);
    document
}

#[test]
fn documents_read_well_as_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths = Vec::new();
    documents(root, &mut paths);
    paths.retain(|path| !path.ends_with("src/guide/links.md"));
    let read = |path: PathBuf| {
        let document = read(&std::fs::read_to_string(&path).unwrap());
        (path, document)
    };
    let all: HashMap<PathBuf, Document> = paths.into_iter().map(read).collect();
    assert!(all.len() > 30, "{} documents", all.len());
    let kept = all.iter().filter(|(path, _)| !path.ends_with("CHANGELOG.md"));
    let words: usize = kept.map(|(_, document)| document.words).sum();
    assert!(words < 18_250, "{words} words");
    let mut defects = Vec::new();
    for (path, document) in &all {
        let name = path.strip_prefix(root).unwrap().display();
        defects.extend(document.defects.iter().map(|defect| format!("{name}: {defect}")));
        for link in document.links.iter().filter(|link| !link.contains("://")) {
            let (file, fragment) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => path.clone(),
                file => path.parent().unwrap().join(file),
            };
            let has_anchor = || match target.canonicalize().ok().and_then(|path| all.get(&path)) {
                Some(document) => document.anchors.contains(fragment),
                None => false,
            };
            if !target.exists() || !fragment.is_empty() && !has_anchor() {
                defects.push(format!("{name}: nothing at {link}"));
            }
        }
    }
    defects.sort();
    assert!(defects.is_empty(), "{}", defects.join("\n"));
}

#[test]
fn links_of_the_guide_have_targets_in_rustdoc() {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/guide");
    let definitions = |text: &str| -> BTreeSet<String> {
        let parser = Parser::new(text);
        parser.reference_definitions().iter().map(|(label, _)| label.to_lowercase()).collect()
    };
    let mut targets = BTreeSet::new();
    for name in ["links.md", "pictures/definitions.md"] {
        targets.append(&mut definitions(&std::fs::read_to_string(guide.join(name)).unwrap()));
    }
    for entry in std::fs::read_dir(&guide).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "md") {
            let text = std::fs::read_to_string(&path).unwrap();
            let used = definitions(&text);
            let missing: Vec<_> = used.difference(&targets).collect();
            assert!(missing.is_empty(), "{}: links.md lacks {missing:?}", path.display());
            let inline = (text.matches("](").count(), text.matches("](https://").count());
            assert_eq!(inline.0, inline.1, "{}: an inline link, dead in rustdoc", path.display());
        }
    }
}
