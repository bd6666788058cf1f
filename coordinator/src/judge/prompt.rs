//! The question: a template with the task's words filled in.

use serde_json::Value;

use crate::corpus::Entry;

/// What is asked unless another template is given.
pub const DEFAULT_PROMPT: &str = "\
You are shown {frames} frames of one video of a robot, in the order of time, from the first to the last.
Task of the robot: {task}
Judge whether the robot completes the task by the end of the video. Objects that appear, vanish, melt or
pass through each other do not complete a task.
Answer with one JSON object and nothing else: {\"score\": S, \"reason\": \"one short sentence\"}, where S is
1 if the task is completed, 0.5 if it is partly completed, 0 if it is not.";

/// Replaced by the number of frames shown.
pub(super) const FRAMES: &str = "{frames}";
/// Replaced by the task.
const TASK: &str = "{task}";

/// Where the words of a question come from.
#[derive(Debug, Clone)]
pub struct Prompt {
    /// The template.
    pub template: String,
    /// The task of every video.
    pub task: Option<String>,
    /// Or the carried column that holds each one's.
    pub task_column: Option<String>,
}

/// Why there is no question.
#[derive(Debug, thiserror::Error)]
pub enum PromptError {
    /// The template asks for a task and there is none.
    #[error(
        "the prompt asks for {TASK}: say it with --task or --task-column, or give another --prompt"
    )]
    NoTask,
    /// A video has no value in the column.
    #[error("{video} has no text in the column `{column}`; complete the list or say --task")]
    NoValue {
        /// The video.
        video: String,
        /// The column.
        column: String,
    },
}

impl Prompt {
    /// The question about one video, but for the number of frames.
    ///
    /// # Errors
    /// [`PromptError`].
    pub fn of(&self, entry: &Entry) -> Result<String, PromptError> {
        if !self.template.contains(TASK) {
            return Ok(self.template.clone());
        }
        let task = match (&self.task_column, &self.task) {
            (Some(column), task) => {
                let value = match entry.carried.get(column) {
                    None | Some(Value::Null) => task.clone(),
                    Some(Value::String(text)) => Some(text.clone()),
                    Some(other) => Some(other.to_string()),
                };
                value.ok_or_else(|| PromptError::NoValue {
                    video: entry.video.to_string(),
                    column: column.clone(),
                })?
            }
            (None, Some(task)) => task.clone(),
            (None, None) => return Err(PromptError::NoTask),
        };
        Ok(self.template.replace(TASK, &task))
    }
}
