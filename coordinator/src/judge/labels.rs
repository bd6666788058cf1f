//! `labels.csv`: a line per video and repeat, the form that `evaluate` reads. A judgement that is
//! missing is an empty label with its status and reason.

use std::io::Write;

use plumbline_common::id::VideoId;

use crate::publish::encode::{EncodeError, Format, write as encode};
use crate::publish::table::Column;
use crate::publish::table::Kind::{Float64, Text, UInt32};

/// One repeat of one video.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The video.
    pub video: VideoId,
    /// Which of its judgements, from 0.
    pub repeat: u32,
    /// What came of it.
    pub verdict: Verdict,
}

/// What came of a question.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// A judgement.
    Judged {
        /// 0, 0.5 or 1.
        label: f64,
        /// The model's words.
        answer: String,
    },
    /// An answer that holds no judgement.
    Unparsable(String),
    /// The endpoint refused the question itself.
    Refused(String),
    /// No answer after every attempt.
    Failed(String),
    /// Not asked any more: a limit on calls or tokens was reached.
    OverBudget(String),
    /// There are no frames to show.
    Unreadable(String),
}

impl Verdict {
    /// The name in the labels.
    #[must_use]
    pub fn status(&self) -> &'static str {
        match self {
            Self::Judged { .. } => "judged",
            Self::Unparsable(_) => "unparsable",
            Self::Refused(_) => "refused",
            Self::Failed(_) => "failed",
            Self::OverBudget(_) => "over_budget",
            Self::Unreadable(_) => "unreadable",
        }
    }

    /// The judgement.
    #[must_use]
    pub fn label(&self) -> Option<f64> {
        match self {
            Self::Judged { label, .. } => Some(*label),
            _ => None,
        }
    }

    /// The model's words, or why there are none.
    #[must_use]
    pub fn text(&self) -> &str {
        match self {
            Self::Judged { answer: text, .. }
            | Self::Unparsable(text)
            | Self::Refused(text)
            | Self::Failed(text)
            | Self::OverBudget(text)
            | Self::Unreadable(text) => text,
        }
    }
}

pub(super) fn write(
    judgements: &[Judgement],
    out: &mut (dyn Write + Send),
) -> Result<(), EncodeError> {
    let columns: Vec<Column<Judgement>> = vec![
        Column::field("video", Text, |j| j.video.as_str().into()),
        Column::field("label", Float64, |j| j.verdict.label().into()),
        Column::field("repeat", UInt32, |j| j.repeat.into()),
        Column::field("status", Text, |j| j.verdict.status().into()),
        Column::field("answer", Text, |j| j.verdict.text().into()),
    ];
    encode(Format::Csv, &columns, judgements, out)
}
