//! The suite `browser`: the report as people use it, in a headless Chromium: sort, filter, open a video,
//! by mouse and by keyboard, light and dark, with five thousand rows, hostile names, and without scripts.
//! `PLUMBLINE_TEST_SCREENSHOTS=DIR` keeps pictures of what it saw.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking, and tells how long a page took"
)]

mod large;
mod speed;

use plumbline_tests::browser::{Browser, Look, key};
use plumbline_tests::run::Place;
use serde_json::{Value, json};

/// Texts of a column of the table, by its heading.
fn column(browser: &Browser, name: &str) -> Vec<String> {
    let script = format!(
        "const heads = [...document.querySelectorAll('#videos thead button')].map((b) => b.title);
         const at = heads.indexOf('Sort by {name}');
         return [...document.querySelectorAll('#videos tbody tr')].map((row) => row.cells[at].textContent);"
    );
    serde_json::from_value(browser.js(&script)).unwrap()
}

fn numbers(texts: &[String]) -> Vec<f64> {
    texts.iter().map(|text| text.parse().unwrap()).collect()
}

/// Keeps a picture where somebody wants to look.
fn keep_picture(browser: &Browser, name: &str) {
    if let Some(directory) = std::env::var_os("PLUMBLINE_TEST_SCREENSHOTS") {
        let file = std::path::Path::new(&directory).join(format!("{name}.png"));
        std::fs::write(file, browser.screenshot()).unwrap();
    }
}

fn scored() -> Place {
    let place = Place::with_clips(6);
    let ended = place.run("out", &["--group-by", "prefix:-0", "--heatmaps", "1"]);
    ended.expect_line(&["report:"]);
    place
}

#[test]
fn a_report_is_sorted_filtered_and_opened() {
    let place = scored();
    let browser = Browser::start(Look::default());
    browser.open(&place.path("out/report.html"), "");
    let shown = column(&browser, "anomaly");
    assert_eq!(shown.len(), 6);
    assert!(numbers(&shown).is_sorted_by(|a, b| a >= b), "{shown:?}");

    // Numbers are sorted from the large end first, then from the other.
    browser.click("#videos button[title='Sort by motion_px']");
    let down = numbers(&column(&browser, "motion_px"));
    assert!(down.is_sorted_by(|a, b| a >= b), "{down:?}");
    browser.click("#videos button[title='Sort by motion_px']");
    let up = numbers(&column(&browser, "motion_px"));
    assert!(up.is_sorted() && up != down, "{up:?}");
    let sorted = browser
        .js("return document.querySelector('#videos th[aria-sort]').ariaSort + document.activeElement.title");
    assert_eq!(sorted, "ascendingSort by motion_px");

    // Text, then a choice; both at once; cleared.
    let rows = "document.querySelectorAll('#videos tbody tr').length";
    browser.click("#filters input[type=search]");
    browser.press("clip-03");
    browser.until(&format!("{rows} === 1"));
    assert_eq!(column(&browser, "video"), ["clip-03.mp4"]);
    browser.click("#filters button");
    browser.until(&format!("{rows} === 6"));
    browser
        .js("const box = document.querySelector('select[data-column=decision]'); box.value = 'drop'; box.dispatchEvent(new Event('change'))");
    let decisions = column(&browser, "decision");
    assert!(!decisions.is_empty() && decisions.iter().all(|decision| decision == "drop"));
    browser.click("#filters button");
    keep_picture(&browser, "table");

    // A video by mouse: its pictures load, its decision is explained.
    browser.click("#videos tbody a");
    browser.until("document.getElementById('video').open");
    let loaded = "[...document.querySelectorAll('#video img')].every((img) => img.complete && img.naturalWidth > 0)";
    browser.until(loaded);
    let images = browser.js("return document.querySelectorAll('#video img').length");
    assert!(
        images.as_u64() >= Some(3),
        "frame, heat map and series: {images}"
    );
    let why = browser.js("return document.getElementById('video-why').textContent");
    assert!(
        ["Kept: ", "Dropped: "]
            .iter()
            .any(|word| why.as_str().unwrap().starts_with(word)),
        "{why}"
    );
    let first = browser.js("return document.getElementById('video-name').textContent");
    browser.press(key::RIGHT);
    let second = browser.js("return document.getElementById('video-name').textContent");
    assert_ne!(first, second, "the arrow leads to the next video");
    keep_picture(&browser, "video");
    browser.click("#video-close");
    assert_eq!(browser.js("return location.hash"), "#table");

    // The address of a video opens it.
    browser.open(&place.path("out/report.html"), "#v=clip-04.mp4");
    let opened = "return document.getElementById('video').open && document.getElementById('video-name').textContent";
    assert_eq!(browser.js(opened), "clip-04.mp4");
    assert_eq!(browser.console(), Vec::<String>::new());
    // The check above can fail.
    browser.js("console.error('a complaint')");
    browser.js("return 1");
    assert_eq!(browser.console().len(), 1);
}

#[test]
fn a_keyboard_alone_suffices() {
    let place = scored();
    let browser = Browser::start(Look::default());
    browser.open(&place.path("out/report.html"), "");
    let focused = "const e = document.activeElement; return e.title || e.dataset.column || e.id || e.type || e.textContent";
    // From the search over every choice to the table and its headings, in the order of the page.
    browser.js("document.querySelector('#filters input').focus()");
    let mut order: Vec<Value> = Vec::new();
    for _ in 0..30 {
        browser.press(key::TAB);
        order.push(browser.js(focused));
        if order.last() == Some(&json!("Sort by video")) {
            break;
        }
    }
    let place_of = |name: &str| order.iter().position(|focus| focus == name);
    let places = ["decision", "button", "videos-region", "Sort by video"].map(place_of);
    assert!(
        places.iter().all(Option::is_some) && places.is_sorted(),
        "{order:?}"
    );

    browser.js("document.querySelector('#videos tbody a').focus()");
    let link = browser.js("return document.activeElement.textContent");
    browser.press(key::ENTER);
    browser.until("document.getElementById('video').open");
    assert_eq!(browser.js("return document.activeElement.id"), "video-name");
    // The first video of the list has none before it.
    browser.press(key::TAB);
    assert_eq!(
        browser.js("return document.activeElement.id"),
        "video-after"
    );
    browser.press(key::TAB);
    assert_eq!(
        browser.js("return document.activeElement.id"),
        "video-close"
    );
    browser.press(key::ESCAPE);
    browser.until("!document.getElementById('video').open");
    assert_eq!(
        browser.js("return document.activeElement.textContent"),
        link
    );

    // Every control and picture has a name for those who do not see it.
    let nameless = browser
        .js("return [...document.querySelectorAll('input, select, button, a, dialog, img:not([alt]), svg[role=img]:not([aria-label])')]
             .filter((e) => e.matches('img, svg') || !(e.labels?.length || e.textContent.trim() || e.ariaLabel || e.getAttribute('aria-labelledby')))
             .filter((e) => !e.closest('dialog:not([open])'))
             .map((e) => e.outerHTML)");
    assert_eq!(nameless, json!([]));
    assert_eq!(browser.console(), Vec::<String>::new());
}

#[test]
fn dark_and_narrow_are_readable() {
    let place = scored();
    let look = Look {
        dark: true,
        window: (500, 900),
        ..Look::default()
    };
    let browser = Browser::start(look);
    browser.open(&place.path("out/report.html"), "");
    // WCAG 2: relative luminance and contrast, of text on the page and in the charts.
    let contrast = browser
        .js("const light = (colour) => {
               const [r, g, b] = colour.match(/[\\d.]+/g).slice(0, 3).map((c) => c / 255)
                 .map((c) => c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
               return 0.2126 * r + 0.7152 * g + 0.0722 * b;
             };
             const paper = light(getComputedStyle(document.body).backgroundColor);
             const inks = [getComputedStyle(document.body).color,
               ...[...document.querySelectorAll('svg.chart text')].map((t) => getComputedStyle(t).fill)];
             return [paper, Math.min(...inks.map((ink) => (light(ink) + 0.05) / (paper + 0.05)))];");
    let contrast: [f64; 2] = serde_json::from_value(contrast).unwrap();
    assert!(contrast[0] < 0.05, "the page is dark: {contrast:?}");
    assert!(contrast[1] >= 4.5, "text stands out: {contrast:?}");
    let wide = browser
        .js("return document.documentElement.scrollWidth - document.documentElement.clientWidth");
    assert_eq!(wide, 0, "nothing makes the page scroll sideways");
    keep_picture(&browser, "dark");
    assert_eq!(browser.console(), Vec::<String>::new());
}

#[test]
fn without_scripts_the_page_is_still_read() {
    let place = scored();
    let look = Look {
        scripts: false,
        ..Look::default()
    };
    let browser = Browser::start(look);
    browser.open(&place.path("out/report.html"), "");
    assert_eq!(browser.all("#videos tbody tr").len(), 6);
    assert_eq!(
        browser.all("#videos thead button").len(),
        0,
        "no script ran"
    );
    for (selector, shown) in [
        ("#filters", false),
        ("#videos", true),
        ("article.clip", true),
    ] {
        for element in browser.all(selector) {
            assert_eq!(browser.is_shown(&element), shown, "{selector}");
        }
    }
}
