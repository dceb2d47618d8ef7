//! A thread that lists and reads environment maps, one job at a time, so that no frame waits for a file. Some maps that
//! it read are kept, so that they are exchanged at once.

use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

use egui::{Color32, ColorImage};

use super::load::{LoadEvent, Messenger};
use super::map_answer::{Answer, MapFile, ReadMap};
use crate::relight::ToneMap;
use crate::relight::output::exposure;
use crate::scene::SkyMap;
use crate::scene::light_filter::{Attached, RigFiles};
use crate::scene::sky_map::maps_in;

/// Size of a thumbnail, pixels.
pub const THUMBNAIL: [usize; 2] = [128, 64];
/// Number of maps that are kept; the largest take 170 MB each.
const MAX_KEPT: usize = 4;

/// The thread's owner, and the maps that are kept.
pub struct MapReader {
    messenger: Messenger,
    is_busy: bool,
    /// The map that was used last is the last one.
    kept: Vec<(MapFile, Attached<SkyMap>)>,
}

/// A job of the thread.
pub enum Job {
    /// Of a folder.
    List(PathBuf),
    /// Makes the thumbnail of a file.
    Show(MapFile),
    /// Reads a map for a light, too.
    Use(MapFile),
}

impl MapReader {
    pub fn new(messenger: Messenger) -> Self {
        Self { messenger, is_busy: false, kept: Vec::new() }
    }

    pub fn is_busy(&self) -> bool {
        self.is_busy
    }

    /// Starts a job; the thread must not be busy. Its [`Answer`] goes to the event loop.
    pub fn start(&mut self, job: Job) {
        assert!(!self.is_busy, "one job at a time");
        self.is_busy = true;
        let keeps = matches!(job, Job::Use(_)) || self.kept.len() < MAX_KEPT;
        let makes_room = matches!(job, Job::Use(_)) && self.kept.len() == MAX_KEPT;
        let oldest = makes_room.then(|| self.kept.remove(0));
        let messenger = self.messenger.clone();
        // Not joined, so that closing the window does not wait for it.
        std::thread::spawn(move || {
            drop(oldest); // takes a while
            let answer = match job {
                Job::List(folder) => {
                    let files = maps_in(&folder).map(|paths| paths.into_iter().map(MapFile::new).collect());
                    Answer::Listed(folder, files.map_err(|error| error.chain()))
                }
                Job::Show(file) | Job::Use(file) => {
                    let read = catch_unwind(|| read(&file.path, keeps));
                    Answer::Read(file, read.unwrap_or_else(|_| Err("its decoder failed".into())))
                }
            };
            // Fails only after the window is closed.
            let _ = messenger.send(LoadEvent::Maps(Box::new(answer)));
        });
    }

    /// Notes that the thread has answered, and keeps the map that it read.
    pub fn accept(&mut self, answer: &Answer) {
        self.is_busy = false;
        if let Answer::Read(file, Ok(ReadMap { map: Some(map), .. })) = answer {
            self.kept.push((file.clone(), map.clone()));
        }
    }

    /// A map that was kept, if the file is still the same.
    pub fn kept(&mut self, path: &Path) -> Option<Attached<SkyMap>> {
        let file = MapFile::new(path.to_owned());
        let at = self.kept.iter().position(|(kept, _)| *kept == file)?;
        let used = self.kept.remove(at);
        self.kept.push(used);
        self.kept.last().map(|(_, map)| map.clone())
    }
}

/// Reads a map and makes its thumbnail.
fn read(path: &Path, keeps: bool) -> Result<ReadMap, String> {
    let map = RigFiles::new(Path::new("")).sky_map(&path.to_string_lossy()).map_err(|error| error.chain())?;
    let thumbnail = thumbnail(&map);
    if keeps {
        map.parts(); // made here rather than in a frame
    }
    Ok(ReadMap { thumbnail, map: keeps.then_some(map) })
}

/// A small picture of a map with automatic exposure.
fn thumbnail(map: &SkyMap) -> ColorImage {
    let [width, height] = THUMBNAIL;
    let share = |i: usize, of: usize| (i as f32 + 0.5) / of as f32;
    let radiance = |i: usize| map.blurred_at([share(i % width, width), share(i / width, height)]);
    let pixels: Vec<[f32; 3]> = (0..width * height).map(|i| radiance(i).to_array()).collect();
    let exposure = exposure::automatic(&pixels).exp2();
    let exposed = pixels.into_iter().map(|pixel| pixel.map(|value| exposure * value)).collect();
    let color = |[r, g, b]: [u8; 3]| Color32::from_rgb(r, g, b);
    ColorImage::new(THUMBNAIL, ToneMap::Agx.display8(exposed).into_iter().map(color).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thumbnails_show_the_map_and_errors_say_why_not() {
        let folder = tempfile::tempdir().expect("there is room");
        let path = folder.path().join("halves.png");
        // Green at the top, blue below.
        let texels: Vec<[u8; 3]> = (0..16 * 8).map(|i| if i < 64 { [0, 200, 0] } else { [0, 0, 200] }).collect();
        crate::image::png::write(&path, 16, 8, &texels).expect("there is room");
        let read_map = read(&path, true).expect("it is a map");
        let [top, bottom] = [4, 60].map(|y| read_map.thumbnail[(64, y)]);
        let is_more = |a: u8, b: u8| a > b.saturating_add(40);
        assert!(is_more(top.g(), top.b()) && is_more(bottom.b(), bottom.g()), "{top:?} {bottom:?}");
        assert!(read_map.map.is_some() && read(&path, false).expect("it is a map").map.is_none());

        let broken = folder.path().join("broken.hdr");
        std::fs::write(&broken, "#?RADIANCE\n").expect("there is room");
        let error = read(&broken, false).err().expect("it is no map");
        assert!(error.contains("broken.hdr"), "{error}");
    }
}
