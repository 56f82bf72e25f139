//! HTTP server of fixed paths: for this machine only, or for those who have the token in its address.

use std::borrow::Cow;
use std::io::ErrorKind;

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

/// A server that listens on 127.0.0.1, or on another address with a token at the beginning of every path.
pub struct Server {
    http: tiny_http::Server,
    host: String,
    port: u16,
    /// Empty on 127.0.0.1.
    token: String,
}

/// Address of this machine alone.
pub const LOCALHOST: &str = "127.0.0.1";

impl Server {
    /// Begins to listen on a port of an address; 0 chooses a free one. `option` is the option that names them. An error
    /// if the port is taken, this user may not use it, or this machine does not have the address.
    pub fn bind(host: &str, port: u16, option: &str) -> Result<Self> {
        let http = tiny_http::Server::http((host, port)).map_err(|error| {
            let why = match error.downcast_ref::<std::io::Error>().map(std::io::Error::kind) {
                Some(ErrorKind::AddrInUse) => "another program has it".to_owned(),
                Some(ErrorKind::AddrNotAvailable) => "this machine does not have that address".to_owned(),
                Some(ErrorKind::PermissionDenied) => "this user may not have it".to_owned(),
                _ => error.to_string(),
            };
            anyhow!("cannot listen on port {port} of {host}: {why}: choose another with `{option}`, or 0 for any that is free")
        })?;
        let port = http.server_addr().to_ip().map_or(port, |address| address.port());
        let token = if host == LOCALHOST { String::new() } else { format!("{:032x}", rand::random::<u128>()) };
        Ok(Self { http, host: host.to_owned(), port, token })
    }

    /// Returns the URL of the server. Where it listens on all addresses, it has the name of this machine.
    pub fn url(&self) -> String {
        let host = match self.host.as_str() {
            "0.0.0.0" | "::" => sysinfo::System::host_name().unwrap_or_else(|| self.host.clone()),
            host if host.contains(':') => format!("[{host}]"),
            host => host.to_owned(),
        };
        let token = if self.token.is_empty() { String::new() } else { format!("{}/", self.token) };
        format!("http://{host}:{}/{token}", self.port)
    }

    /// Answers requests until the process ends, or [`Self::close`] is called. An error if no more connections can be
    /// accepted, or the server was closed.
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
        let asked = request.url().split(['?', '#']).next().unwrap_or_default();
        let path = match self.token.as_str() {
            "" => Some(asked),
            token => asked.strip_prefix('/').and_then(|asked| asked.strip_prefix(token)),
        };
        let path = path.filter(|path| path.starts_with('/'));
        let text = |status, text: &'static str| (status, "text/plain", Cow::Borrowed(text.as_bytes()));
        let (status, kind, content) = match request.method() {
            // A page elsewhere may let its own host name resolve to this address, to read the content here.
            _ if self.token.is_empty() && !self.is_for_us(&request) => {
                text(403, "this server answers to 127.0.0.1 only\n")
            }
            Method::Get | Method::Head => match path.and_then(|path| site.get(path)) {
                Some((kind, content)) => (200, kind, content),
                None => text(404, "there is no such page\n"),
            },
            // A page elsewhere can send a request without reading its answer.
            Method::Post if self.is_from_us(&request) && path.is_some_and(|path| site.act(path)) => text(200, "done\n"),
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

    /// Whether the page that sent a request is one of this server: it has the token, or else its origin; only browsers name an origin.
    fn is_from_us(&self, request: &Request) -> bool {
        !self.token.is_empty()
            || headers(request, "Origin")
                .all(|origin| origin.strip_prefix("http://").is_some_and(|host| self.is_own_host(host)))
    }

    fn is_own_host(&self, host: &str) -> bool {
        [LOCALHOST, "localhost"].iter().any(|name| {
            // The default port of HTTP is omitted.
            host == format!("{name}:{}", self.port) || (self.port == 80 && host == *name)
        })
    }
}

/// Returns the values of a header.
fn headers<'a>(request: &'a Request, name: &'static str) -> impl Iterator<Item = &'a str> {
    request.headers().iter().filter(move |header| header.field.equiv(name)).map(|header| header.value.as_str())
}

#[cfg(test)]
mod tests;
