//! What stands around learned networks: pictures in, correlations between their parts, flow and motion
//! out. The networks themselves are behind one trait, [`Network`]; nothing here knows how they run.
//!
//! Sources: SEA-RAFT ([`sea_raft`]) and DROID-SLAM ([`droid`]) as WorldScore runs them. Arrays are planar,
//! `[channels, rows, columns]`, row-major, unless said otherwise; a *cell* is one of the 1/8 grid, a
//! position is column (x) then row (y), centres at integers.

pub mod convex;
pub mod correlation;
pub mod droid;
pub mod droid_operator;
mod error;
mod network;
pub mod opencv_resize;
pub mod picture;
pub mod sea_raft;
pub mod tracking_picture;

pub use error::LearnedError;
pub use network::{Network, NetworkError, Tensor, TensorView};

/// Pixels of a picture along one side of a cell.
pub const CELL_PX: usize = 8;
