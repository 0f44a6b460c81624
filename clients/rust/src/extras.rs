//! Extras as they cross the wire: one map of msgpack, in which nothing is nested.

use std::collections::BTreeMap;

use crate::msgpack::{Reader, Type, Writer, MAX_ITEMS};
use crate::Error;

/// The largest mask, and the largest extras, in bytes.
pub(crate) const MAX_BESIDE: usize = 65_535;
const MAX_NAME: usize = 64;

/// Named values beside an observation, for everyone but the agent: at most 64, with names of 1 to 64 printable characters,
/// and 65,535 bytes in all.
pub type Extras = BTreeMap<String, Extra>;

/// A value beside an observation.
#[derive(Clone, Debug, PartialEq)]
pub enum Extra {
    /// An integer.
    Int(i64),
    /// A floating point number.
    Float(f64),
    /// A text.
    Text(String),
    /// Bytes.
    Binary(Vec<u8>),
    /// Integers.
    Ints(Vec<i64>),
    /// Floating point numbers.
    Floats(Vec<f64>),
}

impl From<i64> for Extra {
    fn from(value: i64) -> Extra {
        Extra::Int(value)
    }
}

impl From<f64> for Extra {
    fn from(value: f64) -> Extra {
        Extra::Float(value)
    }
}

impl From<&str> for Extra {
    fn from(value: &str) -> Extra {
        Extra::Text(value.to_owned())
    }
}

impl Extra {
    /// Returns a number of bytes that this does not fall short of: no item is shorter than one.
    fn least_size(&self) -> usize {
        match self {
            Extra::Int(_) | Extra::Float(_) => 1,
            Extra::Text(value) => value.len(),
            Extra::Binary(value) => value.len(),
            Extra::Ints(values) => values.len(),
            Extra::Floats(values) => values.len(),
        }
    }

    fn write(&self, to: &mut Writer) {
        match self {
            Extra::Int(value) => to.signed(*value),
            Extra::Float(value) => to.float(*value),
            Extra::Text(value) => to.text(value),
            Extra::Binary(value) => to.binary(value),
            Extra::Ints(values) => values.iter().fold(to.array(values.len()), |to, value| to.signed(*value)),
            Extra::Floats(values) => values.iter().fold(to.array(values.len()), |to, value| to.float(*value)),
        };
    }

    fn read(reader: &mut Reader<'_>) -> Result<Extra, Error> {
        match reader.next() {
            Type::Int => reader.signed().map(Extra::Int),
            Type::Float => reader.float().map(Extra::Float),
            Type::Text => reader.text().map(Extra::from),
            Type::Binary => reader.binary().map(|bytes| Extra::Binary(bytes.to_vec())),
            // No item is shorter than a byte, so nothing large is allocated for a small message.
            Type::Array => match (reader.array(reader.remaining())?, reader.next()) {
                (count, Type::Float) => numbers(reader, count, Type::Float, Reader::float).map(Extra::Floats),
                (count, _) => numbers(reader, count, Type::Int, Reader::signed).map(Extra::Ints),
            },
            Type::Other => reader.fail("has a value that is no number, text, bytes or array"),
        }
    }
}

fn numbers<'a, T>(
    reader: &mut Reader<'a>,
    count: u64,
    kind: Type,
    read: impl Fn(&mut Reader<'a>) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    let mut all = Vec::with_capacity(count as usize);
    for _ in 0..count {
        if reader.next() != kind {
            return reader.fail("has an array that is neither of ints nor of floats");
        }
        all.push(read(reader)?);
    }
    Ok(all)
}

/// Returns the bytes of extras, of which there are none if there are no extras.
pub(crate) fn pack(extras: &Extras) -> Result<Vec<u8>, Error> {
    let mut writer = Writer::default();
    if extras.is_empty() {
        return Ok(writer.bytes);
    }
    if extras.len() as u64 > MAX_ITEMS {
        return Err(Error::Beside(format!("an observation has at most {MAX_ITEMS} extras, not {}", extras.len())));
    }
    let size: usize = extras.values().map(Extra::least_size).sum();
    if size <= MAX_BESIDE {
        writer.map(extras.len());
        for (name, value) in extras {
            if !is_name(name) {
                let text = format!("the name of an extra has 1 to {MAX_NAME} printable characters, not {name:?}");
                return Err(Error::Beside(text));
            }
            value.write(writer.text(name));
        }
    }
    match size.max(writer.bytes.len()) {
        size if size > MAX_BESIDE => {
            Err(Error::Beside(format!("the extras of an observation have at most {MAX_BESIDE} bytes, not {size}")))
        }
        _ => Ok(writer.bytes),
    }
}

/// Returns the extras that were received.
pub(crate) fn unpack(packed: &[u8]) -> Result<Extras, Error> {
    let mut extras = Extras::new();
    let mut reader = Reader::new(packed, "a map of extras");
    for _ in 0..reader.map()? {
        let name = reader.text()?.to_owned();
        if !is_name(&name) {
            return reader.fail("has a name that is not 1 to 64 printable characters");
        }
        if extras.insert(name, Extra::read(&mut reader)?).is_some() {
            return reader.fail("has a name twice");
        }
    }
    reader.end()?;
    Ok(extras)
}

fn is_name(name: &str) -> bool {
    !name.chars().any(char::is_control) && (1..=MAX_NAME).contains(&name.chars().count())
}
