//! Extreme cases, read from the tables that `tests/extreme` writes into `docs/extreme.md`.

use super::table::{Table, escaped};

/// One row of these tables.
#[derive(Clone, Debug, PartialEq)]
struct Case {
    /// Heading of its section.
    part: String,
    case: String,
    asked: String,
    bound: String,
    ours: String,
    thesis: String,
    verdict: String,
    /// Date and commit of its table.
    measured: String,
}

impl Case {
    fn falls_short(&self) -> bool {
        !self.verdict.starts_with("met")
    }

    fn thesis_falls_short(&self) -> bool {
        // NaN exceeds every bound.
        let within = |thesis: f64| self.bound.parse().is_ok_and(|bound: f64| thesis <= bound);
        self.thesis.parse().is_ok_and(|thesis| !within(thesis))
    }
}

/// Header line that identifies a table of extreme cases.
const COLUMNS: &str = "| case | asked for | bound | ours | thesis | |";

/// Returns the rows of all tables with [`COLUMNS`], in document order.
fn cases(markdown: &str) -> Vec<Case> {
    let (mut cases, mut undated) = (Vec::<Case>::new(), 0);
    let (mut part, mut inside) = (String::new(), false);
    for line in markdown.lines() {
        if let Some(heading) = line.strip_prefix("## ") {
            part = heading.into();
        } else if line == COLUMNS {
            (inside, undated) = (true, cases.len());
        } else if inside && line.starts_with("| ") {
            let cells: Vec<String> = line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect();
            let Ok([case, asked, bound, ours, thesis, verdict]) = <[String; 6]>::try_from(cells) else { continue };
            cases.push(Case { part: part.clone(), case, asked, bound, ours, thesis, verdict, measured: String::new() });
        } else if line.contains(", commit ") {
            cases[undated..].iter_mut().for_each(|case| case.measured = line.trim_end_matches('.').into());
            undated = cases.len();
        } else {
            inside &= line.starts_with('|');
        }
    }
    cases
}

/// Returns all cases as one table.
pub(super) fn table(markdown: &str) -> Table {
    let columns = ["part", "case", "asked_for", "bound", "ours", "thesis", "verdict", "measured"];
    let mut table = Table::new("extreme.csv", &columns);
    for c in cases(markdown) {
        table.push([c.part, c.case, c.asked, c.bound, c.ours, c.thesis, c.verdict, c.measured]);
    }
    table
}

fn sentences(cases: &[Case]) -> Vec<String> {
    let short: Vec<&Case> = cases.iter().filter(|case| case.falls_short()).collect();
    let tried: Vec<&Case> = cases.iter().filter(|case| !case.thesis.is_empty()).collect();
    let theirs = tried.iter().filter(|case| case.thesis_falls_short()).count();
    let ours = tried.iter().filter(|case| case.falls_short()).count();
    let all = format!("{} of {} cases are within their bounds.", cases.len() - short.len(), cases.len());
    let beside = format!(
        "The thesis's method was run in {} of them and exceeds the bound in {theirs}; ours exceeds it in {ours} of \
         these.",
        tried.len()
    );
    let each = short
        .iter()
        .map(|c| format!("{}, {}: {} with a bound of {}; {}.", c.case, c.asked, c.ours, c.bound, c.verdict));
    [all, beside].into_iter().chain(each).collect()
}

/// Returns the HTML section; empty without cases.
pub(super) fn html(markdown: &str) -> String {
    let cases = cases(markdown);
    if cases.is_empty() {
        return String::new();
    }
    let items: String = sentences(&cases).iter().map(|s| format!("<li>{}</li>\n", escaped(s))).collect();
    format!(
        "<h2 id=extreme>Extreme cases</h2>\n<p>Test scenes with a known answer, or a known bound on it. Errors are \
         relative root mean square over pixels, unless a row says otherwise. They were measured separately from this \
         page, at the dates in the table, by <code>RELUME_FULL=1 cargo test --release --test \
         extreme</code>.</p>\n<ul>{items}</ul>\n\
         <details><summary>All numbers</summary>{}</details>\n",
        table(markdown).html()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_found_and_counted() {
        let page = format!(
            "# Page\n| other | table |\n|---|---|\n| 1 | 2 |\n\n## Light\n\n{COLUMNS}\n|---|---|---|---|---|---|\n\
             | a < b | all of it | 1.0e-3 | 2.0e-4 | 3.0e-1 | met |\n\
             | c | all of it | 1.0e-3 | 2.0e-2 |  | falls short: too few |\n\n2026-01-01, commit abc.\n\n| d | e |\n"
        );
        let found = cases(&page);
        assert_eq!(found.len(), 2);
        assert_eq!((&found[0].part[..], &found[0].measured[..]), ("Light", "2026-01-01, commit abc"));
        let said = sentences(&found);
        assert_eq!(said[0], "1 of 2 cases are within their bounds.");
        assert_eq!(
            said[1],
            "The thesis's method was run in 1 of them and exceeds the bound in 1; ours exceeds it in 0 of these."
        );
        assert_eq!(said[2], "c, all of it: 2.0e-2 with a bound of 1.0e-3; falls short: too few.");
        assert!(html(&page).contains("a &lt; b") && html("").is_empty());
        // The page in the repository.
        assert!(cases(include_str!("../../docs/extreme.md")).len() > 150);
    }
}
