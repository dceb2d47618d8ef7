//! The words of OBJ and MTL statements.

/// The first word, and the rest without the space between them.
pub fn split_word(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// The text of a file: UTF-8, or what has the mark of UTF-16; lines may end as on old Macs.
pub fn text_of(bytes: &[u8]) -> String {
    let wide = |unit: fn([u8; 2]) -> u16| {
        let units = bytes[2..].as_chunks::<2>().0.iter().map(|&pair| unit(pair));
        char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    let text: String = match bytes {
        [0xff, 0xfe, ..] => wide(u16::from_le_bytes),
        [0xfe, 0xff, ..] => wide(u16::from_be_bytes),
        _ => String::from_utf8_lossy(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)).into_owned(),
    };
    if text.contains('\n') { text } else { text.replace('\r', "\n") }
}

/// A number that is finite in single precision.
pub fn number(word: &str) -> Result<f64, String> {
    let value: f64 = word.parse().map_err(|_| format!("\"{word}\" is not a number"))?;
    // Most numbers are converted to single precision.
    if (value as f32).is_finite() { Ok(value) } else { Err(format!("{word} is not finite")) }
}
