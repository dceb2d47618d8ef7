//! The transfer on disk.

use std::path::Path;

use safetensors::tensor::Dtype;
use serde::Serialize;

use super::{Key, Reader, Writer, file, hash_of, read};
use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::bake::transfer::blocks::BlockMatrix;
use crate::bake::transfer::sky::SkyTransfer;
use crate::bake::transfer::sparse::SellMatrix;
use crate::bake::transport::emitted::EmitterLight;
use crate::error::Result;

/// Key of a transfer to the bake of `key`; `settings` determine how it is computed. A session passes its plan (gather
/// samples, rays, form with its error, bounces, seed, ...) and the lobe.
pub fn transfer_key(key: &Key, settings: &impl Serialize) -> Key {
    Key(hash_of(&(&key.0, settings)))
}

/// Loads a transfer. A file that is damaged or of another format version counts as absent. Factors stay in the file,
/// mapped.
pub fn load_transfer(dir: &Path, key: &Key, framebuffer: &DeepFramebuffer) -> Option<Transfer> {
    read(dir, key, |reader| decode(reader, framebuffer)).map(Transfer::with_packets)
}

/// Stores a transfer of the scene called `name`.
pub fn store_transfer(
    dir: &Path,
    key: &Key,
    name: &str,
    framebuffer: &DeepFramebuffer,
    transfer: &Transfer,
) -> Result<()> {
    let mut writer = Writer { tensors: Vec::new() };
    writer.add("gather_samples", Dtype::U32, 20, &transfer.samples);
    writer.add("factored_samples", Dtype::U32, 9, &transfer.factored);
    writer.add("factor_tables", Dtype::F32, 4, &transfer.tables);
    writer.add("gather_points", Dtype::U32, 8, &transfer.points);
    writer.add("geometric_normals", Dtype::F32, 3, &transfer.geometric_normals);
    for light in &transfer.emission {
        writer.add(format!("emitter.{}", light.emitter), Dtype::F32, 3, &light.radiance);
    }
    let emitters: Vec<u32> = transfer.emission.iter().map(|light| light.emitter).collect();
    let mut metadata = vec![
        ("scene", name.to_owned()),
        ("what", "transfer".to_owned()),
        ("width", framebuffer.tiling.width.to_string()),
        ("height", framebuffer.tiling.height.to_string()),
        ("points_per_sample", transfer.points_per_sample.to_string()),
        ("vector_length", transfer.vector_length.to_string()),
        ("haar", transfer.haar.to_string()),
        ("report", serde_json::to_string(&transfer.report).expect("plain numbers")),
        ("emitters", serde_json::to_string(&emitters).expect("plain numbers")),
    ];
    add_chain(&mut writer, &mut metadata, &transfer.chain);
    if let Some(sparse) = &transfer.sparse {
        metadata.push(("sparse", serde_json::to_string(&[sparse.input_count, sparse.output_count]).expect("numbers")));
        writer.add("slices", Dtype::U32, 5, &sparse.slices);
        writer.add("outputs", Dtype::U32, 1, &sparse.outputs);
        writer.add("terms", Dtype::U16, 8, &sparse.values);
    }
    writer.write(&file(dir, key), &metadata)
}

/// Loads light of the sky, as [`load_transfer`] does.
pub fn load_sky(dir: &Path, key: &Key, framebuffer: &DeepFramebuffer) -> Option<SkyTransfer> {
    let decode = |reader: &Reader| {
        let vector_length = reader.field("vector_length")?;
        let held_out = serde_json::from_str(reader.text("held_out")?).ok()?;
        let sky = SkyTransfer { vector_length, chain: chain(reader)?, held_out };
        sky.is_consistent(framebuffer.samples.len()).then_some(sky)
    };
    read(dir, key, decode)
}

/// Stores light of the sky in the scene called `name`.
pub fn store_sky(dir: &Path, key: &Key, name: &str, framebuffer: &DeepFramebuffer, sky: &SkyTransfer) -> Result<()> {
    let mut writer = Writer { tensors: Vec::new() };
    let mut metadata = vec![
        ("scene", name.to_owned()),
        ("what", "light of the sky".to_owned()),
        ("width", framebuffer.tiling.width.to_string()),
        ("height", framebuffer.tiling.height.to_string()),
        ("vector_length", sky.vector_length.to_string()),
        ("held_out", serde_json::to_string(&sky.held_out).expect("plain numbers")),
    ];
    add_chain(&mut writer, &mut metadata, &sky.chain);
    writer.write(&file(dir, key), &metadata)
}

fn add_chain<'a>(writer: &mut Writer<'a>, metadata: &mut Vec<(&str, String)>, chain: &'a [BlockMatrix]) {
    let shapes: Vec<[u32; 3]> = chain.iter().map(|m| [m.channels, m.input_count, m.output_count]).collect();
    metadata.push(("matrices", serde_json::to_string(&shapes).expect("plain numbers")));
    for (i, matrix) in chain.iter().enumerate() {
        writer.add(format!("{i}.panels"), Dtype::U32, 7, &matrix.panels);
        writer.add(format!("{i}.inputs"), Dtype::U32, 1, &matrix.inputs);
        writer.add(format!("{i}.tints"), Dtype::F32, 3, &matrix.tints);
        writer.add(format!("{i}.outputs"), Dtype::U32, 1, &matrix.outputs);
        writer.add(format!("{i}.factors"), Dtype::F16, 8, &matrix.values);
    }
}

/// The chain that [`add_chain`] wrote. Its factors stay in the file, mapped.
fn chain(reader: &Reader) -> Option<Vec<BlockMatrix>> {
    let shapes: Vec<[u32; 3]> = serde_json::from_str(reader.text("matrices")?).ok()?;
    let matrix = |(i, [channels, input_count, output_count]): (usize, [u32; 3])| {
        Some(BlockMatrix {
            channels,
            input_count,
            output_count,
            panels: reader.take(&format!("{i}.panels"))?,
            inputs: reader.take(&format!("{i}.inputs"))?,
            tints: reader.take(&format!("{i}.tints"))?,
            outputs: reader.take(&format!("{i}.outputs"))?,
            values: reader.map(&format!("{i}.factors"))?,
        })
    };
    shapes.into_iter().enumerate().map(matrix).collect()
}

/// `None` if the file differs from what [`store_transfer`] writes. Kernels follow these indices, so every index is
/// checked.
fn decode(reader: &Reader, framebuffer: &DeepFramebuffer) -> Option<Transfer> {
    let mut transfer = Transfer {
        samples: reader.take("gather_samples")?,
        factored: reader.take("factored_samples")?,
        tables: reader.take("factor_tables")?,
        points: reader.take("gather_points")?,
        geometric_normals: reader.take("geometric_normals")?,
        points_per_sample: reader.field("points_per_sample")?,
        vector_length: reader.field("vector_length")?,
        haar: reader.field("haar")?,
        report: serde_json::from_str(reader.text("report")?).ok()?,
        chain: chain(reader)?,
        ..Default::default()
    };
    let emitters: Vec<u32> = serde_json::from_str(reader.text("emitters")?).ok()?;
    for emitter in emitters {
        transfer.emission.push(EmitterLight { emitter, radiance: reader.take(&format!("emitter.{emitter}"))? });
    }
    if let Some(counts) = reader.text("sparse") {
        let [input_count, output_count] = serde_json::from_str(counts).ok()?;
        // Copied, not mapped: terms contain column increments, which a kernel follows.
        transfer.sparse = Some(SellMatrix {
            input_count,
            output_count,
            slices: reader.take("slices")?,
            outputs: reader.take("outputs")?,
            values: reader.take("terms")?,
        });
    }
    transfer.is_consistent(framebuffer.samples.len()).then_some(transfer)
}
