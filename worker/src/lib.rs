//! Plumbline: one video in, one measured row out, in a limited child process.
