//! Degenerate points and malformed input: typed results, never a panic or a NaN.

use rand_pcg::Pcg32;

use super::super::synthetic::{gauss, uniform};
use super::*;

#[test]
fn degenerate_points_are_judged_without_nonsense() {
    let list = |f: &dyn Fn(usize) -> [f64; 4]| {
        field(
            (0..100)
                .map(f)
                .map(|[a, b, c, d]| Correspondence {
                    from_px: [a, b],
                    to_px: [c, d],
                    weight: 1.0,
                })
                .collect(),
        )
    };
    let along = |i: usize| 2.0 * i as f64;
    let zero_motion = list(&|i| [along(i), (i * i % 37) as f64, along(i), (i * i % 37) as f64]);
    let cases = [
        ("all equal, still", list(&|_| [5.0; 4])),
        ("all equal, moving", list(&|_| [5.0, 5.0, 9.0, 5.0])),
        (
            "one source, many targets",
            list(&|i| [5.0, 5.0, along(i), 3.0]),
        ),
        (
            "many sources, one target",
            list(&|i| [along(i), (i % 7) as f64, 3.0, 3.0]),
        ),
        (
            "collinear, still",
            list(&|i| [along(i), 0.0, along(i), 0.0]),
        ),
        (
            "collinear, moving",
            list(&|i| [along(i), along(i), along(i) + 3.0, along(i) - 3.0]),
        ),
        ("at the limit", list(&|i| [1e6, -1e6 + along(i), -1e6, 1e6])),
        (
            "mirrored",
            list(&|i| [along(i), (i % 9) as f64, -along(i), (i % 9) as f64]),
        ),
    ];
    for (name, points) in cases {
        let clip = clip_of(fit_all(), points);
        assert_finite(&clip);
        if name.ends_with("still") {
            assert_eq!(
                (clip.scene, clip.residual_px),
                (SceneKind::StaticCamera, 0.0),
                "{name}"
            );
        }
    }
    let clip = clip_of(fit_all(), zero_motion);
    assert_eq!(clip.scene, SceneKind::StaticCamera);
    for model in [MotionModel::Homography, MotionModel::Rigid] {
        let fit = clip.edges[0].fit(model).unwrap();
        assert!(fit.inherited && fit.residual_px < 1e-9, "{model:?}");
    }
}

#[test]
fn bad_input_is_a_typed_error() {
    let mut solver = TwoViewSolver::new(TwoViewParams {
        min_cells: 8,
        ..TwoViewParams::default()
    })
    .unwrap();
    let mut rng = Pcg32::new(1, 1);
    let mut points = |n: usize| {
        field(
            (0..n)
                .map(|_| Correspondence {
                    from_px: [uniform(&mut rng), 1.0],
                    to_px: [gauss(&mut rng), 2.0],
                    weight: 1.0,
                })
                .collect(),
        )
    };
    let mut edge = |from_frame, to_frame, field| {
        solver.edge(EdgeInput {
            from_frame,
            to_frame,
            field,
        })
    };
    assert_eq!(
        edge(0, 1, points(7)),
        Err(SceneError::TooFewCells { have: 7, need: 8 })
    );
    assert_eq!(
        edge(0, 1, points(0)),
        Err(SceneError::TooFewCells { have: 0, need: 8 })
    );
    assert_eq!(
        edge(3, 3, points(9)),
        Err(SceneError::SelfEdge { frame: 3 })
    );
    for bad in [f64::NAN, f64::INFINITY, -1e7] {
        let mut field = points(9);
        field.correspondences[4].to_px[1] = bad;
        assert_eq!(edge(0, 1, field), Err(SceneError::Coordinate { index: 4 }));
    }
    let mut unequal = points(9);
    unequal.cells.pop();
    assert_eq!(edge(0, 1, unequal), Err(SceneError::Cells));
    assert_eq!(edge(0, 1, points(8)), Ok(()));
    let clip = solver.finish().unwrap();
    assert_eq!((clip.work.edges, clip.work.edges_rejected), (1, 2));
    assert_finite(&clip);

    let none = TwoViewSolver::new(TwoViewParams::default())
        .unwrap()
        .finish();
    assert_eq!(none, Err(SceneError::NoEdges));
    let few = TwoViewSolver::new(TwoViewParams {
        min_cells: 7,
        ..TwoViewParams::default()
    });
    assert_eq!(few.err(), Some(SceneError::Parameter { name: "min_cells" }));
}
