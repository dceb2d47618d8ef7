//! The window and everything that draws into it.

use std::sync::Arc;

use egui::ViewportId;
use winit::dpi::{LogicalSize, PhysicalSize};
use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

use super::ViewSettings;
use super::panel::controls::PANEL_WIDTH;
use crate::error::{Cause, Error, Result};
use crate::gpu::{Context, Frames, Surface, UiRenderer};
use crate::relight::choose_device;

/// Smallest height at which the panel is usable, points.
const MIN_HEIGHT: f64 = 700.0;

/// The window and what draws into it.
pub struct Graphics {
    pub ui: UiRenderer,
    pub egui: egui_winit::State,
    pub frames: Frames,
    pub surface: Surface,
    pub context: Arc<Context>,
    pub window: Arc<Window>,
    title: String,
}

impl Graphics {
    /// Opens a window with room for the panel and a picture of default size, since the scene is not known yet.
    pub fn new(event_loop: &ActiveEventLoop, settings: &ViewSettings) -> Result<Self> {
        let size = LogicalSize::new(720.0 + f64::from(PANEL_WIDTH), MIN_HEIGHT);
        let no_window = |source: Cause| Error::NoWindow { source };
        let title = format!("{} - relume", settings.name);
        let attributes = Window::default_attributes().with_title(&title).with_inner_size(size);
        let window = Arc::new(event_loop.create_window(attributes).map_err(|e| no_window(e.into()))?);
        let cache_dir = settings.pictures.cache_dir.as_deref();
        let device = choose_device(settings.pictures.device.as_deref(), cache_dir)?;
        let context = Context::for_display(device.as_deref(), settings.pictures.validation, cache_dir, &*window)?;
        let PhysicalSize { width, height } = window.inner_size();
        let surface = Surface::new(&context, window.clone(), [width, height], settings.vsync)?;
        let egui_context = egui::Context::default();
        egui_context.set_visuals(egui::Visuals::dark());
        egui_context.options_mut(|options| options.zoom_with_keyboard = false);
        egui_context.all_styles_mut(|style| {
            style.animation_time = 0.0;
            style.visuals.text_cursor.blink = false; // at rest nothing is drawn
        });
        let id = ViewportId::ROOT;
        let egui = egui_winit::State::new(egui_context, id, &window, Some(window.scale_factor() as f32), None, None);
        let ui = UiRenderer::new(&context, &surface)?;
        Ok(Self { ui, egui, frames: Frames::new(&context)?, surface, context, window, title })
    }

    pub fn pixels_per_point(&self) -> f32 {
        egui_winit::pixels_per_point(self.egui.egui_ctx(), &self.window)
    }

    pub fn set_title(&mut self, title: String) {
        if self.title != title {
            self.window.set_title(&title);
            self.title = title;
        }
    }

    /// Requests room for the picture at 1:1 and the panel, within the size of the monitor.
    pub fn make_room(&self, picture: [u32; 2]) {
        let scale = self.window.scale_factor();
        let [width, height] = picture.map(f64::from);
        let wanted = PhysicalSize::new(width + f64::from(PANEL_WIDTH) * scale, height.max(MIN_HEIGHT * scale));
        let room = self.window.current_monitor().map_or(wanted, |monitor| monitor.size().cast());
        // If the system refuses, the picture is fitted.
        let _ = self.window.request_inner_size(PhysicalSize::new(
            wanted.width.min(0.95 * room.width),
            wanted.height.min(0.9 * room.height),
        ));
    }
}
