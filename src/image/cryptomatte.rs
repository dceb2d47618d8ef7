//! Cryptomattes: which things each pixel sees, and how much of it each one covers [Friedman 2015].
//!
//! A pixel's things are ranked by coverage. Each rank is two channels: a hash of the name, and the coverage. A
//! compositor picks a thing by its name or in the picture, and gets its matte.

use serde_json::{Map, Value};

use super::DataChannel;

/// Things of a pixel that are kept; 6 is usual.
pub const RANKS: usize = 6;

/// Channels and metadata of one kind of things: objects, or materials.
pub struct Cryptomatte {
    pub channels: Vec<DataChannel>,
    /// Attributes of the file.
    pub texts: Vec<(String, String)>,
}

impl Cryptomatte {
    /// `layer`: its name, like `CryptoObject`. `names`: of all things. `covers`: for each pixel, row by row, indices of
    /// the things that it sees and how much of it each one covers; things of one name are one.
    pub fn new(layer: &str, names: &[String], covers: &[Vec<(u32, f32)>]) -> Self {
        let hashes: Vec<u32> = names.iter().map(|name| hash(name)).collect();
        let mut channels: Vec<DataChannel> = (0..2 * RANKS).map(|i| channel(layer, i, covers.len())).collect();
        for (pixel, covers) in covers.iter().enumerate() {
            let mut ranked: Vec<(u32, f32)> = Vec::new();
            for &(thing, coverage) in covers {
                let hash = hashes[thing as usize];
                match ranked.iter_mut().find(|(known, _)| *known == hash) {
                    Some((_, sum)) => *sum += coverage,
                    None => ranked.push((hash, coverage)),
                }
            }
            ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            for (rank, (hash, coverage)) in ranked.into_iter().take(RANKS).enumerate() {
                channels[2 * rank].values[pixel] = f32::from_bits(hash);
                channels[2 * rank + 1].values[pixel] = coverage;
            }
        }
        let named = names.iter().zip(&hashes).filter(|(name, _)| !name.is_empty());
        let manifest: Map<String, Value> =
            named.map(|(name, hash)| (name.clone(), format!("{hash:08x}").into())).collect();
        let key = &format!("{:08x}", murmur3(layer.as_bytes()))[..7];
        let text = |what: &str, value: &str| (format!("cryptomatte/{key}/{what}"), value.to_owned());
        let texts = vec![
            text("name", layer),
            text("hash", "MurmurHash3_32"),
            text("conversion", "uint32_to_float32"),
            text("manifest", &Value::from(manifest).to_string()),
        ];
        Self { channels, texts }
    }
}

/// Two ranks are the four channels of one RGBA layer: `CryptoObject00.R`.
fn channel(layer: &str, index: usize, pixels: usize) -> DataChannel {
    let letter = ["R", "G", "B", "A"][index % 4];
    DataChannel { name: format!("{layer}{:02}.{letter}", index / 4), values: vec![0.0; pixels] }
}

/// Hash of a name as the bits of a float that is neither subnormal, infinite nor NaN.
pub fn hash(name: &str) -> u32 {
    let hash = murmur3(name.as_bytes());
    match (hash >> 23) & 255 {
        0 | 255 => hash ^ (1 << 23),
        _ => hash,
    }
}

/// MurmurHash3 of 32 bits with seed 0 [Appleby 2011].
fn murmur3(bytes: &[u8]) -> u32 {
    let scramble = |k: u32| k.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let (blocks, tail) = bytes.as_chunks::<4>();
    let mut hash = blocks.iter().fold(0u32, |hash, block| {
        (hash ^ scramble(u32::from_le_bytes(*block))).rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64)
    });
    let rest = tail.iter().rev().fold(0u32, |rest, byte| rest << 8 | u32::from(*byte));
    hash ^= scramble(rest) ^ bytes.len() as u32;
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ (hash >> 13)).wrapping_mul(0xc2b2_ae35);
    hash ^ (hash >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the reference implementation.
    #[test]
    fn hashes_are_those_of_murmur3() {
        for (text, hash) in [("", 0), ("a", 0x3c25_69b2), ("hello", 0x248b_fa47), ("hello, world", 0x149b_bb7f)] {
            assert_eq!(murmur3(text.as_bytes()), hash, "{text}");
        }
    }

    #[test]
    fn things_are_ranked_by_what_they_cover() {
        let names = ["floor", "ball", "floor"].map(str::to_owned);
        let matte = Cryptomatte::new("CryptoObject", &names, &[vec![(0, 0.25), (1, 0.375), (2, 0.25)], Vec::new()]);
        let value = |name: &str, pixel: usize| {
            matte.channels.iter().find(|channel| channel.name == name).expect("it is there").values[pixel]
        };
        assert_eq!(value("CryptoObject00.R", 0).to_bits(), hash("floor"));
        assert_eq!((value("CryptoObject00.G", 0), value("CryptoObject00.A", 0)), (0.5, 0.375));
        assert_eq!((value("CryptoObject01.R", 0), value("CryptoObject00.R", 1)), (0.0, 0.0));
    }
}
