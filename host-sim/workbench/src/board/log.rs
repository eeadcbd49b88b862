//! The log of the emulated board: its defmt stream as lines of text.
//!
//! The firmware sends numbers only: the index of a message, then its values. The messages themselves are the names of
//! symbols in the ELF, which are never loaded. On silicon the same stream comes over RTT, and `probe-rs` or
//! `defmt-print` read it.

use crate::Refusal;
use defmt_parser::{DisplayHint, Fragment, Parameter, ParserMode, Type};
use elf::ElfBytes;
use elf::endian::LittleEndian;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The messages that a firmware may log.
#[derive(Clone, Debug)]
pub struct Messages(BTreeMap<u16, Message>);

/// Name of a symbol that stands for a message.
#[derive(Clone, Debug, Deserialize)]
struct Message {
    tag: String,
    #[serde(rename = "data")]
    text: String,
}

impl Messages {
    /// Those in an ELF.
    ///
    /// Errors: the file is no ELF, or has no table of messages.
    pub fn of(elf: &[u8]) -> Result<Self, Refusal> {
        let found = Self::read(elf).filter(|messages| !messages.is_empty());
        let none = || Refusal("the firmware has no table of log messages".to_owned());
        found.map(Self).ok_or_else(none)
    }

    fn read(bytes: &[u8]) -> Option<BTreeMap<u16, Message>> {
        let file = ElfBytes::<LittleEndian>::minimal_parse(bytes).ok()?;
        let (symbols, names) = file.symbol_table().ok()??;
        let message = |symbol: elf::symbol::Symbol| {
            let name = names.get(symbol.st_name as usize).ok()?;
            let message = serde_json::from_str(name).ok()?;
            Some((u16::try_from(symbol.st_value).ok()?, message))
        };
        Some(symbols.iter().filter_map(message).collect())
    }

    /// The lines of a stream. What follows its last whole frame is still under way, and left out.
    ///
    /// Errors: the first frame that makes no sense.
    pub fn lines(&self, stream: &[u8]) -> Result<Vec<String>, Refusal> {
        let end = stream.iter().rposition(|&byte| byte == 0).unwrap_or(0);
        let frames = stream[..end].split(|&byte| byte == 0);
        // Two zeros in a row enclose nothing.
        let frames = frames.filter(|frame| !frame.is_empty());
        let line = |(place, frame): (usize, &[u8])| {
            let bytes = rzcobs::decode(frame).map_err(|_| damaged(place))?;
            self.line(place, &bytes)
        };
        frames.enumerate().map(line).collect()
    }

    fn line(&self, place: usize, frame: &[u8]) -> Result<String, Refusal> {
        let mut values = Values(frame);
        let index = values.number(2).ok_or_else(|| damaged(place))? as u16;
        let message = self.message(index)?;
        let level = message.tag.strip_prefix("defmt_").unwrap_or(&message.tag);
        let mut line = format!("{level}: ");
        self.fill(&mut line, &message.text, &mut values)?;
        Ok(line)
    }

    fn message(&self, index: u16) -> Result<&Message, Refusal> {
        let unknown = || format!("the log is of another firmware: no message {index}");
        self.0.get(&index).ok_or_else(|| Refusal(unknown()))
    }

    /// Appends `text` with its values in their places.
    fn fill(&self, line: &mut String, text: &str, values: &mut Values<'_>) -> Result<(), Refusal> {
        let unreadable = || Refusal(format!("the log gives no values for \"{text}\""));
        let fragments =
            defmt_parser::parse(text, ParserMode::ForwardsCompatible).map_err(|_| unreadable())?;
        // Values come once each, in the order of their indices.
        let mut parameters = BTreeMap::new();
        for fragment in &fragments {
            if let Fragment::Parameter(parameter) = fragment {
                parameters.entry(parameter.index).or_insert(parameter);
            }
        }
        let mut written = BTreeMap::new();
        for (index, parameter) in parameters {
            let value = self.value(parameter, values)?.ok_or_else(unreadable)?;
            written.insert(index, value);
        }
        for fragment in &fragments {
            match fragment {
                Fragment::Literal(literal) => line.push_str(literal),
                Fragment::Parameter(parameter) => line.push_str(&written[&parameter.index]),
            }
        }
        Ok(())
    }

    /// The next value as text; `None` when it is cut short or of a kind that this firmware does not log.
    fn value(
        &self,
        parameter: &Parameter,
        values: &mut Values<'_>,
    ) -> Result<Option<String>, Refusal> {
        let width = match parameter.ty {
            Type::Format => return self.nested(values),
            Type::Str => return Ok(values.text()),
            Type::IStr => return self.interned(values),
            Type::Bool => return Ok(values.number(1).map(|bit| (bit != 0).to_string())),
            Type::F32 => {
                let bits = values.number(4);
                return Ok(bits.map(|bits| f32::from_bits(bits).to_string()));
            }
            Type::U8 => 1,
            Type::U16 => 2,
            Type::U32 | Type::Usize => 4,
            _ => return Ok(None),
        };
        let hex = matches!(parameter.hint, Some(DisplayHint::Hexadecimal { .. }));
        Ok(values.number(width).map(|number| match hex {
            true => format!("{number:#x}"),
            false => number.to_string(),
        }))
    }

    /// A text that the firmware names by its index.
    fn interned(&self, values: &mut Values<'_>) -> Result<Option<String>, Refusal> {
        let index = values.number(2).map(|index| index as u16);
        let message = index.map(|index| self.message(index)).transpose()?;
        Ok(message.map(|message| message.text.clone()))
    }

    /// A value that brings its own message: of an enum the variants, with a bar between them.
    fn nested(&self, values: &mut Values<'_>) -> Result<Option<String>, Refusal> {
        let Some(index) = values.number(2) else {
            return Ok(None);
        };
        let variants: Vec<&str> = self.message(index as u16)?.text.split('|').collect();
        let place = match variants.len() {
            1 => Some(0),
            _ => values.number(1),
        };
        let Some(variant) = place.and_then(|place| variants.get(place as usize)) else {
            return Ok(None);
        };
        let mut written = String::new();
        self.fill(&mut written, variant, values)?;
        Ok(Some(written))
    }
}

/// The refusal of a frame that is none; its place in the stream, counted from 0.
fn damaged(place: usize) -> Refusal {
    Refusal(format!("frame {place} of the log is damaged"))
}

/// The values of a frame that are still to be read.
struct Values<'a>(&'a [u8]);

impl Values<'_> {
    /// A number of `width` bytes, at most four.
    fn number(&mut self, width: usize) -> Option<u32> {
        let (bytes, rest) = self.0.split_at_checked(width)?;
        self.0 = rest;
        let number = bytes.iter().rev();
        Some(number.fold(0, |number, &byte| number << 8 | u32::from(byte)))
    }

    fn text(&mut self) -> Option<String> {
        let length = self.number(4)? as usize;
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        // A text that is none is shown as far as it is one.
        Some(bytes.utf8_chunks().map(|chunk| chunk.valid()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages() -> Messages {
        let message = |(index, tag, text): (u16, &str, &str)| {
            let (tag, text) = (tag.to_owned(), text.to_owned());
            (index, Message { tag, text })
        };
        let pair = "Pair {{ first: {=u16}, again: {0=u16} }}";
        let all = [
            (1, "defmt_info", "boot {} at {=u32:#x}, {=str}{=bool}"),
            (2, "defmt_derived", "Crystal|Bare({=u8})"),
            (3, "defmt_derived", pair),
            (4, "defmt_str", "no {brace} matters"),
            (5, "defmt_warn", "{=istr}"),
        ];
        Messages(all.map(message).into())
    }

    fn stream(frame: &[u8]) -> Vec<u8> {
        [&[0], &rzcobs::encode(frame)[..], &[0]].concat()
    }

    #[test]
    fn values_stand_in_their_places() {
        let boot = [1, 0, 2, 0, 1, 7, 0xff, 0, 0, 0, 2, 0, 0, 0, b'o', b'k', 1];
        let line = "info: boot Bare(7) at 0xff, oktrue";
        assert_eq!(messages().lines(&stream(&boot)), Ok(vec![line.to_owned()]));
        let twice = [stream(&boot), stream(&boot), vec![1, 2]].concat();
        let count = messages().lines(&twice).map(|lines| lines.len());
        assert_eq!(count, Ok(2), "the third is under way");
        let pair = [3, 0, 5, 0];
        let line = "derived: Pair { first: 5, again: 5 }";
        assert_eq!(messages().lines(&stream(&pair)), Ok(vec![line.to_owned()]));
        let interned = messages().lines(&stream(&[5, 0, 4, 0]));
        assert_eq!(interned, Ok(vec!["warn: no {brace} matters".to_owned()]));
    }

    #[test]
    fn what_is_no_log_of_the_firmware_is_refused() {
        let unknown = messages().lines(&stream(&[9, 0])).expect_err("no message");
        assert!(unknown.0.ends_with("no message 9"), "{unknown}");
        for short in [
            &[1, 0][..],
            &[1, 0, 2],
            &[1, 0, 2, 0, 5, 1],
            &[3, 0, 5],
            &[5, 0, 4],
        ] {
            let error = messages().line(0, short).expect_err("too short");
            let message = "the log gives no values for";
            assert!(error.0.starts_with(message), "{error}");
        }
        let error = Messages::of(b"text").expect_err("no ELF");
        assert!(error.0.contains("no table of log messages"), "{error}");
    }
}
