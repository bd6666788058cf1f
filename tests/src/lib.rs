//! Plumbline: end-to-end tests over the built commands.
//!
//! The library is what the suites share: the built binary ([`binary`]), small clips ([`clips`]), datasets of
//! them ([`datasets`]), runs with a deadline ([`run`]), a browser ([`browser`]), what a run published
//! ([`published`]), other processes ([`process`]), and for
//! fleets real servers ([`servers`]) and what goes wrong on the way to them ([`proxy`], [`s3_faults`]). The
//! suites are test binaries: `cli` runs the `plumbline` command, `campaign` a fleet under faults, `browser` looks at reports. Everything
//! here fails by panicking.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

pub mod binary;
pub mod browser;
pub mod clips;
pub mod datasets;
pub mod fleet;
pub mod process;
pub mod proxy;
pub mod published;
pub mod run;
pub mod s3_faults;
pub mod servers;
pub mod stub_chat;
