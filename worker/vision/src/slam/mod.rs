//! Camera trajectory and depth by dense bundle adjustment (Z. Teed, J. Deng, "DROID-SLAM: Deep Visual
//! SLAM for Monocular, Stereo, and RGB-D Cameras", NeurIPS 2021; WorldScore's vendored copy of it).
//!
//! A factor graph joins pairs of frames; each edge says where the grid cells of its source are in its
//! target and how far that is to be trusted. [`bundle`] moves camera poses and one inverse depth per
//! cell until the reprojections agree with these targets. [`tracker`] is the default, on targets from
//! optical flow ([`flow_operator`]); [`mod@reference`] is WorldScore's. Poses are `camera_from_world`
//! ([`se3`]); grids are `[rows, columns]` row-major, cell centres at integers, lengths in cells
//! unless a name says otherwise.

pub mod bundle;
pub mod camera;
pub mod distance;
pub mod flow_operator;
pub mod graph;
pub mod intrinsics;
pub mod keyframes;
mod lanes;
pub mod operator;
pub mod reference;
pub mod se3;
pub mod tracker;
pub mod trajectory;
