//! Five thousand rows, some with names that attack: the page stays small, pages through, and stays ours.

use std::fmt::Write as _;
use std::path::PathBuf;

use plumbline_tests::binary::plumbline;
use plumbline_tests::browser::{Browser, Look};
use plumbline_tests::run::{Place, Started};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};

const ROWS: usize = 5_000;
/// The largest page of as many rows, design section 3.
const PAGE_BYTES: u64 = 5_000_000;

const HOSTILE: &str = "<img src=x onerror=\"document.title='owned'\"></script><script>document.title='owned'</script>.mp4";

/// Rows as a fleet would bring them, of noise around plausible values.
fn rows() -> String {
    let mut dice = Pcg64Mcg::seed_from_u64(7);
    let mut unit = || (dice.next_u32() as f64) / f64::from(u32::MAX);
    let mut text = String::new();
    for index in 0..ROWS {
        let task = [
            "pick_spoon",
            "open_drawer",
            "stack_cubes",
            "wipe_table",
            "pour_water",
        ][index % 5];
        let name = match index {
            17 => HOSTILE.to_owned(),
            _ => format!("{task}/episode_{:05}/seed_{}.mp4", index / 5, index % 7),
        };
        let motion = 0.2 + 3.0 * unit() * unit();
        let mut row = json!({
            "video": name, "group": task, "model": format!("wm-{}", index % 3), "status": "scored",
            "digest": format!("{:064x}", index), "frames": 60, "fps": 15.0, "width": 512, "height": 320,
            "duration_s": 4.0, "scene": "static_camera", "motion_px": motion,
            "reproj_px": 0.1 + 0.3 * motion * unit(), "aepe_px": 0.2 + 0.5 * unit(),
            "aepe_worldscore_px": 0.2 + 0.5 * motion * unit(), "occluded_fraction": 0.1 * unit(),
            "piecewise_residual": 0.05 + 0.2 * unit(), "appearance_ratio": 0.8 + unit(),
            "layer_acceleration_q25": unit(), "interior_shear": 0.01 * unit(), "detail_change_q25": unit(),
            "mean_error": unit(), "max_jump": unit(), "paper_peak_frame": 8 + index % 50,
            "peak_reliable": index % 4 != 0, "profile_digest": "ab".repeat(32),
        });
        if index % 10 == 0 {
            row["fault_frames"] = json!([index % 60, 3]);
            let other = ["freeze", "vanish"][index / 10 % 2];
            row["fault_kinds"] = json!(["jump", other]);
        }
        if index % 97 == 5 {
            row = json!({"video": row["video"], "group": task, "model": row["model"], "status": "undecodable",
                "status_reason": "no complete video: the moov box is missing; write the file again"});
        }
        writeln!(text, "{row}").unwrap();
    }
    text
}

/// The report of these rows, beside their `scores.jsonl`.
pub(super) fn reported(place: &Place) -> PathBuf {
    std::fs::write(place.path("rows.jsonl"), rows()).unwrap();
    let run = |words: &[&str]| Started::start(place.command(plumbline()).args(words)).wait();
    run(&["reduce", "rows.jsonl", "--out", "out", "--format", "jsonl"]).expect_code(3);
    run(&["report", "out"])
        .expect_code(0)
        .expect_line(&["report:", "out/report.html"]);
    place.path("out/report.html")
}

#[test]
fn five_thousand_rows_stay_small_and_turn_pages() {
    let place = Place::new();
    let file = reported(&place);
    let bytes = file.metadata().unwrap().len();
    assert!(bytes <= PAGE_BYTES, "{bytes} bytes");

    let browser = Browser::start(Look::default());
    browser.open(&file, "");
    let shown = "document.getElementById('shown').textContent";
    assert_eq!(browser.js(&format!("return {shown}")), "1–50 of 5,000");
    browser.click("#after");
    assert_eq!(browser.js(&format!("return {shown}")), "51–100 of 5,000");
    // A carried column of few texts is a choice like ours are.
    browser
        .js("const box = document.querySelector('select[data-column=model]'); box.value = 'wm-1'; box.dispatchEvent(new Event('change'))");
    let found: Value = browser.js(&format!("return {shown}"));
    assert_eq!(found, "1–50 of 1,667 found of the 5,000 here");
    browser
        .js("const box = document.querySelector('select[data-column=fault_kinds]'); box.value = 'vanish'; box.dispatchEvent(new Event('change'))");
    let kinds = super::column(&browser, "fault_kinds");
    assert!(!kinds.is_empty() && kinds.iter().all(|kinds| kinds.contains("vanish")));
    super::keep_picture(&browser, "large");

    // The hostile name is text wherever it is shown, and opens like any other.
    browser.click("#filters button");
    browser.click("#filters input[type=search]");
    browser.press("onerror");
    browser.until("document.querySelectorAll('#videos tbody tr').length === 1");
    browser.click("#videos tbody a");
    browser.until("document.getElementById('video').open");
    assert_eq!(
        browser.js("return document.getElementById('video-name').textContent"),
        HOSTILE
    );
    let title =
        browser.js("return document.title + document.querySelectorAll('img[src=x]').length");
    assert!(title.as_str().unwrap().ends_with("Plumbline0"), "{title}");
    assert_eq!(browser.console(), Vec::<String>::new());
}
