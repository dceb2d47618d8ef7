//! The browser of environment maps: the maps of a folder with thumbnails. A click gives the selected domes another map.

use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use egui::{Color32, ColorImage, RichText, ScrollArea, Ui, Vec2};

use super::snapshots::Thumbnail;
use crate::desk::{Desk, TakesMap};
use crate::scene::SkyMap;
use crate::scene::light_filter::{Attached, RigFiles};
use crate::view::loading::load::Messenger;
use crate::view::loading::map_answer::{Answer, MapFile};
use crate::view::loading::map_reader::{Job, MapReader, THUMBNAIL};

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
    /// Maps that have to be read first, and what takes them.
    wanted: Vec<(MapFile, TakesMap)>,
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
    pub fn new(messenger: Messenger) -> Self {
        Self {
            reader: MapReader::new(messenger),
            is_open: false,
            folder: PathBuf::new(),
            is_stale: false,
            rows: Ok(Vec::new()),
            in_sight: 0..0,
            wanted: Vec::new(),
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
            self.want(file, TakesMap::Selection(desk.selection().clone()), desk);
        }
    }

    /// Gives `to` the environment map `name` in `folder`: at once if it is kept, else when it is read. Returns whether
    /// there is such a file.
    pub fn give(&mut self, folder: &Path, name: &str, to: TakesMap, desk: &mut Desk) -> bool {
        let path = RigFiles::new(folder).sky_map_path(name);
        match &path {
            Ok(path) => self.want(MapFile::new(path.clone()), to, desk),
            Err(error) => desk.message = error.chain(),
        }
        path.is_ok()
    }

    fn want(&mut self, file: MapFile, to: TakesMap, desk: &mut Desk) {
        if let Some(map) = self.reader.kept(&file.path) {
            return give(map, to, desk);
        }
        desk.message = format!("reading {}", file.name());
        if to != TakesMap::NewDome {
            self.wanted.retain(|(_, to)| *to == TakesMap::NewDome); // the last choice counts
        }
        self.wanted.push((file, to));
        self.start_next();
    }

    /// Accepts what the thread did.
    pub fn accept(&mut self, answer: Answer, desk: &mut Desk) {
        self.reader.accept(&answer);
        match answer {
            Answer::Listed(folder, files) if folder == self.folder => self.set_files(files),
            Answer::Listed(..) => {}
            Answer::Read(file, outcome) => {
                let map = outcome.as_ref().map(|read| read.map.clone());
                // A map that was wanted only while its thumbnail was made is read again.
                if let Some(map) = map.transpose() {
                    for (_, to) in self.wanted.extract_if(.., |(wanted, _)| *wanted == file) {
                        match &map {
                            Ok(map) => give_late(map.clone(), to, desk),
                            Err(reason) => desk.message.clone_from(reason),
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

    /// Replaces the list; thumbnails of files that were not written since stay.
    fn set_files(&mut self, files: Result<Vec<MapFile>, String>) {
        let old = std::mem::replace(&mut self.rows, Ok(Vec::new()));
        let mut old: HashMap<_, _> = old.into_iter().flatten().map(|row| (row.file.clone(), row)).collect();
        let mut row = |file| old.remove(&file).unwrap_or(Row { file, thumbnail: None });
        self.rows = files.map(|files| files.into_iter().map(&mut row).collect());
    }

    /// Starts the next job if the thread is free: a wanted map, then the list, then a thumbnail in sight.
    fn start_next(&mut self) {
        if self.reader.is_busy() {
            return;
        }
        let wanted = self.wanted.first().map(|(file, _)| Job::Use(file.clone()));
        let list = || std::mem::take(&mut self.is_stale).then(|| Job::List(self.folder.clone()));
        let thumbnail = || {
            let in_sight = self.rows.as_ref().ok()?.get(self.in_sight.clone())?;
            let unread = in_sight.iter().find(|row| row.thumbnail.is_none())?;
            Some(Job::Show(unread.file.clone()))
        };
        if let Some(job) = wanted.or_else(list).or_else(thumbnail) {
            self.reader.start(job);
        }
    }
}

fn give(map: Attached<SkyMap>, to: TakesMap, desk: &mut Desk) {
    match to {
        TakesMap::NewDome => desk.add_dome(map),
        TakesMap::Selection(selection) if selection == *desk.selection() => desk.set_map(Some(map)),
        TakesMap::Selection(_) => desk.message = "the map is read: select the dome again to give it to it".into(),
    }
}

/// Gives a map that has been waited for: an edit of its own, also during a drag.
fn give_late(map: Attached<SkyMap>, to: TakesMap, desk: &mut Desk) {
    desk.end_gesture();
    give(map, to, desk);
    desk.end_gesture();
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
