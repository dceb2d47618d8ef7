//! The browser of environment maps: the maps of a folder with thumbnails. A click gives the selected domes another map.

use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use egui::{Color32, ColorImage, RichText, ScrollArea, Ui, Vec2};
use winit::event_loop::EventLoopProxy;

use super::desk::Desk;
use super::desk::selection::Selection;
use super::load::LoadEvent;
use super::map_answer::{Answer, MapFile, ReadMap};
use super::map_reader::{Job, MapReader, THUMBNAIL};
use super::snapshots::Thumbnail;
use crate::scene::SkyMap;
use crate::scene::light_filter::Attached;

/// Size of a row, points.
const ROW: Vec2 = Vec2::new(330.0, THUMBNAIL[1] as f32 + 8.0);

/// The browser of environment maps.
pub struct MapBrowser {
    reader: MapReader,
    is_open: bool,
    folder: PathBuf,
    /// Whether the folder is to be listed.
    is_stale: bool,
    /// The files of the folder, or why it cannot be listed.
    rows: Result<Vec<Row>, String>,
    /// The rows that the last frame showed.
    in_sight: Range<usize>,
    /// A clicked map that has to be read first, and the selection that takes it.
    clicked: Option<(MapFile, Selection)>,
    /// Shown where there is no thumbnail.
    blank: Thumbnail,
}

/// A file in the list.
struct Row {
    file: MapFile,
    /// `None` until the file is read; an error says why it cannot be.
    thumbnail: Option<Result<Thumbnail, String>>,
}

impl MapBrowser {
    pub fn new(proxy: EventLoopProxy<LoadEvent>) -> Self {
        Self {
            reader: MapReader::new(proxy),
            is_open: false,
            folder: PathBuf::new(),
            is_stale: false,
            rows: Ok(Vec::new()),
            in_sight: 0..0,
            clicked: None,
            blank: Thumbnail::Fresh(ColorImage::filled([1, 1], Color32::from_gray(40))),
        }
    }

    /// Draws the browser if it is open. It lists the folder in which the primary light's map lies when it is opened, or
    /// else `folder`, that of the rig.
    pub fn show(&mut self, ui: &Ui, open: &mut bool, desk: &mut Desk, folder: &Path) {
        if *open && !self.is_open {
            let map = desk.selected_light().and_then(|light| light.map.as_ref()?.as_file());
            let folder = map.and_then(|map| map.path().parent()).unwrap_or(folder);
            let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
            self.folder = folder.canonicalize().unwrap_or(folder.to_owned());
            self.is_stale = true;
        }
        self.is_open = *open;
        self.in_sight = 0..0;
        let window = egui::Window::new("Environment maps").id("maps".into()).open(open).collapsible(false);
        let room = ui.available_rect_before_wrap().height() - 80.0;
        window.default_pos([8.0, 8.0]).resizable(false).show(ui.ctx(), |ui| {
            ui.set_width(ROW.x);
            ui.add(egui::Label::new(RichText::new(self.folder.to_string_lossy()).small()).truncate());
            self.list(ui, room, desk);
        });
        self.start_next();
    }

    fn list(&mut self, ui: &mut Ui, room: f32, desk: &mut Desk) {
        let rows = match &mut self.rows {
            Ok(rows) => rows,
            Err(reason) => {
                ui.label(&*reason);
                return;
            }
        };
        if rows.is_empty() && !self.is_stale && !self.reader.is_busy() {
            ui.label("there are no maps in this folder");
        }
        let current = desk.selected_light().and_then(|light| light.map.as_ref()?.as_file().cloned());
        let mut clicked = None;
        let area = ScrollArea::vertical().max_height(room).auto_shrink([false, true]);
        area.show_rows(ui, ROW.y, rows.len(), |ui, range| {
            self.in_sight = range.clone();
            for row in &mut rows[range] {
                let is_current = current.as_ref().is_some_and(|map| map.path() == row.file.path);
                if row.show(ui, &mut self.blank, is_current) {
                    clicked = Some(row.file.clone());
                }
            }
        });
        if let Some(file) = clicked {
            self.click(file, desk);
        }
    }

    /// Gives the selected domes a map: at once if it is kept, else when it is read.
    fn click(&mut self, file: MapFile, desk: &mut Desk) {
        match self.reader.kept(&file.path) {
            Some(map) => desk.set_map(Some(map)),
            None => {
                desk.message = format!("reading {}", file.name());
                self.clicked = Some((file, desk.selection().clone()));
            }
        }
    }

    /// Accepts what the thread did.
    pub fn accept(&mut self, answer: Answer, desk: &mut Desk) {
        self.reader.accept(&answer);
        match answer {
            Answer::Listed(folder, files) if folder == self.folder => self.set_files(files),
            Answer::Listed(..) => {}
            Answer::Read(file, outcome) => {
                match &outcome {
                    Ok(ReadMap { map: Some(map), .. }) => self.use_clicked(&file, map, desk),
                    Ok(ReadMap { map: None, .. }) => {} // if it was clicked meanwhile, it is read again
                    Err(reason) => {
                        if self.clicked.take_if(|(clicked, _)| *clicked == file).is_some() {
                            desk.message.clone_from(reason);
                        }
                    }
                }
                if let Some(row) = self.rows.iter_mut().flatten().find(|row| row.file == file) {
                    row.thumbnail = Some(outcome.map(|read| Thumbnail::Fresh(read.thumbnail)));
                }
            }
        }
        self.start_next();
    }

    /// Exchanges the map if it is the clicked one and the selection is still the same.
    fn use_clicked(&mut self, file: &MapFile, map: &Attached<SkyMap>, desk: &mut Desk) {
        let clicked = self.clicked.take_if(|(clicked, _)| clicked == file);
        if clicked.is_some_and(|(_, selection)| selection == *desk.selection()) {
            // It is an edit of its own, also during a drag.
            desk.end_gesture();
            desk.set_map(Some(map.clone()));
            desk.end_gesture();
        }
    }

    /// Replaces the list; thumbnails of files that were not written since stay.
    fn set_files(&mut self, files: Result<Vec<MapFile>, String>) {
        let old = std::mem::replace(&mut self.rows, Ok(Vec::new()));
        let mut old: HashMap<_, _> = old.into_iter().flatten().map(|row| (row.file.clone(), row)).collect();
        let mut row = |file| old.remove(&file).unwrap_or(Row { file, thumbnail: None });
        self.rows = files.map(|files| files.into_iter().map(&mut row).collect());
    }

    /// Starts the next job if the thread is free: the clicked map, then the list, then a thumbnail in sight.
    fn start_next(&mut self) {
        if self.reader.is_busy() {
            return;
        }
        let clicked = self.clicked.as_ref().map(|(file, _)| Job::Use(file.clone()));
        let list = || std::mem::take(&mut self.is_stale).then(|| Job::List(self.folder.clone()));
        let thumbnail = || {
            let in_sight = self.rows.as_ref().ok()?.get(self.in_sight.clone())?;
            let unread = in_sight.iter().find(|row| row.thumbnail.is_none())?;
            Some(Job::Show(unread.file.clone()))
        };
        if let Some(job) = clicked.or_else(list).or_else(thumbnail) {
            self.reader.start(job);
        }
    }
}

impl Row {
    /// Draws a row. Returns whether it was clicked.
    fn show(&mut self, ui: &mut Ui, blank: &mut Thumbnail, is_current: bool) -> bool {
        let mut name = RichText::new(self.file.name());
        let (thumbnail, hint) = match &mut self.thumbnail {
            Some(Ok(thumbnail)) => (thumbnail, None),
            Some(Err(reason)) => {
                name = name.color(ui.visuals().warn_fg_color);
                (blank, Some(&*reason))
            }
            None => (blank, None),
        };
        let size = Vec2::from(THUMBNAIL.map(|side| side as f32));
        let image = egui::Image::new(thumbnail.texture(ui)).maintain_aspect_ratio(false).fit_to_exact_size(size);
        let shown = ui.add(egui::Button::image_and_text(image, name).selected(is_current).truncate().min_size(ROW));
        let is_clicked = shown.clicked();
        if let Some(reason) = hint {
            shown.on_hover_text(reason);
        }
        is_clicked
    }
}
