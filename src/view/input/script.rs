//! Scripts: timed key and mouse events as text, recorded from a window or written by hand, and played back in one.
//!
//! Each line is `SECONDS EVENT`, with the time since the first picture; `#` begins a comment. Events:
//!
//! ```text
//! key Ctrl+Z          press and release; key names as in docs/desk.md
//! press A, release A  a held key; `repeat A` for its repeats
//! mouse 320.5 240     pointer position; points from the window's top left
//! down left, up left  a mouse button: left, right, middle
//! wheel 0 -1          mouse wheel, in lines
//! text "rim light"    characters for a text field
//! ```

use std::path::Path;
use std::time::Duration;

use egui::{Event, Key, Modifiers, MouseWheelUnit, PointerButton, Pos2, Vec2};

use super::keys::{chord_text, parse_chord};
use crate::error::{Error, Result};
use crate::storage::file;

/// Events with times, in order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    pub events: Vec<(Duration, Event)>,
}

const BUTTONS: [(&str, PointerButton); 3] =
    [("left", PointerButton::Primary), ("right", PointerButton::Secondary), ("middle", PointerButton::Middle)];

impl Script {
    /// Reads a script. The error for a malformed script names the line.
    pub fn load(path: &Path) -> Result<Self> {
        let text = String::from_utf8(crate::scene::files::read(path)?)
            .map_err(|e| Error::import_from(path, "is not UTF-8 text", e))?;
        Self::parse(&text).map_err(|reason| Error::import(path, reason))
    }

    pub fn parse(text: &str) -> Result<Self, String> {
        let mut events = Vec::new();
        let mut pointer = Pos2::ZERO;
        for (i, line) in text.lines().enumerate() {
            let wrong = |reason: &str| format!("line {}: {reason}: {line:?}", i + 1);
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (seconds, event) = line.split_once(' ').ok_or_else(|| wrong("expected SECONDS EVENT"))?;
            let seconds = seconds.parse().ok().and_then(|s| Duration::try_from_secs_f64(s).ok());
            let time = seconds.ok_or_else(|| wrong("expected a time in seconds first"))?;
            if events.last().is_some_and(|(last, _)| *last > time) {
                return Err(wrong("is earlier than the line before"));
            }
            let parsed = parse_event(event.trim(), &mut pointer).map_err(|reason| wrong(&reason))?;
            events.extend(parsed.into_iter().map(|event| (time, event)));
        }
        Ok(Self { events })
    }

    /// Appends an event, if scripts can represent it.
    pub fn record(&mut self, time: Duration, event: &Event) {
        if event_text(event).is_some() {
            self.events.push((time, event.clone()));
        }
    }

    pub fn save(&self, path: &Path) -> Result<()> {
        let lines = self
            .events
            .iter()
            .filter_map(|(time, event)| Some(format!("{:.3} {}\n", time.as_secs_f64(), event_text(event)?)));
        file::write_bytes(path, lines.collect::<String>().as_bytes())
    }
}

fn parse_event(text: &str, pointer: &mut Pos2) -> Result<Vec<Event>, String> {
    let (word, rest) = text.split_once(' ').unwrap_or((text, ""));
    let rest = rest.trim();
    let chord = || parse_chord(rest).ok_or(format!("there is no key {rest:?}"));
    let pair = || {
        let (x, y) = rest.split_once(' ')?;
        let pair: (f32, f32) = (x.parse().ok()?, y.trim().parse().ok()?);
        (pair.0.is_finite() && pair.1.is_finite()).then_some(pair)
    };
    let pair = || pair().ok_or("expected two numbers".to_owned());
    Ok(match word {
        "key" => {
            let chord = chord()?;
            vec![key_event(chord, true, false), key_event(chord, false, false)]
        }
        "press" => vec![key_event(chord()?, true, false)],
        "repeat" => vec![key_event(chord()?, true, true)],
        "release" => vec![key_event(chord()?, false, false)],
        "mouse" => {
            *pointer = pair()?.into();
            vec![Event::PointerMoved(*pointer)]
        }
        "down" | "up" => {
            let button = BUTTONS.iter().find(|(name, _)| *name == rest).ok_or("expected left, right or middle")?.1;
            let pressed = word == "down";
            vec![Event::PointerButton { pos: *pointer, button, pressed, modifiers: Modifiers::NONE }]
        }
        "wheel" => {
            let delta = Vec2::from(pair()?);
            vec![Event::MouseWheel {
                unit: MouseWheelUnit::Line,
                delta,
                phase: egui::TouchPhase::Move,
                modifiers: Modifiers::NONE,
            }]
        }
        "text" => vec![Event::Text(serde_json::from_str(rest).map_err(|_| "expected text in quotes")?)],
        _ => return Err("expected key, press, repeat, release, mouse, down, up, wheel or text".into()),
    })
}

fn key_event((modifiers, key): (Modifiers, Key), pressed: bool, repeat: bool) -> Event {
    Event::Key { key, physical_key: None, pressed, repeat, modifiers }
}

fn event_text(event: &Event) -> Option<String> {
    Some(match event {
        Event::Key { key, pressed, repeat, modifiers, .. } => {
            let word = match (pressed, repeat) {
                (true, true) => "repeat",
                (true, false) => "press",
                (false, _) => "release",
            };
            format!("{word} {}", chord_text(*modifiers, *key))
        }
        Event::PointerMoved(at) => format!("mouse {} {}", at.x, at.y),
        Event::PointerButton { button, pressed, .. } => {
            let name = BUTTONS.iter().find(|(_, b)| b == button)?.0;
            format!("{} {name}", if *pressed { "down" } else { "up" })
        }
        Event::MouseWheel { unit: MouseWheelUnit::Line, delta, .. } => format!("wheel {} {}", delta.x, delta.y),
        Event::Text(text) => format!("text {}", serde_json::Value::String(text.clone())),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_recorded_plays_back_the_same() {
        let text = "0.250 press Shift+W\n0.300 repeat Shift+W\n0.400 release W\n0.500 mouse 320.5 240\n0.500 down left\n\
                    0.700 up left\n0.800 wheel 0 -1\n0.900 text \"rim \\\"2\\\"\"\n1.000 press Ctrl+Shift+Z\n1.100 press [\n";
        let script = Script::parse(text).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.script");
        script.save(&path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        assert_eq!(Script::load(&path).unwrap(), script);
        assert_eq!(Script::parse("# a comment\n\n1 key Ctrl+Z").unwrap().events.len(), 2);
    }

    #[test]
    fn mistakes_name_their_line() {
        for (text, part) in [
            ("0.1 key A\nkey B", "line 2: expected a time in seconds first"),
            ("x", "line 1: expected SECONDS EVENT"),
            ("-1 key A", "line 1: expected a time"),
            ("2 key A\n1 key A", "line 2: is earlier"),
            ("1 key Ctrl+Nope", "there is no key"),
            ("1 mouse 3", "expected two numbers"),
            ("1 mouse NaN 3", "expected two numbers"),
            ("1 down wheel", "expected left"),
            ("1 text rim", "expected text in quotes"),
            ("1 dance", "expected key"),
        ] {
            let error = Script::parse(text).unwrap_err();
            assert!(error.contains(part), "{text:?}: {error}");
        }
    }
}
