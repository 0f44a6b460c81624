//! A peer's place in a session: greetings, heartbeats, and reconnecting after a break.

use std::fs::File;
use std::io::Read;
use std::time::{Duration, Instant};

use crate::abstract_type::cut;
use crate::dealer::{Dealer, Received};
use crate::message::{decode, encode, kind, Frames, Message, Scalar, MAX_BODY};
use crate::{Error, Options};

const HEARTBEAT: Duration = Duration::from_secs(1);
const TIMEOUT: Duration = Duration::from_secs(5);
const MAX_HEARTBEAT: Duration = Duration::from_secs(60);
const MAX_TEXT: usize = 1000;
const CODEC: &str = concat!("Rust, glue-rl ", env!("CARGO_PKG_VERSION"));

pub(crate) struct Link<'a> {
    role: &'static str,
    options: &'a Options,
    capabilities: Vec<Scalar>,
    instance: Vec<u8>,
    dealer: Dealer,
    heartbeat: Duration,
    timeout: Duration,
    max_body: usize,
    /// What the hub takes beside an observation; an older one takes neither.
    takes_masks: bool,
    takes_extras: bool,
    /// The connection that was greeted last; also the `seq` of that HELLO.
    greeted: u64,
    /// Whether the hub has welcomed us over that connection.
    welcomed: bool,
    /// Whether we wait for a hub, and have said so.
    waiting: bool,
    started: Instant,
}

impl<'a> Link<'a> {
    pub(crate) fn new(role: &'static str, options: &'a Options, capabilities: &[&str]) -> Result<Self, Error> {
        check_session(&options.session)?;
        let is_set = |variable| std::env::var_os(variable).map_or(false, |value| !value.is_empty());
        if is_set("GLUE_KEY") || is_set("GLUE_HUB_KEY") {
            return Err(Error::Config(
                "this library has no encryption: unset GLUE_KEY and GLUE_HUB_KEY, or write in C++ or Python".to_owned(),
            ));
        }
        let mut instance = vec![0; 16];
        File::open("/dev/urandom")
            .and_then(|mut random| random.read_exact(&mut instance))
            .map_err(|error| Error::Config(format!("/dev/urandom cannot be read: {error}")))?;
        Ok(Link {
            role,
            options,
            capabilities: capabilities.iter().map(|name| Scalar::from(*name)).collect(),
            instance,
            dealer: Dealer::new(&options.hub)?,
            heartbeat: HEARTBEAT,
            timeout: TIMEOUT,
            max_body: MAX_BODY,
            takes_masks: false,
            takes_extras: false,
            greeted: 0,
            welcomed: false,
            waiting: false,
            started: Instant::now(),
        })
    }

    /// Returns whether the hub has welcomed us over the latest connection.
    pub(crate) fn is_welcomed(&self) -> bool {
        self.welcomed && self.dealer.is_ready() && self.dealer.connections() == self.greeted
    }

    pub(crate) fn session(&self) -> &str {
        &self.options.session
    }

    pub(crate) fn log(&self, line: &str) {
        (self.options.log)(line);
    }

    /// Cuts off what is beside an observation and not for the hub, as the hub itself does for others.
    pub(crate) fn cut(&self, body: &mut Vec<u8>, with_extras: bool) {
        cut(body, self.takes_masks, self.takes_extras && with_extras);
    }

    /// Checks that the hub accepts a body of this size.
    pub(crate) fn check(&self, body: Option<&[u8]>) -> Result<(), Error> {
        match body.map_or(0, <[u8]>::len) {
            size if size > self.max_body => Err(Error::TooLarge { size, limit: self.max_body }),
            _ => Ok(()),
        }
    }

    pub(crate) fn send(&mut self, header: &[u8], body: Option<&[u8]>) {
        self.dealer.send(header, body);
    }

    /// Returns the header of the next call, reply, ERROR, NOTICE, or WELCOME over the latest connection; none if there is
    /// none for a heartbeat.
    pub(crate) fn receive(&mut self, frames: &mut Frames) -> Result<Option<Message>, Error> {
        let received = self.dealer.receive(frames, self.heartbeat, self.timeout).and_then(|received| match received {
            Received::Message => decode(frames).map(Some),
            Received::Nothing => Ok(None),
        });
        let message = match received {
            Ok(Some(message)) => message,
            Ok(None) => {
                self.idle();
                return Ok(None);
            }
            Err(Error::Protocol(text)) => {
                let hub = &self.options.hub;
                return Err(Error::Protocol(format!("the hub at {hub} broke the protocol: {text}")));
            }
            Err(error) => return Err(error),
        };
        if message.session != self.options.session {
            if message.kind == kind::ERROR && message.session.is_empty() {
                self.log(&format!("the hub says: {}", message.text(1)));
            }
            return Ok(None);
        }
        if !message.known {
            let text = format!("this {} does not know kind {}", self.role, message.kind);
            let error = self.error(message.seq, "unknown-kind", &text);
            self.send(&error, None);
            return Ok(None);
        }
        self.control(message)
    }

    /// Says goodbye, and leaves.
    pub(crate) fn close(&mut self, reason: &str) {
        if self.is_welcomed() {
            let goodbye = encode(kind::GOODBYE, self.session(), 0, &[clip(reason).into()]);
            self.send(&goodbye, None);
        }
        self.dealer.close();
        self.welcomed = false;
    }

    /// Returns the header of the ERROR with which a player answers.
    pub(crate) fn error(&self, seq: u64, code: &str, text: &str) -> Vec<u8> {
        encode(kind::ERROR, self.session(), seq, &[code.into(), clip(text).into()])
    }

    fn control(&mut self, message: Message) -> Result<Option<Message>, Error> {
        match message.kind {
            kind::HEARTBEAT => Ok(None),
            kind::WELCOME => self.welcome(message),
            kind::REFUSE => Err(Error::Refused { code: message.text(0).to_owned(), text: message.text(1).to_owned() }),
            kind::GOODBYE => {
                self.welcomed = false; // a goodbye has no answer
                Err(Error::HubClosed(message.text(0).to_owned()))
            }
            kind::ERROR if message.text(0) == "unknown-peer" => {
                // While a HELLO is unanswered, this error is about something sent before it.
                if self.welcomed {
                    self.greet();
                }
                Ok(None)
            }
            _ => Ok(Some(message)),
        }
    }

    fn greet(&mut self) {
        self.welcomed = false;
        self.greeted = self.dealer.connections();
        let hello = [
            Scalar::Array(vec![Scalar::Int(1)]),
            self.role.into(),
            Scalar::Binary(self.instance.clone()),
            self.options.name.as_str().into(),
            CODEC.into(),
            Scalar::Array(self.capabilities.clone()),
        ];
        let hello = encode(kind::HELLO, self.session(), self.greeted, &hello);
        self.send(&hello, None);
    }

    fn welcome(&mut self, message: Message) -> Result<Option<Message>, Error> {
        // A WELCOME to an earlier HELLO may be another hub's; a second one to the same HELLO says nothing new.
        if message.seq != self.greeted || self.welcomed {
            return Ok(None);
        }
        if message.int(0) != 1 {
            return Err(Error::Protocol(format!("version {} was chosen, and 1 was offered", message.int(0))));
        }
        self.heartbeat = seconds(message.float(2)).min(MAX_HEARTBEAT);
        self.timeout = seconds(message.float(3)).max(self.heartbeat);
        self.max_body = message.int(4).min(MAX_BODY as u64) as usize;
        self.takes_masks = message.confirms("mask");
        self.takes_extras = message.confirms("extras");
        if self.waiting {
            self.log(&format!("the hub at {} is there", self.options.hub));
        }
        self.waiting = false;
        self.welcomed = true;
        Ok(Some(message))
    }

    fn idle(&mut self) {
        if let Some(reason) = self.dealer.farewell() {
            self.log(&format!("the hub at {} ends the connection: {reason}", self.options.hub));
        }
        if !self.dealer.is_ready() {
            self.welcomed = false;
        } else if self.dealer.connections() != self.greeted {
            self.greet();
            return;
        }
        if self.welcomed {
            let heartbeat = encode(kind::HEARTBEAT, self.session(), 0, &[]);
            self.send(&heartbeat, None);
        } else if !self.waiting && self.started.elapsed() > self.heartbeat {
            self.waiting = true;
            self.log(&format!(
                "no hub answers at {} yet; waiting for one (glue-hub and glue-experiment start one)",
                self.options.hub
            ));
        }
    }
}

/// Returns a time in which one can wait, whatever a hub says.
fn seconds(value: f64) -> Duration {
    Duration::from_secs_f64(if value.is_nan() { 1.0 } else { value.clamp(0.01, 1e6) })
}

fn check_session(session: &str) -> Result<(), Error> {
    if session.chars().any(char::is_control) || !(1..=255).contains(&session.chars().count()) {
        return Err(Error::Config(format!("the name of a session has 1 to 255 printable characters, not {session:?}")));
    }
    Ok(())
}

/// Returns one line of at most a thousand bytes.
fn clip(text: &str) -> &str {
    let line = text.trim().lines().next().unwrap_or_default();
    let mut end = line.len().min(MAX_TEXT);
    while !line.is_char_boundary(end) {
        end -= 1;
    }
    &line[..end]
}
