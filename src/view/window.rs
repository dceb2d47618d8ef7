//! The event loop: pending events become one edit, and one edit becomes one frame.

mod loading;

use std::time::{Duration, Instant};

use egui::{Event, ViewportId};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Fullscreen, WindowId};

use super::graphics::Graphics;
use super::input::action::Action;
use super::input::keys::Command;
use super::input::pick::placement;
use super::input::script::Script;
use super::input::state::{InputContext, InputResult, InputState};
use super::interface::{Interface, loading_bar};
use super::loading::load::{LoadEvent, Messenger, Numbered, SceneSource};
use super::loading::loads::Loads;
use super::open_scene::{Flow, OpenScene, Pointer};
use super::panel::controls::PANEL_WIDTH;
use super::remote::Remote;
use super::timings::Timings;
use super::view_state::{Dialog, ViewState};
use super::{Latency, LoadedScene, ViewReport, ViewSettings};
use crate::error::{Cause, Error, Result};
use crate::gpu::{PassTime, Placement, Screen, UiFrame};

/// Opens a window and runs it until it is closed. The scene is loaded and baked on a thread of its own. Fails if no
/// window can be opened or the scene cannot be loaded.
pub fn run(settings: ViewSettings, source: SceneSource) -> Result<ViewReport> {
    let no_window = |source: Cause| Error::NoWindow { source };
    let event_loop = EventLoop::<Numbered>::with_user_event().build().map_err(|e| no_window(e.into()))?;
    let mut app = App::new(settings, event_loop.create_proxy(), source)?;
    event_loop.run_app(&mut app).map_err(|e| no_window(e.into()))?;
    app.finish()
}

struct App {
    settings: ViewSettings,
    loads: Loads,
    /// Other programs; `None` if they cannot connect.
    remote: Option<Remote>,
    began: Instant,
    device_time: Duration,
    view: ViewState,
    /// Dropped before `graphics`, whose device it uses.
    open_scene: Option<OpenScene>,
    graphics: Option<Graphics>,
    /// Current step of the loading thread, and its progress from 0 to 1.
    loading: Option<(&'static str, f32)>,
    input: InputState,
    /// Time of the first event that no frame has shown yet.
    pending: Option<Instant>,
    /// Whether something changed that no frame has shown yet.
    stale: bool,
    /// Whether we requested the next redraw. Otherwise the system requests it because it lost the window's contents.
    asked: bool,
    /// Time at which egui wants to draw the interface again.
    wake: Option<Instant>,
    /// Number of interface frames since the last event.
    idle_ui_frames: u32,
    /// Time at which idle work starts, if there may be any.
    idle_work_at: Option<Instant>,
    /// Whether idle work has a result that no frame has shown yet.
    idle_work_unshown: bool,
    first_picture: Option<Instant>,
    /// Time of the first picture with indirect light.
    first_indirect: Option<Instant>,
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
const MAX_IDLE_UI_FRAMES: u32 = 2;
/// Shortest delay before an interface frame without an event. egui requests one after most events; if another event
/// comes first, its frame serves.
const IDLE_UI_DELAY: Duration = Duration::from_millis(40);

/// Time after a frame at which idle work starts.
const IDLE_DELAY: Duration = Duration::from_millis(150);

impl App {
    fn new(mut settings: ViewSettings, proxy: EventLoopProxy<Numbered>, source: SceneSource) -> Result<Self> {
        let pictures = &mut settings.pictures;
        let displays = pictures.displays.take();
        let view = ViewState::new(pictures.exposure.unwrap_or(0.0), pictures.tone_map.clone(), displays);
        let messenger = Messenger::new(move |message| proxy.send_event(message).is_ok());
        let remote = settings.listen.as_ref().map(|file| Remote::listen(file, messenger.clone())).transpose()?;
        Ok(Self {
            settings,
            loads: Loads::new(source, messenger),
            remote,
            began: Instant::now(),
            device_time: Duration::ZERO,
            view,
            open_scene: None,
            graphics: None,
            loading: Some(("loading", 0.0)),
            input: InputState::default(),
            pending: None,
            stale: true,
            asked: false,
            wake: None,
            idle_ui_frames: 0,
            idle_work_at: None,
            idle_work_unshown: false,
            first_picture: None,
            first_indirect: None,
            played: 0,
            recorded: Script::default(),
            timings: Timings::default(),
            frames: 0,
            trace: Vec::new(),
            outcome: Ok(()),
        })
    }

    fn finish(mut self) -> Result<ViewReport> {
        let (relit_frames, latency) = self.timings.relit();
        let info = self.graphics.as_ref().map(|graphics| graphics.context.info.clone());
        // Dropped before the graphics, whose device it uses.
        let open_scene = self.open_scene.take();
        let gathering = open_scene.as_ref().map(OpenScene::gathering);
        self.outcome?; // after an error the autosave file remains
        let is_answered = !matches!(self.view.dialog, Some(Dialog::Recover(_)));
        open_scene.filter(|_| is_answered).map_or(Ok(()), OpenScene::close)?;
        if let Some(path) = &self.settings.record {
            self.recorded.save(path)?;
        }
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        Ok(ViewReport {
            device: info.as_ref().map(|info| info.name.clone()).unwrap_or_default(),
            driver: info.map(|info| info.driver).unwrap_or_default(),
            first_picture_ms: self.first_picture.map(|at| ms(at - self.began)),
            first_indirect_ms: self.first_indirect.map(|at| ms(at - self.began)),
            device_ms: ms(self.device_time),
            frames: self.frames,
            relit_frames,
            coarse_frames: self.timings.coarse_frames(),
            latency_ms: latency.map(|[best, median, p95]| Latency { best, median, p95 }),
            passes: self.timings.median_passes(),
            gathering,
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

    fn open(&mut self, opened: LoadedScene) -> Result<()> {
        let Some(graphics) = &self.graphics else { return Ok(()) };
        let start = Instant::now();
        let mut open_scene = OpenScene::new(&graphics.context, opened, &self.settings, self.loads.messenger())?;
        self.device_time += start.elapsed();
        if self.settings.pictures.exposure.is_none() {
            open_scene.choose_exposure(&mut self.view)?;
        }
        graphics.make_room(open_scene.picture_size());
        open_scene.ask_to_recover(&mut self.view);
        if let Some(remote) = &mut self.remote {
            remote.opened(&mut open_scene);
        }
        self.open_scene = Some(open_scene);
        self.stale = true;
        Ok(())
    }

    /// Returns the current position of the picture in the window.
    fn placement(&self) -> Placement {
        let (Some(graphics), Some(open_scene)) = (&self.graphics, &self.open_scene) else {
            return Placement::default();
        };
        let PhysicalSize { width, height } = graphics.window.inner_size();
        let panel = if self.view.panel { (PANEL_WIDTH * graphics.pixels_per_point()).ceil() as u32 } else { 0 };
        let area = [width.saturating_sub(panel), height];
        placement(open_scene.picture_size(), area, self.view.one_to_one, self.input.pan.map(|x| x as i32))
    }

    fn pointer(&self) -> Pointer {
        let scale = self.graphics.as_ref().map_or(1.0, Graphics::pixels_per_point);
        Pointer { placement: self.placement(), at: self.input.at.map(|at| [at.x * scale, at.y * scale]) }
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
    fn frame(&mut self) -> Result<Flow> {
        let Some(graphics) = &mut self.graphics else { return Ok(Flow::Continue) };
        let mut raw_input = graphics.egui.take_egui_input(&graphics.window);
        self.play(&mut raw_input.events);
        if let (Some(start), Some(_)) = (self.first_picture, &self.settings.record) {
            raw_input.events.iter().for_each(|event| self.recorded.record(start.elapsed(), event));
        }
        let actions = self.take_events(&mut raw_input.events);
        let had_events = !raw_input.events.is_empty();
        let mut flow = self.act(&actions)?;
        if let Some(open_scene) = self.open_scene.as_mut().filter(|open_scene| open_scene.needs_exposure(&self.view)) {
            open_scene.choose_exposure(&mut self.view)?;
        }
        let has_ui = self.view.has_ui() || self.open_scene.is_none();
        let drawn = if has_ui {
            let (ui, actions) = self.run_ui(raw_input)?;
            self.input.dialog_is_shown = self.view.dialog.is_some();
            self.idle_ui_frames = if had_events { 0 } else { self.idle_ui_frames + 1 };
            if self.idle_ui_frames > MAX_IDLE_UI_FRAMES {
                self.wake = None; // egui would request frames forever
            }
            if !actions.is_empty() {
                if self.act(&actions)? == Flow::Quit {
                    flow = Flow::Quit;
                }
                self.ask_for_frame(); // to show their result in the interface
            }
            Some(ui)
        } else {
            None
        };
        if flow == Flow::Quit || !(self.stale || has_ui) {
            self.pending = None;
            return Ok(flow);
        }
        self.tell_of_dome();
        self.start_shots();
        self.draw(drawn.as_ref())?;
        Ok(flow)
    }

    /// Tells the loading thread once that the rig has a dome: it then bakes light of the sky.
    fn tell_of_dome(&mut self) {
        let has_domes = self.open_scene.as_ref().is_some_and(|open_scene| open_scene.desk.rig().has_domes());
        if let Some(first_dome) = self.loads.thread.first_dome.take_if(|_| has_domes) {
            let _ = first_dome.send(()); // fails if the thread has ended: there is no indirect light
        }
    }

    /// Returns the actions of the events and removes the events that they consume.
    fn take_events(&mut self, events: &mut Vec<Event>) -> Vec<Action> {
        let pointer = self.pointer();
        let graphics = self.graphics.as_ref().expect("frames begin with graphics");
        let egui = graphics.egui.egui_ctx();
        let is_typed_to = egui.egui_wants_keyboard_input() && self.view.has_ui();
        let ui_wants_keys = self.view.dialog.is_some() || is_typed_to;
        self.input.postpone_after_focus_change(events, self.view.dialog.as_ref(), ui_wants_keys);
        let context = InputContext {
            open_scene: self.open_scene.as_mut(),
            view: &self.view,
            pointer,
            pixels_per_point: graphics.pixels_per_point(),
            ui_wants_keys,
            ui_wants_pointer: egui.egui_wants_pointer_input(),
        };
        let InputResult { actions, stale } = self.input.take(events, context);
        self.stale |= stale;
        actions
    }

    fn act(&mut self, actions: &[Action]) -> Result<Flow> {
        for action in actions {
            self.stale = true;
            if let (Action::Do(Command::FullScreen), Some(graphics)) = (action, &self.graphics) {
                let window = &graphics.window;
                window.set_fullscreen(window.fullscreen().is_none().then_some(Fullscreen::Borderless(None)));
            }
            match action {
                Action::Do(Command::NextCamera) => self.step_camera(1),
                Action::Do(Command::PreviousCamera) => self.step_camera(-1),
                Action::Do(Command::Camera(camera)) => self.look_from(*camera),
                _ => {}
            }
            let pointer = self.pointer();
            let flow = match &mut self.open_scene {
                Some(open_scene) => open_scene.act(action, &mut self.view, pointer)?,
                None if *action == Action::Do(Command::Quit) => Flow::Quit,
                None => Flow::Continue,
            };
            if flow == Flow::Quit {
                return Ok(flow);
            }
        }
        Ok(Flow::Continue)
    }

    /// Runs the interface once. Returns its frame and the requested actions.
    fn run_ui(&mut self, raw_input: egui::RawInput) -> Result<(UiFrame, Vec<Action>)> {
        let placement = self.placement();
        let graphics = self.graphics.as_mut().expect("frames begin with graphics");
        let (view, open_scene, timings) = (&mut self.view, &mut self.open_scene, &self.timings);
        let (name, loading) = (&self.settings.name, self.loading);
        let budget_ms = self.settings.frame_budget.as_secs_f64() * 1e3;
        let context = graphics.egui.egui_ctx().clone();
        let scale = graphics.pixels_per_point();
        let mut actions = Vec::new();
        let output = context.run_ui(raw_input, |ui| match open_scene {
            None => loading_bar(ui, name, loading.unwrap_or_default()),
            Some(open_scene) => {
                let view = &mut *view;
                Interface { open_scene, view, timings, name, loading, budget_ms, placement, scale }
                    .draw(ui, &mut actions);
            }
        });
        graphics.egui.handle_platform_output(&graphics.window, output.platform_output);
        graphics.ui.update_textures(&output.textures_delta)?;
        let delay = output.viewport_output.get(&ViewportId::ROOT).map_or(Duration::MAX, |v| v.repaint_delay);
        self.wake = Instant::now().checked_add(delay.max(IDLE_UI_DELAY)).filter(|_| delay < Duration::from_secs(3600));
        let primitives = context.tessellate(output.shapes, output.pixels_per_point);
        Ok((UiFrame { primitives, pixels_per_point: output.pixels_per_point }, actions))
    }

    /// Does one short step of idle work; events are handled between steps.
    fn idle_step(&mut self) -> Result<Flow> {
        let Some(open_scene) = &mut self.open_scene else { return Ok(Flow::Continue) };
        match open_scene.idle_step()? {
            true => {
                self.idle_work_at = Some(Instant::now());
                self.idle_work_unshown = true;
            }
            false if std::mem::take(&mut self.idle_work_unshown) && self.view.has_ui() => self.ask_for_frame(),
            false => {}
        }
        Ok(Flow::Continue)
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
            comparison: None,
            ui: ui.map(|frame| (&mut graphics.ui, frame)),
        };
        let mut passes = None;
        let (mut overlay_changed, mut needs_exposure, mut coarse) = (false, false, false);
        match &mut self.open_scene {
            Some(open_scene) => {
                let overlay = open_scene.overlay.clone();
                let began_ms = self.began.elapsed().as_secs_f64() * 1e3;
                open_scene.draw(&self.view, pointer, screen)?;
                if self.settings.trace {
                    self.trace.push((began_ms, open_scene.times().to_vec()));
                }
                coarse = open_scene.is_coarse();
                overlay_changed = open_scene.overlay != overlay;
                needs_exposure = open_scene.needs_exposure(&self.view);
                passes = Some(open_scene.times()).filter(|times| times.iter().any(|pass| pass.name == "composite"));
                let star = if open_scene.desk.is_unsaved() { "*" } else { "" };
                let message = &open_scene.desk.message;
                graphics.set_title(format!("{}{star} - {message} - relume", self.settings.name));
                if self.first_picture.is_none() {
                    self.first_picture = Some(Instant::now());
                    self.pending = None; // the first picture is no edit
                }
                if open_scene.opened.transfer.is_some() {
                    self.first_indirect.get_or_insert_with(Instant::now);
                }
                if let Some(remote) = &mut self.remote {
                    remote.drawn(open_scene);
                }
            }
            None => {
                let mut frame = graphics.frames.begin()?;
                frame.draw(&mut screen, None)?;
                frame.finish_on(screen.surface)?;
            }
        }
        self.frames += 1;
        let delay = if self.view.show_shots { Duration::ZERO } else { IDLE_DELAY };
        self.idle_work_at = Some(Instant::now() + delay);
        self.stale = graphics.surface.lost_picture() || needs_exposure;
        if let Some(event) = self.pending.take() {
            self.timings.frame(event, passes, coarse);
        }
        if self.stale || overlay_changed {
            self.ask_for_frame();
        }
        Ok(())
    }

    /// Ends the loop on quit or on an error.
    fn check(&mut self, outcome: Result<Flow>, event_loop: &ActiveEventLoop) {
        match outcome {
            Ok(Flow::Continue) => {}
            Ok(Flow::Quit) => event_loop.exit(),
            Err(error) => {
                self.outcome = Err(error);
                event_loop.exit();
            }
        }
    }
}

impl ApplicationHandler<Numbered> for App {
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

    fn user_event(&mut self, event_loop: &ActiveEventLoop, Numbered { scene, shot, event }: Numbered) {
        if let Some(shot) = shot {
            let take = |open_scene: &mut OpenScene| open_scene.shot_sheet.take(shot, scene, event);
            let outcome = self.open_scene.as_mut().map_or(Ok(()), take);
            self.ask_for_frame();
            return self.check(outcome.map(|()| Flow::Continue), event_loop);
        }
        if !self.loads.concerns(scene, &event) {
            return;
        }
        match event {
            LoadEvent::Progress { what, share } => {
                self.loading = Some((what, share));
                if let Some(remote) = &self.remote {
                    remote.progress(what, share);
                }
                if let Some(open_scene) = &mut self.open_scene {
                    open_scene.is_baking = true;
                }
            }
            LoadEvent::Opened(opened) => {
                let change = self.loads.opened(opened);
                self.change(change, event_loop);
            }
            LoadEvent::Transfer(transfer) => {
                let change = self.loads.has_transfer(transfer);
                self.change(change, event_loop);
                if let (Some(remote), true) = (&mut self.remote, self.loads.is_shown()) {
                    remote.host.indirect(false);
                }
            }
            LoadEvent::EdgesRefined(refinement) => {
                if let Some(open_scene) = &mut self.open_scene {
                    open_scene.accept_refinement(refinement.map(|refinement| *refinement));
                }
                self.stale = true;
            }
            LoadEvent::Gathered(gathered) => {
                let accept =
                    |open_scene: &mut OpenScene| open_scene.accept_gathered(gathered.map(|gathered| *gathered));
                let outcome = self.open_scene.as_mut().map_or(Ok(()), accept);
                self.stale = true;
                self.check(outcome.map(|()| Flow::Continue), event_loop);
            }
            LoadEvent::Maps(answer) => {
                if let Some(open_scene) = &mut self.open_scene {
                    open_scene.accept_maps(*answer);
                }
                self.stale = true;
            }
            LoadEvent::Ended(outcome) => self.loading_ended(outcome, event_loop),
            LoadEvent::Wire(inbound) => {
                let Some(remote) = &mut self.remote else { return };
                if let Some(pending) = remote.take(inbound, self.open_scene.as_mut(), &self.view) {
                    remote.reloads(pending);
                    self.reload();
                }
                self.stale = true;
                self.pending.get_or_insert_with(Instant::now);
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
                if self.input.has_more() {
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
        let next_step = self.open_scene.as_ref().and_then(|open_scene| open_scene.next_step_at(&self.view));
        let is_due = next_step.as_ref().is_some_and(due);
        self.stale |= is_due;
        if is_due || self.wake.as_ref().is_some_and(due) || self.next_scripted().as_ref().is_some_and(due) {
            self.wake = None;
            self.ask_for_frame();
        }
        if self.idle_work_at.as_ref().is_some_and(due) {
            self.idle_work_at = None;
            let outcome = self.idle_step();
            self.check(outcome, event_loop);
        }
        let next = [self.wake, self.idle_work_at, self.next_scripted(), next_step]
            .into_iter()
            .flatten()
            .filter(|at| !due(at))
            .min();
        event_loop.set_control_flow(next.map_or(ControlFlow::Wait, ControlFlow::WaitUntil));
    }
}
