//! Ranges of bytes, RFC 9110 section 14: one at a time.

use std::ops::Range;

use hyper::StatusCode;
use hyper::header::{ACCEPT_RANGES, CONTENT_RANGE, ETAG, HeaderMap, HeaderValue, IF_RANGE, RANGE};

use super::answer::{self, Answer};

/// A range that no byte is in.
#[derive(Debug, PartialEq)]
pub(super) struct Unsatisfiable {
    length: u64,
}

impl Unsatisfiable {
    pub(super) fn answer(&self) -> Answer {
        let mut answer = answer::error(StatusCode::RANGE_NOT_SATISFIABLE, "no such range");
        let range = HeaderValue::try_from(format!("bytes */{}", self.length));
        answer.headers_mut().extend(range.ok().map(|range| (CONTENT_RANGE, range)));
        answer
    }
}

/// The one range asked for, if it is one. Several, or what is no range of bytes, mean the whole.
pub(super) fn wanted(
    asked: &HeaderMap,
    tag: &HeaderValue,
    length: u64,
) -> Result<Option<Range<u64>>, Unsatisfiable> {
    if asked.get(IF_RANGE).is_some_and(|range| range != tag) {
        return Ok(None);
    }
    let range = asked.get(RANGE).and_then(|range| range.to_str().ok());
    range.map_or(Ok(None), |range| parse(range, length))
}

fn parse(range: &str, length: u64) -> Result<Option<Range<u64>>, Unsatisfiable> {
    let ends = range.strip_prefix("bytes=").and_then(|range| range.split_once('-'));
    let Some((first, last)) = ends.map(|(first, last)| (first.trim(), last.trim())) else {
        return Ok(None);
    };
    let is_number = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if !(is_number(first) && is_number(last)) {
        return Ok(None);
    }
    // More digits than a length has are more than any file has.
    let number = |text: &str| text.parse::<u64>().unwrap_or(u64::MAX);
    let range = match (first, last) {
        ("", "") => return Ok(None),
        ("", count) => length.saturating_sub(number(count))..length,
        (first, "") => number(first)..length,
        (first, last) if number(last) < number(first) => return Ok(None),
        (first, last) => number(first)..number(last).saturating_add(1).min(length),
    };
    if range.is_empty() { Err(Unsatisfiable { length }) } else { Ok(Some(range)) }
}

/// The answer as one of a part of `length` bytes; its body is that part already.
pub(super) fn partial(mut answer: Answer, range: &Range<u64>, length: u64) -> Answer {
    let text = format!("bytes {}-{}/{length}", range.start, range.end - 1);
    answer.headers_mut().extend(HeaderValue::try_from(text).ok().map(|text| (CONTENT_RANGE, text)));
    *answer.status_mut() = StatusCode::PARTIAL_CONTENT;
    answer
}

/// An answer with a tag and its body in memory, cut to the range that is asked for.
pub(super) fn cut(mut answer: Answer, asked: &HeaderMap) -> Answer {
    let (StatusCode::OK, true, Some(length)) =
        (answer.status(), answer.headers().contains_key(ETAG), answer.body().in_memory())
    else {
        return answer;
    };
    answer.headers_mut().insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    match answer.headers().get(ETAG).map_or(Ok(None), |tag| wanted(asked, tag, length)) {
        Ok(None) => answer,
        Ok(Some(range)) => partial(answer.map(|content| content.part(&range)), &range, length),
        Err(unsatisfiable) => unsatisfiable.answer(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_range_is_heeded_and_all_else_means_the_whole() {
        for (text, found) in [
            ("bytes=0-0", Ok(Some(0..1))),
            ("bytes=2-", Ok(Some(2..10))),
            ("bytes=2-99", Ok(Some(2..10))),
            ("bytes=-3", Ok(Some(7..10))),
            ("bytes=-99", Ok(Some(0..10))),
            ("bytes=9-9", Ok(Some(9..10))),
            ("bytes=10-", Err(Unsatisfiable { length: 10 })),
            ("bytes=-0", Err(Unsatisfiable { length: 10 })),
            ("bytes=99999999999999999999999-", Err(Unsatisfiable { length: 10 })),
            ("bytes=3-2", Ok(None)),
            ("bytes=0-1,4-5", Ok(None)),
            ("bytes=-", Ok(None)),
            ("bytes=+1-2", Ok(None)),
            ("lines=0-1", Ok(None)),
            ("", Ok(None)),
        ] {
            assert_eq!(parse(text, 10), found, "{text}");
        }
        assert_eq!(parse("bytes=0-", 0), Err(Unsatisfiable { length: 0 }));
    }
}
