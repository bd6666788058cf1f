//! What later runs are compared with: frozen corpus statistics (`file`), fault thresholds (`faults`).

pub mod faults;
pub mod file;
