//! `plumbline judge`: labels from a vision-language model behind an OpenAI-compatible endpoint.
//!
//! As the paper's reward model: frames spread evenly over a video and the task in words go in, 1
//! (success), 0.5 (partial) or 0 comes out, several times per video. Frames are decoded in the compute
//! child. Answers are kept by content, prompt, model and repeat, so that a repeated run asks nothing
//! again. Every video and repeat is a line of `labels.csv`, the form that `evaluate` reads, judged or
//! with its reason.

mod answer;
mod cache;
mod chat;
mod labels;
mod prompt;

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use plumbline_common::id::VideoId;
use plumbline_worker::child::SlotError;
use plumbline_worker::measure::frames::{FramesJob, SampledFrames};
use plumbline_worker::profile::Profile;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::corpus::{self, Choice, CorpusError, Entry};
use crate::fanout::{Fanout, Slots};
use crate::measuring::job;
use crate::progress::Progress;
use crate::publish::{OutDir, PublishError};
use crate::run::unreadable;
use crate::stop::StopSignals;
use cache::Cache;
use chat::Chat;
pub use chat::{ChatOptions, Spent};
pub use labels::{Judgement, Verdict};
pub use prompt::{DEFAULT_PROMPT, Prompt, PromptError};

/// A usable `plumbline judge`.
#[derive(Debug, Clone)]
pub struct JudgeOptions {
    /// Videos, as typed.
    pub sources: Vec<String>,
    /// The labels.
    pub out: PathBuf,
    /// Kept answers.
    pub cache: PathBuf,
    /// What is asked.
    pub prompt: Prompt,
    /// Frames shown.
    pub frames: u32,
    /// Their longer side, at most, px.
    pub max_side_px: u32,
    /// Judgements per video.
    pub repeats: u32,
    /// Questions under way at once.
    pub concurrency: usize,
    /// Whom to ask, and how.
    pub chat: ChatOptions,
    /// How videos are decoded.
    pub profile: Profile,
    /// Who decodes.
    pub slots: Slots,
}

/// What came of it.
#[derive(Debug)]
pub struct Judged {
    /// One per video and repeat, by video.
    pub judgements: Vec<Judgement>,
    /// What was asked of the endpoint now.
    pub spent: Spent,
    /// Answers taken from earlier runs.
    pub cached: usize,
}

/// Why there are no labels.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// The list of videos is wrong.
    #[error(transparent)]
    Corpus(#[from] CorpusError),
    /// The question is wrong.
    #[error(transparent)]
    Prompt(#[from] PromptError),
    /// `--out` names no file.
    #[error("{out}: the name of a file for the labels is needed, such as labels.csv")]
    NoName {
        /// As typed.
        out: String,
    },
    /// The profile cannot be written down.
    #[error("the profile cannot be encoded: {0}")]
    Profile(serde_json::Error),
    /// Labels or kept answers cannot be written.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// No compute process can be started.
    #[error(transparent)]
    Slot(#[from] SlotError),
    /// A thread that asks broke down.
    #[error("asking broke down ({0}), which is a defect to report; answers so far are kept")]
    Asking(#[from] tokio::task::JoinError),
    /// Ctrl-C or SIGTERM.
    #[error("interrupted: answers so far are kept; run the same command again to go on")]
    Interrupted,
}

impl JudgeError {
    /// True where the caller named something unusable.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Corpus(_) | Self::Prompt(_) | Self::NoName { .. }
        )
    }
}

/// Judges every video of the sources and writes the labels.
///
/// # Errors
/// [`JudgeError`]; answers so far are kept.
pub async fn judge(options: &JudgeOptions) -> Result<Judged, JudgeError> {
    let no_name = || JudgeError::NoName {
        out: options.out.display().to_string(),
    };
    let name = options.out.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(no_name)?;
    // The labels are no video, whatever directory they go to.
    let entries = corpus::freeze(&options.sources, &Choice::default(), &options.out)?.entries;
    let questions: HashMap<VideoId, String> = entries
        .iter()
        .map(|entry| Ok((entry.video.clone(), options.prompt.of(entry)?)))
        .collect::<Result<_, PromptError>>()?;
    let out = OutDir::create(match options.out.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => std::path::Path::new("."),
    })?;
    let mut asking = Asking::start(options, &entries, questions)?;
    let mut stop = StopSignals::listen();
    tokio::select! {
        done = asking.finish(&entries) => done?,
        () = stop.recv() => return Err(JudgeError::Interrupted),
    }
    let judged = asking.judged();
    out.put_atomic_with(name, |writer| labels::write(&judged.judgements, writer))?;
    Ok(judged)
}

/// A run under way.
struct Asking<'a> {
    options: &'a JudgeOptions,
    chat: Arc<Chat>,
    cache: Arc<Cache>,
    fanout: Fanout<FramesJob>,
    questions: HashMap<VideoId, String>,
    found: BTreeMap<(VideoId, u32), Verdict>,
    cached: usize,
}

impl<'a> Asking<'a> {
    fn start(
        options: &'a JudgeOptions,
        entries: &[Entry],
        questions: HashMap<VideoId, String>,
    ) -> Result<Self, JudgeError> {
        let jobs = entries
            .iter()
            .filter_map(|entry| job(entry, &options.profile).transpose())
            .map(|job| {
                Ok(FramesJob {
                    job: job?,
                    frames: options.frames,
                    max_side_px: options.max_side_px,
                })
            })
            .collect::<Result<_, _>>()
            .map_err(JudgeError::Profile)?;
        Ok(Self {
            options,
            chat: Arc::new(Chat::new(options.chat.clone())),
            cache: Arc::new(Cache::open(&options.cache)?),
            fanout: Fanout::start(jobs, &options.slots),
            questions,
            found: BTreeMap::new(),
            cached: 0,
        })
    }

    /// Asks all there is to ask: at most `concurrency` questions are under way, and no more videos are
    /// decoded than those are about.
    async fn finish(&mut self, entries: &[Entry]) -> Result<(), JudgeError> {
        let under_way = Arc::new(Semaphore::new(self.options.concurrency));
        let mut answers: JoinSet<Result<(VideoId, u32, Verdict), PublishError>> = JoinSet::new();
        let total = entries.len() as u64 * u64::from(self.options.repeats);
        let mut progress = Progress::start(total, 0);
        for entry in entries {
            if entry.bytes.is_none() {
                let reason = unreadable(entry).status_reason.unwrap_or_default();
                self.without_frames(&entry.video, &reason, &mut progress);
            }
        }
        while let Some(decoded) = self.fanout.next().await {
            let (video, sampled) = decoded?;
            let sampled = match sampled {
                Ok(sampled) if !sampled.frames.is_empty() => sampled,
                Ok(_) => {
                    self.without_frames(&video, "the video has no frame", &mut progress);
                    continue;
                }
                Err(reason) => {
                    self.without_frames(&video, &reason, &mut progress);
                    continue;
                }
            };
            let question = self.questions.get(&video).cloned().unwrap_or_default();
            let question = Arc::new(Question::new(question, &sampled));
            for repeat in 0..self.options.repeats {
                let key = cache::key(&self.options.chat, self.options, &question, repeat);
                if let Some(answer) = self.cache.get(&key) {
                    self.cached += 1;
                    self.found
                        .insert((video.clone(), repeat), answer::read(&answer));
                    progress.advance(true);
                    continue;
                }
                let permit = Arc::clone(&under_way).acquire_owned().await;
                let (chat, cache) = (Arc::clone(&self.chat), Arc::clone(&self.cache));
                let (video, question) = (video.clone(), Arc::clone(&question));
                answers.spawn_blocking(move || {
                    let _permit = permit;
                    let verdict = match chat.ask(&question.text, &question.pictures) {
                        Ok(answer) => {
                            cache.put(&key, &answer)?;
                            answer::read(&answer)
                        }
                        Err(why) => why,
                    };
                    Ok((video, repeat, verdict))
                });
                while let Some(answered) = answers.try_join_next() {
                    self.take(answered??, &mut progress);
                }
            }
        }
        while let Some(answered) = answers.join_next().await {
            self.take(answered??, &mut progress);
        }
        progress.finish();
        Ok(())
    }

    fn take(&mut self, (video, repeat, verdict): (VideoId, u32, Verdict), progress: &mut Progress) {
        progress.advance(matches!(verdict, Verdict::Judged { .. }));
        self.found.insert((video, repeat), verdict);
    }

    fn without_frames(&mut self, video: &VideoId, reason: &str, progress: &mut Progress) {
        for repeat in 0..self.options.repeats {
            let verdict = Verdict::Unreadable(reason.to_owned());
            self.take((video.clone(), repeat, verdict), progress);
        }
    }

    fn judged(self) -> Judged {
        let judgement = |((video, repeat), verdict)| Judgement {
            video,
            repeat,
            verdict,
        };
        Judged {
            judgements: self.found.into_iter().map(judgement).collect(),
            spent: self.chat.spent(),
            cached: self.cached,
        }
    }
}

/// What is asked of one video, as often as there are repeats.
pub(crate) struct Question {
    text: String,
    /// JPEG as `data:` addresses.
    pictures: Vec<String>,
    /// BLAKE3 of the video.
    digest: String,
}

impl Question {
    fn new(text: String, sampled: &SampledFrames) -> Self {
        let address = |jpeg: &[u8]| format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg));
        Self {
            text: text.replace(prompt::FRAMES, &sampled.frames.len().to_string()),
            pictures: sampled
                .frames
                .iter()
                .map(|frame| address(&frame.jpeg))
                .collect(),
            digest: sampled.digest.clone(),
        }
    }
}
