//! The whole reduce: a corpus worked out by hand, the extremes of design section 11, and the promise
//! that the order of the input does not matter.

use proptest::prelude::*;

use super::*;

fn bins(n: u16) -> NonZeroU16 {
    NonZeroU16::new(n).unwrap()
}

fn options(recipe: Recipe, n: u16, keep: &str) -> ReduceOptions {
    ReduceOptions {
        recipe,
        bins: bins(n),
        range: Range::Full,
        keep: keep.parse().unwrap(),
        profile_digest: "digest".to_owned(),
        normalise_within: NormaliseWithin::Corpus,
        reference: None,
    }
}

fn video(name: &str, values: [Option<f64>; 4]) -> MeasuredVideo {
    let mut measurement = Measurement::without_score(Status::Scored, "");
    measurement.status_reason = None;
    [
        measurement.reproj_px,
        measurement.aepe_worldscore_px,
        measurement.piecewise_residual,
        measurement.appearance_ratio,
    ] = values;
    MeasuredVideo {
        video: VideoId::new(name).unwrap(),
        group: None,
        carried: Map::new(),
        measurement,
    }
}

fn corpus() -> Vec<MeasuredVideo> {
    let s = Some;
    vec![
        video("a", [s(0.0), s(1.0), s(0.0), None]),
        video("b", [s(0.0), s(1.0), s(1.0), s(2.0)]),
        video("c", [s(0.0), s(3.0), s(2.0), s(4.0)]),
        video("d", [s(4.0), s(3.0), s(3.0), s(6.0)]),
    ]
}

/// s_3 = 0 0 0 4: μ = 1, σ = √3, two bins count 3 and 1, H = ln 4 − ¾ ln 3, e^−H = 3^¾/4.
/// s_p = 1 1 3 3: μ = 2, σ = 1, two bins count 2 and 2, H = ln 2, e^−H = 1/2.
/// w_3 = 3^¾/(3^¾ + 2), w_p = 2/(3^¾ + 2).
/// S = −w_3/√3 − w_p (a and b: the tie goes to a), −w_3/√3 + w_p, √3 w_3 + w_p.
#[test]
fn paper_recipe_by_hand() {
    let found = reduce(corpus(), &options(Recipe::Paper, 2, "50%"));
    let k = 3_f64.powf(0.75);
    let (w3, wp) = (k / (k + 2.0), 2.0 / (k + 2.0));
    let root = 3_f64.sqrt();
    let expected = [
        -w3 / root - wp,
        -w3 / root - wp,
        -w3 / root + wp,
        root * w3 + wp,
    ];
    for (row, expected) in found.rows.iter().zip(expected) {
        // Each of some ten operations rounds by 1.1e-16 of about 1.
        assert!(
            (row.anomaly.unwrap() - expected).abs() < 1e-15,
            "{}",
            row.video
        );
        assert_eq!(row.reward, row.anomaly.map(|s| -s));
    }
    let weights = &found.statistics.corpus.weights;
    assert!((weights["reproj_px"] - w3).abs() < 1e-15);
    assert!((weights["aepe_worldscore_px"] - wp).abs() < 1e-15);
    let s3 = &found.statistics.corpus.signals["reproj_px"];
    assert_eq!(
        (s3.mean, s3.std, s3.median),
        (Some(1.0), Some(root), Some(0.0))
    );
    assert_eq!(
        (s3.edges.as_slice(), s3.counts.as_slice()),
        (&[0.0, 2.0, 4.0][..], &[3, 1][..])
    );
    let ranks: Vec<_> = found.rows.iter().map(|row| row.rank).collect();
    assert_eq!(ranks, [Some(1), Some(2), Some(3), Some(4)]);
    assert_eq!(found.rows[3].percentile, Some(87.5));
    use Decision::{Drop, Keep};
    assert_eq!(
        found.rows.iter().map(|r| r.decision).collect::<Vec<_>>(),
        [Keep, Keep, Drop, Drop]
    );
    assert_eq!(found.statistics.decisions["keep"], 2);
    assert_eq!(found.statistics.statuses.len(), Status::ALL.len());
    // Without d, s_3 is constant and weighs nothing: the weights change by w_3 = .53, most of all rows.
    let sensitivity = found.statistics.sensitivity.unwrap();
    assert_eq!(sensitivity.leave_one_out_video.as_deref(), Some("d"));
    assert!((sensitivity.leave_one_out_max_change - w3).abs() < 1e-15);
    assert!(
        found
            .statistics
            .warnings
            .iter()
            .any(|w| w.contains("fragile: without d"))
    );
    // Rewards: r = −S has mean 0, and a, b share the same soft weight above one half.
    assert_eq!(found.rewards.len(), 4);
    assert_eq!(found.rewards[0].soft, found.rewards[1].soft);
    assert!(found.rewards[0].soft > 0.5 && found.rewards[3].soft < 0.5);
}

/// P = 0 1 2 3: median 3/2, MAD 1, z = −3/2 −1/2 1/2 3/2. T = – 2 4 6: median 4, MAD 2, z = – −1 0 1.
/// Their family: −3/2 −3/4 1/4 5/4. accs = P alone makes the other family; each row's score is the
/// mean of the two.
#[test]
fn balanced_recipe_by_hand() {
    let mut videos = corpus();
    for video in &mut videos {
        video.measurement.layer_acceleration_q25 = video.measurement.piecewise_residual;
    }
    let found = reduce(videos, &options(Recipe::Balanced, 2, "s<=0"));
    let scores: Vec<_> = found.rows.iter().map(|row| row.anomaly).collect();
    assert_eq!(scores, [Some(-1.5), Some(-0.625), Some(0.375), Some(1.375)]);
    assert_eq!(found.rows[3].z_layer_acceleration_q25, Some(1.5));
    assert_eq!(found.rows[0].z_appearance_ratio, None);
    assert_eq!(found.rows[1].z_aepe_worldscore_px, Some(-1.0));
    assert!(
        found
            .statistics
            .warnings
            .iter()
            .any(|w| w.starts_with("4 rows lack a signal"))
    );
    use Decision::{Drop, Keep};
    assert_eq!(
        found.rows.iter().map(|r| r.decision).collect::<Vec<_>>(),
        [Keep, Keep, Drop, Drop]
    );
}

#[test]
fn groups_are_selected_and_normalised_on_their_own() {
    let mut videos = corpus();
    for (video, group) in videos.iter_mut().zip(["x", "x", "y", "y"]) {
        video.group = Some(group.to_owned());
    }
    let mut o = options(Recipe::Paper, 2, "1");
    let found = reduce(videos.clone(), &o);
    let kept = |found: &Reduced| -> Vec<String> {
        let kept = found
            .rows
            .iter()
            .filter(|row| row.decision == Decision::Keep);
        kept.map(|row| row.video.to_string()).collect()
    };
    assert_eq!(kept(&found), ["a", "c"]);
    assert_eq!(found.statistics.groups["x"].n, 2);
    assert_eq!(found.rows[3].z_aepe_worldscore_px, Some(1.0));
    // Within y, s_p is constant and s_3 = 0 4: z = −1, 1. Within x both are constant: scores 0.
    o.normalise_within = NormaliseWithin::Group;
    let found = reduce(videos, &o);
    let scores: Vec<_> = found.rows.iter().map(|row| row.anomaly).collect();
    assert_eq!(scores, [Some(0.0), Some(0.0), Some(-1.0), Some(1.0)]);
    assert!(
        found
            .statistics
            .warnings
            .iter()
            .any(|w| w.contains("group x apart"))
    );
}

#[test]
fn rows_without_a_score_go_to_review() {
    let mut videos = corpus();
    videos[0].measurement.reproj_px = Some(f64::NAN);
    videos[1].measurement.status = Status::Static;
    videos.push(video("e", [None, None, Some(1.0), Some(1.0)]));
    let found = reduce(videos, &options(Recipe::Paper, 2, "100%"));
    let review = |i: usize| {
        let row = &found.rows[i];
        row.anomaly.is_none() && row.rank.is_none() && row.decision == Decision::Review
    };
    assert!(review(0) && review(1) && review(4));
    assert_eq!(found.statistics.statuses["failed"], 1);
    // c and d (and e, which lacks both signals): static and failed rows keep raw values only.
    assert_eq!(found.statistics.corpus.n, 3);
    assert_eq!(found.statistics.corpus.signals["reproj_px"].n, 2);
    assert_eq!(
        (found.rows[1].measured.reproj_px, found.rows[1].z_reproj_px),
        (Some(0.0), None)
    );
    assert_eq!(found.rewards.len(), 2);
    assert!(
        found
            .statistics
            .warnings
            .iter()
            .any(|w| w.starts_with("1 measurements held"))
    );
}

#[test]
fn an_outlier_makes_the_weights_fragile() {
    // s_p even over 40 values, s_3 the same but for one outlier, which empties all bins but two.
    let mut videos: Vec<MeasuredVideo> = (0..40)
        .map(|i| {
            video(
                &format!("v{i:02}"),
                [Some(f64::from(i)), Some(f64::from(i)), None, None],
            )
        })
        .collect();
    videos[7].measurement.reproj_px = Some(1e300);
    let found = reduce(videos, &options(Recipe::Paper, 30, "10"));
    let sensitivity = found.statistics.sensitivity.unwrap();
    assert_eq!(sensitivity.leave_one_out_video.as_deref(), Some("v07"));
    assert!(sensitivity.leave_one_out_max_change > 0.4);
    assert!(
        found
            .rows
            .iter()
            .all(|row| row.anomaly.is_some_and(f64::is_finite))
    );
    assert_eq!(found.statistics.decisions["keep"], 10);
}

/// Quantiles of Weibull distributions: s_p has entropy 2.76 and weight .47. One outlier among 400
/// rows, 2.7 times the largest of the others, widens the bins: entropy 1.36, weight .78 (evidence.md
/// section 3). Every other look at the weights says so, and the winsorised range undoes it.
#[test]
fn one_outlier_moves_a_weight_from_47_to_78() {
    const N: u32 = 400;
    let weibull = |i: u32, power: f64| {
        let q = (f64::from(i) + 0.5) / f64::from(N);
        libm::pow(-libm::log1p(-q), power)
    };
    let videos = |outlier: Option<f64>| -> Vec<MeasuredVideo> {
        (0..N)
            .map(|i| {
                let aepe = outlier
                    .filter(|_| i == N - 1)
                    .unwrap_or_else(|| weibull(i, 0.8));
                video(
                    &format!("v{i:03}"),
                    [Some(weibull(i * 7 % N, 0.9)), Some(aepe), None, None],
                )
            })
            .collect()
    };
    let run = |outlier, range| {
        let mut o = options(Recipe::Paper, 30, "50%");
        o.range = range;
        reduce(videos(outlier), &o).statistics
    };
    let weight = |s: &outcome::CorpusStatistics| s.corpus.weights["aepe_worldscore_px"];

    let before = run(None, Range::Full);
    assert!((weight(&before) - 0.47).abs() < 0.005);
    assert!(
        !before
            .warnings
            .iter()
            .any(|w| w.contains("fragile: without")),
        "{:?}",
        before.warnings
    );
    let with = run(Some(18.7), Range::Full);
    assert!((weight(&with) - 0.78).abs() < 0.005, "{}", weight(&with));
    let entropy = with.corpus.signals["aepe_worldscore_px"]
        .entropy_nats
        .unwrap();
    assert!((entropy - 1.36).abs() < 0.03, "{entropy}");
    let sensitivity = with.sensitivity.as_ref().unwrap();
    assert_eq!(sensitivity.leave_one_out_video.as_deref(), Some("v399"));
    assert!(
        (sensitivity.leave_one_out_max_change - (weight(&with) - weight(&before))).abs() < 0.05
    );
    assert!((sensitivity.winsorised["aepe_worldscore_px"] - weight(&before)).abs() < 0.05);
    assert!(sensitivity.freedman_diaconis_bins["aepe_worldscore_px"] > 60);
    for how in [
        "fragile: without v399",
        "fragile: with the winsorised range",
    ] {
        assert!(
            with.warnings.iter().any(|w| w.contains(how)),
            "{how}: {:?}",
            with.warnings
        );
    }

    let cured = run(Some(18.7), Range::Winsorised);
    let clean = run(None, Range::Winsorised);
    assert!(
        (weight(&cured) - weight(&clean)).abs() < 0.01,
        "{} {}",
        weight(&cured),
        weight(&clean)
    );
    assert!(
        !cured
            .warnings
            .iter()
            .any(|w| w.contains("fragile: without")),
        "{:?}",
        cured.warnings
    );
}

#[test]
fn degenerate_cases_have_a_type() {
    let s =
        |videos: Vec<MeasuredVideo>| reduce(videos, &options(Recipe::Paper, 30, "50%")).statistics;
    let two = s(corpus()[..2].to_vec());
    assert!(two.corpus.too_few && two.degenerate);
    assert!(two.corpus.signals["reproj_px"].degenerate);
    let four = s(corpus());
    assert!(!four.corpus.too_few && !four.degenerate && four.uncertain_decisions.is_none());
    let mut wide = corpus();
    wide[0].measurement.reproj_px = Some(-f64::MAX);
    wide[1].measurement.reproj_px = Some(f64::MAX);
    let wide = s(wide);
    assert!(wide.corpus.signals["reproj_px"].range_overflow);
    assert!(!wide.corpus.signals["aepe_worldscore_px"].range_overflow);
    assert!(
        wide.warnings
            .iter()
            .any(|w| w.contains("more than the largest float"))
    );
    assert!(!s(Vec::new()).degenerate && s(Vec::new()).corpus.too_few);
}

/// Expected of each: nothing that is not finite in any output, and weights that sum to 1 or are empty.
#[test]
fn extremes() {
    let corpora: [&[f64]; 12] = [
        &[],
        &[1.0],
        &[1.0, 2.0],
        &[3.0; 5],
        &[1.0, 1.0, 1.0, 2.0, 2.0],
        &[1.0, 2.0, 3.0, 1e300],
        &[0.0, 5e-324, 1e-320, 3e-310],
        &[0.0, 5e-324],
        &[-f64::MAX, f64::MAX, 0.0, 1.0],
        &[f64::MAX, f64::MAX, f64::MAX, -f64::MAX],
        &[1e15, 1e15 + 0.125, 1e15 + 0.25, 1e15 + 1.0],
        &[-0.0, 0.0, 0.0],
    ];
    for values in corpora {
        for recipe in [Recipe::Paper, Recipe::Balanced] {
            for n in [1, 2, 30] {
                for range in [Range::Full, Range::Winsorised] {
                    let videos: Vec<MeasuredVideo> = values
                        .iter()
                        .enumerate()
                        .map(|(i, &v)| {
                            video(&format!("v{i}"), [Some(v), Some(-v), Some(v), Some(-v)])
                        })
                        .collect();
                    let mut o = options(recipe, n, "50%");
                    o.range = range;
                    let found = reduce(videos, &o);
                    let all_equal = values.iter().all(|&v| v == values[0]);
                    for row in &found.rows {
                        let score = row.anomaly.unwrap();
                        assert!(score.is_finite());
                        assert!(!all_equal || score.to_bits() == 0);
                    }
                    let weights = &found.statistics.corpus.weights;
                    let sum: f64 = weights.values().sum();
                    assert!(weights.is_empty() || (sum - 1.0).abs() < 1e-15);
                    assert_eq!(weights.is_empty(), all_equal || values == [0.0, 5e-324]);
                    assert_eq!(
                        found.statistics.decisions["keep"],
                        (values.len() as u64).div_ceil(2)
                    );
                    assert_eq!(found.statistics.sensitivity.is_some(), values.len() >= 3);
                    assert!(values.len() >= 3 || !found.statistics.warnings.is_empty());
                    for signal in found.statistics.corpus.signals.values() {
                        let numbers = [
                            signal.min,
                            signal.max,
                            signal.mean,
                            signal.std,
                            signal.median,
                            signal.mad,
                        ];
                        assert!(
                            numbers
                                .iter()
                                .flatten()
                                .chain(&signal.edges)
                                .all(|v| v.is_finite())
                        );
                        assert_eq!(signal.counts.iter().sum::<u64>(), signal.n);
                    }
                }
            }
        }
    }
}

#[test]
fn intervals_stand_around_scores() {
    let mut videos = corpus();
    for v in &mut videos {
        let (reproj, aepe) = (
            v.measurement.reproj_px.unwrap(),
            v.measurement.aepe_worldscore_px.unwrap(),
        );
        let around = |mean: f64| {
            (0..20)
                .map(|i| Some(mean + if i % 4 < 2 { 0.5 } else { -0.5 }))
                .collect()
        };
        v.measurement.series.reproj_px = around(reproj);
        v.measurement.series.reproj_cells = vec![10; 20];
        v.measurement.series.aepe_worldscore_px = around(aepe);
    }
    let found = reduce(videos.clone(), &options(Recipe::Paper, 2, "50%"));
    for row in &found.rows {
        let (lo, s, hi) = (
            row.anomaly_lo.unwrap(),
            row.anomaly.unwrap(),
            row.anomaly_hi.unwrap(),
        );
        assert!(lo < s && s < hi && hi - lo < 2.0);
    }
    // P and T have no series.
    let found = reduce(videos, &options(Recipe::Balanced, 2, "50%"));
    assert!(
        found
            .rows
            .iter()
            .all(|row| row.anomaly_lo.is_none() && row.anomaly_hi.is_none())
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Bit for bit: rows, statistics and rewards, compared as their exact JSON.
    #[test]
    fn order_does_not_matter(
        values in prop::collection::vec(prop::array::uniform4(prop::option::weighted(0.9, -1e3_f64..1e3)), 0..25),
        seed in any::<u64>(),
        balanced in any::<bool>(),
    ) {
        let mut videos: Vec<MeasuredVideo> = values
            .into_iter()
            .enumerate()
            .map(|(i, values)| {
                let mut v = video(&format!("v{i}"), values);
                v.group = [None, Some("x".to_owned()), Some("y".to_owned())][i % 3].clone();
                v.measurement.series.aepe_worldscore_px = (0..9).map(|k| Some(f64::from(k))).collect();
                v
            })
            .collect();
        let o = options(if balanced { Recipe::Balanced } else { Recipe::Paper }, 30, "30%");
        let text = |found: &Reduced| {
            serde_json::to_string(&(&found.rows, &found.statistics, &found.rewards)).unwrap()
        };
        let before = reduce(videos.clone(), &o);
        let mut state = seed;
        for i in (1..videos.len()).rev() {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            videos.swap(i, (state >> 33) as usize % (i + 1));
        }
        let after = reduce(videos, &o);
        prop_assert_eq!(text(&before), text(&after));
        prop_assert_eq!(before, after);
    }
}
