//! Profiles: every knob of a measurement in one struct, hashed into every result.

use plumbline_vision::consistency::ConsistencyParams;
use plumbline_vision::faults::{FaultParams, FaultThresholds};
use plumbline_vision::flow::dis::DisParams;
use plumbline_vision::learned::droid_operator::DroidOperatorParams;
use plumbline_vision::scene::{GridParams, LayerParams, TwoViewParams};
use plumbline_vision::signals::SignalParams;
use plumbline_vision::signals::arc::{ArcParams, ArcSelectorParams};
use plumbline_vision::signals::contact::ContactParams;
use plumbline_vision::slam::intrinsics::Intrinsics;
use plumbline_vision::slam::reference::ReferenceParams;
use plumbline_vision::slam::tracker::TrackParams;
use serde::{Deserialize, Serialize};

use crate::decode::DecodeLimits;

/// Raised whenever the same parameters begin to give other numbers, so that old results are not
/// taken for new ones.
pub const MEASURE_VERSION: u32 = 5;

/// A rung of the speed/accuracy ladder (design, section 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rung {
    /// Triage.
    Draft,
    /// Overnight.
    Standard,
    /// Decisions.
    Accurate,
    /// Comparison with published WorldScore numbers, by the learned networks that those were made with.
    Reference,
}

impl Rung {
    /// From the cheapest to the dearest.
    pub const ALL: [Self; 4] = [Self::Draft, Self::Standard, Self::Accurate, Self::Reference];

    /// Those that need no learned network; the learned one answers another question, at a hundred times the cost.
    pub const CLASSICAL: [Self; 3] = [Self::Draft, Self::Standard, Self::Accurate];

    /// The name used on the command line and in every output.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::Accurate => "accurate",
            Self::Reference => "reference",
        }
    }
}

/// What SEA-RAFT's flow is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SeaRaftRole {
    /// Photometric consistency as WorldScore measures it, on the frames as decoded.
    Photometric,
    /// It takes the place of the classical flow, at the working size.
    Flow,
}

/// Flow by SEA-RAFT.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeaRaftUse {
    /// Digest of the model set; that of the only SEA-RAFT among the configured sets where it is not given.
    pub model: Option<String>,
    /// What for.
    pub role: SeaRaftRole,
    /// Whether frames are halved first, as WorldScore does.
    pub half_resolution: bool,
    /// Iterations; those of the weights' size where not given.
    pub iterations: Option<u32>,
    /// Iterations end early when the mean change of the flow, px of the network's picture, is below this.
    pub stop_below_px: Option<f64>,
}

impl SeaRaftUse {
    /// As WorldScore uses it, for `role`.
    #[must_use]
    pub fn new(role: SeaRaftRole) -> Self {
        Self {
            model: None,
            role,
            half_resolution: true,
            iterations: None,
            stop_below_px: None,
        }
    }
}

/// Reprojection error by DROID-SLAM.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DroidUse {
    /// Digest of the model set; that of the only DROID-SLAM among the configured sets where it is not given.
    pub model: Option<String>,
    /// Frames are scaled to this area, px.
    pub area_px: u32,
    /// Longer clips are refused before the first frame: memory grows with the frames, and so do hours.
    pub most_frames: u32,
    /// The networks.
    pub operator: DroidOperatorParams,
    /// The tracker.
    pub tracker: ReferenceParams,
}

impl Default for DroidUse {
    /// WorldScore's constants. Its 512 keyframes would not fit into 4 GiB, hence fewer frames.
    fn default() -> Self {
        Self {
            model: None,
            area_px: 512 * 512,
            most_frames: 100,
            operator: DroidOperatorParams::default(),
            tracker: ReferenceParams::default(),
        }
    }
}

/// Everything that decides what a video's numbers are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// [`MEASURE_VERSION`] of the build.
    pub measure_version: u32,
    /// Which rung it started from.
    pub rung: Rung,
    /// Frames are resized to this height (aspect kept), px.
    pub working_height_px: u32,
    /// Optical flow.
    pub flow: DisParams,
    /// End-point errors and evidence.
    pub consistency: ConsistencyParams,
    /// P, T and motion.
    pub signals: SignalParams,
    /// Which frames make steps of constant visual motion.
    pub arc_selector: ArcSelectorParams,
    /// accs, Sd and sh on those steps.
    pub arc: ArcParams,
    /// Fault detectors.
    pub faults: FaultParams,
    /// Above which score a fault is reported.
    pub fault_thresholds: FaultThresholds,
    /// U·R_c.
    pub contact: ContactParams,
    /// Frame distances of the edges that geometry looks at, ascending; 1 is always measured.
    pub edge_spans: Vec<u32>,
    /// Follow the flow between frames further apart from frame to frame, unless depth is estimated, and search for
    /// the one across a frame only where that frame may be bad enough to be reported. Off in every rung: on some clips it raises `reproj_px`
    /// by three tenths (`tests/benches/results/effort-2026-11-26.md`), everything but the residuals staying
    /// the same to the bit.
    pub follow_flow: bool,
    /// Grid of the geometric measure.
    pub grid: GridParams,
    /// Motion models and their selection.
    pub two_view: TwoViewParams,
    /// Rigid layers of what moves before the camera.
    pub layers: LayerParams,
    /// Dense adjustment under parallax.
    pub tracking: TrackParams,
    /// Adjust every clip, whatever the motion models say, and leave it to the parallax gate whether there is
    /// depth: to see what is saved.
    pub force_adjustment: bool,
    /// The camera's intrinsics, px of the videos as decoded; a field-of-view prior without.
    pub intrinsics: Option<Intrinsics>,
    /// Leading frames left out of every statistic: frame 0 of a generated rollout is often the real
    /// conditioning frame.
    pub conditioning_frames: u32,
    /// Frames up to this index are not candidates for t* (the paper uses 7).
    pub warmup_frames: u32,
    /// Frames per second of a directory of numbered images, which carries no times.
    pub sequence_fps: f64,
    /// How large a video may be.
    pub limits: DecodeLimits,
    /// When a clip is not judged.
    pub verdict: VerdictParams,
    /// SEA-RAFT, where it is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sea_raft: Option<SeaRaftUse>,
    /// DROID-SLAM, where it is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub droid: Option<DroidUse>,
}

/// When a clip gets a typed verdict instead of a score.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VerdictParams {
    /// Fewer usable frames (after the conditioning frames) are `too_short`: three frames give two
    /// pairs, the least from which a change can be told.
    pub min_frames: u32,
    /// A pair counts as moving when this share of its pixels moves by more than 1 px. The signals
    /// need about 100 px of a 128-px-high grid (0.6%).
    pub min_moving_fraction: f64,
    /// Fewer moving pairs are `static`: the signals are medians, which need three.
    pub min_moving_pairs: u32,
    /// A pair with a smaller share of consistent correspondences is `collapsed`.
    pub min_consistent_fraction: f64,
    /// And so is one in which a smaller share of the structured cells corresponds.
    pub min_corresponding_fraction: f64,
    /// Structure in a smaller share of the cells is too little to tell by.
    pub min_structured_fraction: f64,
    /// A frame is broken, and the clip `collapsed`, above this V: it differs from both neighbours, which
    /// agree across it, in as much as this share of the picture. The signals of a recipe are medians, to
    /// which one frame is nothing; the largest V of 60 clean clips is 0.11 (`tests/benches/corruption.sh`).
    pub max_bad_frame: f64,
}

impl Default for VerdictParams {
    fn default() -> Self {
        Self {
            min_frames: 3,
            min_moving_fraction: 0.006,
            min_moving_pairs: 3,
            min_consistent_fraction: 0.05,
            min_corresponding_fraction: 0.05,
            min_structured_fraction: 0.01,
            max_bad_frame: 0.15,
        }
    }
}

impl Profile {
    /// The profile of a rung.
    #[must_use]
    pub fn new(rung: Rung) -> Self {
        // Thresholds of rendered clips would flag most recorded ones, so only `standard`, which was
        // calibrated on recorded clips, reports faults.
        // Height is cheap to give up, rows of the flow's search are not: `draft` searches as many as
        // `standard`, since with a quarter of them the motion-balanced signals order clips another way.
        let (working_height_px, finest_scale, edge_spans, fault_thresholds) = match rung {
            Rung::Draft => (128, 0, vec![1], FaultThresholds::UNCALIBRATED),
            // What stands beside the learned measures is `standard`'s.
            Rung::Standard | Rung::Reference => {
                (256, 1, vec![1, 2], FaultThresholds::STANDARD_RECORDED)
            }
            Rung::Accurate => (512, 0, vec![1, 2, 3], FaultThresholds::UNCALIBRATED),
        };
        // Keyframes that each is joined to, and where the refinement ends: `accurate` goes on to
        // convergence.
        let (span, tolerance) = match rung {
            Rung::Draft => (2, 1e-2),
            Rung::Standard | Rung::Reference => (3, 3e-3),
            Rung::Accurate => (3, 1e-5),
        };
        let is_reference = rung == Rung::Reference;
        Self {
            measure_version: MEASURE_VERSION,
            rung,
            working_height_px,
            flow: DisParams::ultrafast(finest_scale),
            consistency: ConsistencyParams::default(),
            signals: SignalParams::default(),
            arc_selector: ArcSelectorParams::default(),
            arc: ArcParams::default(),
            faults: FaultParams::default(),
            fault_thresholds,
            contact: ContactParams::default(),
            edge_spans,
            follow_flow: false,
            // The grid of dense bundle adjustment at 256 px; the same points at every rung.
            grid: GridParams {
                step: working_height_px as usize / 32,
            },
            two_view: TwoViewParams::default(),
            layers: LayerParams::default(),
            tracking: TrackParams {
                span,
                tolerance,
                ..TrackParams::default()
            },
            force_adjustment: false,
            intrinsics: None,
            // WorldScore counts every frame.
            conditioning_frames: u32::from(!is_reference),
            warmup_frames: 7,
            sequence_fps: 10.0,
            limits: DecodeLimits::default(),
            verdict: VerdictParams::default(),
            sea_raft: is_reference.then(|| SeaRaftUse::new(SeaRaftRole::Photometric)),
            droid: is_reference.then(DroidUse::default),
        }
    }

    /// Whether it needs learned networks.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        self.sea_raft.is_some() || self.droid.is_some()
    }

    /// The digests of the model sets that it names, SEA-RAFT's first.
    #[must_use]
    pub fn models(&self) -> [Option<&str>; 2] {
        let sea_raft = self
            .sea_raft
            .as_ref()
            .and_then(|used| used.model.as_deref());
        let droid = self.droid.as_ref().and_then(|used| used.model.as_deref());
        [sea_raft, droid]
    }

    /// The rung's name; that of a rung with changed knobs says so. The camera, limits, thresholds, which
    /// frames and times count, and which weights the networks have are no such change.
    #[must_use]
    pub fn name(&self) -> String {
        let rung = Self::new(self.rung);
        let [sea_raft, droid] = self.models().map(|model| model.map(str::to_owned));
        let unchanged = Self {
            sea_raft: rung.sea_raft.map(|used| SeaRaftUse {
                model: sea_raft,
                ..used
            }),
            droid: rung.droid.map(|used| DroidUse {
                model: droid,
                ..used
            }),
            fault_thresholds: self.fault_thresholds,
            force_adjustment: self.force_adjustment,
            intrinsics: self.intrinsics,
            conditioning_frames: self.conditioning_frames,
            warmup_frames: self.warmup_frames,
            sequence_fps: self.sequence_fps,
            limits: self.limits.clone(),
            ..Self::new(self.rung)
        };
        match *self == unchanged {
            true => self.rung.as_str().to_owned(),
            false => format!("{}, changed", self.rung.as_str()),
        }
    }

    /// Columns and rows that a picture of this size is measured at; the picture has rows.
    #[must_use]
    pub fn working_size(&self, width: usize, height: usize) -> (usize, usize) {
        let rows = self.working_height_px as usize;
        (((width * rows + height / 2) / height).max(1), rows)
    }

    /// The form that is hashed and that travels: JSON with fields in declaration order.
    ///
    /// # Errors
    /// When a float is not finite.
    pub fn canonical(&self) -> Result<Vec<u8>, serde_json::Error> {
        serde_json::to_vec(self)
    }

    /// Digest of what fault scores depend on: everything but thresholds, limits, verdicts, the dense
    /// adjustment, learned measures that stand beside, and which frames and times count. `reference` has the
    /// faults of `standard`.
    ///
    /// # Errors
    /// As [`Self::canonical`].
    pub fn fault_scores_digest(&self) -> Result<String, serde_json::Error> {
        Self {
            fault_thresholds: FaultThresholds::UNCALIBRATED,
            conditioning_frames: 0,
            warmup_frames: 0,
            sequence_fps: 0.0,
            limits: DecodeLimits::default(),
            verdict: VerdictParams::default(),
            tracking: TrackParams::default(),
            force_adjustment: false,
            intrinsics: None,
            rung: match self.rung {
                Rung::Reference => Rung::Standard,
                rung => rung,
            },
            sea_raft: self
                .sea_raft
                .clone()
                .filter(|used| used.role == SeaRaftRole::Flow),
            droid: None,
            ..self.clone()
        }
        .digest()
    }

    /// BLAKE3 of the canonical form, hex.
    ///
    /// # Errors
    /// As [`Self::canonical`].
    pub fn digest(&self) -> Result<String, serde_json::Error> {
        Ok(blake3::hash(&self.canonical()?).to_hex().to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_follows_every_knob_and_survives_the_wire() {
        let standard = Profile::new(Rung::Standard);
        let digest = standard.digest().unwrap();
        let mut other = standard.clone();
        other.verdict.min_moving_fraction = 0.007;
        assert_eq!(
            (standard.name().as_str(), other.name().as_str()),
            ("standard", "standard, changed")
        );
        assert_ne!(other.digest().unwrap(), digest);
        let back: Profile = serde_json::from_slice(&standard.canonical().unwrap()).unwrap();
        assert_eq!(back, standard);
        assert_eq!(back.digest().unwrap(), digest);
    }
}
