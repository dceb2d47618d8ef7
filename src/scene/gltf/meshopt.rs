//! `EXT_meshopt_compression` and `KHR_meshopt_compression`: decodes buffer views compressed by meshoptimizer, as the
//! extensions specify. The reference library is C++, and its only Rust port supports only the older codec.

use serde::Deserialize;

/// The extension's object in a buffer view.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Packed {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: usize,
    pub count: usize,
    pub mode: String,
    pub filter: Option<String>,
}

/// Reads bytes in order, with bounds checks.
struct Reader<'a> {
    bytes: &'a [u8],
}

const CUT_OFF: &str = "ends before its last element";

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(CUT_OFF)?;
        self.bytes = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, String> {
        Ok(self.take(1)?[0])
    }

    /// Seven bits per byte, lowest first, at most five bytes.
    fn varint(&mut self) -> Result<u32, String> {
        let mut value = 0;
        for i in 0..5 {
            let byte = self.byte()?;
            value |= u32::from(byte & 127) << (7 * i);
            if byte < 128 {
                break;
            }
        }
        Ok(value)
    }
}

impl Packed {
    /// Size of the decompressed view in bytes, or why it is invalid.
    pub fn unpacked_bytes(&self) -> Result<usize, String> {
        let (stride, count) = (self.byte_stride, self.count);
        let fits = match self.mode.as_str() {
            "ATTRIBUTES" => stride > 0 && stride <= 256 && stride.is_multiple_of(4),
            "TRIANGLES" => (stride == 2 || stride == 4) && count.is_multiple_of(3),
            "INDICES" => stride == 2 || stride == 4,
            mode => return Err(format!("mode {mode} is not defined by the extension")),
        };
        if !fits {
            return Err(format!("{count} elements of {stride} bytes cannot be packed as {}", self.mode));
        }
        // Minimum sizes: two bits per 256 bytes of attributes, one byte per index, one byte per triangle.
        let least = if self.mode == "ATTRIBUTES" { count.saturating_mul(stride) / 1_024 } else { count / 3 };
        if least as u64 > self.byte_length {
            return Err(format!("{count} elements cannot be packed in {} bytes", self.byte_length));
        }
        count.checked_mul(stride).ok_or_else(|| format!("{count} elements are too many"))
    }

    /// Decompresses the elements of `packed`.
    pub fn unpack(&self, packed: &[u8]) -> Result<Vec<u8>, String> {
        let size = self.unpacked_bytes()?;
        let mut bytes = match self.mode.as_str() {
            "ATTRIBUTES" => attributes(packed, self.count, self.byte_stride)?,
            "TRIANGLES" => self.indices(triangles(packed, self.count)?),
            _ => self.indices(sequence(packed, self.count)?),
        };
        debug_assert_eq!(bytes.len(), size);
        match self.filter.as_deref().unwrap_or("NONE") {
            "NONE" => {}
            "OCTAHEDRAL" if self.byte_stride == 4 => bytes.as_chunks_mut().0.iter_mut().for_each(octahedral_8),
            "OCTAHEDRAL" if self.byte_stride == 8 => each_i16(&mut bytes, octahedral_16),
            "QUATERNION" if self.byte_stride == 8 => each_i16(&mut bytes, quaternion),
            "EXPONENTIAL" => bytes.as_chunks_mut().0.iter_mut().for_each(exponential),
            "COLOR" if self.byte_stride == 4 => bytes.as_chunks_mut().0.iter_mut().for_each(color_8),
            "COLOR" if self.byte_stride == 8 => each_i16(&mut bytes, color_16),
            filter => return Err(format!("filter {filter} does not fit elements of {} bytes", self.byte_stride)),
        }
        Ok(bytes)
    }

    fn indices(&self, indices: Vec<u32>) -> Vec<u8> {
        match self.byte_stride {
            2 => indices.iter().flat_map(|&i| (i as u16).to_le_bytes()).collect(),
            _ => indices.iter().flat_map(|i| i.to_le_bytes()).collect(),
        }
    }
}

/// Attribute codec: blocks of elements, stored per byte as differences to the previous element.
fn attributes(packed: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, String> {
    let mut reader = Reader { bytes: packed };
    let version = match reader.byte()? {
        0xa0 => 0,
        0xa1 => 1,
        header => return Err(format!("begins with {header:#x}, which is not the header of packed attributes")),
    };
    // After the blocks: the element before the first and, in the newer codec, one channel mode per four bytes.
    let tail = if version == 0 { stride } else { stride + stride / 4 };
    let padded = tail.max(if version == 0 { 32 } else { 24 });
    let blocks = reader.bytes.len().checked_sub(padded).ok_or(CUT_OFF)?;
    let (blocks, behind) = reader.bytes.split_at(blocks);
    let (last, channels) = behind[padded - tail..].split_at(stride);
    let mut last = last.to_vec();
    let mut reader = Reader { bytes: blocks };
    // 8192 bytes per block, a multiple of sixteen elements, at most 256.
    let block = ((8_192 / stride) & !15).min(256);
    let mut elements = Vec::new();
    while elements.len() < count * stride {
        let in_block = block.min(count - elements.len() / stride);
        let begin = elements.len();
        elements.resize(begin + in_block * stride, 0);
        let control = reader.take(if version == 0 { 0 } else { stride / 4 })?;
        for four in 0..stride / 4 {
            let mut columns: [Vec<u8>; 4] = Default::default();
            for (byte, column) in columns.iter_mut().enumerate() {
                let how = control.get(four).map_or(0, |c| c >> (2 * byte) & 3);
                *column = match (version, how) {
                    (_, 3) => reader.take(in_block)?.to_vec(),
                    (_, 2) => vec![0; in_block],
                    (0, _) => groups(&mut reader, in_block, [0, 2, 4, 8])?,
                    (_, 0) => groups(&mut reader, in_block, [0, 1, 2, 4])?,
                    _ => groups(&mut reader, in_block, [1, 2, 4, 8])?,
                };
            }
            let channel = channels.get(four).copied().unwrap_or(0);
            let mut before: [u8; 4] = last[4 * four..4 * four + 4].try_into().expect("four bytes");
            for i in 0..in_block {
                let delta = [0, 1, 2, 3].map(|k: usize| columns[k][i]);
                before = add(before, delta, channel)?;
                elements[begin + i * stride + 4 * four..][..4].copy_from_slice(&before);
            }
        }
        last.copy_from_slice(&elements[elements.len() - stride..]);
    }
    if !reader.bytes.is_empty() {
        return Err(format!("has {} bytes after its last element", reader.bytes.len()));
    }
    Ok(elements)
}

/// Adds `delta` to `before` in the mode of `channel`.
fn add(before: [u8; 4], delta: [u8; 4], channel: u8) -> Result<[u8; 4], String> {
    Ok(match channel & 3 {
        0 => std::array::from_fn(|k| {
            let d = delta[k];
            before[k].wrapping_add((d >> 1) ^ (d & 1).wrapping_neg())
        }),
        1 => {
            let half = |k: usize| {
                let d = u16::from_le_bytes([delta[k], delta[k + 1]]);
                let before = u16::from_le_bytes([before[k], before[k + 1]]);
                before.wrapping_add((d >> 1) ^ (d & 1).wrapping_neg()).to_le_bytes()
            };
            let ([a, b], [c, d]) = (half(0), half(2));
            [a, b, c, d]
        }
        2 => {
            let turned = u32::from_le_bytes(delta).rotate_right(u32::from(channel >> 4));
            (u32::from_le_bytes(before) ^ turned).to_le_bytes()
        }
        _ => return Err(format!("channel {channel} is not defined by the extension")),
    })
}

/// Groups of sixteen bytes of 0 to 8 bits each; every group selects one of four `widths`.
fn groups(reader: &mut Reader, count: usize, widths: [u32; 4]) -> Result<Vec<u8>, String> {
    let group_count = count.div_ceil(16);
    let header = reader.take(group_count.div_ceil(4))?;
    let mut bytes = Vec::with_capacity(16 * group_count);
    for group in 0..group_count {
        let width = widths[usize::from(header[group / 4] >> (2 * (group % 4)) & 3)];
        match width {
            0 => bytes.extend([0; 16]),
            8 => bytes.extend_from_slice(reader.take(16)?),
            _ => {
                let packed = reader.take(2 * width as usize)?;
                let most = (1u8 << width) - 1;
                let in_byte = 8 / width;
                for i in 0..16 {
                    let (byte, at) = (packed[(i / in_byte) as usize], i % in_byte);
                    // Single bits start at the lowest, wider values at the highest.
                    let shift = if width == 1 { at } else { 8 - width * (at + 1) };
                    let value = byte >> shift & most;
                    // The largest value stands for a full byte after the group.
                    bytes.push(if value == most { reader.byte()? } else { value });
                }
            }
        }
    }
    bytes.truncate(count);
    Ok(bytes)
}

/// The last sixteen edges and vertices, to which triangle codes refer.
struct TriangleFifo {
    edges: [[u32; 2]; 16],
    edge_end: usize,
    vertices: [u32; 16],
    vertex_end: usize,
}

impl TriangleFifo {
    fn edge(&self, back: u8) -> [u32; 2] {
        self.edges[self.edge_end.wrapping_sub(1 + usize::from(back)) & 15]
    }

    fn vertex(&self, back: u8) -> u32 {
        self.vertices[self.vertex_end.wrapping_sub(usize::from(back)) & 15]
    }

    fn add_edge(&mut self, edge: [u32; 2]) {
        self.edges[self.edge_end] = edge;
        self.edge_end = (self.edge_end + 1) & 15;
    }

    fn add_vertex(&mut self, vertex: u32) {
        self.vertices[self.vertex_end] = vertex;
        self.vertex_end = (self.vertex_end + 1) & 15;
    }
}

fn zigzag(value: u32) -> u32 {
    (value >> 1) ^ (value & 1).wrapping_neg()
}

/// Triangle codec: one code per triangle, then data that the codes require, then a table of common codes.
fn triangles(packed: &[u8], count: usize) -> Result<Vec<u32>, String> {
    let mut reader = Reader { bytes: packed };
    let header = reader.byte()?;
    if header != 0xe0 && header != 0xe1 {
        return Err(format!("begins with {header:#x}, which is not the header of packed triangles"));
    }
    let near_end = if header == 0xe1 { 13 } else { 15 };
    let codes = reader.take(count / 3)?;
    let (data, table) = reader.bytes.split_at_checked(reader.bytes.len().wrapping_sub(16)).ok_or(CUT_OFF)?;
    let mut reader = Reader { bytes: data };
    let mut fifo = TriangleFifo { edges: [[u32::MAX; 2]; 16], edge_end: 0, vertices: [u32::MAX; 16], vertex_end: 0 };
    let (mut next, mut last) = (0u32, 0u32);
    let mut indices = Vec::with_capacity(count);
    for &code in codes {
        if code < 0xf0 {
            let [a, b] = fifo.edge(code >> 4);
            let near = code & 15;
            let c = if near == 0 {
                next = next.wrapping_add(1);
                next.wrapping_sub(1)
            } else if near < near_end {
                fifo.vertex(near + 1)
            } else {
                // 13 and 14 mean the index before and after the last one.
                let step = if near == 15 { zigzag(reader.varint()?) } else { (u32::from(near) * 2).wrapping_sub(27) };
                last = last.wrapping_add(step);
                last
            };
            if near == 0 || near >= near_end {
                fifo.add_vertex(c);
            }
            fifo.add_edge([c, b]);
            fifo.add_edge([a, c]);
            indices.extend([a, b, c]);
            continue;
        }
        let (first, pair) = match code {
            0xfe => (0, reader.byte()?),
            0xff => (15, reader.byte()?),
            _ => (0, table[usize::from(code & 15)]),
        };
        let is_told = code >= 0xfe;
        if is_told && pair == 0 {
            next = 0;
        }
        let mut fresh = |is_fresh: bool| {
            let vertex = next;
            next = next.wrapping_add(u32::from(is_fresh));
            vertex
        };
        let (second, third) = (pair >> 4, pair & 15);
        let mut a = fresh(first == 0);
        let mut b = if second == 0 { fresh(true) } else { fifo.vertex(second) };
        let mut c = if third == 0 { fresh(true) } else { fifo.vertex(third) };
        if is_told {
            for (vertex, how) in [(&mut a, first), (&mut b, second), (&mut c, third)] {
                if how == 15 {
                    last = last.wrapping_add(zigzag(reader.varint()?));
                    *vertex = last;
                }
            }
        }
        fifo.add_vertex(a);
        if second == 0 || is_told && second == 15 {
            fifo.add_vertex(b);
        }
        if third == 0 || is_told && third == 15 {
            fifo.add_vertex(c);
        }
        fifo.add_edge([b, a]);
        fifo.add_edge([c, b]);
        fifo.add_edge([a, c]);
        indices.extend([a, b, c]);
    }
    if !reader.bytes.is_empty() {
        return Err(format!("has {} bytes after its last triangle", reader.bytes.len()));
    }
    Ok(indices)
}

/// Index codec: differences to one of two previous indices.
fn sequence(packed: &[u8], count: usize) -> Result<Vec<u32>, String> {
    let mut reader = Reader { bytes: packed };
    let header = reader.byte()?;
    if header != 0xd0 && header != 0xd1 {
        return Err(format!("begins with {header:#x}, which is not the header of packed indices"));
    }
    let mut last = [0u32; 2];
    let mut indices = Vec::new();
    for _ in 0..count {
        let value = reader.varint()?;
        let which = (value & 1) as usize;
        last[which] = last[which].wrapping_add(zigzag(value >> 1));
        indices.push(last[which]);
    }
    // A tail of four bytes.
    if reader.bytes.len() == 4 { Ok(indices) } else { Err("has a length that differs from its indices".into()) }
}

fn each_i16(bytes: &mut [u8], decode: impl Fn(&mut [i16; 4])) {
    for element in bytes.as_chunks_mut::<8>().0 {
        let mut values: [i16; 4] = std::array::from_fn(|k| i16::from_le_bytes([element[2 * k], element[2 * k + 1]]));
        decode(&mut values);
        for (k, value) in values.iter().enumerate() {
            element[2 * k..2 * k + 2].copy_from_slice(&value.to_le_bytes());
        }
    }
}

/// Unit vectors, octahedral: two coordinates and the value that represents 1.
fn octahedral([x, y, one]: [f32; 3], largest: f32) -> [f32; 3] {
    let z = one - x.abs() - y.abs();
    let fold = z.min(0.0);
    let unfold = |t: f32| t + if t >= 0.0 { fold } else { -fold };
    let (x, y) = (unfold(x), unfold(y));
    let scale = largest / (x * x + y * y + z * z).sqrt();
    // Rounds half away from zero, as the extension does.
    [x, y, z].map(|t| (t * scale).round())
}

fn octahedral_8(element: &mut [u8; 4]) {
    let [x, y, one, _] = element.map(|b| f32::from(b as i8));
    let unit = octahedral([x, y, one], 127.0);
    (0..3).for_each(|k| element[k] = unit[k] as i8 as u8);
}

fn octahedral_16(element: &mut [i16; 4]) {
    let [x, y, one, _] = element.map(f32::from);
    let unit = octahedral([x, y, one], 32_767.0);
    (0..3).for_each(|k| element[k] = unit[k] as i16);
}

/// Unit quaternions without their largest component; the fourth value holds its index and the scale.
fn quaternion(element: &mut [i16; 4]) {
    let [x, y, z, _] = element.map(f32::from);
    let (scale, largest) = (f32::from(element[3] | 3), (element[3] & 3) as usize);
    let w = (2.0 * scale * scale - x * x - y * y - z * z).max(0.0).sqrt();
    let to_i16 = |t: f32| (t * (32_767.0 / 2.0f32.sqrt() / scale)).round() as i16;
    for (k, value) in [w, x, y, z].into_iter().enumerate() {
        element[(largest + k) & 3] = to_i16(value);
    }
}

/// 24-bit mantissa and 8-bit exponent, converted to single precision.
fn exponential(element: &mut [u8; 4]) {
    let value = u32::from_le_bytes(*element) as i32;
    let (mantissa, exponent) = (value << 8 >> 8, value >> 24);
    let scale = f32::from_bits(((exponent + 127) as u32) << 23);
    *element = (scale * mantissa as f32).to_le_bytes();
}

/// YCoCg; the highest set bit of alpha determines the scale.
fn color([y, co, cg]: [i32; 3], alpha: i32, bits: u32) -> [f32; 4] {
    let mut whole = alpha;
    for shift in [1, 2, 4, 8] {
        whole |= whole >> shift;
    }
    let opacity = (alpha << 1) & whole | (alpha & 1);
    let scale = ((1u32 << bits) - 1) as f32 / whole as f32;
    [y + co - cg, y + cg, y - co - cg, opacity].map(|t| (t as f32 * scale + 0.5).floor())
}

fn color_8(element: &mut [u8; 4]) {
    let [y, co, cg, alpha] = *element;
    let rgba = color([y.into(), (co as i8).into(), (cg as i8).into()], alpha.into(), 8);
    *element = rgba.map(|t| t as u8);
}

fn color_16(element: &mut [i16; 4]) {
    let [y, co, cg, alpha] = *element;
    let rgba = color([(y as u16).into(), co.into(), cg.into()], (alpha as u16).into(), 16);
    *element = rgba.map(|t| t as u16 as i16);
}
