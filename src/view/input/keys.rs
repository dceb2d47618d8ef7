//! The table of key bindings, which `?` shows and docs/desk.md lists.

use egui::{Key, Modifiers};
use glam::DVec3;

use crate::desk::{Frame, GroupEdit, LightEdit, LinkEdit};
use crate::scene::LightKind;
use crate::scene::rig::SLOTS;
use crate::view::views::{Aid, View};

/// A command that a key is bound to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    NextLight,
    PreviousLight,
    /// Adds the next light to the selection.
    AddNextLight,
    AllLights,
    Edit(LightEdit),
    EditGroup(GroupEdit),
    /// Places the light at the point under the mouse. Follows the mouse while the key is held, as do the next two.
    Place,
    Aim,
    Highlight,
    /// Drags the shadow of the point under the mouse while the key is held.
    Shadow,
    LookThrough,
    /// Shows the browser of environment maps, or closes it.
    Maps,
    /// Stores a snapshot in a slot.
    Store(usize),
    /// Recalls the snapshot of a slot.
    Recall(usize),
    Wipe,
    Difference,
    EndSolo,
    Group,
    Ungroup,
    Follow,
    Unfollow,
    EditLinks(LinkEdit),
    SizeKeeps,
    /// Shows the intensity in the next unit that fits the primary light.
    NextUnit,
    New(LightKind),
    Duplicate,
    Delete,
    Undo,
    Redo,
    Exposure(f32),
    AutoExposure,
    ToneMap,
    Save,
    SaveAs,
    Export,
    Quit,
    /// Toggles between one picture pixel per screen pixel and a fitted picture.
    OneToOne,
    /// Looks from the next camera of the scene.
    NextCamera,
    PreviousCamera,
    View(View),
    /// Shows the next channel of the deep framebuffer.
    NextChannel,
    NextLayer,
    Aid(Aid),
    Panel,
    Overlay,
    FullScreen,
    /// Looks from a camera of the scene, by its index.
    Camera(usize),
    /// Pictures of all cameras.
    Shots,
    Help,
    Close,
}

/// A command and its keys.
pub struct Binding {
    /// Alternative keys.
    pub keys: &'static [(Modifiers, Key)],
    pub command: Command,
    pub text: &'static str,
    /// Factors of the command's number with Alt, without a modifier, and with Shift.
    pub steps: Option<[f64; 3]>,
}

/// A group of bindings in the list of keys.
pub struct Section {
    pub title: &'static str,
    pub bindings: &'static [Binding],
}

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;
const CTRL_SHIFT: Modifiers = Modifiers { shift: true, ..Modifiers::COMMAND };

const fn once(keys: &'static [(Modifiers, Key)], command: Command, text: &'static str) -> Binding {
    Binding { keys, command, text, steps: None }
}

const fn steps(keys: &'static [(Modifiers, Key)], edit: LightEdit, text: &'static str, steps: [f64; 3]) -> Binding {
    Binding { keys, command: Command::Edit(edit), text, steps: Some(steps) }
}

const fn moves(keys: &'static [(Modifiers, Key)], frame: Frame, axis: DVec3, text: &'static str) -> Binding {
    steps(keys, LightEdit::Move { frame, axis }, text, [0.1, 1.0, 10.0])
}

const fn master(keys: &'static [(Modifiers, Key)], sign: f64, text: &'static str) -> Binding {
    Binding { keys, command: Command::EditGroup(GroupEdit::Stops(sign)), text, steps: Some(STOPS) }
}

/// Returns the digits 1 to 9 with `modifiers`.
const fn digits(modifiers: Modifiers) -> [(Modifiers, Key); SLOTS] {
    let digits = [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];
    let mut keys = [(modifiers, Key::Num1); SLOTS];
    let mut slot = 0;
    while slot < SLOTS {
        keys[slot].1 = digits[slot];
        slot += 1;
    }
    keys
}

const RECALL: [(Modifiers, Key); SLOTS] = digits(Modifiers::ALT);
const STORE: [(Modifiers, Key); SLOTS] = digits(Modifiers { alt: true, ..Modifiers::COMMAND });

const TURN: [f64; 3] = [0.2, 2.0, 15.0];
const STOPS: [f64; 3] = [0.1, 0.5, 1.0];
const MIRED: [f64; 3] = [2.0, 10.0, 50.0];
const TINT: [f64; 3] = [0.01, 0.05, 0.2];
const CHANNEL: [f64; 3] = [0.01, 0.05, 0.2];
const CONE: [f64; 3] = [0.1, 1.0, 5.0];
const SIZE: [f64; 3] = [0.05, 0.25, 1.0];

/// All key bindings.
pub const SECTIONS: &[Section] = &[
    Section {
        title: "Lights",
        bindings: &[
            once(&[(NONE, Key::Tab)], Command::NextLight, "next light"),
            once(&[(Modifiers::SHIFT, Key::Tab)], Command::PreviousLight, "previous light"),
            once(&[(CTRL, Key::Tab)], Command::AddNextLight, "add the next light to the selection"),
            once(&[(CTRL, Key::A)], Command::AllLights, "select all lights"),
            once(&[(NONE, Key::M)], Command::Edit(LightEdit::Toggle), "light on, off"),
            once(&[(NONE, Key::N)], Command::Edit(LightEdit::Solo), "solo: only solo lights shine; off stays off"),
            once(&[(Modifiers::SHIFT, Key::N)], Command::EndSolo, "end solo"),
            once(&[(NONE, Key::X)], Command::Edit(LightEdit::Shadows), "shadows on, off"),
            once(&[(CTRL, Key::Num1)], Command::New(LightKind::Point), "new point light"),
            once(&[(CTRL, Key::Num2)], Command::New(LightKind::Spot), "new spot light"),
            once(&[(CTRL, Key::Num3)], Command::New(LightKind::Directional), "new directional light"),
            once(&[(CTRL, Key::Num4)], Command::New(LightKind::Disk), "new disk light"),
            once(&[(CTRL, Key::Num5)], Command::New(LightKind::Rect), "new rectangle light"),
            once(&[(CTRL, Key::Num6)], Command::New(LightKind::Dome), "new dome"),
            once(&[(CTRL, Key::Num7)], Command::Maps, "maps for a dome"),
            once(&[(CTRL, Key::D)], Command::Duplicate, "duplicate"),
            once(&[(NONE, Key::Delete)], Command::Delete, "delete"),
        ],
    },
    Section {
        title: "Groups, followers and links",
        bindings: &[
            once(&[(CTRL, Key::G)], Command::Group, "group the selected lights"),
            once(&[(CTRL_SHIFT, Key::G)], Command::Ungroup, "remove them from their groups"),
            master(&[(CTRL, Key::Equals), (CTRL, Key::Plus)], 1.0, "group master up half a stop"),
            master(&[(CTRL, Key::Minus)], -1.0, "group master down half a stop"),
            once(&[(CTRL, Key::M)], Command::EditGroup(GroupEdit::Toggle), "group on, off"),
            once(&[(CTRL, Key::N)], Command::EditGroup(GroupEdit::Solo), "group solo"),
            once(&[(CTRL, Key::L)], Command::Follow, "the others follow the light selected last"),
            once(&[(CTRL_SHIFT, Key::L)], Command::Unfollow, "they follow no light"),
            once(&[(NONE, Key::Z)], Command::EditLinks(LinkEdit::Light), "light the object under the mouse, or not"),
            once(&[(Modifiers::SHIFT, Key::Z)], Command::EditLinks(LinkEdit::Shadow), "its shadow, on or off"),
        ],
    },
    Section {
        title: "Picture",
        bindings: &[
            once(&[(NONE, Key::Num9)], Command::Exposure(0.5), "exposure up half a stop"),
            once(&[(NONE, Key::Num8)], Command::Exposure(-0.5), "exposure down half a stop"),
            once(&[(NONE, Key::Num0)], Command::AutoExposure, "automatic exposure"),
            once(&[(NONE, Key::Num7)], Command::ToneMap, "next tone curve: AgX, PBR Neutral, none, OpenColorIO"),
            once(&[(NONE, Key::Num1)], Command::OneToOne, "picture 1:1, or fitted to the window"),
            once(&[(CTRL, Key::PageDown)], Command::NextCamera, "next camera of the scene"),
            once(&[(CTRL, Key::PageUp)], Command::PreviousCamera, "previous camera"),
        ],
    },
    Section {
        title: "Views",
        bindings: &[
            once(&[(NONE, Key::F5)], Command::View(View::Beauty), "the picture"),
            once(&[(NONE, Key::F6)], Command::View(View::Direct), "direct light"),
            once(&[(NONE, Key::F7)], Command::View(View::Reflection), "reflections"),
            once(&[(NONE, Key::F8)], Command::View(View::Indirect), "indirect light"),
            once(&[(NONE, Key::F9)], Command::View(View::Light), "the selected light alone"),
            once(&[(NONE, Key::F10)], Command::View(View::Lights), "each light alone; click to select"),
            once(
                &[(Modifiers::SHIFT, Key::F10)],
                Command::Shots,
                "all cameras beside each other; click to look from one",
            ),
            once(&[(NONE, Key::F12)], Command::NextChannel, "deep framebuffer: next channel"),
            once(&[(Modifiers::SHIFT, Key::F12)], Command::NextLayer, "next layer: seen in mirrors"),
            once(&[(Modifiers::SHIFT, Key::F8)], Command::View(View::TransferError), "error of indirect light"),
            once(&[(NONE, Key::F4)], Command::Aid(Aid::FalseColor), "false colours, one per stop"),
            once(&[(Modifiers::SHIFT, Key::F4)], Command::Aid(Aid::Histogram), "histogram"),
            once(&[(Modifiers::SHIFT, Key::F5)], Command::Aid(Aid::Probe), "values under the mouse"),
            once(&[(Modifiers::SHIFT, Key::F6)], Command::Aid(Aid::GatherSamples), "gather samples"),
        ],
    },
    Section {
        title: "Move and aim",
        bindings: &[
            moves(&[(NONE, Key::A)], Frame::Camera, DVec3::NEG_X, "move left, as the camera sees it"),
            moves(&[(NONE, Key::D)], Frame::Camera, DVec3::X, "move right"),
            moves(&[(NONE, Key::E)], Frame::Camera, DVec3::Y, "move up"),
            moves(&[(NONE, Key::Q)], Frame::Camera, DVec3::NEG_Y, "move down"),
            moves(&[(NONE, Key::W)], Frame::Camera, DVec3::NEG_Z, "move away"),
            moves(&[(NONE, Key::S)], Frame::Camera, DVec3::Z, "move nearer"),
            moves(&[(NONE, Key::ArrowLeft)], Frame::World, DVec3::NEG_X, "move along the world's -x"),
            moves(&[(NONE, Key::ArrowRight)], Frame::World, DVec3::X, "move along +x"),
            moves(&[(NONE, Key::PageUp)], Frame::World, DVec3::Y, "move along +y"),
            moves(&[(NONE, Key::PageDown)], Frame::World, DVec3::NEG_Y, "move along -y"),
            moves(&[(NONE, Key::ArrowUp)], Frame::World, DVec3::NEG_Z, "move along -z"),
            moves(&[(NONE, Key::ArrowDown)], Frame::World, DVec3::Z, "move along +z"),
            once(&[(NONE, Key::P)], Command::Place, "move to the point under the mouse; hold to drag"),
            once(&[(NONE, Key::O)], Command::Aim, "aim at the point under the mouse; hold to drag"),
            once(&[(NONE, Key::U)], Command::Highlight, "highlight at the point under the mouse; hold to drag"),
            once(&[(NONE, Key::B)], Command::Shadow, "hold over an object, drag its shadow to a new place"),
            once(&[(NONE, Key::V)], Command::LookThrough, "look through the light"),
            steps(&[(NONE, Key::J)], LightEdit::Turn { right: -1.0, up: 0.0 }, "turn left", TURN),
            steps(&[(NONE, Key::L)], LightEdit::Turn { right: 1.0, up: 0.0 }, "turn right", TURN),
            steps(&[(NONE, Key::I)], LightEdit::Turn { right: 0.0, up: 1.0 }, "turn up", TURN),
            steps(&[(NONE, Key::K)], LightEdit::Turn { right: 0.0, up: -1.0 }, "turn down", TURN),
        ],
    },
    Section {
        title: "Intensity, colour, cone, size",
        bindings: &[
            steps(&[(NONE, Key::Equals), (NONE, Key::Plus)], LightEdit::Stops(1.0), "brighter by half a stop", STOPS),
            steps(&[(NONE, Key::Minus)], LightEdit::Stops(-1.0), "darker by half a stop", STOPS),
            steps(&[(NONE, Key::Comma)], LightEdit::Mired(-1.0), "warmer", MIRED),
            steps(&[(NONE, Key::Period)], LightEdit::Mired(1.0), "cooler", MIRED),
            steps(&[(CTRL, Key::Comma)], LightEdit::Tint(-1.0), "tint towards magenta", TINT),
            steps(&[(CTRL, Key::Period)], LightEdit::Tint(1.0), "tint towards green", TINT),
            steps(&[(NONE, Key::R)], LightEdit::Channel(0, 1.0), "more red", CHANNEL),
            steps(&[(NONE, Key::F)], LightEdit::Channel(0, -1.0), "less red", CHANNEL),
            steps(&[(NONE, Key::T)], LightEdit::Channel(1, 1.0), "more green", CHANNEL),
            steps(&[(NONE, Key::G)], LightEdit::Channel(1, -1.0), "less green", CHANNEL),
            steps(&[(NONE, Key::Y)], LightEdit::Channel(2, 1.0), "more blue", CHANNEL),
            steps(&[(NONE, Key::H)], LightEdit::Channel(2, -1.0), "less blue", CHANNEL),
            steps(&[(NONE, Key::CloseBracket)], LightEdit::Outer(1.0), "wider cone or spread", CONE),
            steps(&[(NONE, Key::OpenBracket)], LightEdit::Outer(-1.0), "narrower cone or spread", CONE),
            steps(&[(NONE, Key::Quote)], LightEdit::Inner(1.0), "wider inner cone: a harder edge", CONE),
            steps(&[(NONE, Key::Semicolon)], LightEdit::Inner(-1.0), "narrower inner cone: a softer edge", CONE),
            steps(&[(CTRL, Key::CloseBracket)], LightEdit::Doors(1.0), "open all barn doors", CONE),
            steps(&[(CTRL, Key::OpenBracket)], LightEdit::Doors(-1.0), "close all barn doors", CONE),
            steps(&[(NONE, Key::Num6)], LightEdit::Size(1.0), "larger light: softer shadows", SIZE),
            steps(&[(NONE, Key::Num5)], LightEdit::Size(-1.0), "smaller light: harder shadows", SIZE),
            once(&[(NONE, Key::Num3)], Command::NextUnit, "intensity in the next unit: lumen, nit, watt"),
            once(&[(NONE, Key::Num4)], Command::SizeKeeps, "a change of size keeps radiance, or power"),
        ],
    },
    Section {
        title: "Snapshots",
        bindings: &[
            once(&STORE, Command::Store(0), "store the lights"),
            once(&RECALL, Command::Recall(0), "recall them"),
            once(&[(NONE, Key::C)], Command::Wipe, "last snapshot beside the current lights"),
            once(&[(Modifiers::SHIFT, Key::C)], Command::Difference, "difference between the two"),
        ],
    },
    Section {
        title: "Desk",
        bindings: &[
            once(&[(CTRL, Key::Z)], Command::Undo, "undo"),
            once(&[(CTRL_SHIFT, Key::Z), (CTRL, Key::Y)], Command::Redo, "redo"),
            once(&[(CTRL, Key::S)], Command::Save, "save the rig"),
            once(&[(CTRL_SHIFT, Key::S)], Command::SaveAs, "save the rig as"),
            once(&[(CTRL, Key::E)], Command::Export, "export the scene with these lights, as glTF"),
            once(&[(CTRL, Key::Q)], Command::Quit, "quit"),
            once(&[(NONE, Key::F2)], Command::Panel, "panel"),
            once(&[(NONE, Key::F3)], Command::Overlay, "render times"),
            once(&[(Modifiers::SHIFT, Key::F3)], Command::Aid(Aid::Profile), "render times as a graph, and memory"),
            once(&[(NONE, Key::F11)], Command::FullScreen, "full screen"),
            once(&[(NONE, Key::F1), (NONE, Key::Questionmark)], Command::Help, "these keys"),
            once(&[(NONE, Key::Escape)], Command::Close, "close; back to the picture"),
        ],
    },
];

/// Note on all keys with steps.
pub const STEPS_TEXT: &str = "With Alt held the steps are fine, with Shift held they are coarse.";

/// Returns the command of a key, its number multiplied by the step.
pub fn command(modifiers: Modifiers, key: Key) -> Option<Command> {
    let all = || SECTIONS.iter().flat_map(|section| section.bindings);
    let is = |binding: &&Binding, held: Modifiers| {
        // Some keyboard layouts need Shift for `?` and `+`.
        let symbol = matches!(key, Key::Questionmark | Key::Plus);
        let held = if symbol { Modifiers { shift: false, ..held } } else { held };
        binding.keys.iter().any(|&(wanted, k)| k == key && held.matches_exact(wanted))
    };
    if let Some(binding) = all().find(|binding| is(binding, modifiers)) {
        return Some(binding.numbered(key).unwrap_or_else(|| binding.scaled(1)));
    }
    let (bare, index) = match modifiers {
        Modifiers { alt: true, shift: false, .. } => (Modifiers { alt: false, ..modifiers }, 0),
        Modifiers { alt: false, shift: true, .. } => (Modifiers { shift: false, ..modifiers }, 2),
        _ => return None,
    };
    all().filter(|binding| binding.steps.is_some()).find(|binding| is(binding, bare)).map(|b| b.scaled(index))
}

impl Binding {
    /// Returns the command with the slot of the key, if its keys stand for slots.
    fn numbered(&self, key: Key) -> Option<Command> {
        let slot = self.keys.iter().position(|&(_, k)| k == key)?;
        match self.command {
            Command::Store(_) => Some(Command::Store(slot)),
            Command::Recall(_) => Some(Command::Recall(slot)),
            _ => None,
        }
    }

    fn scaled(&self, index: usize) -> Command {
        let Some(step) = self.steps.map(|steps| steps[index]) else { return self.command };
        match self.command {
            Command::Edit(edit) => Command::Edit(match edit {
                LightEdit::Move { frame, axis } => LightEdit::Move { frame, axis: axis * step },
                LightEdit::Turn { right, up } => LightEdit::Turn { right: right * step, up: up * step },
                LightEdit::Stops(by) => LightEdit::Stops(by * step),
                LightEdit::Mired(by) => LightEdit::Mired(by * step),
                LightEdit::Channel(channel, by) => LightEdit::Channel(channel, by * step),
                LightEdit::Tint(by) => LightEdit::Tint(by * step),
                LightEdit::Doors(by) => LightEdit::Doors(by * step),
                LightEdit::Outer(by) => LightEdit::Outer(by * step),
                LightEdit::Inner(by) => LightEdit::Inner(by * step),
                LightEdit::Size(by) => LightEdit::Size(by * step),
                LightEdit::Toggle | LightEdit::Solo | LightEdit::Shadows => edit,
            }),
            Command::EditGroup(GroupEdit::Stops(by)) => Command::EditGroup(GroupEdit::Stops(by * step)),
            other => other,
        }
    }

    /// Formats the keys: "Ctrl+Shift+Z, Ctrl+Y".
    pub fn keys_text(&self) -> String {
        if let (SLOTS, Some(&(modifiers, first)), Some((_, last))) =
            (self.keys.len(), self.keys.first(), self.keys.last())
        {
            return format!("{}...{}", chord_text(modifiers, first), key_text(*last));
        }
        let texts: Vec<_> = self.keys.iter().map(|&(modifiers, key)| chord_text(modifiers, key)).collect();
        texts.join(", ")
    }
}

/// Returns the tooltip of a command: its text and keys.
pub fn hint(command: Command) -> Option<String> {
    let binding = SECTIONS.iter().flat_map(|section| section.bindings).find(|binding| binding.command == command)?;
    Some(format!("{} ({})", binding.text, binding.keys_text()))
}

/// Formats a key with its modifiers as scripts do: "Ctrl+Shift+Z".
pub fn chord_text(modifiers: Modifiers, key: Key) -> String {
    let held = [(modifiers.command || modifiers.ctrl, "Ctrl+"), (modifiers.alt, "Alt+"), (modifiers.shift, "Shift+")];
    let held: String = held.iter().filter(|(on, _)| *on).map(|(_, text)| *text).collect();
    held + key_text(key)
}

/// Returns the symbol of a key; names for arrows, since not all fonts have their symbols.
fn key_text(key: Key) -> &'static str {
    match key {
        Key::Minus => "-",
        Key::Quote => "'",
        _ if key.symbol_or_name().is_ascii() => key.symbol_or_name(),
        _ => key.name(),
    }
}

/// Parses the format of [`chord_text`]; `None` for an unknown key.
pub fn parse_chord(text: &str) -> Option<(Modifiers, Key)> {
    let mut modifiers = Modifiers::NONE;
    let mut rest = text;
    let held =
        [("Ctrl+", Modifiers::CTRL | Modifiers::COMMAND), ("Alt+", Modifiers::ALT), ("Shift+", Modifiers::SHIFT)];
    while let Some((after, modifier)) = held.iter().find_map(|(name, m)| Some((rest.strip_prefix(name)?, *m))) {
        modifiers |= modifier;
        rest = after;
    }
    let key = Key::ALL.iter().copied().find(|&key| key_text(key) == rest).or_else(|| Key::from_name(rest))?;
    Some((modifiers, key))
}

/// Returns the table for docs/desk.md: one row per section, keys in bold.
pub fn as_markdown() -> String {
    let mut text = String::from("| | |\n|---|---|\n");
    for section in SECTIONS {
        let binding = |b: &Binding| format!("**{}** {}", b.keys_text(), b.text);
        let bindings: Vec<_> = section.bindings.iter().map(binding).collect();
        text += &format!("| {} | {} |\n", section.title, bindings.join("; "));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> impl Iterator<Item = &'static Binding> {
        SECTIONS.iter().flat_map(|section| section.bindings)
    }

    #[test]
    fn every_key_finds_its_own_command_and_no_other() {
        for binding in all() {
            for &(modifiers, key) in binding.keys {
                let own = binding.numbered(key).unwrap_or_else(|| binding.scaled(1));
                assert_eq!(command(modifiers, key), Some(own), "{}", chord_text(modifiers, key));
                assert_eq!(parse_chord(&chord_text(modifiers, key)).map(|(_, key)| key), Some(key));
            }
        }
    }

    #[test]
    fn alt_is_fine_and_shift_is_coarse() {
        let stops = |modifiers, key| match command(modifiers, key) {
            Some(Command::Edit(LightEdit::Stops(by))) => by,
            other => panic!("{other:?}"),
        };
        assert_eq!(stops(NONE, Key::Minus), -0.5);
        assert_eq!(stops(Modifiers::ALT, Key::Minus), -0.1);
        assert_eq!(stops(Modifiers::SHIFT, Key::Minus), -1.0);
        assert_eq!(stops(Modifiers::SHIFT, Key::Plus), 0.5); // where + needs Shift
        assert_eq!(command(Modifiers::SHIFT, Key::M), None);
        assert_eq!(command(Modifiers::SHIFT, Key::Questionmark), Some(Command::Help));
        let ctrl = parse_chord("Ctrl+Shift+Z").unwrap();
        assert_eq!(command(ctrl.0, ctrl.1), Some(Command::Redo));
    }
}
