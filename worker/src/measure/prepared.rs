//! Frames, each prepared once for all pairs that it takes part in, and the flows between them.

use std::rc::Rc;
use std::time::{Duration, Instant};

use plumbline_vision::consistency::{FrameStructure, NormalisedFrame};
use plumbline_vision::flow::Flow;
use plumbline_vision::flow::dis::{Dis, DisFrame};
use plumbline_vision::image::{Rgb8, resize_rgb};
use plumbline_vision::learned::sea_raft::SeaRaftFrame;

use super::edges::{Flows, PairFlows};
use super::error::{ClipError, MAX_ASPECT, at};
use super::network_flow::NetworkFlow;
use crate::decode::DecodedFrame;
use crate::profile::Profile;

/// A frame, prepared once for all pairs that it takes part in.
pub(super) struct Prepared {
    pub(super) index: u32,
    pub(super) rgb: Rgb8,
    dis: Rc<DisFrame>,
    network: Option<Rc<SeaRaftFrame>>,
    pub(super) normalised: Rc<NormalisedFrame>,
    pub(super) structure: Rc<FrameStructure>,
}

/// Pairs of frames, of which each has a flow there and one back.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct FlowWork {
    /// Pairs whose flows were searched for.
    pub(super) pairs: u64,
    /// Pairs that a measurement would take that leaves nothing out.
    pub(super) pairs_in_full: u64,
    /// Frames that are the one before again, bit for bit.
    pub(super) frames_repeated: u64,
}

/// A frame at the working size: the profile's height, aspect kept.
pub(crate) fn working_picture(profile: &Profile, frame: &DecodedFrame) -> Result<Rgb8, ClipError> {
    let (width, height) = (frame.rgb.width, frame.rgb.height);
    if width > MAX_ASPECT * height || height > MAX_ASPECT * width {
        return Err(ClipError::Aspect { width, height });
    }
    let (working_width, working_height) = profile.working_size(width, height);
    Ok(resize_rgb(&frame.rgb, working_width, working_height))
}

/// Prepares frames, and searches for the flows between them.
pub(super) struct FlowSearch<'a> {
    profile: &'a Profile,
    dis: Dis,
    network_flow: Option<NetworkFlow<'a>>,
    pub(super) work: FlowWork,
    /// Wall time.
    pub(super) spent: Duration,
}

impl<'a> FlowSearch<'a> {
    pub(super) fn new(profile: &'a Profile, network_flow: Option<NetworkFlow<'a>>) -> Self {
        Self {
            profile,
            dis: Dis::new(profile.flow.clone()),
            network_flow,
            work: FlowWork::default(),
            spent: Duration::ZERO,
        }
    }

    /// Prepares a frame at the working size; one that is the `last` one again shares its preparation.
    pub(super) fn prepare(
        &mut self,
        index: u32,
        rgb: Rgb8,
        last: Option<&Rc<Prepared>>,
    ) -> Result<Rc<Prepared>, ClipError> {
        if let Some(last) = last.filter(|last| last.rgb == rgb) {
            self.work.frames_repeated += 1;
            return Ok(Rc::new(Prepared {
                index,
                rgb,
                dis: Rc::clone(&last.dis),
                network: last.network.clone(),
                normalised: Rc::clone(&last.normalised),
                structure: Rc::clone(&last.structure),
            }));
        }
        let grey = rgb.grey();
        let started = Instant::now();
        let dis = DisFrame::new(&grey, &self.profile.flow).map_err(at("flow", index))?;
        let network = match &mut self.network_flow {
            Some(network) => Some(Rc::new(network.prepare(index, &rgb)?)),
            None => None,
        };
        self.spent += started.elapsed();
        let normalised = NormalisedFrame::new(&grey, &self.profile.consistency)
            .map_err(at("consistency", index))?;
        Ok(Rc::new(Prepared {
            index,
            rgb,
            dis: Rc::new(dis),
            network,
            structure: Rc::new(FrameStructure::new(&normalised)),
            normalised: Rc::new(normalised),
        }))
    }

    /// Forward and backward flow between two frames: zero, as the search would find, between one frame and
    /// itself.
    pub(super) fn flows(
        &mut self,
        earlier: &Prepared,
        later: &Prepared,
    ) -> Result<Flows, ClipError> {
        let networks = earlier.network.as_ref().zip(later.network.as_ref());
        if networks.is_none() && Rc::ptr_eq(&earlier.dis, &later.dis) {
            let still = Flow::still(earlier.rgb.width, earlier.rgb.height);
            return Ok(Rc::new(PairFlows::of([still.clone(), still])));
        }
        let started = Instant::now();
        let flows =
            if let (Some(network), Some((first, second))) = (&mut self.network_flow, networks) {
                let (forward, ahead) = network.flow(later.index, first, second, &later.rgb)?;
                let (backward, back) = network.flow(later.index, second, first, &later.rgb)?;
                PairFlows {
                    ways: [forward, backward],
                    confidence: Some([ahead, back]),
                }
            } else {
                let error = at("flow", later.index);
                let forward = self.dis.flow(&earlier.dis, &later.dis).map_err(&error)?;
                let backward = self.dis.flow(&later.dis, &earlier.dis).map_err(&error)?;
                PairFlows::of([forward, backward])
            };
        self.work.pairs += 1;
        self.spent += started.elapsed();
        Ok(Rc::new(flows))
    }
}
