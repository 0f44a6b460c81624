//! As much of msgpack as headers, which are arrays, and extras, which are maps, need: read and written item by item.

use crate::Error;

pub(crate) const MAX_ITEMS: u64 = 64;
const MAX_EXACT: i128 = 1 << 53;

/// Writes items, one after another.
#[derive(Default)]
pub(crate) struct Writer {
    pub(crate) bytes: Vec<u8>,
}

impl Writer {
    pub(crate) fn array(&mut self, items: usize) -> &mut Self {
        if items < 16 {
            self.bytes.push(0x90 | items as u8);
        } else {
            self.bytes.push(0xdc);
            self.bytes.extend_from_slice(&(items as u16).to_be_bytes());
        }
        self
    }

    /// Begins a map of up to 65,535 items, each a key and a value.
    pub(crate) fn map(&mut self, items: usize) -> &mut Self {
        if items < 16 {
            self.bytes.push(0x80 | items as u8);
        } else {
            self.bytes.push(0xde);
            self.bytes.extend_from_slice(&(items as u16).to_be_bytes());
        }
        self
    }

    pub(crate) fn int(&mut self, value: u64) -> &mut Self {
        if value < 0x80 {
            self.bytes.push(value as u8);
        } else {
            let power = match value {
                0..=0xff => 0,
                0x100..=0xffff => 1,
                0x1_0000..=0xffff_ffff => 2,
                _ => 3,
            };
            self.bytes.push(0xcc + power);
            self.bytes.extend_from_slice(&value.to_be_bytes()[8 - (1 << power)..]);
        }
        self
    }

    pub(crate) fn signed(&mut self, value: i64) -> &mut Self {
        let power = match value {
            0.. => return self.int(value as u64),
            -32..=-1 => {
                self.bytes.push(value as u8);
                return self;
            }
            -0x80..=-33 => 0,
            -0x8000..=-0x81 => 1,
            -0x8000_0000..=-0x8001 => 2,
            _ => 3,
        };
        self.bytes.push(0xd0 + power);
        self.bytes.extend_from_slice(&value.to_be_bytes()[8 - (1 << power)..]);
        self
    }

    pub(crate) fn float(&mut self, value: f64) -> &mut Self {
        self.bytes.push(0xcb);
        self.bytes.extend_from_slice(&value.to_be_bytes());
        self
    }

    pub(crate) fn bool(&mut self, value: bool) -> &mut Self {
        self.bytes.push(if value { 0xc3 } else { 0xc2 });
        self
    }

    pub(crate) fn nil(&mut self) -> &mut Self {
        self.bytes.push(0xc0);
        self
    }

    pub(crate) fn text(&mut self, value: &str) -> &mut Self {
        match value.len() {
            0..=31 => self.bytes.push(0xa0 | value.len() as u8),
            32..=255 => self.bytes.extend_from_slice(&[0xd9, value.len() as u8]),
            _ => {
                self.bytes.push(0xda);
                self.bytes.extend_from_slice(&(value.len() as u16).to_be_bytes());
            }
        }
        self.bytes.extend_from_slice(value.as_bytes());
        self
    }

    /// Writes up to 65,535 bytes.
    pub(crate) fn binary(&mut self, value: &[u8]) -> &mut Self {
        if value.len() < 0x100 {
            self.bytes.extend_from_slice(&[0xc4, value.len() as u8]);
        } else {
            self.bytes.push(0xc5);
            self.bytes.extend_from_slice(&(value.len() as u16).to_be_bytes());
        }
        self.bytes.extend_from_slice(value);
        self
    }
}

/// What an item is.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Type {
    Int,
    Float,
    Text,
    Binary,
    Array,
    Other,
}

/// Reads items, one after another; anything but what is asked for is an error.
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    what: &'static str,
    /// Items that have not been read.
    left: u64,
}

impl<'a> Reader<'a> {
    /// Reads `bytes`, which errors call `what`.
    pub(crate) fn new(bytes: &'a [u8], what: &'static str) -> Self {
        Reader { bytes, what, left: 1 }
    }

    /// Returns the type of the next item, and reads nothing.
    pub(crate) fn next(&self) -> Type {
        match self.bytes.first() {
            Some(0x00..=0x7f | 0xcc..=0xd3 | 0xe0..=0xff) => Type::Int,
            Some(0xca | 0xcb) => Type::Float,
            Some(0xa0..=0xbf | 0xd9..=0xdb) => Type::Text,
            Some(0xc4..=0xc6) => Type::Binary,
            Some(0x90..=0x9f | 0xdc | 0xdd) => Type::Array,
            _ => Type::Other,
        }
    }

    /// Returns how many bytes have not been read, which is no less than the number of items.
    pub(crate) fn remaining(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Returns the number of items of an array, whose items come next.
    pub(crate) fn array(&mut self, most: u64) -> Result<u64, Error> {
        let items = match self.tag()? {
            tag @ 0x90..=0x9f => u64::from(tag & 0x0f),
            0xdc => self.unsigned(2)?,
            0xdd => self.unsigned(4)?,
            tag => return self.unexpected("an array", tag),
        };
        self.items(items, most, 1)
    }

    /// Returns the number of items of a map; of each the key comes next, and then the value.
    pub(crate) fn map(&mut self) -> Result<u64, Error> {
        let items = match self.tag()? {
            tag @ 0x80..=0x8f => u64::from(tag & 0x0f),
            0xde => self.unsigned(2)?,
            0xdf => self.unsigned(4)?,
            tag => return self.unexpected("a map", tag),
        };
        self.items(items, MAX_ITEMS, 2)
    }

    pub(crate) fn int(&mut self) -> Result<u64, Error> {
        let tag = self.tag()?;
        match self.integer(tag)? {
            Some(value) if (0..1 << 63).contains(&value) => Ok(value as u64),
            Some(value) => self.fail(&format!("has the integer {value}, and they are from 0 to 2^63 - 1")),
            None => self.unexpected("an integer", tag),
        }
    }

    pub(crate) fn signed(&mut self) -> Result<i64, Error> {
        let tag = self.tag()?;
        match self.integer(tag)?.map(i64::try_from) {
            Some(Ok(value)) => Ok(value),
            Some(Err(_)) => self.fail("has an integer beyond 2^63 - 1"),
            None => self.unexpected("an integer", tag),
        }
    }

    pub(crate) fn float(&mut self) -> Result<f64, Error> {
        match self.tag()? {
            0xcb => Ok(f64::from_bits(self.unsigned(8)?)),
            0xca => Ok(f64::from(f32::from_bits(self.unsigned(4)? as u32))),
            tag => match self.integer(tag)? {
                Some(value) if (-MAX_EXACT..=MAX_EXACT).contains(&value) => Ok(value as f64),
                Some(value) => self.fail(&format!("has {value} for a float, which may be an integer up to 2^53")),
                None => self.unexpected("a float", tag),
            },
        }
    }

    /// Reads a bool, which may be an integer: all but 0 are true.
    pub(crate) fn flag(&mut self) -> Result<i128, Error> {
        match self.tag()? {
            0xc2 => Ok(0),
            0xc3 => Ok(1),
            tag => match self.integer(tag)? {
                Some(value) => Ok(value),
                None => self.unexpected("a bool", tag),
            },
        }
    }

    pub(crate) fn text(&mut self) -> Result<&'a str, Error> {
        let size = match self.tag()? {
            tag @ 0xa0..=0xbf => u64::from(tag & 0x1f),
            0xd9 => self.unsigned(1)?,
            0xda => self.unsigned(2)?,
            0xdb => self.unsigned(4)?,
            tag => return self.unexpected("a text", tag),
        };
        let utf8 = self.take(size as usize)?;
        std::str::from_utf8(utf8).or_else(|_| self.fail("has a text that is not UTF-8"))
    }

    pub(crate) fn binary(&mut self) -> Result<&'a [u8], Error> {
        let size = match self.tag()? {
            tag @ 0xc4..=0xc6 => self.unsigned(1 << (tag - 0xc4))?,
            tag => return self.unexpected("bytes", tag),
        };
        self.take(size as usize)
    }

    /// Checks that nothing follows.
    pub(crate) fn end(&self) -> Result<(), Error> {
        if self.left != 0 || !self.bytes.is_empty() {
            return self.fail("has more items than it should have");
        }
        Ok(())
    }

    pub(crate) fn fail<T>(&self, text: &str) -> Result<T, Error> {
        Err(Error::Protocol(format!("{} {text}", self.what)))
    }

    fn unexpected<T>(&self, expected: &str, tag: u8) -> Result<T, Error> {
        self.fail(&format!("has the byte {tag:#04x} where {expected} was expected"))
    }

    fn items(&mut self, items: u64, most: u64, each: u64) -> Result<u64, Error> {
        if items > most {
            return self.fail(&format!("has an array or a map of {items} items, and at most {most} are allowed"));
        }
        self.left += each * items;
        Ok(items)
    }

    fn tag(&mut self) -> Result<u8, Error> {
        if self.left == 0 {
            return self.fail("has fewer items than it should have");
        }
        self.left -= 1;
        Ok(self.take(1)?[0])
    }

    /// Returns the integer that a tag begins, or none if it begins another type.
    fn integer(&mut self, tag: u8) -> Result<Option<i128>, Error> {
        Ok(Some(match tag {
            0..=0x7f => i128::from(tag),
            0xe0..=0xff => i128::from(tag as i8),
            0xcc => i128::from(self.unsigned(1)?),
            0xcd => i128::from(self.unsigned(2)?),
            0xce => i128::from(self.unsigned(4)?),
            0xcf => i128::from(self.unsigned(8)?),
            0xd0 => i128::from(self.unsigned(1)? as i8),
            0xd1 => i128::from(self.unsigned(2)? as i16),
            0xd2 => i128::from(self.unsigned(4)? as i32),
            0xd3 => i128::from(self.unsigned(8)? as i64),
            _ => return Ok(None),
        }))
    }

    fn unsigned(&mut self, size: usize) -> Result<u64, Error> {
        Ok(self.take(size)?.iter().fold(0, |value, byte| value << 8 | u64::from(*byte)))
    }

    fn take(&mut self, size: usize) -> Result<&'a [u8], Error> {
        if size > self.bytes.len() {
            return self.fail("ends in the middle of an item");
        }
        let (taken, rest) = self.bytes.split_at(size);
        self.bytes = rest;
        Ok(taken)
    }
}
