//! Plumbline: end-to-end tests over the built commands.
