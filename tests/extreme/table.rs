//! What was tried and what came of it: printed, and kept in docs/extreme.md.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// One case: what was asked, and how far from it the answer is; what is not a number is beyond every bound.
pub struct Row {
    case: String,
    asked: String,
    bound: f64,
    robust: f64,
    /// What the thesis's method makes of the same, for the table; it may be beyond the bound.
    thesis: Option<f64>,
    /// Why it is beyond the bound, where that is known.
    short: Option<&'static str>,
    note: String,
}

impl Row {
    /// `error` must not exceed `bound`.
    pub fn new(case: impl Into<String>, asked: impl Into<String>, bound: f64, error: f64) -> Self {
        Self {
            case: case.into(),
            asked: asked.into(),
            bound,
            robust: error,
            thesis: None,
            short: None,
            note: String::new(),
        }
    }

    /// `error` of the thesis's method, which is computed if all cases run.
    pub fn thesis(self, error: impl FnOnce() -> f64) -> Self {
        Self { thesis: full().then(error), ..self }
    }

    /// It is known to be beyond its bound, for this reason; that it no longer is, is an error too.
    pub fn short(self, why: &'static str) -> Self {
        Self { short: Some(why), ..self }
    }

    /// What else was found.
    pub fn note(self, note: String) -> Self {
        Self { note, ..self }
    }

    fn meets(&self) -> bool {
        self.robust <= self.bound
    }

    fn is_as_expected(&self) -> bool {
        self.meets() == self.short.is_none()
    }

    fn markdown(&self) -> String {
        let number = |x: f64| match x {
            0.0 => "0".into(),
            0.9..1.1 => format!("{x:.6}"),
            _ => format!("{x:.1e}"),
        };
        let verdict = match (self.meets(), self.short) {
            (true, None) if self.note.is_empty() => "met".into(),
            (true, None) => format!("met; {}", self.note),
            (true, Some(_)) => "met, against expectation".into(),
            (false, None) => "**not met**".into(),
            (false, Some(why)) => format!("falls short: {why}"),
        };
        let thesis = self.thesis.map_or("".into(), number);
        let [bound, robust] = [self.bound, self.robust].map(number);
        format!("| {} | {} | {bound} | {robust} | {thesis} | {verdict} |", self.case, self.asked)
    }
}

/// Whether the heaviest cases run too.
pub fn full() -> bool {
    std::env::var_os("RELUME_FULL").is_some()
}

/// Prints a part of the table and asserts its verdicts. With `BLESS=1` and all cases it becomes that part of the page;
/// without, the page must have each of these cases.
#[track_caller]
pub fn check(part: &str, rows: &[Row]) {
    let head = "| case | asked for | bound | ours | thesis | |\n|---|---|---|---|---|---|\n";
    let lines: Vec<String> = rows.iter().map(Row::markdown).collect();
    let table = format!("{head}{}\n", lines.join("\n"));
    println!("{part}\n\n{table}");
    let wrong: Vec<&String> =
        rows.iter().zip(&lines).filter(|(row, _)| !row.is_as_expected()).map(|(_, l)| l).collect();
    assert!(wrong.is_empty(), "{part}: {wrong:#?}");
    static PAGE: Mutex<()> = Mutex::new(());
    let _turn = PAGE.lock().unwrap_or_else(PoisonError::into_inner);
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/extreme.md");
    let text = std::fs::read_to_string(&page).unwrap();
    let begin = format!("<!-- {part}: written by BLESS=1 RELUME_FULL=1 cargo test --release --test extreme -->\n");
    let end = format!("<!-- end of {part} -->");
    let (before, rest) = text.split_once(&begin).expect("a mark before the table");
    let (there, after) = rest.split_once(&end).expect("a mark after it");
    if std::env::var_os("BLESS").is_some() {
        assert!(full(), "the page holds all cases: RELUME_FULL=1");
        let commit = output(Command::new("git").args(["rev-parse", "--short", "HEAD"]));
        let date = output(Command::new("date").arg("+%F"));
        let mut new = format!("{before}{begin}");
        write!(new, "\n{table}\n{date}, commit {commit}.\n\n{end}{after}").unwrap();
        std::fs::write(&page, new).unwrap();
        return;
    }
    for row in rows {
        let start = format!("| {} | {} |", row.case, row.asked);
        assert!(there.contains(&start), "docs/extreme.md lacks {start}; BLESS=1 RELUME_FULL=1 writes it");
    }
}

fn output(command: &mut Command) -> String {
    let output = command.current_dir(PathBuf::from(env!("CARGO_MANIFEST_DIR"))).output().unwrap();
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}
