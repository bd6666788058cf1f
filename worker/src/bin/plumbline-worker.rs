//! The `plumbline-worker` command.

fn main() -> std::process::ExitCode {
    plumbline_worker::cli::main()
}
