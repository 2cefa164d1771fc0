//! Well-known text as a tree: `PROJCS["name", GEOGCS[...], UNIT["metre", 1]]`.
//!
//! Both versions share this grammar; [`super::wkt_crs`] knows their words.
//!
//! # References
//!
//! * OGC 18-010r7, *Well-known text representation of coordinate reference systems*, clause 6.

use super::ParseCrsError;

/// Brackets inside one another, beyond which a text is no coordinate reference system.
const GREATEST_DEPTH: usize = 24;

/// A keyword and what its brackets hold.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    /// In upper case.
    pub(super) keyword: String,
    pub(super) values: Vec<Value>,
}

/// One thing between the commas.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Node(Node),
    Text(String),
    Number(f64),
    /// A bare word, such as the direction of an axis.
    Word,
}

impl Node {
    /// The first text, which is the name.
    pub(super) fn name(&self) -> &str {
        self.values
            .iter()
            .find_map(|value| match value {
                Value::Text(text) => Some(text.as_str()),
                _ => None,
            })
            .unwrap_or_default()
    }

    /// The numbers, in order.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> {
        self.values.iter().filter_map(|value| match value {
            Value::Number(number) => Some(*number),
            _ => None,
        })
    }

    /// The nodes directly inside.
    pub(super) fn children(&self) -> impl Iterator<Item = &Node> {
        self.values.iter().filter_map(|value| match value {
            Value::Node(node) => Some(node),
            _ => None,
        })
    }

    /// The first node directly inside with one of these keywords.
    pub(super) fn child(&self, keywords: &[&str]) -> Option<&Node> {
        self.children().find(|node| keywords.contains(&node.keyword.as_str()))
    }

    /// The first node at any depth with one of these keywords.
    pub(super) fn descendant(&self, keywords: &[&str]) -> Option<&Node> {
        self.child(keywords).or_else(|| self.children().find_map(|node| node.descendant(keywords)))
    }
}

/// Parses one node, which must be the whole text.
pub(super) fn parse(text: &str) -> Result<Node, ParseCrsError> {
    let mut parser = Parser { text, at: 0 };
    let node = match parser.value(0)? {
        Value::Node(node) => node,
        _ => return Err(parser.error("a keyword and a bracket")),
    };
    parser.skip_spaces();
    if parser.at < text.len() { Err(parser.error("the end")) } else { Ok(node) }
}

struct Parser<'text> {
    text: &'text str,
    at: usize,
}

impl Parser<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    fn skip_spaces(&mut self) {
        self.at = self.text.len() - self.rest().trim_start().len();
    }

    /// The next character after spaces, which stays.
    fn peek(&mut self) -> Option<char> {
        self.skip_spaces();
        self.rest().chars().next()
    }

    fn error(&self, expected: &'static str) -> ParseCrsError {
        let found = match self.rest().chars().next() {
            Some(found) => format!("{found:?}"),
            None => "the end".to_owned(),
        };
        ParseCrsError::Wkt { at: self.at, found, expected }
    }

    fn value(&mut self, depth: usize) -> Result<Value, ParseCrsError> {
        match self.peek() {
            Some('"') => self.quoted().map(Value::Text),
            Some(c) if c.is_ascii_digit() || "+-.".contains(c) => self.number().map(Value::Number),
            Some(c) if c.is_ascii_alphabetic() => self.word_or_node(depth),
            _ => Err(self.error("a name, a number or a keyword")),
        }
    }

    /// Text in quotes; a quote inside is doubled.
    fn quoted(&mut self) -> Result<String, ParseCrsError> {
        let mut text = String::new();
        loop {
            self.at += 1;
            let Some(end) = self.rest().find('"') else {
                self.at = self.text.len();
                return Err(self.error("a closing quote"));
            };
            text.push_str(&self.rest()[..end]);
            self.at += end + 1;
            if !self.rest().starts_with('"') {
                return Ok(text);
            }
            text.push('"');
        }
    }

    fn number(&mut self) -> Result<f64, ParseCrsError> {
        let is_part = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
        let end = self.rest().find(|c| !is_part(c)).unwrap_or(self.rest().len());
        let number: Option<f64> = self.rest()[..end].parse().ok();
        let number = number.filter(|number| number.is_finite());
        let number = number.ok_or_else(|| self.error("a number"))?;
        self.at += end;
        Ok(number)
    }

    fn word_or_node(&mut self, depth: usize) -> Result<Value, ParseCrsError> {
        let is_part = |c: char| c.is_ascii_alphanumeric() || "_-:.".contains(c);
        let end = self.rest().find(|c| !is_part(c)).unwrap_or(self.rest().len());
        let keyword = self.rest()[..end].to_ascii_uppercase();
        self.at += end;
        let closing = match self.peek() {
            Some('[') => ']',
            Some('(') => ')',
            _ => return Ok(Value::Word),
        };
        if depth == GREATEST_DEPTH {
            return Err(self.error("fewer brackets inside one another"));
        }
        let mut values = Vec::new();
        loop {
            self.at += 1;
            values.push(self.value(depth + 1)?);
            match self.peek() {
                Some(',') => {}
                Some(c) if c == closing => {
                    self.at += 1;
                    return Ok(Value::Node(Node { keyword, values }));
                }
                _ => return Err(self.error("a comma or the closing bracket")),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TEXT: &str =
        r#"GEOGCS["a ""b""", DATUM("d",SPHEROID["s",3396190,-1.5e2]), AXIS["x",EAST]]"#;

    #[test]
    fn names_numbers_words_and_both_brackets_are_read() {
        let node = parse(TEXT).unwrap();
        assert_eq!((node.keyword.as_str(), node.name()), ("GEOGCS", "a \"b\""));
        let spheroid = node.descendant(&["SPHEROID"]).unwrap();
        assert_eq!(spheroid.numbers().collect::<Vec<_>>(), [3_396_190.0, -150.0]);
        assert_eq!(node.child(&["AXIS"]).unwrap().values[1], Value::Word);
    }

    #[test]
    fn what_breaks_off_is_an_error() {
        for end in (0..TEXT.len()).filter(|&end| TEXT.is_char_boundary(end)) {
            assert!(parse(&TEXT[..end]).is_err(), "{}", &TEXT[..end]);
        }
        assert!(parse(&"A[".repeat(100_000)).is_err());
        assert!(parse("A[1]]").is_err());
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[A-C\\[\\]()\",0-9.eé -]{0,40}") {
            let _ = parse(&text);
        }
    }
}
