//! The masks that a task spec has room for.

use crate::extras::MAX_BESIDE;
use crate::Error;

/// Returns the number of values of each int of an action; nothing if the task spec does not say all in whole numbers.
pub(crate) fn sizes(task_spec: &str) -> Vec<usize> {
    known_sizes(&task_spec.to_ascii_uppercase()).unwrap_or_default()
}

fn known_sizes(task_spec: &str) -> Option<Vec<usize>> {
    let actions = task_spec.split_once("ACTIONS")?.1.split("REWARDS").next()?;
    let mut rest = actions.split_once("INTS")?.1.trim_start();
    let mut sizes = Vec::new();
    while let Some(range) = rest.strip_prefix('(') {
        let (words, after) = range.split_once(')')?;
        let words: Vec<i64> = words.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
        let (count, low, high) = match words[..] {
            [low, high] => (1, low, high),
            [count, low, high] => (usize::try_from(count).ok()?, low, high),
            _ => return None,
        };
        let size = high.checked_sub(low).filter(|size| (0..1 << 32).contains(size))? + 1;
        if sizes.len() + count > 8 * MAX_BESIDE {
            return None;
        }
        sizes.resize(sizes.len() + count, size as usize);
        rest = after.trim_start();
    }
    Some(sizes)
}

/// Checks that the mask of an observation fits ints of so many values, of which each has a legal one; none are known if
/// `sizes` is empty.
pub(crate) fn check(method: &str, mask: &[bool], sizes: &[usize]) -> Result<(), Error> {
    let fail = |why: String| {
        Err(Error::Beside(format!("{method} returned an observation whose mask does not fit the task spec: {why}")))
    };
    if mask.is_empty() || sizes.is_empty() {
        return Ok(());
    }
    let values: usize = sizes.iter().sum();
    let fits = mask.len() >= values && mask.len() <= (values + 7) / 8 * 8;
    if !fits || mask.iter().skip(values).any(|legal| *legal) {
        return fail(format!("it is of {} values, and the ints of an action have {values}", mask.len()));
    }
    let mut rest = mask.iter();
    match sizes.iter().position(|size| !rest.by_ref().take(*size).fold(false, |any, legal| any | legal)) {
        Some(int) => fail(format!("no value of int {int} is legal")),
        None => Ok(()),
    }
}
