//! A synthetic corpus for looking at the page and for testing it: seeded, so always the same.

use std::collections::BTreeMap;

use plumbline_common::id::VideoId;
use plumbline_common::row::{Decision, GeometryMethod, Measurement, Row, Scene, Series, Status};
use serde_json::{Map, json};

use super::Thumbnails;
use crate::publish::{CorpusFile, ProfileRecord};
use crate::reduce::outcome::{
    CorpusStatistics, Population, Range, Recipe, SignalStatistics, WeightSensitivity,
};

/// SplitMix64.
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// About standard normal.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }
}

fn blank(video: &str) -> Row {
    Row {
        video: VideoId::new(video).unwrap(),
        group: None,
        carried: Map::new(),
        measured: Measurement::without_score(Status::Failed, "to be filled"),
        z_reproj_px: None,
        z_aepe_worldscore_px: None,
        z_piecewise_residual: None,
        z_appearance_ratio: None,
        z_layer_acceleration_q25: None,
        z_interior_shear: None,
        z_detail_change_q25: None,
        anomaly: None,
        anomaly_lo: None,
        anomaly_hi: None,
        rank: None,
        percentile: None,
        decision: Decision::Review,
        reward: None,
        recipe: "balanced".to_owned(),
        profile_digest: "5f3a9c1e7b".repeat(6),
        rung: None,
        flip_probability: None,
    }
}

/// A scored clip of 49 frames whose series jumps at its peak.
pub(crate) fn scored(video: &str, group: Option<&str>, bias: f64, dice: &mut Dice) -> Row {
    let motion = (1.2 + 0.9 * dice.normal() + bias).abs() + 0.15;
    let anomaly = bias + 0.8 * dice.normal() + 0.25 * motion;
    let peak = 9 + (dice.unit() * 38.0) as u32;
    let wave = |dice: &mut Dice, level: f64| -> Vec<Option<f64>> {
        let mut value = level;
        (2..49)
            .map(|frame| {
                value += 0.35 * (level - value) + 0.08 * level * dice.normal();
                let jump = if frame >= peak && frame < peak + 4 {
                    level * (1.0 + anomaly.max(0.0) * 0.6)
                } else {
                    0.0
                };
                (frame != 20).then_some((value + jump).abs())
            })
            .collect()
    };
    let level = 0.2 + 0.1 * motion;
    let series = Series {
        first_frame: 2,
        reproj_px: wave(dice, level),
        aepe_px: wave(dice, level * 0.8),
        ..Series::default()
    };
    let spread = 0.2 + 0.3 * dice.unit();
    Row {
        group: group.map(str::to_owned),
        measured: Measurement {
            status: Status::Scored,
            status_reason: None,
            frames: Some(49),
            scene: Some(match peak % 3 {
                0 => Scene::Parallax,
                1 => Scene::Rotation,
                _ => Scene::StaticCamera,
            }),
            motion_px: Some(motion),
            reproj_px: Some(level * 1.1),
            reproj_method: Some(GeometryMethod::TwoViewGric),
            aepe_px: Some(level * 0.8),
            aepe_worldscore_px: Some(level * 0.83),
            paper_peak_frame: Some(peak),
            peak_reliable: Some(!peak.is_multiple_of(5)),
            series,
            ..Measurement::without_score(Status::Scored, "")
        },
        z_reproj_px: Some(anomaly + 0.4 * dice.normal()),
        z_aepe_worldscore_px: Some(anomaly + 0.5 * dice.normal()),
        z_piecewise_residual: Some(anomaly + 0.6 * dice.normal()),
        z_appearance_ratio: Some(anomaly - 0.6 * dice.normal()),
        z_layer_acceleration_q25: Some(anomaly + 0.3 * dice.normal()),
        z_interior_shear: Some(anomaly - 0.3 * dice.normal()),
        z_detail_change_q25: None,
        anomaly: Some(anomaly),
        anomaly_lo: Some(anomaly - spread),
        anomaly_hi: Some(anomaly + spread * 1.2),
        ..blank(video)
    }
}

/// Ranks the rows, keeps the best 80% and fits the statistics to them.
pub(crate) fn corpus_of(rows: &mut [Row], recipe: Recipe) -> CorpusFile {
    let mut order: Vec<usize> = (0..rows.len())
        .filter(|index| rows[*index].anomaly.is_some())
        .collect();
    order.sort_by(|a, b| {
        rows[*a]
            .anomaly
            .unwrap()
            .total_cmp(&rows[*b].anomaly.unwrap())
    });
    for (place, index) in order.iter().enumerate() {
        rows[*index].rank = Some(place as u64 + 1);
        rows[*index].decision = if place * 5 < order.len() * 4 {
            Decision::Keep
        } else {
            Decision::Drop
        };
    }
    let mut groups: BTreeMap<String, Vec<&Row>> = BTreeMap::new();
    for row in rows.iter().filter(|row| row.anomaly.is_some()) {
        if let Some(group) = &row.group {
            groups.entry(group.clone()).or_default().push(row);
        }
    }
    let all: Vec<&Row> = rows.iter().filter(|row| row.anomaly.is_some()).collect();
    let weights = |first: f64| {
        BTreeMap::from([
            ("reproj_px".to_owned(), first),
            ("aepe_worldscore_px".to_owned(), 1.0 - first),
        ])
    };
    CorpusFile {
        plumbline_version: "0.1.0".to_owned(),
        source: vec!["rollouts/2026-05".to_owned()],
        profile: Some(ProfileRecord {
            name: Some("standard".to_owned()),
            digest: "5f3a9c1e7b".repeat(6),
            parameters: json!({"working_height_px": 256, "flow": {"finest_scale": 1}}),
        }),
        conditioning_frames: Some(1),
        fault_calibration: None,
        cascade: None,
        statistics: CorpusStatistics {
            degenerate: false,
            uncertain_decisions: None,
            statuses: BTreeMap::new(),
            decisions: BTreeMap::new(),
            recipe,
            bins: 30,
            range: Range::Full,
            normalised_within: crate::reduce::outcome::NormaliseWithin::Corpus,
            keep: "80%".to_owned(),
            corpus: population(&all),
            groups: groups
                .iter()
                .map(|(name, rows)| (name.clone(), population(rows)))
                .collect(),
            sensitivity: (all.len() > 2).then(|| WeightSensitivity {
                freedman_diaconis_bins: BTreeMap::new(),
                freedman_diaconis: weights(0.55),
                winsorised: weights(0.48),
                leave_one_out_max_change: 0.083,
                leave_one_out_video: all.first().map(|row| row.video.to_string()),
            }),
            reference: None,
            warnings: Vec::new(),
        },
    }
}

fn population(rows: &[&Row]) -> Population {
    let signal = |values: Vec<f64>| {
        let lo = values.iter().copied().fold(f64::INFINITY, f64::min);
        let hi = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let width = (hi - lo) / 30.0;
        let mut counts = vec![0_u64; 30];
        for value in &values {
            counts[(((value - lo) / width) as usize).min(29)] += 1;
        }
        let n = values.len() as f64;
        SignalStatistics {
            range_overflow: false,
            n: values.len() as u64,
            min: Some(lo),
            max: Some(hi),
            mean: Some(values.iter().sum::<f64>() / n),
            std: Some(width * 5.0),
            median: Some(lo + width * 9.0),
            mad: Some(width * 3.0),
            edges: (0..=30).map(|edge| lo + width * f64::from(edge)).collect(),
            entropy_nats: Some(
                -counts
                    .iter()
                    .filter(|count| **count > 0)
                    .map(|count| *count as f64 / n)
                    .map(|p| p * libm::log(p))
                    .sum::<f64>(),
            ),
            counts,
            degenerate: false,
        }
    };
    if rows.is_empty() {
        return Population {
            too_few: true,
            n: 0,
            signals: BTreeMap::new(),
            weights: BTreeMap::new(),
        };
    }
    let of = |get: fn(&Measurement) -> Option<f64>| {
        signal(rows.iter().filter_map(|row| get(&row.measured)).collect())
    };
    let signals = BTreeMap::from([
        ("reproj_px".to_owned(), of(|m| m.reproj_px)),
        (
            "aepe_worldscore_px".to_owned(),
            of(|m| m.aepe_worldscore_px),
        ),
    ]);
    Population {
        too_few: false,
        n: rows.len() as u64,
        signals,
        weights: BTreeMap::from([
            ("reproj_px".to_owned(), 0.52),
            ("aepe_worldscore_px".to_owned(), 0.48),
        ]),
    }
}

/// A corpus of robot rollouts in `groups` tasks, with a share of videos that could not be scored.
pub(crate) fn rollouts(videos: usize, groups: usize) -> Vec<Row> {
    const TASKS: [&str; 8] = [
        "pick_spoon",
        "open_drawer",
        "stack_cubes",
        "wipe_table",
        "pour_water",
        "fold_cloth",
        "close_fridge",
        "plug_cable",
    ];
    let mut dice = Dice::new(7);
    (0..videos)
        .map(|index| {
            let group = index % groups.max(1);
            let task = match TASKS.get(group) {
                Some(task) => (*task).to_owned(),
                None => format!("task_{group:03}"),
            };
            let video = format!("{task}/seed_{:05}.mp4", index / groups.max(1));
            let named = (groups > 0).then_some(task.as_str());
            let row = scored(&video, named, 0.25 * (group % 8) as f64 - 0.9, &mut dice);
            let failed = |status, reason: &str| Row {
                group: named.map(str::to_owned),
                measured: Measurement::without_score(status, reason),
                ..blank(&video)
            };
            match index % 47 {
                11 => failed(
                    Status::Static,
                    "too little motion to judge: the moving area is below 1% of the picture",
                ),
                23 => failed(
                    Status::Undecodable,
                    "no complete video: the moov box is missing; write the file again",
                ),
                41 if index % 3 == 0 => failed(
                    Status::TooShort,
                    "6 frames, but 10 are needed: record longer clips",
                ),
                _ => row,
            }
        })
        .collect()
}

/// Two JPEG pictures: a scene of blocks, and a warm spot.
pub(crate) fn thumbnails(video: &VideoId) -> Option<Thumbnails> {
    let seed = video.as_str().bytes().map(u32::from).sum::<u32>();
    let jpeg = |paint: &dyn Fn(u32, u32) -> [u8; 3]| {
        let picture = image::RgbImage::from_fn(160, 120, |x, y| image::Rgb(paint(2 * x, 2 * y)));
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture
            .write_to(&mut bytes, image::ImageFormat::Jpeg)
            .unwrap();
        bytes.into_inner()
    };
    let (cx, cy) = (60 + seed * 7 % 200, 60 + seed * 13 % 120);
    let frame = jpeg(&|x, y| {
        let floor = y > 150;
        let block = x.abs_diff(cx) < 32 && y.abs_diff(cy + 30) < 28;
        let arm = x.abs_diff(cx + y / 6) < 7 && y < cy;
        match (block, arm, floor) {
            (true, ..) => [190, 80 + (seed % 90) as u8, 60],
            (_, true, _) => [70, 74, 80],
            (.., true) => [168 - (y / 8) as u8, 150 - (y / 8) as u8, 128],
            _ => [205, 210 - (y / 6) as u8, 206],
        }
    });
    let heat = jpeg(&|x, y| {
        let (dx, dy) = (f64::from(x) - f64::from(cx), f64::from(y) - f64::from(cy));
        let heat = libm::exp(-(dx * dx + dy * dy) / 2600.0);
        [
            (30.0 + 225.0 * heat) as u8,
            (20.0 + 190.0 * heat * heat) as u8,
            (80.0 * (1.0 - heat)) as u8 + 20,
        ]
    });
    Some(Thumbnails {
        frame_jpeg: frame,
        heat_jpeg: heat,
    })
}

/// Names that break careless pages.
pub(crate) fn hostile(rows: &mut Vec<Row>) {
    let names = [
        "<script>document.title='owned'</script>.mp4".to_owned(),
        "\"><img src=x onerror=alert(1)>.mp4".to_owned(),
        "line\nbreak\tand\rreturn.mp4".to_owned(),
        "invoice\u{202e}4pm.exe".to_owned(),
        "مهمة/التقاط_الملعقة/٠٠١.mp4".to_owned(),
        format!("{}/end_of_a_long_name.mp4", "very_long_folder_".repeat(18)),
        "日本語の動画/検証.mp4".to_owned(),
        "&lt;b&gt;already escaped&lt;/b&gt;.mp4".to_owned(),
    ];
    let mut dice = Dice::new(3);
    for (index, name) in names.iter().enumerate() {
        let group = match index % 3 {
            0 => Some("</style><style>*{display:none}</style>"),
            1 => Some("group-with-an-unbroken-name-that-goes-on-and-on-and-on-and-on-and-on"),
            _ => None,
        };
        let mut row = scored(name, group, 1.5, &mut dice);
        row.measured.status_reason = Some("</td><script>alert(2)</script>".to_owned());
        rows.push(row);
    }
    for name in &names {
        let mut row = blank(&format!("failed/{name}"));
        row.measured = Measurement::without_score(Status::Failed, format!("</td>{name}"));
        row.group = Some("<i>".to_owned());
        rows.push(row);
    }
}
