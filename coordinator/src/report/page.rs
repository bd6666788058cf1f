//! The page around the sections: head, content policy, contents, and the style and script that
//! every section shares.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use sha2::{Digest, Sha256};

use super::text;

const COLOURS: &str = include_str!("colours.css");
const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");
/// Longest title of the browser's tab.
const TAB_CHARS: usize = 120;

/// A part of the page.
pub(crate) struct Section {
    /// Anchor.
    pub(crate) id: &'static str,
    /// Heading, and entry in the contents.
    pub(crate) title: &'static str,
    /// What stands under the heading; the section is left out where there is nothing.
    pub(crate) body: Option<Markup>,
}

/// The whole page, under a heading about what `title` names; `data` is what its script reads.
pub(crate) fn assemble<const N: usize>(
    about: &str,
    title: &str,
    sections: [Section; N],
    data: Option<&str>,
) -> String {
    // Nothing from elsewhere: pictures and videos from the page's own place alone (`file:` says so where a
    // page on a disk has no origin). The one script is allowed by its digest, not by being inline.
    let digest = STANDARD.encode(Sha256::digest(SCRIPT.as_bytes()));
    let policy = format!(
        "default-src 'none'; img-src data: 'self' file:; media-src 'self' file:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    );
    let present: Vec<(Section, Markup)> = sections
        .into_iter()
        .filter_map(|mut section| section.body.take().map(|body| (section, body)))
        .collect();
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(policy);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta name="referrer" content="no-referrer";
                title { (text::plain_name(title, TAB_CHARS)) " · Plumbline" }
                style { (PreEscaped(COLOURS)) (PreEscaped(STYLE)) }
            }
            body {
                header.top {
                    p.brand { "Plumbline" }
                    h1 { (about) " " (text::name(title)) }
                    nav aria-label="Contents" {
                        @for (section, _) in present.iter().skip(1) {
                            a href={ "#" (section.id) } { (section.title) }
                        }
                    }
                }
                main {
                    @for (section, body) in &present {
                        section id=(section.id) {
                            h2 { (section.title) }
                            (body)
                        }
                    }
                }
                @if let Some(data) = data { script #data type="application/json" { (PreEscaped(data)) } }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    }
    .into_string()
}

/// A JPEG inside the page.
pub(super) fn jpeg_address(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg))
}
