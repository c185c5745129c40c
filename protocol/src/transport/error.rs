//! What goes wrong on the network, in words.

use std::time::Duration;

use crate::codec::{DecodeError, EncodeError};

/// Why the transport cannot do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// An endpoint that is none.
    #[error(
        "the endpoint {endpoint:?} {problem}; right would be \"tcp/192.168.1.10:7447\" or \"tls/leader.local:7447\""
    )]
    Endpoint {
        /// As given.
        endpoint: String,
        /// What is wrong.
        problem: String,
    },
    /// A client without an endpoint.
    #[error("an agent needs at least one endpoint of a leader or router to connect to")]
    NowhereToConnect,
    /// The Zenoh configuration cannot be made.
    #[error("zenoh configuration{}: {reason}", .file.as_deref().map(|f| format!(" {f}")).unwrap_or_default())]
    Configuration {
        /// The file, where there is one.
        file: Option<String>,
        /// What Zenoh says.
        reason: String,
    },
    /// The roster or the passwords cannot be read.
    #[error(transparent)]
    Document(#[from] crate::document::DocumentError),
    /// Zenoh works in a multi-threaded runtime only.
    #[error("the program must run in tokio's multi-threaded runtime")]
    Runtime,
    /// Nobody took the connection in the time that was given, or the port to listen on is taken.
    #[error(
        "cannot open the session (listening on {listen:?}, connecting to {connect:?}): {reason}. \
             Is the leader running, is the port free, and do user, password and certificates fit?"
    )]
    Open {
        /// Own endpoints.
        listen: Vec<String>,
        /// Endpoints of others.
        connect: Vec<String>,
        /// What Zenoh says.
        reason: String,
    },
    /// A publisher, subscriber, queryable or token was refused.
    #[error("cannot declare {key}: {reason}")]
    Declare {
        /// On which key.
        key: String,
        /// What Zenoh says.
        reason: String,
    },
    /// The session does not take the message any more.
    #[error("cannot send on {key}: {reason}")]
    Send {
        /// On which key.
        key: String,
        /// What Zenoh says.
        reason: String,
    },
    /// The message is illegal. Nothing was sent.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The session did not close in time.
    #[error("the session did not close within {limit:?}{reason}")]
    Close {
        /// The time it had.
        limit: Duration,
        /// What Zenoh says.
        reason: String,
    },
}

/// Why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// Nobody answers this key.
    #[error("nobody answers {0}")]
    NobodyThere(String),
    /// No answer in time.
    #[error("no answer on {key} within {limit:?}")]
    TimedOut {
        /// Asked.
        key: String,
        /// How long.
        limit: Duration,
    },
    /// The other side said no.
    #[error("{key}: {why}")]
    Refused {
        /// Asked.
        key: String,
        /// Its words.
        why: String,
    },
    /// The answer cannot be read.
    #[error("the answer on {key} cannot be read: {source}")]
    Unreadable {
        /// Asked.
        key: String,
        /// Why.
        source: DecodeError,
    },
    /// The question could not be sent.
    #[error(transparent)]
    Transport(#[from] TransportError),
}

/// Zenoh's text without the place in its source code.
pub(super) fn words(error: &zenoh::Error) -> String {
    let text = error.to_string();
    text.split(" at /").next().unwrap_or_default().trim().to_owned()
}
