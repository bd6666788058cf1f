//! WorldScore's two measures of a clip by learned networks: photometric consistency (SEA-RAFT, on the frames
//! as decoded) and 3D consistency (DROID-SLAM, on frames of an area of 512² px).
//!
//! Both see every frame that counts. Units are WorldScore's own: px of the frames as decoded, and cells of
//! the grid of an eighth of the tracked picture.

use std::time::{Duration, Instant};

use plumbline_vision::consistency::worldscore_epe;
use plumbline_vision::image::Rgb8;
use plumbline_vision::learned::LearnedError;
use plumbline_vision::learned::droid::DroidNetworks;
use plumbline_vision::learned::droid_operator::DroidOperator;
use plumbline_vision::learned::sea_raft::{SeaRaft, SeaRaftFrame};
use plumbline_vision::learned::tracking_picture::TrackingPicture;
use plumbline_vision::scene::AdjustedEdge;
use plumbline_vision::slam::camera::Grid;
use plumbline_vision::slam::reference::ReferenceTracker;

use super::error::{ClipError, at};
use crate::learned::{LoadedSeaRaft, Networks};
use crate::profile::{DroidUse, Profile, SeaRaftRole};

/// Side of a cell, px of the tracked picture.
const CELL_PX: usize = 8;

/// WorldScore's frozen normalisers: this error, or a larger one, is a consistency of 0.
const MOST_3D: f64 = 1.0719;
const MOST_PHOTOMETRIC: f64 = 1.1920;

/// WorldScore's consistency of an error, 0 to 100.
fn consistency(error: f64, most: f64) -> f64 {
    100.0 * (1.0 - error.clamp(0.0, most) / most)
}

/// WorldScore's 3D consistency of a mean reprojection error in cells.
pub(super) fn consistency_3d(error_cells: f64) -> f64 {
    consistency(error_cells, MOST_3D)
}

/// WorldScore's photometric consistency of a mean end-point error in px.
pub(super) fn consistency_photometric(error_px: f64) -> f64 {
    consistency(error_px, MOST_PHOTOMETRIC)
}

/// A clip's learned measures while its frames stream by.
#[derive(Default)]
pub(super) struct LearnedMeasures<'a> {
    photometric: Option<Photometric<'a>>,
    tracking: Option<Tracking<'a>>,
}

/// What they found.
#[derive(Default)]
pub(super) struct LearnedResult {
    /// End-point error of each pair, by later frame, px; absent where SEA-RAFT was not asked.
    pub(super) end_point_px: Option<Vec<(u32, f64)>>,
    /// What the last global adjustment leaves on each edge, cells; absent where DROID-SLAM was not asked.
    pub(super) residuals: Option<Vec<AdjustedEdge>>,
    /// Mean over all their cells, cells.
    pub(super) reprojection_cells: Option<f64>,
    pub(super) work: LearnedWork,
}

/// What they cost.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct LearnedWork {
    pub(super) photometric: Duration,
    pub(super) tracking: Duration,
    pub(super) edge_updates: u64,
}

struct Photometric<'a> {
    sea_raft: LoadedSeaRaft,
    /// Where it comes from.
    home: &'a mut Option<LoadedSeaRaft>,
    last: Option<SeaRaftFrame>,
    pairs: Vec<(u32, f64)>,
    spent: Duration,
}

struct Tracking<'a> {
    used: &'a DroidUse,
    /// Where the networks come from and go back to.
    home: &'a mut Option<(String, DroidNetworks)>,
    digest: String,
    /// From the first frame on.
    tracker: Option<ReferenceTracker<DroidOperator>>,
    last_frame: u32,
    spent: Duration,
}

impl<'a> LearnedMeasures<'a> {
    /// The measures that the profile asks for, and SEA-RAFT where it is for something else.
    pub(super) fn new(
        profile: &'a Profile,
        networks: Networks<'a>,
    ) -> (Self, Option<&'a mut SeaRaft>) {
        let role = profile.sea_raft.as_ref().map(|used| used.role);
        let (photometric, flow) = match (networks.sea_raft, role) {
            (Some(home), Some(SeaRaftRole::Photometric)) => (
                home.take().map(|sea_raft| Photometric {
                    sea_raft,
                    home,
                    last: None,
                    pairs: Vec::new(),
                    spent: Duration::ZERO,
                }),
                None,
            ),
            (home, _) => (
                None,
                home.and_then(|home| home.as_mut().map(|kept| &mut kept.network)),
            ),
        };
        let tracking = profile.droid.as_ref().zip(networks.droid);
        let tracking = tracking.map(|(used, home)| Tracking {
            used,
            home,
            digest: String::new(),
            tracker: None,
            last_frame: 0,
            spent: Duration::ZERO,
        });
        let measures = Self {
            photometric,
            tracking,
        };
        (measures, flow)
    }

    /// Takes the next frame that counts, as decoded.
    pub(super) fn push(&mut self, frame: u32, picture: &Rgb8) -> Result<(), ClipError> {
        if let Some(photometric) = &mut self.photometric {
            photometric.push(frame, picture)?;
        }
        if let Some(tracking) = &mut self.tracking {
            tracking.push(frame, picture)?;
        }
        Ok(())
    }

    /// What there is to say of the whole clip; an error says why a part is missing.
    pub(super) fn finish(self) -> (LearnedResult, Option<ClipError>) {
        let mut found = LearnedResult::default();
        if let Some(photometric) = self.photometric {
            found.work.photometric = photometric.spent;
            found.end_point_px = Some(photometric.pairs);
            // Tracking's global run takes more memory than all before it: SEA-RAFT's is given back first.
            if self.tracking.is_none() {
                *photometric.home = Some(photometric.sea_raft);
            }
        }
        let mut problem = None;
        if let Some(tracking) = self.tracking
            && let Err(error) = tracking.finish(&mut found)
        {
            problem = Some(error);
        }
        (found, problem)
    }
}

impl Photometric<'_> {
    fn push(&mut self, frame: u32, picture: &Rgb8) -> Result<(), ClipError> {
        let started = Instant::now();
        let error = learned_error("photometric consistency", frame);
        let next = self.sea_raft.network.prepare(picture).map_err(&error)?;
        if let Some(last) = &self.last {
            let forward = self.sea_raft.network.flow(last, &next).map_err(&error)?;
            let backward = self.sea_raft.network.flow(&next, last).map_err(&error)?;
            let measured = worldscore_epe(&forward.flow, &backward.flow)
                .map_err(at("photometric consistency", frame))?;
            self.pairs.extend(measured.average_px.map(|px| (frame, px)));
        }
        self.last = Some(next);
        self.spent += started.elapsed();
        Ok(())
    }
}

impl Tracking<'_> {
    fn push(&mut self, frame: u32, picture: &Rgb8) -> Result<(), ClipError> {
        let started = Instant::now();
        let prepared = TrackingPicture::new(picture, self.used.area_px)
            .map_err(at("3D consistency", frame))?;
        self.last_frame = frame;
        let tracker = match &mut self.tracker {
            Some(tracker) => tracker,
            None => {
                let Some((digest, networks)) = self.home.take() else {
                    return Ok(());
                };
                self.digest = digest;
                let grid = Grid {
                    rows: prepared.picture.height / CELL_PX,
                    columns: prepared.picture.width / CELL_PX,
                };
                let operator = DroidOperator::new(networks, self.used.operator.clone());
                self.tracker.insert(ReferenceTracker::new(
                    prepared.camera,
                    grid,
                    operator,
                    self.used.tracker.clone(),
                ))
            }
        };
        let offered = tracker
            .operator_mut()
            .offer(frame as usize, &prepared.picture);
        if offered.map_err(learned_error("3D consistency", frame))? {
            tracker
                .push(frame as usize)
                .map_err(at("3D consistency", frame))?;
        }
        self.spent += started.elapsed();
        Ok(())
    }

    fn finish(self, found: &mut LearnedResult) -> Result<(), ClipError> {
        let Some(mut tracker) = self.tracker else {
            return Ok(());
        };
        let started = Instant::now();
        let finished = tracker.finish();
        if let Ok(error) = &finished {
            found.reprojection_cells = error.mean_cells;
            found.residuals = Some(tracker.residuals());
        }
        let operator = tracker.into_operator();
        found.work.tracking = self.spent + started.elapsed();
        found.work.edge_updates = operator.edge_updates();
        *self.home = Some((self.digest, operator.into_networks()));
        match finished {
            Ok(_) => Ok(()),
            Err(error) => Err(at("3D consistency", self.last_frame)(error)),
        }
    }
}

/// Names stage and frame; a picture that is too small has its own words.
pub(super) fn learned_error(stage: &'static str, frame: u32) -> impl Fn(LearnedError) -> ClipError {
    move |error| match error {
        LearnedError::TooSmall {
            width,
            height,
            least,
        } => ClipError::TooSmall {
            stage,
            width,
            height,
            least,
        },
        error => at(stage, frame)(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// WorldScore's normalisation, by hand.
    #[test]
    fn errors_become_consistencies() {
        assert_eq!(consistency_3d(0.0), 100.0);
        assert_eq!(consistency_3d(1.0719), 0.0);
        assert_eq!(consistency_3d(7.0), 0.0);
        assert!((consistency_3d(0.26798) - 75.0).abs() < 1e-3);
        assert!((consistency_photometric(0.596) - 50.0).abs() < 1e-9);
    }
}
