//! The paper's equations, recomputed by hand from what a run publishes (design, section 8).

use plumbline_tests::published::{Row, number};
use plumbline_tests::run::Place;
use serde_json::Value;

/// Our arithmetic here is plain, the program's is exact; with values and spreads of ordinary size
/// they differ by a few units in the last place, far below this.
const TOLERANCE: f64 = 1e-12;

const SIGNALS: [&str; 2] = ["aepe_worldscore_px", "reproj_px"];

/// The smallest corpus in which ranks, 80% and several bins mean something.
const VIDEOS: u64 = 11;

#[track_caller]
fn close(found: f64, expected: f64, what: &str) {
    assert!(
        (found - expected).abs() <= TOLERANCE * expected.abs().max(1.0),
        "{what}: {found}, by hand {expected}"
    );
}

fn floats(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|number| number.as_f64().unwrap())
        .collect()
}

/// H in nats of counts.
fn entropy(counts: &[f64]) -> f64 {
    let n: f64 = counts.iter().sum();
    let shares = counts
        .iter()
        .filter(|count| **count > 0.0)
        .map(|count| count / n);
    -shares.map(|p| p * p.ln()).sum::<f64>()
}

/// Mean and population standard deviation.
fn mean_and_std(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>()
        / n;
    (mean, variance.sqrt())
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    if sorted.len() % 2 == 1 {
        sorted[middle]
    } else {
        (sorted[middle - 1] + sorted[middle]) / 2.0
    }
}

fn column(rows: &[Row], name: &str) -> Vec<f64> {
    rows.iter().map(|row| number(row, name)).collect()
}

#[test]
fn the_paper_recipe_can_be_recomputed_from_the_published_columns() {
    let place = Place::with_clips(VIDEOS);
    place.run("out", &["--recipe", "paper"]).expect_code(0);
    let published = place.published("out");
    let (rows, corpus) = (published.rows(), published.corpus());
    assert_eq!(corpus["recipe"], "paper");

    let mut entropies = Vec::new();
    for name in SIGNALS {
        let statistics = &corpus["corpus"]["signals"][name];
        let values = column(&rows, name);
        let (mean, std) = mean_and_std(&values);
        close(statistics["mean"].as_f64().unwrap(), mean, name);
        close(statistics["std"].as_f64().unwrap(), std, name);
        for row in &rows {
            close(
                number(row, &format!("z_{name}")),
                (number(row, name) - mean) / std,
                name,
            );
        }

        let (edges, counts) = (floats(&statistics["edges"]), floats(&statistics["counts"]));
        assert_eq!(
            (edges.len(), counts.len(), &corpus["bins"]),
            (31, 30, &30.into())
        );
        let (least, most) = (
            values.iter().copied().fold(f64::MAX, f64::min),
            values.iter().copied().fold(f64::MIN, f64::max),
        );
        for (i, edge) in edges.iter().enumerate() {
            close(*edge, least + i as f64 * (most - least) / 30.0, "an edge");
        }
        // Bin i holds edge i ≤ x < edge i+1; the last one its upper edge too.
        let mut recounted = [0.0; 30];
        for value in &values {
            let bin = edges[1..30].iter().filter(|edge| *edge <= value).count();
            recounted[bin] += 1.0;
        }
        assert_eq!(counts, recounted, "{name}");
        close(
            statistics["entropy_nats"].as_f64().unwrap(),
            entropy(&counts),
            name,
        );
        entropies.push(entropy(&counts));
    }

    let powers: Vec<f64> = entropies.iter().map(|h| (-h).exp()).collect();
    let weights: Vec<f64> = powers
        .iter()
        .map(|power| power / powers.iter().sum::<f64>())
        .collect();
    for (name, weight) in SIGNALS.iter().zip(&weights) {
        close(
            corpus["corpus"]["weights"][name].as_f64().unwrap(),
            *weight,
            name,
        );
    }
    for row in &rows {
        let by_hand: f64 = SIGNALS
            .iter()
            .zip(&weights)
            .map(|(name, weight)| weight * number(row, &format!("z_{name}")))
            .sum();
        close(number(row, "anomaly"), by_hand, "anomaly");
        let (lo, hi) = (number(row, "anomaly_lo"), number(row, "anomaly_hi"));
        assert!(lo <= hi, "{lo} {hi}");
    }
    expect_ranks_and_rewards(&rows, &published.parquet("rewards.parquet"));
}

/// Rank 1 is the lowest score, ties by name; the best 80% are kept; rewards follow the score.
fn expect_ranks_and_rewards(rows: &[Row], rewards: &[Row]) {
    let mut order: Vec<&Row> = rows.iter().collect();
    order.sort_by(|a, b| number(a, "anomaly").total_cmp(&number(b, "anomaly")));
    let n = order.len() as f64;
    let kept = (0.8 * n).ceil() as usize;
    for (place, row) in order.iter().enumerate() {
        assert_eq!(row["rank"], place + 1);
        close(
            number(row, "percentile"),
            100.0 * (place as f64 + 0.5) / n,
            "percentile",
        );
        assert_eq!(row["decision"], if place < kept { "keep" } else { "drop" });
    }
    let raw: Vec<f64> = rows.iter().map(|row| -number(row, "anomaly")).collect();
    let (mean, std) = mean_and_std(&raw);
    for (reward, raw) in rewards.iter().zip(raw) {
        close(number(reward, "raw"), raw, "raw");
        let soft = (raw - (mean - 2.0 * std)) / (4.0 * std + 1e-12);
        close(number(reward, "soft"), soft.clamp(0.0, 1.0), "soft");
    }
}

#[test]
fn the_balanced_recipe_is_the_mean_of_robust_z() {
    let place = Place::with_clips(VIDEOS);
    place.run("out", &["--recipe", "balanced"]).expect_code(0);
    let published = place.published("out");
    let rows = published.rows();
    let families: [&[&str]; 2] = [
        &["piecewise_residual", "appearance_ratio"],
        &[
            "layer_acceleration_q25",
            "interior_shear",
            "detail_change_q25",
        ],
    ];
    let ruler = |name: &str| {
        let values: Vec<f64> = rows.iter().filter_map(|row| row[name].as_f64()).collect();
        if values.is_empty() {
            return None;
        }
        let centre = median(&values);
        let deviations: Vec<f64> = values.iter().map(|value| (value - centre).abs()).collect();
        let told = &published.corpus()["corpus"]["signals"][name];
        close(told["median"].as_f64().unwrap(), centre, name);
        close(told["mad"].as_f64().unwrap(), median(&deviations), name);
        Some((centre, median(&deviations)))
    };
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let mut judged = 0;
    for row in &rows {
        let mut scores = Vec::new();
        for family in families {
            let mut z = Vec::new();
            for name in family {
                let (Some(value), Some((centre, mad))) = (row[*name].as_f64(), ruler(name)) else {
                    continue;
                };
                if mad == 0.0 {
                    continue;
                }
                z.push(((value - centre) / mad).clamp(-3.0, 6.0));
                close(number(row, &format!("z_{name}")), z[z.len() - 1], name);
            }
            if !z.is_empty() {
                scores.push(mean(&z));
            }
        }
        if scores.is_empty() {
            assert!(
                row["anomaly"].is_null() && row["decision"] == "review",
                "{row:?}"
            );
        } else {
            close(number(row, "anomaly"), mean(&scores), "anomaly");
            judged += 1;
        }
    }
    assert!(
        judged >= VIDEOS / 2,
        "{judged} of {VIDEOS} have a score: too few to test anything"
    );
}
