//! The one door to a network: named arrays in, named arrays out.

/// An array of 32-bit floats that a network is given.
#[derive(Debug, Clone, Copy)]
pub struct TensorView<'a> {
    /// Sizes, the slowest first.
    pub shape: &'a [usize],
    /// As many values as the sizes' product.
    pub data: &'a [f32],
}

/// An array of 32-bit floats that a network gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Sizes, the slowest first.
    pub shape: Vec<usize>,
    /// As many values as the sizes' product.
    pub data: Vec<f32>,
}

/// A network failed, or gave other arrays than asked for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("network {network}: {message}")]
pub struct NetworkError {
    /// Which network.
    pub network: String,
    /// What went wrong.
    pub message: String,
}

/// A network with its weights.
pub trait Network: Send {
    /// Computes the outputs of these names from the named inputs, in the order asked for.
    ///
    /// # Errors
    /// [`NetworkError`] where a name or a shape does not fit the network, or running it fails.
    fn run(
        &mut self,
        inputs: &[(&'static str, TensorView<'_>)],
        outputs: &[&'static str],
    ) -> Result<Vec<Tensor>, NetworkError>;
}

/// Runs a network and checks the shapes of what it gives: `outputs` are names with sizes.
pub(super) fn run<const N: usize>(
    network: &mut dyn Network,
    name: &str,
    inputs: &[(&'static str, TensorView<'_>)],
    outputs: [(&'static str, &[usize]); N],
) -> Result<[Vec<f32>; N], NetworkError> {
    let names = outputs.map(|(name, _)| name);
    let found = network.run(inputs, &names)?;
    let wrong = |message: String| NetworkError {
        network: name.to_owned(),
        message,
    };
    for (tensor, (output, shape)) in found.iter().zip(outputs) {
        if tensor.shape != shape || tensor.data.len() != shape.iter().product::<usize>() {
            return Err(wrong(format!(
                "{output} has shape {:?}, not {shape:?}",
                tensor.shape
            )));
        }
    }
    let data: Vec<Vec<f32>> = found.into_iter().map(|tensor| tensor.data).collect();
    let count = data.len();
    data.try_into()
        .map_err(|_| wrong(format!("gave {count} arrays, not {N}")))
}
