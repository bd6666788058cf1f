//! Plumbline: the coordinator library.
