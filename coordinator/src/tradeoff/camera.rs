//! A tracked camera against the true one of a rendered clip: trajectory and depths.

use plumbline_sample::SampleError;
use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::geometry::Pose;
use plumbline_sample::scene::Scene;
use plumbline_vision::signals::median;
use plumbline_vision::slam::se3::Se3;
use plumbline_vision::slam::trajectory::{TimedPose, absolute_error};
use plumbline_worker::slam::{DepthVerdict, Tracked};

/// Depths are known to this relative deviation or better where they are called observable.
const OBSERVABLE_DEVIATION: f32 = 1.0;

/// Trajectory error in percent of the path, and depth error; `None` where no depth was estimated.
pub(super) fn camera_errors(
    tracked: &Tracked,
    spec: &ClipSpec,
) -> Result<Option<[f64; 2]>, SampleError> {
    if tracked.depth != DepthVerdict::Estimated {
        return Ok(None);
    }
    let scene = Scene::new(spec.family, spec.seed);
    let pose = |frame: usize| {
        let progress = frame as f64 / (spec.frames - 1) as f64;
        let pose = Pose::from_rigid(&scene.snapshot(progress, None).camera_from_world);
        let [tx, ty, tz] = pose.translation_m;
        let [qx, qy, qz, qw] = pose.quaternion_xyzw();
        Se3::from_array([tx, ty, tz, qx, qy, qz, qw]).inverse()
    };
    let truth: Vec<TimedPose> = tracked
        .times_s
        .iter()
        .take(spec.frames)
        .enumerate()
        .map(|(frame, &time_s)| TimedPose {
            time_s,
            world_from_camera: pose(frame),
        })
        .collect();
    let path_m: f64 = truth
        .windows(2)
        .map(|pair| {
            let [a, b] = [&pair[0], &pair[1]].map(|pose| pose.world_from_camera.translation);
            (a - b).norm()
        })
        .sum();
    let estimate: Vec<TimedPose> = tracked
        .poses
        .iter()
        .filter_map(|&(frame, pose)| {
            Some(TimedPose {
                time_s: *tracked.times_s.get(frame as usize)?,
                world_from_camera: Se3::from_array(pose).inverse(),
            })
        })
        .collect();
    let Ok(error) = absolute_error(&estimate, &truth) else {
        return Ok(None);
    };
    let depth = depth_error(tracked, spec)?;
    Ok(depth
        .filter(|_| path_m > 0.0)
        .map(|depth| [100.0 * error.rmse / path_m, depth]))
}

fn depth_error(tracked: &Tracked, spec: &ClipSpec) -> Result<Option<f64>, SampleError> {
    let (columns, rows) = tracked.grid;
    let [x0, y0, dx, dy] = tracked.grid_px;
    let mut ratios = Vec::new();
    for (index, &frame) in tracked.keyframes.iter().enumerate() {
        let depth_m = spec.truth(frame as usize)?.depth_m;
        for cell in 0..columns * rows {
            let place = index * columns * rows + cell;
            let known = tracked.relative_deviation.get(place).copied().flatten();
            let (Some(&inverse), Some(_)) = (
                tracked.inverse_depths.get(place),
                known.filter(|&deviation| deviation <= OBSERVABLE_DEVIATION),
            ) else {
                continue;
            };
            let pixel = |first: f64, step: f64, at: usize, length: usize| {
                (first + step * at as f64)
                    .round()
                    .clamp(0.0, (length - 1) as f64) as usize
            };
            let x = pixel(x0, dx, cell % columns, spec.width);
            let y = pixel(y0, dy, cell / columns, spec.height);
            let ratio = f64::from(inverse) * f64::from(depth_m[y * spec.width + x]);
            if ratio > 0.0 && ratio.is_finite() {
                ratios.push(ratio);
            }
        }
    }
    let Some(scale) = median(&mut ratios.clone()) else {
        return Ok(None);
    };
    // d̂ = 1 / inverse: d/d̂ is the ratio, once the scale is taken out.
    let mut errors: Vec<f64> = ratios
        .iter()
        .map(|ratio| (ratio / scale - 1.0).abs())
        .collect();
    Ok(median(&mut errors))
}

#[cfg(test)]
mod tests {
    use plumbline_sample::render::Camera;
    use plumbline_sample::scene::Family;
    use plumbline_vision::scene::SceneKind;
    use plumbline_vision::slam::intrinsics::{Intrinsics, IntrinsicsOrigin};
    use plumbline_worker::decode::VideoInfo;
    use plumbline_worker::slam::StageSeconds;

    use super::*;

    /// The true poses and depths in another unit, one depth in ten off by `factor`.
    fn tracked(spec: &ClipSpec, factor: f64) -> Tracked {
        const UNIT_M: f64 = 2.5;
        const STEP_PX: f64 = 8.0;
        let scene = Scene::new(spec.family, spec.seed);
        let pose = |frame: usize| {
            let progress = frame as f64 / (spec.frames - 1) as f64;
            let pose = Pose::from_rigid(&scene.snapshot(progress, None).camera_from_world);
            let [tx, ty, tz] = pose.translation_m.map(|t| t / UNIT_M);
            let [qx, qy, qz, qw] = pose.quaternion_xyzw();
            [tx, ty, tz, qx, qy, qz, qw]
        };
        let (columns, rows) = (spec.width / 8, spec.height / 8);
        let keyframes: Vec<u32> = (0..spec.frames as u32).step_by(3).collect();
        let mut inverse_depths = Vec::new();
        for &frame in &keyframes {
            let depth_m = spec.truth(frame as usize).unwrap().depth_m;
            for cell in 0..columns * rows {
                let (x, y) = (4 + 8 * (cell % columns), 4 + 8 * (cell / columns));
                let off = if cell % 10 == 0 { factor } else { 1.0 };
                let depth = f64::from(depth_m[y * spec.width + x]) / UNIT_M * off;
                inverse_depths.push((1.0 / depth) as f32);
            }
        }
        let camera = Camera::new(spec.width, spec.height).unwrap();
        Tracked {
            info: VideoInfo {
                container: String::new(),
                codec: String::new(),
                pixel_format: String::new(),
                width: spec.width as u32,
                height: spec.height as u32,
                coded_width: spec.width as u32,
                coded_height: spec.height as u32,
                sample_aspect_ratio: 1.0,
                rotation_deg: 0,
                mirrored: false,
                frames: spec.frames as u32,
                fps: Some(spec.fps),
                duration_s: None,
                variable_frame_rate: false,
                dropped_frames: 0,
                damaged_frames: 0,
                rejected_packets: 0,
                silent_packets: 0,
                stopped_early: false,
            },
            times_s: (0..spec.frames).map(|k| k as f64 / spec.fps).collect(),
            scene: SceneKind::Parallax,
            depth: DepthVerdict::Estimated,
            intrinsics: Intrinsics {
                fx: camera.fx,
                fy: camera.fy,
                cx: camera.cx,
                cy: camera.cy,
            },
            intrinsics_origin: IntrinsicsOrigin::Given,
            focal: None,
            poses: (0..spec.frames).map(|k| (k as u32, pose(k))).collect(),
            grid: (columns, rows),
            grid_px: [4.0, 4.0, STEP_PX, STEP_PX],
            relative_deviation: vec![Some(0.1); inverse_depths.len()],
            keyframes,
            inverse_depths,
            observable_fraction: Some(1.0),
            edges: Vec::new(),
            residual_px: None,
            series: Vec::new(),
            adjustment_steps: 0,
            converged: true,
            depth_cells: 0,
            depth_cells_saved: 0,
            seconds: StageSeconds::default(),
        }
    }

    #[test]
    fn the_truth_in_another_unit_has_no_error_and_errors_are_what_was_put_in() {
        let spec = ClipSpec {
            frames: 8,
            ..ClipSpec::clean(Family::Dolly, 0, 3).with_size(64, 48)
        };
        let [pose, depth] = camera_errors(&tracked(&spec, 1.0), &spec).unwrap().unwrap();
        // Depths and inverse depths were rounded to f32.
        assert!(pose < 1e-9 && depth < 1e-6, "{pose} {depth}");
        // The median does not see one depth in ten; it does see all but those that are not known.
        let mut odd = tracked(&spec, 2.0);
        let [_, depth] = camera_errors(&odd, &spec).unwrap().unwrap();
        assert!(depth < 1e-6, "{depth}");
        for (k, inverse) in odd.inverse_depths.iter_mut().enumerate() {
            *inverse *= if k % 2 == 0 { 0.8 } else { 1.25 };
        }
        let [_, depth] = camera_errors(&odd, &spec).unwrap().unwrap();
        assert!(depth > 0.15, "{depth}");
        odd.relative_deviation.fill(None);
        assert_eq!(camera_errors(&odd, &spec).unwrap(), None);
        odd.depth = DepthVerdict::Rotation;
        assert_eq!(camera_errors(&odd, &spec).unwrap(), None);
    }
}
