//! The suite `cli`: `plumbline score` from end to end, over the built binary and small clips.
//!
//! `main_path` and `sources`: what a user gets. `resume`: kills, signals, repeats, the same bytes.
//! `faults`: known faults in the published rows. `frozen`: frozen references and watches. `evaluate`,
//! `explain`, `flow`, `heatmaps`, `judge`, `reference`, `slam`, `tradeoff`: the commands and flags of these names.
//! `learned`: the profile `reference` and SEA-RAFT's flow, over models of random weights. `cascade`: budgets.
//! `outlier`: one clip that moves the weights. `trainer_lists`: episodes and shards for trainers. `datasets`: the
//! same as sources.
//! `hostile`: bad videos and bad names. `system`: permissions, full disks, lost and limited compute
//! processes. `paper`: the published numbers, recomputed by hand.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking, and says what it could not try"
)]

mod cascade;
mod datasets;
mod evaluate;
mod explain;
mod faults;
mod flow;
mod frozen;
mod heatmaps;
mod hostile;
mod judge;
mod learned;
mod main_path;
mod outlier;
mod paper;
mod profiles;
mod reduce;
mod reference;
mod resume;
mod slam;
mod sources;
mod system;
mod tradeoff;
mod trainer_lists;
