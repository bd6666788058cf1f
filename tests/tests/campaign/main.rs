//! The suite `campaign`: a fleet of the built commands at work while everything around it breaks.
//!
//! `campaign`: seeded faults of all kinds over many runs of one corpus; nothing lost, nothing twice, the
//! same bytes as undisturbed. `prefetch`: no consumer ever holds more than its slots, through a restart of
//! the broker. `setup`: the corpus, the programs and what stands between them; `fault`: what goes wrong;
//! `check`: what must be so afterwards; `hang`: whether it still moves; `journal`: what was done, and when.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking, and says what it did"
)]

mod campaign;
mod check;
mod fault;
mod hang;
mod journal;
mod prefetch;
mod setup;
