//! A minimal HTTP client for these tests.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;

use super::program::STEP_LIMIT;

/// A client of an address, and the host that it names.
#[derive(Clone, Copy)]
pub(crate) struct Client<'a> {
    pub(crate) address: &'a str,
    pub(crate) host: &'a str,
    pub(crate) accept: &'a str,
}

impl Client<'_> {
    /// Sends a request, and reads the head of the response.
    pub(crate) fn get(&self, path: &str) -> HttpResponse {
        self.ask("GET", path, "")
    }

    /// Posts nothing but the path, with a header such as `Origin: null\r\n`.
    pub(crate) fn post(&self, path: &str, header: &str) -> HttpResponse {
        self.ask("POST", path, header)
    }

    fn ask(&self, method: &str, path: &str, header: &str) -> HttpResponse {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(STEP_LIMIT)).unwrap();
        write!(
            &stream,
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nAccept: {}\r\n{header}Connection: close\r\n\r\n",
            self.host, self.accept
        )
        .unwrap();
        let mut stream = BufReader::new(stream);
        let head: Vec<_> = std::iter::from_fn(|| Some(crlf(&mut stream)))
            .take_while(|line| !line.is_empty())
            .collect();
        let status = head[0].split(' ').nth(1).unwrap().parse().unwrap();
        let headers: Vec<_> = head[1..]
            .iter()
            .map(|line| line.split_once(": ").unwrap())
            .map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned()))
            .collect();
        let mut response = HttpResponse { status, headers, stream, chunked: false, left: 0 };
        response.chunked = response.has("transfer-encoding");
        if !response.chunked && status != 204 {
            response.left = response.header("content-length").parse().unwrap();
        }
        response
    }
}

fn crlf(stream: &mut impl BufRead) -> String {
    let mut line = String::new();
    stream.read_line(&mut line).unwrap();
    line.strip_suffix("\r\n").unwrap_or_else(|| panic!("{line:?} has no end")).to_owned()
}

/// A response whose body is not read yet.
pub(crate) struct HttpResponse {
    pub(crate) status: u16,
    headers: Vec<(String, String)>,
    stream: BufReader<TcpStream>,
    chunked: bool,
    /// Bytes left of the body, or of its current chunk.
    left: usize,
}

impl HttpResponse {
    pub(crate) fn has(&self, name: &str) -> bool {
        self.headers.iter().any(|(header, _)| header == name)
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        let header = self.headers.iter().find(|(header, _)| header == name);
        header.map(|(_, value)| value.as_str()).unwrap_or_default()
    }

    /// Reads the next byte of the body. Panics if the body ends early.
    fn byte(&mut self) -> Option<u8> {
        if self.left == 0 && self.chunked {
            self.left = usize::from_str_radix(&crlf(&mut self.stream), 16).unwrap();
            if self.left == 0 {
                assert_eq!(crlf(&mut self.stream), "");
                self.chunked = false;
            }
        }
        if self.left == 0 {
            return None;
        }
        let mut byte = [0];
        self.stream.read_exact(&mut byte).unwrap();
        self.left -= 1;
        if self.left == 0 && self.chunked {
            assert_eq!(crlf(&mut self.stream), "");
        }
        Some(byte[0])
    }

    /// Reads the next line of the body, without its end; `None` after the last.
    pub(crate) fn line(&mut self) -> Option<String> {
        let mut line = Vec::new();
        loop {
            match self.byte() {
                Some(b'\n') => break,
                Some(byte) => line.push(byte),
                None if line.is_empty() => return None,
                None => break,
            }
        }
        Some(String::from_utf8(line).unwrap())
    }

    /// Reads the rest of the body.
    pub(crate) fn text(mut self) -> String {
        let bytes: Vec<_> = std::iter::from_fn(|| self.byte()).collect();
        String::from_utf8(bytes).unwrap()
    }
}
