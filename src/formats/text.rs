//! Lines, words and numbers of text formats.

use super::{DecodeError, Place};
use std::borrow::Cow;

/// Splits at ASCII blanks.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// A decimal number; `nan` and `inf` give themselves, for the caller to refuse or repair. The spellings of the C
/// library of Windows (`-1.#IND`) count as NaN.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    match text.parse() {
        Ok(value) => Some(value),
        Err(_) if text.contains('#') || text.to_ascii_lowercase().contains("nan") => Some(f64::NAN),
        Err(_) => None,
    }
}

/// `word` as text for messages, shortened.
pub(super) fn quoted(word: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(word).chars().take(40).collect();
    format!("{text:?}")
}

/// The next number of a line, or what is wrong with it.
pub(super) fn next_number<'a>(
    words: &mut impl Iterator<Item = &'a [u8]>,
    format: &'static str,
    place: impl Fn() -> Place,
) -> Result<f64, DecodeError> {
    let problem = match words.next() {
        Some(word) => match number(word) {
            Some(value) => return Ok(value),
            None => format!("{} is not a number", quoted(word)),
        },
        None => "a number is missing at the end of the line".into(),
    };
    Err(DecodeError::Malformed { format, place: place(), problem })
}

/// Lines with their 1-based numbers; a line that ends in a backslash goes on in the next one.
pub(super) struct LogicalLines<'a> {
    rest: Option<&'a [u8]>,
    line: usize,
}

impl<'a> LogicalLines<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: Some(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)), line: 0 }
    }

    /// A physical line without its end (`\n`, `\r\n` or, on old systems, `\r`).
    fn physical(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?;
        self.line += 1;
        let Some(end) = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r')) else {
            self.rest = None;
            return Some(rest);
        };
        let next = if rest[end..].starts_with(b"\r\n") { end + 2 } else { end + 1 };
        self.rest = rest.get(next..);
        rest.get(..end)
    }
}

impl<'a> Iterator for LogicalLines<'a> {
    type Item = (usize, Cow<'a, [u8]>);

    fn next(&mut self) -> Option<Self::Item> {
        let first = self.physical()?;
        let number = self.line;
        let Some(head) = first.strip_suffix(b"\\") else {
            return Some((number, Cow::Borrowed(first)));
        };
        let mut joined = head.to_vec();
        while let Some(line) = self.physical() {
            joined.push(b' ');
            match line.strip_suffix(b"\\") {
                Some(head) => joined.extend_from_slice(head),
                None => {
                    joined.extend_from_slice(line);
                    break;
                }
            }
        }
        Some((number, Cow::Owned(joined)))
    }
}
