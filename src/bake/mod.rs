//! Scene -> [`Baked`]: everything that does not depend on the lights, one call per stage, in order.

pub mod bvh;
pub mod packet;
