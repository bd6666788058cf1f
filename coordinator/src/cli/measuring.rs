//! The options by which every command measures videos: profile, limits, and who computes.

use std::path::PathBuf;

use clap::Args;
use plumbline_vision::slam::intrinsics::Intrinsics;
use plumbline_worker::fetch::Fetcher;
use plumbline_worker::learned::{Kind, ModelSource, SourceError};
use plumbline_worker::profile::{Profile, SeaRaftRole, SeaRaftUse};
use plumbline_worker::settings::Settings;

use super::Failure;
use crate::fanout::Slots;
use crate::profiles::{self, ProfileName};
use crate::thresholds::{self, FaultCalibration};

/// What was typed about statistics, beside how videos are computed.
#[derive(Debug, Args)]
pub(super) struct MeasuringArgs {
    #[command(flatten)]
    computing: ComputingArgs,
    /// Leading frames left out of every statistic (frame 0 of a rollout is often a real picture) [default: the profile's, 1]
    #[arg(long, value_name = "N")]
    conditioning_frames: Option<u32>,
    /// Frames up to this index cannot be the paper's peak frame t* [default: the profile's, 7]
    #[arg(long, value_name = "T")]
    warmup: Option<u32>,
}

/// What was typed about how videos are computed.
#[derive(Debug, Args)]
pub(super) struct ComputingArgs {
    /// Rung of the speed/accuracy ladder (draft, standard, accurate, reference), or FILE.toml with changed knobs
    #[arg(long, default_value = "standard")]
    pub(super) profile: ProfileName,
    #[command(flatten)]
    pub(super) settings: SettingArgs,
}

/// What was typed that holds whatever the profile.
#[derive(Debug, Clone, Args)]
pub(super) struct SettingArgs {
    /// Focal lengths and principal point of the camera, px of the videos as decoded [default: a view of 60 degrees]
    #[arg(long, value_name = "FX,FY,CX,CY", value_parser = parse_intrinsics)]
    intrinsics: Option<Intrinsics>,
    /// Frames per second of directories of numbered images [default: the profile's, 10]
    #[arg(long, value_name = "FPS")]
    sequence_fps: Option<f64>,
    /// What finds optical flow: dis (classical) or sea-raft (needs --models) [default: the profile's]
    #[arg(long, value_name = "PROVIDER")]
    flow: Option<FlowProvider>,
    /// Converted model sets of learned networks: a directory or s3://BUCKET/PREFIX [default: models.place]
    #[arg(long, value_name = "PLACE")]
    models: Option<String>,
    /// ONNX Runtime's shared library, which runs them [default: models.runtime]
    #[arg(long, value_name = "FILE")]
    onnxruntime: Option<PathBuf>,
    /// Wall time for one video, seconds
    #[arg(long, value_name = "SECONDS")]
    deadline: Option<f64>,
    /// Memory of one compute process, MiB
    #[arg(long, value_name = "MIB")]
    memory: Option<u64>,
}

/// What finds the flow of the working frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum FlowProvider {
    Dis,
    SeaRaft,
}

impl FlowProvider {
    /// Puts it into a profile.
    fn apply(self, profile: &mut Profile) -> Result<(), Failure> {
        let used = &mut profile.sea_raft;
        if used
            .as_ref()
            .is_some_and(|used| used.role == SeaRaftRole::Photometric)
        {
            return Err(Failure::usage(
                "--flow is for profiles without WorldScore's own measures: leave it out, or choose another --profile",
            ));
        }
        match self {
            Self::Dis => *used = None,
            Self::SeaRaft => {
                used.get_or_insert_with(|| SeaRaftUse::new(SeaRaftRole::Flow));
            }
        }
        Ok(())
    }
}

/// Thresholds in place of the profile's own.
#[derive(Debug, Args)]
pub(super) struct ThresholdsArg {
    /// Fault thresholds that `reference fit --faults` wrote, in place of the profile's own
    #[arg(long, value_name = "FILE")]
    fault_thresholds: Option<PathBuf>,
}

impl ThresholdsArg {
    /// Puts them into the profile, where given and fitted for it.
    pub(super) fn apply(&self, profile: &mut Profile) -> Result<Option<FaultCalibration>, Failure> {
        let Some(path) = &self.fault_thresholds else {
            return Ok(None);
        };
        let (thresholds, calibration) = thresholds::load(path, profile).map_err(Failure::usage)?;
        profile.fault_thresholds = thresholds;
        Ok(Some(calibration))
    }
}

/// What is usable.
pub(super) struct Measuring {
    pub(super) profile: Profile,
    pub(super) slots: Slots,
}

fn parse_intrinsics(text: &str) -> Result<Intrinsics, String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|word| word.trim().parse().ok())
        .collect();
    let intrinsics = match numbers.as_deref() {
        Some(&[fx, fy, cx, cy]) => Intrinsics { fx, fy, cx, cy },
        _ => return Err("four numbers are needed: fx,fy,cx,cy".to_owned()),
    };
    match intrinsics.is_valid() {
        true => Ok(intrinsics),
        false => Err("focal lengths must be above 0 and all numbers finite".to_owned()),
    }
}

/// Names the model sets that the profile leaves open: the only ones of the configured place.
async fn name_models(profile: &mut Profile, source: &ModelSource) -> Result<(), SourceError> {
    if let Some(used) = &mut profile.sea_raft
        && used.model.is_none()
    {
        used.model = Some(source.only(Kind::SeaRaft).await?);
    }
    if let Some(used) = &mut profile.droid
        && used.model.is_none()
    {
        used.model = Some(source.only(Kind::Droid).await?);
    }
    Ok(())
}

impl Measuring {
    /// Has a compute process load the profile's networks, where there are any: what is missing or damaged
    /// is found before the first video is.
    pub(super) fn load_networks(&self) -> Result<(), Failure> {
        if !self.profile.is_learned() {
            return Ok(());
        }
        let profile = self.profile.canonical().map_err(Failure::usage)?;
        let mut slot = self.slots.slot();
        let refused = super::runtime()?.block_on(slot.load(&profile));
        match refused.map_err(Failure::stopped)? {
            None => Ok(()),
            Some(reason) => Err(Failure::usage(reason)),
        }
    }
}

impl MeasuringArgs {
    /// A limit of this machine that was typed.
    pub(super) fn typed_limit(&self) -> Option<&'static str> {
        let deadline = self.computing.settings.deadline.map(|_| "--deadline");
        deadline.or(self.computing.settings.memory.map(|_| "--memory"))
    }

    /// With settings from file and environment under what was typed; `jobs` slots, or one per core.
    pub(super) fn usable(self, jobs: Option<u16>) -> Result<Measuring, Failure> {
        let mut measuring = self.computing.usable(jobs)?;
        let profile = &mut measuring.profile;
        profile.conditioning_frames = self
            .conditioning_frames
            .unwrap_or(profile.conditioning_frames);
        profile.warmup_frames = self.warmup.unwrap_or(profile.warmup_frames);
        Ok(measuring)
    }
}

impl ComputingArgs {
    /// With settings from file and environment under what was typed; `jobs` slots, or one per core.
    pub(super) fn usable(&self, jobs: Option<u16>) -> Result<Measuring, Failure> {
        let mut settings = Settings::load().map_err(Failure::usage)?;
        if let Some(deadline_s) = self.settings.deadline {
            settings.compute.deadline_s = deadline_s;
            settings.compute.learned_deadline_s = deadline_s;
        }
        settings.models.place = self.settings.models.clone().or(settings.models.place);
        settings.models.runtime = self
            .settings
            .onnxruntime
            .clone()
            .or(settings.models.runtime);
        if let Some(memory_mib) = self.settings.memory {
            settings.compute.memory_mib = memory_mib;
        }
        settings.validate().map_err(Failure::usage)?;
        let mut profile =
            profiles::load(&self.profile, &settings.decode).map_err(Failure::usage)?;
        profile.intrinsics = self.settings.intrinsics.or(profile.intrinsics);
        profile.sequence_fps = self.settings.sequence_fps.unwrap_or(profile.sequence_fps);
        if !(profile.sequence_fps.is_finite() && profile.sequence_fps > 0.0) {
            return Err(Failure::usage("--sequence-fps must be above 0"));
        }
        if let Some(flow) = self.settings.flow {
            flow.apply(&mut profile)?;
        }
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let slots = Slots {
            program: std::env::current_exe().map_err(Failure::stopped)?,
            count: jobs.map_or(cores, usize::from),
            limits: settings.compute,
            fetcher: Fetcher::new(settings.store.s3_options(), std::env::temp_dir())
                .with_models(settings.models),
        };
        if profile.is_learned() {
            super::runtime()?
                .block_on(name_models(&mut profile, slots.fetcher.model_source()))
                .map_err(Failure::usage)?;
        }
        if let ProfileName::File(path) = &self.profile {
            let tried = super::runtime()?.block_on(profiles::tried(&profile, &slots));
            tried.map_err(|error| Failure::usage(format!("{}: {error}", path.display())))?;
        }
        Ok(Measuring { profile, slots })
    }
}
