//! The codec against glue/testing/vectors.json, which docs/clients.md describes.

use crate::message::{decode, encode, Frames, Scalar};
use crate::zmtp::{greeting, put_frame, FrameReader, Item, COMMAND, MORE, READY};
use crate::{AbstractType, Error};

use self::json::Json;

/// As much of JSON as the vectors need.
mod json {
    use std::str::Chars;

    #[derive(Clone, Debug, PartialEq)]
    pub(super) enum Json {
        Null,
        Bool(bool),
        Number(i64),
        Text(String),
        Array(Vec<Json>),
        Object(Vec<(String, Json)>),
    }

    impl Json {
        pub(super) fn parse(text: &str) -> Json {
            value(&mut text.chars())
        }

        pub(super) fn get(&self, key: &str) -> &Json {
            match self {
                Json::Object(items) => items.iter().find(|(name, _)| name == key).map_or(&Json::Null, |(_, one)| one),
                _ => panic!("{self:?} is no object"),
            }
        }

        pub(super) fn text(&self) -> &str {
            match self {
                Json::Text(text) => text,
                _ => panic!("{self:?} is no text"),
            }
        }

        pub(super) fn array(&self) -> &[Json] {
            match self {
                Json::Array(items) => items,
                _ => panic!("{self:?} is no array"),
            }
        }

        pub(super) fn number(&self) -> i64 {
            match self {
                Json::Number(number) => *number,
                _ => panic!("{self:?} is no number"),
            }
        }
    }

    fn peek(chars: &mut Chars<'_>) -> char {
        while chars.as_str().starts_with(|c: char| c.is_whitespace() || c == ',' || c == ':') {
            chars.next();
        }
        chars.clone().next().expect("more JSON")
    }

    fn value(chars: &mut Chars<'_>) -> Json {
        match peek(chars) {
            '{' => {
                let mut items = Vec::new();
                chars.next();
                while peek(chars) != '}' {
                    let key = string(chars);
                    items.push((key, value(chars)));
                }
                chars.next();
                Json::Object(items)
            }
            '[' => {
                let mut items = Vec::new();
                chars.next();
                while peek(chars) != ']' {
                    items.push(value(chars));
                }
                chars.next();
                Json::Array(items)
            }
            '"' => Json::Text(string(chars)),
            _ => {
                let text = chars.as_str();
                let word = &text[..text.find(|c: char| !c.is_alphanumeric() && c != '-').unwrap_or(text.len())];
                *chars = text[word.len()..].chars();
                match word {
                    "null" => Json::Null,
                    "true" => Json::Bool(true),
                    "false" => Json::Bool(false),
                    number => Json::Number(number.parse().expect("a whole number")),
                }
            }
        }
    }

    fn string(chars: &mut Chars<'_>) -> String {
        assert_eq!(peek(chars), '"');
        chars.next();
        let mut units = Vec::new();
        loop {
            match chars.next().expect("the end of a text") {
                '"' => return String::from_utf16(&units).expect("UTF-16"),
                '\\' => match chars.next().expect("an escape") {
                    'u' => {
                        let digits: String = chars.by_ref().take(4).collect();
                        units.push(u16::from_str_radix(&digits, 16).expect("four digits"));
                    }
                    'n' => units.push(u16::from(b'\n')),
                    't' => units.push(u16::from(b'\t')),
                    'r' => units.push(u16::from(b'\r')),
                    other => units.extend(other.encode_utf16(&mut [0; 2]).iter()),
                },
                other => units.extend(other.encode_utf16(&mut [0; 2]).iter()),
            }
        }
    }
}

fn vectors() -> Json {
    let path = std::env::var("GLUE_VECTORS")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../glue/testing/vectors.json").to_owned());
    Json::parse(&std::fs::read_to_string(&path).expect(&path))
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex")).collect()
}

fn float(hex: &Json) -> f64 {
    f64::from_bits(u64::from_str_radix(hex.text(), 16).expect("16 digits"))
}

fn scalar(item: &Json) -> Scalar {
    let (kind, value) = match item {
        Json::Object(items) => &items[0],
        _ => panic!("{item:?} is no scalar"),
    };
    match (kind.as_str(), value) {
        ("int", value) => Scalar::Int(value.text().parse().expect("a whole number")),
        ("float", value) => Scalar::Float(float(value)),
        ("bool", Json::Bool(value)) => Scalar::Bool(*value),
        ("text", value) => value.text().into(),
        ("binary", value) => Scalar::Binary(bytes(value.text())),
        ("array", value) => Scalar::Array(value.array().iter().map(scalar).collect()),
        _ => Scalar::Nil,
    }
}

fn abstract_type(one: &Json) -> AbstractType {
    AbstractType {
        ints: one.get("ints").array().iter().map(|value| value.number() as i32).collect(),
        doubles: one.get("doubles").array().iter().map(float).collect(),
        chars: bytes(one.get("chars").text()),
    }
}

fn body(body: &Json) -> Option<Vec<u8>> {
    match body {
        Json::Null => None,
        body if body.get("text") != &Json::Null => Some(body.get("text").text().into()),
        body if body.get("bytes") != &Json::Null => Some(bytes(body.get("bytes").text())),
        body => {
            let mut written = Vec::new();
            body.get("abstract").array().iter().for_each(|one| abstract_type(one).write(&mut written));
            Some(written)
        }
    }
}

fn frames(entry: &Json) -> Frames {
    let frames = entry.get("frames").array();
    Frames { header: bytes(frames[0].text()), body: frames.get(1).map(|body| bytes(body.text())) }
}

/// Returns the items, and the frames of the last message, that come of bytes received one at a time.
fn read(wire: &[u8]) -> Result<(Vec<Item>, Frames), Error> {
    let mut reader = FrameReader::new();
    let mut items = Vec::new();
    let mut frames = Frames::default();
    for byte in greeting().iter().chain(wire) {
        reader.room()[0] = *byte;
        reader.received(1);
        while let Some(item) = reader.next(&mut frames)? {
            items.push(item);
        }
    }
    items.remove(0);
    Ok((items, frames))
}

/// Scalars as text, in which a NaN equals a NaN; a bool may be an integer.
fn shown(scalars: &[Scalar], like: &[Scalar]) -> Vec<String> {
    let show = |(scalar, like): (&Scalar, &Scalar)| match (scalar, like) {
        (Scalar::Int(value), Scalar::Bool(_)) => format!("{:?}", Scalar::Bool(*value != 0)),
        _ => format!("{scalar:?}"),
    };
    scalars.iter().zip(like).map(show).collect()
}

/// Whether this library has a role; a peer is one of them.
fn is_ours(role: &str) -> bool {
    ["peer", "agent", "environment", "experiment"].contains(&role)
}

#[test]
fn decodes_what_the_hub_sends() {
    let vectors = vectors();
    let sections = [vectors.get("messages"), vectors.get("accepted"), vectors.get("truncate")];
    let all = sections.iter().flat_map(|section| section.array());
    for entry in all.filter(|entry| entry.get("from").text() == "hub" && is_ours(entry.get("to").text())) {
        let message = decode(&frames(entry)).unwrap_or_else(|error| panic!("{error}: {entry:?}"));
        assert_eq!(message.kind, entry.get("code").number() as u64, "{entry:?}");
        assert_eq!(message.session, entry.get("session").text(), "{entry:?}");
        assert_eq!(message.seq.to_string(), entry.get("seq").text(), "{entry:?}");
        let scalars: Vec<_> = entry.get("scalars").array().iter().map(scalar).collect();
        assert_eq!(message.scalars.len(), scalars.len(), "{entry:?}");
        assert_eq!(shown(&message.scalars, &message.scalars), shown(&scalars, &message.scalars), "{entry:?}");
        assert_eq!(body(entry.get("body")), frames(entry).body, "{entry:?}");
        if let Json::Object(items) = entry.get("body") {
            if items[0].0 == "abstract" {
                let mut rest = frames(entry).body.expect("a body");
                for one in items[0].1.array() {
                    let mut read = AbstractType::default();
                    rest = read.read(&rest).to_vec();
                    assert_eq!(format!("{read:?}"), format!("{:?}", abstract_type(one)));
                }
            }
        }
        let (items, received) = read(&bytes(entry.get("wire").text())).expect("the wire");
        assert!(items == [Item::Message] && received == frames(entry), "{entry:?}");
    }
}

#[test]
fn encodes_what_it_sends() {
    let vectors = vectors();
    let sections = [vectors.get("messages"), vectors.get("truncate")];
    let all = sections.iter().flat_map(|section| section.array());
    for entry in all.filter(|entry| entry.get("to").text() == "hub" && is_ours(entry.get("from").text())) {
        let scalars: Vec<_> = entry.get("scalars").array().iter().map(scalar).collect();
        let code = entry.get("code").number() as u64;
        let seq = entry.get("seq").text().parse().expect("a whole number");
        let header = encode(code, entry.get("session").text(), seq, &scalars);
        let encoded = Frames { header, body: body(entry.get("body")) };
        assert!(encoded == frames(entry), "{entry:?}");
        let mut wire = Vec::new();
        put_frame(&mut wire, if encoded.body.is_some() { MORE } else { 0 }, &encoded.header);
        encoded.body.iter().for_each(|body| put_frame(&mut wire, 0, body));
        assert_eq!(wire, bytes(entry.get("wire").text()), "{entry:?}");
    }
}

#[test]
fn refuses_what_is_no_message() {
    for entry in vectors().get("refused").array() {
        let wire = bytes(entry.get("wire").text());
        let refused = read(&wire).and_then(|(_, frames)| decode(&frames));
        assert!(matches!(refused, Err(Error::Protocol(_))), "{entry:?}");
    }
}

#[test]
fn speaks_zmtp() {
    let vectors = vectors();
    let zmtp = vectors.get("zmtp");
    let mut ready = Vec::new();
    put_frame(&mut ready, COMMAND, READY);
    assert_eq!(greeting().to_vec(), bytes(zmtp.get("greeting").text()));
    assert_eq!(ready, bytes(zmtp.get("ready").text()));
    let (items, _) = read(&bytes(zmtp.get("ping with a context").text())).expect("a ping");
    assert_eq!(items, [Item::Command(b"PING".to_vec(), b"\x01\x2cabc".to_vec())]);
    for entry in zmtp.get("refused").array() {
        if !entry.get("name").text().contains("ERROR") {
            assert!(read(&bytes(entry.get("hex").text())).is_err(), "{entry:?}");
        }
    }
}
