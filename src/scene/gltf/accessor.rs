//! Accessors: every offset, stride and count is checked against the available bytes before anything is allocated.

use gltf::json;
use json::accessor::{ComponentType, Type};

use super::document::Document;
use crate::error::Result;

// An accessor without a buffer view is all zeros, whatever size it claims. This is the limit per accessor, and half the
// limit per file. Morph targets use such accessors, with a few sparse values.
const MAX_ZEROS: usize = 1 << 22;

/// A component type and whether it is normalized, as in the specification's tables.
pub type Form = (ComponentType, bool);

pub const F32: Form = (ComponentType::F32, false);
pub const I8: Form = (ComponentType::I8, false);
pub const I8_NORM: Form = (ComponentType::I8, true);
pub const U8: Form = (ComponentType::U8, false);
pub const U8_NORM: Form = (ComponentType::U8, true);
pub const I16: Form = (ComponentType::I16, false);
pub const I16_NORM: Form = (ComponentType::I16, true);
pub const U16: Form = (ComponentType::U16, false);
pub const U16_NORM: Form = (ComponentType::U16, true);
pub const U32: Form = (ComponentType::U32, false);

/// Elements in a buffer, checked to be in range.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl<'a> Elements<'a> {
    fn iter(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let (bytes, stride, size) = (self.bytes, self.stride, self.size);
        (0..self.count).map(move |i| &bytes[i * stride..i * stride + size])
    }
}

impl Document {
    pub fn accessor_count(&self, index: usize, what: &str) -> Result<usize> {
        let accessor = self.item(&self.root.accessors, index, "accessor", what)?;
        usize::try_from(accessor.count.0).map_err(|_| self.error(format!("{what}: accessor {index} is too long")))
    }

    /// The element type of accessor `index`.
    pub fn accessor_type(&self, index: usize, what: &str) -> Result<Type> {
        let accessor = self.item(&self.root.accessors, index, "accessor", what)?;
        self.valid(accessor.type_, &format!("{what}: the type of accessor {index}"))
    }

    /// Reads vectors of `N` numbers. glTF allows the forms in `core`, `KHR_mesh_quantization` also those in
    /// `quantized`.
    pub fn vectors<const N: usize>(
        &self,
        index: usize,
        what: &str,
        core: &[Form],
        quantized: &[Form],
    ) -> Result<Vec<[f32; N]>> {
        let expected = match N {
            16 => Type::Mat4,
            _ => [Type::Scalar, Type::Vec2, Type::Vec3, Type::Vec4][N - 1],
        };
        let (component, normalized) = self.form(index, what, expected, core, quantized)?;
        let read = reader(component, normalized);
        let size = component.size();
        let element = |bytes: &[u8]| std::array::from_fn(|i| read(&bytes[i * size..(i + 1) * size]));
        self.decode(index, what, size * N, [0.0; N], element)
    }

    /// Reads vertex indices.
    pub fn indices(&self, index: usize, what: &str) -> Result<Vec<u32>> {
        let (component, _) = self.form(index, what, Type::Scalar, &[U8, U16, U32], &[])?;
        self.decode(index, what, component.size(), 0, unsigned)
    }

    fn form(&self, index: usize, what: &str, expected: Type, core: &[Form], quantized: &[Form]) -> Result<Form> {
        let accessor = self.item(&self.root.accessors, index, "accessor", what)?;
        let what = format!("{what}: accessor {index}");
        let json::accessor::GenericComponentType(component) =
            self.valid(accessor.component_type, &format!("{what}: the component type"))?;
        if self.valid(accessor.type_, &format!("{what}: the type"))? != expected {
            return Err(self.error(format!("{what} is not of type {expected:?}")));
        }
        let form = (component, accessor.normalized && component != ComponentType::F32);
        if core.contains(&form) {
            return Ok(form);
        }
        let normalized = if form.1 { "normalized " } else { "" };
        if !quantized.contains(&form) {
            return Err(self.error(format!("{what} holds {normalized}{component:?}, which is not allowed there")));
        }
        if !self.uses("KHR_mesh_quantization") {
            let reason = format!("{what} holds {normalized}{component:?} without KHR_mesh_quantization");
            return Err(self.error(reason));
        }
        Ok(form)
    }

    fn decode<T: Copy>(
        &self,
        index: usize,
        what: &str,
        size: usize,
        zero: T,
        element: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>> {
        let accessor = self.item(&self.root.accessors, index, "accessor", what)?;
        let what = format!("{what}: accessor {index}");
        let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
        let mut values: Vec<T> = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.unwrap_or_default().0;
                self.elements(view.value(), offset, count, size, &what)?.iter().map(&element).collect()
            }
            None if count <= MAX_ZEROS => {
                self.count_zeros(index, count, &what)?;
                vec![zero; count]
            }
            None => return Err(self.error(format!("{what} has {count} elements and no buffer view"))),
        };
        if let Some(sparse) = &accessor.sparse {
            let what = format!("{what}, sparse");
            let count = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
            let json::accessor::IndexComponentType(component) =
                self.valid(sparse.indices.component_type, &format!("{what}: the type of indices"))?;
            let (at, to) = (&sparse.indices, &sparse.values);
            let at = self.elements(at.buffer_view.value(), at.byte_offset.0, count, component.size(), &what)?;
            let to = self.elements(to.buffer_view.value(), to.byte_offset.0, count, size, &what)?;
            let length = values.len();
            for (at, to) in at.iter().zip(to.iter()) {
                let at = unsigned(at) as usize;
                *values.get_mut(at).ok_or_else(|| {
                    self.error(format!("{what}: index {at} is out of range, there are {length} elements"))
                })? = element(to);
            }
        }
        Ok(values)
    }

    /// Counts an accessor without a buffer view towards the file's limit, once.
    fn count_zeros(&self, index: usize, count: usize, what: &str) -> Result<()> {
        let mut zeros = self.zeros.lock().expect("nothing panics while it holds this");
        let (known, of_file) = &mut *zeros;
        if known.insert(index) {
            *of_file += count;
        }
        if *of_file > 2 * MAX_ZEROS {
            return Err(self.error(format!("{what}: {of_file} elements together have no buffer view")));
        }
        Ok(())
    }

    /// Whether accessor `index` contains only zeros.
    pub fn is_all_zeros(&self, index: usize) -> bool {
        self.root.accessors.get(index).is_some_and(|a| a.buffer_view.is_none() && a.sparse.is_none())
    }

    fn elements(&self, view: usize, offset: u64, count: usize, size: usize, what: &str) -> Result<Elements<'_>> {
        let stride = self.item(&self.root.buffer_views, view, "buffer view", what)?.byte_stride.map(|s| s.0);
        let view = self.view(view, what)?;
        let stride = stride.filter(|&s| s != 0).unwrap_or(size);
        // Overlapping elements would let a small file claim any number of them.
        if stride < size {
            return Err(self.error(format!("{what}: stride {stride} is less than an element's {size} bytes")));
        }
        let offset = usize::try_from(offset).unwrap_or(usize::MAX);
        let end = match count {
            0 => Some(offset),
            _ => (count - 1).checked_mul(stride).and_then(|n| n.checked_add(size)).and_then(|n| n.checked_add(offset)),
        };
        match end {
            Some(end) if end <= view.len() => Ok(Elements { bytes: &view[offset..end], stride, size, count }),
            _ => {
                let there = view.len();
                Err(self.error(format!("{what}: {count} elements at byte {offset} overrun a view of {there} bytes")))
            }
        }
    }

    /// The bytes of buffer view `index`.
    pub fn view(&self, index: usize, what: &str) -> Result<&[u8]> {
        let view = self.item(&self.root.buffer_views, index, "buffer view", what)?;
        let what = format!("{what}: buffer view {index}");
        let buffer = self.buffer(view.buffer.value(), &what)?;
        let begin = view.byte_offset.unwrap_or_default().0;
        let range = begin.checked_add(view.byte_length.0).and_then(|end| {
            let range = usize::try_from(begin).ok()?..usize::try_from(end).ok()?;
            buffer.get(range)
        });
        range.ok_or_else(|| {
            let (length, there) = (view.byte_length.0, buffer.len());
            self.error(format!("{what}: {length} bytes at {begin} overrun a buffer of {there}"))
        })
    }
}

fn unsigned(bytes: &[u8]) -> u32 {
    match *bytes {
        [a] => a.into(),
        [a, b] => u16::from_le_bytes([a, b]).into(),
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        _ => unreachable!("indices are 1, 2 or 4 bytes, not {}", bytes.len()),
    }
}

/// Converts one component to a number [glTF 2.0, 3.11; KHR_mesh_quantization].
fn reader(component: ComponentType, normalized: bool) -> impl Fn(&[u8]) -> f32 {
    let largest = match (normalized, component) {
        (true, ComponentType::I8) => 127.0,
        (true, ComponentType::U8) => 255.0,
        (true, ComponentType::I16) => 32_767.0,
        (true, ComponentType::U16) => 65_535.0,
        _ => 1.0,
    };
    let lowest = if normalized { -1.0 } else { f32::NEG_INFINITY };
    move |bytes| {
        let value = match component {
            ComponentType::I8 => f32::from(bytes[0] as i8),
            ComponentType::U8 => f32::from(bytes[0]),
            ComponentType::I16 => f32::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            ComponentType::U16 => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            ComponentType::U32 => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as f32,
            ComponentType::F32 => return f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        };
        (value / largest).max(lowest)
    }
}
