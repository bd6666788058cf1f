//! The `plumbline` command.

fn main() -> std::process::ExitCode {
    plumbline_coordinator::cli::main()
}
