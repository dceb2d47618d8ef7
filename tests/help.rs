//! The help of every command: it is there, it fits the terminal, and it describes each option.

mod command;

use command::{Run, relume};

/// What a help describes, and how.
struct Described {
    /// As written, like `--size <WxH>` or `<SCENE>`.
    name: String,
    description: String,
}

/// Columns of terminals that help is folded for; in wider ones it stays as in 120.
const WIDTHS: [usize; 3] = [80, 100, 120];

fn help(arguments: &[&str], width: usize) -> String {
    Run::of(relume().args(arguments).env("COLUMNS", width.to_string())).silent().stdout
}

/// The commands that `relume help` lists.
fn commands() -> Vec<String> {
    let all = help(&["help"], 120);
    let (_, listed) = all.split_once("\nCommands:\n").expect("help lists commands");
    // Names begin in the third column, their descriptions go on further right.
    let lines = listed.lines().take_while(|line| !line.is_empty()).filter(|line| !line.starts_with("   "));
    let names = lines.map(|line| line.split_whitespace().next().unwrap_or_default().to_owned());
    names.filter(|name| name != "help").collect()
}

/// Arguments and options of a help, with what stands beside and below each.
fn described(help: &str) -> Vec<Described> {
    let mut all: Vec<Described> = Vec::new();
    let mut section = "";
    for line in help.lines() {
        let (text, indent) = (line.trim(), line.len() - line.trim_start().len());
        if indent == 0 {
            // A blank line ends no description: defaults stand below one.
            section = if text.is_empty() { section } else { text };
            continue;
        }
        let is_argument = section == "Arguments:" && indent == 2;
        let is_option = indent <= 6 && text.starts_with('-') && text.contains("--");
        if is_argument || is_option {
            // Two spaces part a name from a description beside it.
            let (name, description) = text.split_once("  ").unwrap_or((text, ""));
            all.push(Described { name: name.to_owned(), description: description.trim().to_owned() });
        } else if let Some(last) = all.last_mut()
            && indent > 6
        {
            last.description = format!("{} {text}", last.description).trim().to_owned();
        }
    }
    all
}

/// Names of what a help leaves without a description.
fn undescribed(help: &str) -> Vec<String> {
    // Defaults and values alone say nothing of what they are for.
    let says = |text: &str| text.starts_with(char::is_alphabetic) && !text.starts_with("Possible values");
    described(help).into_iter().filter(|one| !says(&one.description)).map(|one| one.name).collect()
}

#[test]
fn every_command_describes_itself() {
    let commands = commands();
    for known in ["render", "view", "bake", "bench", "report", "plan", "rig", "reference", "compare", "devices"] {
        assert!(commands.iter().any(|command| command == known), "no {known} in {commands:?}");
    }
    for command in &commands {
        assert_eq!(help(&[command, "--help"], 80), help(&["help", command], 80));
        let [short, long] = ["-h", "--help"].map(|form| help(&[command, form], 80));
        assert!(long.starts_with(char::is_uppercase), "{command} does not begin with what it does: {long}");
        for text in [&short, &long] {
            assert_eq!(undescribed(text), [""; 0], "{command} leaves these without a description: {text}");
        }
        let names = |text: &str| described(text).into_iter().map(|one| one.name).collect::<Vec<_>>();
        assert_eq!(names(&short), names(&long), "-h and --help of {command} list the same");
        for common in ["--quiet", "--verbose", "--help"] {
            assert!(names(&long).iter().any(|name| name.contains(common)), "{command} has no {common}");
        }
    }
}

#[test]
fn help_fits_the_terminal() {
    let commands = commands();
    let pages = commands.iter().flat_map(|command| ["-h", "--help"].map(|form| vec![command.as_str(), form]));
    for page in pages.chain([vec!["help"], vec!["--help"], vec!["-h"], vec![]]) {
        for width in WIDTHS {
            let text = match page.is_empty() {
                // Without a command help goes to stderr, and the usage is bad.
                true => Run::of(relume().env("COLUMNS", width.to_string())).refused("Usage").stderr,
                false => help(&page, width),
            };
            // A word wider than its column cannot be folded: the layers that `reference` writes by default.
            let is_foldable = |line: &&str| line.trim().contains(' ');
            let wide: Vec<_> = text.lines().filter(|line| line.chars().count() > width).filter(is_foldable).collect();
            assert!(wide.is_empty(), "{page:?} in {width} columns: {wide:#?}");
        }
    }
}

/// What the tests above look for they would find.
#[test]
fn missing_descriptions_are_found() {
    let text = "Makes.\n\nArguments:\n  <SCENE>\n\nOptions:\n  -o, --output <OUT>  Where to\n      --bare\n          \
                [default: 4]\n      --told\n          Tells\n\n          [default: 4]\n      --choice\n          \
                Possible values:\n          - a: b\n  -q, --quiet\n\nKeys:\n  -        darker\n";
    assert_eq!(undescribed(text), ["<SCENE>", "--bare", "--choice", "-q, --quiet"]);
}
