//! What was done to the fleet, and when: a line per fault in a file, and counts per kind.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Debug)]
pub(crate) struct Journal {
    started: Instant,
    file: File,
    path: PathBuf,
    faults: BTreeMap<String, u64>,
    notes: BTreeMap<String, u64>,
    /// Since the last fault: what could not be done, and why.
    not_now: BTreeMap<String, u64>,
}

impl Journal {
    pub(crate) fn create(path: PathBuf) -> Self {
        Self {
            started: Instant::now(),
            file: File::create(&path).unwrap(),
            path,
            faults: BTreeMap::new(),
            notes: BTreeMap::new(),
            not_now: BTreeMap::new(),
        }
    }

    /// A fault that was injected.
    pub(crate) fn fault(&mut self, kind: &str, detail: &str) {
        *self.faults.entry(kind.to_owned()).or_default() += 1;
        self.not_now.clear();
        self.line("fault", kind, detail);
    }

    /// A fault that could not be injected, and why.
    pub(crate) fn not_now(&mut self, kind: &str, why: &str) {
        let line = format!("{kind}: {why}");
        self.note("not now", &line);
        *self.not_now.entry(line).or_default() += 1;
    }

    /// Anything else worth counting.
    pub(crate) fn note(&mut self, kind: &str, detail: &str) {
        *self.notes.entry(kind.to_owned()).or_default() += 1;
        self.line("note", kind, detail);
    }

    fn line(&mut self, what: &str, kind: &str, detail: &str) {
        let at_s = self.started.elapsed().as_secs_f64();
        writeln!(self.file, "{at_s:9.3} {what} {kind}: {detail}").unwrap();
    }

    /// Faults so far.
    pub(crate) fn faults(&self) -> u64 {
        self.faults.values().sum()
    }

    pub(crate) fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// The counts, as text.
    pub(crate) fn summary(&self) -> String {
        let lines = |counts: &BTreeMap<String, u64>| -> String {
            let lines = counts.iter().map(|(kind, n)| format!("  {n:5} {kind}\n"));
            lines.collect()
        };
        format!(
            "{} faults in {:.0} s ({})\nnot now, since the last:\n{}done:\n{}of note:\n{}",
            self.faults(),
            self.elapsed_s(),
            self.path.display(),
            lines(&self.not_now),
            lines(&self.faults),
            lines(&self.notes),
        )
    }
}
