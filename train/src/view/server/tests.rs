use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;

use super::*;

/// Starts a server with one page, on a thread that runs until the process ends.
fn started() -> Arc<Server> {
    started_on(LOCALHOST)
}

fn started_on(host: &str) -> Arc<Server> {
    let server = Arc::new(Server::bind(host, 0, "--port").unwrap());
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

/// Whoever has the address may read and act, from any host; nobody else learns what is served.
#[test]
fn on_other_addresses_a_token_is_needed() {
    let (server, other) = (started_on("0.0.0.0"), started_on("0.0.0.0"));
    assert!(
        server.token.len() == 32
            && server.token != other.token
            && server.url().ends_with(&format!("/{}/", server.token))
    );
    let get = |path: &str| ask(&server, &format!("GET {path}"), "machine.example:7007");
    assert!(get(&format!("/{}/?reload=1", server.token)).ends_with("\r\n\r\nhello"));
    for path in
        ["/", "//", &format!("/{}", server.token), &format!("/{}/", other.token), &format!("/{}/", &server.token[1..])]
    {
        assert!(get(path).starts_with("HTTP/1.1 404"), "{path}");
    }
    assert!(Server::bind("192.0.2.1", 0, "--live").err().unwrap().to_string().contains("--live"));
}

#[test]
fn it_listens_on_this_machine_alone() {
    let server = Server::bind(LOCALHOST, 0, "--port").unwrap();
    assert!(server.http.server_addr().to_ip().unwrap().ip().is_loopback());
}

#[test]
fn a_port_that_is_taken_is_named() {
    let server = Server::bind(LOCALHOST, 0, "--port").unwrap();
    let error = Server::bind(LOCALHOST, server.port, "--port").err().unwrap().to_string();
    for part in [&server.port.to_string(), "another program has it", "--port"] {
        assert!(error.contains(part), "{error}");
    }
}
