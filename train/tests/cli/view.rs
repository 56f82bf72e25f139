//! `splat view`: the pages that it serves, and its errors.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Stdio};

use crate::run::{TRAINED, refuse, splat};
use crate::text;

/// A server that ends with the test.
pub struct Serving {
    child: Child,
    pub url: String,
}

impl Serving {
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = splat(&["view"]);
        let mut child = command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        Self { child, url: url.trim().to_owned() }
    }

    /// Takes over a program that serves at `url`.
    pub fn of(child: Child, url: &str) -> Self {
        Self { child, url: url.trim().to_owned() }
    }

    /// Returns the whole answer to a request.
    pub fn ask(&self, method: &str, path: &str) -> Vec<u8> {
        self.ask_as(method, path, "")
    }

    /// Returns the whole answer to a request with more headers, each with its line end.
    pub fn ask_as(&self, method: &str, path: &str, headers: &str) -> Vec<u8> {
        let host = self.url.strip_prefix("http://").unwrap().trim_end_matches('/');
        // A run that has ended serves nothing.
        let Ok(mut stream) = TcpStream::connect(host) else { return Vec::new() };
        write!(stream, "{method} {path} HTTP/1.1\r\nHost: {host}\r\n{headers}Connection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    }

    /// Returns the answer to a path without its headers.
    pub fn get(&self, path: &str) -> Vec<u8> {
        let mut answer = self.ask("GET", path);
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        answer.split_off(end + 4)
    }
}

impl Serving {
    /// Waits until the program ends, and returns its exit code.
    pub fn end(&mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        self.child.wait().unwrap();
    }
}

#[test]
fn a_scene_is_served_on_this_machine() {
    let scene = TRAINED.join("scene.ply");
    let serving = Serving::start(&[text(&scene)]);
    assert!(serving.url.starts_with("http://127.0.0.1:"), "{}", serving.url);
    let page = String::from_utf8(serving.get("/")).unwrap();
    assert!(page.contains("<title>scene.ply</title>") && page.contains("SplatLibrary"));
    let served = serving.get("/scene.ply");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    fs::write(&path, served).unwrap();
    let (read, _) = splat_model::ply::read(&path).unwrap();
    assert_eq!(read, splat_model::ply::read(&scene).unwrap().0);
    assert_eq!(serving.get("/metrics.json"), b"there is no such page\n");
}

#[test]
fn what_cannot_be_served_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    let missing = folder.path().join("nowhere.ply");
    refuse(&mut splat(&["view", text(&missing)]), &[text(&missing)]);
    let empty = folder.path().join("empty.ply");
    fs::write(&empty, "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n").unwrap();
    refuse(&mut splat(&["view", text(&empty)]), &[text(&empty)]);
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    refuse(&mut splat(&["view", text(&scene), "--port", &port]), &[&port, "another program has it", "--port"]);
}
