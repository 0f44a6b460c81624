use crate::Error;

const HEAD: usize = 16;

/// RL-Glue's abstract type, which observations and actions are: three runs of numbers, each of any length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AbstractType {
    /// 32-bit integers.
    pub ints: Vec<i32>,
    /// Floating point numbers.
    pub doubles: Vec<f64>,
    /// Bytes.
    pub chars: Vec<u8>,
}

/// What an environment shows of its state.
pub type Observation = AbstractType;

/// What an agent does.
pub type Action = AbstractType;

impl<const N: usize> From<[i32; N]> for AbstractType {
    /// Makes one of ints alone.
    fn from(ints: [i32; N]) -> Self {
        Vec::from(ints).into()
    }
}

impl From<Vec<i32>> for AbstractType {
    /// Makes one of ints alone.
    fn from(ints: Vec<i32>) -> Self {
        AbstractType { ints, ..AbstractType::default() }
    }
}

impl AbstractType {
    /// Appends this as it crosses the wire.
    pub(crate) fn write(&self, body: &mut Vec<u8>) {
        let counts = [self.ints.len(), self.doubles.len(), self.chars.len(), 0];
        for count in counts {
            // A run of more than 2^32 is far beyond the hub's limit, and refused for that.
            body.extend_from_slice(&(count as u32).to_le_bytes());
        }
        for value in &self.doubles {
            body.extend_from_slice(&value.to_le_bytes());
        }
        for value in &self.ints {
            body.extend_from_slice(&value.to_le_bytes());
        }
        body.extend_from_slice(&self.chars);
    }

    /// Becomes the abstract type that a body begins with, whose size has been checked; returns the rest.
    pub(crate) fn read<'a>(&mut self, body: &'a [u8]) -> &'a [u8] {
        let (ints, doubles, chars) = (count(body, 0), count(body, 4), count(body, 8));
        let (of_doubles, rest) = body[HEAD..].split_at(8 * doubles);
        let (of_ints, rest) = rest.split_at(4 * ints);
        let (of_chars, rest) = rest.split_at(chars);
        self.doubles.clear();
        self.doubles.extend(of_doubles.chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())));
        self.ints.clear();
        self.ints.extend(of_ints.chunks_exact(4).map(|bytes| i32::from_le_bytes(bytes.try_into().unwrap())));
        self.chars.clear();
        self.chars.extend_from_slice(of_chars);
        rest
    }
}

/// Returns what follows the abstract type that a body begins with.
pub(crate) fn skip(body: &[u8]) -> Result<&[u8], Error> {
    if body.len() < HEAD {
        return Err(Error::Protocol(format!("an observation or action has 16 bytes or more, not {}", body.len())));
    }
    if count(body, 12) != 0 {
        return Err(Error::Protocol("bytes 12 to 15 of an observation or action are zero".to_owned()));
    }
    let size = HEAD as u64 + 8 * count(body, 4) as u64 + 4 * count(body, 0) as u64 + count(body, 8) as u64;
    if size > body.len() as u64 {
        return Err(Error::Protocol(format!(
            "an observation or action has {} bytes, and by its counts {size}",
            body.len()
        )));
    }
    Ok(&body[size as usize..])
}

fn count(body: &[u8], at: usize) -> usize {
    u32::from_le_bytes(body[at..at + 4].try_into().unwrap()) as usize
}
