//! Pictures of an open scene: what the next frame shows, and when another one is due.

use std::time::Instant;

use super::{OpenScene, Pointer, ShotDisplay};
use crate::error::Result;
use crate::gpu::{Placement, Screen};
use crate::relight::output::exposure;
use crate::relight::output::inspect::Inspection;
use crate::relight::output::sheet::Grid;
use crate::relight::{Detail, Layers, Picture, Request, ToneMap};
use crate::view::input::pick::pixel;
use crate::view::overlay::aids::{self, OverlayInfo};
use crate::view::still::Still;
use crate::view::view_state::ViewState;
use crate::view::views::{Aid, View};

/// What determines a picture, besides its samples.
#[derive(PartialEq)]
pub(super) struct Shown {
    /// Of the desk's lights.
    version: u64,
    layers: Layers,
    picture: Picture,
    exposure: f32,
    curve: ToneMap,
}

impl OpenScene {
    /// Draws the chosen view and updates [`Self::overlay`] for it.
    pub fn draw(&mut self, view: &ViewState, pointer: Pointer, screen: Screen) -> Result<()> {
        self.shows_light_view = view.show_light_view;
        let display = || ShotDisplay { exposure: view.exposure, tone_map: view.curve() };
        self.shot_display = view.show_shots.then(display);
        self.update_autosave();
        let size = self.picture_size();
        let under_mouse = pointer.at.and_then(|at| pixel(pointer.placement, size, at));
        let probe = under_mouse.filter(|_| view.views.has(Aid::Probe));
        self.overlay = OverlayInfo::default();
        let Some((layers, picture)) = view.views.view.picture(self.desk.selected()) else {
            return self.draw_still(view, probe, screen);
        };
        let start = Instant::now();
        let detail = self.detail_control.detail(start);
        let edited = self.drawn.replace(self.desk.version()) != Some(self.desk.version());
        let mut request = Request {
            picture,
            layers,
            detail,
            most_points: self.detail_control.most_points(),
            exposure: view.exposure,
            tone_map: view.curve(),
            inspection: Inspection { histogram: view.views.has(Aid::Histogram), probe },
        };
        let shown =
            Shown { version: self.desk.version(), layers, picture, exposure: view.exposure, curve: view.curve() };
        let lights = self.shown.as_ref().filter(|(before, _)| *before == shown).map(|(_, lights)| *lights);
        self.waits_for_lights = match lights.filter(|_| view.comparing.is_none()) {
            Some(lights) => self.make_images(&mut request)? < lights,
            None => false,
        };
        if edited {
            self.converge.restart(start);
            self.final_gathering.restart(start);
        } else if !self.relighter.is_coarse() && !self.waits_for_indirect() {
            self.converge.step(&self.opened, self.desk.rig())?;
            if layers == Layers::All && self.converge.is_done(&self.opened, self.desk.rig()) {
                self.gather_step()?;
            }
        }
        let is_better = self.converge.is_done(&self.opened, self.desk.rig()) && !self.final_gathering.catches_up();
        // The gathering of a picture that is coarse does not go on.
        let is_coarse = self.relighter.is_coarse() && !self.waits_for_lights;
        if edited || layers != Layers::All || is_better || is_coarse {
            self.waits_for_operator = false;
        }
        if self.waits_for_lights {
            self.overlay.lights = self.relighter.lights_shown();
        }
        if self.waits_for_operator || self.waits_for_lights {
            _ = self.converge.ready(&self.opened, self.desk.rig(), layers)?;
            return match self.converge.relighter_mut().filter(|_| self.is_refined) {
                Some(refined) => refined.show_again(screen),
                None => self.relighter.show_again(screen),
            };
        }
        let comparing = self.compare(view, screen.surface.wants_blue_first())?;
        // Both sides of a comparison use the same samples.
        let refined = match comparing {
            Some(_) => None,
            None => self.converge.ready(&self.opened, self.desk.rig(), layers)?,
        };
        self.is_refined = refined.is_some();
        let relighter = match refined {
            Some(refined) => {
                refined.set_changes(self.final_gathering.changes())?;
                refined.select(self.desk.history().focus());
                refined
            }
            None => {
                self.sync_lights()?;
                self.layers = layers;
                self.relighter.set_changes(self.final_gathering.changes())?;
                &mut self.relighter
            }
        };
        if self.is_refined {
            (request.detail, request.most_points) = (Detail::Exact, usize::MAX);
        }
        let comparison = comparing.and_then(|comparing| Some(self.comparison_image.as_ref()?.overlay(comparing.kind)));
        relighter.show(request, Screen { comparison, ..screen })?;
        self.overlay.histogram = relighter.histogram().map(<[u32]>::to_vec);
        self.overlay.is_coarse = relighter.is_coarse();
        self.overlay.lights = relighter.lights_shown();
        if let Some((pixel, radiance)) = relighter.probed() {
            self.overlay.probe = aids::radiance_lines(pixel, radiance, view.exposure);
        }
        self.overlay.gathering = self.final_gathering.state();
        self.overlay.progress = self.converge.progress(&self.opened, self.desk.rig());
        let lights = self.overlay.lights.map_or(usize::MAX, |[lights, _]| lights);
        // Coarse pictures go on with sums that lack lights.
        self.shown = (detail != Detail::Coarse).then_some((shown, lights));
        if !self.is_refined {
            self.detail_control.shaded(self.relighter.points_in_rest(), self.relighter.times());
        }
        if self.times().iter().any(|pass| pass.name == "shade light") {
            self.detail_control.shown(Instant::now(), edited, detail, start.elapsed());
        }
        Ok(())
    }

    /// Draws a view of data.
    fn draw_still(&mut self, view: &ViewState, probe: Option<[u32; 2]>, screen: Screen) -> Result<()> {
        let blue_first = screen.surface.wants_blue_first();
        let context = self.relighter.context();
        let errors = (&self.final_gathering, self.relighter.rig());
        let still = Still::get(self.still.take(), context, &self.opened, &view.views, blue_first, errors)?;
        self.relighter.show_still(still.pixels(), screen)?;
        if let Some([x, y]) = probe {
            let value = still.value([x, y]).map_or("no value".into(), |v| match v.x == v.y && v.y == v.z {
                true => aids::short(v.x),
                false => v.to_array().map(aids::short).join("  "),
            });
            self.overlay.probe = vec![format!("pixel {x}, {y}"), format!("{}: {value}", view.views.title())];
        }
        self.overlay.gathering = self.final_gathering.state();
        self.still = Some(still);
        Ok(())
    }

    /// Makes images of lights for the whole picture, if there may be lights without image; the request then begins no
    /// more. Returns how many lights have one; `usize::MAX` for all.
    fn make_images(&mut self, request: &mut Request) -> Result<usize> {
        if request.picture != Picture::Whole
            || self.relighter.was_whole()
            || self.converge.ready(&self.opened, self.desk.rig(), request.layers)?.is_some()
        {
            return Ok(usize::MAX);
        }
        self.sync_lights()?;
        self.layers = request.layers;
        self.relighter.set_changes(self.final_gathering.changes())?;
        self.relighter.advance(request.clone())?;
        request.most_points = 0;
        self.detail_control.shaded(self.relighter.points_in_rest(), self.relighter.times());
        Ok(self.relighter.lights_shown().map_or(usize::MAX, |[lights, _]| lights))
    }

    /// Draws the aids over the picture; `scale` is physical pixels per point.
    pub fn draw_aids(&self, ui: &egui::Ui, view: &ViewState, placement: Placement, scale: f32) {
        let size = self.picture_size();
        let point = |x: f32, y: f32| {
            let left = placement.left as f32 + x * placement.width as f32;
            let top = placement.top as f32 + y * placement.height as f32;
            egui::Pos2::new(left / scale, top / scale)
        };
        aids::draw(ui, &view.views, &self.overlay, point(0.0, 1.0));
        if view.views.view == View::Lights {
            let grid = Grid::new(self.desk.rig().lights.len(), size);
            let at = |[x, y]: [u32; 2]| point(x as f32 / size[0] as f32, y as f32 / size[1] as f32);
            aids::sheet_names(ui, &self.desk, grid, at);
        }
        if view.panel || view.overlay {
            let is_named = !matches!(view.views.view, View::Beauty | View::Lights);
            let name = is_named.then(|| view.views.title());
            let state = self.overlay.state();
            let text: Vec<String> = name.into_iter().chain(state).collect();
            if !text.is_empty() {
                aids::title(ui, &text.join("  -  "), point(0.5, 0.0));
            }
        }
    }

    /// Whether the picture is coarse and not completed yet.
    pub fn is_coarse(&self) -> bool {
        self.waits_for_lights || (!self.is_refined && self.relighter.is_coarse())
    }

    /// Returns when refinement of the picture continues, if no event comes before; `None` if it is complete.
    pub fn next_step_at(&self, view: &ViewState) -> Option<Instant> {
        let (layers, _) = view.views.view.picture(None)?;
        match self.is_coarse() {
            true => self.detail_control.exact_due_at(),
            false if self.waits_for_indirect() => None,
            false => {
                let shows_progress = view.panel || view.overlay;
                let edges = self.converge.next_step_at(&self.opened, self.desk.rig(), shows_progress);
                // Gathering reads the whole picture; images of some layers would be made again each time.
                edges.or_else(|| self.final_gathering.next_step_at(&self.opened).filter(|_| layers == Layers::All))
            }
        }
    }

    /// Chooses the exposure for the current lights, as far as they have images.
    pub fn choose_exposure(&mut self, view: &mut ViewState) -> Result<()> {
        self.sync_lights()?;
        let (layers, most_points) = (self.layers, self.detail_control.most_points());
        let request = Request { layers, most_points, detail: Detail::Progressive, ..Request::default() };
        view.exposure = exposure::automatic(self.relighter.linear(request)?);
        view.provisional_exposure = self.relighter.lights_shown().map(|[shown, _]| (view.exposure, shown));
        Ok(())
    }

    /// Whether the exposure was chosen for a picture with at most half of the lights that it has now.
    pub fn needs_exposure(&self, view: &ViewState) -> bool {
        let picture = view.views.view.picture(self.desk.selected()).map(|(_, picture)| picture);
        picture == Some(Picture::Whole)
            && view.provisional_exposure.is_some_and(|(exposure, of)| {
                exposure == view.exposure && self.relighter.lights_shown().is_none_or(|[shown, _]| shown >= 2 * of)
            })
    }
}
