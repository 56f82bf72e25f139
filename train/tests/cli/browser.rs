//! `report.html` and `splat view` in a browser. Without Chromium these tests say so and pass; with
//! `SPLAT_BROWSER=require` they fail. `SPLAT_BROWSER=PATH` names the browser.

use std::env;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use image::RgbImage;

use crate::run::{TRAINED, fresh};
use crate::view::Serving;
use crate::{live, text};

/// Size of the browser's window, px.
const WINDOW: (u32, u32) = (1100, 1000);

/// Time after which a page is given up.
const PATIENCE: Duration = Duration::from_secs(120);

fn browser() -> Option<PathBuf> {
    let wanted = env::var("SPLAT_BROWSER").unwrap_or_default();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let folders: Vec<PathBuf> = env::split_paths(&env::var_os("PATH").unwrap_or_default()).collect();
    let found =
        names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name))).find(|path| path.is_file());
    match wanted.as_str() {
        "" if found.is_none() => {
            // Written past the test harness, which swallows the output of passing tests.
            let line = b"SKIPPED: no Chromium on the path (SPLAT_BROWSER=require makes that a failure)\n";
            let _ = std::io::stderr().write_all(line);
            None
        }
        "" => found,
        "require" => Some(found.expect("SPLAT_BROWSER=require, and no Chromium is on the path")),
        path => Some(path.into()),
    }
}

/// State of a page in the browser.
pub struct PageResult {
    /// State that the page in the frame reports, as JSON.
    pub state: serde_json::Value,
    /// Lines written to the browser's console.
    pub console: Vec<String>,
    pub picture: RgbImage,
}

/// A page to test.
pub enum BrowserPage {
    File(PathBuf),
    /// From here on, only the test asks the server, on behalf of the browser.
    Served(Serving),
}

/// Returns the document that holds a page in a frame: it waits until the page's viewer has drawn or failed, and records
/// the result. The browser takes its picture when a document is complete. An image that [`serve`] withholds keeps this
/// one incomplete until the page is ready.
fn harness(page: &str, gate: &str, script: &str) -> String {
    let (width, height) = WINDOW;
    include_str!("harness.html")
        .replace("PAGE", page)
        .replace("GATE", gate)
        .replace("SCRIPT", script)
        .replace("WIDTH", &width.to_string())
        .replace("HEIGHT", &height.to_string())
}

/// Loads a page into a frame and records its state. `script` runs before that; its `page` is the page's document.
pub fn look(name: &str, page: BrowserPage, script: &str) -> Option<PageResult> {
    let browser = browser()?;
    let folder = fresh(&format!("browser-{name}"));
    fs::create_dir_all(&folder).unwrap();
    let gate = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", gate.local_addr().unwrap());
    // A document may access a frame of the same origin, which all files have here.
    let (url, html) = match &page {
        BrowserPage::File(path) => {
            let harness_path = folder.join("harness.html");
            fs::write(&harness_path, harness(&format!("file://{}", text(path)), &address, script)).unwrap();
            (format!("file://{}", text(&harness_path)), String::new())
        }
        BrowserPage::Served(_) => (format!("{address}/harness"), harness("/", &address, script)),
    };
    let (stop, stopped) = mpsc::channel::<()>();
    let serving = thread::spawn(move || serve(&gate, &html, &page, &stopped));
    let picture = folder.join("picture.png");
    let profile = format!("--user-data-dir={}", folder.join("profile").display());
    let shot = format!("--screenshot={}", picture.display());
    let size = format!("--window-size={},{}", WINDOW.0, WINDOW.1);
    let output = Command::new(browser)
        .args(["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
        .args(["--allow-file-access-from-files", "--enable-logging=stderr", "--dump-dom", &shot, &size])
        .args(["--hide-scrollbars", &profile, &url])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    drop(stop);
    serving.join().unwrap();
    let (dom, log) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let state = dom.split_once("<pre id=\"state\">").and_then(|(_, rest)| rest.split_once("</pre>"));
    let state = state.and_then(|(state, _)| serde_json::from_str(state).ok());
    Some(PageResult {
        state: state.unwrap_or_else(|| panic!("the page did not answer\n{log}\n{dom}")),
        console: log.lines().filter(|line| line.contains(":CONSOLE")).map(String::from).collect(),
        picture: image::open(picture).unwrap().into_rgb8(),
    })
}

/// Answers the browser: `/harness` with the document, `/held` only after a request for `/open` or when nobody waits any
/// longer, and everything else with the answer of the page's server.
fn serve(gate: &TcpListener, harness: &str, page: &BrowserPage, stopped: &mpsc::Receiver<()>) {
    const EMPTY: &[u8] = b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n";
    gate.set_nonblocking(true).unwrap();
    let (start, mut held, mut open): (_, Vec<TcpStream>, _) = (Instant::now(), Vec::new(), false);
    // Browsers open connections before they have a request, and a busy machine sends it late.
    let mut silent: Vec<TcpStream> = Vec::new();
    while stopped.try_recv() != Err(mpsc::TryRecvError::Disconnected) {
        if open || start.elapsed() > PATIENCE {
            // The clients may have gone.
            held.drain(..).for_each(|mut stream| _ = stream.write_all(EMPTY));
        }
        while let Ok((stream, _)) = gate.accept() {
            stream.set_nonblocking(true).unwrap();
            silent.push(stream);
        }
        let mut request = [0; 4096];
        let spoken = |stream: &mut TcpStream| stream.read(&mut request).map_err(|error| error.kind());
        let asks = silent.iter_mut().map(spoken).position(|read| read != Err(ErrorKind::WouldBlock));
        let Some(at) = asks else {
            thread::sleep(Duration::from_millis(20));
            continue;
        };
        let mut stream = silent.swap_remove(at);
        stream.set_nonblocking(false).unwrap();
        let end = request.iter().position(|byte| *byte == 0).unwrap_or(request.len());
        if end == 0 {
            continue;
        }
        let request = String::from_utf8_lossy(&request[..end]);
        let mut words = request.split(' ');
        let method = words.next().unwrap_or_default();
        let answer = match (words.next(), page) {
            (Some("/held"), _) => {
                held.push(stream);
                continue;
            }
            (Some("/open"), _) => {
                open = true;
                EMPTY.to_vec()
            }
            (Some("/harness"), _) => {
                let head = "HTTP/1.1 200 OK\r\nContent-Type: text/html; charset=utf-8\r\nConnection: close\r\n\r\n";
                format!("{head}{harness}").into_bytes()
            }
            (Some(path), BrowserPage::Served(server)) if path != "/favicon.ico" => server.ask(method, path),
            _ => EMPTY.to_vec(),
        };
        let _ = stream.write_all(&answer);
    }
}

/// Checks that nothing went wrong and that the scene is visible.
#[track_caller]
pub fn assert_drawn(seen: &PageResult) {
    assert_eq!(seen.state["viewer"], "drawn", "{}\n{:?}", seen.state, seen.console);
    let complaints: Vec<&String> =
        seen.console.iter().filter(|line| !line.contains("GPU stall due to ReadPixels")).collect();
    assert!(complaints.is_empty(), "{complaints:#?}");
    let side = |name: &str| seen.state["box"][name].as_f64().unwrap().max(0.0) as u32;
    let (left, top) = (side("left"), side("top"));
    let (right, bottom) = (side("right").min(WINDOW.0), side("bottom").min(seen.picture.height()));
    assert!(right > left + 200 && bottom > top + 100, "the picture is out of observation: {}", seen.state);
    let pixels = (top + 40..bottom - 40).flat_map(|y| (left..right).map(move |x| (x, y)));
    let colours: std::collections::HashSet<[u8; 3]> = pixels.map(|(x, y)| seen.picture.get_pixel(x, y).0).collect();
    assert!(colours.len() > 500, "the picture is blank: {} colours", colours.len());
}

#[test]
fn browsers_draw_the_scene_of_a_report_from_its_file() {
    let report = BrowserPage::File(TRAINED.join("report.html"));
    let Some(seen) = look("report", report, "page.getElementById(\"viewer\").scrollIntoView();") else { return };
    assert_drawn(&seen);
    let lengths: Vec<u64> = serde_json::from_value(seen.state["curves"].clone()).unwrap();
    assert_eq!(lengths.len(), 3, "{}", seen.state);
    assert!(lengths[0] > 200 && lengths[2] > 200, "curves without points: {lengths:?}");
    assert_eq!(seen.state["cut"], "25%", "the line between photograph and render");
}

#[test]
fn browsers_draw_a_scene_that_is_served() {
    let serving = Serving::start(&[text(&TRAINED.join("scene.ply"))]);
    let Some(seen) = look("view", BrowserPage::Served(serving), "") else { return };
    assert_drawn(&seen);
}

/// Looks at a run for two scenes, stops it, and waits for its results. `page.seen` holds the mean of the first picture and
/// the mean difference of both, of 255.
const WATCH: &str = r##"
  const view = frame.contentWindow, root = page.documentElement;
  const until = async (is) => { for (let i = 0; i < 600 && !is(); i++) await wait(100); };
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [64, 64];
  const brush = canvas.getContext("2d", { willReadFrequently: true });
  const mean = (values) => values.reduce((sum, value, at) => sum + (at % 4 < 3 ? value : 0), 0) / (64 * 64 * 3);
  // A picture can be read in the frame that draws it.
  const grab = async () => {
    for (let i = 0; i < 100; i++) {
      page.getElementById("viewer-camera").dispatchEvent(new view.Event("change"));
      await new Promise((go) => view.requestAnimationFrame(go));
      brush.clearRect(0, 0, 64, 64);
      brush.drawImage(page.querySelector("#viewer canvas"), 0, 0, 64, 64);
      const values = brush.getImageData(0, 0, 64, 64).data;
      if (mean(values) > 1) return values;
    }
    return [];
  };
  await until(() => root.dataset.viewer);
  const before = await grab();
  const shown = () => Number(root.dataset.scene?.split("=")[1] ?? 0);
  await until(() => shown() > 50 && !page.getElementById("live-worst").hidden);
  await wait(500);
  // Splats are sorted beside the drawing, on a busy machine seconds later.
  let change = 0;
  for (let i = 0; i < 40 && change < 0.1; i++) {
    const after = await grab();
    change = mean(before.map((value, at) => Math.abs(value - after[at])));
    await wait(500);
  }
  page.seen = [mean(before), change];
  page.getElementById("live-stop").click();
  await until(() => root.dataset.live !== "training");
  page.seen.push(root.dataset.live);
"##;

#[test]
fn browsers_watch_a_run_and_stop_it() {
    let out = fresh("live-browser");
    let serving = live::start(&out, &["--eval-during", "50"]);
    let Some(seen) = look("live", BrowserPage::Served(serving), WATCH) else { return };
    assert_drawn(&seen);
    let [picture, change] = [0, 1].map(|at| seen.state["seen"][at].as_f64().unwrap());
    assert!(picture > 1.0 && change > 0.1, "the picture stays: {}", seen.state);
    let written = out.join("metrics.json").is_file();
    assert_eq!(seen.state["seen"][2], "done", "results written: {written}; {}", seen.state);
    let metrics: serde_json::Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let shown = |id: &str| seen.state["tiles"][id].as_str().unwrap().to_owned();
    assert_eq!(shown("live-step"), metrics["steps"].to_string());
    assert_eq!(shown("live-splats"), metrics["splats"].to_string());
    assert_eq!(shown("live-psnr"), format!("{:.2} dB", metrics["test"]["psnr"].as_f64().unwrap()));
    let lengths: Vec<u64> = serde_json::from_value(seen.state["curves"].clone()).unwrap();
    assert!(lengths.iter().all(|length| *length > 20), "curves without points: {lengths:?}");
}

#[test]
fn browsers_say_what_is_wrong_with_a_scene() {
    let page = fs::read_to_string(TRAINED.join("report.html")).unwrap();
    let (before, scene) = page.split_once("id=\"viewer-scene\">").unwrap();
    let (_, after) = scene.split_once("</script>").unwrap();
    let folder = fresh("broken-report");
    fs::create_dir_all(&folder).unwrap();
    let broken = folder.join("report.html");
    fs::write(&broken, format!("{before}id=\"viewer-scene\">bm90IGEgcGx5</script>{after}")).unwrap();
    let Some(seen) = look("broken", BrowserPage::File(broken), "") else { return };
    assert_eq!(seen.state["viewer"], "failed", "{}", seen.state);
    assert!(seen.state["note"].as_str().unwrap().contains("cannot be drawn here"), "{}", seen.state);
}
