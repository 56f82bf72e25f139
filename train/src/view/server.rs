//! HTTP server of two fixed paths, for this machine only.

use std::io::ErrorKind;
use std::net::Ipv4Addr;

use anyhow::{Result, anyhow};
use tiny_http::{Header, Method, Request, Response};

use super::page::POLICY;

/// A page to serve. No request reads from disk.
#[derive(Clone, Debug)]
pub struct ServedFile {
    /// Path in the URL, such as `/`.
    pub path: &'static str,
    /// MIME type.
    pub kind: &'static str,
    pub content: Vec<u8>,
}

/// A server that listens on 127.0.0.1.
pub struct Server {
    http: tiny_http::Server,
    port: u16,
}

impl Server {
    /// Begins to listen on a port; 0 chooses a free one.
    ///
    /// # Errors
    /// If the port is taken, or this user may not use it.
    pub fn bind(port: u16) -> Result<Self> {
        let http = tiny_http::Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| refused(port, &*error))?;
        let port = http.server_addr().to_ip().map_or(port, |address| address.port());
        Ok(Self { http, port })
    }

    /// Returns the URL of the server.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    /// Answers requests until the process ends.
    ///
    /// # Errors
    /// If no more connections can be accepted.
    pub fn serve(&self, pages: &[ServedFile]) -> Result<()> {
        loop {
            let request = self.http.recv().map_err(|error| anyhow!("the server cannot go on: {error}"))?;
            let answer = self.answer(&request, pages);
            // The client may have gone.
            let _ = request.respond(answer);
        }
    }

    fn answer<'a>(&self, request: &Request, pages: &'a [ServedFile]) -> Response<&'a [u8]> {
        let path = request.url().split(['?', '#']).next().unwrap_or_default();
        let (status, kind, content) = match pages.iter().find(|page| page.path == path) {
            // A page elsewhere may let its own host name resolve to this address, to read the content here.
            _ if !self.is_for_us(request) => (403, "text/plain", &b"this server answers to 127.0.0.1 only\n"[..]),
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
        // All headers are ASCII, the only condition.
        let headers = headers.iter().filter_map(|(name, value)| Header::from_bytes(*name, *value).ok()).collect();
        // Sent in one piece, with its length, so that browsers can tell whether it is complete.
        Response::new(status.into(), headers, content, Some(content.len()), None).with_chunked_threshold(usize::MAX)
    }

    fn is_for_us(&self, request: &Request) -> bool {
        let mut hosts = request.headers().iter().filter(|header| header.field.equiv("Host"));
        let names = ["127.0.0.1", "localhost"].map(|name| format!("{name}:{}", self.port));
        // The default port of HTTP is omitted.
        let short = ["127.0.0.1", "localhost"].map(|name| if self.port == 80 { name } else { "" });
        hosts.all(|host| {
            let host = host.value.as_str();
            names.iter().any(|name| name == host) || (!host.is_empty() && short.contains(&host))
        })
    }
}

/// Describes why a port is not available.
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
