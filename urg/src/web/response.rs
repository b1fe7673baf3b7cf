//! Responses of the server, with their content type.

use std::convert::Infallible;

use bytes::Bytes;
use http_body_util::combinators::UnsyncBoxBody;
use http_body_util::{BodyExt, Full};
use hyper::StatusCode;
use hyper::body::Body;
use hyper::header::{self, HeaderValue};

/// Response with a complete or streaming body.
pub(super) type Response = hyper::Response<UnsyncBoxBody<Bytes, Infallible>>;

pub(super) fn text(status: StatusCode, text: impl Into<Bytes>) -> Response {
    whole(status, "text/plain; charset=utf-8", text)
}

pub(super) fn whole(status: StatusCode, mime: &'static str, body: impl Into<Bytes>) -> Response {
    response(status, mime, Full::new(body.into()))
}

pub(super) fn response(
    status: StatusCode,
    content_type: &'static str,
    body: impl Body<Data = Bytes, Error = Infallible> + Send + 'static,
) -> Response {
    let mut response = Response::new(body.boxed_unsync());
    *response.status_mut() = status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type));
    response
}
