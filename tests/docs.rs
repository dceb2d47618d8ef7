//! What the documentation names exists.

use std::path::Path;

/// Words of `text` between backquotes, or in the parentheses of a Markdown link.
fn named(text: &str) -> impl Iterator<Item = &str> {
    let quoted = text.split('`').skip(1).step_by(2);
    let linked = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    quoted.chain(linked)
}

#[test]
fn files_named_in_the_documentation_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut checked = 0;
    let pages = std::fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let others = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "scenes/README.md", "src/lib.rs"];
    let documents = pages.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    for document in documents.chain(others.map(|name| root.join(name))) {
        let text = std::fs::read_to_string(&document).unwrap();
        let folder = document.parent().unwrap();
        for name in named(&text) {
            let first = name.split_whitespace().next().unwrap_or_default();
            let is_path = ["tools/", "scenes/", "docs/", "src/", "glsl/", "tests/", "benches/"];
            let made_on_use = first.starts_with("scenes/generated");
            if is_path.iter().any(|p| first.starts_with(p)) && !made_on_use && !first.contains(['*', '{', '<']) {
                assert!(
                    root.join(first).exists() || folder.join(first).exists(),
                    "{} names {first}, which does not exist",
                    document.display()
                );
                checked += 1;
            }
        }
    }
    assert!(checked > 5, "only {checked} names were found: has the way they are written changed?");
}

#[test]
fn every_citation_is_in_the_bibliography() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let bibliography = std::fs::read_to_string(root.join("src/lib.rs")).unwrap();
    let mut folders = ["src", "glsl", "docs"].map(|folder| root.join(folder)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let Ok(text) = std::fs::read_to_string(&path) else { continue }; // tables of numbers
            for cited in text.split('[').skip(1).filter_map(|rest| rest.split(']').next()) {
                // "Author 2007, Eq. 3; Other 1999"
                for one in cited.split(';').map(|c| c.split(',').next().unwrap_or_default().trim()) {
                    let mut words = one.rsplitn(2, ' ');
                    let year = words.next().unwrap_or_default();
                    let author = words.next().unwrap_or_default();
                    let is_year = year.len() == 4 && year.parse::<u32>().is_ok_and(|y| (1900..2100).contains(&y));
                    if is_year && author.chars().all(|c| c.is_alphabetic() || "- ,".contains(c)) && !author.is_empty() {
                        assert!(bibliography.contains(&format!("[{one}]")), "{}: [{one}]", path.display());
                    }
                }
            }
        }
    }
}

/// The table of keys in docs/desk.md is the one that binds them; `BLESS=1` writes it.
#[test]
fn the_desk_page_lists_every_key() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/desk.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (begin, end) = ("<!-- keys: written by BLESS=1 cargo test --test docs -->\n", "<!-- end of keys -->");
    let (before, rest) = text.split_once(begin).unwrap();
    let (table, after) = rest.split_once(end).unwrap();
    let wanted = format!("\n{}\n", relume::view::input::keys::as_markdown());
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&path, format!("{before}{begin}{wanted}{end}{after}")).unwrap();
    } else {
        assert_eq!(table, wanted, "BLESS=1 writes it");
    }
}
