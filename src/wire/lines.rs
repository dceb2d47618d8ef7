//! Lines of a connection, none longer than allowed.

use std::io::{BufRead, Error, ErrorKind, Result};

/// Reads one line without its end; `None` after the last one. An error of the kind `InvalidData` if it is longer than
/// `most` bytes.
pub fn read_line(
    from: &mut impl BufRead,
    most: usize,
    mut before_read: impl FnMut() -> Result<()>,
) -> Result<Option<Vec<u8>>> {
    let mut line = Vec::new();
    loop {
        before_read()?;
        let available = match from.fill_buf() {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            available => available?,
        };
        if available.is_empty() {
            // A client that ends without a line end has said half a line.
            return Ok(None);
        }
        let end = available.iter().position(|byte| *byte == b'\n');
        let taken = end.unwrap_or(available.len());
        if line.len() + taken > most {
            return Err(Error::new(ErrorKind::InvalidData, format!("a line has more than {most} bytes")));
        }
        line.extend_from_slice(&available[..taken]);
        from.consume(taken + usize::from(end.is_some()));
        if end.is_some() {
            return Ok(Some(line));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::BufReader;

    use super::*;

    #[test]
    fn lines_end_and_are_not_too_long() {
        let lines = |text: &str| {
            let mut from = BufReader::with_capacity(3, text.as_bytes());
            let mut lines = Vec::new();
            while let Some(line) = read_line(&mut from, 6, || Ok(()))? {
                lines.push(String::from_utf8(line).unwrap());
            }
            Ok::<_, Error>(lines)
        };
        assert_eq!(lines("a\n\nbcdefg\nhalf").unwrap(), ["a", "", "bcdefg"]);
        assert_eq!(lines("a\nbcdefgh\n").unwrap_err().kind(), ErrorKind::InvalidData);
    }
}
