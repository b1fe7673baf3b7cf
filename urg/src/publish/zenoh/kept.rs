//! Transient local message: late readers get it too. Compatible with zenoh's advanced
//! publishers: a reader discovers the publisher by its token, and queries `KEY/@adv/**`.
//! `zenoh-ext` implements them, but needs zenoh's unstable API.

use std::time::SystemTime;

use zenoh::liveliness::LivelinessToken;
use zenoh::query::Queryable;
use zenoh::{Session, Wait};

use super::graph::{Gid, attachment};

/// Published message. Late readers no longer get it after you drop this.
pub(super) struct Kept {
    _answers: Queryable<()>,
    _token: LivelinessToken,
}

impl Kept {
    /// Publishes `message`, the only message with this key. `gid` identifies the publisher for
    /// `rmw_zenoh`.
    pub(super) fn publish(
        session: &Session,
        key: String,
        message: Vec<u8>,
        gid: Gid,
    ) -> zenoh::Result<Self> {
        let metadata = attachment(1, SystemTime::now(), gid);
        session.put(key.clone(), message.clone()).attachment(metadata.clone()).wait()?;
        let offer = format!("{key}/@adv/pub/{}/uhlc/_", session.zid());
        let answers = session
            .declare_queryable(offer.clone())
            .callback(move |query| {
                // An error means that the reader is gone.
                let _ =
                    query.reply(key.clone(), message.clone()).attachment(metadata.clone()).wait();
            })
            .wait()?;
        let token = session.liveliness().declare_token(offer).wait()?;
        Ok(Self { _answers: answers, _token: token })
    }
}
