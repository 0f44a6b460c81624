use crate::extras::{self, Extras, MAX_BESIDE};
use crate::Error;

const HEAD: usize = 16;
/// Where the sizes of mask and extras are.
const AT_MASK: usize = 12;
const AT_EXTRAS: usize = 14;

/// RL-Glue's abstract type, which observations and actions are: three runs of numbers, each of any length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AbstractType {
    /// 32-bit integers.
    pub ints: Vec<i32>,
    /// Floating point numbers.
    pub doubles: Vec<f64>,
    /// Bytes.
    pub chars: Vec<u8>,
    /// Beside an observation: which values of the next action are legal, as [`legal`](Self::legal) numbers them; empty if
    /// all are. As received it is filled up with false to a multiple of 8. An environment with masks has the word `masks`
    /// in its task spec's EXTRA.
    pub mask: Vec<bool>,
    /// Beside an observation: named values for everyone but the agent, whose observations have none.
    pub extras: Extras,
}

/// What an environment shows of its state.
pub type Observation = AbstractType;

/// What an agent does: nothing is beside it, neither a mask nor extras.
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
    /// Returns whether a value of the next action is legal: all are, unless there is a mask. The values of its ints are
    /// numbered from 0, one int after another, each from its minimum: after an int from 0 to 2, 3 is the minimum of the
    /// next.
    pub fn legal(&self, value: usize) -> bool {
        self.mask.is_empty() || self.mask.get(value) == Some(&true)
    }

    /// Appends an observation, and what is beside it, as it crosses the wire.
    pub(crate) fn write_observation(&self, body: &mut Vec<u8>) -> Result<(), Error> {
        let start = body.len();
        self.write(body);
        let extras = extras::pack(&self.extras)?;
        let size = (self.mask.len() + 7) / 8;
        if size > MAX_BESIDE {
            let text = format!("a mask has at most {} values, not {}", 8 * MAX_BESIDE, self.mask.len());
            return Err(Error::Beside(text));
        }
        body[start + AT_MASK..][..2].copy_from_slice(&(size as u16).to_le_bytes());
        body[start + AT_EXTRAS..][..2].copy_from_slice(&(extras.len() as u16).to_le_bytes());
        let byte = |bits: &[bool]| bits.iter().enumerate().map(|(i, legal)| u8::from(*legal) << i).sum::<u8>();
        body.extend(self.mask.chunks(8).map(byte));
        body.extend_from_slice(&extras);
        Ok(())
    }

    /// Appends an action as it crosses the wire.
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
    pub(crate) fn read<'a>(&mut self, body: &'a [u8]) -> Result<&'a [u8], Error> {
        let (ints, doubles, chars) = (count(body, 0), count(body, 4), count(body, 8));
        let (of_doubles, rest) = body[HEAD..].split_at(8 * doubles);
        let (of_ints, rest) = rest.split_at(4 * ints);
        let (of_chars, rest) = rest.split_at(chars);
        let (of_mask, rest) = rest.split_at(size(body, AT_MASK));
        let (of_extras, rest) = rest.split_at(size(body, AT_EXTRAS));
        self.doubles.clear();
        self.doubles.extend(of_doubles.chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())));
        self.ints.clear();
        self.ints.extend(of_ints.chunks_exact(4).map(|bytes| i32::from_le_bytes(bytes.try_into().unwrap())));
        self.chars.clear();
        self.chars.extend_from_slice(of_chars);
        self.mask.clear();
        self.mask.extend(of_mask.iter().flat_map(|byte| (0..8).map(move |i| byte >> i & 1 == 1)));
        self.extras = if of_extras.is_empty() { Extras::new() } else { extras::unpack(of_extras)? };
        Ok(rest)
    }
}

/// Returns what follows the abstract type that a body begins with, which may have a mask or extras.
pub(crate) fn skip(body: &[u8], with_mask: bool, with_extras: bool) -> Result<&[u8], Error> {
    if body.len() < HEAD {
        return Err(Error::Protocol(format!("an observation or action has 16 bytes or more, not {}", body.len())));
    }
    let (mask, extras) = (size(body, AT_MASK), size(body, AT_EXTRAS));
    if mask != 0 && !with_mask {
        return Err(Error::Protocol("an action has a mask".to_owned()));
    }
    if extras != 0 && !with_extras {
        return Err(Error::Protocol("an agent was sent extras, which are not for it".to_owned()));
    }
    let runs = 8 * count(body, 4) as u64 + 4 * count(body, 0) as u64 + count(body, 8) as u64;
    let size = (HEAD + mask + extras) as u64 + runs;
    if size > body.len() as u64 {
        return Err(Error::Protocol(format!(
            "an observation or action has {} bytes, and by its counts {size}",
            body.len()
        )));
    }
    Ok(&body[size as usize..])
}

/// Cuts off what is beside the observation of a body and not wanted.
pub(crate) fn cut(body: &mut Vec<u8>, with_mask: bool, with_extras: bool) {
    let (mask, extras) = (size(body, AT_MASK), size(body, AT_EXTRAS));
    if !with_extras {
        body.truncate(body.len() - extras);
        body[AT_EXTRAS..][..2].fill(0);
    }
    if !with_mask {
        let end = body.len() - size(body, AT_EXTRAS);
        body.drain(end - mask..end);
        body[AT_MASK..][..2].fill(0);
    }
}

/// Returns the size of a mask or of extras.
fn size(body: &[u8], at: usize) -> usize {
    u16::from_le_bytes(body[at..at + 2].try_into().unwrap()).into()
}

fn count(body: &[u8], at: usize) -> usize {
    u32::from_le_bytes(body[at..at + 4].try_into().unwrap()) as usize
}
