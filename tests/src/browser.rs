//! A headless Chromium, driven over WebDriver by Debian's `chromedriver` (`deploy/test.sh browser` installs
//! both). What pages complain of is read from Chromium's own log.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use fantoccini::wd::Capabilities;
use fantoccini::{Client, ClientBuilder, Locator};
use hyper_util::client::legacy::connect::HttpConnector;
use rustix::process::Signal;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::process;

/// Longest wait for anything on a page: generous, for a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

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
    /// Commands.
    pub client: Client,
    place: TempDir,
}

impl Browser {
    /// Starts one.
    ///
    /// # Panics
    /// Where there is none, or it does not start.
    pub async fn start(look: Look) -> Self {
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
        let client = ClientBuilder::new(HttpConnector::new())
            .capabilities(capabilities(look, place.path()))
            .connect(&format!("http://127.0.0.1:{port}"))
            .await
            .expect("Chromium starts");
        Self {
            driver,
            client,
            place,
        }
    }

    /// Opens a file, with what follows its name in the address.
    pub async fn open(&self, file: &Path, rest: &str) {
        let file = file.canonicalize().expect("the file is there");
        // A page that is open already would only be scrolled.
        self.client.goto("about:blank").await.expect("a blank page");
        let address = format!("file://{}{rest}", file.display());
        self.client.goto(&address).await.expect("the page opens");
    }

    /// What a script's `return` gives.
    pub async fn js(&self, script: &str) -> Value {
        self.client
            .execute(script, Vec::new())
            .await
            .unwrap_or_else(|error| panic!("{script}: {error}"))
    }

    /// Waits until a script returns true.
    pub async fn until(&self, condition: &str) {
        let started = std::time::Instant::now();
        while self.js(&format!("return {condition}")).await != json!(true) {
            assert!(
                started.elapsed() < PATIENCE,
                "never became true: {condition}"
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// Clicks on the first element that a selector finds.
    pub async fn click(&self, selector: &str) {
        let found = self.client.find(Locator::Css(selector)).await;
        let element = found.unwrap_or_else(|error| panic!("{selector}: {error}"));
        element
            .click()
            .await
            .unwrap_or_else(|error| panic!("{selector}: {error}"));
    }

    /// Presses keys where the focus is.
    pub async fn press(&self, keys: &str) {
        let focused = self.client.active_element().await.expect("a focus");
        focused.send_keys(keys).await.expect("keys");
    }

    /// Every line that pages or Chromium's policies put on the console.
    pub fn console(&self) -> Vec<String> {
        let log = std::fs::read(self.place.path().join("log")).expect("Chromium's log");
        let log = String::from_utf8_lossy(&log).into_owned();
        let lines = log.lines().filter(|line| line.contains(":CONSOLE"));
        lines.map(str::to_owned).collect()
    }

    /// The window as a PNG.
    pub async fn screenshot(&self) -> Vec<u8> {
        self.client.screenshot().await.expect("a screenshot")
    }
}

fn capabilities(look: Look, place: &Path) -> Capabilities {
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
    let mut capabilities = Capabilities::new();
    capabilities.insert(
        "goog:chromeOptions".to_owned(),
        json!({ "args": arguments }),
    );
    capabilities
}

impl Drop for Browser {
    fn drop(&mut self) {
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
