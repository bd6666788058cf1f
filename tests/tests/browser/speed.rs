//! How long pages take to be there, as `tests/benches/report.sh` asks: a measurement, not a check.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use plumbline_tests::browser::{Browser, Look};
use plumbline_tests::run::Place;
use serde_json::{Map, Value};

/// Times every page is opened.
const ROUNDS: usize = 5;

/// What is timed, and the script that says it in milliseconds, or nothing.
const TIMED: [(&str, &str); 6] = [
    ("parsed, script run", "page.domContentLoadedEventEnd"),
    ("loaded", "page.loadEventEnd"),
    ("first contentful paint", "paint.startTime"),
    (
        "sort by text",
        "timed(() => at('#videos thead button').click())",
    ),
    (
        "filter by text",
        "timed(() => { const box = at('select[data-column=decision]'); box.value = 'drop'; box.dispatchEvent(new Event('change')); })",
    ),
    (
        "open a video",
        "timed(() => { history.replaceState(null, '', at('#videos tbody a').hash); dispatchEvent(new Event('hashchange')); })",
    ),
];

/// A table of all rows and columns and nothing else.
fn plain_table(scores: &Path) -> String {
    let text = std::fs::read_to_string(scores).unwrap();
    let rows: Vec<Map<String, Value>> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let names: BTreeSet<&String> = rows.iter().flat_map(Map::keys).collect();
    let mut page = "<!doctype html><meta charset=utf-8><title>Table</title><table>".to_owned();
    let mut line = |tag: &str, cells: Vec<String>| {
        page.push_str("<tr>");
        for cell in cells {
            let cell = cell.replace('&', "&amp;").replace('<', "&lt;");
            page.push_str(&format!("<{tag}>{cell}</{tag}>"));
        }
    };
    line("th", names.iter().map(|name| (*name).clone()).collect());
    for row in &rows {
        let shown = |name: &&String| match row.get(*name) {
            None | Some(Value::Null) => String::new(),
            Some(Value::String(text)) => text.clone(),
            Some(value) => value.to_string(),
        };
        line("td", names.iter().map(shown).collect());
    }
    page
}

/// Prints a line of a Markdown table for every page: its bytes, then medians of milliseconds. The pages: two
/// to compare with, the report of the synthetic rows, and those that `PLUMBLINE_BENCH_REPORTS` names.
#[test]
#[ignore = "a measurement: tests/benches/report.sh"]
fn pages_are_timed() {
    let place = Place::new();
    let large = super::large::reported(&place);
    std::fs::write(
        place.path("empty.html"),
        "<!doctype html><title>Empty</title><p>empty",
    )
    .unwrap();
    let table = plain_table(&place.path("out/scores.jsonl"));
    std::fs::write(place.path("table.html"), table).unwrap();
    let mut pages: Vec<(String, PathBuf)> = vec![
        ("an empty page".to_owned(), place.path("empty.html")),
        (
            "a plain table of the 5,000 rows".to_owned(),
            place.path("table.html"),
        ),
        ("the report of the 5,000 rows".to_owned(), large),
    ];
    let named = std::env::var("PLUMBLINE_BENCH_REPORTS").unwrap_or_default();
    pages.extend(
        named
            .split(':')
            .filter(|name| !name.is_empty())
            .map(|name| {
                let file = PathBuf::from(name);
                let run = file.parent().and_then(Path::file_name).unwrap_or_default();
                (format!("the report {}", run.to_string_lossy()), file)
            }),
    );

    let browser = Browser::start(Look::default());
    let mut times = vec![[const { Vec::new() }; TIMED.len()]; pages.len()];
    for _ in 0..ROUNDS {
        for ((_, file), times) in pages.iter().zip(&mut times) {
            browser.open(file, "");
            browser.until("performance.getEntriesByName('first-contentful-paint').length === 1");
            for ((_, script), times) in TIMED.iter().zip(times) {
                let told = browser.js(&format!(
                    "const [page] = performance.getEntriesByType('navigation');
                     const [paint] = performance.getEntriesByName('first-contentful-paint');
                     const at = (selector) => document.querySelector(selector);
                     // Until the new layout stands, too.
                     const timed = (act) => {{ const from = performance.now(); act(); document.body.offsetHeight; return performance.now() - from; }};
                     return at('#videos') || !`{script}`.startsWith('timed') ? {script} : null"
                ));
                times.extend(told.as_f64());
            }
        }
    }
    println!(
        "| page | bytes | {} |",
        TIMED.map(|(name, _)| format!("{name}, ms")).join(" | ")
    );
    println!("|---|---|{}", "---|".repeat(TIMED.len()));
    for ((name, file), times) in pages.iter().zip(times) {
        let bytes = file.metadata().unwrap().len();
        let medians = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            times
                .get(times.len() / 2)
                .map_or("–".to_owned(), |median| format!("{median:.0}"))
        });
        println!("| {name} | {bytes} | {} |", medians.join(" | "));
    }
}
