//! A headless Chromium, driven over WebDriver (W3C; JSON over HTTP) by Debian's `chromedriver`, which
//! `deploy/test.sh browser` installs. What pages complain of is read from Chromium's own log.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine as _;
use rustix::process::Signal;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::process;

/// Longest wait for anything on a page: generous, for a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Longest wait for an answer of the driver, whose first brings up a whole browser.
const ANSWER: Duration = Duration::from_secs(180);

/// Keys as WebDriver names them.
pub mod key {
    /// Tabulator.
    pub const TAB: &str = "\u{e004}";
    /// Enter.
    pub const ENTER: &str = "\u{e007}";
    /// Escape.
    pub const ESCAPE: &str = "\u{e00c}";
    /// Arrow to the right.
    pub const RIGHT: &str = "\u{e014}";
}

/// What marks an element's reference in an answer (WebDriver, section 12.2).
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";

/// How a browser starts.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    /// Whether pages are asked to be dark.
    pub dark: bool,
    /// Whether pages may run scripts.
    pub scripts: bool,
    /// Columns and rows of the window, CSS pixels.
    pub window: (u32, u32),
}

impl Default for Look {
    fn default() -> Self {
        Self {
            dark: false,
            scripts: true,
            window: (1280, 1000),
        }
    }
}

/// The browser; dropping it ends it.
#[derive(Debug)]
pub struct Browser {
    driver: Child,
    agent: ureq::Agent,
    /// Address of the session.
    session: String,
    place: TempDir,
}

impl Browser {
    /// Starts one.
    ///
    /// # Panics
    /// Where there is none, or it does not start.
    pub fn start(look: Look) -> Self {
        let place = TempDir::with_prefix("plumbline-browser-").expect("a temporary directory");
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .process_group(0)
            .spawn()
            .expect("chromedriver is missing: run deploy/test.sh browser, which installs it");
        let mut lines = BufReader::new(driver.stdout.take().expect("its output")).lines();
        let port = lines.by_ref().map_while(Result::ok).find_map(|line| {
            let (_, port) = line.split_once("started successfully on port ")?;
            Some(port.trim_end_matches('.').to_owned())
        });
        let port = port.expect("chromedriver names its port");
        // Whatever else it says must not block it.
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(drop));
        let config = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(ANSWER));
        let mut browser = Self {
            driver,
            agent: config.build().into(),
            session: format!("http://127.0.0.1:{port}/session"),
            place,
        };
        let wanted =
            json!({ "capabilities": { "alwaysMatch": capabilities(look, browser.place.path()) } });
        let started = browser.ask("", &wanted).expect("Chromium starts");
        let id = started["sessionId"].as_str().expect("a session");
        browser.session = format!("{}/{id}", browser.session);
        browser
    }

    /// Sends a command of the session; its value, or what went wrong.
    fn ask(&self, command: &str, body: &Value) -> Result<Value, String> {
        let address = format!("{}{command}", self.session);
        let answer = self.agent.post(&address).send(body.to_string());
        Self::value(answer)
    }

    fn look_up(&self, command: &str) -> Result<Value, String> {
        let answer = self.agent.get(format!("{}{command}", self.session)).call();
        Self::value(answer)
    }

    fn value(
        answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
    ) -> Result<Value, String> {
        let mut answer = answer.map_err(|error| error.to_string())?;
        let text = answer
            .body_mut()
            .with_config()
            .limit(64 << 20)
            .read_to_string();
        let text = text.map_err(|error| error.to_string())?;
        let mut told: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
        match answer.status().is_success() {
            true => Ok(told["value"].take()),
            false => Err(told["value"]["message"].to_string()),
        }
    }

    /// Opens a file, with what follows its name in the address.
    pub fn open(&self, file: &Path, rest: &str) {
        let file = file.canonicalize().expect("the file is there");
        let address = format!("file://{}{rest}", file.display());
        // A page that is open already would only be scrolled.
        for address in ["about:blank", &address] {
            self.ask("/url", &json!({ "url": address }))
                .expect("the page opens");
        }
    }

    /// What a script's `return` gives.
    #[track_caller]
    pub fn js(&self, script: &str) -> Value {
        let run = self.ask("/execute/sync", &json!({ "script": script, "args": [] }));
        run.unwrap_or_else(|error| panic!("{script}: {error}"))
    }

    /// Waits until an expression is true.
    #[track_caller]
    pub fn until(&self, condition: &str) {
        let started = Instant::now();
        while self.js(&format!("return {condition}")) != json!(true) {
            assert!(
                started.elapsed() < PATIENCE,
                "never became true: {condition}"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// References of all elements that a selector finds.
    #[track_caller]
    pub fn all(&self, selector: &str) -> Vec<String> {
        let found = self.ask(
            "/elements",
            &json!({ "using": "css selector", "value": selector }),
        );
        let found = found.unwrap_or_else(|error| panic!("{selector}: {error}"));
        let found = found.as_array().expect("a list");
        found.iter().map(reference).collect()
    }

    /// Whether an element is to be seen.
    pub fn is_shown(&self, element: &str) -> bool {
        let shown = self.look_up(&format!("/element/{element}/displayed"));
        shown.expect("an answer") == json!(true)
    }

    /// Clicks on the first element that a selector finds, as a person would: it must be in reach.
    #[track_caller]
    pub fn click(&self, selector: &str) {
        let found = self.all(selector);
        let first = found.first().unwrap_or_else(|| panic!("no {selector}"));
        let clicked = self.ask(&format!("/element/{first}/click"), &json!({}));
        clicked.unwrap_or_else(|error| panic!("{selector}: {error}"));
    }

    /// Presses keys where the focus is.
    #[track_caller]
    pub fn press(&self, keys: &str) {
        let pressed: Vec<Value> = keys
            .chars()
            .flat_map(|key| ["keyDown", "keyUp"].map(|act| json!({ "type": act, "value": key })))
            .collect();
        let keyboard =
            json!({ "actions": [{ "type": "key", "id": "keyboard", "actions": pressed }] });
        self.ask("/actions", &keyboard).expect("keys");
    }

    /// Every line that pages or Chromium's policies put on the console.
    pub fn console(&self) -> Vec<String> {
        let log = std::fs::read(self.place.path().join("log")).expect("Chromium's log");
        let log = String::from_utf8_lossy(&log).into_owned();
        let lines = log.lines().filter(|line| line.contains(":CONSOLE"));
        lines.map(str::to_owned).collect()
    }

    /// The window as a PNG.
    pub fn screenshot(&self) -> Vec<u8> {
        let picture = self.look_up("/screenshot").expect("a screenshot");
        let picture = picture.as_str().unwrap_or_default();
        base64::engine::general_purpose::STANDARD
            .decode(picture)
            .expect("base64")
    }
}

fn reference(element: &Value) -> String {
    element[ELEMENT].as_str().expect("a reference").to_owned()
}

fn capabilities(look: Look, place: &Path) -> Value {
    let (width, height) = look.window;
    let mut arguments = vec![
        "--headless".to_owned(),
        "--no-sandbox".to_owned(),
        "--disable-gpu".to_owned(),
        "--disable-quic".to_owned(),
        "--no-first-run".to_owned(),
        "--disable-background-networking".to_owned(),
        "--disable-component-update".to_owned(),
        "--disable-sync".to_owned(),
        "--disable-dev-shm-usage".to_owned(),
        "--enable-logging".to_owned(),
        format!("--log-file={}", place.join("log").display()),
        format!("--user-data-dir={}", place.join("profile").display()),
        format!("--window-size={width},{height}"),
    ];
    if look.dark {
        arguments.push("--blink-settings=preferredColorScheme=0".to_owned());
    }
    if !look.scripts {
        arguments.push("--blink-settings=scriptEnabled=false".to_owned());
    }
    json!({ "goog:chromeOptions": { "args": arguments } })
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _closed = self.agent.delete(&self.session).call();
        // Told to end, the driver ends its browser, too.
        process::signal(self.driver.id() as i32, Signal::TERM);
        for _ in 0..250 {
            if matches!(self.driver.try_wait(), Ok(Some(_))) {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let _gone = self.driver.kill();
        let _gone = self.driver.wait();
    }
}
