//! Error figures between an image and a reference.
