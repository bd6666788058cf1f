//! The solver against its slow twin, under everything that a graph can be, and on any number of threads.

mod cases;
mod dense;
mod extremes;
mod hostile;
mod robust;
mod threads;
