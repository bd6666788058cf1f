//! Prints the absolute trajectory error (RMSE, scale-aligned) of an estimate: TRUTH.txt ESTIMATE.txt.

#![allow(clippy::print_stdout, reason = "the result")]

use plumbline_vision::slam::trajectory::{TimedPose, absolute_error, parse_tum};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let read = |path: Option<String>| -> Result<Vec<TimedPose>, Box<dyn std::error::Error>> {
        let path = path.ok_or("usage: trajectory_error TRUTH.txt ESTIMATE.txt")?;
        Ok(parse_tum(&std::fs::read_to_string(path)?)?)
    };
    let mut arguments = std::env::args().skip(1);
    let truth = read(arguments.next())?;
    let estimate = read(arguments.next())?;
    println!("{:.6}", absolute_error(&estimate, &truth)?.rmse);
    Ok(())
}
