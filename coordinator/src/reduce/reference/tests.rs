//! Scores against a reference: those of the corpus where it is its own reference, those of a video by
//! itself, and finite however far out a value lies.

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, Measurement, Row, Status};
use proptest::prelude::*;
use serde_json::Map;

use super::*;
use crate::reduce::drift::Verdict;
use crate::reduce::outcome::NormaliseWithin;
use crate::reduce::population::{in_memory, survey};
use crate::reduce::values::InMemory;
use crate::reduce::{MeasuredVideo, PAPER_BINS, reduce, score_final};

pub(crate) fn options(recipe: Recipe, keep: &str) -> ReduceOptions {
    ReduceOptions {
        recipe,
        bins: PAPER_BINS,
        range: Range::Full,
        keep: keep.parse().unwrap(),
        profile_digest: "d1ge57".to_owned(),
        normalise_within: NormaliseWithin::Corpus,
        reference: None,
    }
}

/// Freezes rows in memory, as `reduce_files::freeze` does rows in files.
pub(crate) fn freeze(videos: &[MeasuredVideo], options: &ReduceOptions) -> Frozen {
    let scored = videos
        .iter()
        .filter(|v| v.measurement.status == Status::Scored);
    let values: Vec<_> = scored
        .map(|video| BySignal::of(&video.measurement))
        .collect();
    let signals = in_memory(&values);
    let Ok(surveyed) = survey(values.len() as u64, &signals, options.bins, options.range);
    let frozen = Frozen::freeze(&surveyed, &signals, options, &mut |recipe| {
        let of_recipe = ReduceOptions {
            recipe,
            ..options.clone()
        };
        let found = reduce(videos.to_vec(), &of_recipe);
        let anomalies: InMemory = found.rows.iter().filter_map(|row| row.anomaly).collect();
        let moments = crate::reduce::moments::Moments::of(
            &found.rewards.iter().map(|r| r.raw).collect::<Vec<_>>(),
        );
        Ok::<_, std::convert::Infallible>((anomalies, moments.unwrap().standard()))
    });
    let Ok(frozen) = frozen;
    frozen
}

pub(crate) fn against(reference: &Frozen, options: &ReduceOptions) -> ReduceOptions {
    let reference = Reference::new(reference.clone(), "ref".to_owned()).unwrap();
    ReduceOptions {
        reference: Some(std::sync::Arc::new(reference)),
        ..options.clone()
    }
}

/// Rows by four signals each, NaN for a missing one.
fn videos(rows: &[[f64; 4]]) -> Vec<MeasuredVideo> {
    let video = |(k, values): (usize, &[f64; 4])| {
        let mut m = Measurement::without_score(Status::Scored, "");
        m.status_reason = None;
        let [a, b, c, d] = values.map(|value| Some(value).filter(|value| !value.is_nan()));
        (m.reproj_px, m.aepe_worldscore_px) = (a, b);
        (m.piecewise_residual, m.appearance_ratio) = (c, d);
        MeasuredVideo {
            video: VideoId::new(format!("v{k:03}")).unwrap(),
            group: None,
            carried: Map::new(),
            measurement: m,
        }
    };
    rows.iter().enumerate().map(video).collect()
}

fn z_of(row: &Row) -> [Option<f64>; 5] {
    [
        row.z_reproj_px,
        row.z_aepe_worldscore_px,
        row.z_piecewise_residual,
        row.z_appearance_ratio,
        row.anomaly,
    ]
}

fn rows() -> impl Strategy<Value = Vec<[f64; 4]>> {
    let value = prop_oneof![9 => -1e3_f64..1e3, 1 => Just(f64::NAN)];
    prop::collection::vec([value.clone(), value.clone(), value.clone(), value], 3..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Through JSON and back, a corpus' own reference gives what the corpus gives by itself.
    #[test]
    fn a_corpus_is_its_own_reference(rows in rows(), paper in any::<bool>()) {
        let recipe = if paper { Recipe::Paper } else { Recipe::Balanced };
        let o = options(recipe, "50%");
        let videos = videos(&rows);
        let frozen = freeze(&videos, &o);
        prop_assume!(frozen.scores.contains_key(recipe_name(recipe)));
        let text = serde_json::to_string(&frozen).unwrap();
        let back: Frozen = serde_json::from_str(&text).unwrap();
        prop_assert_eq!(&frozen, &back);
        let alone = reduce(videos.clone(), &o);
        let found = reduce(videos, &against(&back, &o));
        for (a, b) in alone.rows.iter().zip(&found.rows) {
            prop_assert_eq!(z_of(a), z_of(b));
            prop_assert_eq!((a.rank, a.decision), (b.rank, b.decision));
        }
        let soft = |rewards: &[crate::reduce::rewards::Reward]| -> Vec<(f64, f64)> {
            rewards.iter().map(|r| (r.raw, r.soft)).collect()
        };
        prop_assert_eq!(soft(&alone.rewards), soft(&found.rewards));
        // Robust z are clipped, so that scores may tie; those of distinct scores are the same.
        let mut anomalies: Vec<f64> = alone.rows.iter().filter_map(|r| r.anomaly).collect();
        anomalies.sort_unstable_by(f64::total_cmp);
        if anomalies.windows(2).all(|pair| pair[0] < pair[1]) {
            for (a, b) in alone.rows.iter().zip(&found.rows) {
                prop_assert_eq!(a.percentile, b.percentile);
            }
            prop_assert_eq!(alone.rewards, found.rewards);
        }
    }

    /// A row by itself is what it is in any corpus.
    #[test]
    fn rows_are_final(reference in rows(), corpus in rows(), paper in any::<bool>()) {
        let recipe = if paper { Recipe::Paper } else { Recipe::Balanced };
        let o = options(recipe, "s<=0.2");
        let frozen = freeze(&videos(&reference), &o);
        prop_assume!(frozen.scores.contains_key(recipe_name(recipe)));
        let o = against(&frozen, &o);
        let corpus = videos(&corpus);
        let all = reduce(corpus.clone(), &o);
        for (row, video) in all.rows.iter().zip(corpus) {
            let one = score_final(video.clone(), o.reference.as_deref().unwrap(), &o);
            prop_assert_eq!(&Row { rank: None, ..row.clone() }, &one);
            let single = reduce(vec![video], &o);
            prop_assert_eq!(Row { rank: None, ..single.rows[0].clone() }, one);
        }
    }
}

fn even(n: usize, from: f64) -> Vec<[f64; 4]> {
    let value = |i: usize, k: usize| from + ((i * (7 + 6 * k)) % n) as f64 / n as f64;
    (0..n).map(|i| [0, 1, 2, 3].map(|k| value(i, k))).collect()
}

#[test]
fn values_far_out_give_finite_scores() {
    let o = options(Recipe::Paper, "1");
    let narrow: Vec<[f64; 4]> = even(9, 0.0)
        .into_iter()
        .map(|row| row.map(|v| v * 1e-300))
        .collect();
    let o = against(&freeze(&videos(&narrow), &o), &o);
    let found = reduce(
        videos(&[
            [f64::MAX; 4],
            [-f64::MAX; 4],
            [f64::MAX, -f64::MAX, 0.0, 0.0],
        ]),
        &o,
    );
    for (row, reward) in found.rows.iter().zip(&found.rewards) {
        assert!(
            z_of(row).into_iter().flatten().all(f64::is_finite),
            "{row:?}"
        );
        assert!((0.0..=1.0).contains(&reward.soft) && (0.0..=1.0).contains(&reward.percentile));
    }
    assert_eq!(found.rows[0].percentile, Some(100.0));
    // One of three lies below all, two above.
    let reference = found.statistics.reference.unwrap();
    assert_eq!(reference.drift["reproj_px"].ks, Some(1.0 - 1.0 / 3.0));
}

#[test]
fn shifts_are_told_and_few_rows_are_not_judged() {
    let o = options(Recipe::Balanced, "1");
    let frozen = freeze(&videos(&even(500, 0.0)), &o);
    let o = against(&frozen, &o);
    let compared = |rows: Vec<[f64; 4]>| {
        let statistics = reduce(videos(&rows), &o).statistics;
        let drift = statistics.reference.unwrap().drift["piecewise_residual"];
        (drift, statistics.warnings.join("\n"))
    };
    let (same, warnings) = compared(even(300, 0.0));
    assert_eq!(
        (same.verdict, warnings.contains("moved")),
        (Verdict::Stable, false)
    );
    let (moved, warnings) = compared(even(300, 0.4));
    assert_eq!(moved.verdict, Verdict::Major);
    assert!(
        warnings.contains("piecewise_residual has moved far"),
        "{warnings}"
    );
    // Forty rows: too few for the index, but a distance of .6 is no chance.
    let (few, warnings) = compared(even(40, 0.6));
    assert!(few.psi_by_chance.unwrap() > 0.25 && few.verdict == Verdict::Major);
    assert!(warnings.contains("Kolmogorov"), "{warnings}");
    let (one, warnings) = compared(even(1, 0.6));
    assert_eq!((one.verdict, one.n, one.ks_p), (Verdict::TooFew, 1, None));
    assert!(
        warnings.contains("with 1 rows against 500 it cannot be judged"),
        "{warnings}"
    );
    assert!(!warnings.contains("too few for scores"), "{warnings}");
    let (none, _) = compared(vec![]);
    assert_eq!(
        (none.psi, none.ks, none.verdict),
        (None, None, Verdict::TooFew)
    );
}

#[test]
fn decisions_by_threshold_are_final_and_others_are_not() {
    let o = options(Recipe::Balanced, "s<=0");
    let frozen = freeze(&videos(&even(50, 0.0)), &o);
    let video = videos(&even(1, -3.0)).remove(0);
    let one = |keep: &str| {
        let o = against(&frozen, &options(Recipe::Balanced, keep));
        score_final(video.clone(), o.reference.as_deref().unwrap(), &o).decision
    };
    assert_eq!(
        (one("s<=0"), one("80%")),
        (Decision::Keep, Decision::Review)
    );
}

#[test]
fn statistics_that_make_no_sense_are_refused() {
    let frozen = freeze(&videos(&even(50, 0.0)), &options(Recipe::Paper, "1"));
    let refused = |change: &dyn Fn(&mut Frozen)| {
        let mut changed = frozen.clone();
        change(&mut changed);
        Reference::new(changed, String::new()).is_err()
    };
    assert!(!refused(&|_| {}));
    assert!(refused(&|f| {
        f.rulers.remove("reproj_px");
    }));
    assert!(refused(&|f| f
        .signals
        .get_mut("reproj_px")
        .unwrap()
        .at_most[3] = 0));
    assert!(refused(&|f| f.scores.get_mut("paper").unwrap().std = -1.0));
    assert!(refused(&|f| {
        f.population.weights.insert("reproj_px".to_owned(), 2.0);
    }));
    let absent = freeze(
        &videos(&[[f64::NAN, f64::NAN, 1.0, 2.0]; 4]),
        &options(Recipe::Paper, "1"),
    );
    let reference = Reference::new(absent, String::new()).unwrap();
    assert!(
        reference.scores(Recipe::Paper).is_none() && reference.scores(Recipe::Balanced).is_none()
    );
}
