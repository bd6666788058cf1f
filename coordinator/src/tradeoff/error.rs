//! Why there is no answer, by what a person does next.

use plumbline_sample::SampleError;
use plumbline_vision::flow::FlowError;
use plumbline_worker::explain::DrawError;

use crate::corpus::CorpusError;
use crate::picture::PngError;
use crate::publish::PublishError;
use crate::run::RunError;
use crate::sample::WriteSampleError;

/// Fewer videos have no order worth comparing.
pub(super) const MIN_SAMPLE: usize = 3;

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum TradeoffError {
    /// The corpus, OUT, or a measurement.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Labels, or the list of videos.
    #[error(transparent)]
    Corpus(#[from] CorpusError),
    /// Too few videos can be read.
    #[error(
        "{readable} of the videos can be read, and {MIN_SAMPLE} are needed to compare orders; give more"
    )]
    TooFew {
        /// Readable videos in the sample.
        readable: usize,
    },
    /// OUT belongs to a run of `score`.
    #[error("{out}: holds the results of a score run; choose another --out")]
    ScoresThere {
        /// OUT.
        out: String,
    },
    /// Nothing to compare.
    #[error(
        "one point alone compares with nothing: add --profile FILE.toml, or leave out --grid none"
    )]
    OnePoint,
    /// OUT cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// A rendered clip cannot be written.
    #[error(transparent)]
    Render(WriteSampleError),
    /// A rendered scene has no truth.
    #[error("a scene of known truth does not render ({0}); report this defect")]
    Scene(#[from] SampleError),
    /// A point's flow does not work on a rendered scene.
    #[error("a profile's flow fails on a rendered scene: {0}; change its knobs")]
    Flow(#[from] FlowError),
    /// The picture cannot be drawn.
    #[error(transparent)]
    Draw(#[from] DrawError),
    /// The picture does not encode.
    #[error(transparent)]
    Png(#[from] PngError),
    /// A step broke down.
    #[error("a step broke down ({0}); what was measured is kept, and this is a defect to report")]
    Finishing(#[from] tokio::task::JoinError),
    /// Ctrl-C or SIGTERM.
    #[error("interrupted: what was measured is kept; run the same command again to go on")]
    Interrupted,
}
