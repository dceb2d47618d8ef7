//! The table of a view's values from which the device interpolates. Twin of the lookup: src/reference/composite.rs.

use std::sync::Arc;

use glam::UVec2;

use crate::error::Result;
use crate::gpu::{Buffer, Context};
use crate::image::display_view::DisplayView;
use crate::shared::{DISPLAY_TABLE_END, DISPLAY_TABLE_SIDE, DISPLAY_TABLE_TOE};

/// A view's values on the device.
pub struct DisplayTable {
    view: Arc<DisplayView>,
    entries: Buffer<UVec2>,
}

impl DisplayTable {
    pub fn new(context: &Arc<Context>, view: &Arc<DisplayView>) -> Result<Self> {
        let entries = Buffer::from_slice(context, "display table", &values(view))?;
        Ok(Self { view: view.clone(), entries })
    }

    pub fn is_of(&self, view: &Arc<DisplayView>) -> bool {
        Arc::ptr_eq(&self.view, view)
    }

    pub fn entries(&self) -> &Buffer<UVec2> {
        &self.entries
    }
}

const SIDE: usize = DISPLAY_TABLE_SIDE as usize;

/// Entries of a view's table, red changing fastest: 16-bit fractions of red and green in x, of blue in y.
pub fn values(view: &DisplayView) -> Vec<UVec2> {
    let place = |index: usize| {
        let stops = (1.0 + DISPLAY_TABLE_END / DISPLAY_TABLE_TOE).log2() * index as f32 / (SIDE - 1) as f32;
        DISPLAY_TABLE_TOE * (stops.exp2() - 1.0)
    };
    let colors = |i: usize| [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)].map(place);
    let mut colors: Vec<[f32; 3]> = (0..SIDE * SIDE * SIDE).map(colors).collect();
    view.apply(&mut colors);
    let packed = |[r, g, b]: [f32; 3]| {
        let [r, g, b] = [r, g, b].map(|value| (value.clamp(0.0, 1.0) * 65535.0).round() as u32);
        UVec2::new(r | g << 16, b)
    };
    colors.into_iter().map(packed).collect()
}
