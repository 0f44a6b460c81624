//! ZMTP 3.1 with the NULL mechanism, as the last appendix of docs/protocol-reference.md says: bytes, no sockets.

use crate::message::MAX_HEADER;
use crate::message::{Frames, MAX_BODY};
use crate::Error;

pub(crate) const MORE: u8 = 1;
const LONG: u8 = 2;
pub(crate) const COMMAND: u8 = 4;

const GREETING_SIZE: usize = 64;
const MAX_COMMAND: usize = 4096;
/// An observation and an action.
const MAX_FRAME: usize = 2 * MAX_BODY;
const SMALL: usize = 1 << 16;

/// What DEALERs say after the greeting.
pub(crate) const READY: &[u8] = b"\x05READY\x0bSocket-Type\0\0\0\x06DEALER\x08Identity\0\0\0\0";

/// Returns the bytes with which either side begins.
pub(crate) fn greeting() -> [u8; GREETING_SIZE] {
    let mut bytes = [0; GREETING_SIZE];
    bytes[0] = 0xff;
    bytes[9] = 0x7f;
    bytes[10] = 3;
    bytes[11] = 1;
    bytes[12..16].copy_from_slice(b"NULL");
    bytes
}

/// Appends a frame with its flags and length.
pub(crate) fn put_frame(to: &mut Vec<u8>, flags: u8, frame: &[u8]) {
    if frame.len() < 256 {
        to.extend_from_slice(&[flags, frame.len() as u8]);
    } else {
        to.push(flags | LONG);
        to.extend_from_slice(&(frame.len() as u64).to_be_bytes());
    }
    to.extend_from_slice(frame);
}

/// What comes of received bytes.
#[derive(Debug, PartialEq)]
pub(crate) enum Item {
    /// A greeting that was right.
    Greeting,
    /// A command: its name and what follows it.
    Command(Vec<u8>, Vec<u8>),
    /// A message, which is in the frames that were passed.
    Message,
}

/// Takes what a hub sends in pieces of any size, and makes messages and commands of it.
pub(crate) struct FrameReader {
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    greeted: bool,
    /// Whether the first frame of a message of two is there.
    more: bool,
}

impl FrameReader {
    pub(crate) fn new() -> Self {
        FrameReader { buffer: vec![0; SMALL], start: 0, end: 0, greeted: false, more: false }
    }

    /// Returns where to put the next bytes; `received` says how many were put.
    pub(crate) fn room(&mut self) -> &mut [u8] {
        if self.start == self.end {
            self.start = 0;
            self.end = 0;
            self.buffer.truncate(SMALL);
            self.buffer.shrink_to(SMALL);
        } else if self.end == self.buffer.len() {
            // The bytes here belong to a frame whose length has been checked.
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
            if self.end > self.buffer.len() / 2 {
                self.buffer.resize(2 * self.buffer.len(), 0);
            }
        }
        &mut self.buffer[self.end..]
    }

    pub(crate) fn received(&mut self, count: usize) {
        self.end += count;
    }

    /// Returns what comes next, or none if more bytes are needed for it. The frames of a message go to `frames`.
    pub(crate) fn next(&mut self, frames: &mut Frames) -> Result<Option<Item>, Error> {
        if !self.greeted {
            return if self.end < GREETING_SIZE { Ok(None) } else { self.greet().map(Some) };
        }
        loop {
            let bytes = &self.buffer[self.start..self.end];
            let flags = match bytes.first() {
                Some(flags) => *flags,
                None => return Ok(None),
            };
            let (head, length) = if flags & LONG == 0 {
                (2, bytes.get(1).map(|length| u64::from(*length)))
            } else {
                (9, bytes.get(1..9).map(|length| u64::from_be_bytes(length.try_into().unwrap())))
            };
            let length = match length {
                Some(length) => self.check(flags, length)?,
                None => return Ok(None),
            };
            let data = match bytes.get(head..head + length) {
                Some(data) => data,
                None => return Ok(None),
            };
            self.start += head + length;
            if flags & COMMAND != 0 {
                let end = data.first().map_or(0, |length| data.len().min(1 + usize::from(*length)));
                let name = data.get(1..end).unwrap_or_default().to_vec();
                return Ok(Some(Item::Command(name, data[end..].to_vec())));
            }
            if self.more {
                copy(frames.body.get_or_insert_with(Vec::new), data);
            } else {
                copy(&mut frames.header, data);
                if flags & MORE == 0 {
                    frames.body = None;
                }
            }
            self.more = flags & MORE != 0;
            if !self.more {
                return Ok(Some(Item::Message));
            }
        }
    }

    fn greet(&mut self) -> Result<Item, Error> {
        let greeting = &self.buffer[..GREETING_SIZE];
        if greeting[0] != 0xff || greeting[9] & 1 == 0 || greeting[10] < 3 {
            return Err(Error::Protocol("it does not speak ZMTP 3: is this the address of a hub?".to_owned()));
        }
        let mechanism = String::from_utf8_lossy(&greeting[12..32]);
        let mechanism = mechanism.trim_end_matches('\0');
        if mechanism != "NULL" {
            return Err(Error::Config(format!(
                "the hub wants {mechanism}, and this library has no encryption: use another of its addresses"
            )));
        }
        self.start = GREETING_SIZE;
        self.greeted = true;
        Ok(Item::Greeting)
    }

    fn check(&self, flags: u8, length: u64) -> Result<usize, Error> {
        let command = flags & COMMAND != 0;
        if flags > MORE | LONG | COMMAND || (command && flags & MORE != 0) {
            return Err(Error::Protocol(format!("a frame has the flags {flags}, which do not exist")));
        }
        if self.more && !command && flags & MORE != 0 {
            return Err(Error::Protocol("a message has more than two frames".to_owned()));
        }
        let most = match (command, self.more) {
            (true, _) => MAX_COMMAND,
            (false, false) => MAX_HEADER,
            (false, true) => MAX_FRAME,
        };
        if length > most as u64 {
            return Err(Error::Protocol(format!("a frame has {length} bytes, and {most} are allowed")));
        }
        Ok(length as usize)
    }
}

/// Makes `to` a copy of `from`, and keeps little more room than that.
fn copy(to: &mut Vec<u8>, from: &[u8]) {
    to.clear();
    if to.capacity() > SMALL {
        to.shrink_to(from.len());
    }
    to.extend_from_slice(from);
}
