//! Where the map of a dome comes from.

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use super::{PhysicalSky, SkyMap};
use crate::scene::light_filter::Attached;

/// The map of a dome.
#[derive(Clone, Debug)]
pub enum DomeMap {
    File(Attached<SkyMap>),
    Physical(RenderedSky),
}

/// A physical sky and its map, which is rendered when it is first needed.
#[derive(Clone)]
pub struct RenderedSky {
    sky: PhysicalSky,
    map: Arc<OnceLock<SkyMap>>,
}

impl DomeMap {
    /// The map of a physical sky, whose parameters must be in their ranges.
    pub fn physical(sky: PhysicalSky) -> Self {
        Self::Physical(RenderedSky { sky, map: Arc::default() })
    }

    pub fn as_file(&self) -> Option<&Attached<SkyMap>> {
        match self {
            Self::File(map) => Some(map),
            Self::Physical(_) => None,
        }
    }

    pub fn as_physical(&self) -> Option<&PhysicalSky> {
        match self {
            Self::File(_) => None,
            Self::Physical(map) => Some(map.sky()),
        }
    }
}

impl RenderedSky {
    pub fn sky(&self) -> &PhysicalSky {
        &self.sky
    }
}

impl Deref for DomeMap {
    type Target = SkyMap;

    fn deref(&self) -> &SkyMap {
        match self {
            Self::File(map) => map,
            Self::Physical(RenderedSky { sky, map }) => map.get_or_init(|| sky.map()),
        }
    }
}

/// Equal files, or equal parameters.
impl PartialEq for DomeMap {
    fn eq(&self, other: &Self) -> bool {
        self.as_file() == other.as_file() && self.as_physical() == other.as_physical()
    }
}

impl std::fmt::Debug for RenderedSky {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.sky.fmt(f)
    }
}
