//! A converted model set: a directory of `.onnx` files and `model.json`, which tells their digests.
//!
//! Files are read whole, checked against their digest, and given to ONNX Runtime from memory: what was
//! checked is what runs. The set's own digest is that of `model.json`, and so covers every weight.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use plumbline_vision::learned::NetworkError;
use plumbline_vision::learned::droid::DroidNetworks;
use plumbline_vision::learned::sea_raft::{SeaRaft, SeaRaftNetworks, SeaRaftParams};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::runtime::Runtime;
use super::session::{OrtNetwork, Threads};

pub(super) const SIDECAR: &str = "model.json";
/// The format that is read; `deploy/models/model_set.py` writes it.
const FORMAT: u32 = 1;
/// A sidecar has some 3 kB, the largest graph 37 MB.
pub(super) const MOST_SIDECAR_BYTES: u64 = 1 << 20;
pub(super) const MOST_GRAPH_BYTES: u64 = 1 << 30;

/// A model set cannot be used; says what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// No converted set lies there.
    #[error(
        "no converted model in {directory}: convert the official checkpoint by deploy/models/convert.py --out {directory}",
        directory = directory.display()
    )]
    Missing {
        /// The directory.
        directory: PathBuf,
    },
    /// A file of the set is damaged, missing or of another kind.
    #[error("{path}: {reason}; convert the checkpoint again by deploy/models/convert.py", path = path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The set is of another network.
    #[error("{directory} holds {found}, not {wanted}", directory = directory.display())]
    AnotherNetwork {
        /// The directory.
        directory: PathBuf,
        /// The network it holds.
        found: String,
        /// The network asked for.
        wanted: &'static str,
    },
    /// ONNX Runtime does not take a graph.
    #[error(transparent)]
    Network(#[from] NetworkError),
}

#[derive(Debug, Deserialize)]
struct Sidecar {
    format: u32,
    network: String,
    configuration: serde_json::Value,
    graphs: BTreeMap<String, Graph>,
}

#[derive(Debug, Deserialize)]
struct Graph {
    file: String,
    sha256: String,
}

#[derive(Debug, Deserialize)]
struct SeaRaftConfiguration {
    iterations: usize,
    width: usize,
    radius: usize,
}

/// A model set whose sidecar was read.
#[derive(Debug)]
pub struct ModelSet {
    directory: PathBuf,
    sidecar: Sidecar,
    digest: String,
}

impl ModelSet {
    /// Reads the sidecar of a set.
    ///
    /// # Errors
    /// [`ModelError`] where there is none, or it is not one.
    pub fn read(directory: &Path) -> Result<Self, ModelError> {
        let path = directory.join(SIDECAR);
        if !path.is_file() {
            return Err(ModelError::Missing {
                directory: directory.to_owned(),
            });
        }
        let bytes = read_limited(&path, MOST_SIDECAR_BYTES)?;
        Self::parse(&path, &bytes)
    }

    /// The set of a sidecar with this content at `path`.
    ///
    /// # Errors
    /// [`ModelError::Damaged`] where it is none.
    pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Self, ModelError> {
        let sidecar: Sidecar =
            serde_json::from_slice(bytes).map_err(|error| damaged(path, error.to_string()))?;
        if sidecar.format != FORMAT {
            let reason = format!("format {}, this program reads {FORMAT}", sidecar.format);
            return Err(damaged(path, reason));
        }
        Ok(Self {
            directory: path.parent().unwrap_or(path).to_owned(),
            sidecar,
            digest: digest_of(bytes),
        })
    }

    /// SHA-256 of `model.json`, hexadecimal: names the weights, the graphs and the checkpoint.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Which network it is of: `sea-raft` or `droid`.
    #[must_use]
    pub fn network(&self) -> &str {
        &self.sidecar.network
    }

    /// Where it lies.
    #[must_use]
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// The names of its files, the sidecar's apart.
    ///
    /// # Errors
    /// [`ModelError::Damaged`] where one is no plain name.
    pub(super) fn files(&self) -> Result<Vec<&str>, ModelError> {
        let graphs = self.sidecar.graphs.values();
        graphs.map(|graph| self.file_name(graph)).collect()
    }

    /// Reads every file and holds it against its digest.
    ///
    /// # Errors
    /// [`ModelError::Damaged`].
    pub fn verify(&self) -> Result<(), ModelError> {
        let mut graphs = self.sidecar.graphs.values();
        graphs.try_for_each(|graph| self.read_graph(graph).map(drop))
    }

    /// SEA-RAFT as WorldScore uses it: at half resolution, with the size's own number of iterations.
    ///
    /// # Errors
    /// [`ModelError`] where the set is of another network or damaged.
    pub fn sea_raft(&self, runtime: &Runtime, threads: Threads) -> Result<SeaRaft, ModelError> {
        self.must_be("sea-raft")?;
        let configuration: SeaRaftConfiguration =
            serde_json::from_value(self.sidecar.configuration.clone())
                .map_err(|error| damaged(&self.directory.join(SIDECAR), error.to_string()))?;
        let open = |graph| self.open(runtime, graph, threads);
        let networks = SeaRaftNetworks {
            features: open("features")?,
            context: open("context")?,
            update: open("update")?,
            upsample: open("upsample")?,
        };
        let params = SeaRaftParams {
            width: configuration.width,
            radius: configuration.radius,
            iterations: configuration.iterations,
            half_resolution: true,
            stop_below_px: None,
        };
        Ok(SeaRaft::new(networks, params))
    }

    /// DROID-SLAM's networks.
    ///
    /// # Errors
    /// [`ModelError`] where the set is of another network or damaged.
    pub fn droid(&self, runtime: &Runtime, threads: Threads) -> Result<DroidNetworks, ModelError> {
        self.must_be("droid")?;
        let open = |graph| self.open(runtime, graph, threads);
        Ok(DroidNetworks {
            features: open("features")?,
            context: open("context")?,
            gates: open("gates")?,
            update: open("update")?,
            aggregate: open("aggregate")?,
        })
    }

    fn must_be(&self, wanted: &'static str) -> Result<(), ModelError> {
        if self.sidecar.network == wanted {
            return Ok(());
        }
        Err(ModelError::AnotherNetwork {
            directory: self.directory.clone(),
            found: self.sidecar.network.clone(),
            wanted,
        })
    }

    fn open(
        &self,
        runtime: &Runtime,
        name: &str,
        threads: Threads,
    ) -> Result<Box<OrtNetwork>, ModelError> {
        let Some(graph) = self.sidecar.graphs.get(name) else {
            let reason = format!("it names no graph {name}");
            return Err(damaged(&self.directory.join(SIDECAR), reason));
        };
        let bytes = self.read_graph(graph)?;
        let name = format!("{} {name}", self.sidecar.network);
        let network = OrtNetwork::open(&runtime.environment, &name, &bytes, threads)?;
        Ok(Box::new(network))
    }
}

impl ModelSet {
    fn file_name<'a>(&self, graph: &'a Graph) -> Result<&'a str, ModelError> {
        let file = Path::new(&graph.file);
        if file.file_name() == Some(file.as_os_str()) {
            return Ok(&graph.file);
        }
        let reason = format!("{:?} is not a file's name", graph.file);
        Err(damaged(&self.directory.join(SIDECAR), reason))
    }

    fn read_graph(&self, graph: &Graph) -> Result<Vec<u8>, ModelError> {
        let path = self.directory.join(self.file_name(graph)?);
        let bytes = read_limited(&path, MOST_GRAPH_BYTES)?;
        if digest_of(&bytes) != graph.sha256 {
            let reason = format!("its content is not what {SIDECAR} says");
            return Err(damaged(&path, reason));
        }
        Ok(bytes)
    }
}

fn damaged(path: &Path, reason: String) -> ModelError {
    ModelError::Damaged {
        path: path.to_owned(),
        reason,
    }
}

fn read_limited(path: &Path, most: u64) -> Result<Vec<u8>, ModelError> {
    let failed = |error: std::io::Error| damaged(path, error.to_string());
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(failed)?;
    file.take(most + 1)
        .read_to_end(&mut bytes)
        .map_err(failed)?;
    if bytes.len() as u64 > most {
        return Err(damaged(path, format!("larger than {most} bytes")));
    }
    Ok(bytes)
}

/// SHA-256, hexadecimal.
pub(super) fn digest_of(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
