//! Plumbline's coordinator: freezes a corpus, hands out jobs, collects rows, reduces, publishes.

pub mod cli;
pub mod collect;
pub mod corpus;
pub mod evaluate;
pub mod explain;
pub mod fanout;
mod heat_maps;
pub mod judge;
mod lease;
mod npz;
pub mod picture;
pub mod profiles;
pub mod progress;
pub mod publish;
pub mod reduce;
pub mod reduce_files;
pub mod reference;
pub mod report;
pub mod run;
pub mod sample;
pub mod settings;
pub mod slam;
mod stop;
pub mod thresholds;
pub mod watch;
