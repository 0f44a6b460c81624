use std::error::Error as StdError;
use std::fmt;

/// What can go wrong; its text names the cause and the remedy.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// An address, a session's name, a number or the environment is wrong.
    Config(String),
    /// The program at the other end broke the protocol.
    Protocol(String),
    /// The hub refuses this program.
    Refused {
        /// The hub's code, such as `role-taken`.
        code: String,
        /// Why, for people.
        text: String,
    },
    /// The hub ended the session, or knows nothing of this experiment any more.
    HubClosed(String),
    /// A player was lost, and the episode is void: start another. The hub waits for the player, or for another.
    PeerLost(String),
    /// A player failed in a call, or broke the protocol.
    PeerFailed(String),
    /// The player lacks the capability for this request.
    Unsupported(String),
    /// A request failed with another code of the hub's.
    Request {
        /// The hub's code.
        code: String,
        /// Why, for people.
        text: String,
    },
    /// The agent or environment that is served failed; the hub is informed.
    Player(Box<dyn StdError + Send + Sync>),
    /// A mask or extras are not what can be sent.
    Beside(String),
    /// A body is larger than the hub accepts.
    TooLarge {
        /// Its size in bytes.
        size: usize,
        /// What the hub accepts.
        limit: usize,
    },
}

impl Error {
    /// Returns the hub's code, such as `peer-lost`, if a request failed with one.
    pub fn code(&self) -> Option<&str> {
        match self {
            Error::PeerLost(_) => Some("peer-lost"),
            Error::PeerFailed(_) => Some("peer-failed"),
            Error::Unsupported(_) => Some("unsupported"),
            Error::Request { code, .. } => Some(code),
            _ => None,
        }
    }

    pub(crate) fn of_request(code: &str, text: &str) -> Error {
        let text = text.to_owned();
        match code {
            "peer-lost" => Error::PeerLost(text),
            "peer-failed" => Error::PeerFailed(text),
            "unsupported" => Error::Unsupported(text),
            _ => Error::Request { code: code.to_owned(), text },
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Config(text)
            | Error::Protocol(text)
            | Error::HubClosed(text)
            | Error::Beside(text)
            | Error::PeerLost(text)
            | Error::PeerFailed(text)
            | Error::Unsupported(text)
            | Error::Request { text, .. } => out.write_str(text),
            Error::Refused { text, .. } => write!(out, "the hub refused this program: {text}"),
            Error::Player(source) => write!(out, "the player failed: {source}"),
            Error::TooLarge { size, limit } => {
                write!(out, "a body has {size} bytes, and the hub takes {limit}")
            }
        }
    }
}

impl StdError for Error {
    fn source(&self) -> Option<&(dyn StdError + 'static)> {
        match self {
            Error::Player(source) => Some(source.as_ref()),
            _ => None,
        }
    }
}
