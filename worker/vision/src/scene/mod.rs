//! Which motion model a frame pair requires, and what the best rigid one leaves unexplained.
