//! One network in ONNX Runtime.

use std::borrow::Cow;

use ort::environment::Environment;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use ort::session::{Session, SessionInputValue};
use ort::value::TensorRef;
use plumbline_vision::learned::{Network, NetworkError, Tensor, TensorView};

/// Threads that one network computes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Threads(std::num::NonZeroUsize);

impl Threads {
    /// The calling thread alone: as many children as cores, one thread each, is the fastest whole.
    pub const ONE: Self = Self(std::num::NonZeroUsize::MIN);

    /// That many.
    #[must_use]
    pub fn new(count: std::num::NonZeroUsize) -> Self {
        Self(count)
    }
}

/// A network with its weights, loaded.
#[derive(Debug)]
pub struct OrtNetwork {
    name: String,
    session: Session,
}

impl OrtNetwork {
    /// Loads a model from its bytes.
    ///
    /// Operations run one after the other, on `threads` threads that sleep when there is nothing to do:
    /// a spinning thread takes its core from another child.
    pub(super) fn open(
        environment: &Environment,
        name: &str,
        model: &[u8],
        threads: Threads,
    ) -> Result<Self, NetworkError> {
        let session = Session::builder(environment)
            .and_then(|builder| configured(builder, threads))
            .and_then(|mut builder| builder.commit_from_memory(model))
            .map_err(|error| failed(name, &error))?;
        Ok(Self {
            name: name.to_owned(),
            session,
        })
    }
}

fn configured(builder: SessionBuilder, Threads(threads): Threads) -> ort::Result<SessionBuilder> {
    Ok(builder
        .with_intra_threads(threads.get())?
        .with_inter_threads(1)?
        .with_parallel_execution(false)?
        .with_intra_op_spinning(false)?
        .with_inter_op_spinning(false)?
        .with_deterministic_compute(true)?
        .with_optimization_level(GraphOptimizationLevel::All)?)
}

fn failed(name: &str, error: &ort::Error) -> NetworkError {
    NetworkError {
        network: name.to_owned(),
        message: error.to_string(),
    }
}

impl Network for OrtNetwork {
    fn run(
        &mut self,
        inputs: &[(&'static str, TensorView<'_>)],
        outputs: &[&'static str],
    ) -> Result<Vec<Tensor>, NetworkError> {
        let name = self.name.clone();
        let given = inputs
            .iter()
            .map(|&(input, view)| {
                let tensor = TensorRef::from_array_view((view.shape, view.data))?;
                Ok((Cow::from(input), SessionInputValue::from(tensor)))
            })
            .collect::<Result<Vec<_>, ort::Error>>()
            .map_err(|error| failed(&name, &error))?;
        let found = self
            .session
            .run(given)
            .map_err(|error| failed(&name, &error))?;
        outputs
            .iter()
            .map(|&output| {
                let value = found.get(output).ok_or_else(|| NetworkError {
                    network: name.clone(),
                    message: format!("it has no output {output}"),
                })?;
                let (shape, data) = value
                    .try_extract_tensor::<f32>()
                    .map_err(|error| failed(&name, &error))?;
                Ok(Tensor {
                    shape: shape.iter().map(|&n| n.unsigned_abs() as usize).collect(),
                    data: data.to_vec(),
                })
            })
            .collect()
    }
}
