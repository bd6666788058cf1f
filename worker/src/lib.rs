//! Plumbline: one video in, one measured row out, in a limited child process.

pub mod child;
pub mod cli;
pub mod decode;
pub mod encode;
pub mod explain;
pub mod fetch;
pub mod fleet;
pub mod learned;
pub mod measure;
pub mod packaging;
pub mod profile;
pub mod settings;
pub mod slam;
