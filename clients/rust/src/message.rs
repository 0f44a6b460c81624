//! Every kind of message: docs/protocol-reference.md, "Every kind of message".

use crate::abstract_type::skip;
use crate::msgpack::{Reader, Writer, MAX_ITEMS};
use crate::Error;

pub(crate) const MAX_HEADER: usize = 4096;
pub(crate) const MAX_BODY: usize = 16_777_216;
const MAX_SESSION: usize = 255;

/// The codes of the kinds.
#[rustfmt::skip]
pub(crate) mod kind {
    pub(crate) const AGENT_INIT: u64 = 4;
    pub(crate) const AGENT_START: u64 = 5;
    pub(crate) const AGENT_STEP: u64 = 6;
    pub(crate) const AGENT_END: u64 = 7;
    pub(crate) const AGENT_CLEANUP: u64 = 8;
    pub(crate) const AGENT_MESSAGE: u64 = 10;
    pub(crate) const AGENT_SEED: u64 = 80;
    pub(crate) const AGENT_SAVE: u64 = 81;
    pub(crate) const AGENT_LOAD: u64 = 82;
    pub(crate) const AGENT_METRICS: u64 = 86;

    pub(crate) const ENV_INIT: u64 = 11;
    pub(crate) const ENV_START: u64 = 12;
    pub(crate) const ENV_STEP: u64 = 13;
    pub(crate) const ENV_CLEANUP: u64 = 14;
    pub(crate) const ENV_MESSAGE: u64 = 19;
    pub(crate) const ENV_SEED: u64 = 83;
    pub(crate) const ENV_SAVE: u64 = 84;
    pub(crate) const ENV_LOAD: u64 = 85;

    pub(crate) const RL_INIT: u64 = 20;
    pub(crate) const RL_START: u64 = 21;
    pub(crate) const RL_STEP: u64 = 22;
    pub(crate) const RL_CLEANUP: u64 = 23;
    pub(crate) const RL_RETURN: u64 = 24;
    pub(crate) const RL_NUM_STEPS: u64 = 25;
    pub(crate) const RL_NUM_EPISODES: u64 = 26;
    pub(crate) const RL_EPISODE: u64 = 27;
    pub(crate) const RL_AGENT_MESSAGE: u64 = 33;
    pub(crate) const RL_ENV_MESSAGE: u64 = 34;
    pub(crate) const RL_ENV_START: u64 = 36;
    pub(crate) const RL_ENV_STEP: u64 = 37;
    pub(crate) const RL_AGENT_START: u64 = 38;
    pub(crate) const RL_AGENT_STEP: u64 = 39;
    pub(crate) const RL_AGENT_END: u64 = 40;
    pub(crate) const RL_AGENT_SAVE: u64 = 90;
    pub(crate) const RL_AGENT_LOAD: u64 = 91;
    pub(crate) const RL_ENV_SAVE: u64 = 92;
    pub(crate) const RL_ENV_LOAD: u64 = 93;
    pub(crate) const RL_AGENT_METRICS: u64 = 94;

    pub(crate) const HELLO: u64 = 64;
    pub(crate) const WELCOME: u64 = 65;
    pub(crate) const REFUSE: u64 = 66;
    pub(crate) const HEARTBEAT: u64 = 67;
    pub(crate) const GOODBYE: u64 = 68;
    pub(crate) const ERROR: u64 = 69;
    pub(crate) const NOTICE: u64 = 70;
}

/// Instead of a bool, that an episode was cut off in a state that is not terminal.
pub(crate) const CUT_OFF: u64 = 2;

/// One item of a header.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Scalar {
    Nil,
    Int(u64),
    Float(f64),
    Bool(bool),
    Text(String),
    Binary(Vec<u8>),
    Array(Vec<Scalar>),
}

impl Scalar {
    /// Returns how an integer that is written for the end of an episode is read.
    pub(crate) fn end(flag: i128) -> Scalar {
        if flag == i128::from(CUT_OFF) {
            Scalar::Int(CUT_OFF)
        } else {
            Scalar::Bool(flag != 0)
        }
    }
}

impl From<&str> for Scalar {
    fn from(text: &str) -> Scalar {
        Scalar::Text(text.to_owned())
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Type {
    Int,
    Float,
    Bool,
    /// A bool, or [`CUT_OFF`].
    End,
    Text,
    /// An array of texts, which may be missing.
    Texts,
    /// Two floats, which may be missing.
    Pace,
}

#[derive(Clone, Copy, PartialEq)]
enum Body {
    None,
    /// A text or bytes.
    Bytes,
    Action,
    /// An observation without extras, as agents see it.
    Seen,
    Observation,
    /// An observation and an action.
    Both,
}

/// The two frames of a message, kept from one message to the next.
#[derive(Clone, Default, PartialEq)]
pub(crate) struct Frames {
    pub(crate) header: Vec<u8>,
    pub(crate) body: Option<Vec<u8>>,
}

/// The header of a message from the hub. A kind that is not `known` has no scalars.
#[derive(Debug)]
pub(crate) struct Message {
    pub(crate) kind: u64,
    pub(crate) session: String,
    pub(crate) seq: u64,
    pub(crate) scalars: Vec<Scalar>,
    pub(crate) known: bool,
}

impl Message {
    pub(crate) fn int(&self, scalar: usize) -> u64 {
        match self.scalars[scalar] {
            Scalar::Int(value) => value,
            _ => unreachable!("decode has checked that it is an int"),
        }
    }

    pub(crate) fn float(&self, scalar: usize) -> f64 {
        match self.scalars[scalar] {
            Scalar::Float(value) => value,
            _ => unreachable!("decode has checked that it is a float"),
        }
    }

    /// Returns a bool, or whether an episode is over.
    pub(crate) fn bool(&self, scalar: usize) -> bool {
        self.scalars[scalar] != Scalar::Bool(false)
    }

    /// Returns whether an episode is over because it was cut off.
    pub(crate) fn is_cut_off(&self, scalar: usize) -> bool {
        self.scalars[scalar] == Scalar::Int(CUT_OFF)
    }

    /// Returns whether a WELCOME confirms a capability; an older hub confirms none.
    pub(crate) fn confirms(&self, capability: &str) -> bool {
        matches!(self.scalars.get(5), Some(Scalar::Array(all)) if all.contains(&capability.into()))
    }

    pub(crate) fn text(&self, scalar: usize) -> &str {
        match &self.scalars[scalar] {
            Scalar::Text(value) => value,
            _ => unreachable!("decode has checked that it is a text"),
        }
    }
}

/// Returns what a kind carries when it comes from the hub.
fn from_hub(kind: u64) -> Option<(&'static [Type], Body)> {
    use kind::*;
    use Type::{Bool, End, Float, Int, Pace, Text, Texts};
    Some(match kind {
        ENV_INIT | ENV_START | ENV_CLEANUP | ENV_SAVE | AGENT_CLEANUP | AGENT_SAVE | RL_CLEANUP | RL_AGENT_END
        | RL_AGENT_LOAD | RL_ENV_LOAD | AGENT_METRICS | HEARTBEAT => (&[], Body::None),
        AGENT_INIT | AGENT_MESSAGE | AGENT_LOAD | ENV_MESSAGE | ENV_LOAD | RL_INIT | RL_AGENT_MESSAGE
        | RL_ENV_MESSAGE | RL_AGENT_SAVE | RL_ENV_SAVE => (&[], Body::Bytes),
        ENV_STEP | RL_AGENT_START | RL_AGENT_STEP | RL_AGENT_METRICS => (&[], Body::Action),
        AGENT_START => (&[], Body::Seen),
        AGENT_STEP => (&[Float, Pace], Body::Seen),
        RL_ENV_START => (&[], Body::Observation),
        RL_ENV_STEP => (&[Float, End], Body::Observation),
        RL_START => (&[], Body::Both),
        RL_STEP => (&[Float, End], Body::Both),
        AGENT_END | RL_RETURN => (&[Float], Body::None),
        AGENT_SEED | ENV_SEED | RL_NUM_STEPS | RL_NUM_EPISODES => (&[Int], Body::None),
        RL_EPISODE => (&[End], Body::None),
        WELCOME => (&[Int, Bool, Float, Float, Int, Texts], Body::None),
        GOODBYE => (&[Text], Body::None),
        REFUSE | ERROR => (&[Text, Text], Body::None),
        NOTICE => (&[Text, Text, Text], Body::None),
        _ => return None,
    })
}

/// Returns the header of a message to the hub.
pub(crate) fn encode(kind: u64, session: &str, seq: u64, scalars: &[Scalar]) -> Vec<u8> {
    let mut header = Writer { bytes: Vec::with_capacity(32 + session.len()) };
    header.array(3 + scalars.len()).int(kind).text(session).int(seq);
    scalars.iter().for_each(|scalar| write(&mut header, scalar));
    header.bytes
}

fn write(header: &mut Writer, scalar: &Scalar) {
    match scalar {
        Scalar::Nil => header.nil(),
        Scalar::Int(value) => header.int(*value),
        Scalar::Float(value) => header.float(*value),
        Scalar::Bool(value) => header.bool(*value),
        Scalar::Text(value) => header.text(value),
        Scalar::Binary(value) => header.binary(value),
        Scalar::Array(items) => {
            header.array(items.len());
            items.iter().for_each(|item| write(header, item));
            header
        }
    };
}

/// Returns what frames from the hub say, or what is wrong with them.
pub(crate) fn decode(frames: &Frames) -> Result<Message, Error> {
    if frames.header.len() > MAX_HEADER {
        let size = frames.header.len();
        return Err(Error::Protocol(format!("a header has at most {MAX_HEADER} bytes, not {size}")));
    }
    let mut reader = Reader::new(&frames.header, "a header");
    let items = reader.array(MAX_ITEMS)?;
    let kind = reader.int()?;
    let session = reader.text()?.to_owned();
    let seq = reader.int()?;
    if session.len() > MAX_SESSION && session.chars().count() > MAX_SESSION {
        return Err(Error::Protocol(format!("the name of a session has more than {MAX_SESSION} characters")));
    }
    let (types, body) = match from_hub(kind) {
        Some(shape) => shape,
        None => return Ok(Message { kind, session, seq, scalars: Vec::new(), known: false }),
    };
    let mut scalars = Vec::with_capacity(types.len());
    for each in types {
        let scalar = match each {
            Type::Int => Scalar::Int(reader.int()?),
            Type::Float => Scalar::Float(reader.float()?),
            Type::Bool => Scalar::Bool(reader.flag()? != 0),
            Type::End => Scalar::end(reader.flag()?),
            Type::Text => Scalar::Text(reader.text()?.to_owned()),
            Type::Texts | Type::Pace if items == 3 + scalars.len() as u64 => break,
            Type::Pace => {
                scalars.push(Scalar::Float(reader.float()?));
                Scalar::Float(reader.float()?)
            }
            Type::Texts => {
                let count = reader.array(MAX_ITEMS)?;
                Scalar::Array((0..count).map(|_| reader.text().map(Scalar::from)).collect::<Result<_, _>>()?)
            }
        };
        scalars.push(scalar);
    }
    reader.end()?;
    check(kind, body, frames.body.as_deref())?;
    Ok(Message { kind, session, seq, scalars, known: true })
}

fn check(kind: u64, expected: Body, body: Option<&[u8]>) -> Result<(), Error> {
    let rest = match (expected, body) {
        (Body::None, None) | (Body::Bytes, Some(_)) => return Ok(()),
        (Body::None, Some(_)) => return Err(Error::Protocol(format!("kind {kind} has no body, and came with one"))),
        (_, None) => return Err(Error::Protocol(format!("kind {kind} has a body, and came without one"))),
        (Body::Action, Some(body)) => skip(body, false, false)?,
        (Body::Seen, Some(body)) => skip(body, true, false)?,
        (Body::Observation, Some(body)) => skip(body, true, true)?,
        (Body::Both, Some(body)) => skip(skip(body, true, true)?, false, false)?,
    };
    if !rest.is_empty() {
        return Err(Error::Protocol(format!("the body of kind {kind} is longer than its counts say")));
    }
    Ok(())
}
