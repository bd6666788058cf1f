//! The score row: what is said of one video, first by a worker alone ([`Measurement`]), then in the
//! light of the whole corpus ([`Row`]).
//!
//! Units: pixel errors are in pixels of a 256-px-high picture (`_px`), times in seconds (`_s`).
//! A missing value is `None` (null), never 0, −1 or NaN.

use serde::{Deserialize, Serialize};

use crate::id::VideoId;

/// What became of one video.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Measured; takes part in the corpus statistics.
    Scored,
    /// Too little motion to judge: insufficient evidence, never "perfect".
    Static,
    /// Correspondences vanish on some frame.
    Collapsed,
    /// Fewer frames than a measure needs.
    TooShort,
    /// Larger, longer or heavier than the profile's limits allow.
    OverLimit,
    /// No complete video could be decoded from the bytes.
    Undecodable,
    /// The measurement itself failed (crash, deadline, memory, unreadable file).
    Failed,
}

impl Status {
    /// All statuses, in the order in which reports list them.
    pub const ALL: [Self; 7] = [
        Self::Scored,
        Self::Static,
        Self::Collapsed,
        Self::TooShort,
        Self::OverLimit,
        Self::Undecodable,
        Self::Failed,
    ];

    /// The name used in every output.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Scored => "scored",
            Self::Static => "static",
            Self::Collapsed => "collapsed",
            Self::TooShort => "too_short",
            Self::OverLimit => "over_limit",
            Self::Undecodable => "undecodable",
            Self::Failed => "failed",
        }
    }
}

/// The camera and scene class that the clip's flow requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scene {
    /// The camera stands still.
    StaticCamera,
    /// One homography explains the background: a rotating camera, or a plane.
    Rotation,
    /// A moving camera before a scene with depth.
    Parallax,
}

/// How `reproj_px` was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GeometryMethod {
    /// Per-edge model selection by GRIC: a static camera, or one homography per edge. Under parallax only
    /// where no adjustment was possible: each edge then has its own free depth, so that the value is a
    /// lower bound of what shared depth leaves.
    TwoViewGric,
    /// Under parallax: poses and one inverse depth per cell and frame, shared by all its edges, by dense
    /// bundle adjustment.
    DenseAdjustment,
}

/// What to do with a video.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decision {
    /// Goes into the filtered corpus.
    Keep,
    /// Left out of it.
    Drop,
    /// No score to decide by: a person looks.
    Review,
}

/// The measures per adjacent frame pair; entry `k` belongs to the pair whose later frame is
/// `first_frame + k`. Kept for the interval, the explanation and the report.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Index of the later frame of the first pair (0-based, input frames).
    pub first_frame: u32,
    /// Corrected end-point error, mean over in-frame pixels.
    pub aepe_px: Vec<Option<f64>>,
    /// WorldScore's end-point error.
    pub aepe_worldscore_px: Vec<Option<f64>>,
    /// Mean residual of the edges whose later frame is this one (the paper's e_t).
    pub reproj_px: Vec<Option<f64>>,
    /// Valid cells behind `reproj_px`: the weight of the frame in the clip's mean.
    pub reproj_cells: Vec<u32>,
    /// Mean residual of what moves under the camera and rigid layers.
    #[serde(default)]
    pub layer_residual_px: Vec<Option<f64>>,
    /// P: piecewise-affine residual of moving pixels, relative to their motion.
    pub piecewise_residual: Vec<Option<f64>>,
    /// T: appearance residual of moving over all pixels.
    pub appearance_ratio: Vec<Option<f64>>,
    /// Mean |flow|.
    pub motion_px: Vec<Option<f64>>,
    /// accs of the two steps of constant visual motion that end here; defined on kept frames only.
    pub layer_acceleration: Vec<Option<f64>>,
    /// Lower quartile of the same over cells.
    #[serde(default)]
    pub layer_acceleration_q25: Vec<Option<f64>>,
    /// Sd of the step that ends here.
    pub interior_shear: Vec<Option<f64>>,
    /// sh of the points that end here.
    pub detail_change: Vec<Option<f64>>,
    /// Lower quartile of the same over cells.
    #[serde(default)]
    pub detail_change_q25: Vec<Option<f64>>,
}

impl Series {
    /// The paper's jump at `frame` with its sign, e_t − e_{t−1}, px of a 256-px-high picture: negative
    /// where the residual falls, which is no artifact. `None` where either frame has no residual.
    #[must_use]
    pub fn reproj_jump_px(&self, frame: u32) -> Option<f64> {
        let at = |frame: u32| {
            let place = frame.checked_sub(self.first_frame)?;
            *self.reproj_px.get(place as usize)?
        };
        Some(at(frame)? - at(frame.checked_sub(1)?)?)
    }
}

/// What one worker says of one video, whatever else is in the corpus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// What became of it.
    pub status: Status,
    /// One sentence: why it is not `scored`, and the remedy.
    pub status_reason: Option<String>,
    /// BLAKE3 of the bytes, hex.
    pub digest: Option<String>,
    /// Size of the object.
    pub bytes: Option<u64>,
    /// Frames decoded.
    pub frames: Option<u32>,
    /// Frames per second by presentation times.
    pub fps: Option<f64>,
    /// Columns of the original picture.
    pub width: Option<u32>,
    /// Rows of the original picture.
    pub height: Option<u32>,
    /// Length by presentation times.
    pub duration_s: Option<f64>,
    /// What the camera did.
    pub scene: Option<Scene>,
    /// Mean |flow|: stands beside every score, since errors follow motion.
    pub motion_px: Option<f64>,
    /// s_3: mean residual of the best rigid camera and scene.
    pub reproj_px: Option<f64>,
    /// How `reproj_px` was found.
    pub reproj_method: Option<GeometryMethod>,
    /// What no rigid layer explains of what moves before the camera, adjacent frames.
    pub layer_residual_px: Option<f64>,
    /// Forward/backward end-point error, corrected.
    pub aepe_px: Option<f64>,
    /// s_p: forward/backward end-point error exactly as WorldScore computes it.
    pub aepe_worldscore_px: Option<f64>,
    /// DROID-SLAM's mean reprojection error exactly as WorldScore computes it, cells (1/8 px of a picture of
    /// 512² px): s_3 of the profile `reference`, the only one that has it.
    #[serde(default)]
    pub reproj_droid_px: Option<f64>,
    /// WorldScore's 3D consistency, 0 to 100, of `reproj_droid_px`.
    #[serde(default)]
    pub worldscore_3d: Option<f64>,
    /// WorldScore's photometric consistency, 0 to 100, of `aepe_worldscore_px` by SEA-RAFT.
    #[serde(default)]
    pub worldscore_photometric: Option<f64>,
    /// Digests of the model sets that had a part in it.
    #[serde(default)]
    pub models: Option<String>,
    /// Share of in-frame pixels whose forward and backward flow disagree.
    pub occluded_fraction: Option<f64>,
    /// P, clip median.
    pub piecewise_residual: Option<f64>,
    /// T, clip median.
    pub appearance_ratio: Option<f64>,
    /// accs, clip median over steps of constant visual motion: layers that do not keep their motion.
    pub layer_acceleration: Option<f64>,
    /// The same of the lower quartile over cells: even what is followed best does not keep its motion.
    pub layer_acceleration_q25: Option<f64>,
    /// Sd, clip median, 1/px: rigid interiors that shear.
    pub interior_shear: Option<f64>,
    /// sh, clip median: moving surfaces that change their detail.
    pub detail_change: Option<f64>,
    /// The same of the lower quartile over cells: even what is followed best changes its detail.
    pub detail_change_q25: Option<f64>,
    /// U·R_c: low where nothing is touched and the clip has little to be judged by.
    pub contact: Option<f64>,
    /// The frame of the most severe fault.
    pub peak_frame: Option<u32>,
    /// Frames with a fault, the most severe first; empty where none was found, `None` where the
    /// detectors did not run.
    pub fault_frames: Option<Vec<u32>>,
    /// Kinds of those faults, in the same order: `bad_frame`, `jump`, `appear`, `vanish`, `flicker`,
    /// `freeze`.
    pub fault_kinds: Option<Vec<String>>,
    /// Mean of e_t.
    pub mean_error: Option<f64>,
    /// Largest |e_t − e_{t−1}|.
    pub max_jump: Option<f64>,
    /// t*: the frame of the largest jump after the warm-up.
    pub paper_peak_frame: Option<u32>,
    /// Whether that jump stands out of the series.
    pub peak_reliable: Option<bool>,
    /// The series behind the means.
    pub series: Series,
}

impl Measurement {
    /// A measurement that says only why there is none.
    #[must_use]
    pub fn without_score(status: Status, reason: impl Into<String>) -> Self {
        Self {
            status,
            status_reason: Some(reason.into()),
            digest: None,
            bytes: None,
            frames: None,
            fps: None,
            width: None,
            height: None,
            duration_s: None,
            scene: None,
            motion_px: None,
            reproj_px: None,
            reproj_method: None,
            layer_residual_px: None,
            aepe_px: None,
            aepe_worldscore_px: None,
            reproj_droid_px: None,
            worldscore_3d: None,
            worldscore_photometric: None,
            models: None,
            occluded_fraction: None,
            piecewise_residual: None,
            appearance_ratio: None,
            layer_acceleration: None,
            layer_acceleration_q25: None,
            interior_shear: None,
            detail_change: None,
            detail_change_q25: None,
            contact: None,
            peak_frame: None,
            fault_frames: None,
            fault_kinds: None,
            mean_error: None,
            max_jump: None,
            paper_peak_frame: None,
            peak_reliable: None,
            series: Series::default(),
        }
    }
}

/// What a measurement cost; kept apart from the row, since it differs from run to run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Wall time of the whole measurement, without the fetch.
    pub total_s: f64,
    /// Processor time of it, over all threads: what counts on a busy machine.
    #[serde(default)]
    pub cpu_s: f64,
    /// Bringing the video from its object store.
    #[serde(default)]
    pub fetch_s: f64,
    /// Reading, decoding and resizing.
    pub decode_s: f64,
    /// Optical flow, both directions.
    pub flow_s: f64,
    /// End-point errors and signals.
    pub signals_s: f64,
    /// Motion models and dense adjustment.
    pub geometry_s: f64,
    /// Pairs of frames whose flows, there and back, were searched for.
    #[serde(default)]
    pub flow_pairs: u64,
    /// Pairs whose flows were not needed: followed from frame to frame, or between equal frames.
    #[serde(default)]
    pub flow_pairs_saved: u64,
    /// Frames that equal the one before bit for bit, and were not prepared again.
    #[serde(default)]
    pub frames_repeated: u64,
    /// SEA-RAFT, as WorldScore's photometric consistency.
    #[serde(default)]
    pub photometric_s: f64,
    /// DROID-SLAM, as WorldScore's 3D consistency.
    #[serde(default)]
    pub tracking_s: f64,
    /// Updates of single edges by DROID-SLAM's network.
    #[serde(default)]
    pub edge_updates: u64,
    /// The most memory that the compute process had had by then.
    #[serde(default)]
    pub peak_memory_mib: u64,
    /// Steps of the dense adjustment.
    #[serde(default)]
    pub adjustment_steps: u64,
    /// Inverse depths that it estimated.
    #[serde(default)]
    pub depth_cells: u64,
    /// Inverse depths that did not have to be estimated.
    #[serde(default)]
    pub depth_cells_saved: u64,
}

/// The published row: one per input video, in the order of `video`. The field order is the column
/// order of `scores.*`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Path below SOURCE, or key.
    pub video: VideoId,
    /// Value of `--group-by`.
    pub group: Option<String>,
    /// Columns carried through from a list, by name.
    pub carried: serde_json::Map<String, serde_json::Value>,
    /// The worker's part.
    pub measured: Measurement,
    /// z-score of `reproj_px` in the corpus.
    pub z_reproj_px: Option<f64>,
    /// z-score of `aepe_worldscore_px` in the corpus.
    pub z_aepe_worldscore_px: Option<f64>,
    /// Robust z of P, clipped to [−3, 6].
    pub z_piecewise_residual: Option<f64>,
    /// Robust z of T, clipped to [−3, 6].
    pub z_appearance_ratio: Option<f64>,
    /// Robust z of accs (lower quartile), clipped to [−3, 6].
    pub z_layer_acceleration_q25: Option<f64>,
    /// Robust z of Sd, clipped to [−3, 6].
    pub z_interior_shear: Option<f64>,
    /// Robust z of sh (lower quartile), clipped to [−3, 6].
    pub z_detail_change_q25: Option<f64>,
    /// S_r: the relative anomaly score of the chosen recipe; lower is better.
    pub anomaly: Option<f64>,
    /// Lower end of its 90% interval (block bootstrap over frame pairs).
    pub anomaly_lo: Option<f64>,
    /// Upper end of it.
    pub anomaly_hi: Option<f64>,
    /// 1 is the most consistent of the corpus; ties are broken by video id.
    pub rank: Option<u64>,
    /// (rank − 0.5) / n in percent.
    pub percentile: Option<f64>,
    /// Keep, drop or review.
    pub decision: Decision,
    /// −S_r.
    pub reward: Option<f64>,
    /// Which signals were combined.
    pub recipe: String,
    /// Digest of the profile that measured it.
    pub profile_digest: String,
    /// The name of that profile, where rows of a run come from different ones (a cascade).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rung: Option<String>,
    /// The probability that the top profile of a cascade decides otherwise; 0 where it was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flip_probability: Option<f64>,
}
