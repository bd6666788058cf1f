//! Plumbline's coordinator: freezes a corpus, hands out jobs, collects rows, reduces, publishes.

mod answers;
pub mod cli;
pub mod collect;
pub mod corpus;
pub mod evaluate;
pub mod explain;
pub mod fanout;
pub mod fleet;
mod heat_maps;
pub mod judge;
mod lease;
mod measuring;
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
pub mod slam;
mod stop;
pub mod thresholds;
pub mod watch;
