//! What the kernel refuses to a compute process, whatever a hostile video makes of its decoder.
//!
//! Two of the kernel's own means, neither of which needs privileges: Landlock for files and signals, seccomp for
//! calls. Reading and loading libraries stay allowed, so that videos, models and ONNX Runtime are found as
//! anywhere. Where a kernel has less, the rest holds, and [`probe`] says what is missing.

use std::collections::BTreeMap;

use landlock::{ABI, Access, AccessFs, AccessNet, Ruleset, RulesetAttr, RulesetStatus, Scope};
use seccompiler::{BpfProgram, SeccompAction, SeccompFilter};

/// Calls that are refused with "operation not permitted": what opens a way to the network (of all families;
/// an io_uring could, past this filter), starts another program, or reaches into another process.
const REFUSED_CALLS: [i64; 9] = [
    libc::SYS_socket,
    libc::SYS_io_uring_setup,
    libc::SYS_execve,
    libc::SYS_execveat,
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_pidfd_getfd,
    libc::SYS_bpf,
];

/// One protection, and why it does not hold, where it does not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Protection {
    /// What is refused, for people.
    pub what: &'static str,
    /// Why it is not.
    pub missing: Option<String>,
}

/// Gives up, on this thread and all that it starts, what a compute process does not need; for good.
pub(super) fn confine() -> [Protection; 2] {
    [
        Protection {
            what: "changing files, and signals to other processes (Landlock)",
            missing: restrict_files().err(),
        },
        Protection {
            what: "network, other programs and other processes' memory (seccomp)",
            missing: filter_calls().err(),
        },
    ]
}

/// What the kernel of this machine would refuse to a compute process: tried on a thread that ends with it.
#[must_use]
pub fn probe() -> Vec<Protection> {
    let tried = std::thread::spawn(|| confine().to_vec()).join();
    tried.unwrap_or_default()
}

/// No right to change anything is granted anywhere. What an older kernel does not know stays allowed.
fn restrict_files() -> Result<(), String> {
    let abi = ABI::V6;
    let status = Ruleset::default()
        .handle_access(AccessFs::from_write(abi))
        .and_then(|rules| rules.handle_access(AccessNet::from_all(abi)))
        .and_then(|rules| rules.scope(Scope::from_all(abi)))
        .and_then(Ruleset::create)
        .and_then(landlock::RulesetCreated::restrict_self)
        .map_err(|error| error.to_string())?;
    match status.ruleset {
        RulesetStatus::FullyEnforced => Ok(()),
        RulesetStatus::PartiallyEnforced => Err("this kernel knows only a part of it".to_owned()),
        RulesetStatus::NotEnforced => Err("this kernel has none".to_owned()),
    }
}

fn filter_calls() -> Result<(), String> {
    let always: BTreeMap<i64, Vec<_>> = REFUSED_CALLS.map(|call| (call, Vec::new())).into();
    let target = std::env::consts::ARCH
        .try_into()
        .map_err(|error: seccompiler::BackendError| error.to_string())?;
    let refused = SeccompAction::Errno(libc::EPERM as u32);
    let program: BpfProgram = SeccompFilter::new(always, SeccompAction::Allow, refused, target)
        .and_then(TryInto::try_into)
        .map_err(|error| error.to_string())?;
    seccompiler::apply_filter(&program).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::io::ErrorKind::PermissionDenied;
    use std::net::{TcpListener, TcpStream, UdpSocket};
    use std::process::Command;
    use std::thread;

    use super::*;

    /// Whether a protection can be tested on this kernel.
    fn holds(protection: &Protection) -> bool {
        if let Some(reason) = &protection.missing {
            eprintln!("skipped: {}: {reason}", protection.what);
        }
        protection.missing.is_none()
    }

    #[test]
    fn a_confined_thread_reads_and_does_nothing_else() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let (kept, new) = (dir.path().join("kept"), dir.path().join("new"));
        fs::write(&kept, "x").unwrap();
        let try_everything = move || {
            let [files, calls] = confine();
            // What a thread of it starts is confined, too.
            let refused = thread::spawn(move || {
                assert_eq!(fs::read_to_string(&kept).unwrap(), "x");
                if holds(&files) {
                    for change in [
                        File::create(&new).map(drop),
                        File::options().write(true).open(&kept).map(drop),
                        fs::remove_file(&kept),
                        fs::create_dir(&new),
                        fs::rename(&kept, &new),
                    ] {
                        assert_eq!(change.unwrap_err().kind(), PermissionDenied);
                    }
                }
                if holds(&calls) {
                    for reach in [
                        TcpStream::connect(address).map(drop),
                        UdpSocket::bind("127.0.0.1:0").map(drop),
                        std::os::unix::net::UnixDatagram::unbound().map(drop),
                        Command::new("true").status().map(drop),
                    ] {
                        assert_eq!(reach.unwrap_err().kind(), PermissionDenied);
                    }
                }
            });
            refused.join().unwrap();
        };
        thread::spawn(try_everything).join().unwrap();
        assert_eq!(fs::read_to_string(dir.path().join("kept")).unwrap(), "x");
        // Nobody else is confined, not even by a probe.
        assert_eq!(probe().len(), 2);
        TcpStream::connect(address).unwrap();
        fs::write(dir.path().join("new"), "y").unwrap();
        assert!(Command::new("true").status().unwrap().success());
    }
}
