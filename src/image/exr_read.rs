//! Reads the RGB and grey layers of an EXR file with any parts, tiles, compression and sample types.

use std::collections::HashSet;
use std::io::BufReader;
use std::path::Path;

use exr::block::UncompressedBlock;
use exr::block::chunk::{Chunk, CompressedBlock};
use exr::block::lines::LineRef;
use exr::block::reader::ChunksReader;
use exr::compression::Compression;
use exr::error::{Error as ExrError, Result as ExrResult};
use exr::math::Vec2;
use exr::meta::attribute::{Chromaticities, IntegerBounds, SampleType};
use exr::meta::header::Header;
use glam::{DMat3, DVec2};
use rayon::prelude::*;

use super::primaries::Primaries;
use super::{Image, Layer};
use crate::error::{Error, Result};
use crate::storage::file;

/// Size limit: 8192 x 4096 pixels in twenty layers.
const MAX_BYTES: u64 = 8 << 30;

/// Reads every RGB layer (half, float or uint; `NAME.R` channels, parts, or grey `Y`), in file order.
///
/// Colours of other primaries become those of Rec. 709 [RP 177-1993]. Other channels (alpha, depth) are skipped. The
/// image is the display window; a larger data window is cropped, and pixels without data are black. In a file of
/// several parts, plain `R`, `G`, `B` are the layer named like the part, except that `beauty` and `rgba` are the
/// unnamed layer.
pub fn read(path: &Path) -> Result<Image> {
    let malformed = |cause: ExrError| match cause {
        ExrError::Io(cause) => Error::io("read", path)(cause),
        cause => Error::import_from(path, "not a readable EXR file", cause),
    };
    let (opened, file_bytes) = file::open(path)?;
    let reader = exr::block::read(BufReader::new(opened), false).map_err(malformed)?;
    let headers = reader.headers();
    let wanted = Wanted::find(headers).map_err(|reason| Error::import(path, reason))?;
    let window = headers[0].shared_attributes.display_window;
    check_size(headers, window, wanted.names.len(), file_bytes).map_err(|reason| Error::import(path, reason))?;

    let mut canvas = Canvas::new(window, wanted)
        .ok_or_else(|| Error::import(path, "has a display window that does not fit into memory"))?;
    let mut chunks = reader.all_chunks(false).map_err(malformed)?;
    let meta = chunks.meta_data().clone();
    loop {
        // 64: enough for every thread, small compared with the image. The crate's parallel reader would start a thread
        // pool for every file, and a panic in it could not be handled.
        let batch: Vec<Chunk> = chunks.by_ref().take(64).collect::<ExrResult<_>>().map_err(malformed)?;
        if batch.is_empty() {
            break;
        }
        let blocks: ExrResult<Vec<_>> = batch
            .into_par_iter()
            .filter(|chunk| canvas.wanted.slots[chunk.layer_index].iter().any(Option::is_some))
            .map(|chunk| {
                check_dwa(&meta.headers[chunk.layer_index], &chunk)?;
                UncompressedBlock::decompress_chunk(chunk, &meta, false)
            })
            .collect();
        for block in blocks.map_err(malformed)? {
            canvas.insert(&meta.headers[block.index.layer], &block).map_err(malformed)?;
        }
    }
    canvas.finish(&meta.headers).map_err(|reason| Error::import(path, reason))
}

/// Refuses sizes that a file of `file_bytes` cannot hold, before anything is allocated for them.
fn check_size(headers: &[Header], window: IntegerBounds, layers: usize, file_bytes: u64) -> Result<(), String> {
    let size = |size: Vec2<usize>| size.0 as u64 * size.1 as u64;
    let chunks = headers.iter().map(|header| header.chunk_count as u64).fold(0, u64::saturating_add);
    // Each block has an 8-byte offset, a 4-byte position and a 4-byte length.
    if chunks.saturating_mul(16) > file_bytes {
        return Err(format!("claims {chunks} blocks, more than its bytes could hold: truncated?"));
    }
    for header in headers {
        let Vec2(width, height) = header.layer_size;
        let bytes = size(header.layer_size).saturating_mul(header.channels.bytes_per_pixel as u64);
        // Deflate compresses at most 1032:1, other coders less; DWA also reduces 64 equal pixels to one.
        let ratio = match header.compression {
            Compression::DWAA(_) | Compression::DWAB(_) => 1032 * 64,
            _ => 1032,
        };
        if width == 0 || height == 0 || bytes > MAX_BYTES || bytes > file_bytes.saturating_mul(ratio) {
            return Err(format!("claims {width}x{height} pixels, which its {file_bytes} bytes cannot hold"));
        }
        // Blocks are decompressed whole, many of them in parallel.
        let block_bytes = bytes.min(header.max_block_byte_size() as u64);
        if block_bytes > 1 << 30 {
            return Err(format!("has blocks of {block_bytes} bytes"));
        }
    }
    let bytes = size(window.size).saturating_mul(layers as u64 * 12);
    if window.size.area() == 0 || bytes > MAX_BYTES {
        return Err(format!("has a display window of {}x{} pixels", window.size.0, window.size.1));
    }
    Ok(())
}

/// Refuses DWA blocks that claim sections larger than their pixels.
///
/// exr 1.74.2 allocates whatever size a block claims, and a process that allocates too much aborts. Can be removed when
/// the crate's `dwa/section_stream.rs` checks the counters itself.
fn check_dwa(header: &Header, chunk: &Chunk) -> ExrResult<()> {
    let bytes = match &chunk.compressed_block {
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        _ => return Ok(()),
    };
    let size =
        header.get_absolute_block_pixel_coordinates(header.get_block_data_indices(&chunk.compressed_block)?)?.size;
    let is_raw = bytes.len() == size.area() * header.channels.bytes_per_pixel;
    if is_raw || !matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        return Ok(());
    }
    // Pixels are padded to 8x8, and run-length coding at worst doubles them.
    let most = 2 * (size.0 + 7) * (size.1 + 7) * header.channels.bytes_per_pixel;
    // A block begins with eleven counters; all but the first (version) and last (coder) are sizes.
    let claimed = bytes.as_chunks::<8>().0.iter().take(10).map(|bytes| u64::from_le_bytes(*bytes));
    if claimed.skip(1).any(|size| size > most as u64) {
        return Err(ExrError::Invalid("DWA block claims more than its pixels".into()));
    }
    Ok(())
}

#[derive(Clone, Copy)]
enum Component {
    One(usize),
    Grey,
}

/// Destination of each channel of each part.
struct Wanted {
    names: Vec<String>,
    /// By part and channel: layer and component, or `None`.
    slots: Vec<Vec<Option<(usize, Component)>>>,
}

impl Wanted {
    fn find(headers: &[Header]) -> Result<Self, String> {
        let mut found: Vec<(String, [bool; 3], bool)> = Vec::new();
        let mut slots = Vec::new();
        for header in headers {
            let part = header.own_attributes.layer_name.as_ref().filter(|_| headers.len() > 1);
            let part = part.map(|name| String::from_utf8_lossy(name.as_slice()).into_owned());
            let mut of_part = Vec::new();
            for channel in &header.channels.list {
                let name = String::from_utf8_lossy(channel.name.as_slice());
                let (layer, letter) = layer_and_letter(&name, part.as_deref());
                let Some(component) = component(letter) else {
                    of_part.push(None);
                    continue;
                };
                if channel.sampling != Vec2(1, 1) {
                    return Err(format!("channel {name} is subsampled, which is not supported"));
                }
                let index = found.iter().position(|(name, ..)| *name == layer).unwrap_or_else(|| {
                    found.push((layer.to_owned(), [false; 3], false));
                    found.len() - 1
                });
                let seen = match component {
                    Component::One(component) => &mut found[index].1[component],
                    Component::Grey => &mut found[index].2,
                };
                if std::mem::replace(seen, true) {
                    return Err(format!("channel {name} of layer `{layer}` occurs twice"));
                }
                of_part.push(Some((index, component)));
            }
            slots.push(of_part);
        }
        Self { names: Vec::new(), slots }.check(headers, &found)
    }

    /// Refuses layers that lack a channel; skips grey in layers that have colour.
    fn check(mut self, headers: &[Header], found: &[(String, [bool; 3], bool)]) -> Result<Self, String> {
        for (layer, rgb, grey) in found {
            let missing = ["R", "G", "B"].into_iter().zip(rgb).find(|(_, seen)| !**seen);
            if let (Some((letter, _)), true) = (missing, rgb.contains(&true) || !grey) {
                let channel = if layer.is_empty() { letter.to_owned() } else { format!("{layer}.{letter}") };
                return Err(format!("channel {channel} is missing"));
            }
        }
        for slot in self.slots.iter_mut().flatten() {
            if matches!(slot, Some((layer, Component::Grey)) if found[*layer].1 == [true; 3]) {
                *slot = None;
            }
        }
        if found.is_empty() {
            let channels = headers.iter().flat_map(|header| &header.channels.list);
            let names: Vec<_> = channels.map(|channel| String::from_utf8_lossy(channel.name.as_slice())).collect();
            return Err(format!("holds no RGB or grey layer, only channels {}", names.join(", ")));
        }
        self.names = found.iter().map(|(name, ..)| name.clone()).collect();
        Ok(self)
    }
}

fn layer_and_letter<'a>(channel: &'a str, part: Option<&'a str>) -> (&'a str, &'a str) {
    match (channel.rsplit_once('.'), part) {
        (Some(named), _) => named,
        (None, None | Some("beauty" | "rgba")) => ("", channel),
        (None, Some(part)) => (part, channel),
    }
}

fn component(letter: &str) -> Option<Component> {
    match letter {
        "R" => Some(Component::One(0)),
        "G" => Some(Component::One(1)),
        "B" => Some(Component::One(2)),
        "Y" => Some(Component::Grey),
        _ => None,
    }
}

/// The display window, filled block by block.
struct Canvas {
    window: IntegerBounds,
    wanted: Wanted,
    layers: Vec<Vec<[f32; 3]>>,
    /// Part and corner of every block read so far, and how many pixels of each part they cover.
    seen: HashSet<(usize, Vec2<usize>)>,
    covered: Vec<usize>,
}

impl Canvas {
    fn new(window: IntegerBounds, wanted: Wanted) -> Option<Self> {
        let (area, count) = (window.size.area(), wanted.names.len());
        // The system provides zeroed memory on first access, so a short file that claims to be large costs little; but
        // a request beyond the available memory would abort.
        Vec::<[f32; 3]>::new().try_reserve_exact(area * count).ok()?;
        let layers = (0..count).map(|_| vec![[0.0; 3]; area]).collect();
        Some(Self { window, layers, seen: HashSet::new(), covered: vec![0; wanted.slots.len()], wanted })
    }

    fn insert(&mut self, header: &Header, block: &UncompressedBlock) -> ExrResult<()> {
        let index = block.index;
        let is_full_resolution = index.level == Vec2(0, 0);
        if !is_full_resolution || !self.seen.insert((index.layer, index.pixel_position)) {
            return Ok(());
        }
        self.covered[index.layer] += index.pixel_size.area();
        for line in block.lines(&header.channels) {
            if let Some((layer, component)) = self.wanted.slots[index.layer][line.location.channel] {
                match header.channels.list[line.location.channel].sample_type {
                    SampleType::F32 => self.insert_line(header, layer, component, line, |value: f32| value)?,
                    SampleType::F16 => self.insert_line(header, layer, component, line, half::f16::to_f32)?,
                    SampleType::U32 => self.insert_line(header, layer, component, line, |value: u32| value as f32)?,
                }
            }
        }
        Ok(())
    }

    fn insert_line<T: exr::io::Data>(
        &mut self,
        header: &Header,
        layer: usize,
        component: Component,
        line: LineRef<'_>,
        to_f32: impl Fn(T) -> f32,
    ) -> ExrResult<()> {
        let Vec2(width, height) = self.window.size;
        let origin = header.own_attributes.layer_position;
        let offset = |origin: i32, window: i32| i64::from(origin) - i64::from(window);
        let x = line.location.position.0 as i64 + offset(origin.0, self.window.position.0);
        let y = line.location.position.1 as i64 + offset(origin.1, self.window.position.1);
        if y < 0 || y >= height as i64 {
            return Ok(());
        }
        let row = y as usize * width;
        let pixels = &mut self.layers[layer];
        for (sample, x) in line.read_samples::<T>().zip(x..) {
            if x >= 0 && x < width as i64 {
                let pixel = &mut pixels[row + x as usize];
                let value = to_f32(sample?);
                match component {
                    Component::One(component) => pixel[component] = value,
                    Component::Grey => *pixel = [value; 3],
                }
            }
        }
        Ok(())
    }

    fn finish(self, headers: &[Header]) -> Result<Image, String> {
        let used = self.wanted.slots.iter().map(|channels| channels.iter().any(Option::is_some));
        for ((header, covered), used) in headers.iter().zip(&self.covered).zip(used) {
            let expected = header.layer_size.area();
            if used && *covered != expected {
                return Err(format!("holds only {covered} of {expected} pixels"));
            }
        }
        let Vec2(width, height) = self.window.size;
        let layers = self.wanted.names.into_iter().zip(self.layers).map(|(name, pixels)| Layer { name, pixels });
        let mut image = Image { width, height, layers: layers.collect(), data: Vec::new() };
        if let Some(primaries) = other_primaries(headers) {
            image.map_pixels(primaries.from_rec_709().inverse());
        }
        Ok(image)
    }
}

/// The primaries that the file names; `None` if they are those of Rec. 709 or no colour space.
fn other_primaries(headers: &[Header]) -> Option<Primaries> {
    let Chromaticities { red, green, blue, white } = headers[0].shared_attributes.chromaticities?;
    let [red, green, blue, white] = [red, green, blue, white].map(|Vec2(x, y)| DVec2::new(x.into(), y.into()));
    let primaries = Primaries { rgb: [red, green, blue], white };
    let matrix = primaries.from_rec_709().inverse();
    let is_other = |i: usize| (matrix.col(i) - DMat3::IDENTITY.col(i)).abs().max_element() > SAME_PRIMARIES;
    (matrix.is_finite() && (0..3).any(is_other)).then_some(primaries)
}

/// Largest entry by which a matrix between primaries differs from the identity if the file means Rec. 709, whose
/// chromaticities some programs round.
const SAME_PRIMARIES: f64 = 2e-3;
