//! The words of OBJ and MTL statements.

/// The first word, and the rest without the space between them.
pub fn split_word(text: &str) -> (&str, &str) {
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// A number that is finite in single precision.
pub fn number(word: &str) -> Result<f64, String> {
    let value: f64 = word.parse().map_err(|_| format!("\"{word}\" is not a number"))?;
    // Most numbers are converted to single precision.
    if (value as f32).is_finite() { Ok(value) } else { Err(format!("{word} is not finite")) }
}
