//! Plumbline: one video in, one measured row out, in a limited child process.

pub mod child;
pub mod decode;
pub mod encode;
pub mod explain;
pub mod learned;
pub mod measure;
pub mod profile;
pub mod slam;
