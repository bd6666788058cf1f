//! Points side by side: what each costs and gives, the front, and which the question's hours allow.

use std::collections::BTreeMap;

use plumbline_common::id::VideoId;
use plumbline_common::row::{Cost, Scene, Status};

use super::compare::{compare, foretells, uncertain};
use super::front::{Bought, front};
use super::plan::{self, Question, Shape, Spent, Working};
use super::sample::Sampled;
use super::{
    PointMeasured, PointResult, Stages, Tradeoff, TradeoffError, TradeoffOptions, profile_to_type,
};
use crate::run::RunError;

/// Points side by side, the cheapest first, and the plan. The last point measured is the top.
pub(super) fn judge(
    options: &TradeoffOptions,
    corpus_videos: usize,
    sample: &[Sampled],
    labels: &BTreeMap<VideoId, f64>,
    measured: Vec<PointMeasured>,
) -> Result<Tradeoff, TradeoffError> {
    let question = Question {
        videos: options.videos.unwrap_or(corpus_videos as u64),
        shape: options.shape,
        cores: options.cores,
        hours: options.hours,
    };
    let keep = &options.reduce.keep;
    let Some(top) = measured.last() else {
        return Err(TradeoffError::OnePoint);
    };
    let top_cpu_s = cpu_s_per_video(&top.costs);
    let top_uncertain = uncertain(&top.rows, keep).iter().filter(|&&u| u).count();
    let mut points = Vec::new();
    for (index, of) in measured.iter().enumerate() {
        let profile = &of.point.profile;
        let working = Working {
            height_px: profile.working_height_px,
            conditioning_frames: profile.conditioning_frames,
        };
        let spent = spent(sample, of);
        let cpu_s = cpu_s_per_video(&of.costs);
        points.push(PointResult {
            name: of.point.name.clone(),
            profile: profile_to_type(&of.point),
            profile_digest: profile.digest().map_err(RunError::Profile)?,
            top: index + 1 == measured.len(),
            working_height_px: profile.working_height_px,
            finest_scale: profile.flow.finest_scale,
            edge_spans: profile.edge_spans.clone(),
            scored: of.rows.iter().filter(|row| row.anomaly.is_some()).count(),
            cpu_s_per_video: cpu_s,
            relative_cost: if top_cpu_s > 0.0 {
                cpu_s / top_cpu_s
            } else {
                1.0
            },
            stages_s: stages(&of.costs, cpu_s),
            on_front: false,
            agreement: compare(&of.rows, &top.rows, keep),
            spearman_by_recipe: of
                .by_recipe
                .iter()
                .map(|(recipe, rows)| {
                    let found = compare(rows, &top.by_recipe[recipe], keep).spearman;
                    (recipe.clone(), found)
                })
                .collect(),
            auroc_failure: foretells(&of.rows, labels),
            truth: of.known.as_ref().map(|known| known.truth),
            faults: of.known.as_ref().map(|known| known.faults.clone()),
            cost_model: plan::fit(&spent, working),
            plan: plan::plan(&spent, working, &question),
        });
    }
    let bought: Vec<Bought> = points
        .iter()
        .map(|point| Bought {
            cost: point.cpu_s_per_video,
            good: point.agreement.spearman.unwrap_or(-1.0),
        })
        .collect();
    for (point, on_front) in points.iter_mut().zip(front(&bought)) {
        point.on_front = on_front || point.top;
    }
    points.sort_by(|a, b| a.cpu_s_per_video.total_cmp(&b.cpu_s_per_video));
    let recommended = recommend(&points, &question).map(|point| point.name.clone());
    Ok(Tradeoff {
        source: options.sources.clone(),
        corpus_videos,
        sample: sample
            .iter()
            .map(|s| s.entry.video.as_str().to_owned())
            .collect(),
        recipe: options.reduce.recipe,
        keep: keep.to_string(),
        top_uncertain,
        question,
        waiting: waiting(&measured),
        points,
        recommended,
    })
}

/// Of the front's points that are done in time even at the upper end of their interval, the one with the
/// fewest flips; of equals the nearest in order, then the cheapest.
pub(super) fn recommend<'a>(
    points: &'a [PointResult],
    question: &Question,
) -> Option<&'a PointResult> {
    const HOUR_S: f64 = 3600.0;
    let in_time = points.iter().filter(|point| {
        let plan = point.plan.filter(|_| point.on_front);
        plan.is_some_and(|plan| plan.wall_interval_90_s.1 <= question.hours * HOUR_S)
    });
    in_time.min_by(|a, b| {
        let spearman = |point: &PointResult| point.agreement.spearman.unwrap_or(-1.0);
        let flips = |point: &PointResult| point.agreement.flips.count();
        (flips(a).cmp(&flips(b)))
            .then(spearman(b).total_cmp(&spearman(a)))
            .then(a.cpu_s_per_video.total_cmp(&b.cpu_s_per_video))
    })
}

/// How long measurements took by the clock, over what they computed.
fn waiting(measured: &[PointMeasured]) -> f64 {
    let costs = || measured.iter().flat_map(|point| &point.costs);
    let cpu_s: f64 = costs().map(|cost| cost.cpu_s).sum();
    let total_s: f64 = costs().map(|cost| cost.total_s).sum();
    if cpu_s > 0.0 { total_s / cpu_s } else { 1.0 }
}

fn cpu_s_per_video(costs: &[Cost]) -> f64 {
    costs.iter().map(|cost| cost.cpu_s).sum::<f64>() / costs.len().max(1) as f64
}

/// Stages are timed by the clock; processor time is shared out among them in proportion.
fn stages(costs: &[Cost], cpu_s_per_video: f64) -> Stages {
    let sum = |of: fn(&Cost) -> f64| costs.iter().map(of).sum::<f64>();
    let total = sum(|cost| cost.total_s);
    let share = |of: fn(&Cost) -> f64| {
        if total > 0.0 {
            cpu_s_per_video * sum(of) / total
        } else {
            0.0
        }
    };
    Stages {
        decode: share(|cost| cost.decode_s),
        flow: share(|cost| cost.flow_s),
        signals: share(|cost| cost.signals_s),
        geometry: share(|cost| cost.geometry_s),
    }
}

fn spent(sample: &[Sampled], of: &PointMeasured) -> Vec<Spent> {
    let rows = sample.iter().zip(&of.rows).zip(&of.costs);
    rows.map(|((sampled, row), cost)| {
        let m = &row.measured;
        Spent {
            shape: match (m.frames, m.width, m.height) {
                (Some(frames), Some(width), Some(height)) => Some(Shape {
                    frames,
                    width,
                    height,
                }),
                _ => None,
            },
            parallax: m.scene == Some(Scene::Parallax) && m.status != Status::Failed,
            weight: sampled.weight,
            cpu_s: cost.cpu_s,
        }
    })
    .collect()
}
