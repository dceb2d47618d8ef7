//! The hand on mouse and keys: what its events mean.

use egui::{Event, Key, PointerButton, Pos2};

use super::controls::{self, Action, Dialog, ViewState};
use super::gizmo::Grab;
use super::keys::{self, Command};
use super::stage::{Pointer, Stage};
use super::views::View;

#[derive(Default)]
pub struct InputState {
    /// Where the mouse is.
    pub at: Option<Pos2>,
    /// How far the picture was pulled, pixels.
    pub pan: [f32; 2],
    panning: bool,
    /// A key that is held and follows the mouse.
    dragging: Option<(Key, Command)>,
    /// What the mouse took hold of in the picture.
    grabbed: Option<Grab>,
    /// Typed before it was known whom it is for.
    ahead: Vec<Event>,
    /// Whether the last frame showed a dialog.
    pub dialog_is_shown: bool,
}

/// What events come upon.
pub struct Around<'a> {
    pub stage: Option<&'a mut Stage>,
    pub view: &'a ViewState,
    /// Where the mouse was before them.
    pub pointer: Pointer,
    pub pixels_per_point: f32,
    pub ui_wants_keys: bool,
    pub ui_wants_pointer: bool,
}

/// What events ask for.
#[derive(Default)]
pub struct Taken {
    pub actions: Vec<Action>,
    /// Whether there is something new to be seen, whatever the actions do.
    pub stale: bool,
}

impl InputState {
    /// Leaves the events up to the one that changes whom later ones are for, and keeps these for the next frame: who types ahead of a
    /// dialog types into it.
    pub fn in_turn(&mut self, events: &mut Vec<Event>, dialog: Option<&Dialog>, ui_wants_keys: bool) {
        events.splice(0..0, self.ahead.drain(..));
        if dialog.is_some() && !self.dialog_is_shown {
            // It takes no key before it is there.
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
            // The letter of a key that was an answer is none of the next one's.
            if controls::is_answered_by_keys(dialog) && matches!(self.ahead.first(), Some(Event::Text(_))) {
                self.ahead.remove(0);
            }
        }
    }

    /// Whether something was typed ahead.
    pub fn has_more(&self) -> bool {
        !self.ahead.is_empty()
    }

    /// What the events mean; those that mean something to us are taken out.
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
        // One edit for all moves of a frame: the last one counts.
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
        // The dialog is open, but no frame has shown it yet.
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
        // What answers a question is no letter for the next dialog.
        let mut events = vec![press(Key::S, Modifiers::NONE), Event::Text("s".into()), Event::Text("a".into())];
        hand.in_turn(&mut events, Some(&Dialog::Quit), true);
        assert!(events.len() == 1 && hand.ahead == [Event::Text("a".into())]);
    }
}
