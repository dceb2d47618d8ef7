//! Scenes and maps load on threads of their own.

pub(super) mod load;
pub(super) mod loads;
pub(super) mod map_answer;
pub(super) mod map_reader;
