use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;

use super::*;

/// Starts a server with one page, on a thread that runs until the process ends.
fn started() -> Arc<Server> {
    let server = Arc::new(Server::bind(0, "--port").unwrap());
    let serving = Arc::clone(&server);
    std::thread::spawn(move || {
        serving.serve(&[ServedFile { path: "/", kind: "text/html", content: b"hello".to_vec() }][..]).unwrap();
    });
    server
}

/// Returns the answer to a request line with a host.
fn ask(server: &Server, line: &str, host: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    write!(stream, "{line} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn only_its_pages_are_served() {
    let server = started();
    let host = format!("127.0.0.1:{}", server.port);
    let answer = ask(&server, "GET /?reload=1", &host);
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("\r\n\r\nhello"), "{answer}");
    assert!(answer.contains("Content-Security-Policy: default-src 'none'"), "{answer}");
    for path in ["/etc/passwd", "/../../etc/passwd", "//etc/passwd", "/%2e%2e/Cargo.toml", "/scene.ply"] {
        let answer = ask(&server, &format!("GET {path}"), &host);
        assert!(answer.starts_with("HTTP/1.1 404"), "{path}: {answer}");
    }
    let answer = ask(&server, "POST /", &host);
    assert!(answer.starts_with("HTTP/1.1 405"), "{answer}");
    let answer = ask(&server, "HEAD /", &host);
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("\r\n\r\n"), "{answer}");
}

#[test]
fn pages_of_others_cannot_read_what_is_served() {
    let server = started();
    for host in ["evil.example", "evil.example:80", "127.0.0.1", &format!("127.0.0.1.evil.example:{}", server.port)] {
        let answer = ask(&server, "GET /", host);
        assert!(answer.starts_with("HTTP/1.1 403") && !answer.contains("hello"), "{host}: {answer}");
    }
    let answer = ask(&server, "GET /", &format!("localhost:{}", server.port));
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
}

#[test]
fn it_listens_on_this_machine_alone() {
    let server = Server::bind(0, "--port").unwrap();
    assert!(server.http.server_addr().to_ip().unwrap().ip().is_loopback());
}

#[test]
fn a_port_that_is_taken_is_named() {
    let server = Server::bind(0, "--port").unwrap();
    let error = Server::bind(server.port, "--port").err().unwrap().to_string();
    for part in [&server.port.to_string(), "another program has it", "--port"] {
        assert!(error.contains(part), "{error}");
    }
}
