//! The suite `fleet`: `plumbline-worker` and `plumbline score --queue` against a real broker and a real store.
//!
//! `score`: what the README says, from nothing to scores with two workers, and the same bytes as without a
//! fleet; `resume`: a coordinator that is killed, and two for one run; `dead`: jobs that no worker gets done,
//! and their second chance; `cascade`: waves with several profiles; `learned`: model sets by digest from the
//! store; `setup`: a fleet of its own for each test.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod cascade;
mod datasets;
mod dead;
mod learned;
mod resume;
mod score;
mod setup;
