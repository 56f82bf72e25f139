//! A server of two fixed paths, for this machine alone.

use std::io::ErrorKind;
use std::net::Ipv4Addr;

use anyhow::{Result, anyhow};
use tiny_http::{Header, Method, Request, Response};

use super::page::POLICY;

/// Something to serve: nothing is read from disk, whatever a request asks for.
#[derive(Clone, Debug)]
pub struct Page {
    /// Such as `/`.
    pub path: &'static str,
    /// Its MIME type.
    pub kind: &'static str,
    pub content: Vec<u8>,
}

/// A server that listens on 127.0.0.1.
pub struct Server {
    http: tiny_http::Server,
    port: u16,
}

impl Server {
    /// Begins to listen on a port, on any that is free for 0.
    ///
    /// # Errors
    /// If it is taken, or this user may not have it.
    pub fn bind(port: u16) -> Result<Self> {
        let http = tiny_http::Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| refused(port, &*error))?;
        let port = http.server_addr().to_ip().map_or(port, |address| address.port());
        Ok(Self { http, port })
    }

    /// Where it is to be reached.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    /// Answers until the process ends.
    ///
    /// # Errors
    /// If no more connections can be had.
    pub fn serve(&self, pages: &[Page]) -> Result<()> {
        loop {
            let request = self.http.recv().map_err(|error| anyhow!("the server cannot go on: {error}"))?;
            let answer = self.answer(&request, pages);
            // Whoever asked may have gone.
            let _ = request.respond(answer);
        }
    }

    fn answer<'a>(&self, request: &Request, pages: &'a [Page]) -> Response<&'a [u8]> {
        let path = request.url().split(['?', '#']).next().unwrap_or_default();
        let (status, kind, content) = match pages.iter().find(|page| page.path == path) {
            // A page elsewhere may have its own name lead to this address, to read what is here.
            _ if !self.is_for_us(request) => (403, "text/plain", &b"this server answers to 127.0.0.1 alone\n"[..]),
            _ if !matches!(request.method(), Method::Get | Method::Head) => (405, "text/plain", &b"only GET\n"[..]),
            None => (404, "text/plain", &b"there is no such page\n"[..]),
            Some(page) => (200, page.kind, &page.content[..]),
        };
        let headers = [
            ("Content-Type", kind),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Cache-Control", "no-store"),
        ];
        // All of them are ASCII, which is all that is asked for.
        let headers = headers.iter().filter_map(|(name, value)| Header::from_bytes(*name, *value).ok()).collect();
        // In one piece, with its length, so that browsers can tell whether all of it came.
        Response::new(status.into(), headers, content, Some(content.len()), None).with_chunked_threshold(usize::MAX)
    }

    fn is_for_us(&self, request: &Request) -> bool {
        let mut hosts = request.headers().iter().filter(|header| header.field.equiv("Host"));
        let names = ["127.0.0.1", "localhost"].map(|name| format!("{name}:{}", self.port));
        // The default port of HTTP is not written.
        let short = ["127.0.0.1", "localhost"].map(|name| if self.port == 80 { name } else { "" });
        hosts.all(|host| {
            let host = host.value.as_str();
            names.iter().any(|name| name == host) || (!host.is_empty() && short.contains(&host))
        })
    }
}

/// Why a port is not to be had, in words.
fn refused(port: u16, error: &(dyn std::error::Error + Send + Sync + 'static)) -> anyhow::Error {
    let why = match error.downcast_ref::<std::io::Error>().map(std::io::Error::kind) {
        Some(ErrorKind::AddrInUse) => "another program has it".to_owned(),
        Some(ErrorKind::PermissionDenied) => "this user may not have it".to_owned(),
        _ => error.to_string(),
    };
    anyhow!("cannot listen on port {port} of 127.0.0.1: {why}: choose another with `--port`, or 0 for any that is free")
}

#[cfg(test)]
mod tests;
