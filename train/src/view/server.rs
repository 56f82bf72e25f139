//! HTTP server of fixed paths, for this machine only.

use std::borrow::Cow;
use std::io::ErrorKind;
use std::net::Ipv4Addr;

use anyhow::{Result, anyhow};
use tiny_http::{Header, Method, Request, Response};

use super::page::POLICY;

/// The pages of a server. No request reads from disk.
pub trait Site {
    /// Returns the MIME type and the content of a path such as `/`; `None` if there is no such page.
    fn get(&self, path: &str) -> Option<(&'static str, Cow<'_, [u8]>)>;

    /// Does what a POST to a path asks for. Returns whether there is such an action.
    fn act(&self, _path: &str) -> bool {
        false
    }
}

/// A page that does not change.
#[derive(Clone, Debug)]
pub struct ServedFile {
    /// Path in the URL, such as `/`.
    pub path: &'static str,
    /// MIME type.
    pub kind: &'static str,
    pub content: Vec<u8>,
}

impl Site for [ServedFile] {
    fn get(&self, path: &str) -> Option<(&'static str, Cow<'_, [u8]>)> {
        self.iter().find(|page| page.path == path).map(|page| (page.kind, Cow::Borrowed(&page.content[..])))
    }
}

/// A server that listens on 127.0.0.1.
pub struct Server {
    http: tiny_http::Server,
    port: u16,
}

impl Server {
    /// Begins to listen on a port; 0 chooses a free one. `option` is the option that names the port.
    ///
    /// # Errors
    /// If the port is taken, or this user may not use it.
    pub fn bind(port: u16, option: &str) -> Result<Self> {
        let http =
            tiny_http::Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| refused(port, &*error, option))?;
        let port = http.server_addr().to_ip().map_or(port, |address| address.port());
        Ok(Self { http, port })
    }

    /// Returns the URL of the server.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    /// Answers requests until the process ends, or [`Self::close`] is called.
    ///
    /// # Errors
    /// If no more connections can be accepted, or the server was closed.
    pub fn serve(&self, site: &(impl Site + ?Sized)) -> Result<()> {
        loop {
            let request = self.http.recv().map_err(|error| anyhow!("the server cannot go on: {error}"))?;
            self.respond(request, site);
        }
    }

    /// Ends [`Self::serve`] on another thread.
    pub fn close(&self) {
        self.http.unblock();
    }

    fn respond(&self, request: Request, site: &(impl Site + ?Sized)) {
        let path = request.url().split(['?', '#']).next().unwrap_or_default();
        let text = |status, text: &'static str| (status, "text/plain", Cow::Borrowed(text.as_bytes()));
        let (status, kind, content) = match request.method() {
            // A page elsewhere may let its own host name resolve to this address, to read the content here.
            _ if !self.is_for_us(&request) => text(403, "this server answers to 127.0.0.1 only\n"),
            Method::Get | Method::Head => match site.get(path) {
                Some((kind, content)) => (200, kind, content),
                None => text(404, "there is no such page\n"),
            },
            // A page elsewhere can send a request without reading its answer.
            Method::Post if self.is_from_us(&request) && site.act(path) => text(200, "done\n"),
            _ => text(405, "only GET\n"),
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
        let answer = Response::new(status.into(), headers, &content[..], Some(content.len()), None);
        // The client may have gone.
        let _ = request.respond(answer.with_chunked_threshold(usize::MAX));
    }

    fn is_for_us(&self, request: &Request) -> bool {
        headers(request, "Host").all(|host| self.is_own_host(host))
    }

    /// Whether the page that sent a request is one of this server; programs that are no browsers name no origin.
    fn is_from_us(&self, request: &Request) -> bool {
        headers(request, "Origin")
            .all(|origin| origin.strip_prefix("http://").is_some_and(|host| self.is_own_host(host)))
    }

    fn is_own_host(&self, host: &str) -> bool {
        ["127.0.0.1", "localhost"].iter().any(|name| {
            // The default port of HTTP is omitted.
            host == format!("{name}:{}", self.port) || (self.port == 80 && host == *name)
        })
    }
}

/// Returns the values of a header.
fn headers<'a>(request: &'a Request, name: &'static str) -> impl Iterator<Item = &'a str> {
    request.headers().iter().filter(move |header| header.field.equiv(name)).map(|header| header.value.as_str())
}

/// Describes why a port is not available.
fn refused(port: u16, error: &(dyn std::error::Error + Send + Sync + 'static), option: &str) -> anyhow::Error {
    let why = match error.downcast_ref::<std::io::Error>().map(std::io::Error::kind) {
        Some(ErrorKind::AddrInUse) => "another program has it".to_owned(),
        Some(ErrorKind::PermissionDenied) => "this user may not have it".to_owned(),
        _ => error.to_string(),
    };
    anyhow!(
        "cannot listen on port {port} of 127.0.0.1: {why}: choose another with `{option}`, or 0 for any that is free"
    )
}

#[cfg(test)]
mod tests;
