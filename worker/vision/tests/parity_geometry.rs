//! Geometry against the reference's numbers (`tests/golden/README.md`, droid_geometry.npz): poses,
//! projection and its derivatives, frame distances, and six adjustments step by step.
//!
//! The archive was computed in f64 from the same f32 inputs, so that only the order of sums differs:
//! one evaluation agrees to some 1e-15 of the largest term. Tolerances are stated where they stand;
//! an error is absolute below 1 and relative above.

#![expect(clippy::unwrap_used, reason = "what cannot be read fails the test")]

mod archive;

use archive::{Archive, worst};
use nalgebra::Vector6;
use plumbline_vision::slam::bundle::{
    BundleOptions, EdgeObservation, Problem, Scene, Workspace, adjust, normal_equations,
};
use plumbline_vision::slam::camera::{DepthRule, Grid, Pinhole, reproject};
use plumbline_vision::slam::distance::{frame_distance, symmetric_distance};
use plumbline_vision::slam::se3::Se3;

const GRID: Grid = Grid {
    columns: 16,
    rows: 12,
};
const CELLS: usize = 192;

/// Some tens of operations on numbers up to 10.
const ROUNDING: f64 = 1e-12;

fn poses(archive: &mut Archive, key: &str) -> Vec<Se3> {
    let values = archive.f64(key);
    values
        .chunks_exact(7)
        .map(|v| Se3::from_array(v.try_into().unwrap()))
        .collect()
}

fn camera(archive: &mut Archive, key: &str) -> Pinhole {
    let v = archive.f64(key);
    Pinhole {
        fx: v[0],
        fy: v[1],
        cx: v[2],
        cy: v[3],
    }
}

#[test]
fn exp_retraction_and_relative_poses() {
    let mut archive = Archive::open("droid_geometry.npz");
    let xi: Vec<Vector6<f64>> = archive
        .f64("se3/xi")
        .chunks_exact(6)
        .map(Vector6::from_column_slice)
        .collect();
    let pose = poses(&mut archive, "se3/pose");
    let arrays = |poses: Vec<Se3>| {
        poses
            .into_iter()
            .flat_map(Se3::to_array)
            .collect::<Vec<_>>()
    };
    let found = arrays(xi.iter().map(Se3::exp).collect());
    // The reference leaves the turn's part of the translation out at angles up to 1e-4: here
    // |φ| is 2e-5 and |τ| 1e-5, so that ½ φ × τ is up to 1e-10.
    assert!(worst(found, &archive.f64("se3/exp")) < 2e-10);
    let found = arrays(pose.iter().zip(&xi).map(|(p, xi)| p.retract(xi)).collect());
    assert!(worst(found, &archive.f64("se3/retr")) < 2e-10);
    let found = arrays(pose.iter().map(|p| p.relative_to(&pose[0])).collect());
    assert!(worst(found, &archive.f64("se3/rel_pose0_to_n")) < ROUNDING);
}

#[test]
fn projection_and_its_derivatives() {
    let mut archive = Archive::open("droid_geometry.npz");
    let pose = poses(&mut archive, "proj/poses");
    let depths = archive.f64("proj/disps");
    let camera = camera(&mut archive, "proj/intrinsics");
    let (ii, jj) = (archive.indices("proj/ii"), archive.indices("proj/jj"));
    let mut found: [Vec<f64>; 6] = Default::default();
    for (&i, &j) in ii.iter().zip(&jj) {
        let relative = pose[j].relative_to(&pose[i]);
        for cell in 0..CELLS {
            let at = [(cell % 16) as f64, (cell / 16) as f64];
            let r = reproject(
                &camera,
                &relative,
                at,
                depths[i * CELLS + cell],
                DepthRule::WORLDSCORE,
            );
            found[0].extend(r.at.iter());
            found[1].push(f64::from(u8::from(r.valid)));
            found[2].push(r.z);
            found[3].extend(r.by_source.iter().flatten());
            found[4].extend(r.by_target.iter().flatten());
            found[5].extend(r.by_inverse_depth.iter());
        }
    }
    for (key, found) in ["coords", "valid", "Z", "Ji", "Jj", "Jz"].iter().zip(found) {
        let error = worst(found, &archive.f64(&format!("proj/{key}")));
        // Relative depths down to 0.1 magnify a rounding by up to 1e4 in the derivatives.
        assert!(error < 1e-11, "{key}: {error:e}");
    }
}

#[test]
fn frame_distances_of_all_pairs() {
    let mut archive = Archive::open("droid_geometry.npz");
    let pose = poses(&mut archive, "dist/poses");
    let depths = archive.f64("dist/disps");
    let camera = camera(&mut archive, "dist/intrinsics");
    let (ii, jj) = (archive.indices("dist/ii"), archive.indices("dist/jj"));
    assert_eq!(ii.len(), 49);
    // 1000 is the reference's word for "too few samples".
    let as_reference = |d: Option<f64>| d.unwrap_or(1000.0);
    // The reference passes β as f32.
    for (beta, name) in [
        (f64::from(0.3f32), "0.3"),
        (0.25, "0.25"),
        (0.0, "0.0"),
        (1.0, "1.0"),
    ] {
        let depths = |i: usize| &depths[i * CELLS..(i + 1) * CELLS];
        let one_way = |i: usize, j: usize| {
            as_reference(frame_distance(
                &camera,
                GRID,
                depths(i),
                &pose[j].relative_to(&pose[i]),
                beta,
            ))
        };
        let pairs = || ii.iter().copied().zip(jj.iter().copied());
        let found = pairs().map(|(i, j)| one_way(i, j));
        let error = worst(found, &archive.f64(&format!("dist/d_beta{name}")));
        assert!(error < ROUNDING, "beta {beta}: {error:e}");
        // The mean of both ways: where one way is missing the reference averages its 1000.
        let expected = archive.f64(&format!("dist/bidir_beta{name}"));
        for ((i, j), expected) in pairs().zip(expected) {
            let side = |i: usize| (&pose[i], depths(i));
            match symmetric_distance(&camera, GRID, [side(i), side(j)], beta) {
                Some(found) => assert!((found - expected).abs() < ROUNDING * expected.max(1.0)),
                None => assert!(expected >= 500.0),
            }
        }
    }
}

struct Case {
    scene: Scene,
    targets: Vec<f32>,
    weights: Vec<f32>,
    ii: Vec<usize>,
    jj: Vec<usize>,
    depth_damping: Vec<f32>,
    measured: Vec<f32>,
    free: std::ops::Range<usize>,
    options: BundleOptions,
}

/// t0, t1, iterations, lm, ep, motion only: `params` of the archive, which is a string there.
const CASES: [(&str, usize, usize, usize, f32, f32, bool); 6] = [
    ("s1_3frames_frontend", 1, 3, 3, 1e-4, 0.1, false),
    ("s2_6frames_backend", 1, 6, 3, 1e-5, 0.01, false),
    ("s3_6frames_window_t0_3", 3, 6, 2, 1e-4, 0.1, false),
    ("s4_hard_behind_camera", 1, 4, 2, 1e-4, 0.1, false),
    ("s5_motion_only", 3, 5, 3, 1e-4, 0.1, true),
    ("s6_with_depth_prior", 1, 4, 2, 1e-4, 0.1, false),
];

impl Case {
    fn load(
        archive: &mut Archive,
        (name, t0, t1, _, lm, ep, motion_only): (&str, usize, usize, usize, f32, f32, bool),
    ) -> Self {
        let key = |k: &str| format!("ba/{name}/{k}");
        let (ii, jj) = (archive.indices(&key("ii")), archive.indices(&key("jj")));
        let poses = poses(archive, &key("poses"));
        // Rows of eta belong to the sorted union of free frames and sources.
        let eta = archive.f32(&key("eta"));
        let rows = (0..poses.len()).filter(|f| (t0..t1).contains(f) || ii.contains(f));
        let mut depth_damping = vec![0.0; poses.len() * CELLS];
        for (frame, row) in rows.zip(eta.chunks_exact(CELLS)) {
            depth_damping[frame * CELLS..(frame + 1) * CELLS].copy_from_slice(row);
        }
        Self {
            scene: Scene {
                camera: camera(archive, &key("intrinsics")),
                grid: GRID,
                inverse_depths: archive.f64(&key("disps")),
                poses,
            },
            targets: archive.f32(&key("target")),
            weights: archive.f32(&key("weight")),
            ii,
            jj,
            depth_damping,
            measured: archive.f32(&key("disps_sens")),
            free: t0..t1,
            options: BundleOptions {
                lm: f64::from(lm),
                ep: f64::from(ep),
                motion_only,
                iterations: 1,
                ..BundleOptions::worldscore()
            },
        }
    }

    fn edges(&self) -> Vec<EdgeObservation<'_>> {
        let fields = self
            .targets
            .chunks_exact(2 * CELLS)
            .zip(self.weights.chunks_exact(2 * CELLS));
        let ends = self.ii.iter().zip(&self.jj);
        ends.zip(fields)
            .map(|((&source, &target), (at, weight))| EdgeObservation {
                source,
                target,
                at,
                weight,
            })
            .collect()
    }

    fn problem<'a>(&'a self, edges: &'a [EdgeObservation<'a>]) -> Problem<'a> {
        Problem {
            edges,
            free: self.free.clone(),
            depth_damping: Some(&self.depth_damping),
            measured: Some(&self.measured),
        }
    }

    fn sources(&self) -> Vec<usize> {
        let mut sources: Vec<usize> = self.ii.iter().copied().chain(self.free.clone()).collect();
        sources.sort_unstable();
        sources.dedup();
        sources
    }
}

#[test]
fn adjustments_step_by_step() {
    let mut archive = Archive::open("droid_geometry.npz");
    for parameters in CASES {
        let (name, _, _, iterations, ..) = parameters;
        let case = Case::load(&mut archive, parameters);
        let edges = case.edges();
        let problem = case.problem(&edges);
        let key = |k: &str| format!("ba/{name}/{k}");

        let full = normal_equations(&case.scene, &problem, &case.options).unwrap();
        let motion = BundleOptions {
            motion_only: true,
            ..case.options
        };
        let poses_only = normal_equations(&case.scene, &problem, &motion).unwrap();
        let mut check = |k: &str, found: &mut dyn Iterator<Item = f64>, tolerance: f64| {
            let error = worst(found, &archive.f64(&key(k)));
            assert!(error < tolerance, "{name} {k}: {error:e}");
        };
        // Sums of some thousand terms.
        check("lin1_A", &mut poses_only.matrix.iter().copied(), 1e-12);
        check("lin1_b", &mut poses_only.rhs.iter().copied(), 1e-12);
        check("lin1_S", &mut full.matrix.iter().copied(), 1e-11);
        check("lin1_g", &mut full.rhs.iter().copied(), 1e-11);
        let rows = |values: &[f64]| -> Vec<f64> {
            case.sources()
                .iter()
                .flat_map(|f| values[f * CELLS..(f + 1) * CELLS].to_vec())
                .collect()
        };
        if !case.options.motion_only {
            check("lin1_w", &mut rows(&full.depth_rhs).into_iter(), 1e-12);
            check("lin1_C", &mut rows(&full.depth_diagonal).into_iter(), 1e-12);
        }

        let mut scene = case.scene.clone();
        let mut workspace = Workspace::default();
        for n in 1..=iterations {
            let report = adjust(&mut scene, &problem, &case.options, &mut workspace).unwrap();
            assert_eq!((report.iterations, report.pose_steps_dropped), (1, 0));
            // The condition of the damped systems is up to 1e4 and errors accumulate over steps; the
            // reference's short cut for small angles (see above) is worth up to 5e-5 of a step there.
            let tolerance = 1e-8;
            check(
                &format!("dx{n}"),
                &mut workspace.pose_step().iter().copied(),
                tolerance,
            );
            check(
                &format!("poses_after{n}"),
                &mut scene.poses.iter().flat_map(|p| p.to_array()),
                tolerance,
            );
            check(
                &format!("disps_after{n}"),
                &mut scene.inverse_depths.iter().copied(),
                tolerance,
            );
            if !case.options.motion_only {
                check(
                    &format!("dz{n}"),
                    &mut rows(&workspace.depth_step()).into_iter(),
                    tolerance,
                );
            }
        }
    }
}

/// Σ w ‖r‖² at `scene`, over the observations where `counts`, by the plain projection; and which
/// observations lie in front of the camera.
fn plain_cost(case: &Case, scene: &Scene, counts: Option<&[bool]>) -> (f64, Vec<bool>) {
    let rule = DepthRule {
        valid_above: case.options.min_depth,
        unit_below: case.options.min_depth,
    };
    let (mut cost, mut valid) = (0.0, Vec::new());
    for edge in case.edges() {
        let relative = scene.poses[edge.target].relative_to(&scene.poses[edge.source]);
        for cell in 0..CELLS {
            let at = [(cell % 16) as f64, (cell / 16) as f64];
            let d = scene.inverse_depths_of(edge.source)[cell];
            let r = reproject(&scene.camera, &relative, at, d, rule);
            if counts.is_none_or(|c| c[valid.len()]) {
                for axis in 0..2 {
                    let residual = f64::from(edge.at[axis * CELLS + cell]) - r.at[axis];
                    cost += f64::from(edge.weight[axis * CELLS + cell]) * residual * residual;
                }
            }
            valid.push(r.valid);
        }
    }
    let known = |m: &&f32| **m > 0.0;
    if case.measured.iter().any(|m| known(&m)) {
        // The prior's weight is given against weights scaled by 0.001.
        for (m, d) in case
            .measured
            .iter()
            .zip(&scene.inverse_depths)
            .filter(|(m, _)| known(m))
        {
            cost += 0.05 / 0.001 * (d - f64::from(*m)).powi(2);
        }
    }
    (cost, valid)
}

#[test]
fn the_clean_solver_reaches_a_lower_cost_on_every_scene() {
    let mut archive = Archive::open("droid_geometry.npz");
    for parameters in CASES {
        let (name, _, _, iterations, ..) = parameters;
        let case = Case::load(&mut archive, parameters);
        let edges = case.edges();
        let problem = case.problem(&edges);
        let run = |options: BundleOptions| {
            let mut scene = case.scene.clone();
            let options = BundleOptions {
                iterations,
                ..options
            };
            let report = adjust(&mut scene, &problem, &options, &mut Workspace::default()).unwrap();
            (scene, report)
        };
        let (reference, _) = run(case.options);
        // As many steps, the same weights, squares and the same nearest depth; the reference's quirks,
        // its absolute damping and its eta are off.
        let clean_problem = Problem {
            depth_damping: None,
            ..problem.clone()
        };
        let clean_options = BundleOptions {
            iterations,
            weight_scale: case.options.weight_scale,
            min_depth: case.options.min_depth,
            motion_only: case.options.motion_only,
            huber_cells: None,
            ..BundleOptions::default()
        };
        let mut clean = case.scene.clone();
        let report = adjust(
            &mut clean,
            &clean_problem,
            &clean_options,
            &mut Workspace::default(),
        )
        .unwrap();
        // One fixed set for both: what lies in front of the camera at the start and at both ends.
        let sets = [&case.scene, &reference, &clean].map(|scene| plain_cost(&case, scene, None).1);
        let common: Vec<bool> = (0..sets[0].len())
            .map(|k| sets.iter().all(|s| s[k]))
            .collect();
        let cost = |scene: &Scene| plain_cost(&case, scene, Some(&common)).0;
        let (start, reference, clean) = (cost(&case.scene), cost(&reference), cost(&clean));
        let counted = common.iter().filter(|c| **c).count();
        println!(
            "{name}: {counted} cells of {}: start {start:.4}, reference {reference:.4}, clean {clean:.4} {report:?}",
            common.len()
        );
        assert!(clean <= reference, "{name}: {clean} > {reference}");
    }
}
