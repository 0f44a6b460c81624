//! The codec against glue/testing/vectors.json, which docs/clients.md describes.

use crate::abstract_type::cut;
use crate::message::{decode, encode, Frames, Scalar};
use crate::zmtp::{greeting, put_frame, FrameReader, Item, COMMAND, MORE, READY};
use crate::{extras, masks, AbstractType, Error, Extra, Extras};

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
        mask: optional(one, "mask").iter().flat_map(|byte| (0..8).map(move |i| byte >> i & 1 == 1)).collect(),
        extras: match optional(one, "extras") {
            packed if packed.is_empty() => Extras::new(),
            packed => extras::unpack(&packed).expect("extras"),
        },
    }
}

/// Returns bytes that may be missing.
fn optional(one: &Json, key: &str) -> Vec<u8> {
    match one.get(key) {
        Json::Text(hex) => bytes(hex),
        _ => Vec::new(),
    }
}

fn body(body: &Json) -> Option<Vec<u8>> {
    match body {
        Json::Null => None,
        body if body.get("text") != &Json::Null => Some(body.get("text").text().into()),
        body if body.get("bytes") != &Json::Null => Some(bytes(body.get("bytes").text())),
        body => {
            let mut written = Vec::new();
            for one in body.get("abstract").array() {
                abstract_type(one).write_observation(&mut written).expect("what can be sent");
            }
            Some(written)
        }
    }
}

/// Returns the body of frames as this library writes it, whose extras are in the order of their names.
fn rewritten(entry: &Json) -> Option<Vec<u8>> {
    let body = frames(entry).body?;
    if entry.get("body").get("abstract") == &Json::Null {
        return Some(body);
    }
    let (mut rest, mut written) = (&body[..], Vec::new());
    while !rest.is_empty() {
        let mut one = AbstractType::default();
        rest = one.read(rest).expect("an observation or action");
        one.write_observation(&mut written).expect("what can be sent");
    }
    Some(written)
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
    let sections = ["messages", "accepted", "truncate", "beside", "pace"].map(|name| vectors.get(name));
    let all = sections.iter().flat_map(|section| section.array());
    for entry in all.filter(|entry| entry.get("from").text() == "hub" && is_ours(entry.get("to").text())) {
        let message = decode(&frames(entry)).unwrap_or_else(|error| panic!("{error}: {entry:?}"));
        assert_eq!(message.kind, entry.get("code").number() as u64, "{entry:?}");
        assert_eq!(message.session, entry.get("session").text(), "{entry:?}");
        assert_eq!(message.seq.to_string(), entry.get("seq").text(), "{entry:?}");
        let scalars: Vec<_> = entry.get("scalars").array().iter().map(scalar).collect();
        assert_eq!(message.scalars.len(), scalars.len(), "{entry:?}");
        assert_eq!(shown(&message.scalars, &message.scalars), shown(&scalars, &message.scalars), "{entry:?}");
        assert_eq!(body(entry.get("body")), rewritten(entry), "{entry:?}");
        let (items, received) = read(&bytes(entry.get("wire").text())).expect("the wire");
        assert!(items == [Item::Message] && received == frames(entry), "{entry:?}");
    }
}

#[test]
fn encodes_what_it_sends() {
    let vectors = vectors();
    let sections = ["messages", "truncate", "beside"].map(|name| vectors.get(name));
    let all = sections.iter().flat_map(|section| section.array());
    for entry in all.filter(|entry| entry.get("to").text() == "hub" && is_ours(entry.get("from").text())) {
        let scalars: Vec<_> = entry.get("scalars").array().iter().map(scalar).collect();
        let code = entry.get("code").number() as u64;
        let seq = entry.get("seq").text().parse().expect("a whole number");
        let header = encode(code, entry.get("session").text(), seq, &scalars);
        let sent = frames(entry);
        assert_eq!((header, body(entry.get("body"))), (sent.header.clone(), rewritten(entry)), "{entry:?}");
        let mut wire = Vec::new();
        put_frame(&mut wire, if sent.body.is_some() { MORE } else { 0 }, &sent.header);
        sent.body.iter().for_each(|body| put_frame(&mut wire, 0, body));
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

/// Returns what a scalar of the vectors is among extras.
fn extra(item: &Json) -> Extra {
    let int = |item: &Json| item.get("int").text().parse().expect("a whole number");
    let (kind, value) = match item {
        Json::Object(items) => &items[0],
        _ => panic!("{item:?} is no extra"),
    };
    match (kind.as_str(), value) {
        ("int", _) => Extra::Int(int(item)),
        ("float", value) => float(value).into(),
        ("text", value) => value.text().into(),
        ("binary", value) => Extra::Binary(bytes(value.text())),
        (_, Json::Array(items)) if items.first().map_or(false, |one| one.get("float") != &Json::Null) => {
            Extra::Floats(items.iter().map(|one| float(one.get("float"))).collect())
        }
        (_, value) => Extra::Ints(value.array().iter().map(int).collect()),
    }
}

#[test]
fn reads_and_writes_extras() {
    let vectors = vectors();
    for entry in vectors.get("extras").get("accepted").array() {
        let values = match entry.get("values") {
            Json::Object(values) => values.iter().map(|(name, value)| (name.clone(), extra(value))).collect(),
            other => panic!("{other:?} are no values"),
        };
        let read = extras::unpack(&bytes(entry.get("hex").text())).expect("extras");
        assert_eq!(read, values, "{entry:?}");
        let packed = extras::pack(&values).expect("what can be sent");
        assert!(values.is_empty() || extras::unpack(&packed).expect("extras") == values, "{entry:?}");
    }
    for entry in vectors.get("extras").get("refused").array() {
        let refused = extras::unpack(&bytes(entry.get("hex").text()));
        assert!(matches!(refused, Err(Error::Protocol(_))), "{entry:?}");
    }
}

#[test]
fn refuses_to_send_what_nobody_would_read() {
    let named = |name: &str, value: Extra| Extras::from([(name.to_owned(), value)]);
    let refused = [
        named("", 1.into()),
        named("a\nb", 1.into()),
        named(&"é".repeat(65), 1.into()),
        named("large", Extra::Binary(vec![0; 65_535])),
        named("huge", Extra::Floats(vec![0.0; 70_000])),
        (0..65).map(|i| (i.to_string(), i.into())).collect(),
    ];
    for extras in refused {
        let observation = AbstractType { extras, ..AbstractType::default() };
        assert!(matches!(observation.write_observation(&mut Vec::new()), Err(Error::Beside(_))), "{observation:?}");
    }
    let observation = AbstractType { mask: vec![true; 8 * 65_535 + 1], ..AbstractType::default() };
    assert!(matches!(observation.write_observation(&mut Vec::new()), Err(Error::Beside(_))));
}

#[test]
fn cuts_off_what_a_hub_does_not_take() {
    let (mut all, mut mask, mut extras, mut neither) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let full = AbstractType {
        ints: vec![7],
        mask: vec![false, true, true],
        extras: Extras::from([("coins".to_owned(), 3.into())]),
        ..AbstractType::default()
    };
    full.write_observation(&mut all).unwrap();
    AbstractType { extras: Extras::new(), ..full.clone() }.write_observation(&mut mask).unwrap();
    AbstractType { mask: vec![], ..full.clone() }.write_observation(&mut extras).unwrap();
    full.write(&mut neither);
    for (with_mask, with_extras, kept) in
        [(true, true, &all), (true, false, &mask), (false, true, &extras), (false, false, &neither)]
    {
        let mut body = all.clone();
        cut(&mut body, with_mask, with_extras);
        assert_eq!(&body, kept);
    }
    assert!(full.legal(1) && !full.legal(0) && !full.legal(3) && AbstractType::default().legal(9));
}

#[test]
fn finds_ints_without_a_legal_value() {
    let sizes =
        masks::sizes("OBSERVATIONS INTS (0 9) Actions DOUBLES (0 1) ints (0 1)( 2 -1 1 ) CHARCOUNT 2 REWARDS (0 1)");
    assert_eq!(sizes, [2, 3, 3]);
    for unknown in ["ACTIONS INTS (0 UNSPEC) REWARDS", "a mirror", "ACTIONS DOUBLES (0 1) REWARDS EXTRA INTS (0 1)"] {
        assert!(masks::sizes(unknown).is_empty(), "{unknown}");
    }
    let check = |bits: &str, sizes: &[usize]| {
        let mask: Vec<bool> = bits.bytes().map(|bit| bit == b'1').collect();
        masks::check("step", &mask, sizes).map_err(|error| error.to_string())
    };
    assert!(check("01001100", &sizes).is_ok() && check("", &sizes).is_ok() && check("0", &[]).is_ok());
    assert!(check("01000110", &sizes).unwrap_err().ends_with("no value of int 1 is legal"));
    for (unfit, sizes) in [("111111111", &sizes[..]), ("1111111", &sizes), ("10101", &[2, 2])] {
        assert!(check(unfit, sizes).unwrap_err().contains("values, and the ints of an action have"), "{unfit}");
    }
}
