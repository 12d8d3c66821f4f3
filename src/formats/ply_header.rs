//! The header of a PLY file, and the reading of single values in its three encodings.

use super::text::{quoted, words};
use super::{DecodeError, Place};

pub(super) const FORMAT: &str = "PLY";

/// More elements or properties than any program writes; each row is walked once per property.
const ELEMENTS_MAX: usize = 64;
const PROPERTIES_MAX: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// The type of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(word: &[u8]) -> Option<Self> {
        Some(match word {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }
}

#[derive(Clone, Debug)]
pub(super) struct Property {
    pub(super) name: String,
    /// Of the value, or of each value of a list.
    pub(super) kind: Kind,
    /// Lists: the type of their length.
    pub(super) list_count: Option<Kind>,
}

#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

#[derive(Clone, Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    pub(super) line_count: usize,
}

impl Header {
    /// The header, and where the data begins.
    pub(super) fn read(bytes: &[u8]) -> Result<(Self, usize), DecodeError> {
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let (mut start, mut line) = (0, 0);
        loop {
            line += 1;
            let malformed =
                |problem: String| DecodeError::Malformed { format: FORMAT, place: Place::Line(line), problem };
            let rest = bytes.get(start..).unwrap_or_default();
            let Some(end) = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r')) else {
                return Err(malformed("the header ends before end_header".into()));
            };
            let text = &rest[..end];
            start += if rest[end..].starts_with(b"\r\n") { end + 2 } else { end + 1 };
            let mut words = words(text);
            match words.next().unwrap_or_default() {
                b"ply" if line == 1 => {}
                _ if line == 1 => return Err(malformed("the file does not begin with ply".into())),
                b"comment" | b"obj_info" | b"" => {}
                b"format" => {
                    encoding = Some(encoding_of(words.next()).ok_or_else(|| malformed(unknown("format", text)))?)
                }
                b"element" => {
                    let element = element_of(words).ok_or_else(|| malformed(unknown("element", text)))?;
                    if elements.len() == ELEMENTS_MAX {
                        return Err(malformed(format!("more than {ELEMENTS_MAX} elements")));
                    }
                    elements.push(element);
                }
                b"property" => {
                    let property = property_of(words).ok_or_else(|| malformed(unknown("property", text)))?;
                    let element =
                        elements.last_mut().ok_or_else(|| malformed("a property before any element".into()))?;
                    if element.properties.len() == PROPERTIES_MAX {
                        return Err(malformed(format!("more than {PROPERTIES_MAX} properties")));
                    }
                    element.properties.push(property);
                }
                b"end_header" => {
                    let encoding = encoding.ok_or_else(|| malformed("the header names no format".into()))?;
                    return Ok((Self { encoding, elements, line_count: line }, start));
                }
                other => return Err(malformed(format!("{} is not a header line", quoted(other)))),
            }
        }
    }
}

fn unknown(what: &str, line: &[u8]) -> String {
    format!("{} is not a {what} that is read here", quoted(line))
}

fn encoding_of(word: Option<&[u8]>) -> Option<Encoding> {
    match word? {
        b"ascii" => Some(Encoding::Ascii),
        b"binary_little_endian" => Some(Encoding::LittleEndian),
        b"binary_big_endian" => Some(Encoding::BigEndian),
        _ => None,
    }
}

fn element_of<'w>(mut words: impl Iterator<Item = &'w [u8]>) -> Option<Element> {
    let name = String::from_utf8_lossy(words.next()?).into_owned();
    let count = std::str::from_utf8(words.next()?).ok()?.parse().ok()?;
    Some(Element { name, count, properties: Vec::new() })
}

fn property_of<'w>(mut words: impl Iterator<Item = &'w [u8]>) -> Option<Property> {
    let first = words.next()?;
    let (list_count, kind) = match first {
        b"list" => (Some(Kind::of(words.next()?).filter(|kind| kind.is_integer())?), Kind::of(words.next()?)?),
        first => (None, Kind::of(first)?),
    };
    Some(Property { name: String::from_utf8_lossy(words.next()?).into_owned(), kind, list_count })
}

/// Reads values one after another.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
    line: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize, encoding: Encoding, header_lines: usize) -> Self {
        Self { bytes, at, encoding, line: header_lines + 1 }
    }

    pub(super) fn place(&self) -> Place {
        match self.encoding {
            Encoding::Ascii => Place::Line(self.line),
            _ => Place::Byte(self.at as u64),
        }
    }

    fn available(&self) -> u64 {
        self.bytes.len().saturating_sub(self.at) as u64
    }

    fn truncated(&self, what: String, needed: u64) -> DecodeError {
        DecodeError::Truncated { format: FORMAT, what, needed, available: self.available() }
    }

    /// Refuses an element whose rows cannot be in the bytes that are left.
    pub(super) fn check_declared(&self, element: &Element) -> Result<(), DecodeError> {
        let least = |property: &Property| match self.encoding {
            // A digit and a blank; the last value of the file needs no blank.
            Encoding::Ascii => 2,
            _ => property.list_count.unwrap_or(property.kind).bytes() as u64,
        };
        let row_bytes: u64 = element.properties.iter().map(least).sum();
        let needed = row_bytes.saturating_mul(element.count);
        let spare = u64::from(self.encoding == Encoding::Ascii);
        if needed > self.available() + spare {
            return Err(self.truncated(format!("the element {} with its {} rows", element.name, element.count), needed));
        }
        Ok(())
    }

    /// The value as it is; integers of all types are exact.
    pub(super) fn scalar(&mut self, kind: Kind) -> Result<f64, DecodeError> {
        match self.encoding {
            Encoding::Ascii => self.ascii(),
            encoding => self.binary(kind, encoding),
        }
    }

    fn ascii(&mut self) -> Result<f64, DecodeError> {
        while let Some(byte) = self.bytes.get(self.at).filter(|byte| byte.is_ascii_whitespace()) {
            self.line += usize::from(*byte == b'\n');
            self.at += 1;
        }
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        if rest.is_empty() {
            return Err(self.truncated("the next value".into(), 1));
        }
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.at += end;
        super::text::number(&rest[..end]).ok_or_else(|| DecodeError::Malformed {
            format: FORMAT,
            place: self.place(),
            problem: format!("{} is not a number", quoted(&rest[..end])),
        })
    }

    fn binary(&mut self, kind: Kind, encoding: Encoding) -> Result<f64, DecodeError> {
        let size = kind.bytes();
        let Some(stored) = self.bytes.get(self.at..self.at.saturating_add(size)) else {
            return Err(self.truncated("the next value".into(), size as u64));
        };
        self.at += size;
        let mut value = [0; 8];
        value[..size].copy_from_slice(stored);
        if encoding == Encoding::BigEndian {
            value[..size].reverse();
        }
        let [a, b, c, d, ..] = value;
        Ok(match kind {
            Kind::I8 => f64::from(a as i8),
            Kind::U8 => f64::from(a),
            Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
            Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
            Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Kind::F64 => f64::from_le_bytes(value),
        })
    }

    /// The length of a list whose values are there.
    pub(super) fn list_count(&mut self, count_kind: Kind, kind: Kind) -> Result<u64, DecodeError> {
        let place = self.place();
        let count = self.scalar(count_kind)?;
        if !(0.0..=f64::from(u32::MAX)).contains(&count) || count.fract() != 0.0 {
            let problem = format!("a list cannot have {count} values");
            return Err(DecodeError::Malformed { format: FORMAT, place, problem });
        }
        let least = if self.encoding == Encoding::Ascii { 2 } else { kind.bytes() as u64 };
        let needed = count as u64 * least;
        if needed > self.available() + u64::from(self.encoding == Encoding::Ascii) {
            return Err(self.truncated(format!("a list of {count} values"), needed));
        }
        Ok(count as u64)
    }

    /// A vertex index; its range is checked once all vertices are known.
    pub(super) fn index(&mut self, kind: Kind) -> Result<u32, DecodeError> {
        let place = self.place();
        let index = self.scalar(kind)?;
        if (0.0..f64::from(u32::MAX)).contains(&index) && index.fract() == 0.0 {
            return Ok(index as u32);
        }
        let problem = format!("{index} is not a vertex index");
        Err(DecodeError::Malformed { format: FORMAT, place, problem })
    }

    pub(super) fn skip(&mut self, property: &Property) -> Result<(), DecodeError> {
        let count = match property.list_count {
            Some(count_kind) => self.list_count(count_kind, property.kind)?,
            None => 1,
        };
        for _ in 0..count {
            self.scalar(property.kind)?;
        }
        Ok(())
    }
}
