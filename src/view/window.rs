//! The event loop: pending events become one edit, and one edit becomes one frame.

use std::time::{Duration, Instant};

use egui::{Event, ViewportId};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Fullscreen, WindowId};

use super::action::Action;
use super::controls::PANEL_WIDTH;
use super::graphics::Graphics;
use super::input_state::{Around, InputState, Taken};
use super::interface::{Interface, loading_bar};
use super::keys::Command;
use super::load::{LoadEvent, Loader};
use super::pick::placement;
use super::script::Script;
use super::stage::{Pointer, Stage, Then};
use super::timings::Timings;
use super::view_state::{Dialog, ViewState};
use super::views::Views;
use super::{Latency, Opened, ViewReport, ViewSettings};
use crate::error::{Cause, Error, Result};
use crate::gpu::{PassTime, Placement, Screen, UiFrame};
use crate::relight::ToneMap;

/// Opens a window and runs it until it is closed. `load` runs on its own thread and sends its results to the window.
/// Fails if no window can be opened or the scene cannot be loaded.
pub fn run(settings: ViewSettings, load: impl FnOnce(&Loader) -> Result<()> + Send + 'static) -> Result<ViewReport> {
    let no_window = |source: Cause| Error::NoWindow { source };
    let event_loop = EventLoop::<LoadEvent>::with_user_event().build().map_err(|e| no_window(e.into()))?;
    let loader = Loader::new(event_loop.create_proxy());
    let mut app = App::new(settings, event_loop.create_proxy());
    // Not joined, so that closing the window does not wait for a long bake.
    std::thread::spawn(move || loader.end(load(&loader)));
    event_loop.run_app(&mut app).map_err(|e| no_window(e.into()))?;
    app.finish()
}

struct App {
    settings: ViewSettings,
    proxy: EventLoopProxy<LoadEvent>,
    began: Instant,
    device_time: Duration,
    view: ViewState,
    /// Dropped before `graphics`, whose device it uses.
    stage: Option<Stage>,
    graphics: Option<Graphics>,
    /// Current step of the loading thread, and its progress from 0 to 1.
    loading: Option<(&'static str, f32)>,
    hand: InputState,
    /// Time of the first event that no frame has shown yet.
    pending: Option<Instant>,
    /// Whether something changed that no frame has shown yet.
    stale: bool,
    /// Whether we requested the next redraw. Otherwise the system requests it because it lost the window's contents.
    asked: bool,
    /// Time at which egui wants to draw the interface again.
    wake: Option<Instant>,
    /// Number of interface frames since the last event.
    looks: u32,
    /// Time at which idle work starts, if there may be any.
    rest: Option<Instant>,
    /// Whether idle work has a result that no frame has shown yet.
    rested: bool,
    first_picture: Option<Instant>,
    played: usize,
    recorded: Script,
    timings: Timings,
    frames: usize,
    /// Start times of frames, milliseconds, and their passes; empty unless requested.
    trace: Vec<(f64, Vec<PassTime>)>,
    outcome: Result<()>,
}

/// Largest number of interface frames without an event. A new overlay needs one frame for its layout and one to appear;
/// its content may depend on the picture of the frame before.
const LOOKS: u32 = 2;
/// Shortest delay before an interface frame without an event. egui requests one after most events; if another event
/// comes first, its frame serves.
const SECOND_LOOK: Duration = Duration::from_millis(40);

/// Time after a frame at which idle work starts.
const REST: Duration = Duration::from_millis(150);

impl App {
    fn new(settings: ViewSettings, proxy: EventLoopProxy<LoadEvent>) -> Self {
        let view = ViewState {
            exposure: settings.exposure.unwrap_or(0.0),
            tone_map: match settings.tone_map {
                ToneMap::FalseColor => ToneMap::Agx,
                curve => curve,
            },
            one_to_one: false,
            panel: true,
            overlay: false,
            views: Views::new(settings.tone_map),
            help: false,
            dialog: None,
            search: String::new(),
            comparing: None,
            look: false,
        };
        Self {
            settings,
            proxy,
            began: Instant::now(),
            device_time: Duration::ZERO,
            view,
            stage: None,
            graphics: None,
            loading: Some(("loading", 0.0)),
            hand: InputState::default(),
            pending: None,
            stale: true,
            asked: false,
            wake: None,
            looks: 0,
            rest: None,
            rested: false,
            first_picture: None,
            played: 0,
            recorded: Script::default(),
            timings: Timings::default(),
            frames: 0,
            trace: Vec::new(),
            outcome: Ok(()),
        }
    }

    fn finish(mut self) -> Result<ViewReport> {
        let (relit_frames, latency) = self.timings.relit();
        let info = self.graphics.as_ref().map(|graphics| graphics.context.info.clone());
        // Dropped before the graphics, whose device it uses.
        let stage = self.stage.take();
        self.outcome?; // after an error the autosave file remains
        let is_answered = !matches!(self.view.dialog, Some(Dialog::Recover(_)));
        stage.filter(|_| is_answered).map_or(Ok(()), Stage::close)?;
        if let Some(path) = &self.settings.record {
            self.recorded.save(path)?;
        }
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        Ok(ViewReport {
            device: info.as_ref().map(|info| info.name.clone()).unwrap_or_default(),
            driver: info.map(|info| info.driver).unwrap_or_default(),
            first_picture_ms: self.first_picture.map(|at| ms(at - self.began)),
            device_ms: ms(self.device_time),
            frames: self.frames,
            relit_frames,
            coarse_frames: self.timings.coarse_frames(),
            latency_ms: latency.map(|[best, median, p95]| Latency { best, median, p95 }),
            passes: self.timings.median_passes(),
            trace: self.trace,
        })
    }

    fn ask_for_frame(&mut self) {
        if let Some(graphics) = &self.graphics {
            self.asked = true;
            graphics.window.request_redraw();
        }
    }

    /// Records an event that the next frame must show.
    fn note_event(&mut self, at: Instant) {
        self.pending.get_or_insert(at);
        self.ask_for_frame();
    }

    fn open(&mut self, opened: Opened) -> Result<()> {
        let Some(graphics) = &self.graphics else { return Ok(()) };
        let start = Instant::now();
        let mut stage = Stage::new(&graphics.context, opened, &self.settings, self.proxy.clone())?;
        self.device_time += start.elapsed();
        if self.settings.exposure.is_none() {
            self.view.exposure = stage.automatic_exposure()?;
        }
        graphics.make_room(stage.picture_size());
        stage.ask_to_recover(&mut self.view);
        self.stage = Some(stage);
        self.stale = true;
        Ok(())
    }

    /// Returns the current position of the picture in the window.
    fn placement(&self) -> Placement {
        let (Some(graphics), Some(stage)) = (&self.graphics, &self.stage) else { return Placement::default() };
        let PhysicalSize { width, height } = graphics.window.inner_size();
        let panel = if self.view.panel { (PANEL_WIDTH * graphics.pixels_per_point()).ceil() as u32 } else { 0 };
        let area = [width.saturating_sub(panel), height];
        placement(stage.picture_size(), area, self.view.one_to_one, self.hand.pan.map(|x| x as i32))
    }

    fn pointer(&self) -> Pointer {
        let scale = self.graphics.as_ref().map_or(1.0, Graphics::pixels_per_point);
        Pointer { placement: self.placement(), at: self.hand.at.map(|at| [at.x * scale, at.y * scale]) }
    }

    /// Adds the script's events that are due.
    fn play(&mut self, events: &mut Vec<Event>) {
        let (Some(script), Some(start)) = (&self.settings.script, self.first_picture) else { return };
        while let Some((time, event)) = script.events.get(self.played)
            && start + *time <= Instant::now()
        {
            self.pending.get_or_insert_with(Instant::now);
            events.push(event.clone());
            self.played += 1;
        }
    }

    fn next_scripted(&self) -> Option<Instant> {
        let script = self.settings.script.as_ref()?;
        Some(self.first_picture? + script.events.get(self.played)?.0)
    }

    /// Handles the pending events and draws one frame.
    fn frame(&mut self) -> Result<Then> {
        let Some(graphics) = &mut self.graphics else { return Ok(Then::Continue) };
        let mut input = graphics.egui.take_egui_input(&graphics.window);
        self.play(&mut input.events);
        if let (Some(start), Some(_)) = (self.first_picture, &self.settings.record) {
            input.events.iter().for_each(|event| self.recorded.record(start.elapsed(), event));
        }
        let actions = self.take_events(&mut input.events);
        let had_events = !input.events.is_empty();
        let mut then = self.act(&actions)?;
        let has_ui = self.view.has_ui() || self.stage.is_none();
        let drawn = if has_ui {
            let (ui, actions) = self.run_ui(input)?;
            self.hand.dialog_is_shown = self.view.dialog.is_some();
            self.looks = if had_events { 0 } else { self.looks + 1 };
            if self.looks > LOOKS {
                self.wake = None; // egui would request frames forever
            }
            if !actions.is_empty() {
                if self.act(&actions)? == Then::Quit {
                    then = Then::Quit;
                }
                self.ask_for_frame(); // to show their result in the interface
            }
            Some(ui)
        } else {
            None
        };
        if then == Then::Quit || !(self.stale || has_ui) {
            self.pending = None;
            return Ok(then);
        }
        self.draw(drawn.as_ref())?;
        Ok(then)
    }

    /// Returns the actions of the events and removes the events that they consume.
    fn take_events(&mut self, events: &mut Vec<Event>) -> Vec<Action> {
        let pointer = self.pointer();
        let graphics = self.graphics.as_ref().expect("frames begin with graphics");
        let context = graphics.egui.egui_ctx();
        let is_typed_to = context.egui_wants_keyboard_input() && self.view.has_ui();
        let ui_wants_keys = self.view.dialog.is_some() || is_typed_to;
        self.hand.in_turn(events, self.view.dialog.as_ref(), ui_wants_keys);
        let around = Around {
            stage: self.stage.as_mut(),
            view: &self.view,
            pointer,
            pixels_per_point: graphics.pixels_per_point(),
            ui_wants_keys,
            ui_wants_pointer: context.egui_wants_pointer_input(),
        };
        let Taken { actions, stale } = self.hand.take(events, around);
        self.stale |= stale;
        actions
    }

    fn act(&mut self, actions: &[Action]) -> Result<Then> {
        for action in actions {
            self.stale = true;
            if let (Action::Do(Command::FullScreen), Some(graphics)) = (action, &self.graphics) {
                let window = &graphics.window;
                window.set_fullscreen(window.fullscreen().is_none().then_some(Fullscreen::Borderless(None)));
            }
            let pointer = self.pointer();
            let then = match &mut self.stage {
                Some(stage) => stage.act(action, &mut self.view, pointer)?,
                None if *action == Action::Do(Command::Quit) => Then::Quit,
                None => Then::Continue,
            };
            if then == Then::Quit {
                return Ok(then);
            }
        }
        Ok(Then::Continue)
    }

    /// Runs the interface once. Returns its frame and the requested actions.
    fn run_ui(&mut self, input: egui::RawInput) -> Result<(UiFrame, Vec<Action>)> {
        let placement = self.placement();
        let graphics = self.graphics.as_mut().expect("frames begin with graphics");
        let (view, stage, timings) = (&mut self.view, &mut self.stage, &self.timings);
        let (name, loading) = (&self.settings.name, self.loading);
        let budget_ms = self.settings.frame_budget.as_secs_f64() * 1e3;
        let context = graphics.egui.egui_ctx().clone();
        let scale = graphics.pixels_per_point();
        let mut actions = Vec::new();
        let output = context.run_ui(input, |ui| match stage {
            None => loading_bar(ui, name, loading.unwrap_or_default()),
            Some(stage) => {
                let view = &mut *view;
                Interface { stage, view, timings, name, loading, budget_ms, placement, scale }.draw(ui, &mut actions);
            }
        });
        graphics.egui.handle_platform_output(&graphics.window, output.platform_output);
        graphics.ui.update_textures(&output.textures_delta)?;
        let delay = output.viewport_output.get(&ViewportId::ROOT).map_or(Duration::MAX, |v| v.repaint_delay);
        self.wake = Instant::now().checked_add(delay.max(SECOND_LOOK)).filter(|_| delay < Duration::from_secs(3600));
        let primitives = context.tessellate(output.shapes, output.pixels_per_point);
        Ok((UiFrame { primitives, pixels_per_point: output.pixels_per_point }, actions))
    }

    /// Does one short step of idle work; events are handled between steps.
    fn rest(&mut self) -> Result<Then> {
        let Some(stage) = &mut self.stage else { return Ok(Then::Continue) };
        match stage.rest()? {
            true => {
                self.rest = Some(Instant::now());
                self.rested = true;
            }
            false if std::mem::take(&mut self.rested) && self.view.panel => self.ask_for_frame(),
            false => {}
        }
        Ok(Then::Continue)
    }

    fn draw(&mut self, ui: Option<&UiFrame>) -> Result<()> {
        let (placement, pointer) = (self.placement(), self.pointer());
        let graphics = self.graphics.as_mut().expect("frames begin with graphics");
        let PhysicalSize { width, height } = graphics.window.inner_size();
        if width == 0 || height == 0 {
            return Ok(()); // minimised: `stale` remains set
        }
        graphics.surface.resize([width, height]);
        let mut screen = Screen {
            surface: &mut graphics.surface,
            placement,
            over: None,
            ui: ui.map(|frame| (&mut graphics.ui, frame)),
        };
        let mut passes = None;
        let (mut overlay_changed, mut coarse) = (false, false);
        match &mut self.stage {
            Some(stage) => {
                let overlay = stage.overlay.clone();
                let began_ms = self.began.elapsed().as_secs_f64() * 1e3;
                stage.draw(&self.view, pointer, screen)?;
                if self.settings.trace {
                    self.trace.push((began_ms, stage.times().to_vec()));
                }
                coarse = stage.is_coarse();
                overlay_changed = stage.overlay != overlay;
                passes = Some(stage.times()).filter(|times| times.iter().any(|pass| pass.name == "composite"));
                let star = if stage.desk.history().is_unsaved() { "*" } else { "" };
                let message = &stage.desk.message;
                graphics.set_title(format!("{}{star} - {message} - relume", self.settings.name));
                if self.first_picture.is_none() {
                    self.first_picture = Some(Instant::now());
                    self.pending = None; // the first picture is no edit
                }
            }
            None => {
                let mut frame = graphics.frames.begin()?;
                frame.draw(&mut screen, None)?;
                frame.finish_on(screen.surface)?;
            }
        }
        self.frames += 1;
        self.rest = Some(Instant::now() + REST);
        self.stale = graphics.surface.lost_picture();
        if let Some(event) = self.pending.take() {
            self.timings.frame(event, passes, coarse);
        }
        if self.stale || overlay_changed {
            self.ask_for_frame();
        }
        Ok(())
    }

    /// Ends the loop on quit or on an error.
    fn check(&mut self, outcome: Result<Then>, event_loop: &ActiveEventLoop) {
        match outcome {
            Ok(Then::Continue) => {}
            Ok(Then::Quit) => event_loop.exit(),
            Err(error) => {
                self.outcome = Err(error);
                event_loop.exit();
            }
        }
    }
}

impl ApplicationHandler<LoadEvent> for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.graphics.is_some() {
            return;
        }
        let start = Instant::now();
        match Graphics::new(event_loop, &self.settings) {
            Ok(graphics) => {
                self.graphics = Some(graphics);
                self.device_time += start.elapsed();
                self.ask_for_frame();
            }
            Err(error) => self.check(Err(error), event_loop),
        }
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, event: LoadEvent) {
        match event {
            LoadEvent::Progress { what, share } => self.loading = Some((what, share)),
            LoadEvent::Opened(opened) => {
                let outcome = self.open(*opened).map(|()| Then::Continue);
                self.check(outcome, event_loop);
            }
            LoadEvent::Refined(transfer) => {
                let outcome = self.stage.as_mut().map_or(Ok(()), |stage| stage.refine(transfer));
                self.stale = true;
                self.check(outcome.map(|()| Then::Continue), event_loop);
            }
            LoadEvent::EdgesRefined(refinement) => {
                if let Some(stage) = &mut self.stage {
                    stage.accept_refinement(*refinement);
                }
                self.stale = true;
            }
            LoadEvent::Ended(outcome) => {
                self.loading = None;
                match (&mut self.stage, outcome) {
                    // Direct light can still be edited.
                    (Some(stage), Err(error)) => stage.desk.message = format!("no indirect light: {error}"),
                    (_, outcome) => self.check(outcome.map(|()| Then::Continue), event_loop),
                }
            }
        }
        self.ask_for_frame();
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match &event {
            WindowEvent::RedrawRequested => {
                self.stale |= !std::mem::take(&mut self.asked);
                let since = self.pending;
                let outcome = self.frame();
                if self.hand.has_more() {
                    self.pending = since; // postponed events are not shown yet
                    self.ask_for_frame();
                }
                return self.check(outcome, event_loop);
            }
            WindowEvent::CloseRequested => {
                let outcome = self.act(&[Action::Do(Command::Quit)]);
                self.check(outcome, event_loop);
            }
            WindowEvent::CursorMoved { .. }
            | WindowEvent::CursorEntered { .. }
            | WindowEvent::CursorLeft { .. }
            | WindowEvent::MouseInput { .. }
            | WindowEvent::MouseWheel { .. }
            | WindowEvent::KeyboardInput { .. }
            | WindowEvent::ModifiersChanged(_)
            | WindowEvent::Ime(_) => {} // `take_events` decides whether they change the picture
            // Size, focus, visibility: the system may have lost the window's contents.
            _ => self.stale = true,
        }
        let Some(graphics) = &mut self.graphics else { return };
        if graphics.egui.on_window_event(&graphics.window, &event).repaint || self.stale {
            self.note_event(Instant::now());
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let now = Instant::now();
        let due = |at: &Instant| *at <= now;
        let goes_on = self.stage.as_ref().and_then(|stage| stage.goes_on_at(&self.view));
        let is_due = goes_on.as_ref().is_some_and(due);
        self.stale |= is_due;
        if is_due || self.wake.as_ref().is_some_and(due) || self.next_scripted().as_ref().is_some_and(due) {
            self.wake = None;
            self.ask_for_frame();
        }
        if self.rest.as_ref().is_some_and(due) {
            self.rest = None;
            let outcome = self.rest();
            self.check(outcome, event_loop);
        }
        let next =
            [self.wake, self.rest, self.next_scripted(), goes_on].into_iter().flatten().filter(|at| !due(at)).min();
        event_loop.set_control_flow(next.map_or(ControlFlow::Wait, ControlFlow::WaitUntil));
    }
}
