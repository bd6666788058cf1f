//! `docs/configuration.md` is what the code says: names and values from the settings and profiles themselves,
//! meanings from the doc comments of their fields. `PLUMBLINE_WRITE_DOCS=1` writes it anew.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use plumbline_worker::profile::{Profile, Rung};
use plumbline_worker::settings::Settings;
use serde_json::Value;
use syn::{Expr, Fields, GenericArgument, Item, Lit, Meta, PathArguments, Type};

/// The named fields of all structs of the sources, by the struct's name. A name may be used twice.
#[derive(Default)]
struct Sources(BTreeMap<String, Vec<Vec<Field>>>);

struct Field {
    name: String,
    /// The doc comment, one line.
    meaning: String,
    /// Name of its type, or of what an `Option` of it holds.
    of: String,
}

impl Sources {
    fn read(directory: &Path) -> Self {
        let mut sources = Self::default();
        sources.add_directory(directory);
        sources
    }

    fn add_directory(&mut self, directory: &Path) {
        let mut entries: Vec<_> = std::fs::read_dir(directory).unwrap().collect();
        entries.sort_by_key(|entry| entry.as_ref().unwrap().path());
        for path in entries.into_iter().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                self.add_directory(&path);
            } else if path.extension().is_some_and(|end| end == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                let file = syn::parse_file(&text).unwrap();
                file.items.into_iter().for_each(|item| self.add(item));
            }
        }
    }

    fn add(&mut self, item: Item) {
        let Item::Struct(item) = item else { return };
        let Fields::Named(fields) = item.fields else {
            return;
        };
        let fields = fields.named.into_iter().map(|field| Field {
            name: field.ident.unwrap().to_string(),
            meaning: meaning(&field.attrs),
            of: type_name(&field.ty),
        });
        let known = self.0.entry(item.ident.to_string()).or_default();
        known.push(fields.collect());
    }

    /// The struct of that name with these fields.
    fn find(&self, name: &str, value: &serde_json::Map<String, Value>) -> Option<&[Field]> {
        let named = self.0.get(name)?.iter();
        let mut fitting = named.filter(|fields| {
            fields.len() == value.len() && fields.iter().all(|f| value.contains_key(&f.name))
        });
        fitting.next().map(Vec::as_slice)
    }
}

fn meaning(attributes: &[syn::Attribute]) -> String {
    let docs = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(pair) = &attribute.meta else {
            return None;
        };
        match &pair.value {
            Expr::Lit(text) if pair.path.is_ident("doc") => match &text.lit {
                Lit::Str(line) => Some(line.value().trim().to_owned()),
                _ => None,
            },
            _ => None,
        }
    });
    let text = docs.collect::<Vec<_>>().join(" ");
    // Links between items of the code lead nowhere on a page, and a bar would end its cell.
    text.replace("[`", "`")
        .replace("`]", "`")
        .replace('|', "\\|")
}

fn type_name(of: &Type) -> String {
    let Type::Path(path) = of else {
        return String::new();
    };
    let last = path.path.segments.last().unwrap();
    match &last.arguments {
        PathArguments::AngleBracketed(inside) if last.ident == "Option" => {
            match inside.args.first() {
                Some(GenericArgument::Type(inner)) => type_name(inner),
                _ => String::new(),
            }
        }
        _ => last.ident.to_string(),
    }
}

/// One row of a table: a setting or knob that is no section of others.
struct Row {
    name: String,
    values: Vec<String>,
    meaning: String,
}

/// Rows of `of` and what is below it, with the values of each of `columns`.
fn rows(sources: &Sources, of: &str, prefix: &str, columns: &[&Value], out: &mut Vec<Row>) {
    // The fullest: sections that a rung goes without are not written for it.
    let objects = columns.iter().filter_map(|value| value.as_object());
    let object = objects.max_by_key(|object| object.len()).unwrap();
    let fields = sources.find(of, object);
    let fields = fields.unwrap_or_else(|| panic!("no struct {of} with the fields {object:?}"));
    for field in fields {
        let name = format!("{prefix}{}", field.name);
        let values: Vec<&Value> = columns.iter().map(|value| &value[&field.name]).collect();
        if values.iter().any(|value| value.is_object()) {
            rows(sources, &field.of, &format!("{name}."), &values, out);
            continue;
        }
        assert!(!field.meaning.is_empty(), "{name} has no doc comment");
        out.push(Row {
            name,
            values: values.into_iter().map(shown).collect(),
            meaning: field.meaning.clone(),
        });
    }
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "–".to_owned(),
        value => format!("`{value}`"),
    }
}

fn page() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sources = Sources::read(&root.join("src"));
    let mut all = Sources::read(&root.join("vision/src"));
    all.add_directory(&root.join("src"));

    let mut page = String::from(
        "# Configuration\n\n\
         Made from the code by its tests; `PLUMBLINE_WRITE_DOCS=1 cargo nextest run -E 'binary(configuration)'` makes it anew.\n\n\
         ## Settings\n\n\
         What a run or a worker may use and where its servers are: no part of a score's definition but for `[decode]`, \
         which decides what is scored. Read from `plumbline.toml` in the working directory, over it from the environment, \
         over that from options of the command line.\n\n\
         | `plumbline.toml` | environment | default | meaning |\n|---|---|---|---|\n",
    );
    let settings = serde_json::to_value(Settings::default()).unwrap();
    let mut table = Vec::new();
    rows(&sources, "Settings", "", &[&settings], &mut table);
    for Row {
        name,
        values,
        meaning,
    } in &table
    {
        let environment = format!("PLUMBLINE_{}", name.to_uppercase().replace('.', "__"));
        writeln!(
            page,
            "| `{name}` | `{environment}` | {} | {meaning} |",
            values[0]
        )
        .unwrap();
    }
    page.push_str(
        "\nThe first part of a name is the section: `[compute]`, then `deadline_s = 300.0`. Beside these, \
         AWS's own variables (`AWS_ENDPOINT_URL`, `AWS_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, \
         `AWS_PROFILE`, …) say where a bucket is and who asks, `SSL_CERT_FILE` names certificates to trust, \
         and a setting that is misspelt is refused.\n\n\
         ## Profiles\n\n\
         Every knob of a measurement; its digest stands in every result, and numbers of two profiles are never mixed. \
         `plumbline profile show NAME` prints a file of them, `--profile FILE.toml` uses one: it names the rung it starts \
         from (`rung`) and what it changes. A bar means not set.\n\n",
    );
    // By way of the canonical text, which has the shortest form of every number.
    let ladder = Rung::ALL.map(|rung| {
        let text = Profile::new(rung).canonical().unwrap();
        serde_json::from_slice::<Value>(&text).unwrap()
    });
    let names = Rung::ALL.map(|rung| format!("`{}`", rung.as_str()));
    writeln!(page, "| knob | {} | meaning |", names.join(" | ")).unwrap();
    writeln!(page, "|---|{}---|", "---|".repeat(names.len())).unwrap();
    let mut table = Vec::new();
    let columns: Vec<&Value> = ladder.iter().collect();
    rows(&all, "Profile", "", &columns, &mut table);
    for Row {
        name,
        values,
        meaning,
    } in &table
    {
        writeln!(page, "| `{name}` | {} | {meaning} |", values.join(" | ")).unwrap();
    }
    page
}

#[test]
fn the_page_is_what_the_code_says() {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/configuration.md");
    let page = page();
    if std::env::var_os("PLUMBLINE_WRITE_DOCS").is_some() {
        std::fs::write(&path, &page).unwrap();
    }
    let published = std::fs::read_to_string(&path).unwrap_or_default();
    let first = page
        .lines()
        .zip(published.lines())
        .find(|(now, then)| now != then);
    assert!(
        page == published,
        "docs/configuration.md is behind the code; PLUMBLINE_WRITE_DOCS=1 writes it anew. First difference: {first:?}"
    );
}
