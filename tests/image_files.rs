//! EXR and PNG round trips, whole-file writing, and files that are not what they claim.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use exr::prelude as ex;
use exr::prelude::{Blocks, Compression, Encoding, FlatSamples, LayerAttributes, LineOrder, Vec2, WritableImage, f16};
use relume::image::primaries::Primaries;
use relume::image::{DataChannel, Image, exr as our_exr, png};
use relume::storage::file;
use relume::{Error, Result};

fn ramp(width: usize, height: usize, offset: f32) -> Vec<[f32; 3]> {
    (0..width * height).map(|i| [offset + i as f32 * 0.37, -(i as f32), 1.0 / (1.0 + i as f32)]).collect()
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn assert_names<T>(outcome: Result<T>, path: &Path) -> String {
    let error = outcome.err().expect("an error").to_string();
    let name = path.file_name().unwrap().to_str().unwrap();
    assert!(error.contains(name), "`{error}` does not name {name}");
    error
}

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn exr_round_trip_keeps_every_bit() {
    let folder = folder();
    let path = folder.path().join("a.exr");
    // 37 rows: not a multiple of the 16 in a block.
    for (width, height) in [(1, 1), (53, 37), (17, 16), (1, 300)] {
        let mut image = Image::single(width, height, ramp(width, height, 0.0))
            .with_layer("direct", ramp(width, height, 1.0))
            .with_layer("light.key.indirect", ramp(width, height, 2.0))
            .with_layer("light.Lämpchen 光.direct", ramp(width, height, 3.0))
            .with_layer("a name of far more than the thirty-one bytes of old files", ramp(width, height, 4.0));
        image.layers[0].pixels[0] = [f32::MAX, f32::MIN_POSITIVE / 2.0, -0.0];
        image.layers[1].pixels[0] = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        our_exr::write(&path, &image).unwrap();
        let read = our_exr::read(&path).unwrap();
        assert_eq!((read.width, read.height, read.layers.len()), (width, height, image.layers.len()));
        for layer in &image.layers {
            let bits = |pixels: &[[f32; 3]]| pixels.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&read.layer(&layer.name).unwrap().pixels), bits(&layer.pixels), "layer {}", layer.name);
        }
        let first = fs::read(&path).unwrap();
        assert_eq!(first[5] & 4, 4, "the flag that lets OpenEXR read long channel names");
        our_exr::write(&path, &image).unwrap();
        assert_eq!(fs::read(&path).unwrap(), first);
    }
}

#[test]
fn exr_is_one_part_with_the_contract_s_channel_names() {
    let folder = folder();
    let path = folder.path().join("a.exr");
    let image = Image::single(4, 3, ramp(4, 3, 0.0))
        .with_layer("light.key.indirect", ramp(4, 3, 1.0))
        .with_layer("direct", ramp(4, 3, 2.0));
    our_exr::write(&path, &image).unwrap();
    let meta = exr::meta::MetaData::read_from_file(&path, true).unwrap();
    assert_eq!(meta.headers.len(), 1);
    assert!(!meta.requirements.has_multiple_layers);
    let header = &meta.headers[0];
    let names: Vec<_> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
    let wanted = "B G R direct.B direct.G direct.R light.key.indirect.B light.key.indirect.G light.key.indirect.R";
    assert_eq!(names.join(" "), wanted);
    assert_eq!(header.compression, Compression::ZIP16);
    assert!(!meta.requirements.has_long_names);
}

/// Several layers of any channels, each its own part if there is more than one.
/// Colours with 16 bits, data with 32 whatever the colours have, attributes in one order: another program's reader sees
/// what was written.
#[test]
fn data_channels_and_attributes_are_written() {
    let folder = folder();
    let path = folder.path().join("data.exr");
    let data = ["depth.Z", "normal.X"].map(|name| DataChannel { name: name.into(), values: vec![1e10, 0.1] });
    let image = Image { data: data.to_vec(), ..Image::single(2, 1, vec![[0.1, 2.0, 3.0]; 2]) };
    let texts = (0..8).map(|i| (format!("cryptomatte/{i}/name"), format!("Crypto{i} with ü"))).collect();
    let metadata = our_exr::ExrMetadata { texts, precision: our_exr::Precision::Half, ..Default::default() };
    let write = || {
        our_exr::write_with_metadata(&path, &image, &metadata).unwrap();
        fs::read(&path).unwrap()
    };
    let bytes = write();
    assert!((0..5).all(|_| write() == bytes), "the same bytes each time");
    let read = ex::read_all_flat_layers_from_file(&path).unwrap();
    let layer = &read.layer_data[0];
    let kind = |samples: &FlatSamples| match samples {
        FlatSamples::F16(_) => "half",
        FlatSamples::F32(_) => "float",
        FlatSamples::U32(_) => "uint",
    };
    let kinds: Vec<(String, &str)> =
        layer.channel_data.list.iter().map(|c| (c.name.to_string(), kind(&c.sample_data))).collect();
    let kinds: Vec<(&str, &str)> = kinds.iter().map(|(name, kind)| (name.as_str(), *kind)).collect();
    let wanted = [("B", "half"), ("G", "half"), ("R", "half"), ("depth.Z", "float"), ("normal.X", "float")];
    assert_eq!(kinds, wanted);
    let values = |index: usize| layer.channel_data.list[index].sample_data.values_as_f32().collect::<Vec<f32>>();
    assert_eq!((values(3), values(4)), (vec![1e10, 0.1], vec![1e10, 0.1]));
    assert_eq!(values(2), [f16::from_f32(0.1).to_f32(); 2]);
    // As bytes: the reader takes texts for Latin-1.
    let has = |text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
    assert!(layer.attributes.other.len() == 8 && has("Crypto7 with ü") && has("cryptomatte/7/name"));
}

/// Lines or tiles, one part or one for each layer: the same channels, read by another program's reader.
#[test]
fn parts_and_tiles_hold_the_same() {
    let folder = folder();
    let path = folder.path().join("parts.exr");
    let (width, height) = (150, 70); // neither is a multiple of the side of a tile
    let mut image = Image::single(width, height, ramp(width, height, 0.0))
        .with_layer("light.key", ramp(width, height, 1.0))
        .with_layer("light.key.direct.diffuse", ramp(width, height, 2.0));
    image.data.push(DataChannel { name: "light.key.Z".into(), values: vec![0.25; width * height] });
    let texts = vec![("cryptomatte/1/name".to_owned(), "Crypto".to_owned())];
    for blocks in [our_exr::Blocks::Lines, our_exr::Blocks::Tiles] {
        for has_parts in [false, true] {
            let metadata = our_exr::ExrMetadata { texts: texts.clone(), blocks, has_parts, ..Default::default() };
            our_exr::write_with_metadata(&path, &image, &metadata).unwrap();
            let bytes = fs::read(&path).unwrap();
            our_exr::write_with_metadata(&path, &image, &metadata).unwrap();
            assert_eq!(fs::read(&path).unwrap(), bytes);
            let read = ex::read_all_flat_layers_from_file(&path).unwrap();
            let parts: Vec<String> = read
                .layer_data
                .iter()
                .map(|part| part.attributes.layer_name.as_ref().map_or("".into(), |n| n.to_string()))
                .collect();
            let wanted: &[&str] = if has_parts { &["beauty", "light.key", "light.key.direct.diffuse"] } else { &[""] };
            assert_eq!(parts, wanted);
            assert!(read.layer_data.iter().all(|part| part.encoding.blocks
                == match blocks {
                    our_exr::Blocks::Lines => Blocks::ScanLines,
                    our_exr::Blocks::Tiles => Blocks::Tiles(Vec2(64, 64)),
                }));
            assert!(read.layer_data.iter().all(|part| part.attributes.other.len() == 1));
            let channels = read.layer_data.iter().flat_map(|part| &part.channel_data.list);
            let mut count = 0;
            for channel in channels {
                let name = channel.name.to_string();
                let (layer, letter) = name.rsplit_once('.').unwrap_or(("", &name));
                let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
                match "RGB".find(letter) {
                    Some(c) => {
                        let pixels = &image.layers.iter().find(|l| l.name == layer).unwrap().pixels;
                        assert!(values.iter().zip(pixels).all(|(value, pixel)| *value == pixel[c]), "{name}");
                    }
                    None => assert_eq!((name.as_str(), &values), ("light.key.Z", &image.data[0].values)),
                }
                count += 1;
            }
            assert_eq!(count, 10);
        }
    }
}

fn foreign(parts: Vec<(&str, Vec<(&str, FlatSamples)>)>, size: (usize, usize), encoding: Encoding) -> Vec<u8> {
    let layers = parts.into_iter().map(|(part, channels)| {
        let channels = channels.into_iter().map(|(name, samples)| ex::AnyChannel::new(name, samples)).collect();
        ex::Layer::new(size, LayerAttributes::named(part), encoding, ex::AnyChannels::sort(channels))
    });
    let window = exr::meta::header::ImageAttributes::with_size(size);
    let mut bytes = Cursor::new(Vec::new());
    ex::Image::from_layers(window, layers.collect::<Vec<_>>()).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn encoding(compression: Compression, blocks: Blocks) -> Encoding {
    Encoding { compression, blocks, line_order: LineOrder::Increasing }
}

fn floats(values: &[f32]) -> FlatSamples {
    FlatSamples::F32(values.to_vec())
}

fn zip() -> Encoding {
    encoding(Compression::ZIP16, Blocks::ScanLines)
}

fn written(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn exr_of_other_programs_are_read() {
    let folder = folder();
    let halves = FlatSamples::F16(vec![f16::from_f32(0.5), f16::from_f32(2.0)]);
    let mixed =
        vec![("R", halves), ("G", FlatSamples::U32(vec![7, 9])), ("B", floats(&[0.25, 4.0])), ("A", floats(&[1.0; 2]))];
    for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(1, 1))] {
        let bytes = foreign(vec![("x", mixed.clone())], (2, 1), encoding(Compression::RLE, blocks));
        let image = our_exr::read(&written(&folder, "mixed.exr", &bytes)).unwrap();
        assert_eq!(image, Image::single(2, 1, vec![[0.5, 7.0, 0.25], [2.0, 9.0, 4.0]]));
    }

    let grey = vec![("Y", floats(&[3.0])), ("mask.Y", floats(&[4.0])), ("depth.Z", floats(&[5.0]))];
    let image = our_exr::read(&written(&folder, "grey.exr", &foreign(vec![("x", grey)], (1, 1), zip()))).unwrap();
    assert_eq!(image, Image::single(1, 1, vec![[3.0; 3]]).with_layer("mask", vec![[4.0; 3]]));

    let rgb = |value: f32| vec![("R", floats(&[value])), ("G", floats(&[value])), ("B", floats(&[value]))];
    let named = vec![("key.R", floats(&[8.0])), ("key.G", floats(&[8.0])), ("key.B", floats(&[8.0]))];
    let parts =
        vec![("beauty", rgb(1.0)), ("direct", rgb(2.0)), ("whatever", named), ("z", vec![("Z", floats(&[0.0]))])];
    let image = our_exr::read(&written(&folder, "parts.exr", &foreign(parts, (1, 1), zip()))).unwrap();
    let wanted =
        Image::single(1, 1, vec![[1.0; 3]]).with_layer("direct", vec![[2.0; 3]]).with_layer("key", vec![[8.0; 3]]);
    assert_eq!(image, wanted);
}

#[test]
fn exr_data_window_is_placed_in_the_display_window() {
    let folder = folder();
    let channels = ["R", "G", "B"].map(|name| ex::AnyChannel::new(name, floats(&[1.0, 2.0, 3.0, 4.0])));
    let attributes = LayerAttributes::default().with_position(Vec2(-1, 1));
    let channels = ex::AnyChannels::sort(channels.into_iter().collect());
    let layer = ex::Layer::new((2, 2), attributes, zip(), channels);
    let mut image = ex::Image::from_layer(layer);
    image.attributes.display_window = exr::meta::attribute::IntegerBounds::from_dimensions((2, 2));
    let mut bytes = Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).unwrap();
    let read = our_exr::read(&written(&folder, "window.exr", &bytes.into_inner())).unwrap();
    assert_eq!(read, Image::single(2, 2, vec![[0.0; 3], [0.0; 3], [2.0; 3], [0.0; 3]]));
}

/// Colours are those of Rec. 709, whatever primaries the file has.
#[test]
fn primaries_of_a_file_are_converted() {
    let folder = folder();
    let path = folder.path().join("acescg.exr");
    let pixels = vec![[0.5, 0.25, 0.125], [1.0, 1.0, 1.0], [0.0, 0.9, 0.1], [3.0, 0.0, 2.0]];
    let image = Image::single(2, 2, pixels);
    for primaries in [Primaries::REC_709, Primaries::ACES_CG] {
        let metadata = our_exr::ExrMetadata { primaries, ..Default::default() };
        our_exr::write_with_metadata(&path, &image, &metadata).unwrap();
        let read = our_exr::read(&path).unwrap();
        for (got, want) in read.layers[0].pixels.iter().flatten().zip(image.layers[0].pixels.iter().flatten()) {
            let tolerance = if primaries == Primaries::REC_709 { 0.0 } else { 1e-5 };
            assert!((got - want).abs() <= tolerance, "{primaries:?}: {got}, want {want}");
        }
    }
}

#[test]
fn every_compression_is_read() {
    let folder = folder();
    let values: Vec<f32> = (0..40 * 37).map(|i| (i % 40) as f32 * 0.1 + (i / 40) as f32).collect();
    for (name, bytes) in every_encoding(&values) {
        let read = our_exr::read(&written(&folder, &name, &bytes)).unwrap_or_else(|error| panic!("{name}: {error:?}"));
        for (got, want) in read.layers[0].pixels.iter().zip(&values) {
            // DWA is coarse by design; the others are exact or round to 16 or 24 bits.
            let tolerance = if name.starts_with("DWA") { 0.1 * want.abs() + 0.5 } else { 0.02 * want.abs() + 1e-3 };
            assert!((got[0] - want).abs() <= tolerance, "{name}: got {}, want {want}", got[0]);
        }
    }
}

fn every_encoding(values: &[f32]) -> Vec<(String, Vec<u8>)> {
    use Compression::*;
    let mut files = Vec::new();
    for compression in [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, B44A, DWAA(None), DWAB(None)] {
        for (blocks, label) in [(Blocks::ScanLines, "lines"), (Blocks::Tiles(Vec2(16, 16)), "tiles")] {
            let halves = FlatSamples::F16(values.iter().map(|&value| f16::from_f32(value)).collect());
            let channels = vec![("R", floats(values)), ("G", halves), ("B", floats(values)), ("A", floats(values))];
            let bytes = foreign(vec![("x", channels)], (40, 37), encoding(compression, blocks));
            files.push((format!("{compression:?}-{label}.exr"), bytes));
        }
    }
    files
}

#[test]
fn truth_images_are_read() {
    let shared = std::env::var_os("RELUME_SHARED").map_or_else(|| PathBuf::from("../shared"), PathBuf::from);
    let reference = Path::new(env!("CARGO_MANIFEST_DIR")).join(shared).join("reference");
    let Ok(entries) = fs::read_dir(&reference) else {
        return eprintln!("skipped: no truth images in {}", reference.display());
    };
    for path in entries.map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some_and(|e| e == "exr")) {
        let image = our_exr::read(&path).unwrap();
        let layer = image.layer("").unwrap();
        assert!(image.width >= 512 && image.height >= 480 && layer.pixels.len() == image.width * image.height);
        assert!(layer.luminance().iter().all(|value| value.is_finite()), "{}", path.display());
        assert!(layer.luminance().iter().sum::<f32>() > 0.0, "{}", path.display());
    }
}

#[test]
fn missing_or_subsampled_channels_are_named() {
    let folder = folder();
    let two = vec![("direct.R", floats(&[0.0])), ("direct.B", floats(&[0.0])), ("R", floats(&[0.0]))];
    let path = written(&folder, "two.exr", &foreign(vec![("x", two)], (1, 1), zip()));
    let error = assert_names(our_exr::read(&path), &path);
    assert!(error.contains("channel G is missing"), "{error}");
    let two = vec![("direct.R", floats(&[0.0])), ("direct.B", floats(&[0.0]))];
    let path = written(&folder, "direct.exr", &foreign(vec![("x", two)], (1, 1), zip()));
    assert!(assert_names(our_exr::read(&path), &path).contains("channel direct.G is missing"));
    let path = written(&folder, "z.exr", &foreign(vec![("x", vec![("Z", floats(&[0.0]))])], (1, 1), zip()));
    assert!(assert_names(our_exr::read(&path), &path).contains("only channels Z"));
}

/// Where the four values of the named box begin in a header.
fn window_at(bytes: &[u8], name: &str) -> usize {
    let key = [name.as_bytes(), b"\0box2i\0\x10\0\0\0"].concat();
    bytes.windows(key.len()).position(|window| window == key).unwrap() + key.len()
}

#[test]
fn hostile_exr_is_an_error_that_names_the_file() {
    let folder = folder();
    let good = foreign(
        vec![("x", vec![("R", floats(&[1.0; 600])), ("G", floats(&[1.0; 600])), ("B", floats(&[1.0; 600]))])],
        (20, 30),
        zip(),
    );
    let path = written(&folder, "good.exr", &good);
    our_exr::read(&path).unwrap();

    let path = folder.path().join("hostile.exr");
    for length in 0..good.len() {
        fs::write(&path, &good[..length]).unwrap();
        assert_names(our_exr::read(&path), &path);
    }
    for garbage in [&b"garbage"[..], &[0; 4096], &[0xff; 4096], b"\x76\x2f\x31\x01", b"\x76\x2f\x31\x01\x02\0\0\0\0\0"]
    {
        fs::write(&path, garbage).unwrap();
        assert_names(our_exr::read(&path), &path);
    }
    // Corners of 2^31 - 1, 2^30 and 2^16: terabytes, were they believed.
    for window in [&["dataWindow"][..], &["displayWindow"], &["dataWindow", "displayWindow"]] {
        for corner in [i32::MAX, 1 << 30, 1 << 16] {
            let mut bytes = good.clone();
            for name in window {
                let at = window_at(&bytes, name) + 8;
                bytes[at..at + 4].copy_from_slice(&corner.to_le_bytes());
                bytes[at + 4..at + 8].copy_from_slice(&corner.to_le_bytes());
            }
            fs::write(&path, bytes).unwrap();
            assert_names(our_exr::read(&path), &path);
        }
    }
    assert_names(our_exr::read(&folder.path().join("none.exr")), Path::new("none.exr"));
    assert_names(our_exr::read(folder.path()), folder.path());
    assert_names(our_exr::read(Path::new("/dev/null")), Path::new("/dev/null"));
}

#[test]
fn a_block_that_is_there_twice_leaves_another_out() {
    let folder = folder();
    let uncompressed = encoding(Compression::Uncompressed, Blocks::ScanLines);
    let rgb = ["R", "G", "B"].map(|name| (name, floats(&[1.0, 2.0]))).to_vec();
    let mut bytes = foreign(vec![("x", rgb)], (1, 2), uncompressed);
    // The last block: its row, its length, three floats.
    let row = bytes.len() - 20;
    assert_eq!(bytes[row..row + 8], [1, 0, 0, 0, 12, 0, 0, 0]);
    bytes[row] = 0;
    let path = written(&folder, "twice.exr", &bytes);
    assert!(assert_names(our_exr::read(&path), &path).contains("1 of 2"));
}

#[test]
fn flipped_bytes_never_panic() {
    let folder = folder();
    let values: Vec<f32> = (0..40 * 37).map(|i| (i % 97) as f32 * 0.37).collect();
    let path = folder.path().join("flipped.exr");
    let mut state = 12345u64;
    let mut random = move || {
        state ^= state << 13; // xorshift64
        state ^= state >> 7;
        state ^= state << 17;
        state as usize
    };
    let rounds = if std::env::var_os("RELUME_FULL").is_some() { 1000 } else { 200 };
    for (name, good) in every_encoding(&values) {
        for round in 0..rounds {
            let mut bytes = good.clone();
            let reach = if round % 2 == 0 { 400 } else { bytes.len() }; // half of them in the header
            for _ in 0..1 + random() % 4 {
                bytes[random() % reach] = [0, 255, random() as u8, 1 << (random() % 8)][random() % 4];
            }
            fs::write(&path, &bytes).unwrap();
            if let Err(error) = our_exr::read(&path) {
                assert!(error.to_string().contains("flipped.exr"), "{name}: {error}");
            }
        }
    }
}

#[test]
fn dwa_blocks_cannot_claim_more_than_their_pixels() {
    let folder = folder();
    let values: Vec<f32> = (0..40 * 37).map(|i| (i % 97) as f32 * 0.37).collect();
    let files = every_encoding(&values);
    let (name, good) = files.iter().find(|(name, _)| name.starts_with("DWAB") && name.ends_with("lines.exr")).unwrap();
    // Version 2 begins a block's counters; the second is the size of what it holds unlossily.
    let begin = good.windows(8).rposition(|window| window == [2, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    for counter in [1, 6, 7, 8, 9] {
        let mut bytes = good.clone();
        bytes[begin + 8 * counter..][..8].copy_from_slice(&(1u64 << 50).to_le_bytes());
        let path = written(&folder, name, &bytes);
        assert_names(our_exr::read(&path), &path);
    }
}

#[test]
fn what_cannot_be_an_exr_is_not_written() {
    let folder = folder();
    let path = folder.path().join("bad.exr");
    assert_names(our_exr::write(&path, &Image::default()), &path);
    assert_names(our_exr::write(&path, &Image::single(0, 5, Vec::new())), &path);
    assert_names(our_exr::write(&path, &Image::default().with_layer("x", Vec::new())), &path);
    for name in ["nul\0", &"long".repeat(100)] {
        let image = Image { width: 1, height: 1, ..Image::default() }.with_layer(name, vec![[0.0; 3]]);
        assert_names(our_exr::write(&path, &image), &path);
    }
    let mut twice = Image::single(1, 1, vec![[0.0; 3]]).with_layer("a", vec![[0.0; 3]]);
    twice.layers[0].name = "a".to_owned();
    assert_names(our_exr::write(&path, &twice), &path);
    assert!(names_in(folder.path()).is_empty());
}

#[test]
fn png_round_trip() {
    let folder = folder();
    let path = folder.path().join("a.png");
    let rgb: Vec<[u8; 3]> = (0..=254).map(|i| [i, 255 - i, i / 2]).collect();
    png::write(&path, 17, 15, &rgb).unwrap();
    let read = png::read(&path).unwrap();
    assert_eq!((read.width, read.height), (17, 15));
    assert!(read.rgba.iter().zip(&rgb).all(|(got, want)| got[..3] == want[..] && got[3] == 255));
    assert!(fs::read(&path).unwrap().windows(4).any(|window| window == b"sRGB"));

    let rgba: Vec<[u8; 4]> = (0..6).map(|i| [i, 2 * i, 3 * i, 40 * i]).collect();
    png::write(&path, 2, 3, &rgba).unwrap();
    assert_eq!(png::read(&path).unwrap().rgba, rgba);

    // One-bit grey as drawing programs save masks: white, black, white.
    let mut bytes = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut bytes, 3, 1);
    encoder.set_color(::png::ColorType::Grayscale);
    encoder.set_depth(::png::BitDepth::One);
    encoder.write_header().unwrap().write_image_data(&[0b1010_0000]).unwrap();
    fs::write(&path, bytes).unwrap();
    assert_eq!(png::read(&path).unwrap().rgba, [[255; 4], [0, 0, 0, 255], [255; 4]]);
}

#[test]
fn srgb_ends_and_middle() {
    assert_eq!([0.0, 1.0, 0.5, 0.001].map(png::srgb8_from_linear), [0, 255, 188, 3]);
    assert_eq!([-1.0, 7.0, f32::INFINITY, f32::NAN].map(png::srgb8_from_linear), [0, 255, 255, 0]);
}

#[test]
fn hostile_png_is_an_error_that_names_the_file() {
    let folder = folder();
    let path = folder.path().join("hostile.png");
    png::write(&path, 20, 20, &[[9, 8, 7]; 400]).unwrap();
    let good = fs::read(&path).unwrap();
    // The closing IEND is twelve bytes that say nothing about the pixels.
    for length in 0..good.len() - 12 {
        fs::write(&path, &good[..length]).unwrap();
        assert_names(png::read(&path), &path);
    }
    let mut huge = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x08\x06\0\0\0".to_vec();
    huge.extend(0xb3ef_0f6du32.to_be_bytes());
    huge.extend(b"\0\0\0\x04IDAT\0\0\0\0\0\0\0\0");
    for bytes in [&huge[..], b"garbage", &[0; 100]] {
        fs::write(&path, bytes).unwrap();
        assert_names(png::read(&path), &path);
    }
    assert_names(png::write(&path, 0, 0, &[[0u8; 3]; 0]), &path);
}

#[test]
fn write_whole_replaces_or_leaves_alone() {
    let folder = folder();
    let path = folder.path().join("report.txt");
    file::write_bytes(&path, b"first").unwrap();
    file::write_bytes(&path, b"second").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"second");

    let failed = file::write_whole(&path, |out| {
        out.write_all(b"half of the th").unwrap();
        Err(Error::invalid("third", "stopped"))
    });
    assert_eq!(failed.unwrap_err().to_string(), "third: stopped");
    assert_eq!(fs::read(&path).unwrap(), b"second");
    assert_eq!(names_in(folder.path()), ["report.txt"]);
}

#[test]
fn unwritable_places_are_io_errors_that_name_the_path() {
    let folder = folder();
    let not_a_folder = folder.path().join("file");
    fs::write(&not_a_folder, "").unwrap();
    for path in [folder.path().join("none/a.txt"), not_a_folder.join("a.txt"), PathBuf::from("/proc/a.txt")] {
        let error = file::write_bytes(&path, b"x").unwrap_err();
        assert!(matches!(&error, Error::Io { path: named, .. } if *named == path), "{error:?}");
        assert!(error.to_string().contains("a.txt"));
    }
    let is_a_folder = file::write_bytes(folder.path(), b"x").unwrap_err();
    assert!(matches!(&is_a_folder, Error::Io { path, .. } if path == folder.path()));
    assert_eq!(names_in(folder.path()), ["file"]);
}

#[cfg(unix)]
#[test]
fn new_files_have_the_usual_permissions_and_links_stay() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let (usual, ours) = (folder.path().join("usual"), folder.path().join("ours"));
    fs::write(&usual, "").unwrap();
    file::write_bytes(&ours, b"").unwrap();
    assert_eq!(mode(&ours), mode(&usual));

    let link = folder.path().join("link");
    std::os::unix::fs::symlink(&ours, &link).unwrap();
    file::write_bytes(&link, b"through").unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(fs::read(&ours).unwrap(), b"through");
}

#[cfg(target_os = "linux")]
#[test]
fn devices_are_written_to_not_replaced() {
    file::write_bytes(Path::new("/dev/null"), b"gone").unwrap();
    let error = file::write_bytes(Path::new("/dev/full"), b"too much").unwrap_err();
    assert!(
        matches!(&error, Error::Io { source, .. } if source.kind() == std::io::ErrorKind::StorageFull),
        "{error:?}"
    );
    assert!(error.to_string().contains("/dev/full"));
    // An encoder's own error does not hide that the disk is full.
    let hidden = file::write_whole(Path::new("/dev/full"), |out| {
        out.write_all(&vec![7; 1 << 20]).map_err(|_| Error::invalid("encoder", "failed"))
    });
    assert!(matches!(hidden, Err(Error::Io { .. })), "{hidden:?}");
    for device in ["/dev/null", "/dev/full"] {
        assert!(!fs::metadata(device).unwrap().is_file(), "{device} was replaced");
    }
}
