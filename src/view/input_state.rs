//! State of mouse and keyboard, and the conversion of their events to actions.

use egui::{Event, Key, PointerButton, Pos2};

use super::action::Action;
use super::controls;
use super::gizmo::Grab;
use super::keys::{self, Command};
use super::stage::{Pointer, Stage};
use super::view_state::{Dialog, ViewState};
use super::views::View;

/// State of mouse and keyboard.
#[derive(Default)]
pub struct InputState {
    /// Mouse position, points.
    pub at: Option<Pos2>,
    /// Offset of the panned picture, physical pixels.
    pub pan: [f32; 2],
    panning: bool,
    /// A held key whose command follows the mouse.
    dragging: Option<(Key, Command)>,
    /// The handle that the mouse drags.
    grabbed: Option<Grab>,
    /// Events postponed until their receiver is known.
    ahead: Vec<Event>,
    /// Whether the last frame showed a dialog.
    pub dialog_is_shown: bool,
}

/// The context in which events are interpreted.
pub struct Around<'a> {
    pub stage: Option<&'a mut Stage>,
    pub view: &'a ViewState,
    /// Mouse position before the events.
    pub pointer: Pointer,
    pub pixels_per_point: f32,
    pub ui_wants_keys: bool,
    pub ui_wants_pointer: bool,
}

/// The result of the events.
#[derive(Default)]
pub struct Taken {
    pub actions: Vec<Action>,
    /// Whether a redraw is needed regardless of the actions.
    pub stale: bool,
}

impl InputState {
    /// Truncates `events` after the first one that may change the receiver of later ones, and postpones the rest to the
    /// next frame. Keys that are typed before a dialog appears thus reach the dialog.
    pub fn in_turn(&mut self, events: &mut Vec<Event>, dialog: Option<&Dialog>, ui_wants_keys: bool) {
        events.splice(0..0, self.ahead.drain(..));
        if dialog.is_some() && !self.dialog_is_shown {
            // The dialog receives no keys before it is shown.
            self.ahead = events.extract_if(.., |event| matches!(event, Event::Key { .. } | Event::Text(_))).collect();
            return;
        }
        let hands_over = |event: &Event| match event {
            Event::Key { key, pressed: true, modifiers, .. } => {
                controls::hands_over(dialog, ui_wants_keys, *modifiers, *key)
            }
            Event::PointerButton { pressed, .. } => !pressed,
            _ => false,
        };
        if let Some(last) = events.iter().position(hands_over) {
            self.ahead = events.split_off(last + 1);
            // A key that answered a dialog is not also typed into the next field.
            if controls::is_answered_by_keys(dialog) && matches!(self.ahead.first(), Some(Event::Text(_))) {
                self.ahead.remove(0);
            }
        }
    }

    /// Whether there are postponed events.
    pub fn has_more(&self) -> bool {
        !self.ahead.is_empty()
    }

    /// Returns the actions of the events and removes the events that they consume.
    pub fn take(&mut self, events: &mut Vec<Event>, mut around: Around) -> Taken {
        let mut taken = Taken::default();
        events.retain(|event| match event {
            Event::PointerMoved(at) => {
                self.moved(*at, around.pixels_per_point, &mut taken);
                true
            }
            Event::PointerGone => {
                self.at = None;
                true
            }
            Event::PointerButton { button, pressed, modifiers, .. } => {
                self.panning = *button == PointerButton::Middle && *pressed && around.view.one_to_one;
                self.grabbed = None;
                if let Some(stage) = &mut around.stage {
                    stage.let_go();
                    let presses_picture = *button == PointerButton::Primary && *pressed && !around.ui_wants_pointer;
                    if presses_picture && around.view.views.view == View::Lights {
                        taken.stale |= stage.select_from_sheet(around.pointer);
                    } else if presses_picture && around.view.panel {
                        self.grabbed = stage.grab(around.pointer, *modifiers);
                        taken.stale = true;
                    }
                }
                true
            }
            Event::Key { key, pressed: false, .. } => {
                if self.dragging.is_some_and(|(held, _)| held == *key) {
                    self.dragging = None;
                    around.stage.iter_mut().for_each(|stage| stage.let_go());
                }
                true
            }
            Event::Key { key, pressed: true, repeat, modifiers, .. } => {
                let Some(command) = keys::command(*modifiers, *key) else { return true };
                if around.ui_wants_keys && !controls::works_always(command) {
                    return true;
                }
                if *repeat && !controls::repeats(command) {
                    return false;
                }
                if !repeat && let Some(stage) = &mut around.stage {
                    stage.desk.end_gesture();
                }
                if matches!(command, Command::Place | Command::Aim | Command::Highlight | Command::Shadow) {
                    self.dragging = Some((*key, command));
                }
                taken.actions.push(Action::Do(command));
                false
            }
            _ => true,
        });
        taken
    }

    fn moved(&mut self, at: Pos2, pixels_per_point: f32, taken: &mut Taken) {
        let before = self.at.replace(at);
        if let (true, Some(before)) = (self.panning, before) {
            let moved = (at - before) * pixels_per_point;
            self.pan = [self.pan[0] + moved.x, self.pan[1] + moved.y];
            taken.stale = true;
        }
        // All moves in a frame make one edit; the last one counts.
        let held = self.dragging.map(|(_, command)| Action::Do(command));
        for action in held.into_iter().chain(self.grabbed.map(Action::Drag)) {
            taken.actions.retain(|other| *other != action);
            taken.actions.push(action);
        }
    }
}

#[cfg(test)]
mod tests {
    use egui::Modifiers;

    use super::*;

    fn press(key: Key, modifiers: Modifiers) -> Event {
        Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers }
    }

    #[test]
    fn what_is_typed_ahead_waits_for_whom_it_is_for() {
        let mut hand = InputState::default();
        let save = press(Key::S, Modifiers::COMMAND);
        let move_right = press(Key::D, Modifiers::NONE);
        let enter = press(Key::Enter, Modifiers::NONE);
        let mut events = vec![move_right.clone(), save.clone(), move_right.clone(), enter.clone()];
        hand.in_turn(&mut events, None, false);
        assert_eq!(events, [move_right.clone(), save.clone()]);
        // The dialog is open, but not shown yet.
        let dialog = Some(Dialog::SaveAs(String::new()));
        let mut events = vec![Event::PointerGone];
        hand.in_turn(&mut events, dialog.as_ref(), true);
        assert_eq!(events, [Event::PointerGone]);
        hand.dialog_is_shown = true;
        let mut events = vec![save.clone()];
        hand.in_turn(&mut events, dialog.as_ref(), true);
        assert_eq!(events, [move_right, enter], "Enter closes it");
        let mut events = vec![];
        hand.in_turn(&mut events, None, false);
        assert!(events == [save] && !hand.has_more());
        // A key that answers a dialog is not typed into the next one.
        let mut events = vec![press(Key::S, Modifiers::NONE), Event::Text("s".into()), Event::Text("a".into())];
        hand.in_turn(&mut events, Some(&Dialog::Quit), true);
        assert!(events.len() == 1 && hand.ahead == [Event::Text("a".into())]);
    }
}
