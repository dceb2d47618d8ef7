//! State of mouse and keyboard, and the conversion of their events to actions.

use egui::{Event, Key, PointerButton, Pos2};

use super::action::Action;
use super::keys::{self, Command};
use crate::view::open_scene::{OpenScene, Pointer};
use crate::view::overlay::gizmo::Grab;
use crate::view::panel::controls;
use crate::view::view_state::{Dialog, ViewState};
use crate::view::views::View;

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
    postponed: Vec<Event>,
    /// Whether the last frame showed a dialog.
    pub dialog_is_shown: bool,
}

/// The context in which events are interpreted.
pub struct InputContext<'a> {
    pub open_scene: Option<&'a mut OpenScene>,
    pub view: &'a ViewState,
    /// Mouse position before the events, then before the one that is taken.
    pub pointer: Pointer,
    pub pixels_per_point: f32,
    pub ui_wants_keys: bool,
    pub ui_wants_pointer: bool,
}

/// The result of the events.
#[derive(Default)]
pub struct InputResult {
    pub actions: Vec<Action>,
    /// Whether a redraw is needed regardless of the actions.
    pub stale: bool,
}

impl InputState {
    /// Truncates `events` after the first one that may change the receiver of later ones, and postpones the rest to the
    /// next frame. Keys that are typed before a dialog appears thus reach the dialog.
    pub fn postpone_after_focus_change(
        &mut self,
        events: &mut Vec<Event>,
        dialog: Option<&Dialog>,
        ui_wants_keys: bool,
    ) {
        events.splice(0..0, self.postponed.drain(..));
        if dialog.is_some() && !self.dialog_is_shown {
            // The dialog receives no keys before it is shown.
            self.postponed =
                events.extract_if(.., |event| matches!(event, Event::Key { .. } | Event::Text(_))).collect();
            return;
        }
        let changes_receiver = |event: &Event| match event {
            Event::Key { key, pressed: true, modifiers, .. } => {
                controls::changes_key_receiver(dialog, ui_wants_keys, *modifiers, *key)
            }
            Event::PointerButton { pressed, .. } => !pressed,
            _ => false,
        };
        if let Some(last) = events.iter().position(changes_receiver) {
            self.postponed = events.split_off(last + 1);
            // A key that answered a dialog is not also typed into the next field.
            if controls::is_answered_by_keys(dialog) && matches!(self.postponed.first(), Some(Event::Text(_))) {
                self.postponed.remove(0);
            }
        }
    }

    /// Whether there are postponed events.
    pub fn has_more(&self) -> bool {
        !self.postponed.is_empty()
    }

    /// Returns the actions of the events and removes the events that they consume.
    pub fn take(&mut self, events: &mut Vec<Event>, mut context: InputContext) -> InputResult {
        let mut result = InputResult::default();
        events.retain(|event| match event {
            Event::PointerMoved(at) => {
                self.moved(*at, context.pixels_per_point, &mut result);
                context.pointer.at = Some([at.x, at.y].map(|x| x * context.pixels_per_point));
                true
            }
            Event::PointerGone => {
                self.at = None;
                true
            }
            Event::PointerButton { button, pressed, modifiers, .. } => {
                self.panning = *button == PointerButton::Middle && *pressed && context.view.one_to_one;
                self.grabbed = None;
                result.actions.push(Action::EndDrag);
                if let Some(open_scene) = &mut context.open_scene {
                    let presses_picture = *button == PointerButton::Primary && *pressed && !context.ui_wants_pointer;
                    if presses_picture && context.view.views.view == View::Lights {
                        result.stale |= open_scene.select_from_sheet(context.pointer);
                    } else if presses_picture && context.view.panel {
                        self.grabbed = open_scene.grab(context.pointer, *modifiers);
                        result.stale = true;
                    }
                }
                true
            }
            Event::Key { key, pressed: false, .. } => {
                if self.dragging.is_some_and(|(held, _)| held == *key) {
                    self.dragging = None;
                    result.actions.push(Action::EndDrag);
                }
                true
            }
            // A window without the focus hears no releases.
            Event::WindowFocused(false) => {
                if self.dragging.take().is_some() | self.grabbed.take().is_some() {
                    result.actions.push(Action::EndDrag);
                }
                self.panning = false;
                true
            }
            Event::Key { key, pressed: true, repeat, modifiers, .. } => {
                let Some(command) = keys::command(*modifiers, *key) else { return true };
                if context.ui_wants_keys && !controls::works_always(command) {
                    return true;
                }
                if *repeat && !controls::repeats(command) {
                    return false;
                }
                if !repeat {
                    result.actions.push(Action::EndGesture);
                }
                if matches!(command, Command::Place | Command::Aim | Command::Highlight | Command::Shadow) {
                    self.dragging = Some((*key, command));
                }
                result.actions.push(Action::Do(command));
                false
            }
            _ => true,
        });
        result
    }

    fn moved(&mut self, at: Pos2, pixels_per_point: f32, result: &mut InputResult) {
        let before = self.at.replace(at);
        if let (true, Some(before)) = (self.panning, before) {
            let moved = (at - before) * pixels_per_point;
            self.pan = [self.pan[0] + moved.x, self.pan[1] + moved.y];
            result.stale = true;
        }
        // All moves in a frame make one edit; the last one counts.
        let held = self.dragging.map(|(_, command)| Action::Do(command));
        for action in held.into_iter().chain(self.grabbed.map(Action::Drag)) {
            result.actions.retain(|other| *other != action);
            result.actions.push(action);
        }
    }
}

#[cfg(test)]
mod tests {
    use egui::Modifiers;

    use super::*;
    use crate::relight::ToneMap;

    fn press(key: Key, modifiers: Modifiers) -> Event {
        Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers }
    }

    /// A slow frame has several events: each key press and each drag is an edit of its own.
    #[test]
    fn events_of_one_frame_are_separate_edits() {
        let view = ViewState::new(0.0, ToneMap::Agx, None);
        let context = InputContext {
            open_scene: None,
            view: &view,
            pointer: Pointer { placement: Default::default(), at: None },
            pixels_per_point: 1.0,
            ui_wants_keys: false,
            ui_wants_pointer: false,
        };
        let release =
            |key| Event::Key { key, physical_key: None, pressed: false, repeat: false, modifiers: Modifiers::NONE };
        let right = press(Key::D, Modifiers::NONE);
        let mut events = vec![press(Key::P, Modifiers::NONE), release(Key::P), right.clone(), right];
        let actions = InputState::default().take(&mut events, context).actions;
        let moved = Action::Do(keys::command(Modifiers::NONE, Key::D).unwrap());
        let place = Action::Do(Command::Place);
        let ends = Action::EndGesture;
        assert_eq!(actions, [ends.clone(), place, Action::EndDrag, ends.clone(), moved.clone(), ends, moved]);
    }

    #[test]
    fn typed_ahead_keys_wait_for_their_receiver() {
        let mut input = InputState::default();
        let save = press(Key::S, Modifiers::COMMAND);
        let move_right = press(Key::D, Modifiers::NONE);
        let enter = press(Key::Enter, Modifiers::NONE);
        let mut events = vec![move_right.clone(), save.clone(), move_right.clone(), enter.clone()];
        input.postpone_after_focus_change(&mut events, None, false);
        assert_eq!(events, [move_right.clone(), save.clone()]);
        // The dialog is open, but not shown yet.
        let dialog = Some(Dialog::SaveAs(String::new()));
        let mut events = vec![Event::PointerGone];
        input.postpone_after_focus_change(&mut events, dialog.as_ref(), true);
        assert_eq!(events, [Event::PointerGone]);
        input.dialog_is_shown = true;
        let mut events = vec![save.clone()];
        input.postpone_after_focus_change(&mut events, dialog.as_ref(), true);
        assert_eq!(events, [move_right, enter], "Enter closes it");
        let mut events = vec![];
        input.postpone_after_focus_change(&mut events, None, false);
        assert!(events == [save] && !input.has_more());
        // A key that answers a dialog is not typed into the next one.
        let mut events = vec![press(Key::S, Modifiers::NONE), Event::Text("s".into()), Event::Text("a".into())];
        input.postpone_after_focus_change(&mut events, Some(&Dialog::Quit), true);
        assert!(events.len() == 1 && input.postponed == [Event::Text("a".into())]);
    }
}
