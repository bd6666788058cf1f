//! Man pages and shell completions of a command, from the definitions that its help is made of.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, Command, Subcommand};
use clap_complete::Shell;

/// What whoever packages a command asks of it; hidden from its help, which is for those who use it.
#[derive(Debug, Subcommand)]
pub enum Packaging {
    /// Writes the man pages of the command and its subcommands
    #[command(hide = true)]
    Man(ManArgs),
    /// Prints the completions for a shell
    #[command(hide = true)]
    Completions(CompletionsArgs),
}

/// Where man pages go.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Directory for the pages, one `.1` file each
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Which completions.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

impl Packaging {
    /// Writes or prints what was asked for.
    ///
    /// # Errors
    /// When that cannot be written.
    pub fn run(&self, mut command: Command) -> anyhow::Result<()> {
        match self {
            Self::Man(ManArgs { out }) => man(command, out),
            Self::Completions(CompletionsArgs { shell }) => {
                // Made whole first: a pipe that closes is an error, not a panic.
                let mut script = Vec::new();
                let name = command.get_name().to_owned();
                clap_complete::generate(*shell, &mut command, name, &mut script);
                let written = std::io::stdout().write_all(&script);
                written.context("standard output cannot be written")
            }
        }
    }
}

fn man(command: Command, out: &Path) -> anyhow::Result<()> {
    let written =
        std::fs::create_dir_all(out).and_then(|()| clap_mangen::generate_to(command, out));
    written.with_context(|| format!("--out {}: cannot be written", out.display()))
}
